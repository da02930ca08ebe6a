"""How a posterior is sampled, and the chains that come of it."""

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from imubayes.inference.convergence import Convergence

_FEWEST_WALKERS = 64
# What is kept of chains: 80 MB, but never fewer draws than the second.
_MOST_STORED, _LEAST_KEPT = 10_000_000, 20_000


@dataclass(frozen=True)
class Settings:
    """Settings of the sampler; `walkers` = 0 means the smallest number that emcee's moves allow.

    Each ensemble takes at least `least_steps` after the burn-in; `most_steps` = 0 means as many as memory allows.
    Longer chains are thinned to `most_kept` draws in all, fewer if there are many parameters; the checkpoint has all
    steps.

    Examples
    --------
    >>> import imubayes
    >>> imubayes.Settings(ensembles=6, least_steps=2000, seed=3)
    Settings(ensembles=6, walkers=0, seed=3, least_steps=2000, most_steps=0, most_kept=100000)
    """

    ensembles: int = 4
    walkers: int = 0
    seed: int = 0
    least_steps: int = 0
    most_steps: int = 0
    most_kept: int = 100_000


@dataclass(frozen=True)
class Chains:
    """What was sampled, burn-in removed.

    Attributes
    ----------
    points : shape (ensembles, steps, walkers, D), in z.
    log_density : shape (ensembles, steps, walkers).
    acceptance : share of proposals taken, all moves together.
    diagnosis : convergence.
    """

    points: np.ndarray
    log_density: np.ndarray
    acceptance: float
    diagnosis: "Convergence"


def thinned(chains: Chains, most: int) -> Chains:
    """Return chains of a size that is practical to store, at most about `most` draws: every nth step, all walkers."""
    each = math.ceil(chains.log_density.size / min(most, max(_LEAST_KEPT, _MOST_STORED // chains.points.shape[-1])))
    return replace(chains, points=chains.points[:, ::each], log_density=chains.log_density[:, ::each])


def walkers_for(dimensions: int, settings: Settings) -> int:
    """Return the number of walkers of an ensemble: even, and at least twice the dimensions plus two."""
    fewest = max(_FEWEST_WALKERS, 2 * dimensions + 2)
    return max(settings.walkers + settings.walkers % 2, fewest)
