"""Noise terms of static records of 6 h at 100 Hz: do estimates and 95 % intervals hold what they promise?

    python tests/study/static_record_study.py        50 replicates; writes benchmarks/results/static_record.md

White noise, flicker noise and random walk come from the generator of the shipped record, which shares no code with the
estimate: independent values, the fractional sum of order ½ of white noise in the time domain, and a cumulative sum.
"""

import re
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "data" / "generators"))
import static_record as generator  # noqa: E402

from imubayes_recordings.noise_analysis.cosine_spectra import cosine_statistics  # noqa: E402
from imubayes_recordings.noise_analysis.likelihood import NoiseLikelihood  # noqa: E402
from imubayes_recordings.noise_analysis.noise_terms import NoiseTerm  # noqa: E402
from imubayes_recordings.noise_analysis.running_sum import from_samples  # noqa: E402
from imubayes_recordings.noise_analysis.term_estimates import TermEstimate, estimate_terms  # noqa: E402

REPORT = ROOT / "benchmarks" / "results" / "static_record.md"
HEADING = "## Coverage"
HOURS, RATE = 6.0, 100.0
SEEDS = range(9101, 9151)
TERMS = (NoiseTerm.WHITE, NoiseTerm.FLICKER, NoiseTerm.RANDOM_WALK)
# Medians of the coefficients in °/√h, °/h and °/h/√h, and the spread of their logarithms.
MEDIANS, SPREAD = {"white": 0.05, "flicker": 0.5, "random_walk": 2.0}, 0.3


@dataclass(frozen=True)
class Recovery:
    """One coefficient of one replicate, over its true value."""

    seed: int
    term: NoiseTerm
    found: TermEstimate
    truth: float

    @property
    def z(self) -> float:
        """Return the deviation in standard deviations, NaN where the term is not determined."""
        return (self.found.value - self.truth) / self.found.sd

    def inside(self, understate: float = 1.0) -> bool:
        """Return whether the 95 % interval holds the truth, or the upper limit is above it.

        Parameters
        ----------
        understate : factor on the length of the interval, to plant a fault.
        """
        if not self.found.determined:
            return self.truth <= self.found.limit
        low, high = (
            self.found.value + understate * (end - self.found.value) for end in (self.found.low, self.found.high)
        )
        return low <= self.truth <= high


def truth_of(seed: int) -> dict[str, float]:
    """Return the true coefficients of a replicate, in SI."""
    random = np.random.default_rng([seed, 1])
    return {
        term: generator.in_si("gyro", term, median * float(np.exp(SPREAD * random.normal())))
        for term, median in MEDIANS.items()
    }


def recovered(seed: int, hours: float = HOURS) -> list[Recovery]:
    """Return the coefficients of one replicate."""
    truth = truth_of(seed)
    samples = generator.noise(truth, round(hours * 3600 * RATE), 1 / RATE, np.random.default_rng([seed, 2]))
    estimate = estimate_terms(NoiseLikelihood(cosine_statistics(from_samples(samples, 1 / RATE))))
    assert estimate.full.converged
    return [Recovery(seed, term, estimate.of(term), truth[str(term)]) for term in TERMS]


def coverage(found: list[Recovery], understate: float = 1.0) -> float:
    """Return the share of intervals that hold the truth."""
    return float(np.mean([each.inside(understate) for each in found]))


def report(found: list[Recovery], seconds: float) -> str:
    """Return the table of the study."""
    lines = [
        HEADING,
        "",
        f"Made by `python tests/study/static_record_study.py`: {len({each.seed for each in found})} replicates of "
        f"{HOURS:g} h at {RATE:g} Hz, seeds {SEEDS[0]} … {SEEDS[-1]}, medians N = 0.05 °/√h, B = 0.5 °/h, "
        "K = 2 °/h/√h. Asked: coverage 0.90 … 0.98 of 95 % intervals.",
        "",
        "| term | determined | coverage | mean z | rms z | within 2 sd | largest abs(z) (seed) | median sd/value |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, chosen in [*((str(term), [term]) for term in TERMS), ("all", list(TERMS))]:
        part = [each for each in found if each.term in chosen]
        known = [each for each in part if each.found.determined]
        z = np.array([each.z for each in known])
        worst = int(np.argmax(np.abs(z)))
        relative = np.median([each.found.sd / each.found.value for each in known])
        lines.append(
            f"| {name} | {len(known)} of {len(part)} | {coverage(part):.3f} | {z.mean():+.2f} "
            f"| {np.sqrt(np.mean(z**2)):.2f} | {np.mean(np.abs(z) <= 2):.3f} "
            f"| {abs(z[worst]):.2f} ({known[worst].seed}) | {relative:.3f} |"
        )
    lines += ["", f"{seconds / len({each.seed for each in found}):.1f} s of CPU a replicate, its generation included."]
    return "\n".join(lines) + "\n"


def replaced(file: Path, heading: str, section: str) -> None:
    """Write a section of a report in the place of the one that it has."""
    parts = re.split(r"(?m)^(?=## )", file.read_text())
    kept = [part.rstrip() + "\n" for part in parts if not part.startswith(heading)]
    file.write_text("\n".join([*kept, section]))


def main() -> None:
    """Run all replicates and write the table beside what else stands in the report."""
    clock, found = time.process_time(), []
    for seed in SEEDS:
        found += recovered(seed)
        print(seed, *(f"{each.term} {each.z:+.2f} {each.inside()}" for each in found[-3:]), flush=True)
    table = report(found, time.process_time() - clock)
    print(table)
    replaced(REPORT, HEADING, table)


if __name__ == "__main__":
    main()
