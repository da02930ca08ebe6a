"""The joint fit: from a bound model to its mode, posterior draws and derived quantities."""

import hashlib
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np

from imubayes.foundations.arrays import Array, Float
from imubayes.foundations.deferred_modules import DeferredModule
from imubayes.foundations.errors import input_error
from imubayes.foundations.progress import counted
from imubayes.inference.chains import Chains, Settings, thinned, walkers_for
from imubayes.inference.checkpoint import Checkpoint
from imubayes.inference.fitted_model import Fit, Posterior
from imubayes.inference.laplace_proposal import LaplaceProposal, LogDensity, WeighedProposal, weigh_tail
from imubayes.inference.nested_laplace import NestedLaplace, nested_laplace
from imubayes.inference.noise_scale_modes import NEGLIGIBLE, ScaleModes, modes_of_scales, posterior_points
from imubayes.inference.parameter_fit import fit_at
from imubayes.inference.plausibility import implausible_estimates, unexplained_outputs
from imubayes.inference.posterior_mode import Mode, find_mode, heights, log_evidence, message
from imubayes.model.bind import Model
from imubayes.model.carried_motion import first_point
from imubayes.model.derived_quantities import evaluate_derived
from imubayes.model.problem import Problem, compile_predictions

if TYPE_CHECKING:
    from imubayes.inference import ensemble_sampling
else:
    ensemble_sampling = DeferredModule("imubayes.inference.ensemble_sampling")

# Starts are compared by their log density: within this they are the same mode or one as good, beyond the second
# they are out of the running whatever their width.
_SAME, _HOPELESS = 0.5, 30.0
_DISPERSED = 3
# Draws whose importance weights judge the proposal, of all ensembles together.
_TRIAL = 4000
# An end of the 95 % interval of a normal posterior has a Monte Carlo error of 2.67 u/√n.  At 11 400 draws twice that is
# half a unit of the first digit of u (JCGM 101, 7.9), a twentieth of a u that begins with 9; and a margin for the error
# of the error itself.
PRIOR_DRAWS, LAPLACE_DRAWS = 2000, 16_000

FAILED = "The fit failed: it ended at values that no working unit on the stated equipment has."

Progress = Callable[[str], None]


def joint_fit(
    model: Model,
    sampling: Settings | None,
    checkpoint: Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
    start: tuple[np.ndarray, np.ndarray] | None = None,
    laplace_draws: int | np.ndarray = LAPLACE_DRAWS,
) -> Fit:
    """Fit a model and sample its posterior.

    Parameters
    ----------
    model : as declared.
    sampling : how to sample; None for the Laplace approximation alone.
    checkpoint : file that the sampling is kept in; a temporary one if None.
    resume : continue the checkpoint.
    progress : called with a short text as the work goes on.
    start : z and h to begin the fit at, if a fit of nearly the same model is known; the middle of the prior if
        None.  Other starts are tried only if the posterior is to be sampled, or none is known.
    laplace_draws : number of draws of the Laplace approximation, or standard normal vectors (S, P + H) to make them of.

    Raises
    ------
    InputError
        if a checkpoint is to be resumed that belongs to another fit.
    """
    tell = progress or (lambda text: None)
    _require_double_precision()
    clock = time.perf_counter()
    problem = model.problem
    with tempfile.TemporaryDirectory() as folder:
        file = _checkpoint(model, sampling, checkpoint or Path(folder) / "checkpoint.h5") if sampling else None
        if file is not None and resume:
            file.check()
        fit, found, others = _at_modes(model, sampling, start, tell)
        if found is None or not fit.converged:
            return replace(fit, seconds={"fit": time.perf_counter() - clock})
        mode, others = found.highest, [*others, *(np.asarray(lower.z) for lower in found.lower)]
        approximation = nested_laplace(problem, mode, found.marginal)
        proposal = LaplaceProposal(approximation, problem)
        seconds, clock = {"fit": time.perf_counter() - clock}, time.perf_counter()
        if sampling is not None and file is not None:
            if not resume:
                file.create()
            chains = thinned(_sampled(model, proposal, mode, others, sampling, file, tell), sampling.most_kept)
            points = chains.points.reshape(-1, chains.points.shape[-1])
            fit = replace(fit, sampled=chains.diagnosis.converged, message=chains.diagnosis.message)
        else:
            chains, points = None, posterior_points(problem, found, approximation, laplace_draws)
        seconds["sample"] = time.perf_counter() - clock
    tell("deriving quantities")
    return replace(fit, posterior=posterior_of_draws(fit, points, approximation, chains), seconds=seconds)


def mode_fit(model: Model, progress: Progress | None = None) -> Fit:
    """Return a fit at the mode of its parameters and noise scales, without a posterior."""
    _require_double_precision()
    return _at_modes(model, None, None, progress or (lambda text: None))[0]


def _at_modes(
    model: Model, sampling: Settings | None, start: tuple[np.ndarray, np.ndarray] | None, tell: Progress
) -> tuple[Fit, ScaleModes | None, list[np.ndarray]]:
    """Return the fit at the highest mode, the modes of noise scales, and other ends worth a look.

    There are no modes of scales if the first one did not converge.
    """
    tell("fitting: mode")
    mode, others = _best_start(model, sampling, start, tell)
    fit = judged_fit(model, mode)
    if not fit.converged:
        return fit, None, others
    tell("fitting: noise scales")
    found = modes_of_scales(model.problem, mode)
    return judged_fit(model, found.highest), found, others


def judged_fit(model: Model, mode: Mode) -> Fit:
    """Return the fit at a mode; one without convergence if its estimates cannot be of the unit and the set-up."""
    z, h = np.asarray(mode.z), np.asarray(mode.h)
    if not bool(mode.converged):
        return Fit(model, z, h, False, message(mode), mode)
    implausible = implausible_estimates(model, z, h)
    unexplained = unexplained_outputs(model, np.asarray(mode.about.misfit))
    failed = FAILED if implausible or unexplained else ""
    return Fit(model, z, h, not failed, failed, mode, implausible=implausible, unexplained=unexplained)


def _sampled(
    model: Model,
    proposal: LaplaceProposal,
    mode: Mode,
    others: list[np.ndarray],
    sampling: Settings,
    file: Checkpoint,
    tell: Progress,
) -> Chains:
    names = model.layout.names + model.hyper_layout.names
    density = LogDensity(model.problem, file.walkers // 2)
    tell("sampling: weighing the proposal")
    count = max(_TRIAL, file.walkers * sampling.ensembles) // sampling.ensembles
    weighed = weigh_tail(density, proposal, sampling.ensembles, count, sampling.seed)
    others = [end for end in others if not _negligible(model.problem, end, mode)]
    starts = _starts(proposal, weighed, mode, others, file, sampling)
    return ensemble_sampling.sample(density, starts, names, sampling, file, weighed, tell)


def _require_double_precision() -> None:
    if jnp.result_type(float) != jnp.float64:
        raise input_error(
            "JAX runs in single precision",
            "this Python process",
            "float64: a part in a million of a scale factor is lost in float32",
            'call jax.config.update("jax_enable_x64", True) before the first computation',
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
    arrays = jax.tree.leaves((problem.nodes, problem.observations, problem.channels, problem.transitions))
    return _digest(*(np.ascontiguousarray(array).tobytes() for array in arrays))


def campaign_hash(model: Model) -> str:
    """Return what identifies the data: the hash of the files, or of the arrays if there are no files.

    It stands in every file that is made of a fit, so that constants, record and certificate can be held together.
    """
    return model.campaign.digest or data_hash(model)


def model_hash(model: Model) -> str:
    """Return the SHA-256 of the model: its effects with channels, priors and settings, in order."""
    listed = sorted(repr(replace(effect, where="")) for effect in model.spec.effects)
    sources = [Path(file).read_text() for file in model.spec.files]
    correlated = [repr((each.parameters, each.matrix)) for each in model.spec.correlations]
    aside = [each.model_dump_json() for each in model.spec.set_aside]
    classes = [repr(each) for each in model.spec.classes]
    return _digest(*(text.encode() for text in (*listed, *correlated, *sources, *aside, *classes)))


def _best_start(
    model: Model,
    sampling: Settings | None,
    start: tuple[np.ndarray, np.ndarray] | None,
    tell: Progress,
) -> tuple[Mode, list[np.ndarray]]:
    """Fit from the start and from draws of the prior; return the best, and other ends worth a look."""
    problem = model.problem
    _, hyper_size = problem.size
    compile_predictions(problem)
    z, h = start if start is not None else (first_point(model.assembly), np.zeros(hyper_size))
    mode = find_mode(problem, np.asarray(z), np.asarray(h))
    draws = _dispersed(first_point(model.assembly), sampling) if sampling is not None or start is None else []
    ends = [fit_at(problem, draw, mode.h) for draw in counted(tell, "fitting: dispersed start", draws)]
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


def _dispersed(first: np.ndarray, sampling: Settings | None) -> list[Float[Array, " P"]]:
    """Return draws of the prior to begin fits at, with what is estimated beforehand: turns of a unit in motion."""
    random = np.random.default_rng([sampling.seed if sampling else 0, 1])
    draws = [np.asarray(random.normal(size=len(first))) for _ in range(_DISPERSED)]
    return [np.where(first == 0, draw, first) for draw in draws]


def _negligible(problem: Problem, end: np.ndarray, mode: Mode) -> bool:
    """Return whether a fit ended in a mode that holds next to nothing of the posterior, by the Laplace evidence.

    An ensemble that begins there does not leave it, and says what is no matter: that the ensembles disagree.
    """
    there = find_mode(problem, np.asarray(end), mode.h)
    return bool(there.converged) and log_evidence(there) < log_evidence(mode) - NEGLIGIBLE


def _starts(
    proposal: LaplaceProposal,
    weighed: WeighedProposal | None,
    mode: Mode,
    others: list[np.ndarray],
    file: Checkpoint,
    sampling: Settings,
) -> list[np.ndarray]:
    """Return the first points of each ensemble: of the posterior by importance resampling.

    If a dispersed fit ended at another place, an ensemble begins about that.
    """
    starts = []
    for ensemble in range(sampling.ensembles):
        random = np.random.RandomState(np.random.SeedSequence([sampling.seed, ensemble, 8]).generate_state(4))
        if weighed is not None:
            points = weighed.resampled(ensemble, file.walkers, random)
        else:
            points = proposal.draw(random, file.walkers)
        if 0 < ensemble <= len(others):
            points = points.copy()
            points[:, : len(mode.z)] += others[ensemble - 1] - np.asarray(mode.z)
        starts.append(points)
    return starts


def redrawn(fit: Fit, count: int) -> Fit:
    """Return a fit with so many draws of its Laplace approximation."""
    assert fit.posterior is not None
    assert fit.mode is not None
    approximation = fit.posterior.approximation
    problem = fit.model.problem
    points = posterior_points(problem, modes_of_scales(problem, fit.mode), approximation, count)
    return replace(fit, posterior=posterior_of_draws(fit, points, approximation, None))


def posterior_of_draws(fit: Fit, points: np.ndarray, approximation: NestedLaplace, chains: Chains | None) -> Posterior:
    """Return the posterior of draws (S, P + H), with the derived quantities of each and of the prior."""
    size, count = len(fit.z), len(points)
    prior = np.random.default_rng(0).normal(size=(PRIOR_DRAWS, size))
    derived = evaluate_derived(fit.derived.derivation, fit.model.problem, np.concatenate([points[:, :size], prior]))
    return Posterior(points, derived[:count], prior, derived[count:], approximation, chains)
