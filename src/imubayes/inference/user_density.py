"""Sampling of any log density with the sampler of the fit: independent ensembles that run until they agree.

The ensembles have a proposal, if its importance weights show that it holds the posterior and chains from the stated
starts agree with it (`imubayes.inference.density_proposal`): the normal distribution about the mode if JAX gives it,
or a mixture fitted to where such chains were, as of two modes or beside a hard edge.  If neither holds, as of a
funnel, most steps are Hamiltonian Monte Carlo with a step size that follows the local geometry
(`imubayes.inference.gradient_moves`), if JAX can differentiate the density and blackjax is installed.

All evaluations of the density are counted, and a budget of them ends the sampling.
"""

import hashlib
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from arviz_base import from_dict

from imubayes.foundations.deferred_modules import DeferredModule
from imubayes.foundations.errors import input_error
from imubayes.foundations.progress import Tell, silent
from imubayes.inference.chains import Chains, Settings, walkers_for
from imubayes.inference.checkpoint import Checkpoint
from imubayes.inference.convergence import BLIND
from imubayes.inference.density_mode import NormalProposal, differentiable, normal_about_mode
from imubayes.inference.density_proposal import ProposalSearch, finite_starts
from imubayes.inference.ensemble_sampling import sample as sample_ensembles
from imubayes.inference.gradient_moves import GradientMove, Single, gradient_move
from imubayes.inference.laplace_proposal import WeighedProposal
from imubayes.inference.user_function import CountedDensity, of_many_points

if TYPE_CHECKING:
    import xarray
else:
    xarray = DeferredModule("xarray")  # takes long to import, and few commands need it


# Starts are wider than the target is said to be, so that a second mode nearby is met by one of the ensembles.
_OVERDISPERSION = 2.0
# Without a proposal the starts are no draws of the target: 150 of these steps are left out as burn-in.
_LEAST_STEPS = 400
MOST_EVALUATIONS, MOST_WITH_GRADIENTS = 2_000_000, 100_000_000
"""Budgets of evaluations: of a function that is called, and of one that gradients lead through, compiled as a whole."""
# Of so many steps the budget has to allow at least as many as judge a chain.
_FEWEST_STEPS = 40


@dataclass(frozen=True)
class Samples:
    """Draws from a log density.

    Attributes
    ----------
    names : of the D parameters.
    chains : draws, log densities, acceptance and convergence, with burn-in removed.
    evaluations : of the log density at one point, with or without its gradient, that this took.
    most_evaluations : the budget of them.
    ended : why the sampling ended without convergence, and what to do, in a sentence; empty if it converged.

    Examples
    --------
    >>> import imubayes
    >>> found = imubayes.sample(lambda x: -0.5 * (x**2).sum(axis=1), [0.0, 0.0], names=["a", "b"])
    >>> found.names, found.draws.shape[1]
    (('a', 'b'), 2)
    """

    names: tuple[str, ...]
    chains: Chains
    evaluations: int
    most_evaluations: int
    ended: str = ""

    @property
    def draws(self) -> np.ndarray:
        """All draws together, shape (S, D)."""
        return self.chains.points.reshape(-1, len(self.names))

    @property
    def converged(self) -> bool:
        """Whether nested R̂ and the effective sample sizes of all parameters and of the log density are sufficient."""
        return self.chains.diagnosis.converged

    @property
    def message(self) -> str:
        """The parameters that did not converge, the reason and the remedy, in sentences; empty if all converged."""
        return f"{self.chains.diagnosis.message} {self.ended}".strip()

    @property
    def blind_to(self) -> str:
        """The limit of `converged`, in a sentence: distant modes are not seen."""
        return BLIND

    @cached_property
    def posterior(self) -> "xarray.DataTree":
        """The draws as an ArviZ tree, one variable per name; a chain is an ensemble, walker after walker."""
        ensembles, steps, walkers, _ = self.chains.points.shape
        points = self.chains.points.swapaxes(1, 2).reshape(ensembles, walkers * steps, -1)
        density = self.chains.log_density.swapaxes(1, 2).reshape(ensembles, -1)
        variables = {name: points[..., place] for place, name in enumerate(self.names)}
        return from_dict({"posterior": variables, "sample_stats": {"lp": density}}, check_conventions=False)


def sample(
    log_density: Callable[[Any], Any],
    start: np.ndarray | Sequence[float],
    scale: np.ndarray | Sequence[float] | float = 1.0,
    names: Sequence[str] = (),
    *,
    settings: Settings | None = None,
    most_evaluations: int | None = None,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    progress: Callable[[str], None] | None = None,
) -> Samples:
    """Sample a log density of your own by independent ensembles.

    The proposal follows from the mode, if JAX finds it, or from chains that begin at the stated start; both have to
    agree. Without a proposal, Hamiltonian Monte Carlo follows a JAX function if `imubayes[gradient]` is installed. The
    ensembles run until nested R̂ and all effective sample sizes suffice, or the budget of evaluations is used up. In
    that case the answer is not converged, and its message says so. A mode that no walker came near is not seen.

    Parameters
    ----------
    log_density : points (n, D) → (n,), or a point (D,) → a number, up to a constant; −∞ or NaN if the density is
        zero.  A function of one point is vectorised, by JAX if JAX accepts it, and called point by point otherwise.
    start : shape (D,), a point within the bulk of the density.
    scale : shape (D,) or one for all, the rough standard deviation of each parameter; it covers all modes that matter.
    names : of the D parameters; ``x0``, ``x1``, … if none are given.
    settings : of the sampler.
    most_evaluations : budget of evaluations of the density at a point, with or without its gradient; a block of steps
        may go beyond it.  None for 2 million, 100 million if gradients lead the chains.
    checkpoint : file in which the chains are kept; a temporary one if None.
    resume : continue the checkpoint.
    progress : called with a line on the steps done, how far the chains are from their goals, and the evaluations.

    Raises
    ------
    InputError
        for names, a log density, a start, a budget or a checkpoint to be resumed that do not fit.

    Examples
    --------
    >>> import imubayes
    >>> normal = imubayes.sample(lambda x: -0.5 * (x**2).sum(axis=1), [0.0, 0.0], names=["a", "b"])
    >>> normal.converged
    True
    """
    settings, names = settings or Settings(), _checked_names(names, np.size(start))
    centre = np.atleast_1d(np.asarray(start, dtype=float))
    widths = np.broadcast_to(np.asarray(scale, dtype=float), centre.shape)
    most = _checked_budget(most_evaluations, walkers_for(len(centre), settings) * settings.ensembles)
    density, scaled = _counted(log_density, centre, widths, most, settings)
    found = _begun(density, scaled, centre, widths, settings, progress or silent)
    density.most = MOST_WITH_GRADIENTS if found.gradients is not None and most_evaluations is None else most
    if found.weighed is None:
        settings = replace(settings, least_steps=settings.least_steps or _LEAST_STEPS)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(checkpoint) if checkpoint is not None else Path(folder) / "checkpoint.h5"
        file = _checkpoint(path, found.starts[0].shape, names, settings, resume)
        moves = found.weighed, progress, found.gradients
        chains = sample_ensembles(density, found.starts, names, settings, file, *moves, density)
        return Samples(names, chains, density.used, density.most, _ended(chains, density, file.steps))


@dataclass(frozen=True)
class _Begun:
    """Where ensembles begin, and by which moves they go on: of a proposal, or along gradients if there is none."""

    starts: list[np.ndarray]
    weighed: WeighedProposal | None
    gradients: GradientMove | None


def _counted(
    log_density: Callable[[Any], Any], centre: np.ndarray, widths: np.ndarray, most: int, settings: Settings
) -> tuple[CountedDensity, Single | None]:
    """Return the density of many points, counted, and that of one at (x − start)/scale if JAX differentiates it."""
    random = np.random.default_rng([settings.seed, 1])
    tried = centre + _OVERDISPERSION * widths * random.normal(size=(walkers_for(len(centre), settings), len(centre)))
    of_many = of_many_points(log_density, tried, widths)
    return CountedDensity(of_many, most), differentiable(of_many, centre, widths)


def _begun(
    density: CountedDensity,
    scaled: Single | None,
    centre: np.ndarray,
    widths: np.ndarray,
    settings: Settings,
    tell: Tell,
) -> _Begun:
    walkers, wide = walkers_for(len(centre), settings), NormalProposal(centre, np.diag(_OVERDISPERSION * widths))
    starts = _checked_starts(finite_starts(density, wide, walkers, settings.ensembles, [settings.seed, 1]))
    laplace = None if scaled is None else normal_about_mode(scaled, centre, widths, density.spend)
    search = ProposalSearch(density, starts, settings, tell)
    weighed = search.proposal(laplace)
    if weighed is not None:
        return _Begun(_of_proposal(weighed, walkers, settings), weighed, None)
    gradients = None if scaled is None else gradient_move(scaled, centre, widths, density.spend)
    return _Begun(search.starts, None, gradients)


def _ended(chains: Chains, density: CountedDensity, steps: int) -> str:
    """Return why chains of so many steps ended without convergence, and what to do; empty if they converged."""
    if chains.diagnosis.converged:
        return ""
    used = f"{density.used} evaluations of the log density, of a budget of {density.most}"
    if density.left < density.used / steps:
        remedy = "allow more by `most_evaluations`, or state a `start` and `scale` nearer to the density"
        return f"It ended after {steps} steps as the budget was used up ({used}): {remedy}."
    remedy = "allow more by `settings.most_steps`, or write the density in other parameters"
    return (
        f"It ended after {steps} steps, the most that settings or memory allow, or that would help ({used}): {remedy}."
    )


def _of_proposal(weighed: WeighedProposal, walkers: int, settings: Settings) -> list[np.ndarray]:
    """Return the first points of each ensemble, (walkers, D), from a proposal by its weights.

    A walker that begins where a proposal is next to impossible would stay there for as long as its weight is large.
    """
    seed = np.random.default_rng([settings.seed, 2]).integers(2**32, size=4)
    state = np.random.RandomState(seed)
    return [weighed.resampled(ensemble, walkers, state) for ensemble in range(settings.ensembles)]


def _checkpoint(
    path: Path, shape: tuple[int, ...], names: Sequence[str], settings: Settings, resume: bool
) -> Checkpoint:
    """Return a checkpoint for ensembles of a shape (walkers, D): one that is to be continued, or a new one."""
    walkers, dimensions = shape
    fingerprints = {
        "parameters": hashlib.sha256("\n".join(names).encode()).hexdigest(),
        "sampler": f"seed {settings.seed}, {settings.ensembles} ensembles of {walkers} walkers",
    }
    file = Checkpoint(path, settings.ensembles, walkers, dimensions, fingerprints)
    if resume:
        file.check()
    else:
        file.create()
    return file


def _checked_names(names: Sequence[str], parameters: int) -> tuple[str, ...]:
    """Return the names, made up if there are none; raise InputError if their number is another."""
    given = tuple(names) or tuple(f"x{place}" for place in range(parameters))
    if len(given) != parameters:
        what = f"{len(given)} names for {parameters} parameters"
        raise input_error(what, "names", "one name per entry of `start`", "give as many names as parameters")
    return given


def _checked_budget(most: int | None, walkers: int) -> int:
    """Return the budget of evaluations; raise InputError if it does not allow a chain of so many walkers."""
    given, fewest = MOST_EVALUATIONS if most is None else most, _FEWEST_STEPS * walkers
    if given < fewest:
        what = f"{given} evaluations allow no chain of {walkers} walkers"
        raise input_error(what, "most_evaluations", f"at least {fewest}", "allow more evaluations")
    return given


def _checked_starts(starts: list[np.ndarray]) -> list[np.ndarray]:
    """Return the starts; raise InputError if none was found."""
    if not starts:
        raise input_error(
            "the log density is not finite at any starting point",
            "log_density, start, scale",
            "a start within the bulk of the density",
            "choose another start, or a smaller scale",
        )
    return starts
