"""The noise terms of static records as a model file of priors for the other campaigns of the unit.

Determined terms have lognormal priors as wide as their intervals, and keep the correlation of their estimate.  Flicker
noise and random walk that the record does not determine are not zero: they have half-normal priors with 95 % below the
upper limit.  A ramp of one record may go the other way in the next.
"""

import math
from collections.abc import Sequence

import numpy as np

from imubayes.noise_analysis.noise_record import ChannelNoise, StaticNoise, TermRecord
from imubayes.noise_analysis.noise_spectra import NoiseTerm

# Effect, parameter and factor from output units and seconds of each coefficient; white noise is scaled by the sampling
# rate besides.
_EFFECTS = {
    NoiseTerm.WHITE: ("white_noise", "sigma", 1.0),
    NoiseTerm.QUANTISATION: ("pulse_quantisation", "q", 1.0),
    NoiseTerm.FLICKER: ("flicker_noise", "b", 1.0),
    NoiseTerm.RANDOM_WALK: ("random_walk_noise", "k", 60.0),
    NoiseTerm.MARKOV: ("gauss_markov_noise", "sigma", 1.0),
}
_TIME = "correlation_time"
_ALWAYS = (NoiseTerm.FLICKER, NoiseTerm.RANDOM_WALK)
_QUANTILE = 1.959964  # of the normal distribution, at 97.5 %
_LEAST_WIDTH = 1e-3


def priors_text(noise: StaticNoise, sample_rate: float | None = None) -> str:
    """Return the noise of the last record of every channel as a model file.

    Parameters
    ----------
    sample_rate : of the raw samples of the other campaigns, Hz; that of the record where None.
    """
    last = {channel.channel: channel for channel in noise.channels if has_priors(channel)}
    text = [
        "# Noise of the unit from its static records, as priors for models of its other campaigns. In such a model:",
        '#     noise_priors = "noise-priors.toml"        # path from the folder of the model file',
        "# It takes the place of effects of the same names. sigma of white noise is that of one raw sample.",
        "format = 1",
        f'name = "noise of {noise.campaign}"',
    ]
    for channel in last.values():
        rate = sample_rate or 1 / channel.interval_s
        text += ["", f"# {channel.channel}, run {channel.run}; raw samples at {rate:.6g} Hz"]
        if withheld := [str(term.term) for term in channel.terms if term.withheld]:
            text.append(f"# not determined by this record, and not here: {', '.join(withheld)}")
        text += _effects(channel, rate)
        text += _correlation(channel)
    left_out = dict.fromkeys(channel.channel for channel in noise.channels if channel.channel not in last)
    if left_out:
        text += ["", f"# without priors, as the record does not determine their white noise: {', '.join(left_out)}"]
    return "\n".join(text) + "\n"


def has_priors(channel: ChannelNoise) -> bool:
    """Whether a record gives priors: from a fit that converged and determines the white noise."""
    return channel.converged and channel.of(NoiseTerm.WHITE).determined


def _effects(channel: ChannelNoise, rate: float) -> list[str]:
    text: list[str] = []
    for term, (effect, parameter, factor) in _EFFECTS.items():
        found = channel.of(term)
        scale = factor * (math.sqrt(rate) if term is NoiseTerm.WHITE else 1.0)
        if found.determined:
            priors = {parameter: _lognormal(found, scale)}
            if term is NoiseTerm.MARKOV:
                assert channel.correlation_time_s is not None
                width = (channel.correlation_time_sd_s or 0.0) / channel.correlation_time_s
                priors["time"] = f"lognormal({channel.correlation_time_s:.8g} s, {max(width, _LEAST_WIDTH):.3g})"
        elif term in _ALWAYS and found.upper_limit is not None:
            priors = {parameter: _below(found, scale * found.output_per_unit)}
        else:
            continue
        text += _entry(effect, channel.channel, priors, optional=term is not NoiseTerm.WHITE)
    ramp = channel.of(NoiseTerm.RAMP)
    if ramp.determined:
        assert ramp.value is not None
        assert ramp.sd is not None
        effect = "gyro_bias_drift" if channel.kind == "gyro" else "accel_bias_drift"
        priors = {"slope": f"normal(0, {math.hypot(ramp.value, ramp.sd):.6g} {ramp.unit})"}
        text += [f"# ramp of this record: {ramp.value:.4g} ± {ramp.sd:.2g} {ramp.unit}"]
        text += _entry(effect, channel.channel, priors, optional=True)
    return text


def _entry(effect: str, channel: str, priors: dict[str, str], optional: bool) -> list[str]:
    listed = ", ".join(f'{name} = "{prior}"' for name, prior in priors.items())
    entry = ["[[effect]]", f'name = "{effect}"', f'channels = ["{channel}"]', f"prior = {{ {listed} }}"]
    return [*entry, *(["optional = true"] if optional else []), ""]


def _lognormal(found: TermRecord, scale: float) -> str:
    """Return the prior of a determined coefficient, in output units, by the ends of its interval."""
    assert found.value is not None
    assert found.low is not None
    assert found.high is not None
    per, middle = scale * found.output_per_unit, found.value
    width = math.log(found.high / middle) / _QUANTILE
    if found.low > 0:
        middle, width = math.sqrt(found.low * found.high), math.log(found.high / found.low) / (2 * _QUANTILE)
    return f"lognormal({per * middle:.8g} output, {max(width, _LEAST_WIDTH):.3g})"


def _below(found: TermRecord, scale: float) -> str:
    assert found.upper_limit is not None
    return f"halfnormal({scale * found.upper_limit / _QUANTILE:.6g} output)"


def _correlation(channel: ChannelNoise) -> list[str]:
    """Return the correlation of the logarithms of the determined coefficients as a block of the model file."""
    names = []
    for term in channel.correlated_terms:
        effect, parameter = ("gauss_markov_noise", "time") if term == _TIME else _EFFECTS[NoiseTerm(term)][:2]
        names.append(f"{effect}.{parameter}[{channel.channel}]")
    if len(names) < 2:
        return []
    rows = [f"    [{_numbers(row)}]," for row in channel.correlation]
    listed = ", ".join(f'"{name}"' for name in names)
    return ["[[prior_correlation]]", f"parameters = [{listed}]", "matrix = [", *rows, "]", "optional = true", ""]


def _numbers(row: Sequence[float]) -> str:
    return ", ".join(f"{value:.6f}" for value in np.asarray(row))
