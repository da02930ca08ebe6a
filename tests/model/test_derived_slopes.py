"""Derived quantities of many points at once, and their Jacobian against automatic differentiation."""

import jax
import jax.numpy as jnp
import numpy as np

from imubayes.model.bind import bind
from imubayes.model.derived_quantities import derived_jacobian, derived_quantities, evaluate_derived
from imubayes.model.problem import values_of
from small_campaign import campaign, spec

EFFECTS = ("mounting_error", "table_axis_tilt", "gyro_misalignment", "gyro_scale_factor", "converter_gain_drift")


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
    np.testing.assert_allclose(found / largest, slopes / largest, rtol=1e-6, atol=1e-7)
    assert evaluate_derived(derived, problem, np.zeros((0, points.shape[1]))).shape == (0, len(values))


def test_slopes_are_compared_where_the_model_has_a_drift_of_the_converter():
    """Without one both slopes are zero, and their relative difference is not a number."""
    names = {
        effect: [one.name for one in derived_quantities(bind(spec(effect), campaign()).assembly).names]
        for effect in ("accel_bias", "converter_gain_drift")
    }
    assert not [name for name in names["accel_bias"] if name.startswith("delta_k")]
    assert {"delta_k[ax,inject]", "delta_k[ax,inject-low]"} & set(names["converter_gain_drift"])
