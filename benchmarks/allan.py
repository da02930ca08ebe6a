"""Allan deviation of a long record: time and deviations against allantools in the same process.

Both get the samples in memory and return overlapping Allan deviations at the same octave averaging times.  Next to it
stand the whole analysis of the record, noise terms with intervals included, and its memory.
"""

import sys
import tracemalloc
from importlib.util import find_spec

import numpy as np
from common import Report, in_words, once, seconds

from imubayes_recordings.noise_analysis.allan_deviation import allan_variance
from imubayes_recordings.noise_analysis.cosine_spectra import cosine_statistics
from imubayes_recordings.noise_analysis.likelihood import NoiseLikelihood
from imubayes_recordings.noise_analysis.running_sum import from_samples
from imubayes_recordings.noise_analysis.term_estimates import estimate_terms

RATE = 100.0
AGREEMENT, RATIO_BAR, MEMORY_BAR = 1e-10, 1.0, 300.0


def measure(quick: bool = False) -> Report:
    if find_spec("allantools") is None:
        # No extra holds it: it asks for Sphinx, which it does not use.
        sys.exit("This benchmark compares with allantools: `pip install --no-deps allantools==2024.6`.")
    report = Report("allan", "Allan deviation of long records")
    sizes = [10**4, 10**5] if quick else [10**5, 10**6, 10**7]
    rows, apart, ratio = [], 0.0, 0.0
    for count in sizes:
        own, other, difference = against_allantools(count)
        apart, ratio = max(apart, difference), own / other
        rows.append([f"{count:.0e}", in_words(own), in_words(other), f"{own / other:.2f}", f"{difference:.1e}"])
    report.table(["samples", "imubayes", "allantools", "ratio", "largest relative difference"], rows)
    report.judge("relative difference of the deviations", apart, AGREEMENT, least=False)
    report.judge("time over that of allantools, longest record", ratio, RATIO_BAR, least=False)
    rows, peak = [], 0.0
    for count in sizes:
        x = record(count)
        taken = once(lambda x=x: whole_analysis(x))
        tracemalloc.start()
        whole_analysis(x)
        peak = tracemalloc.get_traced_memory()[1] / 1e6
        tracemalloc.stop()
        rows.append([f"{count:.0e}", in_words(taken), f"{peak:.0f} MB"])
    report.say("\nRunning sum, Allan deviation and noise terms with intervals; memory beside that of the samples:\n")
    report.table(["samples", "time", "peak memory"], rows)
    report.judge("memory of the longest analysis, MB", peak, MEMORY_BAR, least=False)
    return report


def against_allantools(count: int) -> tuple[float, float, float]:
    """Return the time of either, and the largest relative difference of the deviations."""
    import allantools

    x = record(count)
    factors = [2**k for k in range(40) if 3 * 2**k <= count]
    taus = [factor / RATE for factor in factors]

    def theirs() -> np.ndarray:
        return allantools.oadev(x, rate=RATE, data_type="freq", taus=taus)[1]

    def ours() -> np.ndarray:
        return np.sqrt(allan_variance(from_samples(x, 1 / RATE)).variance)

    difference = float(np.max(np.abs(ours() / theirs() - 1)))
    return seconds(ours, least=3), seconds(theirs, least=3), difference


def record(count: int) -> np.ndarray:
    """Return white noise and a random walk."""
    random = np.random.default_rng(count)
    return random.normal(size=count) + np.cumsum(random.normal(scale=1e-3, size=count))


def whole_analysis(x: np.ndarray) -> None:
    """Analyse a record as `imubayes noise` does."""
    sums = from_samples(x, 1 / RATE)
    allan_variance(sums)
    estimate_terms(NoiseLikelihood(cosine_statistics(sums)))
