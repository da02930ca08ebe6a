"""Contribution of each test procedure: the uncertainty of a quantity from one procedure alone, and without it.

At the mode the precision of the parameters is the prior's plus a sum over runs, JᵀΣ⁻¹J of each.  With the gradient c of
a quantity its variance is cᵀΛ⁻¹c for any sum that leaves something out.

That holds for quantities that are linear in the parameters over the posterior.  An angle near zero is not: as a length
it has no gradient there, and is left out: a linear variance would contradict its posterior.
"""

import numpy as np

from imubayes.inference.fitted_model import Fit
from imubayes.inference.posterior_precision import deviations, precision_of
from imubayes.json_record import Record
from imubayes.model.problem import prior_widths

_QUANTITIES = ("mounting_angle[", "scale_factor[")
# Least share of the posterior variance that a linear function of the parameters explains.
_LINEAR = 0.9


class ProcedureShare(Record):
    """Standard deviation of a quantity from the runs of one procedure alone, and without them."""

    procedure: str
    alone: float
    without: float


class Contribution(Record):
    """Standard deviation of a quantity at the mode, by test procedure."""

    quantity: str
    unit: str
    sd: float
    by: tuple[ProcedureShare, ...]


def contributions(fit: Fit) -> tuple[Contribution, ...]:
    """Return for each mounting angle and scale factor that is linear in the parameters its uncertainty by procedure.

    Empty where the fit did not converge or there is one procedure alone.  `alone` is the standard deviation from the
    prior and the runs of one procedure, `without` that from all others; both in the unit of the quantity, with the
    gradient from the posterior draws.
    """
    campaign, model = fit.model.campaign, fit.model
    procedures = list(dict.fromkeys(run.procedure for run in campaign.runs))
    if len(procedures) < 2 or fit.posterior is None or fit.mode is None:
        return ()
    chosen = [place for place, name in enumerate(fit.derived.names) if name.name.startswith(_QUANTITIES)]
    prior = np.diag(np.asarray(prior_widths(model.problem, fit.mode.h)) ** -2)
    of_run = np.array([procedures.index(run.procedure) for run in campaign.runs])[np.asarray(model.entries.run)]
    information = [
        precision_of(model.problem, fit.mode.about, fit.mode.h, of_run == place) for place in range(len(procedures))
    ]
    posterior = fit.posterior
    draws = posterior.points[posterior.derived_rows, : len(fit.z)]
    gradients, linear = _gradients(draws, posterior.derived[:, chosen])
    chosen = [place for place, is_linear in zip(chosen, linear, strict=True) if is_linear]
    gradients = gradients[linear]
    together = prior + sum(information)
    alone = [deviations(gradients, prior + own) for own in information]
    without = [deviations(gradients, together - own) for own in information]
    return tuple(
        Contribution(
            quantity=fit.derived.names[place].name,
            unit=fit.derived.names[place].unit,
            sd=float(sd),
            by=tuple(
                ProcedureShare(procedure=name, alone=float(alone[number][row]), without=float(without[number][row]))
                for number, name in enumerate(procedures)
            ),
        )
        for row, (place, sd) in enumerate(zip(chosen, deviations(gradients, together), strict=True))
    )


def _gradients(z: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return slopes of quantities on z, (n, P), by regression over draws (D, P), and which they explain, (n,) bool."""
    centred, about = z - z.mean(axis=0), values - values.mean(axis=0)
    slopes, *_ = np.linalg.lstsq(centred, about)
    explained = 1 - np.var(about - centred @ slopes, axis=0) / np.maximum(np.var(about, axis=0), np.finfo(float).tiny)
    return slopes.T, explained > _LINEAR
