"""The noise terms by likelihood: variances of the coefficients, recovery, limits, and planted faults."""

import math

import numpy as np
import pytest
import static_record as generator
from scipy.fft import dct

from imubayes_recordings.noise_analysis.allan_deviation import allan_variance
from imubayes_recordings.noise_analysis.cosine_spectra import cosine_statistics, removed_shares
from imubayes_recordings.noise_analysis.described_band import Octave, octave_fits
from imubayes_recordings.noise_analysis.likelihood import NoiseLikelihood
from imubayes_recordings.noise_analysis.noise_terms import Averages, NoiseTerm, allan_shape, coefficient_variance
from imubayes_recordings.noise_analysis.running_sum import from_samples
from imubayes_recordings.noise_analysis.term_estimates import NoiseEstimate, estimate_terms

TERMS = (NoiseTerm.WHITE, NoiseTerm.QUANTISATION, NoiseTerm.RANDOM_WALK, NoiseTerm.FLICKER, NoiseTerm.MARKOV)
STEP, TIME = 0.5, 7.0


def covariance(term: NoiseTerm, samples: int) -> np.ndarray:
    """The covariance of samples from the definition of each process; of flicker up to a constant."""
    i = np.arange(samples)
    if term is NoiseTerm.WHITE:
        return np.eye(samples) / STEP
    if term is NoiseTerm.QUANTISATION:
        difference = np.eye(samples, samples + 1, 1) - np.eye(samples, samples + 1)
        return difference @ difference.T / STEP**2
    if term is NoiseTerm.RANDOM_WALK:
        return STEP * (np.minimum(i[:, None], i[None, :]) + 1.0)
    lag = np.abs(i[:, None] - i[None, :])
    if term is NoiseTerm.MARKOV:
        return np.exp(-lag * STEP / TIME)
    # The spectrum 1/(2 sin(ω/2)) integrated numerically, 1 − cos(lω) of it.
    omega = (np.arange(200_000) + 0.5) * np.pi / 200_000
    variogram = [float(np.mean((1 - np.cos(k * omega)) / (2 * np.sin(omega / 2)))) for k in range(samples)]
    return -np.array(variogram)[lag]


@pytest.mark.parametrize("term", TERMS)
@pytest.mark.parametrize(("count", "block"), [(40, 1), (50, 6)])
def test_variances_of_coefficients_are_exact(term: NoiseTerm, count: int, block: int):
    average = np.kron(np.eye(count), np.full((1, block), 1 / block))
    basis = dct(np.eye(count), type=2, norm="ortho", axis=0)[1:] @ average
    expected = np.diag(basis @ covariance(term, count * block) @ basis.T)
    found = coefficient_variance(term, Averages(count, block, STEP), TIME)
    np.testing.assert_allclose(found, expected, rtol=1e-5)


@pytest.mark.parametrize(("samples", "limit"), [(120, 1 << 14), (120, 20)])
def test_shares_of_removed_bands_are_exact(monkeypatch: pytest.MonkeyPatch, samples: int, limit: int):
    """From the covariance of white noise without two bands of frequency, an integral over what is left."""
    monkeypatch.setattr("imubayes_recordings.noise_analysis.cosine_spectra._MOST_MEANS", limit)
    bands = [(0.2, 0.3), (0.7, 0.72)]
    statistics = cosine_statistics(from_samples(np.random.default_rng(12).normal(size=samples), STEP))
    frequency = (np.arange(200_000) + 0.5) / 200_000  # up to 1/(2 STEP) = 1 Hz
    kept = np.all([(frequency < low) | (frequency > high) for low, high in bands], axis=0)
    lags = [float(np.mean(kept * np.cos(2 * np.pi * frequency * k * STEP))) for k in range(samples)]
    i = np.arange(samples)
    filtered = np.array(lags)[np.abs(i[:, None] - i[None, :])]
    block = statistics.block
    expected = []
    if block > 1:
        basis = dct(np.eye(block), type=2, norm="ortho", axis=0)[1:]
        expected.append(1 - np.diag(basis @ filtered[:block, :block] @ basis.T))
    count = samples // block
    basis = dct(np.eye(count), type=2, norm="ortho", axis=0)[1:] @ np.kron(
        np.eye(count), np.full((1, block), 1 / block)
    )
    single = 1 - block * np.diag(basis @ filtered[: count * block, : count * block] @ basis.T)
    level = statistics.coarse[0]
    expected.append(np.add.reduceat(single, level.first - 1) / level.count)
    for found, exact in zip(removed_shares(statistics, bands), expected, strict=True):
        np.testing.assert_allclose(found, exact, atol=1e-4)


@pytest.mark.parametrize("term", [*TERMS, NoiseTerm.RAMP])
def test_allan_variances_are_those_of_simulated_noise(term: NoiseTerm):
    """Means over 300 records; flicker and Gauss–Markov noise at averaging times of many samples."""
    random = np.random.default_rng(11)
    found, samples = [], 1024
    for _ in range(300):
        if term is NoiseTerm.MARKOV:
            x = gauss_markov(samples, 0.5, TIME, random)
        else:
            x = generator.noise({"white": 0.0, str(term): 1.0}, samples, 0.5, random)
        found.append(allan_variance(from_samples(x, 0.5)).variance)
    tau = 0.5 * 2.0 ** np.arange(len(found[0]))
    fine = (tau > 3) & (tau < 70)
    np.testing.assert_allclose(np.mean(found, axis=0)[fine], allan_shape(term, tau, TIME)[fine], rtol=0.12)


def gauss_markov(samples: int, step: float, time: float, random: np.random.Generator) -> np.ndarray:
    correlation, x = math.exp(-step / time), random.normal(size=samples)
    for k in range(1, samples):
        x[k] = correlation * x[k - 1] + math.sqrt(1 - correlation**2) * x[k]
    return x


def estimated(x: np.ndarray, step: float) -> NoiseEstimate:
    return estimate_terms(NoiseLikelihood(cosine_statistics(from_samples(x, step))))


ALL_THREE = {"white": 0.1, "flicker": 0.02, "random_walk": 2e-3}


def record(seed: int, terms: dict[str, float], samples: int = 200_000, step: float = 0.05) -> np.ndarray:
    return generator.noise(terms, samples, step, np.random.default_rng(seed))


def test_white_flicker_and_random_walk_are_recovered():
    found = [estimated(record(seed, ALL_THREE), 0.05) for seed in range(100, 104)]
    inside = []
    for estimate in found:
        assert estimate.full.converged
        for name, truth in ALL_THREE.items():
            term = estimate.of(NoiseTerm(name))
            assert term.determined
            assert abs(term.value - truth) < 4 * term.sd
            inside.append(term.low <= truth <= term.high)
        for term in (NoiseTerm.QUANTISATION, NoiseTerm.MARKOV, NoiseTerm.RAMP):
            assert not estimate.of(term).determined
    assert np.mean(inside) >= 0.8


def test_a_level_that_the_model_ignores_shows():
    """The planted fault: a tone at 1.7 Hz is no term of the model, and the fit of its octave says so."""
    x = record(1, {"white": 0.1}, 60_000)
    tone = x + 0.5 * np.sin(2 * np.pi * 1.7 * 0.05 * np.arange(len(x)))
    clean, spoilt = (octaves(each, 0.05) for each in (x, tone))
    assert min(octave.p_value for octave in clean) > 1e-3
    assert next(octave for octave in spoilt if octave.low_hz <= 1.7 <= 1.03 * octave.high_hz).p_value < 1e-6


def octaves(x: np.ndarray, step: float) -> list[Octave]:
    likelihood = NoiseLikelihood(cosine_statistics(from_samples(x, step)))
    return octave_fits(likelihood, estimate_terms(likelihood).full)


def test_white_noise_alone_gives_limits_for_all_else():
    estimate = estimated(record(2, {"white": 1.0}, 50_000), 0.05)
    assert estimate.determined == (NoiseTerm.WHITE,)
    for term in (NoiseTerm.QUANTISATION, NoiseTerm.FLICKER, NoiseTerm.RANDOM_WALK, NoiseTerm.RAMP):
        found = estimate.of(term)
        assert not found.determined
        assert 0 < found.limit < math.inf
    assert estimate.of(NoiseTerm.FLICKER).limit < 0.1


def test_quantisation_and_a_ramp_are_told_from_noise():
    truth = {"white": 1.0, "quantisation": 0.3, "ramp": 1e-3}
    estimate = estimated(record(3, truth, 100_000, 0.1), 0.1)
    assert set(estimate.determined) == {NoiseTerm.WHITE, NoiseTerm.QUANTISATION}
    for name, value in truth.items():
        found = estimate.of(NoiseTerm(name))
        assert found.determined
        assert abs(found.value - value) < 3.5 * found.sd


def test_a_gauss_markov_process_is_told_from_flicker():
    random = np.random.default_rng(4)
    x = 0.3 * gauss_markov(40_000, 0.5, 100.0, random) + math.sqrt(2) * random.normal(size=40_000)
    estimate = estimated(x, 0.5)
    assert set(estimate.determined) == {NoiseTerm.WHITE, NoiseTerm.MARKOV}
    found = estimate.of(NoiseTerm.MARKOV)
    assert abs(found.value - 0.3) < 3 * found.sd
    assert abs(estimate.correlation_time - 100.0) < 3 * estimate.correlation_time_sd


def test_missing_samples_do_not_change_what_is_found():
    """Single samples and a gap of five minutes are missing; the noise of what is left is what it was."""
    x = record(5, ALL_THREE)
    random = np.random.default_rng(6)
    x[random.uniform(size=len(x)) < 0.003] = np.nan
    x[90_000:96_000] = np.nan
    estimate = estimated(x, 0.05)
    for name, truth in ALL_THREE.items():
        found = estimate.of(NoiseTerm(name))
        assert abs(found.value - truth) < 3.5 * found.sd


def test_gaps_read_as_zero_would_show():
    """The planted fault of the test above."""
    x = record(5, {"white": 0.1}, 60_000) + 5.0
    x[np.random.default_rng(6).uniform(size=len(x)) < 0.003] = 0.0
    found = estimated(x, 0.05).of(NoiseTerm.WHITE)
    assert abs(found.value - 0.1) > 10 * found.sd


@pytest.mark.slow
def test_blocks_and_single_coefficients_agree(monkeypatch: pytest.MonkeyPatch):
    """The two levels use the same information as one cosine transform of the whole record."""
    x = record(7, ALL_THREE, 65_536, 0.1)
    monkeypatch.setattr("imubayes_recordings.noise_analysis.cosine_spectra._MOST_MEANS", 65_536)
    whole = estimated(x, 0.1)
    monkeypatch.setattr("imubayes_recordings.noise_analysis.cosine_spectra._MOST_MEANS", 1024)
    cut = estimated(x, 0.1)
    for name in ALL_THREE:
        one, other = whole.of(NoiseTerm(name)), cut.of(NoiseTerm(name))
        assert other.determined == one.determined
        if one.determined:
            assert other.value == pytest.approx(one.value, abs=0.7 * one.sd)
            assert other.sd == pytest.approx(one.sd, rel=0.25)
        else:
            assert other.limit == pytest.approx(one.limit, rel=0.25)


def test_the_gradient_is_that_of_the_likelihood():
    likelihood = NoiseLikelihood(cosine_statistics(from_samples(record(8, ALL_THREE, 4000), 0.05)))
    terms = (NoiseTerm.WHITE, NoiseTerm.FLICKER, NoiseTerm.RANDOM_WALK, NoiseTerm.MARKOV)
    at = likelihood.start(terms, 3.0)
    _, gradient, _ = likelihood._expansion(terms, at)
    for place in range(len(at)):
        step = np.zeros(len(at))
        step[place] = 1e-5
        ends = [likelihood._expansion(terms, at + sign * step)[0] for sign in (-1, 1)]
        assert gradient[place] == pytest.approx((ends[1] - ends[0]) / 2e-5, rel=1e-4, abs=1e-4)


def test_a_correlation_time_far_below_a_block_is_white_noise():
    """Also if the exponential of a whole block would overflow; warnings are errors here."""
    found = coefficient_variance(NoiseTerm.MARKOV, Averages(20, 1024, 1.0), 0.5)
    np.testing.assert_allclose(found, (1 + 2 / np.expm1(2.0)) / 1024, rtol=2e-3)
