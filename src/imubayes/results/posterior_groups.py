"""The groups of ArviZ's schema: draws with named dimensions, and every group that model criticism asks for.

They are arrays alone, which `imubayes.results.result_folder` writes and `imubayes.results.result` hands to ArviZ as a
tree of xarray, which takes long to import.

A variable of the posterior holds draws by name, unit and labelled dimensions, without gaps.  An array has a number for
every combination of its labels, but parameters come as they are declared: a gyro has no accelerometer bias.  So a
dimension holds exactly the labels that its variables have.  It is called ``channel`` if these are all channels of
the campaign, ``gyro_channel`` if they are all gyros, and so on; if combinations of labels do not make a full
grid, such as the angles between pairs of axes, they share one dimension of joint labels.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np

from imubayes.compiled.in_numpy import in_numpy
from imubayes.foundations.arrays import Array, Float, in_batches
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.quantity_names import QuantityName
from imubayes.foundations.units import to_si
from imubayes.inference.chains import Chains
from imubayes.inference.fitted_model import Fit, Posterior, evenly_spaced
from imubayes.inference.run_fit import campaign_hash, model_hash
from imubayes.model.bind import Model
from imubayes.model.likelihood import entry_log_likelihood
from imubayes.model.noise_covariance import heavy_tailed, noise_distribution
from imubayes.model.problem import Problem, predict_many
from imubayes.parameters.priors import Normal

SAMPLE = ("chain", "draw")
# What the labels of a derived quantity are.
_DERIVED_LABELS = {
    "scale_factor": ("channel",),
    "input_axis": ("channel", "component"),
    "mounting_angle": ("channel", "mounting"),
    "axis_angle": ("axis", "axis"),
    "delta_k": ("channel", "run"),
}

Labels = tuple[str, ...]
_PAIRS: dict[Labels, str] = {("axis", "axis"): "axis_pair"}


@dataclass(frozen=True)
class Members:
    """The members of one variable before they are arranged.

    Attributes
    ----------
    owner : effect or derived quantity that the variable belongs to.
    kinds : what each part of a label names: channel, component, run, mounting, table, pose.
    columns, labels, units : of each member, its place in a flat array of draws, its label and its unit.
    """

    owner: str
    kinds: Labels
    columns: list[int] = field(default_factory=list)
    labels: list[Labels] = field(default_factory=list)
    units: list[str] = field(default_factory=list)

    def append(self, column: int, label: Labels, unit: str) -> None:
        """Add a member with one label for each kind."""
        self.columns.append(column)
        self.labels.append(label if self.kinds else ())
        self.units.append(unit)

    @property
    def unit(self) -> str:
        """The unit of all members, or each unit with the members that have it."""
        if len(set(self.units)) == 1:
            return self.units[0]
        having = {unit: [] for unit in self.units}
        for label, unit in zip(self.labels, self.units, strict=True):
            having[unit].append(",".join(label))
        return "; ".join(f"{unit} ({', '.join(labels)})" for unit, labels in having.items())


@dataclass(frozen=True)
class Labelled:
    """An array with a name for each of its dimensions, and attributes such as its unit."""

    dimensions: Labels
    values: np.ndarray
    attributes: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Variable:
    """A variable: its dimensions, and for each place of its array the column in a flat array of draws."""

    unit: str
    dimensions: Labels
    columns: np.ndarray

    def of(self, draws: np.ndarray) -> Labelled:
        """Return draws (chain, draw, D) as (chain, draw, dimensions…)."""
        return Labelled((*SAMPLE, *self.dimensions), draws[..., self.columns], {"units": self.unit})


class Dimensions:
    """Names of dimensions, each with its labels; one name never stands for two lists of labels."""

    def __init__(self, campaign: Campaign):
        self.labels: dict[str, Labels] = {}
        self._whole = dict(_lists_with_names(campaign))

    def arranged(self, name: str, members: Members) -> Variable:
        """Return a variable on dimensions of its own labels."""
        by_kind = [dict.fromkeys(label[place] for label in members.labels) for place in range(len(members.kinds))]
        place_of = dict(zip(members.labels, members.columns, strict=True))
        grid = [self._in_order(kind, labels) for kind, labels in zip(members.kinds, by_kind, strict=True)]
        if len(place_of) < np.prod([len(labels) for labels in grid], dtype=int):
            joint = _PAIRS.get(members.kinds, "_and_".join(members.kinds))
            texts = tuple(",".join(label) for label in members.labels)
            dimension = self._named(texts, (joint, f"{members.owner}_{joint}", f"{name}_{joint}"))
            return Variable(members.unit, (dimension,), np.array(members.columns))
        dimensions = tuple(
            self._named(labels, (*self._standard(kind, labels), f"{members.owner}_{kind}", f"{name}_{kind}"))
            for kind, labels in zip(members.kinds, grid, strict=True)
        )
        columns = np.array([place_of[label] for label in product(*grid)]).reshape([len(labels) for labels in grid])
        return Variable(members.unit, dimensions, columns)

    def _standard(self, kind: str, labels: Labels) -> Iterator[str]:
        """Yield the names of dimensions that are known to have just these labels."""
        if kind not in self._whole:
            yield kind
        known = (name for name, whole in self._whole.items() if whole == labels)
        yield from (name for name in known if name == kind or name.endswith(f"_{kind}"))

    def _in_order(self, kind: str, labels: Iterable[str]) -> Labels:
        order = {label: place for place, label in enumerate(self._whole.get(kind, ()))}
        return tuple(sorted(labels, key=lambda label: order.get(label, len(order))))

    def _named(self, labels: Labels, names: Sequence[str]) -> str:
        name = next(name for name in names if self.labels.get(name, labels) == labels)
        self.labels[name] = labels
        return name


def _lists_with_names(campaign: Campaign) -> Iterator[tuple[str, Labels]]:
    """Yield each list of labels that has a name of its own, in the order of the campaign."""
    yield "channel", tuple(channel.name for channel in campaign.channels)
    for kind in ("gyro", "accelerometer"):
        yield f"{kind}_channel", tuple(channel.name for channel in campaign.of_kind(kind))
    yield "run", tuple(run.name for run in campaign.runs)
    for procedure in dict.fromkeys(run.procedure for run in campaign.runs):
        yield f"{procedure}_run", tuple(run.name for run in campaign.runs if run.procedure == procedure)
    used = [run.mounting for run in campaign.runs if run.mounting is not None]
    yield "mounting", tuple(dict.fromkeys(used))
    yield "table", tuple(dict.fromkeys(run.table for run in campaign.runs if run.table is not None))


def variables_of(fit: Fit) -> tuple[dict[str, Variable], dict[str, Variable], Mapping[str, Labels]]:
    """Return the variables of parameters and of derived quantities, and the labels of each dimension.

    The columns of the first are those of the draws in units, (…, P + H), those of the second are of the derived
    quantities, (…, D).
    """
    dimensions = Dimensions(fit.model.campaign)
    own = {name: dimensions.arranged(name, members) for name, members in _parameters(fit.model).items()}
    derived = {name: dimensions.arranged(name, members) for name, members in _derived(fit).items()}
    return own, derived, dimensions.labels


def _parameters(model: Model) -> dict[str, Members]:
    """Return the variables of parameters and noise scales, ``effect.parameter``, in the order of the flat vector."""
    per: dict[str, set[Labels]] = {}
    for effect in model.assembly.effects:
        for name in effect.declared:
            per.setdefault(f"{effect.name}.{name}", set()).add(effect.per_of(name))
    found: dict[str, Members] = {}
    for column, parameter in enumerate(model.layout.parameters + model.hyper_layout.parameters):
        name = f"{parameter.effect}.{parameter.field}"
        if len(per[name]) == 1:
            kinds, label = next(iter(per[name])), parameter.label
        else:  # an effect that the model lists twice, its values belonging to different things
            kinds, label = ("label",), (",".join(parameter.label),)
        found.setdefault(name, Members(parameter.effect, kinds)).append(column, label, parameter.shown_unit)
    return found


def _derived(fit: Fit) -> dict[str, Members]:
    """Return the variables of derived quantities, by family."""
    found: dict[str, Members] = {}
    for column, quantity in enumerate(fit.derived.names):
        name = QuantityName.of(quantity.name)
        members = found.setdefault(name.family, Members(name.family, _DERIVED_LABELS[name.family]))
        members.append(column, name.labels, quantity.unit)
    return found


# The dimension of what was measured.
ENTRY = "entry"
# Likelihoods are kept for so many values (4 MB), of so many draws at least, without which PSIS-LOO shows nothing, and
# at most; outputs are replicated of the same draws, as LOO-PIT asks for, and of a quarter as many of the prior.
_KEPT_VALUES, _FEWEST_KEPT, _MOST_KEPT = 1_000_000, 100, 1000
_PRIOR_SHARE = 4
# Draws whose outputs are computed at a time: some 100 000 values, since NumPy takes as long for 20 draws as for 100.
_BATCH_VALUES, _FEWEST_AT_ONCE, _MOST_AT_ONCE = 100_000, 20, 128
# Draws are rounded to binary places below these shares of their spread, since what follows is noise that no file can be
# compressed with.  Of parameters 6e-8 of a standard deviation: a sum or difference of them may be known 5e4 times
# better than each, and its uncertainty then changes by less than a thousandth.  Replicated outputs are rounded to an
# eighth of it, which raises their variance by a thousandth; log densities to a 128th, a per cent of a draw's weight.
_SHARE, _REPLICATED_SHARE, _DENSITY_STEP = 2.0**-24, 2.0**-3, 2.0**-7
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


@in_numpy
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


def in_units(model: Model, points: np.ndarray) -> np.ndarray:
    """Return points (…, P + H) in z as values in datasheet units."""
    problem, size = model.problem, len(model.layout)
    values = problem.priors.values(points[..., :size]), problem.hyper_priors.values(points[..., size:])
    return np.concatenate(values, axis=-1) / np.concatenate([model.layout.factors(), model.hyper_layout.factors()])


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

    # What has a bound is kept as it is: a scale rounded to 0 would be infinitely far from the bulk of its prior.
    unbounded = [isinstance(each.prior, Normal) for each in (*model.layout.parameters, *model.hyper_layout.parameters)]

    def parameters(own_draws: np.ndarray, derived_draws: np.ndarray) -> Group:
        kept_draws = np.where(unbounded, _without_noise(own_draws), own_draws)
        found = _variables(own, kept_draws) | _variables(derived, _without_noise(derived_draws))
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
    count = len(problem.observations.value)
    batch = min(max(_BATCH_VALUES // count, _FEWEST_AT_ONCE), _MOST_AT_ONCE)
    blocks = [slice(begin, begin + batch) for begin in range(0, len(points), batch)]
    replicated = np.empty((len(points), count))
    entry = np.empty(replicated.shape, dtype=np.float32)
    # A block at a time: of a large campaign each copy of all takes as much memory as the fit.
    for block in blocks:
        predicted = predict_many(problem, points[block, :size])
        both = np.concatenate([predicted, points[block, size:]], axis=1)
        deviation, tail, density = np.moveaxis(in_batches(lambda part: _likelihoods(problem, part), both, batch), 1, 0)
        alone = random.normal(size=predicted.shape) * heavy_tailed(tail, random)
        replicated[block] = predicted + deviation * alone
        entry[block] = rounded(density, np.array(_DENSITY_STEP))
    step = _REPLICATED_SHARE * _spread(replicated)
    for block in blocks:
        replicated[block] = rounded(replicated[block], step)
    shape = (*draws.shape[:2], -1)
    return replicated.reshape(shape), entry.reshape(shape)


def rounded(values: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Return values rounded to multiples of powers of two not above a step; as they are if it is 0 or not finite."""
    some = np.isfinite(step) & (step > 0)
    power = np.exp2(np.floor(np.log2(np.where(some, step, 1.0))))
    return np.where(some, np.round(values / power) * power, values)


def _without_noise(draws: np.ndarray) -> np.ndarray:
    """Return draws (chain, draw, D) rounded to a share of their spread, or of themselves if they are smaller."""
    spread = _spread(draws.reshape(-1, draws.shape[-1]))
    return rounded(draws, _SHARE * np.minimum(spread, np.abs(draws)))


def _spread(draws: np.ndarray) -> np.ndarray:
    """Return the standard deviation of draws (S, D), (D,), or that of their quartiles if it is smaller."""
    low, high = np.quantile(draws, (0.25, 0.75), axis=0)
    return np.fmin(draws.std(axis=0), (high - low) / 1.349)


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
    labels = {"run": run, "channel": model.output_names[entries.channel], "row": entries.row}
    return {name: Labelled((ENTRY,), values) for name, values in (labels | {ENTRY: np.arange(len(entries))}).items()}


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
        "data_sha256": campaign_hash(fit.model),
        "model_sha256": model_hash(fit.model),
        "converged": int(fit.converged),
        "interval": "95 % equal-tailed if an interval is given",
    }
