"""The grade of a unit that its errors show: |f| = g in the poses of a unit turned by hand tells bias and scale factor.

The grade chooses the default priors.  The noise of raw samples tells it as a rule; where an output filter hides that
noise, or a table of means states none, the priors of too fine a grade would hold the errors of a consumer unit.
"""

import numpy as np
import scipy  # loads its parts when they are first used

from imubayes.campaign.equipment import grade_of
from imubayes.foundations.campaign_data import GRADES, Campaign, Grade
from imubayes.model.effect_registry import Registry
from imubayes.parameters.declarations import declared_parameters
from imubayes.parameters.priors import parse_prior

# Log odds from which a coarser grade is clear, and the least scatter of |f|, m/s²: 0.1 mg of tilt, drift and rounding.
_CLEARLY, _LEAST_SCATTER = 3.0, 1e-3


def shown_grade(campaign: Campaign) -> tuple[Grade, Grade] | None:
    """Return the grade whose default priors the poses of a unit turned by hand show, and that which its noise tells.

    Output filters make the noise of a consumer unit small, and a table of means states none; its biases and scale
    factors, of which |f| = g tells nearly all, remain those of its grade.  None where the grade is stated, where there
    are no such poses, or where no coarser grade explains |f| clearly better.
    """
    told = grade_of(campaign, "accelerometer")
    size, response = _magnitudes(campaign)
    if campaign.grade is not None or not len(size):
        return None
    left = size - response @ np.linalg.lstsq(response, size, rcond=None)[0]
    noise = max(_LEAST_SCATTER, float(np.sqrt(left @ left / max(1, len(left) - response.shape[1]))))
    evidence = {grade: _evidence(size, response, noise, grade, campaign) for grade in GRADES}
    coarser = GRADES[: GRADES.index(told) + 1]
    best = max(coarser, key=evidence.__getitem__)
    return (best, told) if evidence[best] > evidence[told] + _CLEARLY else None


def _magnitudes(campaign: Campaign) -> tuple[np.ndarray, np.ndarray]:
    """Return |f| − g of all poses of a unit turned by hand, (n,), m/s², and its response to the nine errors, (n, 9)."""
    heavy = [place for place, channel in enumerate(campaign.channels) if channel.kind == "accelerometer"]
    poses = [run.observed[:, heavy] for run in campaign.runs if run.tumble is not None]
    if len(heavy) != 3 or not poses:
        return np.zeros(0), np.zeros((0, 9))
    channels = [campaign.channels[place] for place in heavy]
    offset, scale = (np.array([getattr(each, key) for each in channels]) for key in ("offset", "scale_si"))
    read = (np.concatenate(poses) - offset) / scale
    read = read[np.isfinite(read).all(axis=1)]
    size = np.linalg.norm(read, axis=1)
    up, gravity = read / size[:, None], campaign.site.gravity
    return size - gravity, np.hstack([gravity * up**2, gravity * up * np.roll(up, -1, axis=1), up])


def _evidence(size: np.ndarray, response: np.ndarray, noise: float, grade: Grade, campaign: Campaign) -> float:
    """Return the logarithm of the probability density of |f| − g under the default priors of a grade."""
    effects, gravity = Registry().effects, campaign.site.gravity
    # The two angles of a pair of axes have one sum.
    fields = (("accel_scale_factor", "scale", 1), ("accel_misalignment", "toward_o", 2), ("accel_bias", "bias", 1))
    widths = []
    for name, field, summed in fields:
        declared = declared_parameters(effects[name])[field]
        width = parse_prior(declared.prior_of(grade), declared.unit, gravity, name).sd()
        widths += 3 * [width * np.sqrt(summed)]
    covariance = response @ np.diag(np.square(widths)) @ response.T + noise**2 * np.eye(len(size))
    return float(scipy.stats.multivariate_normal.logpdf(size, cov=covariance))
