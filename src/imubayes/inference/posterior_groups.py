"""The groups of ArviZ's schema: draws with named dimensions, and every group that model criticism asks for.

They are arrays alone, which `imubayes.results.posterior_file` writes and `imubayes.results.posterior_tree` hands to
ArviZ as a tree of xarray, which takes long to import.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import jax
import jax.numpy as jnp
import numpy as np

from imubayes.array_shapes import Array, Float
from imubayes.gather import in_batches
from imubayes.inference.ensemble_sampling import Chains
from imubayes.inference.fitted_model import Fit, Posterior, evenly_spaced
from imubayes.inference.posterior_variables import SAMPLE, Labelled, Labels, Variable, variables_of
from imubayes.inference.run_fit import data_hash, model_hash
from imubayes.kept_programs import kept
from imubayes.model.bind import Model
from imubayes.model.likelihood import entry_log_likelihood
from imubayes.model.noise_covariance import noise_distribution
from imubayes.model.problem import Problem, predict_many
from imubayes.model.student_t import heavy_tailed
from imubayes.units import to_si

# The dimension of what was measured.
ENTRY = "entry"
# Likelihoods are kept for so many values (4 MB), of so many draws at least, without which PSIS-LOO tells nothing, and
# at most; outputs are replicated of the same draws, as LOO-PIT asks for, and of a quarter as many of the prior.
_KEPT_VALUES, _FEWEST_KEPT, _MOST_KEPT = 1_000_000, 100, 1000
_PRIOR_SHARE, _BATCH = 4, 20
# Share of the noise of an entry below which the rounding of single precision matters to nothing.
_ROUNDING = 0.05
# Independent draws are divided into chains, since diagnostics of chains compare several.
_INDEPENDENT_CHAINS = 4


@dataclass(frozen=True)
class Group:
    """A group: variables by name, the coordinates of their dimensions and of other labels, and attributes."""

    variables: Mapping[str, Labelled]
    coordinates: Mapping[str, Labelled]
    attributes: Mapping[str, str | int] = field(default_factory=dict)


@dataclass(frozen=True)
class Groups:
    """All groups by name, and what is said of the whole."""

    named: Mapping[str, Group]
    attributes: Mapping[str, str | int]


@kept
def _likelihoods(problem: Problem, draws: Float[Array, "n EH"]) -> Float[Array, "n 3 E"]:
    """Return noise scale, tail and log likelihood of every entry, for draws of predictions and noise scales in z."""
    count = len(problem.observations.value)

    def of_draw(draw):
        predicted, h = draw[:count], draw[count:]
        pieces = entry_log_likelihood(problem, problem.observations.value - predicted, h)
        law = noise_distribution(problem, h)
        own = jnp.where(problem.observations.weight > 0, law.squared_scale, 0.0)
        tail = jnp.zeros_like(own) if law.tail is None else jnp.broadcast_to(law.tail, own.shape)
        return jnp.stack([jnp.sqrt(own), tail, pieces.entry])

    return jax.vmap(of_draw)(draws)


@kept
def _values(problem: Problem, points: Float[Array, "n PH"]) -> Float[Array, "n PH"]:
    size = problem.size[0]
    return jax.vmap(
        lambda point: jnp.concatenate([problem.priors.values(point[:size]), problem.hyper_priors.values(point[size:])])
    )(points)


def in_units(model: Model, points: np.ndarray) -> np.ndarray:
    """Return points (…, P + H) in z as values in datasheet units."""
    factors = np.concatenate([model.layout.factors(), model.hyper_layout.factors()])
    flat = points.reshape(-1, points.shape[-1])
    return np.asarray(_values(model.problem, flat)).reshape(points.shape) / factors


def posterior_groups(fit: Fit) -> Groups:
    """Return prior, posterior, predictive, likelihood and data groups of a fit, for ArviZ.

    A variable has a dimension for each kind of label of its members, and no gaps (`posterior_variables`).  A chain is
    an ensemble: its walkers, which are not independent of each other, follow one another, each with its steps in order,
    so that the autocorrelation and R̂ that ArviZ computes are those of steps and of independent ensembles.  A fit that
    was not sampled has four chains of independent draws from the Laplace approximation.  Predictions and likelihoods
    are of evenly spaced draws of each chain.

    Raises
    ------
    ValueError
        for a fit without posterior draws.
    """
    posterior, model = fit.posterior, fit.model
    if posterior is None:
        raise ValueError("the fit has no posterior draws")
    chains, problem = posterior.chains, model.problem
    draws, prior = (
        by_ensemble(posterior.points, chains),
        _prior_points(model.problem, posterior, np.random.default_rng(1)),
    )
    random = np.random.default_rng(2)
    kept = draws[:, evenly_spaced(draws.shape[1], min(draws.shape[1], _kept(len(model.entries), len(draws))))]
    predicted, likelihood = _predicted(problem, kept, random)
    prior_predicted, _ = _predicted(problem, prior[None, : kept.shape[0] * kept.shape[1] // _PRIOR_SHARE], random)
    own, derived, labels = variables_of(fit)

    def parameters(own_draws: np.ndarray, derived_draws: np.ndarray) -> Group:
        found = _variables(own, own_draws) | _variables(derived, derived_draws)
        return Group(found, _coordinates(found, labels) | _sample_coordinates(own_draws))

    groups = {
        "posterior": parameters(in_units(model, draws), by_ensemble(posterior.derived, chains)),
        "prior": parameters(in_units(model, prior)[None], posterior.prior_derived[None]),
        "posterior_predictive": _outputs(model, predicted),
        "prior_predictive": _outputs(model, prior_predicted),
        "log_likelihood": _at_entries(model, likelihood, "log density of an entry given the others of its run"),
        "observed_data": _outputs(model, model.entries.value),
        "constant_data": _constant_data(model),
    }
    if chains is not None:
        density = by_ensemble(chains.log_density.reshape(-1, 1), chains)[..., 0]
        _, steps, walkers, _ = chains.points.shape
        about = {"walkers": walkers, "steps": steps, "order": "draw = walker · steps + step"}
        groups["sample_stats"] = Group({"lp": Labelled(SAMPLE, density)}, _sample_coordinates(density), about)
    whole = _attributes(fit)
    groups = {name: replace(group, attributes={**group.attributes, **whole}) for name, group in groups.items()}
    return Groups(groups, whole)


def by_ensemble(draws: np.ndarray, chains: Chains | None) -> np.ndarray:
    """Return flat draws (S, D) as (chain, draw, D): a chain is an ensemble, or a part of the independent draws.

    Walker after walker, each with its steps in order.  Joined step by step, neighbours would be of different walkers,
    the autocorrelation would vanish at short lags, and effective sizes would be those of independent draws.
    """
    if chains is None:
        return draws.reshape(_INDEPENDENT_CHAINS, -1, draws.shape[-1])
    ensembles, steps, walkers, _ = chains.points.shape
    return draws.reshape(ensembles, steps, walkers, -1).swapaxes(1, 2).reshape(ensembles, walkers * steps, -1)


def _kept(entries: int, chains: int) -> int:
    """Return for how many draws of each chain predictions and likelihoods are kept."""
    return int(np.clip(_KEPT_VALUES // max(entries, 1), _FEWEST_KEPT, _MOST_KEPT)) // chains


def _prior_points(problem: Problem, posterior: Posterior, random: np.random.Generator) -> np.ndarray:
    """Return draws of the prior in z, (S″, P + H)."""
    parameters = posterior.prior_points
    noise = random.normal(size=(len(parameters), posterior.points.shape[1] - parameters.shape[1]))
    correlation = problem.hyper_correlation
    return np.concatenate([parameters, noise if correlation is None else correlation.coloured(noise)], axis=1)


def _predicted(problem: Problem, draws: np.ndarray, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return replicated outputs and log likelihoods of draws in z (chain, draw, P + H), each (chain, draw, E)."""
    size, points = problem.size[0], draws.reshape(-1, draws.shape[-1])
    predicted = predict_many(problem, points[:, :size])
    # One compiled function for any number of draws.
    both = np.concatenate([predicted, points[:, size:]], axis=1)
    deviation, tail, entry = np.moveaxis(in_batches(lambda part: _likelihoods(problem, part), both, _BATCH), 1, 0)
    alone = random.normal(size=predicted.shape) * heavy_tailed(tail, random)
    replicated = predicted + deviation * alone
    rounding = np.abs(replicated) * np.finfo(np.float32).eps / 2
    if np.all(rounding <= _ROUNDING * deviation):
        replicated = replicated.astype(np.float32)
    return tuple(part.reshape(*draws.shape[:2], -1) for part in (replicated, entry.astype(np.float32)))


def _variables(variables: Mapping[str, Variable], draws: np.ndarray) -> dict[str, Labelled]:
    """Return variables of draws (chain, draw, D)."""
    return {name: variable.of(draws) for name, variable in variables.items()}


def _coordinates(variables: Mapping[str, Labelled], labels: Mapping[str, Labels]) -> dict[str, Labelled]:
    used = dict.fromkeys(name for variable in variables.values() for name in variable.dimensions if name not in SAMPLE)
    return {name: Labelled((name,), np.array(labels[name])) for name in used}


def _sample_coordinates(draws: np.ndarray) -> dict[str, Labelled]:
    return {name: Labelled((name,), np.arange(size)) for name, size in zip(SAMPLE, draws.shape, strict=False)}


def _outputs(model: Model, values: np.ndarray) -> Group:
    """Return outputs (…, E) in output units, closing rotations in degrees."""
    return _at_entries(model, values * np.where(model.entries.closing, 1 / to_si("deg"), 1.0))


def _at_entries(model: Model, values: np.ndarray, meaning: str = "") -> Group:
    """Return what belongs to the entries, (…, E), with run, channel and row of each."""
    sample = _sample_coordinates(values) if values.ndim > 1 else {}
    about = {"long_name": meaning} if meaning else {}
    return Group({"output": Labelled((*sample, ENTRY), values, about)}, _entry_coordinates(model) | sample)


def _entry_coordinates(model: Model) -> dict[str, Labelled]:
    entries = model.entries
    run = np.array([run.name for run in model.campaign.runs])[entries.run]
    labels = {"run": run, "channel": _channel_names(model)[entries.channel], "row": entries.row}
    return {name: Labelled((ENTRY,), values) for name, values in (labels | {ENTRY: np.arange(len(entries))}).items()}


def _channel_names(model: Model) -> np.ndarray:
    return np.array([*(channel.name for channel in model.campaign.channels), "closure_x", "closure_y", "closure_z"])


def _constant_data(model: Model) -> Group:
    """Return what is known of the entries: run, channel, row, number of samples and unit of the output."""
    entries, channels = model.entries, model.campaign.channels
    units = np.array([*(channel.output_unit for channel in channels), "deg", "deg", "deg"])[entries.channel]
    found = {"samples": Labelled((ENTRY,), entries.samples), "unit": Labelled((ENTRY,), units)}
    return Group(found, _entry_coordinates(model))


def _attributes(fit: Fit) -> dict[str, str | int]:
    sampled = fit.posterior is not None and fit.posterior.chains is not None
    return {
        "creation_library": "imubayes",
        "inference_library": "emcee" if sampled else "imubayes, Laplace approximation",
        "campaign": fit.model.campaign.name,
        "model": fit.model.spec.name,
        "data_sha256": data_hash(fit.model),
        "model_sha256": model_hash(fit.model),
        "converged": int(fit.converged),
        "interval": "95 % equal-tailed where an interval is given",
    }
