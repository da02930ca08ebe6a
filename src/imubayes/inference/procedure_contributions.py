"""Which test procedure told how much: the uncertainty of a quantity from one procedure alone, and without it.

At the mode the precision of the parameters is the prior's and a sum over runs, JᵀΣ⁻¹J of each.  With the gradient c of
a quantity its variance is cᵀΛ⁻¹c for any of the sums that leave something out.
"""

from typing import Any

import numpy as np

from imubayes.inference.joint_fit import JointFit
from imubayes.inference.posterior_precision import deviations, precision_of
from imubayes.model.problem import prior_widths

_QUANTITIES = ("mounting_angle[", "scale_factor[")


def contributions(fit: JointFit) -> list[dict[str, Any]]:
    """Return for each mounting angle and scale factor its uncertainty by procedure.

    Empty where the fit did not converge or there is one procedure alone.  `alone` is the standard deviation from the
    prior and the runs of one procedure, `without` that from all others; both in the unit of the quantity, with the
    gradient from the posterior draws.
    """
    campaign, model = fit.model.campaign, fit.model
    procedures = list(dict.fromkeys(run.procedure for run in campaign.runs))
    if len(procedures) < 2 or not bool(fit.mode.converged):
        return []
    chosen = [place for place, one in enumerate(fit.derived.names) if one.name.startswith(_QUANTITIES)]
    prior = np.diag(np.asarray(prior_widths(model.problem, fit.mode.h)) ** -2)
    of_run = np.array([procedures.index(run.procedure) for run in campaign.runs])[np.asarray(model.entries.run)]
    told = [
        precision_of(model.problem, fit.mode.about, fit.mode.h, of_run == place) for place in range(len(procedures))
    ]
    gradients = _gradients(fit, chosen)
    together = prior + sum(told)
    alone = [deviations(gradients, prior + one) for one in told]
    without = [deviations(gradients, together - one) for one in told]
    return [
        {
            "quantity": fit.derived.names[place].name,
            "unit": fit.derived.names[place].unit,
            "sd": float(sd),
            "by": [
                {"procedure": name, "alone": float(alone[one][row]), "without": float(without[one][row])}
                for one, name in enumerate(procedures)
            ],
        }
        for row, (place, sd) in enumerate(zip(chosen, deviations(gradients, together), strict=True))
    ]


def _gradients(fit: JointFit, chosen: list[int]) -> np.ndarray:
    """Return the slope of derived quantities on z, (n, P), by regression of the draws: they are nearly linear in it."""
    z, values = fit.points[fit.derived_from, : len(fit.mode.z)], fit.derived_draws[:, chosen]
    slopes, *_ = np.linalg.lstsq(z - z.mean(axis=0), values - values.mean(axis=0))
    return slopes.T
