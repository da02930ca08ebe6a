"""Simulated replicates of a shipped campaign: do 95 % intervals hold what they promise?

The replicates come from the generator under `data/generators`, which shares no code with the forward models.
"""

import sys
import tempfile
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import imubayes
from imubayes.api import Result

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "data" / "generators"))


@dataclass(frozen=True)
class Scores:
    """What came out of the replicates, all quantities of all replicates in a row.

    `z` is (mean − truth)/sd, `inside` whether the truth lies in the 95 % interval.
    """

    names: list[str]
    z: np.ndarray
    inside: np.ndarray
    sd: np.ndarray
    converged: list[bool]

    @property
    def coverage(self) -> float:
        """Share of intervals that hold the truth."""
        return float(self.inside.mean())

    @property
    def rms(self) -> float:
        """Root mean square of the z-scores."""
        return float(np.sqrt(np.mean(self.z**2)))


def replicate(generator, name: str, seed: int, model: str | None = None) -> tuple[dict[str, float], Result]:
    """Generate one replicate and fit it; return truth and result."""
    with tempfile.TemporaryDirectory() as folder:
        campaign = Path(folder) / name
        generator.generate(campaign, seed)
        truth = tomllib.loads((campaign / "truth.toml").read_text())
        result = imubayes.fit(campaign, ROOT / "models" / f"{model or name}.toml", seed=seed)
    return truth["parameters"] | truth["derived"], result


def study(generator, name: str, seeds, understate: float = 1.0, only: str = "") -> Scores:
    """Return scores over replicates.

    Parameters
    ----------
    understate : factor on the reported standard deviations, to plant a fault.
    only : a prefix of the names to look at.
    """
    names, z, inside, sds, converged = [], [], [], [], []
    for seed in seeds:
        truth, result = replicate(generator, name, seed)
        converged.append(result.converged)
        for line in (*result.summary.parameters, *result.summary.derived):
            if line.name not in truth or not line.name.startswith(only):
                continue
            true, middle = truth[line.name], line.mean
            low, high = (middle + understate * (bound - middle) for bound in (line.q025, line.q975))
            names.append(line.name)
            z.append((middle - true) / (understate * line.sd))
            inside.append(low <= true <= high)
            sds.append(line.sd)
    return Scores(names, np.array(z), np.array(inside), np.array(sds), converged)
