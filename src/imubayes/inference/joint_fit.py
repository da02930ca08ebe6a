"""The whole way: from a declared model to a posterior and everything that is derived from it."""

import hashlib
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from imubayes.errors import InputError, Issue
from imubayes.inference.checkpoint import Checkpoint
from imubayes.inference.ensemble_sampling import Chains, Settings, sample, walkers_for
from imubayes.inference.fitted import Fitted
from imubayes.inference.laplace_move import LaplaceProposal, LogDensity
from imubayes.inference.nested_laplace import NestedLaplace, nested_laplace
from imubayes.inference.posterior_mode import Mode, find_mode, fit_at, heights, message
from imubayes.model.bind import Model
from imubayes.model.derived_quantities import Derived, derive, derive_many
from imubayes.model.problem import Problem

# Starts are compared by their log density: within this they are the same mode or one as good, beyond the second
# they are out of the running whatever their width.
_SAME, _HOPELESS = 0.5, 30.0
_DISPERSED = 3
_PRIOR_DRAWS, _LAPLACE_DRAWS, _DERIVED_DRAWS = 2000, 4000, 4000

Progress = Callable[[str], None]


@dataclass(frozen=True)
class JointFit:
    """A joint fit with its posterior.

    Attributes
    ----------
    model, derived : what was fitted.
    mode : where the fit ended.
    approximation : the nested Laplace approximation; None where the fit did not converge.
    chains : the sampled posterior; None where it was not sampled.
    points : shape (S, P + H), draws in z: sampled, or of the Laplace approximation.
    derived_draws, prior_derived : shapes (S′, D) and (S″, D), in the units of their names.
    seconds : time spent, by step.
    """

    model: Model
    derived: Derived
    mode: Mode
    approximation: NestedLaplace | None
    chains: Chains | None
    points: np.ndarray
    derived_draws: np.ndarray
    prior_derived: np.ndarray
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def converged(self) -> bool:
        """Whether the fit, and the sampling where there was any, converged."""
        return bool(self.mode.converged) and (self.chains is None or self.chains.diagnosis.converged)

    @property
    def message(self) -> str:
        """What did not converge, in a sentence; empty where all did."""
        if not bool(self.mode.converged):
            return message(self.mode)
        return self.chains.diagnosis.message if self.chains is not None else ""

    @property
    def derived_from(self) -> np.ndarray:
        """Which of the points the derived draws were made of, (S′,)."""
        return _spread_over(self.points, len(self.derived_draws))

    @property
    def fitted(self) -> Fitted:
        """The model with its mode, without what was derived from it."""
        return Fitted(self.model, np.asarray(self.mode.z), np.asarray(self.mode.h), self.converged, self.message)


def joint_fit(
    model: Model,
    sampling: Settings | None,
    checkpoint: Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
    start: tuple[np.ndarray, np.ndarray] | None = None,
) -> JointFit:
    """Fit a model and sample its posterior.

    Parameters
    ----------
    model : as declared.
    sampling : how to sample; None for the Laplace approximation alone.
    checkpoint : file that the sampling is kept in; a temporary one where None.
    resume : continue the checkpoint.
    progress : called with a short text as the work goes on.
    start : z and h to begin the fit at, where a fit of nearly the same model is known; the middle of the prior where
        None.  Other places are tried only where the posterior is to be sampled, or no start is known.

    Raises
    ------
    InputError
        where a checkpoint is to be resumed that belongs to another fit.
    """
    tell = progress or (lambda text: None)
    _require_double_precision()
    clock = time.perf_counter()
    seconds = {}
    problem = model.problem
    with tempfile.TemporaryDirectory() as folder:
        file = _checkpoint(model, sampling, checkpoint or Path(folder) / "checkpoint.h5") if sampling else None
        if file is not None and resume:
            file.check()
        tell("fitting")
        settings = sampling or Settings()
        dispersed = _DISPERSED if sampling is not None or start is None else 0
        mode, others = _best_start(problem, settings.seed, start, dispersed)
        derived = derive(model.assembly)
        if not bool(mode.converged):
            return _unconverged(model, derived, mode, {"fit": time.perf_counter() - clock})
        approximation = nested_laplace(problem, mode)
        proposal = LaplaceProposal(approximation, problem)
        seconds["fit"], clock = time.perf_counter() - clock, time.perf_counter()
        chains = None
        if sampling is not None and file is not None:
            if not resume:
                file.create()
            starts = _starts(proposal, mode, others, file, sampling)
            names = model.layout.names + model.hyper_layout.names

            def report(steps: int, word: str) -> None:
                tell(f"sampling: {steps} steps" + (f" ({word})" if word else ""))

            density = LogDensity(problem, walkers_for(sum(problem.size), settings) // 2)
            chains = sample(density, starts, names, sampling, file, proposal, report)
            points = chains.points.reshape(-1, chains.points.shape[-1])
        else:
            points = proposal.draw(np.random.RandomState(0), _LAPLACE_DRAWS)
        seconds["sample"] = time.perf_counter() - clock
    tell("deriving")
    draws, prior = _derived_draws(derived, problem, points)
    return JointFit(model, derived, mode, approximation, chains, points, draws, prior, seconds)


def _require_double_precision() -> None:
    if jnp.result_type(float) != jnp.float64:
        raise InputError(
            Issue(
                "JAX runs in single precision",
                "this Python process",
                "float64: a part in a million of a scale factor is lost in float32",
                'call jax.config.update("jax_enable_x64", True) before the first computation',
            )
        )


def _checkpoint(model: Model, sampling: Settings, path: Path) -> Checkpoint:
    dimensions = len(model.layout) + len(model.hyper_layout)
    walkers = walkers_for(dimensions, sampling)
    fingerprints = {
        "data": data_hash(model),
        "model": model_hash(model),
        "parameters": _digest("\n".join(model.layout.names + model.hyper_layout.names).encode()),
        "sampler": f"seed {sampling.seed}, {sampling.ensembles} ensembles of {walkers} walkers",
    }
    return Checkpoint(path, sampling.ensembles, walkers, dimensions, fingerprints)


def _digest(*parts: bytes) -> str:
    return hashlib.sha256(b"\0".join(parts)).hexdigest()


def data_hash(model: Model) -> str:
    """Return the SHA-256 of everything measured and of the nominal stimulus."""
    problem = model.problem
    arrays = jax.tree.leaves((problem.instants, problem.observations, problem.channels, problem.transitions))
    return _digest(*(np.ascontiguousarray(array).tobytes() for array in arrays))


def model_hash(model: Model) -> str:
    """Return the SHA-256 of the model: its effects with channels, priors and settings, in order."""
    listed = sorted(repr(replace(one, where="")) for one in model.spec.effects)
    sources = [Path(file).read_text() for file in model.spec.files]
    return _digest(*(text.encode() for text in (*listed, *sources)))


def _best_start(
    problem: Problem,
    seed: int,
    start: tuple[np.ndarray, np.ndarray] | None,
    dispersed: int,
) -> tuple[Mode, list[np.ndarray]]:
    """Fit from the start and from draws of the prior; return the best, and other ends worth a look."""
    size, hyper_size = problem.size
    z, h = start if start is not None else (np.zeros(size), np.zeros(hyper_size))
    mode = find_mode(problem, jnp.asarray(z), jnp.asarray(h))
    random = np.random.default_rng([seed, 1])
    ends = [fit_at(problem, jnp.asarray(random.normal(size=size)), mode.h) for _ in range(dispersed)]
    here, *densities = heights(problem, [mode.z, *ends], mode.h).tolist()
    best = int(np.argmax(densities)) if densities else -1
    if densities and (densities[best] > here + _SAME or (not bool(mode.converged) and np.isfinite(densities[best]))):
        again = find_mode(problem, ends[best], mode.h)
        if bool(again.converged) or not bool(mode.converged):
            mode, here = again, float(heights(problem, [again.z], again.h)[0])
    others = [
        np.asarray(end) for end, height in zip(ends, densities, strict=True) if here - _HOPELESS < height < here - _SAME
    ]
    return mode, others


def _starts(
    proposal: LaplaceProposal, mode: Mode, others: list[np.ndarray], file: Checkpoint, sampling: Settings
) -> list[np.ndarray]:
    """Return the first points of each ensemble: about the mode, or about another place a dispersed fit ended at."""
    starts = []
    for ensemble in range(sampling.ensembles):
        random = np.random.RandomState(np.random.SeedSequence([sampling.seed, ensemble, 7]).generate_state(4))
        points = proposal.draw(random, file.walkers)
        if 0 < ensemble <= len(others):
            points[:, : len(mode.z)] += others[ensemble - 1] - np.asarray(mode.z)
        starts.append(points)
    return starts


def _derived_draws(derived: Derived, problem: Problem, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    size = problem.size[0]
    chosen = _spread_over(points, _DERIVED_DRAWS)
    prior = np.random.default_rng(0).normal(size=(_PRIOR_DRAWS, size))
    both = np.concatenate([points[chosen, :size], prior])
    values = derive_many(derived.derivation, problem, both)
    return values[:_DERIVED_DRAWS], values[_DERIVED_DRAWS:]


def _spread_over(points: np.ndarray, count: int) -> np.ndarray:
    """Return places of so many points, evenly over all."""
    return np.linspace(0, len(points) - 1, count).astype(int)


def _unconverged(model: Model, derived: Derived, mode: Mode, seconds: dict[str, float]) -> JointFit:
    parameters, hyperparameters = model.problem.size
    nothing = np.full((1, parameters + hyperparameters), np.nan)
    missing = np.full((1, len(derived.names)), np.nan)
    return JointFit(model, derived, mode, None, None, nothing, missing, missing, seconds)
