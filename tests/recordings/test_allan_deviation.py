"""The overlapping Allan deviation and its intervals, against allantools and against the definition."""

import json
import tracemalloc
from collections.abc import Iterator

import numpy as np
import pytest
import reference_series

from imubayes.campaign.run_tables import RowBatch
from imubayes.foundations.errors import InputError
from imubayes_recordings.noise_analysis.allan_deviation import (
    AllanVariance,
    allan_variance,
    chi_square_interval,
    equivalent_degrees,
)
from imubayes_recordings.noise_analysis.running_sum import CHUNK, from_samples, running_sums

REFERENCE = json.loads(reference_series.FILE.read_text())
EXPONENTS = reference_series.EXPONENTS


def by_definition(x: np.ndarray, factor: int) -> float:
    """Half the mean square difference of the means over all neighbouring spans."""
    means = np.array([x[i : i + factor].mean() for i in range(len(x) - factor + 1)])
    return float(np.mean((means[factor:] - means[:-factor]) ** 2) / 2)


def test_deviations_are_those_of_allantools():
    found = allan_variance(from_samples(reference_series.series(), 1 / reference_series.RATE))
    assert found.factor.tolist() == REFERENCE["factor"]
    assert found.terms.tolist() == REFERENCE["terms"]
    np.testing.assert_allclose(np.sqrt(found.variance), REFERENCE["deviation"], rtol=1e-10)


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_intervals_are_those_of_allantools(exponent: int):
    found = allan_variance(from_samples(reference_series.series(), 1 / reference_series.RATE))
    low, high, degrees = found.interval(np.full(len(found.tau), exponent), 0.95)
    known = np.array([edf is not None for edf in REFERENCE["degrees"][str(exponent)]])
    assert known.sum() >= len(known) - 1  # allantools lacks the case of two spans of quantisation noise
    expected = [edf for edf in REFERENCE["degrees"][str(exponent)] if edf is not None]
    np.testing.assert_allclose(degrees[known], expected, rtol=1e-10)
    ends = np.array([pair for pair in REFERENCE["interval"][str(exponent)] if pair is not None])
    np.testing.assert_allclose(low[known], ends[:, 0], rtol=1e-10)
    np.testing.assert_allclose(high[known], ends[:, 1], rtol=1e-10)


def test_deviations_are_those_of_the_definition():
    x = reference_series.series(400)
    found = allan_variance(from_samples(x, 1.0))
    expected = [by_definition(x, int(m)) for m in found.factor]
    np.testing.assert_allclose(found.variance, expected, rtol=1e-10)


def test_chunks_join_without_a_seam(monkeypatch: pytest.MonkeyPatch):
    x = reference_series.series(2000)
    whole = allan_variance(from_samples(x, 1.0))
    monkeypatch.setattr("imubayes_recordings.noise_analysis.allan_deviation.CHUNK", 37)
    np.testing.assert_allclose(allan_variance(from_samples(x, 1.0)).variance, whole.variance, rtol=1e-12)


@pytest.mark.parametrize("exponent", [0, -2])
def test_the_degrees_of_freedom_are_those_of_simulated_records(exponent: int):
    """Twice the squared mean of the Allan variance over its variance, over 4000 records of 128 samples."""
    random = np.random.default_rng(3)
    x = random.normal(size=(4000, 128))
    x = np.cumsum(x, axis=1) if exponent == -2 else x
    total = np.concatenate([np.zeros((4000, 1)), np.cumsum(x, axis=1)], axis=1)
    # The source smooths the phase over a sampling interval, which shows at the shortest averaging times.
    for factor in (16, 32):
        variance = np.mean(
            (total[:, 2 * factor :] - 2 * total[:, factor:-factor] + total[:, : -2 * factor]) ** 2, axis=1
        )
        seen = 2 * variance.mean() ** 2 / variance.var()
        assert equivalent_degrees(exponent, factor, 129) == pytest.approx(seen, rel=0.12)


def test_two_spans_of_quantisation_noise():
    """White phase: differences a span apart share two phases of three."""
    random = np.random.default_rng(4)
    phase = random.normal(size=(6000, 97))
    variance = np.mean((phase[:, 80:] - 2 * phase[:, 40:-40] + phase[:, :-80]) ** 2, axis=1)
    assert equivalent_degrees(2, 40, 97) == pytest.approx(2 * variance.mean() ** 2 / variance.var(), rel=0.1)


def test_an_interval_covers_as_often_as_it_says():
    random = np.random.default_rng(5)
    x = random.normal(size=(600, 256))
    inside = 0
    for row in x:
        found = allan_variance(from_samples(row, 1.0))
        at = int(np.flatnonzero(found.factor == 16)[0])
        low, high, _ = found.interval(np.zeros(len(found.tau)), 0.95)
        inside += low[at] <= 0.25 <= high[at]
    assert 0.93 <= inside / 600 <= 0.97


def test_wrong_noise_makes_wrong_intervals():
    """The planted fault of the test above: a random walk judged as white noise."""
    random = np.random.default_rng(5)
    inside = 0
    for row in np.cumsum(random.normal(size=(300, 256)), axis=1):
        found = allan_variance(from_samples(row, 1.0))
        at = int(np.flatnonzero(found.factor == 16)[0])
        low, high, _ = found.interval(np.zeros(len(found.tau)), 0.95)
        truth = np.sqrt(16 / 3 + 1 / 96)
        inside += low[at] <= truth <= high[at]
    assert inside / 300 < 0.9


def with_dropouts(share: float, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    x = random.normal(size=50_000)
    return x, np.where(random.uniform(size=len(x)) < share, np.nan, x)


def test_missing_samples_are_left_out():
    whole, broken = with_dropouts(0.01, np.random.default_rng(6))
    broken[20_000:23_000] = np.nan
    full, found = (allan_variance(from_samples(x, 1.0)) for x in (whole, broken))
    assert found.factor.tolist() == full.factor[:-1].tolist()  # none of the longest spans is complete enough
    assert (found.terms < full.terms[:-1]).all()
    low, high, _ = found.interval(np.zeros(len(found.tau)), 0.999)
    assert ((low <= 1 / np.sqrt(found.tau)) & (1 / np.sqrt(found.tau) <= high)).all()


def test_filling_with_zeros_would_show():
    """The planted fault of the test above: 3 + noise with the gaps read as 0."""
    _, broken = with_dropouts(0.01, np.random.default_rng(6))
    found = allan_variance(from_samples(np.nan_to_num(broken + 3.0), 1.0))
    low, high, _ = found.interval(np.zeros(len(found.tau)), 0.999)
    assert not ((low <= 1 / np.sqrt(found.tau)) & (1 / np.sqrt(found.tau) <= high)).all()


def batches(time: np.ndarray, values: np.ndarray, size: int) -> Iterator[RowBatch]:
    for first in range(0, len(time), size):
        part = slice(first, first + size)
        yield RowBatch(first, len(time[part]), {"time_s": time[part], "g": values[part]}, {}, {})


def test_samples_are_placed_by_their_times():
    """A clock that is fast by 100 ppm, jitters by a fifth of a step and loses samples, at the seam of batches too."""
    random = np.random.default_rng(7)
    grid = np.delete(np.arange(20_000), [7, 999, 1000, *range(5000, 5400)])
    time = 50.0 + 0.01 * (1 + 1e-4) * (grid + random.uniform(-0.2, 0.2, len(grid)))
    record = running_sums(batches(time, random.normal(size=len(grid)), 500), ["g"], "log.csv")["g"]
    assert record.samples == 20_000
    assert record.present == len(grid)
    assert record.interval == pytest.approx(0.010001, rel=1e-5)
    assert record.holes is not None
    assert record.holes.start.tolist() == [7, 999, 5000]
    assert record.missing_before(np.array([0, 7, 8, 1000, 1001, 5200, 20_000])).tolist() == [0, 0, 1, 2, 3, 203, 403]


def test_a_record_with_a_gap_far_longer_than_itself_is_refused():
    time = np.concatenate([np.arange(100.0), 1e6 + np.arange(100.0)])
    with pytest.raises(InputError, match="gaps are far longer"):
        running_sums(batches(time, np.ones(200), 50), ["g"], "log.csv")


def test_time_that_stands_still_is_refused():
    with pytest.raises(InputError, match="does not advance"):
        running_sums(batches(np.zeros(10), np.ones(10), 50), ["g"], "log.csv")


def test_memory_does_not_grow_with_the_record():
    """Peaks of Python's allocations at 1 and at 4 million samples; the running sum alone would take 32 MB."""

    def peak(samples: int) -> int:
        def streamed() -> Iterator[RowBatch]:
            random = np.random.default_rng(8)
            for first in range(0, samples, 65536):
                rows = min(65536, samples - first)
                time = 0.01 * (first + np.arange(rows))
                yield RowBatch(first, rows, {"time_s": time, "g": random.normal(size=rows)}, {}, {})

        tracemalloc.start()
        found: AllanVariance = allan_variance(running_sums(streamed(), ["g"], "log")["g"])
        assert len(found.tau) >= 19
        used = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return used

    small, large = peak(1_000_000), peak(4_000_000)
    assert large < 1.1 * small
    assert large < 100 * CHUNK


def test_an_interval_is_that_of_chi_square():
    """NIST SP 1065, 5.3.1: edf 10 at 95 %: χ² quantiles 3.246973 and 20.483177."""
    low, high = chi_square_interval(1.0, 10.0, 0.95)
    assert low == pytest.approx(np.sqrt(10 / 20.483177), rel=1e-6)
    assert high == pytest.approx(np.sqrt(10 / 3.246973), rel=1e-6)
