"""Noise densities of the gyros and the accelerometers of a unit, as filters ask for them, from its static records."""

from dataclasses import dataclass

from imubayes.foundations.campaign_data import Campaign
from imubayes.noise_analysis.cosine_spectra import NoiseTerm
from imubayes.noise_analysis.noise_record import StaticNoise, coefficient_unit


@dataclass(frozen=True)
class NoiseDensity:
    """The noise of the gyros or the accelerometers.

    Attributes
    ----------
    white : rad/s/√Hz or m/s²/√Hz; None where unknown.
    walk : rad/s²/√Hz or m/s³/√Hz; None where unknown.
    walk_is_limit : whether the walk is an upper limit of 95 %.
    """

    white: float | None
    walk: float | None
    walk_is_limit: bool = False


def of_record(noise: StaticNoise, campaign: Campaign) -> dict[str, NoiseDensity]:
    """Return the noise of a static record, kind → density."""
    found = {}
    for kind in ("gyro", "accelerometer"):
        white, walk = [], []
        for record in noise.channels:
            channel = next((c for c in campaign.of_kind(kind) if c.name == record.channel), None)
            if channel is None:
                continue
            for term, into in ((NoiseTerm.WHITE, white), (NoiseTerm.RANDOM_WALK, walk)):
                si = coefficient_unit(channel, term, campaign.site.gravity)[1]
                own = record.of(term)
                value = own.value if own.determined else own.upper_limit
                if value is not None:
                    into.append((value * si, not own.determined))
        if white:
            largest, limit = max(walk) if walk else (None, False)
            found[kind] = NoiseDensity(max(white)[0], largest, limit)
    return found
