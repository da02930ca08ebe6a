"""What a static record holds beside noise, and why terms are withheld, in sentences."""

import math

from imubayes.display.labels import pretty
from imubayes.display.rounding import significant
from imubayes.noise_analysis.described_band import Cause, Gap
from imubayes.noise_analysis.noise_record import ChannelNoise
from imubayes.noise_analysis.noise_spectra import NoiseTerm

_COARSE = 0.1  # part of rounding in the variance of samples from which it is told
_MOST_LINES = 5


def beside_noise(noise: ChannelNoise) -> list[str]:
    """Return a sentence for each finding."""
    return [
        *_of_repetition(noise), *_of_outliers(noise), *_of_temperature(noise), *_of_lines(noise), *_of_change(noise),
        *_of_filter(noise), *_of_gaps(noise), *_of_levels(noise), *_of_rounding(noise),
    ]  # fmt: skip


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
            f"filter look the same. Of a filter, N is {low}."
        )
    return _REASONS[cause]


_REASONS = {
    Cause.CONVERGENCE: "the estimate did not converge. Give a part of the record without disturbances.",
    Cause.UNDESCRIBED: "the noise terms do not describe the spectrum. Give a part of the record without disturbances.",
    Cause.FILTER: "a filter shapes the frequencies that would tell. Give a log without it, or a longer record.",
    Cause.DRIFT: "low frequencies are not those of noise. Give a settled part of the record, or a temperature_degC.",
    Cause.CHANGE: "low frequencies hold the change. Give a settled part of the record.",
    Cause.DISTURBANCE: "the tails of the disturbance reach over the spectrum. Give a part of the record without it.",
    Cause.REPETITION: "the log is too coarse to tell repeated values from equal ones. Give the sensor's own log.",
    Cause.ROUNDING: (
        "the noise is below half a step of the log and not rounded at random, so that its spectrum is not that of the "
        "sensor. Give a log of finer steps."
    ),
    Cause.AMBIGUOUS: "a Gauss–Markov process and a low-pass filter look the same.",
}


def density_unit(unit: str) -> str:
    """Return the unit of a noise term for display, with √h and √Hz."""
    return pretty(unit).replace("sqrt(h)", "√h").replace("sqrt(Hz)", "√Hz")


def _of_repetition(noise: ChannelNoise) -> list[str]:
    found = noise.repetition
    if found is None:
        return []
    times = f"{found.mean:.3g}" if found.shortest == found.longest else f"{found.shortest} to {found.longest}"
    told = f"each value is repeated {times} times: the output is new every {significant(found.interval_s)} s."
    return [f"{told} The record is taken at that rate."]


def _of_outliers(noise: ChannelNoise) -> list[str]:
    found = noise.outliers
    if found is None:
        return []
    many = "an outlier is" if found.count == 1 else f"{found.count} outliers are"
    size = f"{found.size:.3g} {pretty(noise.output_unit)}"
    return [f"{many} left out; the largest is {size} off at {found.time_s:.6g} s."]


def _of_temperature(noise: ChannelNoise) -> list[str]:
    found = noise.temperature
    if found is None:
        return []
    slope = f"{found.slope:.3g} ± {found.sd:.1g} {pretty(noise.output_unit)} per K"
    return [f"the output follows temperature_degC, by {slope}; this is taken out before the noise."]


def _of_lines(noise: ChannelNoise) -> list[str]:
    if not noise.lines:
        return []
    named = [
        f"{line.frequency_hz:.5g} Hz (amplitude {line.amplitude:.3g} ± {line.amplitude_sd:.1g})"
        for line in noise.lines[:_MOST_LINES]
    ]
    more = len(noise.lines) - len(named)
    listed = f"{', '.join(named)} {pretty(noise.output_unit)}" + (f" and {more} more" if more else "")
    word = "a line" if len(noise.lines) == 1 else "lines"
    return [f"the spectrum has {word} at {listed}, taken out before the fit."]


def _of_change(noise: ChannelNoise) -> list[str]:
    change = noise.sudden_change
    if change is None:
        return []
    size = f"{change.change:.3g} {pretty(noise.output_unit)}"
    return [
        f"at {change.time_s:.6g} s the output changes by {size} from one mean over {change.tau_s:.3g} s to the next, "
        f"{change.ratio:.0f} times the scatter of such changes: a step or a transient, not noise."
    ]


def _of_filter(noise: ChannelNoise) -> list[str]:
    cut = next((gap for gap in noise.gaps if gap.cause is Cause.FILTER), None)
    if cut is None and noise.roll_off is None:
        return []
    told = "a filter shapes the spectrum: "
    if cut is not None:
        tau = significant(noise.shortest_tau_s)
        return [f"{told}frequencies above {cut.low_hz:.3g} Hz are left out, as with --shortest-tau {tau}."]
    assert noise.roll_off is not None
    lost = -10 * noise.roll_off.attenuation / math.log(10)
    return [f"{told}its power is {lost:.2g} dB at {noise.roll_off.frequency_hz:.3g} Hz. N is that of low frequencies."]


def _of_gaps(noise: ChannelNoise) -> list[str]:
    return [_gap_text(gap) for gap in noise.gaps if gap.cause is not Cause.FILTER]


def _gap_text(gap: Gap) -> str:
    what = "a drift or a transient" if gap.cause is Cause.DRIFT else "a vibration or a disturbance"
    span = (
        f"below {gap.high_hz:.3g} Hz" if gap.cause is Cause.DRIFT else f"from {gap.low_hz:.3g} to {gap.high_hz:.3g} Hz"
    )
    return f"the noise terms do not describe the spectrum {span}, left out of the fit: {what} may shape it."


def _of_levels(noise: ChannelNoise) -> list[str]:
    if noise.unequal_levels <= 1:
        return []
    return [
        f"the level of noise scatters {noise.unequal_levels:.2g} times as much over the record as Gaussian noise of "
        "one level does: it changes, or has heavy tails. The interval of N is as much wider."
    ]


def _of_rounding(noise: ChannelNoise) -> list[str]:
    share = noise.rounding_share
    if share < _COARSE or noise.of(NoiseTerm.QUANTISATION).determined:
        return []
    part = "is taken out of N" if noise.rounding_removed else "is part of N"
    return [
        f"the log has steps of {noise.resolution_in_output_units:.3g} {pretty(noise.output_unit)}. Rounding to them "
        f"makes {min(share, 1.0):.0%} of the variance of single samples, and {part}."
    ]
