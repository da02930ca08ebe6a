"""Effects with memory, and temperature rates, against loops in plain NumPy."""

from dataclasses import replace
from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest

from imubayes.effects.base import Decay, Play, inclusive_scan
from imubayes.model.bind import Model, bind
from imubayes.model.problem import predict
from imubayes.procedures.ambient import rate_of_change
from small_campaign import DEGREE, GYRO_SCALE, predicted_with, spec, tumble_campaign, whole_catalogue, wide_campaign

HOUR_DEGREE = DEGREE / 3600


def change(name: str, run: str, channel: str, bound: Model | None = None, **values: float) -> np.ndarray:
    """Return what an effect adds to a gyro in each row of a run, deg/h; among all effects unless a model is given."""
    if bound is None:
        bound = whole_catalogue()
        there, here = predicted_with(name, channel, **values), predicted_with(name, "")
    else:
        moved = np.zeros(len(bound.layout))
        for place, parameter in enumerate(bound.layout.parameters):
            if parameter.name.startswith(f"{name}.") and parameter.label == (channel,):
                moved[place] = parameter.prior.z(values[parameter.field] * parameter.factor)
        there, here = (predict(bound.problem, jnp.asarray(z)) for z in (moved, 0.0 * moved))
    names, channels = [r.name for r in bound.campaign.runs], [c.name for c in bound.campaign.channels]
    chosen = (bound.entries.run == names.index(run)) & (bound.entries.channel == channels.index(channel))
    return np.asarray(there - here)[chosen] / GYRO_SCALE / HOUR_DEGREE


def covariate(run: str, name: str) -> np.ndarray:
    return next(each for each in wide_campaign().runs if each.name == run).covariates[name]


def lagged(time: np.ndarray, temperature: np.ndarray, tau: float) -> np.ndarray:
    """Return the temperature after a first-order lag, integrated in small steps."""
    inside, found = temperature[0], [temperature[0]]
    steps = 20000
    for k in range(1, len(time)):
        width = (time[k] - time[k - 1]) / steps
        for outside in temperature[k - 1] + (np.arange(steps) + 0.5) / steps * (temperature[k] - temperature[k - 1]):
            inside += width / tau * (outside - inside)
        found.append(inside)
    return np.array(found)


@pytest.mark.parametrize("run", ["cycle-fast", "cycle-slow"])
def test_a_thermal_lag_is_the_solution_of_its_equation(run):
    time, temperature = covariate(run, "time"), covariate(run, "temperature")
    found = change("gyro_thermal_lag", run, "gy", coefficient=3.0, tau=12.0)
    np.testing.assert_allclose(found, 3.0 * (lagged(time, temperature, 720.0) - temperature), atol=2e-3)


@pytest.mark.parametrize("run", ["cycle-fast", "cycle-up"])
def test_hysteresis_follows_the_play_operator(run):
    temperature, play = covariate(run, "temperature"), 4.0
    middle, expected = temperature[0], []
    for now in temperature:
        middle = min(max(middle, now - play), now + play)
        expected.append((now - middle) / play)
    found = change("gyro_thermal_hysteresis", run, "gx", half_width=2.0, play=play)
    np.testing.assert_allclose(found, 2.0 * np.array(expected), atol=1e-9)
    assert max(found) == pytest.approx(2.0)
    assert min(found) == pytest.approx(-2.0)


@cache
def with_a_converter_of_its_own() -> Model:
    """Return a model of a campaign if the converter of one run takes a course apart from the sensor's."""
    among = wide_campaign()
    place = [run.name for run in among.runs].index("cycle-fast")
    run = among.runs[place]
    course = 30 + 15 * np.sin(np.arange(16) / 2)
    other = replace(run, covariates=dict(run.covariates) | {"converter_temperature": course})
    among = replace(among, runs=(*among.runs[:place], other, *among.runs[place + 1 :]))
    return bind(spec("converter_offset_lag", "converter_gain_hysteresis", "gyro_scale_factor"), among)


def test_a_converter_lag_follows_the_converter_temperature():
    bound = with_a_converter_of_its_own()
    run = next(each for each in bound.campaign.runs if each.name == "cycle-fast")
    time, course = run.covariates["time"], run.covariates["converter_temperature"]
    found = (
        change("converter_offset_lag", "cycle-fast", "gy", bound, coefficient=0.02, tau=12.0) * GYRO_SCALE * HOUR_DEGREE
    )
    np.testing.assert_allclose(found, 0.02 * (lagged(time, course, 720.0) - course), atol=2e-5)


def test_converter_gain_hysteresis_scales_the_input():
    bound = with_a_converter_of_its_own()
    run = next(each for each in bound.campaign.runs if each.name == "cycle-fast")
    middle, place = run.covariates["converter_temperature"][0], []
    for now in run.covariates["converter_temperature"]:
        middle = min(max(middle, now - 4.0), now + 4.0)
        place.append((now - middle) / 4.0)
    found = change("converter_gain_hysteresis", "cycle-fast", "gy", bound, half_width=50.0, play=4.0)
    earth = change("gyro_scale_factor", "cycle-fast", "gy", bound, scale=1e6)
    np.testing.assert_allclose(found, 50e-6 * earth * np.array(place), rtol=1e-9, atol=1e-9)


def test_memory_is_independent_of_the_order_of_rows():
    among = wide_campaign()
    place = [run.name for run in among.runs].index("cycle-fast")
    run, mixed = among.runs[place], np.random.default_rng(1).permutation(16)
    other = replace(run, covariates={name: values[mixed] for name, values in run.covariates.items()})
    shuffled = bind(spec("gyro_thermal_lag"), replace(among, runs=(*among.runs[:place], other)))
    found = change("gyro_thermal_lag", "cycle-fast", "gy", shuffled, coefficient=3.0, tau=12.0)
    plain = change("gyro_thermal_lag", "cycle-fast", "gy", coefficient=3.0, tau=12.0)
    np.testing.assert_allclose(found, plain[mixed], atol=1e-9)


def test_memory_starts_anew_in_each_run():
    alone = bind(spec("gyro_thermal_lag"), wide_campaign().only("cycle-slow"))
    found = change("gyro_thermal_lag", "cycle-slow", "gy", alone, coefficient=3.0, tau=12.0)
    np.testing.assert_allclose(
        found, change("gyro_thermal_lag", "cycle-slow", "gy", coefficient=3.0, tau=12.0), atol=1e-9
    )


def test_transitions_of_a_tumble_have_the_memory_of_the_poses():
    among = tumble_campaign()
    (run,) = among.runs
    warmed = replace(run, covariates=dict(run.covariates) | {"temperature": np.array([20.0, 30, 41, 38, 50])})
    bound = bind(spec("gyro_thermal_lag"), replace(among, runs=(warmed,)))
    at = {"coefficient": 100.0, "tau": 1.0}
    z = jnp.asarray(bound.layout.z_of(np.array([at.get(p.field, 0.0) for p in bound.layout.parameters])))
    closing = np.asarray(bound.entries.closing)
    transition = bound.entries.row[closing]
    moved = np.abs(np.asarray(predict(bound.problem, z) - predict(bound.problem, z * 0))[closing])
    assert moved[transition == 0].max() < 1e-12, "the first pose starts in equilibrium"
    assert all(moved[transition == k].max() > 1e-6 for k in (1, 2, 3))


def test_the_rate_of_a_linear_temperature_is_exact():
    time = np.array([0.0, 60, 130, 190, 400, 460])
    np.testing.assert_allclose(rate_of_change(time, 20 + 0.01 * time), 0.01, rtol=1e-12)
    shuffled = np.array([3, 0, 5, 1, 4, 2])
    curved = 20 + 1e-5 * time**2
    found = rate_of_change(time, curved)
    assert found is not None
    np.testing.assert_array_equal(rate_of_change(time[shuffled], curved[shuffled]), found[shuffled])


def test_the_temperature_rate_suppresses_thermometer_noise():
    time = np.arange(2000) * 10.0
    truth = 12 * 2 * np.pi / 20000 * np.cos(2 * np.pi * time / 20000)
    recorded = 25 + 12 * np.sin(2 * np.pi * time / 20000) + 0.1 * np.random.default_rng(3).normal(size=2000)
    found = rate_of_change(time, np.round(recorded, 1))
    assert np.sqrt(np.mean((found - truth) ** 2)) < 0.1 * np.sqrt(np.mean(truth**2))
    assert rate_of_change(time, 25 + 0.05 * np.random.default_rng(3).normal(size=2000)) is None
    assert rate_of_change(np.zeros(6), np.arange(6.0)) is None


def decays(rng, count: int) -> Decay:
    return Decay(jnp.asarray(rng.uniform(size=(count, 2))), jnp.asarray(rng.normal(size=(count, 2))))


def plays(rng, count: int) -> Play:
    shift, low, room = rng.normal(size=(count, 2)), rng.normal(size=(count, 2)), rng.uniform(size=(count, 2))
    return Play(*map(jnp.asarray, (shift, low, low + room)))


@pytest.mark.parametrize("kind", [decays, plays])
@pytest.mark.parametrize("count", [1, 2, 3, 9, 10, 23])
def test_an_inclusive_scan_composes_the_steps_in_order(kind, count):
    steps = kind(np.random.default_rng(count), count)
    memory, expected = np.zeros(2), []
    for k in range(count):
        if isinstance(steps, Decay):
            memory = np.asarray(steps.gain)[k] * memory + np.asarray(steps.shift)[k]
        else:
            memory = np.clip(memory + np.asarray(steps.shift)[k], np.asarray(steps.low)[k], np.asarray(steps.high)[k])
        expected.append(memory)
    np.testing.assert_allclose(inclusive_scan(steps).from_rest(), expected, rtol=1e-12, atol=1e-12)
