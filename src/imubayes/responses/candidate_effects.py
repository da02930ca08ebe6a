"""Candidates: every effect of the catalogue that the model lacks, added to the model at its null.

The model and all candidates become one problem whose first parameters are the model's own.  At their nulls the
candidates change nothing, so one linearisation gives the Jacobian of the fit and the response to every candidate.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property

import equinox as eqx
import jax
import numpy as np

from imubayes.compiled.in_numpy import linearised_in_numpy
from imubayes.compiled.kept_programs import kept
from imubayes.effects.base import Effect, MotionEffect
from imubayes.foundations.arrays import Array, on_device
from imubayes.foundations.campaign_data import Campaign
from imubayes.inference.fitted_model import Fit
from imubayes.model import bound_effects as bound
from imubayes.model.assembly import assemble
from imubayes.model.bind import Model, build_problem
from imubayes.model.effect_registry import EffectClass, Registry
from imubayes.model.model_file import EffectSpec
from imubayes.model.problem import Problem, predict_from
from imubayes.parameters.declarations import Parameter, Priors, declared_parameters, prior_slopes, prior_values

# Columns of the Jacobian at once, if it is compiled: most places of a scan need a few shapes' coefficients alone.
_SEEDS_AT_ONCE = 16


@dataclass(frozen=True)
class Coefficient:
    """One linear coefficient of a candidate.

    Attributes
    ----------
    parameter : name, unit and prior.
    owner : the channel, mounting, table or run it belongs to.
    typical : smallest and largest magnitude met in practice, in its unit.
    null : value at which it changes nothing, SI.
    even : whether it acts alike with either sign, and has no derivative at its null.
    """

    parameter: Parameter
    owner: str
    typical: tuple[float, float]
    null: float = 0.0
    even: bool = False

    @property
    def sign(self) -> int:
        """The only sign that its prior allows, as of a width or a spread; 0 if it may have either."""
        low, high = self.parameter.prior.support()
        return 1 if self.even else int(low >= self.null) - int(high <= self.null)


@dataclass(frozen=True)
class ShapeScan:
    """Values of a candidate's shape parameters: field → value in its unit; empty if it has none."""

    effect: str
    shape: dict[str, float]


@dataclass(frozen=True)
class Response:
    """The response to one candidate, for one choice of its shape.

    Attributes
    ----------
    scan : effect and shape.
    coefficients : C of them.
    columns : shape (E, C), change of the predicted entries per unit of each coefficient: the derivative at the null, or
        if that is zero the secant to the largest typical size.
    """

    scan: ShapeScan
    coefficients: tuple[Coefficient, ...]
    columns: np.ndarray


@dataclass(frozen=True)
class Responses:
    """The fit, linearised, with all candidates.

    Attributes
    ----------
    misfit : shape (E,), observed less predicted, output units.
    jacobian : shape (E, P), of the model's own parameters in z.
    candidates : one response per candidate and shape.
    unobservable : effects that no run can show → covariates or stimulus that no run has; empty if unknown.
    """

    misfit: np.ndarray
    jacobian: np.ndarray
    candidates: tuple[Response, ...]
    unobservable: dict[str, tuple[str, ...]]


@dataclass(frozen=True)
class LinearisationPoint:
    """Where candidates are linearised that are not at their nulls.

    Attributes
    ----------
    values : coefficient → its value, in its unit.
    shapes : effect → field → value, in its unit; only shapes near it are scanned of that effect.
    """

    values: Mapping[str, float] = field(default_factory=dict)
    shapes: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


_AT_NULLS = LinearisationPoint()
_ABOUT_SHAPE = (1.0, 0.96, 1.04, 0.9, 1.11, 0.8, 1.25)
"""Shapes that are scanned about one that was found: the response to its error would look like a cause of its own."""


@dataclass(frozen=True)
class _Extended:
    problem: Problem
    own: int
    effects: tuple[bound.BoundEffect, ...]
    parameters: tuple[Parameter, ...]
    places: dict[str, int]
    about: LinearisationPoint

    def grid(self, effect: bound.BoundEffect) -> list[dict[str, float]]:
        """Return the shapes to scan; several shape parameters are scanned together, place by place."""
        if effect.name in self.about.shapes:
            about = self.about.shapes[effect.name]
            return [{name: value * factor for name, value in about.items()} for factor in _ABOUT_SHAPE]
        grids = {name: declared.shape for name, declared in effect.declared.items() if declared.shape}
        longest = max((len(grid) for grid in grids.values()), default=0)
        return [{name: grid[min(place, len(grid) - 1)] for name, grid in grids.items()} for place in range(longest)]


def candidate_responses(fitted: Fit, only: Sequence[str] = (), about: LinearisationPoint = _AT_NULLS) -> Responses:
    """Return the fit linearised in its own parameters and in those of every candidate, or of the named ones only.

    Parameters
    ----------
    about : where candidates are linearised; those that it does not name at their nulls.
    """
    return _linearised_with(fitted, *lacking_effects(fitted, only), about)


def responses_of_model(fitted: Fit) -> Responses:
    """Return the fit linearised in its own parameters alone: no candidate is looked at."""
    return _linearised_with(fitted, (), {})


def _linearised_with(
    fitted: Fit,
    acting: tuple[bound.BoundEffect, ...],
    unobservable: dict[str, tuple[str, ...]],
    about: LinearisationPoint = _AT_NULLS,
) -> Responses:
    extended = _extend(fitted, acting, about)
    z = np.concatenate([fitted.z, np.zeros(len(extended.parameters) - extended.own)])
    slopes = np.asarray(prior_slopes(extended.problem.priors, z))
    own = np.asarray(prior_values(extended.problem.priors, z))[: extended.own]
    coefficients = [extended.places[parameter.name] for effect in acting for parameter in _linear(effect)]
    first = _linearised(extended.problem, _at_nulls(extended, own, 0), [*range(extended.own), *coefficients])
    candidates: list[Response] = []
    for place in range(max((1, *(len(extended.grid(effect)) for effect in acting)))):
        scanned = [effect for effect in acting if place < max(1, len(extended.grid(effect)))]
        linear = [extended.places[parameter.name] for effect in scanned for parameter in _linear(effect)]
        values = _at_nulls(extended, own, place)
        at = first if place == 0 else _linearised(extended.problem, values, linear)
        candidates.extend(_response(effect, extended, at, place) for effect in scanned)
    predicted, jacobian = first.predicted, first.columns(range(extended.own))
    misfit = np.asarray(fitted.model.problem.observations.value) - predicted
    shown = _responding(candidates, extended, own, predicted)
    silent = {effect.name for effect in acting} - {response.scan.effect for response in shown}
    unobservable |= dict.fromkeys(sorted(silent), ())
    return Responses(misfit, jacobian * slopes[None, : extended.own], shown, unobservable)


def _responding(
    candidates: Sequence[Response], extended: _Extended, own: np.ndarray, predicted: np.ndarray
) -> tuple[Response, ...]:
    """Return the responses without the coefficients that no entry responds to, at any shape."""
    heard = {name for response in candidates for name in _heard(response)}
    first_shapes = {response.scan.effect: response for response in reversed(candidates)}
    silent = [response for response in first_shapes.values() if not heard & set(_names(response))]
    secants = {name: each for response in silent for name, each in _secants(response, extended, own, predicted).items()}
    found = (_with_response(response, heard, secants) for response in candidates)
    return tuple(response for response in found if response.coefficients)


def _names(response: Response) -> list[str]:
    return [coefficient.parameter.name for coefficient in response.coefficients]


def _heard(response: Response) -> list[str]:
    """Return the names of the coefficients with a derivative that is not zero."""
    pairs = zip(_names(response), response.columns.T, strict=True)
    return [name for name, column in pairs if np.any(column)]


def _with_response(response: Response, heard: set[str], secants: dict[str, np.ndarray]) -> Response:
    """Return a response with the coefficients that have a derivative, or a secant."""
    names = _names(response)
    kept = [place for place, name in enumerate(names) if name in heard or np.any(secants.get(name, 0.0))]
    coefficients = tuple(replace(response.coefficients[k], even=names[k] not in heard) for k in kept)
    columns = [response.columns[:, k] if names[k] in heard else secants[names[k]] for k in kept]
    stacked = np.stack(columns, axis=1) if kept else response.columns[:, :0]
    return replace(response, coefficients=coefficients, columns=stacked)


def _secants(response: Response, extended: _Extended, own: np.ndarray, predicted: np.ndarray) -> dict[str, np.ndarray]:
    """Return the change of the predicted entries, (E,), per unit of each coefficient at its largest typical size."""
    values, found, problem = _at_nulls(extended, own, 0), {}, extended.problem
    for coefficient in response.coefficients:
        size = coefficient.typical[1]
        at = values.copy()
        at[extended.places[coefficient.parameter.name]] += size * coefficient.parameter.factor
        whole = np.concatenate([at, np.asarray(problem.nulls)])
        found[coefficient.parameter.name] = (_pushed(problem, whole, np.zeros((0, len(whole))))[0] - predicted) / size
    return found


class CatalogueModel:
    """The model of a fit with every candidate beside, of which some are free and the others stay at their nulls.

    It is predicted by the program of `candidate_responses`: nothing is compiled for a choice of candidates.
    """

    def __init__(self, fitted: Fit):
        self.fitted = fitted
        self._extended = _extend(fitted, lacking_effects(fitted)[0], _AT_NULLS)

    def parameters_of(self, changed: Model) -> dict[int, Parameter] | None:
        """Return the parameters of a changed model by their places; None if this model cannot predict it.

        It cannot of an effect outside the catalogue or on fewer channels than share its parameters.
        """
        channels = {each.name: each for each in self._extended.effects}
        found = {}
        for effect in changed.assembly.effects:
            whole = channels.get(effect.name)
            limited = whole is not None and set(effect.channels) < set(whole.channels)
            for each in effect.parameters:
                shared = limited and "channel" not in effect.per_of(each.field)[:1]
                if each.name not in self._extended.places or shared:
                    return None
                found[self._extended.places[each.name]] = each
        return found

    def at(self, values: Mapping[str, float]) -> "CatalogueModel":
        """Return the same with candidates at values in place of their nulls.

        Parameters
        ----------
        values : of parameters, or of fields of effects, in their units; those that a prior excludes stay at the null.
        """
        found, nulls = copy(self), self._nulls.copy()
        for place, each in enumerate(self._extended.parameters[self.size :], self.size):
            value = values.get(each.name, values.get(f"{each.effect}.{each.field}"))
            if value is not None and each.z_at(value) is not None:
                nulls[place] = value * each.factor
        vars(found)["_nulls"] = nulls
        return found

    @property
    def size(self) -> int:
        """The number of the model's own parameters, whose places come first."""
        return self._extended.own

    def start(self, place: int, parameter: Parameter, value: float | None = None) -> float:
        """Return z of a value, or else of the null, of a parameter at a place; 0 if its prior excludes it."""
        null = float(self._nulls[place]) / parameter.factor
        found = parameter.z_at(value) if value is not None else None
        return (parameter.z_at(null) or 0.0) if found is None else found

    @cached_property
    def _nulls(self) -> np.ndarray:
        """The values at which no parameter changes anything, SI (P + C,)."""
        effects = self.fitted.model.assembly.effects
        nulls = {each.name: effect.declared[each.field].null for effect in effects for each in effect.parameters}
        return _at_nulls(self._extended, np.array([nulls[name] for name in self.fitted.model.layout.names]), 0)

    def values(self, z: np.ndarray, free: Mapping[int, Parameter]) -> np.ndarray:
        """Return the values of all parameters, SI (P + C,), those that are not free at their nulls."""
        return self._values(z, free, prior_values)

    def _values(self, z: np.ndarray, free: Mapping[int, Parameter], of: Callable[..., Array]) -> np.ndarray:
        parameters, places, whole = self._extended.parameters, list(free), np.zeros(len(self._nulls))
        whole[places] = z
        # Of families that are the same nothing is compiled.
        priors = Priors.stack([free.get(k, each).prior for k, each in enumerate(parameters)])
        found = self._nulls.copy()
        found[places] = np.asarray(of(priors, whole))[places]
        return found

    def linearised(self, z: np.ndarray, free: Mapping[int, Parameter]) -> tuple[np.ndarray, np.ndarray]:
        """Return the misfit (E,) and its Jacobian ∂f/∂z (E, F), some parameters with their own priors free.

        Parameters
        ----------
        z : shape (F,).
        free : by their places, in the order of `z`.
        """
        extended, places = self._extended, list(free)
        at, slopes = self._values(z, free, prior_values), self._values(z, free, prior_slopes)[places]
        found = _linearised(extended.problem, at, places)
        misfit = np.asarray(extended.problem.observations.value) - found.predicted
        return misfit, found.columns(places) * slopes


def searchable(registry: Registry) -> Iterator[type[Effect]]:
    """Return the effects that can be missing: causes, not nuisance parameters of the runs."""
    for member in registry.effects.values():
        learns_spread = any(declared.spread for declared in declared_parameters(member).values())
        if issubclass(member, Effect) and not member.nuisance and not learns_spread:
            yield member


def fitting_channels(member: EffectClass, campaign: Campaign) -> list[str]:
    """Return the names of the channels that a member can act on."""
    return [channel.name for channel in campaign.channels if channel.kind in member.kinds]


def lacking_effects(
    fitted: Fit, only: Sequence[str] = ()
) -> tuple[tuple[bound.BoundEffect, ...], dict[str, tuple[str, ...]]]:
    """Return every effect that the model lacks, on the channels that lack it, and the effects that no run can show.

    Parameters
    ----------
    only : names of the effects to look at; all if empty.
    """
    model = fitted.model
    acting: list[bound.BoundEffect] = []
    unobservable: dict[str, tuple[str, ...]] = {}
    for member in searchable(model.registry):
        spec = _spec(member, fitted) if not only or member.name in only else None
        if spec is None:
            continue
        try:
            acting.append(bound.bind_effect(spec, model.assembly.grouping, model.registry))
        except (bound.NoChannelError, bound.ExactEquipmentError):
            continue
        except bound.NotObservableError as error:
            unobservable[member.name] = error.missing
    return tuple(acting), unobservable


def _spec(member: type[Effect], fitted: Fit) -> EffectSpec | None:
    """Return the candidate on the channels that lack it; None if none does."""
    rivals = [effect for effect in fitted.model.assembly.effects if _rival(effect.effect_class, member)]
    spec = EffectSpec(member.name, where=f"candidate {member.name}")
    if not rivals:
        return spec
    if issubclass(member, MotionEffect):
        return None
    taken = {name for rival in rivals for name in rival.channels}
    free = tuple(name for name in fitting_channels(member, fitted.model.campaign) if name not in taken)
    return replace(spec, channels=free) if free else None


def _rival(member: EffectClass, other: EffectClass) -> bool:
    return member.name == other.name or member.name in other.excludes or other.name in member.excludes


def _extend(fitted: Fit, acting: tuple[bound.BoundEffect, ...], about: LinearisationPoint) -> _Extended:
    assembly = fitted.model.assembly
    extended = assemble(assembly.effects + acting, assembly.grouping)
    parameters = extended.layout.parameters
    places = {parameter.name: place for place, parameter in enumerate(parameters)}
    problem, own, given = build_problem(extended), len(assembly.layout), fitted.model.problem
    # The record may have been corrected since it was bound.
    problem = eqx.tree_at(
        lambda known: (known.nodes, known.observations.value), problem, (given.nodes, given.observations.value)
    )
    return _Extended(problem, own, acting, parameters, places, about)


@dataclass(frozen=True)
class _Linearised:
    """The prediction and its derivative by some parameters in SI, candidates at their nulls.

    Attributes
    ----------
    predicted : shape (E,).
    packed : shape (colours, E), derivatives by parameters that reach no common entry, added up.
    row : shape (P + C,), the row of `packed` that holds a parameter's derivative.
    reach : shape (E, P + C), bool: which parameters reach which entries.
    """

    predicted: np.ndarray
    packed: np.ndarray
    row: np.ndarray
    reach: np.ndarray

    def columns(self, places: Sequence[int]) -> np.ndarray:
        """Return the derivatives by some of these parameters, (E, len(places))."""
        chosen = np.array(places, dtype=int)
        return np.where(self.reach[:, chosen], self.packed[self.row[chosen]].T, 0.0)


def _linearised(problem: Problem, values: np.ndarray, places: Sequence[int]) -> _Linearised:
    """Return the prediction at values of all parameters, SI, and its derivative by the parameters at some places."""
    sparsity, nulls = problem.sparsity, np.asarray(problem.nulls)
    colour = np.asarray(sparsity.colour)
    needed = np.unique(colour[np.array(places, dtype=int)])
    seeds = np.asarray(sparsity.seeds)[needed]
    seeds = np.concatenate([seeds, np.zeros((len(seeds), len(nulls)))], axis=1)
    predicted, packed = _pushed(problem, np.concatenate([values, nulls]), seeds)
    return _Linearised(predicted, packed, np.searchsorted(needed, colour), np.asarray(sparsity.reach))


def _pushed(problem: Problem, whole: np.ndarray, seeds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the prediction (E,), and its derivatives along seeds (S, V), (S, E).

    The program with all candidates is the longest of all, and is run some ten times: NumPy does so in less time than
    the compiler takes, and what it cannot evaluate is compiled.
    """
    found = linearised_in_numpy(_predicted, problem, whole)
    if found is not None:
        predicted, push = found
        return predicted, np.stack([push(seed) for seed in seeds]) if len(seeds) else np.zeros((0, len(predicted)))
    blocks = max(1, -(-len(seeds) // _SEEDS_AT_ONCE))
    padded = np.concatenate([seeds, np.zeros((blocks * _SEEDS_AT_ONCE - len(seeds), len(whole)))])
    placed = on_device(problem)
    pushed = [_push(placed, whole, block) for block in np.split(padded, blocks)]
    return np.asarray(pushed[0][0]), np.concatenate([np.asarray(each) for _, each in pushed])[: len(seeds)]


def _predicted(problem: Problem, whole: Array) -> Array:
    return predict_from(problem, whole)


def _at_nulls(extended: _Extended, own: np.ndarray, scan_place: int) -> np.ndarray:
    """Return the values of all parameters, SI (P + C,), candidates at their nulls and shapes."""
    values = np.concatenate([own, np.zeros(len(extended.parameters) - extended.own)])
    place = extended.own
    for effect in extended.effects:
        grid = extended.grid(effect)
        shape = grid[min(scan_place, len(grid) - 1)] if grid else {}
        for parameter in effect.parameters:
            null = effect.declared[parameter.field].null
            values[place] = shape[parameter.field] * parameter.factor if parameter.field in shape else null
            if parameter.name in extended.about.values:
                values[place] = extended.about.values[parameter.name] * parameter.factor
            place += 1
    return values


@kept
def _push(problem: Problem, whole, seeds):
    predicted, push = jax.linearize(lambda values: predict_from(problem, values), whole)
    return predicted, jax.vmap(push)(seeds)


def _linear(effect: bound.BoundEffect) -> list[Parameter]:
    """Return the parameters of an effect that are its coefficients, not its shape."""
    return [parameter for parameter in effect.parameters if not effect.declared[parameter.field].shape]


def _response(effect: bound.BoundEffect, extended: _Extended, at: _Linearised, scan_place: int) -> Response:
    grid = extended.grid(effect)
    shape = grid[scan_place] if grid else {}
    coefficients = coefficients_of(effect)
    places = [extended.places[each.parameter.name] for each in coefficients]
    factors = np.array([each.parameter.factor for each in coefficients])
    return Response(ShapeScan(effect.name, shape), coefficients, at.columns(places) * factors)


def coefficients_of(effect: bound.BoundEffect) -> tuple[Coefficient, ...]:
    """Return the coefficients of an effect."""
    return tuple(
        Coefficient(parameter, ",".join(parameter.label), parameter.typical, effect.declared[parameter.field].null)
        for parameter in _linear(effect)
    )
