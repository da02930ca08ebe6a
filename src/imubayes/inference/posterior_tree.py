"""The posterior as an ArviZ tree: named coordinates, and every group that model criticism asks for."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import xarray
from arviz_base import from_dict

from imubayes.inference.ensemble_sampling import burn_in
from imubayes.inference.fit import Fit, evenly_spaced
from imubayes.inference.joint_fit import data_hash, model_hash
from imubayes.model.bind import Model
from imubayes.model.likelihood import entry_log_likelihood
from imubayes.model.noise_covariance import noise_distribution
from imubayes.model.problem import Problem, predict_many
from imubayes.parameters.vector import Layout
from imubayes.simulation.simulate import heavy_tailed

# Predictions and likelihoods are kept for so many draws: enough for every check, and one percent of the space.
_KEPT, _BATCH = 200, 20


@eqx.filter_jit
def _likelihoods(problem: Problem, predicted, h):
    def one(at):
        predicted, h = at
        pieces = entry_log_likelihood(problem, problem.observations.value - predicted, h)
        law = noise_distribution(problem, h)
        own = jnp.where(problem.observations.weight > 0, law.squared_scale, 0.0)
        tail = jnp.zeros_like(own) if law.tail is None else law.tail
        return jnp.sqrt(own), tail, pieces.entry, pieces.group

    # Whole batches: what is left over would be compiled a second time.
    return jax.lax.map(one, (predicted, h), batch_size=_BATCH)


@eqx.filter_jit
def _values(problem: Problem, points):
    size = problem.size[0]
    return jax.vmap(
        lambda point: jnp.concatenate([problem.priors.values(point[:size]), problem.hyper_priors.values(point[size:])])
    )(points)


def in_units(model: Model, points: np.ndarray) -> np.ndarray:
    """Return points (…, P + H) in z as values in datasheet units."""
    factors = np.concatenate([model.layout.factors(), model.hyper_layout.factors()])
    flat = points.reshape(-1, points.shape[-1])
    return np.asarray(_values(model.problem, flat)).reshape(points.shape) / factors


def posterior_tree(fit: Fit) -> xarray.DataTree:
    """Return prior, posterior, predictive, likelihood and data groups of a fit.

    A chain is a walker; the walkers of one ensemble form a superchain, given in `sample_stats`.  An unsampled fit has
    one chain, of draws from the Laplace approximation.
    """
    model, problem = fit.model, fit.model.problem
    assert fit.posterior is not None, "a fit without posterior draws"
    draws, chains = fit.posterior.points, fit.posterior.chains
    if chains is not None:
        ensembles, steps, walkers, _ = chains.points.shape
        points = chains.points.transpose(0, 2, 1, 3).reshape(ensembles * walkers, steps, -1)
        log_density = chains.log_density.transpose(0, 2, 1).reshape(ensembles * walkers, steps)
        superchain = np.repeat(np.arange(ensembles), walkers)
    else:
        points, log_density, superchain = draws[None], None, np.zeros(1, dtype=int)
    kept = evenly_spaced(len(draws), min(_KEPT, len(draws)))
    random = np.random.default_rng(1)
    prior_points = random.normal(size=(_KEPT, draws.shape[1]))
    predicted, entry_likelihood, group_likelihood = _predicted(problem, draws[kept], random)
    prior_predicted, _, _ = _predicted(problem, prior_points, random)
    coordinates, dimensions = {}, {}
    posterior = _by_effect(model.layout, model.hyper_layout, in_units(model, points), coordinates, dimensions)
    prior = _by_effect(model.layout, model.hyper_layout, in_units(model, prior_points)[None], coordinates, dimensions)
    posterior |= _derived(fit, coordinates, dimensions)
    entries, names = model.entries, [channel.name for channel in model.campaign.channels]
    labels = [*names, "closure_x", "closure_y", "closure_z"]
    runs = np.array([run.name for run in model.campaign.runs])
    data = {
        "entry_run": runs[entries.run],
        "entry_channel": np.array(labels)[entries.channel],
        "entry_row": entries.row,
        "samples": entries.samples,
    }
    group = np.asarray(problem.observations.group)
    first = np.unique(group, return_index=True)[1]
    coordinates["piece"] = [f"{runs[entries.run[i]]},{labels[entries.channel[i]]}" for i in first]
    dimensions |= {name: ["entry"] for name in ("output", *data)}
    dimensions |= {"run_and_channel": ["piece"]}
    groups = {
        "posterior": posterior,
        "prior": prior,
        "posterior_predictive": {"output": predicted[None]},
        "prior_predictive": {"output": prior_predicted[None]},
        "log_likelihood": {"output": entry_likelihood[None], "run_and_channel": group_likelihood[None]},
        "observed_data": {"output": entries.value},
        "constant_data": data,
    }
    if log_density is not None:
        groups["sample_stats"] = {"lp": log_density}
    tree = from_dict(
        groups, coords=coordinates, dims=dimensions, attrs={"/": _attributes(fit)}, check_conventions=False
    )
    if "sample_stats" in groups:
        tree["sample_stats"] = xarray.DataTree(
            tree["sample_stats"].to_dataset().assign(superchain=("chain", superchain))
        )
    return tree


def _predicted(problem: Problem, points: np.ndarray, random: np.random.Generator):
    """Return replicated outputs, and log likelihoods per entry and per run and channel."""
    size = problem.size[0]
    predicted = predict_many(problem, points[:, :size])
    deviation, tail, entry, group = (np.asarray(part) for part in _likelihoods(problem, predicted, points[:, size:]))
    alone = random.normal(size=predicted.shape) * heavy_tailed(tail, random)
    return predicted + deviation * alone, entry, group


def _by_effect(layout: Layout, hyper_layout: Layout, values, coordinates, dimensions) -> dict[str, np.ndarray]:
    """Return one array per effect parameter, (chain, draw, labels…), with named coordinates."""
    parameters = layout.parameters + hyper_layout.parameters
    places: dict[str, list[int]] = {}
    for place, parameter in enumerate(parameters):
        places.setdefault(f"{parameter.effect}.{parameter.field}", []).append(place)
    found = {}
    for name, chosen in places.items():
        labels = [parameters[place].label for place in chosen]
        _label(name, labels, coordinates, dimensions)
        found[name] = values[..., chosen]
    return found


def _label(name: str, labels: Sequence[tuple[str, ...]], coordinates: dict, dimensions: dict) -> None:
    """Give a variable one dimension of its own, named after what its values belong to."""
    axis = f"{name}.label"
    coordinates[axis] = [",".join(label) for label in labels]
    dimensions[name] = [axis]


def _derived(fit: Fit, coordinates: dict, dimensions: dict) -> dict[str, np.ndarray]:
    """Return derived quantities by family; they were computed for every so manieth draw, the rest is left empty."""
    assert fit.posterior is not None
    points, chains, draws = fit.posterior.points, fit.posterior.chains, fit.posterior.derived
    ensembles, steps, walkers, _ = chains.points.shape if chains is not None else (1, len(points), 1, 0)
    families: dict[str, list[int]] = {}
    for place, name in enumerate(fit.derived.names):
        families.setdefault(name.name.split("[")[0], []).append(place)
    found = {}
    for family, places in families.items():
        whole = np.full((len(points), len(places)), np.nan)
        whole[fit.posterior.derived_rows] = draws[:, places]
        whole = whole.reshape(ensembles, steps, walkers, len(places)).transpose(0, 2, 1, 3)
        labels = [(fit.derived.names[place].name.split("[")[1].rstrip("]"),) for place in places]
        _label(family, labels, coordinates, dimensions)
        found[family] = whole.reshape(ensembles * walkers, steps, len(places))
    return found


def _attributes(fit: Fit) -> dict[str, str | int]:
    chains = fit.posterior.chains if fit.posterior is not None else None
    return {
        "inference_library": "imubayes",
        "campaign": fit.model.campaign.name,
        "model": fit.model.spec.name,
        "data_sha256": data_hash(fit.model),
        "model_sha256": model_hash(fit.model),
        "burn_in": burn_in(chains.points.shape[1]) if chains is not None else 0,
        "converged": int(fit.converged),
        "interval": "95 % equal-tailed where an interval is given",
    }
