"""A changed model, refitted from where the old fit stood, and what speaks for or against it."""

from collections.abc import Callable
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from imubayes.adequacy.known_noise import known_scales
from imubayes.adequacy.known_noise_fit import known_noise_point
from imubayes.criticism.verdict import CoefficientEstimate
from imubayes.errors import InputError, Issue
from imubayes.inference.fitted_model import Fit
from imubayes.inference.posterior_precision import linearise
from imubayes.inference.run_fit import joint_fit
from imubayes.json_record import Record, finite
from imubayes.loop.changed_model import ChangedModel
from imubayes.loop.cross_validation import cross_validate, objection, observed_delta_chi2
from imubayes.loop.held_out_record import CrossValidation


class Prediction(Record):
    """What a change was predicted to bring.

    Attributes
    ----------
    delta_chi2 : drop at the noise known beforehand, negative where χ² rises; None where noise itself is changed.
    coefficients : of effects added: those of the diagnosis, where it estimated the same; by the linear model elsewhere,
        several effects together.
    """

    delta_chi2: float | None
    coefficients: tuple[CoefficientEstimate, ...]


@dataclass(frozen=True)
class Refit:
    """A changed model after its fit.

    Attributes
    ----------
    before : the fit before.
    change : the changed model before its fit, with the prediction.
    fit : the refit.
    delta_chi2 : observed drop, at the noise scales of the fit before; NaN where the refit did not converge.
    objection : why the refit is not taken; empty where nothing speaks against it.
    held_out : cross-validation; None where there was none.
    predicted : what was predicted.
    """

    before: Fit
    change: ChangedModel
    fit: Fit
    delta_chi2: float
    objection: str
    held_out: CrossValidation | None
    predicted: Prediction


def require_fit(before: Fit) -> None:
    """Raise InputError for a fit that cannot be started from."""
    if not np.isfinite(before.z).all():
        raise InputError(
            Issue(
                f"there is no fit to go on from: {before.message}",
                before.model.spec.where,
                "a fit that converged",
                "mend what kept the fit from converging, fit again, then change the model",
            )
        )


def refit_changed(
    before: Fit,
    change: ChangedModel,
    progress: Callable[[str], None],
    coefficients: tuple[CoefficientEstimate, ...] = (),
) -> Refit:
    """Fit a changed model from where the fit before stood, and compare the two.

    Parameters
    ----------
    before : the fit before.
    change : the changed model with its start.
    progress : called with a short text as the work goes on.
    coefficients : predicted, of effects added.
    """
    progress("fitting")
    fit = joint_fit(change.model, None, start=(change.z, change.h), progress=progress)
    delta_chi2 = observed_delta_chi2(before, fit) if fit.converged else float("nan")
    against = objection(fit, delta_chi2, bool(change.removed))
    unseen = None if against else cross_validate(before, fit, progress, bool(change.removed))
    prediction = Prediction(delta_chi2=_predicted_drop(before, change), coefficients=coefficients)
    return Refit(before, change, fit, delta_chi2, against, unseen, prediction)


def _predicted_drop(before: Fit, change: ChangedModel) -> float | None:
    """Return the drop of χ² at the noise known beforehand, the models linear about the fit and the start of the refit.

    None where the noise has other scales.
    """
    if change.model.hyper_layout.names != before.model.hyper_layout.names:
        return None
    start = Fit(change.model, change.z, change.h, False)
    was, now = (
        known_noise_point(fit.model, linearise(fit.model.problem, jnp.asarray(fit.z)), known_scales(fit)).record().chi2
        for fit in (before, start)
    )
    return finite(was - now)
