"""The law of what a recording does not determine, over all effects of the registry.

A unit has one effect, large for its kind.  What the rows of a campaign read is held against what the model makes of the
inputs that a recording with these rows determines, or constants on board use, and of nothing else: that difference is
left in.  It is within three stated standard uncertainties, and the effect is named.
"""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from imubayes.effects.base import PlaceEffect, RecordEffect, SignalEffect
from imubayes.effects.shared_formulas import RunBias
from imubayes.foundations.arrays import take
from imubayes.inference.fitted_model import Fit
from imubayes.model.problem import Problem, predict, row_means, signal_path, values_of
from imubayes.results.result import Result
from imubayes_qualification.onboard.correct_recording import correction_of, left_in_sd
from imubayes_qualification.onboard.inputs_along_axes import effects_left_in
from imubayes_qualification.onboard.response import TEMPERATURES, sensor_posterior
from imubayes_qualification.onboard.unexpressed_effects import (
    input_ranges,
    modelled_outputs,
    unexpressed_effects,
)
from planted_result import planted
from small_campaign import at_null, whole_catalogue

GYROS, ACCELEROMETERS = ("gx", "gy", "gz"), ("ax", "ay", "az")
SIX = (*GYROS, *ACCELEROMETERS)
RECORDINGS = {
    "whole": SIX, "gyros alone": GYROS, "accelerometers alone": ACCELEROMETERS, "along axes": SIX, "on board": SIX,
}  # fmt: skip


def of_the_unit() -> list[str]:
    """Names of the effects of sensors and converters, and of where they sit."""
    return [
        effect.name for effect in whole_catalogue().assembly.effects
        if issubclass(effect.effect_class, PlaceEffect | SignalEffect | RecordEffect)
        and not issubclass(effect.effect_class, RunBias) and "injection" not in effect.effect_class.needs
    ]  # fmt: skip


def large(name: str) -> np.ndarray:
    """Return z with one effect at one and a half prior standard deviations, its shapes at the middle."""
    model, z = whole_catalogue(), at_null().copy()
    declared = next(effect.declared for effect in model.assembly.effects if effect.name == name)
    for place, parameter in enumerate(model.layout.parameters):
        if parameter.name.startswith(f"{name}."):
            z[place] = 0.0 if declared[parameter.field].shape else 1.5 * (-1) ** place
    return z


@cache
def derived() -> Fit:
    model = whole_catalogue()
    return Fit(model, at_null(), np.zeros(len(model.hyper_layout)), True)


@jax.jit
def _inputs(problem: Problem, z: jax.Array) -> jax.Array:
    path = signal_path(problem, values_of(problem, z))
    kinds, found = sorted(problem.channels), []
    for vector in ("rate", "force"):
        acting = {kind: getattr(path.experience[kind], vector) for kind in kinds}
        for axis in range(3):
            rows = [row_means(problem, acting[kind][..., axis]).reshape(-1) for kind in kinds]
            found.append(take(jnp.concatenate(rows), problem.observations.readout))
    return jnp.stack(found, axis=1)


@cache
def inputs() -> np.ndarray:
    """Return rate and specific force of the body for each entry of the campaign, shape (E, 6)."""
    return np.asarray(_inputs(whole_catalogue().problem, jnp.asarray(at_null())))


@cache
def temperatures() -> np.ndarray:
    """Return the temperatures of sensor and converter of each entry, NaN where a run has none, shape (E, 2)."""
    model = whole_catalogue()
    unknown = np.full(1000, np.nan)
    return np.array([
        [model.campaign.runs[run].covariates.get(name, unknown)[row] for name in TEMPERATURES]
        for run, row in zip(model.entries.run, model.entries.row, strict=True)
    ])  # fmt: skip


def told(recording: str) -> np.ndarray:
    """Return what a recording shows of the inputs of each entry, shape (E, 6)."""
    if recording != "along axes":
        columns = RECORDINGS[recording]
        return inputs() * np.repeat([set(GYROS) <= set(columns), set(ACCELEROMETERS) <= set(columns)], 3)
    model = whole_catalogue()
    own = np.array([channel.axes[0] for channel in model.campaign.channels])[model.entries.channel]
    gyro = np.array([channel.kind == "gyro" for channel in model.campaign.channels])[model.entries.channel]
    found = np.zeros_like(inputs())
    for chosen, place in ((gyro, slice(0, 3)), (~gyro, slice(3, 6))):
        axes = own[chosen]
        found[chosen, place] = np.sum(inputs()[chosen, place] * axes, axis=1, keepdims=True) * axes
    return found


def left(result: Result, name: str, recording: str) -> tuple[np.ndarray, np.ndarray, float]:
    """Return what is left in of each output and the channel of each, and the largest whole contribution; SI."""
    model, posterior = whole_catalogue(), sensor_posterior(result)
    entries, channels = model.entries, model.campaign.channels
    scale = np.array([channel.scale_si for channel in channels])[entries.channel]
    read = np.asarray(predict(model.problem, jnp.asarray(result.fit.z)))
    alone = np.asarray(predict(model.problem, jnp.asarray(at_null())))
    warm = temperatures()
    warm_or_not = np.where(np.isnan(warm), 25.0, warm)

    def modelled(acting: np.ndarray) -> dict[str, np.ndarray]:
        return modelled_outputs(posterior, posterior.values[None], acting, warm_or_not)

    by_kind = modelled(told(recording))
    if recording == "on board":
        still, up, down = (modelled(share * told(recording)) for share in (0.0, 1e-4, -1e-4))
        by_kind = {kind: still[kind] + (up[kind] - down[kind]) / 2e-4 for kind in still}
    explained = np.empty_like(read)
    for place, channel in enumerate(channels):
        chosen = entries.channel == place
        explained[chosen] = by_kind[channel.kind][0, chosen, model.campaign.of_kind(channel.kind).index(channel)]
    needs = next(e.effect_class.needs for e in model.assembly.effects if e.name == name)
    felt = np.array([model.campaign.runs[run].procedure != "current_injection" for run in entries.run])
    for place, temperature in enumerate(TEMPERATURES):
        if temperature in needs:
            felt &= ~np.isnan(warm[:, place])
    kinds = {channel.kind for channel in channels if channel.name in RECORDINGS[recording]}
    felt &= np.array([channels[place].kind in kinds for place in entries.channel])
    return (
        np.abs((read - explained) / scale)[felt],
        entries.channel[felt],
        float(np.abs((read - alone) / scale)[felt].max(initial=0)),
    )


# Over the whole catalogue; at every run test_uncorrected_effects.py has an effect of each cause.
@pytest.mark.slow
@pytest.mark.parametrize("recording", RECORDINGS)
def test_what_a_recording_does_not_tell_is_in_the_uncertainty_and_named(recording):
    channels = whole_catalogue().campaign.channels
    named, broken, blind = set(), [], []
    for name in of_the_unit():
        result = planted(whole_catalogue(), large(name), (name,), like=derived())
        if recording == "along axes":
            found = effects_left_in(result, channels, False)
        elif recording == "on board":
            found = unexpressed_effects(result, sensor_posterior(result), input_ranges(result.fit.model.campaign))
        else:
            found = correction_of(result, RECORDINGS[recording], "recording").left_in
        error, channel, whole = left(result, name, recording)
        stated = np.array([left_in_sd(found, each) / abs(each.scale_si) for each in channels])[channel]
        # A row is a mean over a turn or part of it: a formula of the mean is not the mean of the formula.
        allowed = 3 * stated + 0.02 * whole + 1e-12
        if (error > allowed).any():
            broken.append((name, float((error / allowed).max())))
        # Without the uncertainty of what is left in the law would be broken.
        if (error > 0.1 * whole + 1e-12).any():
            named.add(name)
            blind += [name] if {each.effect for each in found} != {name} else []
    assert not broken
    assert not blind
    assert LEFT_IN[recording] <= named


LEFT_IN = {
    "whole": {"gyro_warm_up", "gyro_magnetic_sensitivity", "accel_thermal_lag", "converter_dead_zone"},
    "gyros alone": {"gyro_g_sensitivity", "gyro_g2_sensitivity", "gyro_scale_g_dependence"},
    "accelerometers alone": {"lever_arm", "accel_vibration_rectification"},
    "on board": {
        "gyro_scale_cubic",
        "accel_quadratic",
        "lever_arm",
        "gyro_bias_drift",
        "gyro_output_axis_acceleration",
    },
    "along axes": {"gyro_misalignment", "accel_misalignment", "accel_cross_coupling", "accel_cross_axis_quadratic"},
}
"""Some of the effects that each recording leaves in."""
