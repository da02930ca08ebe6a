"""Contribution of each test procedure: the uncertainty of a quantity from one procedure alone, and without it.

Given the noise scales h the precision of the parameters is the prior's plus a sum over runs, JᵀΣ(h)⁻¹J of each.  With
the gradient c of a quantity its variance is cᵀΛ(h)⁻¹c for any sum that leaves something out, and its mean over draws of
h the variance that is reported: at the mode of h alone, the scatter between few runs is understated.  The standard
deviation from all runs is that of the posterior itself.

That holds for quantities that are linear in the parameters over the posterior.  An angle near zero is not: as a length
it has no gradient there, and is left out: a linear variance would contradict its posterior.
"""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from imubayes.inference.contribution_record import Contribution, ProcedureShare
from imubayes.inference.fitted_model import Fit, evenly_spaced
from imubayes.inference.posterior_precision import deviations, whitened_jacobian
from imubayes.model.problem import prior_widths

_QUANTITIES = ("mounting_angle[", "scale_factor[")
# Draws of the noise scales over which variances are averaged, as many as so many products allow.
_FEWEST_SCALES, _MOST_SCALES, _MOST_WORK = 8, 200, 3e9
# Least share of the posterior variance that a linear function of the parameters explains.
_LINEAR = 0.9


def contributions(fit: Fit) -> tuple[Contribution, ...]:
    """Return for each mounting angle and scale factor that is linear in the parameters its uncertainty by procedure.

    Empty where the fit did not converge or there is one procedure alone.  `alone` is the standard deviation from the
    prior and the runs of one procedure, `without` that from all others; both in the unit of the quantity, with the
    gradient from the posterior draws.
    """
    procedures = list(dict.fromkeys(run.procedure for run in fit.model.campaign.runs))
    posterior = fit.posterior
    if len(procedures) < 2 or posterior is None or fit.mode is None:
        return ()
    chosen = [place for place, name in enumerate(fit.derived.names) if name.name.startswith(_QUANTITIES)]
    draws = posterior.points[:, : len(fit.z)]
    gradients, linear = _gradients(draws, posterior.derived[:, chosen])
    chosen = [place for place, is_linear in zip(chosen, linear, strict=True) if is_linear]
    if not chosen:
        return ()
    alone, without = _deviations_by_procedure(fit, procedures, gradients[linear])
    found = []
    for row, place in enumerate(chosen):
        sd = float(np.std(posterior.derived[:, place]))
        # No part of the data tells more than all of them, and none less than the prior, whose angles may be lengths.
        most = max(sd, float(np.std(posterior.prior_derived[:, place])))
        alone_of, without_of = (np.clip(part[:, row], sd, most).tolist() for part in (alone, without))
        by = tuple(
            ProcedureShare(procedure=name, alone=one, without=others)
            for name, one, others in zip(procedures, alone_of, without_of, strict=True)
        )
        name = fit.derived.names[place]
        found.append(Contribution(quantity=name.name, unit=name.unit, sd=sd, by=by))
    return tuple(found)


def _deviations_by_procedure(
    fit: Fit, procedures: Sequence[str], gradients: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the deviations of quantities with gradients (n, P) from each procedure alone and without it, (L, n)."""
    model, problem = fit.model, fit.model.problem
    assert fit.mode is not None
    assert fit.posterior is not None
    of_run = np.array([procedures.index(run.procedure) for run in model.campaign.runs])[np.asarray(model.entries.run)]
    parts = [of_run == place for place in range(len(procedures))]
    work = of_run.size * gradients.shape[1] ** 2 * len(parts)
    count = int(np.clip(_MOST_WORK // work, _FEWEST_SCALES, _MOST_SCALES))
    scales = fit.posterior.points[evenly_spaced(len(fit.posterior.points), count), len(fit.z) :]
    alone, without = np.zeros((2, len(parts), len(gradients)))
    for h in jnp.asarray(scales):
        prior = np.diag(np.asarray(prior_widths(problem, h)) ** -2)
        # Entries of different runs share no noise: each part of the whitened Jacobian stands for itself.
        jacobian = np.asarray(whitened_jacobian(problem, fit.mode.about, h))
        information = [own.T @ own for own in (jacobian[part] for part in parts)]
        for place, own in enumerate(information):
            others = prior + sum(part for part in information if part is not own)
            alone[place] += deviations(gradients, prior + own) ** 2
            without[place] += deviations(gradients, others) ** 2
    return np.sqrt(alone / len(scales)), np.sqrt(without / len(scales))


def _gradients(z: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return slopes of quantities on z, (n, P), by regression over draws (D, P), and which they explain, (n,) bool."""
    centred, about = z - z.mean(axis=0), values - values.mean(axis=0)
    slopes, *_ = np.linalg.lstsq(centred, about)
    explained = 1 - np.var(about - centred @ slopes, axis=0) / np.maximum(np.var(about, axis=0), np.finfo(float).tiny)
    return slopes.T, explained > _LINEAR
