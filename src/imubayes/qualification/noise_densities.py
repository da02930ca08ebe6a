"""Noise of a triad as filters ask for it: white noise density and random walk, of its noisiest axis."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from imubayes.campaign_data import Campaign
from imubayes.errors import InputError, Issue
from imubayes.noise_analysis.noise_record import StaticNoise, coefficient_unit
from imubayes.noise_analysis.noise_spectra import NoiseTerm
from imubayes.qualification.onboard_record import OnboardConstants, TriadConstants
from imubayes.results.result import Result

_SECONDS = math.sqrt(3600.0)


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


def read_noise(file: Path) -> StaticNoise:
    """Read what `imubayes noise --out` wrote.

    Raises
    ------
    InputError
        where the file is missing or no such record.
    """
    file = file / "noise.json" if file.is_dir() else file
    try:
        return StaticNoise.model_validate_json(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        fault = "there is no such file" if not file.is_file() else "the file is no noise record"
        raise InputError(
            Issue(fault, str(file), "noise.json, as `imubayes noise CAMPAIGN --out FOLDER` writes it", "give its path")
        ) from error


def of_record(noise: StaticNoise, campaign: Campaign) -> dict[str, NoiseDensity]:
    """Return the noise of a static record, kind → density."""
    found = {}
    for kind in ("gyro", "accelerometer"):
        white, walk, limit = [], [], False
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
            largest = max(walk) if walk else (None, False)
            limit = largest[1]
            found[kind] = NoiseDensity(max(white)[0], largest[0], limit)
    return found


def of_fit(result: Result, constants: OnboardConstants, rate: float | None) -> dict[str, NoiseDensity]:
    """Return the noise that a fit knows: white noise of one sample at a rate in Hz, a random walk where it has one."""
    walks = {
        line.name[len("random_walk_noise.k[") : -1]: line.mean
        for line in result.summary.parameters
        if line.name.startswith("random_walk_noise.k[") and line.mean is not None
    }
    return {triad.kind: of_triad(triad, walks, rate) for triad in constants.triads}


def of_triad(triad: TriadConstants, walks: Mapping[str, float], rate: float | None) -> NoiseDensity:
    """Return the noise of a triad from that of a sample and random walks by channel, in output units over 1 h."""
    scales = dict(zip(triad.channels, triad.nominal_scale, strict=True))
    own = [walks.get(name, walks.get("all", 0.0)) / abs(scale) / _SECONDS for name, scale in scales.items()]
    return NoiseDensity(max(triad.sample_noise) / math.sqrt(rate) if rate else None, max(own) or None)
