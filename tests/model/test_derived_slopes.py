"""Derived quantities of many points at once, and their Jacobian against automatic differentiation."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from imubayes.foundations.campaign_data import Campaign
from imubayes.model.bind import bind
from imubayes.model.derived_quantities import derived_jacobian, derived_quantities, evaluate_derived
from imubayes.model.problem import values_of
from small_campaign import campaign as plain_campaign
from small_campaign import spec

EFFECTS = ("mounting_error", "table_axis_tilt", "gyro_misalignment", "gyro_scale_factor", "converter_gain_drift")


def campaign() -> Campaign:
    """Return the small campaign with temperatures of the converter that change in every run, as recorded ones do."""
    plain = plain_campaign()
    runs = []
    for run in plain.runs:
        values = run.covariates["converter_temperature"] + 0.01 * np.arange(run.rows)
        runs.append(replace(run, covariates={**run.covariates, "converter_temperature": values}))
    return replace(plain, runs=tuple(runs))


def test_batches_and_jacobian_agree_with_single_points():
    model = bind(spec(*EFFECTS), campaign())
    derived, problem = derived_quantities(model.assembly).derivation, model.problem
    points = np.random.default_rng(1).normal(size=(3, problem.size[0]))

    @jax.jit
    def at(z):
        return derived(values_of(problem, z)), jax.jacfwd(lambda z: derived(values_of(problem, z)))(z)

    values, slopes = at(jnp.asarray(points[1]))
    np.testing.assert_allclose(evaluate_derived(derived, problem, points)[1], values, rtol=1e-13)
    found = derived_jacobian(derived, problem, points[1])
    assert np.any(found != 0)
    largest = np.maximum(np.abs(slopes).max(axis=1, keepdims=True), 1e-30)
    # Beside that the rounding of the values over the step: a component near 1 hardly changes.
    rounding = 4 * np.finfo(float).eps * np.abs(values)[:, None] / 1e-3
    assert np.all(np.abs(found - slopes) <= 1e-6 * np.abs(slopes) + 1e-7 * largest + rounding)
    assert evaluate_derived(derived, problem, np.zeros((0, points.shape[1]))).shape == (0, len(values))


def test_slopes_are_compared_where_the_model_has_a_drift_of_the_converter():
    """Without one both slopes are zero, and their relative difference is not a number."""
    names = {
        effect: [one.name for one in derived_quantities(bind(spec(effect), campaign()).assembly).names]
        for effect in ("accel_bias", "converter_gain_drift")
    }
    assert not [name for name in names["accel_bias"] if name.startswith("delta_k")]
    assert {"delta_k[ax,inject]", "delta_k[ax,inject-low]"} & set(names["converter_gain_drift"])


def test_input_axes_are_the_tilted_nominal_axes():
    """By trigonometry of the angles, and only of channels that have a misalignment."""
    model = bind(spec("gyro_misalignment", "gyro_scale_factor", "accel_scale_factor"), campaign())
    derived, z = derived_quantities(model.assembly), np.random.default_rng(2).normal(size=model.problem.size[0])
    names = [one.name for one in derived.names]
    found = dict(zip(names, evaluate_derived(derived.derivation, model.problem, z[None])[0], strict=True))
    values = dict(zip(model.layout.names, np.asarray(values_of(model.problem, jnp.asarray(z))), strict=False))
    gyros = campaign().of_kind("gyro")
    assert len([name for name in names if name.startswith("input_axis[")]) == 3 * len(gyros)
    for gyro in gyros:
        axis = np.array([found[f"input_axis[{gyro.name},{component}]"] for component in "xyz"])
        along, second, third = (float(axis @ direction) for direction in gyro.axes)
        assert np.hypot(np.hypot(along, second), third) - 1 == pytest.approx(0, abs=1e-14)
        for name, part in (("toward_o", second), ("toward_s", third)):
            angle = values[f"gyro_misalignment.{name}[{gyro.name}]"]
            assert abs(angle) > 1e-5
            assert part / along == pytest.approx(angle, rel=1e-9)
