"""Disturbances of a record are found, named and kept out of the terms; noise is not taken for them."""

import numpy as np
import pytest
import static_record as generator
from scipy.signal import butter, lfilter

from imubayes_recordings.noise_analysis.allan_deviation import allan_variance
from imubayes_recordings.noise_analysis.described_band import Cause, DescribedBand
from imubayes_recordings.noise_analysis.noise_terms import NoiseTerm
from imubayes_recordings.noise_analysis.record_examination import (
    Examination,
    at_own_rate,
    examined,
    unequal_levels,
    widened,
    without_rounding,
    without_temperature,
)
from imubayes_recordings.noise_analysis.running_sum import from_samples
from imubayes_recordings.noise_analysis.spectral_lines import without_lines
from imubayes_recordings.noise_analysis.term_estimates import NoiseEstimate, TermEstimate, estimate_terms

STEP, SAMPLES = 0.01, 60_000
TIME = STEP * np.arange(SAMPLES)


def white(seed: int, samples: int = SAMPLES) -> np.ndarray:
    """Unit samples: N = 0.1."""
    return np.random.default_rng([90, seed]).normal(size=samples)


def rounded(x: np.ndarray, step: float) -> np.ndarray:
    return np.round(x / step) * step if step else x


def held(kind: str, x: np.ndarray) -> np.ndarray:
    random = np.random.default_rng(91)
    if kind == "constant":
        return np.repeat(x[: len(x) // 4], 4)
    if kind == "irregular":
        return np.repeat(x[: len(x) // 4], random.integers(3, 6, len(x) // 4))
    return x[np.floor(np.arange(len(x)) / 3.6).astype(int)]  # two clocks


@pytest.mark.parametrize("step", [0.0, 0.1])
@pytest.mark.parametrize("kind", ["constant", "irregular", "beating"])
def test_repeated_values_are_taken_at_their_rate(kind: str, step: float):
    record, repetition = at_own_rate(from_samples(held(kind, rounded(white(1), step)), STEP))
    assert repetition is not None
    assert repetition.counted
    mean = 3.6 if kind == "beating" else 4.0
    assert repetition.mean == pytest.approx(mean, rel=0.005)
    assert record.interval == pytest.approx(mean * STEP, rel=0.005)
    assert np.std(record.values(0, record.samples)) == pytest.approx(1.0, abs=0.025)


def test_missing_samples_do_not_break_a_repetition():
    x = held("constant", white(2))
    x[np.random.default_rng(92).uniform(size=len(x)) < 0.01] = np.nan
    x[5000:6002] = np.nan
    _, repetition = at_own_rate(from_samples(x, STEP))
    assert repetition is not None
    assert repetition.mean == pytest.approx(4.0, rel=0.002)


@pytest.mark.parametrize("step", [0.0, 0.1, 0.5, 1.0, 3.0])
def test_coarse_logs_and_slow_noise_are_no_repetition(step: float):
    x = white(3)
    noises = {
        "white": x,
        "smooth": np.convolve(x, np.ones(8) / 3, "same"),
        "walk": 0.1 * np.cumsum(x) + 0.1 * white(4),
        "slope": np.linspace(0, 50, SAMPLES) + 0.05 * x,
        "louder": x * np.where(TIME < 300, 0.05, 2.0),
    }
    found = [name for name, noise in noises.items() if at_own_rate(from_samples(rounded(noise, step), STEP))[1]]
    assert found == []
    assert at_own_rate(from_samples(np.clip(rounded(x, step), -1, 1), STEP))[1] is None  # at its ends half of the time


def test_lines_are_found_with_frequency_and_amplitude():
    x = white(5) + 0.2 * np.sin(2 * np.pi * 7.3 * TIME) + 0.1 * np.sin(2 * np.pi * 14.6 * TIME)
    cleaned, lines = without_lines(from_samples(x, STEP))
    assert [line.frequency_hz for line in lines] == pytest.approx([7.3, 14.6], abs=2e-3)
    for line, amplitude in zip(lines, (0.2, 0.1), strict=True):
        assert abs(line.amplitude - amplitude) < 4 * line.amplitude_sd
        assert line.amplitude_sd < 0.02
    assert np.var(cleaned.values(0, SAMPLES)) == pytest.approx(1.0, abs=0.02)


def test_noise_has_no_lines():
    """One false line in a thousand records is promised; three in sixty have a chance of 4e-5."""
    random = np.random.default_rng(93)
    found = 0
    for number in range(60):
        x = random.normal(size=20_000)
        x = [
            x,
            np.convolve(x, [1, 1, 1, 1], "same"),
            x + 0.05 * np.cumsum(random.normal(size=len(x))),
            rounded(x, 2.0),
        ][number % 4]
        found += bool(without_lines(from_samples(x, STEP))[1])
    assert found <= 2


def examination(x: np.ndarray, shortest_tau: float = 0.0) -> tuple[Examination, DescribedBand, NoiseEstimate]:
    seen = examined(from_samples(x, STEP))
    band = seen.band(shortest_tau)
    return seen, band, estimate_terms(band.likelihood)


def white_of(x: np.ndarray) -> tuple[TermEstimate, DescribedBand, dict[NoiseTerm, Cause]]:
    seen, band, estimate = examination(x)
    growth = unequal_levels(seen.cleaned, band.likelihood, estimate.full)
    growth *= band.roll_off.growth if band.roll_off else 1.0
    found, _ = without_rounding(widened(estimate.of(NoiseTerm.WHITE), growth), estimate, seen.own_rate)
    return found, band, seen.withheld(band, estimate, 0.0)


FILTERS = {
    "two taps": lambda x: np.convolve(x, [1, 0.163], "same") / 1.163,
    "mean of four": lambda x: np.convolve(x, np.ones(4) / 4, "same"),
    "Butterworth": lambda x: lfilter(*butter(2, 0.2), x),
    "Butterworth in steps": lambda x: rounded(np.asarray(lfilter(*butter(2, 0.2), x)), 0.2),
}


@pytest.mark.parametrize(
    "name", [pytest.param(one, marks=pytest.mark.slow) if "steps" in one else one for one in FILTERS]
)
def test_white_noise_behind_a_filter_is_that_of_low_frequencies(name: str):
    found, band, withheld = white_of(np.asarray(FILTERS[name](white(6))))
    assert band.filtered
    assert withheld.keys() == {NoiseTerm.QUANTISATION}
    assert abs(np.log(found.value / 0.1)) < 3.5 * found.sd / found.value
    assert found.sd < 0.006
    if gap := band.cut(Cause.FILTER):
        assert gap.high_hz >= 50.0


@pytest.mark.slow
def test_the_faint_end_of_a_filter_is_no_quantisation_noise():
    """Below 5 Hz two taps take 3 % of the power: a filter too strong, and quantisation noise for the difference."""
    wrong = 0
    for seed in range(40, 46):
        x = np.convolve(white(seed), [1, 0.163], "same") / 1.163
        seen, band, estimate = examination(x, 0.1)
        withheld = seen.withheld(band, estimate, 0.0)
        wrong += estimate.of(NoiseTerm.QUANTISATION).determined and NoiseTerm.QUANTISATION not in withheld
    assert wrong == 0


@pytest.mark.slow
def test_white_noise_has_no_filter():
    """Beyond 1e-4 a record; faint attenuation only widens the interval."""
    assert not any(white_of(white(seed, 20_000))[1].filtered for seed in range(20, 32))


@pytest.mark.slow
def test_a_slow_filter_is_no_gauss_markov_process():
    """A first-order low-pass filter of 20 samples, in steps whose rounding is the white noise above."""
    x = rounded(np.asarray(lfilter([0.05], [1, -0.95], white(7))), 0.1)
    _, _, withheld = white_of(x)
    assert withheld[NoiseTerm.WHITE] is Cause.AMBIGUOUS
    assert withheld[NoiseTerm.MARKOV] is Cause.AMBIGUOUS


@pytest.mark.parametrize("shortest_tau", [0.0, 0.1])
def test_a_wandering_line_is_neither_quantisation_nor_gauss_markov_noise(shortest_tau: float):
    phase = 2 * np.pi * 0.73 * TIME + np.cumsum(0.01 * white(8))
    seen, _, estimate = examination(white(9) + 0.4 * np.sin(phase), shortest_tau)
    assert [round(line.frequency_hz, 1) for line in seen.lines] == [0.7]
    assert estimate.determined == (NoiseTerm.WHITE,)
    assert abs(estimate.of(NoiseTerm.WHITE).value - 0.1) < 3.5 * estimate.of(NoiseTerm.WHITE).sd


@pytest.mark.parametrize(
    ("wander", "amplitude", "stated"),
    [(0.01, 0.3, True), (0.05, 1.0, False), pytest.param(0.15, 1.0, False, marks=pytest.mark.slow)],
)
def test_the_tails_of_a_peak_are_not_in_what_is_stated(wander: float, amplitude: float, stated: bool):
    """The phase of a vibration wanders: the record without it has the white noise of all but its band."""
    for seed in range(30, 33):
        x = white(seed) + amplitude * np.sin(2 * np.pi * 12 * TIME + np.cumsum(wander * white(100 + seed)))
        found, _, withheld = white_of(x)
        assert (NoiseTerm.WHITE not in withheld) is stated
        assert abs(found.value - 0.1) < 3.5 * found.sd or not stated


def test_no_lines_are_found_at_the_ends_of_a_band_that_is_taken_out():
    x = white(13) + 2 * np.sin(2 * np.pi * 0.73 * TIME + np.cumsum(0.02 * white(14)))
    _, lines = without_lines(from_samples(x, STEP))
    assert len(lines) == 1
    assert abs(lines[0].amplitude - 2) < 4 * lines[0].amplitude_sd
    assert lines[0].high_hz < 2


def test_a_disturbance_that_is_no_line_withholds():
    """Its tails raise the spectrum over all octaves."""
    x = white(10) + 5 * np.sin(2 * np.pi * 5 * TIME + np.cumsum(0.2 * white(11)))
    found, _, withheld = white_of(x)
    assert NoiseTerm.WHITE in withheld or found.low <= 0.1 <= found.high


def test_noise_that_grows_louder_is_told():
    for x, equal in ((white(12), True), (white(12) * np.where(TIME < 300, 1.0, 1.5), False)):
        seen, band, estimate = examination(x)
        assert (unequal_levels(seen.cleaned, band.likelihood, estimate.full) == 1.0) is equal


def test_drift_with_temperature_is_told_from_random_walks():
    step, samples = 0.1, 20_000
    time = step * np.arange(samples)
    random = np.random.default_rng(94)
    for number in range(12):
        walk = generator.noise({"white": 1.0, "random_walk": 0.05}, samples, step, random)
        temperature = 25 + 3 * np.sin(2 * np.pi * 2.3 * time / time[-1] + number)
        recorded = from_samples(temperature, step)
        assert without_temperature(from_samples(walk, step), recorded)[1] is None
        drift = without_temperature(from_samples(walk + 1.5 * temperature, step), recorded)[1]
        assert drift is not None
        assert abs(drift.slope - 1.5) < 4 * drift.sd


def test_stretches_without_rest_are_left_out_on_request():
    """Bursts of twenty times the noise and pushes of the mean; flicker noise beside them stays."""
    generator = np.random.default_rng(8)
    samples = 200_000
    quiet = generator.normal(size=samples) + 0.02 * np.cumsum(generator.normal(size=samples))
    loud = quiet.copy()
    for start in (30_000, 90_000, 150_500):
        loud[start : start + 800] += 20 * generator.normal(size=800)
    loud[120_000:121_000] += 60.0
    record = from_samples(loud, 0.01)
    assert examined(record).contamination is None
    seen = examined(record, robust=True)
    found = seen.contamination
    assert found is not None
    assert found.count == 4
    assert 0.015 < found.share < 0.035
    assert float(allan_variance(seen.cleaned).variance[0]) == pytest.approx(1.0, rel=0.02)
    assert float(allan_variance(record).variance[0]) > 3.0
    # A quiet record loses nothing, nor does one that drifts.
    assert examined(from_samples(quiet, 0.01), robust=True).contamination is None
