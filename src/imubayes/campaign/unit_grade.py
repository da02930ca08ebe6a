"""The grade of a unit: as the campaign states it, or by the noise of its channels.

Noise distinguishes the technologies better than anything else that is known before a fit.  One raw sample of a MEMS
gyro for consumers scatters by 0.05 to 0.3 deg/s, of an industrial one by 0.02 to 0.05 deg/s, of a ring-laser,
fibre-optic or tactical MEMS gyro by less; one of their accelerometers by more than 1 mg, by 0.5 to 1 mg, and by less.
"""

import numpy as np

from imubayes.foundations.campaign_data import Campaign, Grade
from imubayes.foundations.units import to_si

LEAST_NOISE: dict[str, tuple[float, float]] = {
    "gyro": (to_si("deg/s") * 0.05, to_si("deg/s") * 0.02),
    "accelerometer": (to_si("mg"), 0.5 * to_si("mg")),
}
"""Least standard deviation of one raw sample, rad/s and m/s², of a consumer and of an industrial unit."""


def grade_of(campaign: Campaign, kind: str) -> Grade:
    """Return the grade of the channels of a kind.

    A kind whose noise is unknown, such as the gyros of a unit in motion, has the grade of the other kind: both are of
    one unit.  It is tactical if nothing is known of either.
    """
    if campaign.grade is not None:
        return campaign.grade
    if kind not in LEAST_NOISE:
        return "tactical"
    for each in sorted(LEAST_NOISE, key=lambda each: each != kind):
        found = _by_noise(campaign, each)
        if found is not None:
            return found
    return "tactical"


def _by_noise(campaign: Campaign, kind: str) -> Grade | None:
    """Return the grade by the noise of the channels of a kind; None if it is unknown."""
    noise = [channel.noise / abs(channel.scale_si) for channel in campaign.of_kind(kind) if channel.noise is not None]
    if not noise:
        return None
    typical, (consumer, industrial) = float(np.median(noise)), LEAST_NOISE[kind]
    return "consumer" if typical >= consumer else "industrial" if typical >= industrial else "tactical"
