"""Sampling of any log density with the sampler of the fit: independent ensembles that run until they agree.

Where JAX can differentiate the density, the ensembles have the Laplace approximation about its mode as a proposal, if
its importance weights show that it holds the posterior.  It does not where a mode is a spike that holds next to nothing
(a funnel), a tail is heavy, or draws about the user's start find more mass elsewhere (a second mode).  There most steps
are Hamiltonian Monte Carlo with a step size that follows the local geometry (`imubayes.inference.gradient_moves`), if
blackjax is installed.

Strongly correlated parameters make a ridge; starts of the right standard deviations without the correlations lie far
off it, and walkers that begin there may never arrive.  A JAX function tells its gradient, so the mode is found by
Newton steps and the correlations come with it.
"""

import hashlib
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import lazy_loader
import numpy as np
from arviz_base import from_dict

from imubayes.foundations.errors import input_error
from imubayes.inference.checkpoint import Checkpoint
from imubayes.inference.convergence import BLIND, WORST_PARETO_K
from imubayes.inference.ensemble_sampling import Chains, Settings, walkers_for
from imubayes.inference.ensemble_sampling import sample as sample_ensembles
from imubayes.inference.gradient_moves import Single, gradient_move
from imubayes.inference.laplace_proposal import BatchedDensity, WeighedProposal, weigh, weigh_tail

if TYPE_CHECKING:
    import xarray
else:
    xarray = lazy_loader.load("xarray")  # takes long to import, and few commands need it


# Newton steps at most, and the decrement g·H⁻¹g below which a mode is found: a thousandth of a standard deviation.
_NEWTON_STEPS, _DECREMENT = 100, 1e-6
# Gradients are differenced over this share of the conditional standard deviation.
_DIFFERENCE = 1e-3
# Curvatures below this share of the largest are taken for this share: flat directions are not followed for ever.
_FLAT = 1e-14


@dataclass(frozen=True)
class NormalProposal:
    """A normal distribution as a proposal: point = centre + axes · standard normal.

    Attributes
    ----------
    centre : shape (D,).
    axes : shape (D, D), invertible.
    """

    centre: np.ndarray
    axes: np.ndarray

    @property
    def dimensions(self) -> int:
        """Number D of parameters."""
        return len(self.centre)

    def to_point(self, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the points of standard normal vectors, (n, D), and the log density of the proposal, (n,)."""
        return self.centre + normal @ self.axes.T, self._density(normal)

    def to_normal(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the standard normal vectors of points, (n, D), and the log density of the proposal, (n,)."""
        normal = np.linalg.solve(self.axes, (points - self.centre).T).T
        return normal, self._density(normal)

    def _density(self, normal: np.ndarray) -> np.ndarray:
        constant = 0.5 * self.dimensions * np.log(2 * np.pi) + np.linalg.slogdet(self.axes)[1]
        return -0.5 * np.sum(normal**2, axis=1) - constant


def normal_about_mode(scaled: Single, start: np.ndarray, scale: np.ndarray) -> NormalProposal | None:
    """Return the Laplace approximation of a log density, from Newton steps with the absolute values of its curvatures.

    None where no mode is found.

    Parameters
    ----------
    scaled : log density at (x − start)/scale.
    start, scale : shape (D,), where the search begins, and rough standard deviations.
    """
    whole = jax.jit(jax.vmap(jax.value_and_grad(scaled)))

    def gradients(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        value, slope = whole(jnp.asarray(at))
        return np.asarray(value), np.asarray(slope)

    size = len(start)
    at, apart = np.zeros(size), np.full(size, _DIFFERENCE)
    for _ in range(_NEWTON_STEPS):
        offsets = np.concatenate([np.zeros((1, size)), np.diag(apart), -np.diag(apart)])
        value, slope = gradients(at + offsets)
        if not (np.isfinite(value[0]) and np.all(np.isfinite(slope))):
            return None
        curvature = -(slope[1 : size + 1] - slope[size + 1 :]) / (2 * apart[:, None])
        found, axes = np.linalg.eigh((curvature + curvature.T) / 2)
        strength = np.maximum(np.abs(found), _FLAT * np.abs(found).max() or 1.0)
        step = axes @ (axes.T @ slope[0] / strength)
        if slope[0] @ step < _DECREMENT:
            flat = found.min() <= _FLAT * found.max()
            return None if flat else NormalProposal(start + scale * at, scale[:, None] * axes / np.sqrt(found))
        shorter = at + 0.5 ** np.arange(2 * size + 1)[:, None] * step
        heights = gradients(shorter)[0]
        best = int(np.nanargmax(np.where(np.isfinite(heights), heights, -np.inf)))
        if not heights[best] > value[0]:
            return None
        at = shorter[best]
        apart = _DIFFERENCE / np.sqrt(np.maximum(np.abs(np.diag(curvature)), strength.max() * _FLAT))
    return None


def differentiable(log_density: BatchedDensity, start: np.ndarray, scale: np.ndarray) -> Single | None:
    """Return the log density of one point (x − start)/scale, (D,); None where JAX cannot differentiate it.

    None as well in single precision, where differences of gradients tell no curvature.
    """

    def single(scaled: jax.Array) -> jax.Array:
        return jnp.asarray(log_density(jnp.asarray(start + scale * scaled)[None]))[0]  # pyright: ignore

    if not jax.config.jax_enable_x64:
        return None
    try:
        jax.make_jaxpr(jax.value_and_grad(single))(jnp.zeros(len(start)))
    # Whatever the function does not take: it is of NumPy, it branches on values, it calls other programs.
    except Exception:
        return None
    return single


# Starts are wider than the target is said to be, so that a second mode nearby is met by one of the ensembles.
_OVERDISPERSION = 2.0
# Without a Laplace proposal the starts are no draws of the target: 150 of these steps are left out as burn-in.
_LEAST_STEPS = 400
# Walkers that give less than some effective draws in so many steps will mostly never do.
_MOST_STEPS = 5000
# Draws whose importance weights judge a proposal, of all ensembles together.
_TRIAL = 4000
# A proposal that is taken less often is no help, and one that misses this share of the mass, and more than so many
# standard errors of it, is no measure.
_LEAST_ACCEPTANCE, _MISSED, _ERRORS = 0.1, 0.05, 4.0


@dataclass(frozen=True)
class Samples:
    """Draws from a log density.

    Attributes
    ----------
    names : of the D parameters.
    chains : draws, log densities, acceptance and convergence, with burn-in removed.

    Examples
    --------
    >>> import imubayes
    >>> found = imubayes.sample(lambda x: -0.5 * (x**2).sum(axis=1), [0.0, 0.0], names=["a", "b"])
    >>> found.names, found.draws.shape[1]
    (('a', 'b'), 2)
    """

    names: tuple[str, ...]
    chains: Chains

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
        """What did not converge, in a sentence; empty where all did."""
        return self.chains.diagnosis.message

    @property
    def blind_to(self) -> str:
        """What `converged` cannot see, in a sentence: distant modes."""
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
    log_density: BatchedDensity,
    start: np.ndarray | Sequence[float],
    scale: np.ndarray | Sequence[float] | float = 1.0,
    names: Sequence[str] = (),
    *,
    settings: Settings | None = None,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    progress: Callable[[str], None] | None = None,
) -> Samples:
    """Sample a log density of your own by independent ensembles of stretch and differential-evolution moves.

    A function that JAX can differentiate, in double precision, is sampled from its mode and Laplace covariance, where
    these hold it; where they do not, by Hamiltonian Monte Carlo that follows the local geometry, as of a funnel, if
    `imubayes[gradient]` is installed.  The ensembles run until nested R̂ and the effective sample sizes of all
    parameters and of the log density are sufficient, or `settings.most_steps` (5000 where it is 0 and there is no
    proposal) is reached.  A mode that no walker came near is not seen.

    Parameters
    ----------
    log_density : points (n, D) → (n,), up to a constant; −∞ or NaN where the density is zero.  A JAX function of one
        point becomes such a function by ``jax.jit(jax.vmap(function))``.
    start : shape (D,), a point within the bulk of the density.
    scale : shape (D,) or one for all, the rough standard deviation of each parameter.
    names : of the D parameters; ``x0``, ``x1``, … where none are given.
    settings : number of ensembles and walkers, seed, fewest and most steps.
    checkpoint : file in which the chains are kept; a temporary one where None.
    resume : continue the checkpoint.
    progress : called with a line on the steps done and how far the chains are from their goals.

    Raises
    ------
    InputError
        for names that do not fit the start, a log density of another shape or not finite at any start, and a
        checkpoint to be resumed that is missing, damaged or of other parameters or settings.

    Examples
    --------
    >>> import imubayes
    >>> normal = imubayes.sample(lambda x: -0.5 * (x**2).sum(axis=1), [0.0, 0.0], names=["a", "b"])
    >>> normal.converged
    True
    """
    settings = settings or Settings()
    centre = np.atleast_1d(np.asarray(start, dtype=float))
    widths = np.broadcast_to(np.asarray(scale, dtype=float), centre.shape)
    names = tuple(names) or tuple(f"x{place}" for place in range(len(centre)))
    wide = NormalProposal(centre, np.diag(_OVERDISPERSION * widths))
    _check(log_density, _starts(wide, None, settings)[0], names)
    density, scaled = _without_nan(log_density), differentiable(log_density, centre, widths)
    laplace = None if scaled is None else normal_about_mode(scaled, centre, widths)
    weighed = _weighed(density, laplace, wide, settings)
    gradients = None if weighed is not None or scaled is None else gradient_move(scaled, centre, widths)
    starts = _starts(wide, weighed, settings)
    settings = settings if weighed is not None else _of_some_length(settings)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(checkpoint) if checkpoint is not None else Path(folder) / "checkpoint.h5"
        file = _checkpoint(path, starts[0].shape, names, settings, resume)
        return Samples(names, sample_ensembles(density, starts, names, settings, file, weighed, progress, gradients))


def _of_some_length(settings: Settings) -> Settings:
    """Return the settings with lengths for chains without a proposal where they state none."""
    least = settings.least_steps or _LEAST_STEPS
    return replace(settings, least_steps=least, most_steps=settings.most_steps or max(least, _MOST_STEPS))


def _starts(wide: NormalProposal, weighed: WeighedProposal | None, settings: Settings) -> list[np.ndarray]:
    """Return the first points of each ensemble, (walkers, D): about the start, or of a proposal by its weights.

    A walker that begins where a proposal is next to impossible would stay there for as long as its weight is large.
    """
    walkers, random = walkers_for(wide.dimensions, settings), np.random.default_rng([settings.seed, 1])
    if weighed is not None:
        state = np.random.RandomState(random.integers(2**32, size=4))
        return [weighed.resampled(ensemble, walkers, state) for ensemble in range(settings.ensembles)]
    size = (settings.ensembles * walkers, wide.dimensions)
    return np.split(wide.to_point(random.normal(size=size))[0], settings.ensembles)


def _weighed(
    density: BatchedDensity, laplace: NormalProposal | None, wide: NormalProposal, settings: Settings
) -> WeighedProposal | None:
    """Return the Laplace approximation with its weights; None where it does not hold the density."""
    if laplace is None:
        return None
    count = max(_TRIAL, walkers_for(wide.dimensions, settings) * settings.ensembles) // settings.ensembles
    weighed = weigh_tail(density, laplace, settings.ensembles, count, settings.seed)
    about_start = weigh(density, wide, settings.ensembles, count, settings.seed)
    if weighed is None or weighed.pareto_k > WORST_PARETO_K or weighed.acceptance < _LEAST_ACCEPTANCE:
        return None
    if about_start is not None:
        excess = np.exp(about_start.log_mass - weighed.log_mass) - 1
        if excess > max(_MISSED, _ERRORS * np.hypot(about_start.mass_error, weighed.mass_error)):
            return None
    return weighed


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


def _without_nan(log_density: BatchedDensity) -> BatchedDensity:
    def density(points: np.ndarray) -> np.ndarray:
        values = np.asarray(log_density(points))
        return np.where(np.isnan(values), -np.inf, values)

    return density


def _check(log_density: BatchedDensity, points: np.ndarray, names: tuple[str, ...]) -> None:
    """Raise InputError unless names and log density fit the points (n, D)."""
    if len(names) != points.shape[1]:
        what = f"{len(names)} names for {points.shape[1]} parameters"
        raise input_error(what, "names", "one name per entry of `start`", "give as many names as parameters")
    values = np.asarray(log_density(points))
    if values.shape != points.shape[:1]:
        raise input_error(
            f"the log density of points {points.shape} has shape {values.shape}",
            "log_density",
            f"shape {points.shape[:1]}, one value per point",
            "vectorise it: `jax.vmap(function)`, or a loop over the points",
        )
    if not np.isfinite(values).any():
        raise input_error(
            "the log density is not finite at any starting point",
            "log_density, start, scale",
            "a start within the bulk of the density",
            "choose another start, or a smaller scale",
        )
