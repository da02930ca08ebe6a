"""Contribution of each test procedure: the uncertainty of a quantity from one procedure alone, and without it.

Given the noise scales h the precision of the parameters is the prior's plus a sum over runs, JᵀΣ(h)⁻¹J of each.  With
the gradient c of a quantity its variance is cᵀΛ(h)⁻¹c for any sum that leaves something out, and its mean over draws of
h the variance that is reported: at the mode of h alone, the scatter between few runs is understated.  The standard
deviation from all runs is that of the posterior itself.

That holds for quantities that are linear in the parameters over the posterior.  An angle near zero is not: as a length
it has no gradient there, and is left out: a linear variance would contradict its posterior.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import cho_factor, cho_solve

from imubayes.array_shapes import Array, Float, Int
from imubayes.gather import take
from imubayes.inference.contribution_record import Contribution, ProcedureShare
from imubayes.inference.fitted_model import Fit, evenly_spaced
from imubayes.inference.posterior_precision import Linearised, whitened_jacobian
from imubayes.kept_programs import kept
from imubayes.model.problem import Problem, prior_widths

_QUANTITIES = ("mounting_angle[", "scale_factor[")
# Draws of the noise scales over which variances are averaged: standard deviations are known to 2 %, as from 200.
_SCALES = 30
# Least share of the posterior variance that a linear function of the parameters explains.
_LINEAR = 0.9


class QuantityDraws(NamedTuple):
    """A quantity with draws of its posterior, (S,) or the first of them, and of its prior, in its unit."""

    name: str
    unit: str
    posterior: np.ndarray
    prior: np.ndarray


def contributions(fit: Fit, further: Sequence[QuantityDraws] = ()) -> tuple[Contribution, ...]:
    """Return for each quantity that is linear in the parameters its uncertainty by procedure.

    Quantities are mounting angles, scale factors, and further ones, such as determined combinations.  Empty where the
    fit did not converge or there is one procedure alone.  `alone` is the standard deviation from the prior and the runs
    of one procedure, `without` that from all others; both in the unit of the quantity, with the gradient from the
    posterior draws.
    """
    procedures = list(dict.fromkeys(run.procedure for run in fit.model.campaign.runs))
    posterior = fit.posterior
    if len(procedures) < 2 or posterior is None or fit.mode is None:
        return ()
    asked = [
        QuantityDraws(name.name, name.unit, posterior.derived[:, place], posterior.prior_derived[:, place])
        for place, name in enumerate(fit.derived.names)
        if name.name.startswith(_QUANTITIES)
    ]
    asked += further
    if not asked:
        return ()
    draws, count = posterior.points[:, : len(fit.z)], len(posterior.derived)
    gradients, linear = _gradients(draws[:count], np.stack([each.posterior[:count] for each in asked], axis=1))
    chosen = [each for each, is_linear in zip(asked, linear, strict=True) if is_linear]
    if not chosen:
        return ()
    alone, without = _deviations_by_procedure(fit, procedures, gradients[linear])
    found = []
    for row, each in enumerate(chosen):
        sd = float(np.std(each.posterior))
        # No part of the data tells more than all of them, and none less than the prior, whose angles may be lengths.
        most = max(sd, float(np.std(each.prior)))
        alone_of, without_of = (np.clip(part[:, row], sd, most).tolist() for part in (alone, without))
        by = tuple(
            ProcedureShare(procedure=name, alone=one, without=others)
            for name, one, others in zip(procedures, alone_of, without_of, strict=True)
        )
        found.append(Contribution(quantity=each.name, unit=each.unit, sd=sd, by=by))
    return tuple(found)


def _deviations_by_procedure(
    fit: Fit, procedures: Sequence[str], gradients: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the deviations of quantities with gradients (n, P) from each procedure alone and without it, (L, n)."""
    model, problem = fit.model, fit.model.problem
    assert fit.mode is not None
    assert fit.posterior is not None
    of_run = np.array([procedures.index(run.procedure) for run in model.campaign.runs])
    of_entry = of_run[np.asarray(model.entries.run)]
    ends = tuple(np.cumsum(np.bincount(of_entry, minlength=len(procedures))).tolist())
    places = jnp.asarray(np.argsort(of_entry, kind="stable"))
    draws = evenly_spaced(len(fit.posterior.points), _SCALES)
    scales = jnp.asarray(fit.posterior.points[draws, len(fit.z) :])
    alone, without = _variances(problem, fit.mode.about, scales, places, ends, jnp.asarray(gradients))
    return np.sqrt(alone), np.sqrt(without)


@kept
def _variances(
    problem: Problem,
    about: Linearised,
    scales: Float[Array, "S H"],
    places: Int[Array, " E"],
    ends: tuple[int, ...],
    gradients: Float[Array, "n P"],
) -> Float[Array, "2 L n"]:
    """Return mean variances over noise scales, from each procedure alone and without it.

    Parameters
    ----------
    places : entries in order of procedures.
    ends : of the procedures in this order.
    """
    others = 1 - jnp.eye(len(ends))

    def variance(precision: Float[Array, "P P"]) -> Float[Array, " n"]:
        return jnp.sum(gradients * cho_solve(cho_factor(precision), gradients.T).T, axis=1)

    def at(h: Float[Array, " H"]) -> Float[Array, "2 L n"]:
        # Entries of different runs share no noise: each part of the whitened Jacobian stands for itself.
        jacobian = take(whitened_jacobian(problem, about, h), places)
        parts = [jacobian[first:end] for first, end in pairwise((0, *ends))]
        alone = jnp.stack([part.T @ part for part in parts])
        prior = jnp.diag(prior_widths(problem, h) ** -2)[None, None]
        # Summed, not taken from the whole: the difference would lose the digits of a small part.
        return jax.vmap(jax.vmap(variance))(prior + jnp.stack([alone, jnp.einsum("lk,kpq->lpq", others, alone)]))

    return jnp.mean(jax.lax.map(at, scales), axis=0)


def _gradients(z: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return slopes of quantities on z, (n, P), by regression over draws (D, P), and which they explain, (n,) bool."""
    centred, about = z - z.mean(axis=0), values - values.mean(axis=0)
    slopes, *_ = np.linalg.lstsq(centred, about)
    explained = 1 - np.var(about - centred @ slopes, axis=0) / np.maximum(np.var(about, axis=0), np.finfo(float).tiny)
    return slopes.T, explained > _LINEAR
