"""Sampling: independent emcee ensembles that run until they agree.

Four ensembles, each of its own seed, begin from fits that were started far apart in the prior, so that a second
mode, if there is one, is found by one of them and shows as disagreement.  They advance in blocks; after each
block the checkpoint is replaced as a whole and convergence is judged.

How long a chain has to be follows from the importance weights of its proposal: a walker stays for as many steps as the
weight of its place, so the chain takes several times the largest weight found (`imubayes.inference.laplace_proposal`);
and from the tails of the posterior, whose standard deviations and intervals are to have small Monte Carlo errors
(`imubayes.inference.convergence`).

Without good independent proposals a walker that begins far off a narrow ridge may never arrive, while the others move
along it.  Such walkers are drawn anew in the burn-in, from those in the bulk of their ensemble.
"""

import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from imubayes.foundations.deferred_modules import DeferredModule
from imubayes.foundations.progress import duration, silent
from imubayes.inference.chains import Chains, Settings
from imubayes.inference.checkpoint import Checkpoint, append
from imubayes.inference.convergence import MOST_DRAWS, STAYS, Convergence, diagnose, far_below, normal_length
from imubayes.inference.gradient_moves import GradientMove
from imubayes.inference.laplace_proposal import BatchedDensity, LaplaceMove, WeighedProposal
from imubayes.inference.mixture_proposal import MixtureProposal

if TYPE_CHECKING:
    import emcee
else:
    emcee = DeferredModule("emcee")  # takes long to import, and only sampling needs it

# Stretch and DE moves, the safety net for what is not Gaussian, take this share of the steps beside a Laplace proposal,
# and the second beside gradients, which lead to no other mode.  DESnookerMove of emcee 3.1.6 is biased.
_OTHERS_SHARE_LAPLACE, _OTHERS_SHARE = 0.04, 0.4
# Beside a mixture that is mostly refused, as at the corner of hard edges, they free the walkers that it leaves there.
_OTHERS_SHARE_MIXTURE = 0.3
# Short steps of the Laplace move, and the share of them; if independent draws are mostly refused, half of all.
# In ten steps two walkers of three take a short one: it frees those few from which independent draws rarely lead.
_SHORT_STEP, _SHORT_SHARE, _SHORT_SHARE_HARD = 0.3, 0.1, 0.5
_HARD_ACCEPTANCE = 0.5
_BURN_IN, _BLOCK = 5, 5
# So many draws of all ensembles together are taken even if fewer would do, and so many steps.
_LEAST_DRAWS, _LEAST_STEPS = 6000, 10
# Draws beyond those asked for, so that the next judgement mostly is the last; and how many times the length at once:
# what a short chain says of its tails is rough.
_MARGIN, _MOST_LONGER = 1.1, 4.0
# Of a chain longer than this without good independent proposals a quarter is left out, and so much of one with them.
_LONG, _LONG_BURN_IN = 60, 15
# Until a walker is drawn anew it has been far below the bulk for so many steps; and for so many steps it is looked for,
# all left out: by then ensembles that began a thousand standard deviations off a ridge have their quartiles on it.
_WATCHED, _SETTLING = 15, 150
# Largest size of all chains together, in numbers: 400 MB.
_MOST_NUMBERS = 50_000_000


@runtime_checkable
class Budget(Protocol):
    """How many evaluations of the log density are allowed."""

    most: int
    used: int

    @property
    def left(self) -> int:
        """Evaluations that are left."""
        ...


def sample(
    log_density: BatchedDensity,
    starts: Sequence[np.ndarray],
    names: Sequence[str],
    settings: Settings,
    checkpoint: Checkpoint,
    weighed: WeighedProposal | None = None,
    progress: Callable[[str], None] | None = None,
    gradients: GradientMove | None = None,
    budget: Budget | None = None,
) -> Chains:
    """Sample until converged, until the longest chain allowed, or until a budget of evaluations is used up.

    Parameters
    ----------
    log_density : points (n, D) → (n,).
    starts : for each ensemble its first points, shape (walkers, D).
    names : of the D parameters.
    checkpoint : created or checked before; if it holds steps, they are continued.
    weighed : the Laplace proposal with its importance weights; None without one.
    progress : called with a line on the steps done, the time left, and how far the chains are from their goals.
    gradients : the move of most steps if there is no proposal; None for stretch and DE moves alone.
    budget : of evaluations, which what counts them goes beyond by a block at most; None without a bound.
    """
    ensembles = _ensembles(log_density, starts, settings, checkpoint, weighed, gradients)
    walkers, dimensions = starts[0].shape
    least, most = _lengths(len(starts), walkers, dimensions, settings, weighed)
    settled = 0 if _good(weighed) else min(_SETTLING, burn_in(least, weighed))
    tell, clock, begun = progress or silent, time.monotonic(), checkpoint.steps
    taken, mixing, cost = begun, "", _Cost(budget, len(starts) * walkers)
    while True:
        if taken >= least or (taken and not cost.affordable):
            chains = _judged(checkpoint, names, weighed)
            mixing = _mixing(chains.diagnosis, weighed)
            if chains.diagnosis.settled or taken >= most or not cost.affordable:
                return chains
            least = min(taken + _lacking(chains), most)
        steps = min(max(_BLOCK, taken // 4), (least if taken < least else most) - taken, max(cost.affordable, _BLOCK))
        if _WATCHED <= taken <= settled:
            _redraw_strays(ensembles, checkpoint)
        with checkpoint.block() as backends:
            for ensemble, backend in zip(ensembles, backends, strict=True):
                ensemble.advance(steps, backend)
        taken += steps
        cost.took(steps)
        each = (time.monotonic() - clock) / (taken - begun)
        left = f" of {least}, about {duration(each * (least - taken))} left" if taken < least else ""
        tell(f"sampling: step {taken}{left}{mixing}{cost.words()}")


class _Cost:
    """What steps cost of a budget of evaluations, from those that were taken."""

    def __init__(self, budget: Budget | None, each: int):
        self._budget, self._each, self._steps = budget, float(each), 0
        self._before = budget.used if budget is not None else 0

    def took(self, steps: int) -> None:
        """Learn what a step costs."""
        self._steps += steps
        if self._budget is not None:
            self._each = max((self._budget.used - self._before) / self._steps, 1.0)

    @property
    def affordable(self) -> int:
        """Further steps that the budget allows."""
        return int(self._budget.left / self._each) if self._budget is not None else sys.maxsize

    def words(self) -> str:
        """Return what was used of the budget."""
        return f"; {self._budget.used} of {self._budget.most} evaluations" if self._budget is not None else ""


def _redraw_strays(ensembles: "Sequence[_Ensemble]", checkpoint: Checkpoint) -> None:
    """Draw walkers anew that were far below their ensemble in the latest steps."""
    for ensemble, backend in zip(ensembles, checkpoint.read(), strict=True):
        ensemble.state = without_strays(ensemble.state, np.asarray(backend.get_log_prob())[-_WATCHED:])


def without_strays(state: "emcee.State", log_density: np.ndarray) -> "emcee.State":
    """Return the state of an ensemble with walkers that stay far below its bulk drawn anew from those that do not.

    A place that holds a share of the posterior, however low its density, widens the quartiles or is left by its walkers
    now and then; only one that does neither is given up.

    Parameters
    ----------
    log_density : shape (steps, walkers), of the latest steps.
    """
    stray = log_density.max(axis=0) < far_below(log_density)
    if not stray.any() or state.log_prob is None or state.random_state is None:
        return state
    random = np.random.RandomState()
    random.set_state(state.random_state)
    chosen = random.choice(np.flatnonzero(~stray), size=int(stray.sum()))
    coords, height = state.coords.copy(), state.log_prob.copy()
    coords[stray], height[stray] = coords[chosen], height[chosen]
    return emcee.State(coords, log_prob=height, random_state=random.get_state())


def _lacking(chains: Chains) -> int:
    """Return the further steps that the Monte Carlo errors ask for; 0 if they ask for none."""
    each, steps = chains.log_density[:, 0].size, chains.log_density.shape[1]
    wanted = min(_MARGIN * min(chains.diagnosis.longer, _MOST_LONGER) * steps, MOST_DRAWS / each)
    return max(math.ceil(wanted) - steps, 0) if chains.diagnosis.longer > 1 else 0


def _mixing(found: Convergence, weighed: WeighedProposal | None) -> str:
    """Return how far chains are from the goals of sampling."""
    r_hat = f"nested R-hat {np.nanmax(found.r_hat, initial=1.0):.3f}"
    if weighed is not None:
        return f"; {r_hat}"
    return f"; effective size {min(found.least_size, found.needed_size):.0f} of {found.needed_size:.0f}, {r_hat}"


def _lengths(
    ensembles: int, walkers: int, dimensions: int, settings: Settings, weighed: WeighedProposal | None
) -> tuple[int, int]:
    """Return the fewest and the most steps that each ensemble takes, burn-in included."""
    memory = _MOST_NUMBERS // (ensembles * walkers * dimensions)
    most = min(settings.most_steps + _BURN_IN if settings.most_steps else memory, memory)
    draws, stays = float(_LEAST_DRAWS), 0.0
    if weighed is not None:
        # Independent proposals taken with probability a: the integrated autocorrelation time is about 2/a − 1.
        accepted = max(weighed.acceptance, _HARD_ACCEPTANCE)
        draws, stays = _MARGIN * normal_length(dimensions) * (2 / accepted - 1), STAYS * weighed.largest
    enough = settings.least_steps or math.ceil(max(_LEAST_STEPS, draws / (ensembles * walkers), stays))
    return min(enough + _BURN_IN, most), most


@dataclass
class _Ensemble:
    """An ensemble with its sampler and where it stands."""

    sampler: "emcee.EnsembleSampler"
    move: LaplaceMove | GradientMove | None
    state: "emcee.State"

    def advance(self, steps: int, backend: "emcee.backends.HDFBackend") -> None:
        """Take a block of steps into a backend."""
        block = emcee.backends.Backend()
        block.reset(*self.state.coords.shape)
        self.sampler.backend = block
        if self.move is not None:
            self.move.forget()
        for state in self.sampler.sample(self.state, iterations=steps, skip_initial_state_check=True):
            self.state = state
        append(backend, block)


def _ensembles(
    log_density: BatchedDensity,
    starts: Sequence[np.ndarray],
    settings: Settings,
    checkpoint: Checkpoint,
    weighed: WeighedProposal | None,
    gradients: GradientMove | None,
) -> list[_Ensemble]:
    """Return the ensembles at their starts or where the checkpoint left them."""
    short_share = _SHORT_SHARE if _good(weighed) else _SHORT_SHARE_HARD
    ensembles = []
    for number, start in enumerate(starts):
        move = LaplaceMove(weighed.proposal, _SHORT_STEP, short_share) if weighed is not None else gradients
        state = _state(number, start, settings, checkpoint)
        walkers, dimensions = start.shape
        share = _others_share(weighed) if weighed is not None else _OTHERS_SHARE
        ensembles.append(_Ensemble(_sampler(log_density, walkers, dimensions, move, share), move, state))
    return ensembles


def _others_share(weighed: WeighedProposal) -> float:
    """Return the share of stretch and DE moves beside a proposal."""
    hard = isinstance(weighed.proposal, MixtureProposal) and not _good(weighed)
    return _OTHERS_SHARE_MIXTURE if hard else _OTHERS_SHARE_LAPLACE


def _good(weighed: WeighedProposal | None) -> bool:
    """Return whether there are independent proposals that are mostly taken."""
    return weighed is not None and weighed.acceptance >= _HARD_ACCEPTANCE


def _sampler(
    log_density: BatchedDensity,
    walkers: int,
    dimensions: int,
    move: LaplaceMove | GradientMove | None = None,
    share: float = 1.0,
) -> "emcee.EnsembleSampler":
    """Return a sampler with a move, and this share of stretch and DE moves beside it."""
    moves = [(emcee.moves.StretchMove(), share / 2), (emcee.moves.DEMove(), share / 2)]
    if move is not None:
        moves.append((move, 1 - share))
    return emcee.EnsembleSampler(walkers, dimensions, log_density, moves=moves, vectorize=True)


def _state(number: int, start: np.ndarray, settings: Settings, checkpoint: Checkpoint) -> "emcee.State":
    """Return where an ensemble stands: its last checkpoint, or its start with a random stream of its own."""
    if checkpoint.steps:
        state = checkpoint.read()[number].get_last_sample()
        # The random stream comes back as a list, which NumPy does not take and emcee does not complain about.
        state.random_state = tuple(state.random_state or ())
        return state
    random = np.random.RandomState(np.random.SeedSequence([settings.seed, number]).generate_state(4))
    return emcee.State(start, random_state=random.get_state())


def short_chain(
    log_density: BatchedDensity, start: np.ndarray, steps: int, seed: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return points (steps, walkers, D) and log densities (steps, walkers) of an ensemble without a proposal."""
    sampler = _sampler(log_density, *start.shape)
    random = np.random.RandomState(np.random.SeedSequence(list(seed)).generate_state(4))
    sampler.run_mcmc(emcee.State(start, random_state=random.get_state()), steps, skip_initial_state_check=True)
    return np.asarray(sampler.get_chain()), np.asarray(sampler.get_log_prob())


def burn_in(steps: int, weighed: WeighedProposal | None) -> int:
    """Return how many of the first steps are left out: the first few, more of a long chain.

    With good independent proposals a walker has forgotten its start after a few steps, and a longer chain is one that
    needs many draws; others may have begun where they should not, and settle first.
    """
    settling = max(steps // 4, min(_SETTLING, steps // 2))
    long = 0 if steps <= _LONG else _LONG_BURN_IN if _good(weighed) else settling
    return min(max(_BURN_IN, long), max(steps - 2, 0))


def _judged(checkpoint: Checkpoint, names: Sequence[str], weighed: WeighedProposal | None) -> Chains:
    points, log_density = checkpoint.chains()
    first = burn_in(points.shape[1], weighed)
    points, log_density = points[:, first:], log_density[:, first:]
    moved = np.any(np.diff(points, axis=1) != 0, axis=-1)
    acceptance = float(moved.mean()) if moved.size else math.nan
    return Chains(points, log_density, acceptance, diagnose(points, log_density, names, weighed))
