"""The bend of weak directions next to others that the data determine to a share of the prior near the rounding."""

from dataclasses import replace
from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest

from imubayes.foundations.numerics import inverse_of_precision
from imubayes.inference.nested_laplace import bends, curved_directions, posterior_precision, ridge_points
from imubayes.inference.posterior_mode import Mode, find_mode
from imubayes.model.bind import Model, bind
from imubayes.model.noise_covariance import whiten, whitener
from imubayes.model.problem import predict_many
from small_campaign import campaign, simulated, spec

QUIETER = 1e-3
"""Noise over that of the small campaign: most parameters are determined to 1e-6 of their priors, three not at all."""


@cache
def made() -> Model:
    plain = campaign()
    quiet = tuple(replace(channel, noise=QUIETER * channel.noise) for channel in plain.channels)
    chosen = spec("table_axis_tilt", "mounting_error", "gyro_misalignment", "gyro_scale_factor", "accel_misalignment")
    model = bind(chosen, replace(plain, channels=quiet))
    return bind(chosen, simulated(model, np.zeros(model.problem.size[0]), 4))


@cache
def mode() -> Mode:
    return find_mode(made().problem, *(jnp.zeros(size) for size in made().problem.size))


def left_over(weak: np.ndarray, reach: np.ndarray, bend: np.ndarray) -> float:
    """Return the second-order change of the outputs along bent weak steps, in standard deviations of the noise."""
    problem, at = made().problem, mode()
    w = reach * np.random.default_rng(0).normal(size=(40, len(reach)))
    curve, straight = 0.5 * np.einsum("ni,nj,ijp->np", w, w, bend), w @ weak.T
    both = sum(predict_many(problem, np.asarray(at.z) + sign * straight + curve) for sign in (1, -1))
    change = 0.5 * both - np.asarray(problem.observations.value - at.about.misfit)
    whitened = np.asarray(whiten(problem, whitener(problem, at.h), jnp.asarray(change.T)))
    return float(np.sqrt((whitened**2).sum(axis=0)).max())


@pytest.mark.slow
def test_bent_steps_keep_to_the_ridge():
    problem, at = made().problem, mode()
    weak, reach, bend = curved_directions(problem, at)
    assert len(reach) == 3
    assert left_over(np.asarray(weak), reach, np.asarray(bend)) < 0.01
    # Without a bend, and with the strong variances by the eigenvalues of the covariance, the planted fault, steps leave
    # it by many standard deviations.
    assert left_over(np.asarray(weak), reach, np.zeros(bend.shape)) > 5
    variances, vectors = np.linalg.eigh(inverse_of_precision(np.asarray(posterior_precision(problem, at))))
    strong = vectors[:, :-3]
    planted = bends(problem, at, weak, jnp.asarray(reach), jnp.asarray((strong * variances[:-3]) @ strong.T))
    assert left_over(np.asarray(weak), reach, np.asarray(planted)) > 1


def test_the_distance_from_the_ridge_does_not_depend_on_the_signs_of_directions() -> None:
    """An eigenvalue solver leaves the sign of each direction open, and the basis of directions of equal variance."""
    rng = np.random.default_rng(1)
    weak = np.linalg.qr(rng.normal(size=(7, 3)))[0]
    reach, bend = np.array([0.9, 0.4, 0.4]), rng.normal(size=(3, 3, 7))
    basis = np.array([[-1.0, 0, 0], [0, 0.6, 0.8], [0, 0.8, -0.6]])
    turned = np.einsum("ai,bj,abp->ijp", basis, basis, bend)
    as_it_is = ridge_points(np.zeros(7), weak, reach, bend + bend.swapaxes(0, 1))
    otherwise = ridge_points(np.zeros(7), weak @ basis, reach, turned + turned.swapaxes(0, 1))
    np.testing.assert_allclose(as_it_is, otherwise, atol=1e-12)
