"""Effects of a model that a correction does not take out, each with the size of the error of leaving it in.

An effect is switched off if all that acts on the unit is known, and again if only that is known which the
correction uses: what the two changes differ by is left in.  Constants on board use what is affine in rate and specific
force; a recording is corrected by the inputs of the channels that it has and by temperatures.  The inputs are drawn
from the range of the campaign, with directions of its own.  An effect that needs more than the instant (memory, a
limit, a value of its own for each run) is sized by what it contributes to the rows of the campaign.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from imubayes.compiled.kept_programs import kept
from imubayes.effects.base import Effect, Order, PlaceEffect, RecordEffect, SignalEffect
from imubayes.effects.shared_formulas import RunBias
from imubayes.foundations.arrays import Array, Float
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.covariates import REFERENCE_TEMPERATURE, ambient_names
from imubayes.foundations.signal_path_state import Experience
from imubayes.model.bound_effects import BoundEffect
from imubayes.model.derived_quantities import is_lasting
from imubayes.model.problem import predict_from, values_of
from imubayes.model.sensitive_axes import WARMED_UP, SensitivityInputs, acting_on, outputs_at
from imubayes.procedures import PROCEDURES
from imubayes.results.result import Result
from imubayes.results.stored_tables import complete, draws_of, thinned
from imubayes_qualification.onboard.record import CarriedParameter, Cause, UnexpressedEffect
from imubayes_qualification.onboard.response import TEMPERATURES, SensorPosterior

# Below this share of an effect, and of the inputs, what is not affine is rounding.
_AFFINE, _ROUNDING = 1e-6, 1e-10
# Below this share of the standard uncertainty of the output, products of small errors are left out without mention: the
# combined uncertainty would grow by 0.1 %.
_NEGLIGIBLE = 0.05
_STEP = 1e-4
_PAIRS = 48
_DRAWS = 100
_DRAWS_IN_CAMPAIGN = 16
# Inputs of a unit that was never turned, rad/s.
_LEAST_RATE = 0.1


Acting = dict[str, Experience]
"""Kind → what acts on its channels at n instants, leaves (n, C, 3)."""
_Change = Callable[[Acting, dict[str, np.ndarray]], dict[str, np.ndarray]]


def acts_linearly(effect: BoundEffect) -> bool:
    """Return whether an effect of the unit acts by inputs and temperatures alone, without memory or limit."""
    return _of_the_unit(effect) and _is_lasting(effect) and set(effect.effect_class.needs) <= set(TEMPERATURES)


def _of_the_unit(effect: BoundEffect) -> bool:
    """Tell whether an effect belongs to the unit; offsets of single runs are an uncertainty instead.

    The place of the unit on a wheel or in a fixture, another in each run, is that of the set-up.
    """
    own = issubclass(effect.effect_class, PlaceEffect | SignalEffect | RecordEffect)
    own = own and not (issubclass(effect.effect_class, PlaceEffect) and "run" in effect.effect_class.per)
    return own and not issubclass(effect.effect_class, RunBias) and "injection" not in effect.effect_class.needs


def _is_lasting(effect: BoundEffect) -> bool:
    return issubclass(effect.effect_class, Effect) and is_lasting(effect, effect.effect_class)


def _injected(campaign: Campaign) -> np.ndarray:
    """Return the runs in which a current stands for an input that no sensor felt."""
    return np.array([place for place, run in enumerate(campaign.runs) if PROCEDURES[run.procedure].injected], dtype=int)


def input_ranges(campaign: Campaign) -> dict[str, float]:
    """Return the largest magnitude of input of a channel in the campaign, kind → rad/s or m/s², 1 g at least."""
    found = {"gyro": _LEAST_RATE, "accelerometer": campaign.site.gravity}
    felt = [run for place, run in enumerate(campaign.runs) if place not in _injected(campaign)]
    for place, channel in enumerate(campaign.channels):
        if channel.kind in found and felt:
            read = [run.observed[:, place] for run in felt]
            read += [run.tumble.readings[..., place].ravel() for run in felt if run.tumble is not None]
            inputs = np.abs(np.concatenate(read) - channel.offset) / abs(channel.scale_si)
            largest = float(np.nanmax(inputs, initial=0.0, where=np.isfinite(inputs)))
            found[channel.kind] = max(found[channel.kind], largest)
    return found


def probe_inputs(spans: dict[str, float]) -> np.ndarray:
    """Return rates and specific forces within their ranges, along the axes and in fixed random directions, (n, 6)."""
    directions = _directions(20260301, _PAIRS, 2)
    single = np.concatenate([np.eye(6), -np.eye(6)])
    together = np.concatenate([directions.reshape(_PAIRS, 6), single])
    return together * np.repeat([spans.get("gyro", 0.0), spans.get("accelerometer", 0.0)], 3)


def _directions(seed: int, *shape: int) -> np.ndarray:
    found = np.random.default_rng(seed).normal(size=(*shape, 3))
    return found / np.linalg.norm(found, axis=-1, keepdims=True)


def probe_temperatures(count: int, ranges: dict[str, tuple[float, float]]) -> np.ndarray:
    """Return temperatures of sensor and converter that vary over their ranges, shape (count, 2)."""
    limits = np.array([ranges.get(name, (REFERENCE_TEMPERATURE,) * 2) for name in TEMPERATURES])
    return _within(limits, count)


def _within(limits: np.ndarray, count: int) -> np.ndarray:
    """Return points that vary over ranges (K, 2), shape (count, K): some at the ends, the others between them."""
    shares = np.random.default_rng(20260302).uniform(size=(count, len(limits)))
    shares[:4] = np.resize([[0, 0], [0, 1], [1, 0], [1, 1]], (4, len(limits)))
    return limits[:, 0] + shares * (limits[:, 1] - limits[:, 0])


@kept
def _outputs(
    inputs: SensitivityInputs, values: Float[Array, "S V"], acting: Acting, ambient: dict[str, Float[Array, " n"]]
) -> dict[str, Array]:
    return jax.vmap(lambda value: jax.vmap(partial(outputs_at, inputs, value))(acting, ambient))(values)


def _modelled(
    posterior: SensorPosterior, values: np.ndarray, acting: Acting, ambient: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Return the outputs for values (S, V), kind → (S, n, C).  One program serves all: every covariate is given."""
    count = len(next(iter(acting.values())).rate)
    unsaid = {name: np.full(count, WARMED_UP if name == "power_on" else 0.0) for name in ambient_names()}
    found = _outputs(posterior.inputs, *jax.tree.map(jnp.asarray, (values, acting, unsaid | ambient)))
    return {kind: np.asarray(outputs) for kind, outputs in found.items()}


def modelled_outputs(
    posterior: SensorPosterior, values: np.ndarray, stimuli: np.ndarray, temperatures: np.ndarray
) -> dict[str, np.ndarray]:
    """Return the outputs of the model for values (S, V) at inputs (n, 6) and temperatures (n, 2): kind → (S, n, C)."""
    return _modelled(posterior, values, acting_in_body(posterior, stimuli), _at(temperatures))


def _at(temperatures: np.ndarray) -> dict[str, np.ndarray]:
    return dict(zip(TEMPERATURES, temperatures.T, strict=True))


def acting_in_body(posterior: SensorPosterior, stimuli: np.ndarray) -> Acting:
    """Return what acts on all channels if rate and specific force of the unit (n, 6) are all that is known."""
    return {
        kind: acting_on(
            *(np.repeat(each[:, None], len(known.scale), axis=1) for each in (stimuli[:, :3], stimuli[:, 3:]))
        )
        for kind, known in posterior.inputs.channels.items()
    }


def _everything(result: Result, posterior: SensorPosterior, spans: dict[str, float]) -> Acting:
    """Return inputs within their ranges, with what no recording holds: angular acceleration, North and up."""
    acting = acting_in_body(posterior, probe_inputs(spans))
    count = len(probe_inputs(spans))
    swept = float(np.abs(np.asarray(result.fit.model.assembly.nodes.table_acceleration)).max(initial=0.0))
    up, aside = _directions(20260303, 2, count)
    north = np.cross(up, aside)
    north /= np.linalg.norm(north, axis=1, keepdims=True)
    spread = [each[:, None, :] for each in (swept * _directions(20260304, count), north, up)]
    return {
        kind: replace(
            each, table_acceleration=spread[0] + each.north, north=spread[1] + each.north, up=spread[2] + each.up
        )
        for kind, each in acting.items()
    }


def _conditions(result: Result, ranges: dict[str, tuple[float, float]], count: int) -> dict[str, np.ndarray]:
    """Return covariates within their ranges in the campaign, name → (count,); from 0 on, but for temperatures."""
    ambient = {name: np.asarray(each) for name, each in result.fit.model.assembly.nodes.ambient.values.items()}
    limits = [
        ranges.get(name, (REFERENCE_TEMPERATURE,) * 2) if name in TEMPERATURES
        else tuple(float(end(each, initial=0.0, where=np.isfinite(each))) for end in (np.min, np.max))
        for name, each in ambient.items()
    ]  # fmt: skip
    return dict(zip(ambient, _within(np.array(limits), count).T, strict=True))


def unexpressed_effects(
    result: Result, posterior: SensorPosterior, spans: dict[str, float]
) -> tuple[UnexpressedEffect, ...]:
    """Return the effects that constants do not express, with the error of leaving each out."""
    full = np.repeat([max(spans.get("gyro", 0.0), _LEAST_RATE), spans.get("accelerometer", 1.0)], 3)
    small = _STEP * np.concatenate([np.diag(full), -np.diag(full), np.zeros((1, 6))])
    probes, acting = probe_inputs(spans), _everything(result, posterior, spans)
    # Constants are polynomials in the temperatures: what is not affine in the inputs is asked for at T_ref.
    ambient = _conditions(result, {}, len(probes))

    def affine(change: _Change) -> dict[str, np.ndarray]:
        near = change(acting_in_body(posterior, small), _at(np.full((len(small), 2), REFERENCE_TEMPERATURE)))
        slopes = {kind: (each[:, :6] - each[:, 6:12]) / (2 * _STEP * full)[:, None] for kind, each in near.items()}
        return {kind: each[:, 12:] + np.einsum("np,spc->snc", probes, slopes[kind]) for kind, each in near.items()}

    def cause(effect: BoundEffect, change: _Change) -> Cause:
        felt = change(acting_in_body(posterior, probes), _at(np.full((len(probes), 2), REFERENCE_TEMPERATURE)))
        return "nonlinear" if acts_linearly(effect) and any(each.any() for each in felt.values()) else "covariate"

    return _left_by(result, posterior, (acting, ambient), affine, cause, spans)


def uncorrected_effects(
    result: Result, posterior: SensorPosterior, known: Callable[[Acting], Acting], spans: dict[str, float],
    ranges: dict[str, tuple[float, float]],
) -> tuple[UnexpressedEffect, ...]:  # fmt: skip
    """Return the effects that a correction row by row leaves in.

    Parameters
    ----------
    known : what a row records of all that acts on the unit.
    spans : kinds of channels that are corrected and others that may act → range of inputs.
    ranges : of the temperatures that rows record.
    """
    acting = _everything(result, posterior, spans)
    ambient = _conditions(result, ranges, len(probe_inputs(spans)))
    told = {name: ambient[name] for name in TEMPERATURES}
    return _left_by(
        result, posterior, (acting, ambient), lambda change: change(known(acting), told),
        lambda effect, change: "covariate", spans,
    )  # fmt: skip


def _left_by(
    result: Result, posterior: SensorPosterior, whole: tuple[Acting, dict[str, np.ndarray]],
    taken_out: Callable[[_Change], dict[str, np.ndarray]], cause: Callable[[BoundEffect, _Change], Cause],
    spans: dict[str, float],
) -> tuple[UnexpressedEffect, ...]:  # fmt: skip
    """Return what a correction leaves of each effect, if it takes out a part of the change that the effect makes."""
    model, found = result.fit.model, []
    chosen = posterior.draws[np.linspace(0, len(posterior.draws) - 1, min(_DRAWS, len(posterior.draws))).astype(int)]
    values = np.stack([posterior.values, *(posterior.at(draw) for draw in chosen)])
    scales = {kind: np.array([c.scale_si for c in posterior.campaign.of_kind(kind)]) for kind in whole[0]}
    present = {kind: each / scales[kind] for kind, each in _modelled(posterior, values, *whole).items()}
    for effect in model.assembly.effects:
        if not (_of_the_unit(effect) and effect.parameters):
            continue
        if not _is_lasting(effect):
            found += _in_campaign(result, effect)
            continue
        without = _without(values, *_switch(result, effect))

        def change(acting: Acting, ambient: dict[str, np.ndarray], without: np.ndarray = without):
            with_it, not_it = (_modelled(posterior, each, acting, ambient) for each in (values, without))
            return {kind: (with_it[kind] - not_it[kind]) / scales[kind] for kind in with_it}

        full, part = change(*whole), taken_out(change)
        for kind in effect.kinds:
            rest = full[kind] - part[kind]
            spread = rest[1:].std(axis=0, ddof=1) if len(chosen) > 1 else np.zeros(rest.shape[1:])
            place = np.unravel_index(np.hypot(rest[0], spread).argmax(), spread.shape)
            size, sd = float(abs(rest[0][place])), float(spread[place])
            least = max(_AFFINE * float(np.abs(full[kind]).max()), _ROUNDING * spans[kind],
                        _NEGLIGIBLE * float(present[kind][(slice(1, None), *place)].std()))  # fmt: skip
            if np.hypot(size, sd) > least:
                found.append(_unexpressed(result, effect, kind, cause(effect, change), size, sd))
    return tuple(found)


def _switch(result: Result, effect: BoundEffect) -> tuple[np.ndarray, np.ndarray]:
    """Return the places of an effect's parameters in the values, and what switches it off there."""
    places = [result.fit.model.layout.index(parameter.name) for parameter in effect.parameters]
    nulls = [effect.declared[parameter.field].null for parameter in effect.parameters]
    return np.array(places, dtype=int), np.array(nulls)


def _without(values: np.ndarray, places: np.ndarray, nulls: np.ndarray) -> np.ndarray:
    changed = values.copy()
    changed[..., places] = nulls
    return changed


def _in_campaign(result: Result, effect: BoundEffect) -> Iterator[UnexpressedEffect]:
    """Yield the largest contribution of an effect to the rows of the campaign, for each kind of channel."""
    model = result.fit.model
    names = [parameter.name for parameter in effect.parameters]
    places, nulls = _switch(result, effect)
    draws = thinned(complete(draws_of(result.draws, names)), _DRAWS_IN_CAMPAIGN)
    own = np.stack([draws[name] for name in names], axis=1) * model.layout.factors()[places]
    values = np.array(values_of(model.problem, jnp.asarray(result.fit.z)))
    values[places] = own.mean(axis=0)
    without = _predicted(result, _without(values, places, nulls))
    changes = [_predicted(result, values) - without]
    for draw in own:
        values[places] = draw
        changes.append(_predicted(result, values) - without)
    mean, spread = np.abs(changes[0]), np.std(changes[1:], axis=0)
    entries, channels = model.entries, model.campaign.channels
    felt = ~np.isin(entries.run, _injected(model.campaign)) & ~entries.closing
    for kind in effect.kinds:
        named = [k for k, c in enumerate(channels) if c.kind == kind and c.name in effect.channels]
        rows = np.flatnonzero(np.isin(entries.channel, named) & felt)
        if not len(rows):
            continue
        scale = np.abs([channels[k].scale_si for k in entries.channel[rows]])
        worst = int((np.hypot(mean[rows], spread[rows]) / scale).argmax())
        size, sd = (float(each[rows][worst] / scale[worst]) for each in (mean, spread))
        yield _unexpressed(result, effect, kind, _cause(effect), size, sd)


def _predicted(result: Result, values: np.ndarray) -> np.ndarray:
    return np.asarray(predict_from(result.fit.model.problem, jnp.asarray(values)))


def _cause(effect: BoundEffect) -> Cause:
    if issubclass(effect.effect_class, RecordEffect):
        return "memory"
    limited = issubclass(effect.effect_class, Effect) and effect.effect_class.order >= Order.LIMIT
    return "limit" if limited else "covariate"


def _unexpressed(
    result: Result, effect: BoundEffect, kind: str, cause: Cause, size: float, sd: float
) -> UnexpressedEffect:
    lines = {line.name: line for line in result.summary.parameters}
    own = {c.name for c in result.fit.model.campaign.of_kind(kind)} & set(effect.channels)
    carried = tuple(
        CarriedParameter(
            name=parameter.name, value=lines[parameter.name].mean or 0.0, sd=lines[parameter.name].sd or 0.0,
            unit=parameter.unit, si_factor=parameter.factor,
        )
        for parameter in effect.parameters if own & set(parameter.label) or parameter.label == ("all",)
    )  # fmt: skip
    formula = (effect.effect_class.__doc__ or "").strip().splitlines()[0]
    channels = tuple(channel for channel in effect.channels if channel in own)
    return UnexpressedEffect(
        effect=effect.name, channels=channels, kind=kind, formula=formula, cause=cause, size=size, sd=sd,
        parameters=carried,
    )  # fmt: skip
