"""The noise terms of static records as tables, sentences and figures, and as a model file of priors.

The priors serve the other campaigns of the unit.  Determined terms have lognormal priors as wide as their intervals,
and keep the correlation of their estimate.  Flicker noise and random walk that the record does not determine are not
zero: they have half-normal priors with 95 % below the upper limit.  A ramp of one record may go the other way in the
next.

There is a figure per record.  The sentences state what a static record holds beside noise, and why terms are withheld.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from imubayes.display.layout import Cell, Report, Sheet, cells
from imubayes.display.numbers_and_labels import pretty, rounded, significant
from imubayes.foundations.files import write_text
from imubayes.foundations.quantity_names import name_of
from imubayes_recordings.display.allan import allan_figure
from imubayes_recordings.display.kalibr_noise import noise_yaml
from imubayes_recordings.noise_analysis.described_band import Cause, Gap
from imubayes_recordings.noise_analysis.noise_record import ChannelNoise, NoiseDensity, StaticNoise, TermRecord
from imubayes_recordings.noise_analysis.noise_terms import NoiseTerm

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
    sample_rate : of the raw samples of the other campaigns, Hz; that of the record if None.
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
        names.append(name_of(f"{effect}.{parameter}", channel.channel))
    if len(names) < 2:
        return []
    rows = [f"    [{_numbers(row)}]," for row in channel.correlation]
    listed = ", ".join(f'"{name}"' for name in names)
    return ["[[prior_correlation]]", f"parameters = [{listed}]", "matrix = [", *rows, "]", "optional = true", ""]


def _numbers(row: Sequence[float]) -> str:
    return ", ".join(f"{value:.6f}" for value in np.asarray(row))


_COARSE = 0.1  # part of rounding in the variance of samples from which it is reported
_MOST_LINES = 5


def withheld_because(noise: ChannelNoise, cause: Cause) -> str:
    """Return why terms are withheld, and what to do."""
    time = noise.correlation_time_s
    if cause is Cause.AMBIGUOUS and time is not None:
        square = sum(
            (scale * noise.of(term).maximum_in_output_units) ** 2
            for term, scale in ((NoiseTerm.WHITE, 1.0), (NoiseTerm.MARKOV, (2 * time) ** 0.5))
        )
        white = noise.of(NoiseTerm.WHITE)
        low = f"{significant(square**0.5 / white.output_per_unit)} {density_unit(white.unit)}"
        return (
            f"Gauss–Markov noise with a correlation time of {significant(time)} s and white noise behind a low-pass "
            f"filter look the same. If it is a filter, N is {low}."
        )
    return _CAUSES[cause]


_CAUSES = {
    Cause.CONVERGENCE: "the estimate did not converge. Give a part of the record without disturbances.",
    Cause.UNDESCRIBED: "the noise terms do not describe the spectrum. Give a part of the record without disturbances.",
    Cause.FILTER: "a filter shapes the frequencies that determine it. Give an unfiltered log, or a longer record.",
    Cause.DRIFT: "low frequencies are not those of noise. Give a settled part of the record, or a temperature_degC.",
    Cause.CHANGE: "low frequencies contain the change. Give a settled part of the record.",
    Cause.DISTURBANCE: "the disturbance extends over the whole spectrum. Give a part of the record without it.",
    Cause.REPETITION: "the log is too coarse to distinguish repeated values from equal ones. Give the sensor's own "
    "log.",
    Cause.ROUNDING: (
        "the noise is below half a step of the log and not rounded at random, so that its spectrum is not that of the "
        "sensor. Give a log of finer steps."
    ),
    Cause.AMBIGUOUS: "a Gauss–Markov process and a low-pass filter look the same.",
}


def density_unit(unit: str) -> str:
    """Return the unit of a noise term for display, with √h and √Hz."""
    return pretty(unit).replace("sqrt(h)", "√h").replace("sqrt(Hz)", "√Hz")


def _left_out(noise: ChannelNoise) -> Iterator[str]:
    """Yield a sentence for each thing that was taken out of the record before its noise was fitted."""
    unit = pretty(noise.output_unit)
    if (found := noise.repetition) is not None:
        times = f"{found.mean:.3g}" if found.shortest == found.longest else f"{found.shortest} to {found.longest}"
        yield (
            f"each value is repeated {times} times: the output is new every {significant(found.interval_s)} s. The "
            "record is taken at that rate."
        )
    if (found := noise.outliers) is not None:
        many = "an outlier is" if found.count == 1 else f"{found.count} outliers are"
        yield f"{many} left out; the largest is {found.size:.3g} {unit} off at {found.time_s:.6g} s."
    if (found := noise.contamination) is not None:
        many = "a stretch is" if found.count == 1 else f"{found.count} stretches are"
        yield (
            f"{many} left out in which the unit did not rest, {100 * found.share:.2g} % of the record, the "
            f"largest disturbance at {found.loudest_s:.6g} s."
        )
    if (found := noise.temperature) is not None:
        slope = f"{found.slope:.3g} ± {found.sd:.1g} {unit} per K"
        yield f"the output follows temperature_degC, by {slope}. This is removed before the noise is estimated."
    if noise.lines:
        named = ", ".join(
            f"{line.frequency_hz:.5g} Hz (amplitude {line.amplitude:.3g} ± {line.amplitude_sd:.1g})"
            for line in noise.lines[:_MOST_LINES]
        )
        more = f" and {len(noise.lines) - _MOST_LINES} more" if len(noise.lines) > _MOST_LINES else ""
        word = "a line" if len(noise.lines) == 1 else "lines"
        yield f"the spectrum has {word} at {named} {unit}{more}, removed before the fit."


def _not_as_described(noise: ChannelNoise) -> Iterator[str]:
    """Yield a sentence for each thing in which the record is not the noise that the terms describe."""
    unit = pretty(noise.output_unit)
    if (change := noise.sudden_change) is not None:
        yield (
            f"at {change.time_s:.6g} s the output changes by {change.change:.3g} {unit} from one mean over "
            f"{change.tau_s:.3g} s to the next, {change.ratio:.0f} times the scatter of such changes: a step or a "
            "transient, not noise."
        )
    cut = next((gap for gap in noise.gaps if gap.cause is Cause.FILTER), None)
    told = "a filter shapes the spectrum: "
    if cut is not None:
        tau = significant(noise.shortest_tau_s)
        yield f"{told}frequencies above {cut.low_hz:.3g} Hz are left out, as with --shortest-tau {tau}."
    elif (off := noise.roll_off) is not None:
        lost = -10 * off.attenuation / math.log(10)
        yield f"{told}its power is {lost:.2g} dB at {off.frequency_hz:.3g} Hz. N applies to low frequencies."
    yield from (_gap_text(gap) for gap in noise.gaps if gap.cause is not Cause.FILTER)
    if noise.unequal_levels > 1:
        yield (
            f"over the record the noise level varies {noise.unequal_levels:.2g} times as much as that of Gaussian "
            "noise with a constant level: the level changes, or the noise has heavy tails. The interval of N is "
            "widened by the same factor."
        )
    share = noise.rounding_share
    if share >= _COARSE and not noise.of(NoiseTerm.QUANTISATION).determined:
        part = "is taken out of N" if noise.rounding_removed else "is part of N"
        yield (
            f"the log has steps of {noise.resolution_in_output_units:.3g} {unit}. Rounding to them makes "
            f"{min(share, 1.0):.0%} of the variance of single samples, and {part}."
        )


def _gap_text(gap: Gap) -> str:
    what = "a drift or a transient" if gap.cause is Cause.DRIFT else "a vibration or a disturbance"
    span = (
        f"below {gap.high_hz:.3g} Hz" if gap.cause is Cause.DRIFT else f"from {gap.low_hz:.3g} to {gap.high_hz:.3g} Hz"
    )
    return f"the noise terms do not describe the spectrum {span}, left out of the fit: {what} may shape it."


_NAMES = {
    NoiseTerm.QUANTISATION: "quantisation Q",
    NoiseTerm.FLICKER: "bias instability B",
    NoiseTerm.MARKOV: "Gauss–Markov σ",
}
# The names of IEEE Std 952 and 1293: white noise of a rate is a random walk of the angle.
_NAMES_BY_KIND = {
    NoiseTerm.WHITE: ("angle random walk N", "velocity random walk N"),
    NoiseTerm.RANDOM_WALK: ("rate random walk K", "accel. random walk K"),
    NoiseTerm.RAMP: ("rate ramp R", "acceleration ramp R"),
}
_REASONS = {"empty": "without a sample", "constant": "constant, dead or coarser than its noise"}
NOISE_FILE, PRIORS_FILE, KALIBR_FILE = "noise.json", "noise-priors.toml", "imu.yaml"


def noise_report(noise: StaticNoise) -> Report:
    """Return the terms of every channel, and what to know about them."""
    percent = f"{100 * noise.probability:.0f} %"
    sheets = [_sheet(channel, percent) for channel in noise.channels]
    lines = [f"{each.channel} in run '{each.run}' is {_REASONS[each.reason]}: left out." for each in noise.left_out]
    lines += [
        f"{channel.channel} in run '{channel.run}': {told}" for channel in noise.channels for told in _warnings(channel)
    ]
    closing = (
        f"Intervals are {percent} profile-likelihood intervals (for a ramp, posterior intervals). Upper limits are "
        f"one-sided {percent} limits (for a ramp, the farther end of its interval). A term is determined if the record "
        "needs it in addition to all others. In 1 to 2 % of records without a term, the term is reported nevertheless. "
        "As in IEEE Std 952 and 1293, N is white noise of the output, B flicker noise (the floor "
        "of its Allan deviation is 0.664 B) and K a random walk. Gauss–Markov noise with a correlation time longer "
        "than the record cannot be distinguished from a random walk.",
    )
    return Report(lines, sheets, closing)


def _name(term: NoiseTerm, kind: str) -> str:
    return _NAMES[term] if term in _NAMES else _NAMES_BY_KIND[term][kind != "gyro"]


def _sheet(noise: ChannelNoise, percent: str) -> Sheet:
    missing = f", {noise.missing} missing" if noise.missing else ""
    hours = (noise.samples + noise.missing) * noise.interval_s / 3600
    title = f"{noise.channel} in run '{noise.run}': {noise.samples} samples over {hours:.3g} h{missing}"
    head = ("noise term", "estimate", "sd", f"{percent} interval", "unit")
    rows = [_row(term, noise.kind) for term in noise.terms]
    if noise.correlation_time_s is not None and noise.of(NoiseTerm.MARKOV).determined:
        value, sd = rounded((noise.correlation_time_s, noise.correlation_time_sd_s), noise.correlation_time_sd_s)
        place = next(k for k, term in enumerate(noise.terms) if term.term is NoiseTerm.MARKOV) + 1
        rows.insert(place, cells("Gauss–Markov T", value, sd, "", "s"))
    return Sheet(title, head, rows, (0, 4), "", "")


def _row(term: TermRecord, kind: str) -> tuple[Cell, ...]:
    name = _name(term.term, kind)
    unit = density_unit(term.unit)
    if not term.determined:
        limit = "not determined" if term.upper_limit is None or term.withheld else f"< {significant(term.upper_limit)}"
        return tuple(Cell(text, "dim") for text in (name, "–", "–", limit, unit))
    value, sd, low, high = rounded((term.value, term.sd, term.low, term.high), term.sd)
    return cells(name, value, sd, f"{low} … {high}", unit)


def _warnings(noise: ChannelNoise) -> Iterator[str]:
    """Yield a sentence for each finding beside the noise, each cause for which terms are withheld, and what is open."""
    yield from _left_out(noise)
    yield from _not_as_described(noise)
    for cause in dict.fromkeys(term.withheld for term in noise.terms if term.withheld):
        names = [_name(term.term, noise.kind) for term in noise.terms if term.withheld is cause]
        named = (
            "no term is" if len(names) == len(noise.terms) else f"{', '.join(names)} {'are' if names[1:] else 'is'} not"
        )
        yield f"{named} determined: {withheld_because(noise, cause)}"
    if noise.undecided:
        names = " or ".join(_name(term, noise.kind) for term in noise.undecided)
        yield f"the record needs {names}, but does not show which. A longer record would."
    for term, other in noise.alternatives:
        one, instead = _name(other, noise.kind), _name(term, noise.kind)
        yield f"the record is described equally well with {one} in place of {instead}."


def write_noise(
    folder: Path,
    noise: StaticNoise,
    sample_rate: float | None = None,
    densities: Mapping[str, NoiseDensity] | None = None,
) -> list[Path]:
    """Write the record, kalibr's `imu.yaml`, priors if there are any, and a figure of each record; return the files."""
    write_text(folder / NOISE_FILE, noise.json_text())
    written = [folder / NOISE_FILE]
    if densities:
        rate = sample_rate or 1 / min(channel.interval_s for channel in noise.channels)
        write_text(folder / KALIBR_FILE, noise_yaml(densities, rate, f"campaign '{noise.campaign}'"))
        written.append(folder / KALIBR_FILE)
    if any(has_priors(channel) for channel in noise.channels):
        write_text(folder / PRIORS_FILE, priors_text(noise, sample_rate))
        written.append(folder / PRIORS_FILE)
    else:
        (folder / PRIORS_FILE).unlink(missing_ok=True)  # of an earlier call: it would be taken for this one's
    for run in dict.fromkeys(channel.run for channel in noise.channels):
        drawn = allan_figure([channel for channel in noise.channels if channel.run == run])
        plain = "".join(letter if letter.isalnum() or letter in "-_." else "_" for letter in run)
        written.append(drawn.save(folder / f"allan-{plain}.png"))
    return written
