"""The posterior as an ArviZ tree: variables with named dimensions, and every group that model criticism asks for."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import xarray
from arviz_base import from_dict

from imubayes.array_shapes import Array, Float
from imubayes.inference.ensemble_sampling import Chains, burn_in
from imubayes.inference.fitted_model import Fit, Posterior, evenly_spaced
from imubayes.inference.run_fit import data_hash, model_hash
from imubayes.model.bind import Model
from imubayes.model.likelihood import entry_log_likelihood
from imubayes.model.noise_covariance import noise_distribution
from imubayes.model.problem import Problem, predict_many
from imubayes.model.student_t import heavy_tailed

# Predictions and likelihoods are kept for so many draws: enough for every check, and one percent of the space.
_KEPT, _BATCH = 200, 20
# Independent draws are divided into chains, since diagnostics of chains compare several.
_INDEPENDENT_CHAINS = 4
# What the labels of a derived quantity are.
_DERIVED_DIMENSIONS = {
    "scale_factor": ("channel",),
    "mounting_angle": ("channel", "mounting"),
    "axis_angle": ("channel", "second_channel"),
    "delta_k": ("channel", "run"),
}

Labels = dict[str, list[str]]


@eqx.filter_jit
def _likelihoods(problem: Problem, predicted: Float[Array, "n E"], h: Float[Array, "n H"]):
    def of_draw(draw):
        predicted, h = draw
        pieces = entry_log_likelihood(problem, problem.observations.value - predicted, h)
        law = noise_distribution(problem, h)
        own = jnp.where(problem.observations.weight > 0, law.squared_scale, 0.0)
        tail = jnp.zeros_like(own) if law.tail is None else law.tail
        return jnp.sqrt(own), tail, pieces.entry, pieces.group

    # Whole batches: what is left over would be compiled a second time.
    return jax.lax.map(of_draw, (predicted, h), batch_size=_BATCH)


@eqx.filter_jit
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


def posterior_tree(fit: Fit) -> xarray.DataTree:
    """Return prior, posterior, predictive, likelihood and data groups of a fit.

    A variable has a dimension for each kind of label of its members (`channel`, `run`, `mounting`, `table`, `pose`);
    it is NaN where a combination does not exist, and derived quantities also in the draws for which they were not
    computed.  A chain is a walker; the walkers of one ensemble form a superchain, given in `sample_stats`.  A fit that
    was not sampled has four chains of independent draws from the Laplace approximation.

    Raises
    ------
    ValueError
        for a fit without posterior draws.
    """
    posterior = fit.posterior
    if posterior is None:
        raise ValueError("the fit has no posterior draws")
    chains, model = posterior.chains, fit.model
    kept = posterior.points[evenly_spaced(len(posterior.points), min(_KEPT, len(posterior.points)))]
    random = np.random.default_rng(1)
    prior_points = _prior_points(posterior, random)
    predicted, entry_likelihood, group_likelihood = _predicted(model.problem, kept, random)
    prior_predicted, _, _ = _predicted(model.problem, prior_points[:_KEPT], random)
    own, derived = _members(model), _derived_members(fit)
    labels = _label_coordinates(model, {**own, **derived})
    groups = {
        "posterior": _arranged(own, in_units(model, by_walker(posterior.points, chains)), labels)
        | _arranged(derived, by_walker(_all_derived(posterior), chains), labels),
        "prior": _arranged(own, in_units(model, prior_points)[None], labels)
        | _arranged(derived, posterior.prior_derived[None], labels),
        "posterior_predictive": {"output": predicted[None]},
        "prior_predictive": {"output": prior_predicted[None]},
        "log_likelihood": {"output": entry_likelihood[None], "run_and_channel": group_likelihood[None]},
        "observed_data": {"output": model.entries.value},
        "constant_data": _constant_data(model),
    }
    if chains is not None:
        groups["sample_stats"] = {"lp": by_walker(chains.log_density.reshape(-1, 1), chains)[..., 0]}
    dimensions = {name: list(members.dimensions) for name, members in {**own, **derived}.items()}
    dimensions |= {name: ["entry"] for name in ("output", *groups["constant_data"])}
    dimensions |= {"run_and_channel": ["piece"]}
    coordinates = labels | {"piece": _pieces(model)}
    tree = from_dict(
        groups, coords=coordinates, dims=dimensions, attrs={"/": _attributes(fit)}, check_conventions=False
    )
    if chains is not None:
        ensembles, _, walkers, _ = chains.points.shape
        superchain = ("chain", np.repeat(np.arange(ensembles), walkers))
        tree["sample_stats"] = xarray.DataTree(tree["sample_stats"].to_dataset().assign(superchain=superchain))
    return tree


def by_walker(draws: np.ndarray, chains: Chains | None) -> np.ndarray:
    """Return flat draws (S, D) as (chain, draw, D): a chain is a walker, or a part of the independent draws."""
    if chains is None:
        return draws.reshape(_INDEPENDENT_CHAINS, -1, draws.shape[-1])
    ensembles, steps, walkers, _ = chains.points.shape
    return draws.reshape(ensembles, steps, walkers, -1).transpose(0, 2, 1, 3).reshape(ensembles * walkers, steps, -1)


def _prior_points(posterior: Posterior, random: np.random.Generator) -> np.ndarray:
    """Return draws of the prior in z, (S″, P + H)."""
    parameters = posterior.prior_points
    noise = random.normal(size=(len(parameters), posterior.points.shape[1] - parameters.shape[1]))
    return np.concatenate([parameters, noise], axis=1)


def _predicted(problem: Problem, points: np.ndarray, random: np.random.Generator):
    """Return replicated outputs, and log likelihoods per entry and per run and channel."""
    size = problem.size[0]
    predicted = predict_many(problem, points[:, :size])
    deviation, tail, entry, group = (np.asarray(part) for part in _likelihoods(problem, predicted, points[:, size:]))
    alone = random.normal(size=predicted.shape) * heavy_tailed(tail, random)
    return predicted + deviation * alone, entry, group


@dataclass(frozen=True)
class Members:
    """The members of one variable: their columns in the array of draws, and their labels by dimension."""

    dimensions: tuple[str, ...]
    columns: list[int] = field(default_factory=list)
    labels: list[tuple[str, ...]] = field(default_factory=list)

    def append(self, column: int, label: tuple[str, ...]) -> None:
        """Add a member with one label for each dimension."""
        self.columns.append(column)
        self.labels.append(label if self.dimensions else ())


def _members(model: Model) -> dict[str, Members]:
    """Return the variables of parameters and noise scales, `effect.parameter`, in the order of the flat vector."""
    per: dict[str, set[tuple[str, ...]]] = {}
    for effect in model.assembly.effects:
        for name in effect.declared:
            per.setdefault(f"{effect.name}.{name}", set()).add(effect.per_of(name))
    found: dict[str, Members] = {}
    for column, parameter in enumerate(model.layout.parameters + model.hyper_layout.parameters):
        name = f"{parameter.effect}.{parameter.field}"
        if len(per[name]) == 1:
            found.setdefault(name, Members(next(iter(per[name])))).append(column, parameter.label)
        else:  # an effect that the model lists twice, its values belonging to different things
            found.setdefault(name, Members((f"{name}.label",))).append(column, (",".join(parameter.label),))
    return found


def _derived_members(fit: Fit) -> dict[str, Members]:
    found: dict[str, Members] = {}
    for column, name in enumerate(fit.derived.names):
        family, _, label = name.name.removesuffix("]").partition("[")
        dimensions = _DERIVED_DIMENSIONS[family]
        # Names of channels have no comma; those of mountings and runs, which come second, may.
        found.setdefault(family, Members(dimensions)).append(column, tuple(label.split(",", len(dimensions) - 1)))
    return found


def _label_coordinates(model: Model, variables: Mapping[str, Members]) -> Labels:
    """Return the labels of each dimension that any variable uses; channels and runs in the order of the campaign."""
    used: dict[str, dict[str, None]] = {}
    for members in variables.values():
        for place, dimension in enumerate(members.dimensions):
            used.setdefault(dimension, {}).update((label[place], None) for label in members.labels)
    channels = [channel.name for channel in model.campaign.channels]
    order = {"channel": channels, "second_channel": channels, "run": [run.name for run in model.campaign.runs]}
    return {
        dimension: sorted(labels, key=order[dimension].index) if dimension in order else list(labels)
        for dimension, labels in used.items()
    }


def _arranged(variables: Mapping[str, Members], draws: np.ndarray, labels: Labels) -> dict[str, np.ndarray]:
    """Return draws (chain, draw, D) as one array per variable, (chain, draw, labels…)."""
    found = {}
    for name, members in variables.items():
        sizes = [len(labels[dimension]) for dimension in members.dimensions]
        values = np.full((*draws.shape[:2], *sizes), np.nan)
        for column, label in zip(members.columns, members.labels, strict=True):
            place = (labels[dimension].index(part) for dimension, part in zip(members.dimensions, label, strict=True))
            values[(..., *place)] = draws[..., column]
        found[name] = values
    return found


def _all_derived(posterior: Posterior) -> np.ndarray:
    """Return the derived quantities of every draw, (S, D), NaN where they were not computed."""
    values = np.full((len(posterior.points), posterior.derived.shape[1]), np.nan)
    values[posterior.derived_rows] = posterior.derived
    return values


def _channel_names(model: Model) -> np.ndarray:
    return np.array([*(channel.name for channel in model.campaign.channels), "closure_x", "closure_y", "closure_z"])


def _constant_data(model: Model) -> dict[str, np.ndarray]:
    entries = model.entries
    return {
        "entry_run": np.array([run.name for run in model.campaign.runs])[entries.run],
        "entry_channel": _channel_names(model)[entries.channel],
        "entry_row": entries.row,
        "samples": entries.samples,
    }


def _pieces(model: Model) -> list[str]:
    """Return the run and channel of each piece of the likelihood."""
    data, first = _constant_data(model), np.unique(np.asarray(model.problem.observations.group), return_index=True)[1]
    return [f"{data['entry_run'][entry]},{data['entry_channel'][entry]}" for entry in first]


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
