"""Effects of a model that matrix, bias and gain cannot express, each with the size of the error of leaving it out.

An effect of the sensor or the converter is switched off, and what that changes is compared with a function affine in
rate and specific force.  What is not affine is nonlinear.  An effect that needs more than the instantaneous inputs and
temperatures (memory, a limit, vibration, time) is sized by what it contributes to the rows of the campaign.
"""

from collections.abc import Sequence
from functools import partial
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np

from imubayes.array_shapes import Array, Float
from imubayes.campaign_data import Campaign
from imubayes.covariates import REFERENCE_TEMPERATURE
from imubayes.effects.base import Effect, Order, RecordEffect, SignalEffect
from imubayes.effects.shared_formulas import RunBias
from imubayes.kept_programs import kept
from imubayes.model.bound_effects import BoundEffect
from imubayes.model.derived_quantities import is_lasting
from imubayes.model.problem import predict_from, values_of
from imubayes.model.sensitive_axes import SensitivityInputs, outputs_in_body
from imubayes.qualification.correct_recording import TEMPERATURES
from imubayes.qualification.onboard_record import CarriedParameter, UnexpressedEffect
from imubayes.qualification.sensor_posterior import SensorPosterior
from imubayes.results.posterior_draws import complete, draws_of, thinned
from imubayes.results.result import Result

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


def acts_linearly(effect: BoundEffect) -> bool:
    """Tell whether an effect of sensor or converter acts by inputs and temperatures alone, without memory or limit."""
    return _of_the_unit(effect) and _is_instantaneous(effect)


def _of_the_unit(effect: BoundEffect) -> bool:
    """Tell whether an effect belongs to sensor or converter; offsets of single runs are an uncertainty instead."""
    kept = issubclass(effect.effect_class, SignalEffect | RecordEffect) and not issubclass(effect.effect_class, RunBias)
    return kept and "injection" not in effect.effect_class.needs


def _is_instantaneous(effect: BoundEffect) -> bool:
    effect_class = effect.effect_class
    return (
        issubclass(effect_class, Effect)
        and is_lasting(effect, effect_class)
        and set(effect_class.needs) <= set(TEMPERATURES)
    )


def input_ranges(campaign: Campaign) -> dict[str, float]:
    """Return the largest magnitude of input of a channel in the campaign, kind → rad/s or m/s², 1 g at least."""
    found = {"gyro": _LEAST_RATE, "accelerometer": campaign.site.gravity}
    for place, channel in enumerate(campaign.channels):
        if channel.kind in found:
            read = [run.observed[:, place] for run in campaign.runs]
            read += [run.tumble.readings[..., place].ravel() for run in campaign.runs if run.tumble is not None]
            inputs = np.abs(np.concatenate(read) - channel.offset) / abs(channel.scale_si)
            largest = float(np.nanmax(inputs, initial=0.0, where=np.isfinite(inputs)))
            found[channel.kind] = max(found[channel.kind], largest)
    return found


def probe_inputs(spans: dict[str, float]) -> np.ndarray:
    """Return rates and specific forces within their ranges, along the axes and in fixed random directions, (n, 6)."""
    directions = np.random.default_rng(20260301).normal(size=(_PAIRS, 2, 3))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    single = np.concatenate([np.eye(6), -np.eye(6)])
    together = np.concatenate([directions.reshape(_PAIRS, 6), single])
    return together * np.repeat([spans.get("gyro", 0.0), spans.get("accelerometer", 0.0)], 3)


def probe_temperatures(count: int, ranges: dict[str, tuple[float, float]]) -> np.ndarray:
    """Return temperatures of sensor and converter that vary over their ranges, shape (count, 2)."""
    shares = np.random.default_rng(20260302).uniform(size=(count, 2))
    shares[:4] = [[0, 0], [0, 1], [1, 0], [1, 1]]
    limits = np.array([ranges.get(name, (REFERENCE_TEMPERATURE,) * 2) for name in TEMPERATURES])
    return limits[:, 0] + shares * (limits[:, 1] - limits[:, 0])


@kept
def _outputs(
    inputs: SensitivityInputs, values: Float[Array, "S V"], stimuli: Float[Array, "n 6"], at: Float[Array, "n 2"]
) -> dict[str, Array]:
    def of(value, stimulus, temperature):
        return outputs_in_body(inputs, value, stimulus, temperature[0], temperature[1])

    return jax.vmap(lambda value: jax.vmap(partial(of, value))(stimuli, at))(values)


def modelled_outputs(
    posterior: SensorPosterior, values: np.ndarray, stimuli: np.ndarray, temperatures: np.ndarray
) -> dict[str, np.ndarray]:
    """Return the outputs of the model for values (S, V) at inputs (n, 6) and temperatures (n, 2): kind → (S, n, C)."""
    found = _outputs(posterior.inputs, *map(jnp.asarray, (values, stimuli, temperatures)))
    return {kind: np.asarray(outputs) for kind, outputs in found.items()}


def unexpressed_effects(
    result: Result, posterior: SensorPosterior, spans: dict[str, float]
) -> tuple[UnexpressedEffect, ...]:
    """Return the effects that constants do not express, with the error of leaving each out."""
    model = result.fit.model
    found: list[UnexpressedEffect] = []
    elsewhere: list[BoundEffect] = []
    for effect in model.assembly.effects:
        if not _of_the_unit(effect):
            continue
        places = np.array([model.layout.index(parameter.name) for parameter in effect.parameters], dtype=int)
        nulls = np.array([effect.declared[parameter.field].null for parameter in effect.parameters])
        if _is_instantaneous(effect) and _changes(posterior, places, nulls, spans):
            found += _nonlinear(result, posterior, effect, places, nulls, spans)
        else:
            elsewhere.append(effect)
    return (*found, *(each for effect in elsewhere for each in _in_campaign(result, effect)))


def uncorrected_effects(result: Result, kinds: Sequence[str]) -> tuple[UnexpressedEffect, ...]:
    """Return the effects of these kinds of channels that a correction row by row leaves in, sized in the campaign.

    They have a memory or a limit, or depend on more than the inputs and temperatures of the row.
    """
    effects = [each for each in result.fit.model.assembly.effects if _of_the_unit(each) and not _is_instantaneous(each)]
    found = (each for effect in effects if effect.parameters for each in _in_campaign(result, effect))
    return tuple(each for each in found if each.kind in kinds)


def _without(values: np.ndarray, places: np.ndarray, nulls: np.ndarray) -> np.ndarray:
    changed = values.copy()
    changed[..., places] = nulls
    return changed


def _changes(posterior: SensorPosterior, places: np.ndarray, nulls: np.ndarray, spans: dict[str, float]) -> bool:
    probes = probe_inputs(spans)
    warm = np.full((len(probes), 2), REFERENCE_TEMPERATURE + 10.0)
    both = np.stack([posterior.values, _without(posterior.values, places, nulls)])
    outputs = modelled_outputs(posterior, both, probes, warm)
    return any(bool((each[0] != each[1]).any()) for each in outputs.values())


def _nonlinear(
    result: Result, posterior: SensorPosterior, effect: BoundEffect, places: np.ndarray, nulls: np.ndarray,
    spans: dict[str, float],
) -> list[UnexpressedEffect]:  # fmt: skip
    """Return the part of an effect that is not affine in the inputs, for each kind of channel."""
    full = np.repeat([max(spans.get("gyro", 0.0), _LEAST_RATE), spans.get("accelerometer", 1.0)], 3)
    small = _STEP * np.concatenate([np.diag(full), -np.diag(full), np.zeros((1, 6))])
    probes = np.concatenate([probe_inputs(spans), small])
    at = np.full((len(probes), 2), REFERENCE_TEMPERATURE)
    chosen = posterior.draws[np.linspace(0, len(posterior.draws) - 1, min(_DRAWS, len(posterior.draws))).astype(int)]
    values = np.stack([posterior.values, *(posterior.at(draw) for draw in chosen)])
    present = modelled_outputs(posterior, values, probes, at)
    absent = modelled_outputs(posterior, _without(values, places, nulls), probes, at)
    found = []
    for kind in effect.kinds:
        scale = np.array([channel.scale_si for channel in posterior.campaign.of_kind(kind)])
        change = (present[kind] - absent[kind]) / scale
        up, down, zero = change[:, -13:-7], change[:, -7:-1], change[:, -1:]
        slope = (up - down) / (2 * _STEP * full)[:, None]
        rest = change - zero - np.einsum("np,spc->snc", probes, slope)
        place, channel = np.unravel_index(np.abs(rest[0]).argmax(), rest[0].shape)
        size, whole = float(abs(rest[0, place, channel])), float(np.abs(change[0]).max())
        uncertain = float((present[kind] / scale)[1:, place, channel].std()) if len(chosen) > 1 else 0.0
        if size > max(_AFFINE * whole, _ROUNDING * spans[kind], _NEGLIGIBLE * uncertain):
            sd = float(rest[1:, place, channel].std(ddof=1)) if len(chosen) > 1 else 0.0
            found.append(_unexpressed(result, effect, kind, "nonlinear", size, sd))
    return found


def _in_campaign(result: Result, effect: BoundEffect) -> list[UnexpressedEffect]:
    """Return the largest contribution of an effect to the rows of the campaign, for each kind of channel."""
    model = result.fit.model
    names = [parameter.name for parameter in effect.parameters]
    places = np.array([model.layout.index(name) for name in names], dtype=int)
    nulls = np.array([effect.declared[parameter.field].null for parameter in effect.parameters])
    draws = thinned(complete(draws_of(result.draws, names)), _DRAWS_IN_CAMPAIGN)
    own = np.stack([draws[name] for name in names], axis=1) * model.layout.factors()[places]
    values = np.array(values_of(model.problem, jnp.asarray(result.fit.z)))
    values[places] = own.mean(axis=0)
    without = _predicted(result, _without(values, places, nulls))
    mean = _predicted(result, values) - without
    entries, channels = model.entries, model.campaign.channels
    found = []
    for kind in effect.kinds:
        named = [k for k, c in enumerate(channels) if c.kind == kind and c.name in effect.channels]
        rows = np.flatnonzero(np.isin(entries.channel, named) & ~entries.closing)
        if not len(rows):
            continue
        scale = np.abs([channels[k].scale_si for k in entries.channel[rows]])
        row = int(rows[(np.abs(mean[rows]) / scale).argmax()])
        unit = abs(channels[int(entries.channel[row])].scale_si)
        repeated = []
        for draw in own:
            values[places] = draw
            repeated.append((_predicted(result, values)[row] - without[row]) / unit)
        cause = _cause(effect)
        found.append(_unexpressed(result, effect, kind, cause, float(abs(mean[row]) / unit), float(np.std(repeated))))
    return found


def _predicted(result: Result, values: np.ndarray) -> np.ndarray:
    return np.asarray(predict_from(result.fit.model.problem, jnp.asarray(values)))


def _cause(effect: BoundEffect) -> Literal["memory", "limit", "covariate"]:
    if issubclass(effect.effect_class, RecordEffect):
        return "memory"
    limited = issubclass(effect.effect_class, Effect) and effect.effect_class.order >= Order.LIMIT
    return "limit" if limited else "covariate"


def _unexpressed(
    result: Result, effect: BoundEffect, kind: str,
    cause: Literal["nonlinear", "memory", "limit", "covariate"], size: float, sd: float,
) -> UnexpressedEffect:  # fmt: skip
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
