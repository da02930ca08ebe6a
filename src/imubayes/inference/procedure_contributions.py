"""Contributions of test procedures: the uncertainty of a quantity from one procedure alone, and without it.

Given the noise scales h the precision of the parameters is the prior's plus a sum over runs, JᵀΣ(h)⁻¹J of each.  With
the gradient c of a quantity its variance is cᵀΛ(h)⁻¹c for any sum that leaves something out, and its mean over draws of
h the variance that is reported: at the mode of h alone, the scatter between few runs is understated.  The standard
deviation from all runs is that of the posterior itself.  That holds for quantities that are linear in the parameters
over the posterior.  Angles near zero are left out: a linear variance would contradict their posterior.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from imubayes.foundations.arrays import cholesky, solve_lower
from imubayes.inference.fitted_model import Fit, evenly_spaced
from imubayes.inference.identifiability import Contribution, ProcedureShare
from imubayes.inference.parameter_fit import Linearised, whitened_columns
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


def contributions(
    fit: Fit, further: Sequence[QuantityDraws] = (), stated: Mapping[str, float] | None = None
) -> tuple[Contribution, ...]:
    """Return for each quantity that is linear in the parameters its uncertainty by procedure.

    Quantities are mounting angles, scale factors, and further ones, such as determined combinations.  Empty if the
    fit did not converge or there is one procedure alone.  `alone` is the standard deviation from the prior and the runs
    of one procedure, `without` that from all others; both in the unit of the quantity, with the gradient from the
    posterior draws.

    Parameters
    ----------
    further : quantities beside those of the fit.
    stated : standard uncertainties by name; of a quantity without one it is that of its draws.
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
    gradients, linear = _gradients_of_draws(draws[:count], np.stack([each.posterior[:count] for each in asked], axis=1))
    chosen = [each for each, is_linear in zip(asked, linear, strict=True) if is_linear]
    if not chosen:
        return ()
    alone, without = _deviations_by_procedure(fit, procedures, gradients[linear])
    by_procedure = zip(np.moveaxis(alone, 1, 0), np.moveaxis(without, 1, 0), strict=True)
    return tuple(
        _contribution(each, (stated or {}).get(each.name), procedures, *parts)
        for each, parts in zip(chosen, by_procedure, strict=True)
    )


def _contribution(
    of: QuantityDraws, stated: float | None, procedures: Sequence[str], alone: np.ndarray, without: np.ndarray
) -> Contribution:
    """Return a quantity with its standard uncertainty by procedure, (L,) each, and from all data."""
    sd = float(np.std(of.posterior)) if stated is None else stated
    # No part of the data determines more than all of them, and none less than the prior, whose angles may be lengths.
    most = max(sd, float(np.std(of.prior)))
    by = zip(procedures, np.clip(alone, sd, most).tolist(), np.clip(without, sd, most).tolist(), strict=True)
    shares = tuple(ProcedureShare(procedure=name, alone=one, without=others) for name, one, others in by)
    return Contribution(quantity=of.name, unit=of.unit, sd=sd, by=shares)


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
    places = np.asarray(np.argsort(of_entry, kind="stable"))
    draws = evenly_spaced(len(fit.posterior.points), _SCALES)
    scales = np.asarray(fit.posterior.points[draws, len(fit.z) :])
    alone, without = _variances(problem, fit.mode.about, scales, places, ends, np.asarray(gradients))
    return np.sqrt(alone), np.sqrt(without)


def _variances(
    problem: Problem,
    about: Linearised,
    scales: np.ndarray,
    places: np.ndarray,
    ends: tuple[int, ...],
    gradients: np.ndarray,
) -> np.ndarray:
    """Return mean variances over noise scales (S, H), from each procedure alone and without it, (2, L, n).

    Parameters
    ----------
    places : entries in order of procedures.
    ends : of the procedures in this order.
    gradients : of the quantities, (n, P).
    """
    others = 1 - np.eye(len(ends))

    def at(h: np.ndarray) -> np.ndarray:
        # Entries of different runs share no noise: each part of the whitened Jacobian stands for itself.
        jacobian = whitened_columns(problem, h, about.jacobian)[places]
        parts = [jacobian[first:end] for first, end in pairwise((0, *ends))]
        alone = np.stack([part.T @ part for part in parts])
        # Summed, not taken from the whole: the difference would lose the digits of a small part.
        both = np.stack([alone, np.tensordot(others, alone, 1)]) + np.diag(prior_widths(problem, h) ** -2)
        halves = [[solve_lower(cholesky(precision), gradients.T) for precision in each] for each in both]
        return np.sum(np.stack(halves) ** 2, axis=2)

    return np.mean([at(h) for h in scales], axis=0)


def _gradients_of_draws(z: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return slopes of quantities on z, (n, P), by regression over draws (D, P), and which they explain, (n,) bool."""
    centred, about = z - z.mean(axis=0), values - values.mean(axis=0)
    slopes, *_ = np.linalg.lstsq(centred, about)
    explained = 1 - np.var(about - centred @ slopes, axis=0) / np.maximum(np.var(about, axis=0), np.finfo(float).tiny)
    return slopes.T, explained > _LINEAR
