"""A model with effects added, refitted from where the old fit stood, and what speaks for or against it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from imubayes.criticism.cross_validation import (
    cross_validate,
    objection,
    observed_delta_chi2,
)
from imubayes.criticism.diagnosis_record import Diagnosis, ScreenedEffect
from imubayes.criticism.held_out_record import CrossValidation
from imubayes.criticism.known_noise import known_scales
from imubayes.criticism.known_noise_fit import known_noise_point
from imubayes.criticism.verdict import CoefficientEstimate
from imubayes.criticism.warm_start import Extension, extend
from imubayes.errors import InputError, Issue
from imubayes.inference.fitted_model import Fit
from imubayes.inference.posterior_precision import linearise
from imubayes.inference.run_fit import joint_fit
from imubayes.json_record import Record, finite


class Prediction(Record):
    """What an addition was predicted to bring.

    Attributes
    ----------
    delta_chi2 : at the noise known beforehand; None where noise itself is added.
    coefficients : those of the diagnosis, where it estimated the same; by the linear model elsewhere, several effects
        together.
    """

    delta_chi2: float | None
    coefficients: tuple[CoefficientEstimate, ...]


@dataclass(frozen=True)
class Refit:
    """An extended model after its fit.

    Attributes
    ----------
    before : the fit before.
    extension : the extended model before its fit, with the prediction.
    fit : the refit.
    delta_chi2 : observed, at the noise scales of the fit before; NaN where the refit did not converge.
    objection : why the refit is not taken; empty where nothing speaks against it.
    held_out : cross-validation; None where there was none.
    predicted : what was predicted.
    """

    before: Fit
    extension: Extension
    fit: Fit
    delta_chi2: float
    objection: str
    held_out: CrossValidation | None
    predicted: Prediction


def refit_with(
    before: Fit,
    effects: Sequence[str],
    channels: Sequence[str] | None,
    diagnosis: Diagnosis | None,
    progress: Callable[[str], None],
    files: Sequence[str] = (),
) -> Refit:
    """Add effects to the model of a fit and fit again from where it stood.

    Parameters
    ----------
    before : the fit to start from.
    effects : names of effects or noise members.
    channels : for the new effects; all that they can act on where None.
    diagnosis : of the fit; what it estimates is where coefficients without a gradient, and scanned shapes, start.
    progress : called with a short text as the work goes on.
    files : Python files that define effects, beside those of the model.

    Raises
    ------
    InputError
        for an effect that does not fit, and for a fit that cannot be started from.
    """
    if not np.isfinite(before.z).all():
        raise InputError(
            Issue(
                f"there is no fit to go on from: {before.message}",
                before.model.spec.where,
                "a fit that converged",
                "mend what kept the fit from converging, fit again, then add",
            )
        )
    extension = start_of_refit(before, effects, channels, diagnosis, files)
    progress("fitting")
    fit = joint_fit(extension.model, None, start=(extension.z, extension.h), progress=progress)
    delta_chi2 = observed_delta_chi2(before, extension, fit) if fit.converged else float("nan")
    against = objection(fit, delta_chi2)
    unseen = None if against else cross_validate(before, fit, progress)
    screened = _screened(effects, diagnosis)
    known = screened[0] if screened and _one_finding(effects, diagnosis) else None
    coefficients = _predicted_coefficients(extension, known, len(effects) == 1)
    prediction = Prediction(delta_chi2=_predicted_drop(before, extension), coefficients=coefficients)
    return Refit(before, extension, fit, delta_chi2, against, unseen, prediction)


def _screened(effects: Sequence[str], diagnosis: Diagnosis | None) -> list[ScreenedEffect]:
    """Return what a diagnosis says of effects."""
    lines = [diagnosis.estimate(effect) for effect in effects] if diagnosis is not None else []
    return [line for line in lines if line is not None]


def _one_finding(effects: Sequence[str], diagnosis: Diagnosis | None) -> bool:
    """Tell whether effects stand for one finding: a single one, or several that the data do not distinguish."""
    groups = diagnosis.groups if diagnosis is not None else ()
    return len(effects) == 1 or any(set(effects) <= set(group.effects) for group in groups)


def start_of_refit(
    before: Fit,
    effects: Sequence[str],
    channels: Sequence[str] | None,
    diagnosis: Diagnosis | None,
    files: Sequence[str] = (),
) -> Extension:
    """Return the model with effects added and the start of its refit (see `refit_with`)."""
    screened = _screened(effects, diagnosis)
    shape, hints = {}, {}
    for line in screened:
        shape |= {name if "." in name else f"{line.effect}.{name}": value for name, value in line.shape.items()}
        hints |= {each.name: each.value for each in line.coefficients if each.value is not None}
    estimates = [each for line in screened for each in line.coefficients]
    return extend(before, effects, channels, shape, hints, estimates, files)


def _predicted_coefficients(
    extension: Extension, screened: ScreenedEffect | None, alone: bool
) -> tuple[CoefficientEstimate, ...]:
    """Return those of the diagnosis, where it estimated the same; of the linear model elsewhere."""
    of_diagnosis = screened is not None and (alone or extension.delta_chi2 is None)
    return tuple(screened.coefficients if screened is not None and of_diagnosis else extension.coefficients)


def _predicted_drop(before: Fit, extension: Extension) -> float | None:
    """Return the drop of χ² at the noise known beforehand, the models linear about the fit and the start of the refit.

    None where the noise has a new scale.
    """
    if extension.model.hyper_layout.names != before.model.hyper_layout.names:
        return None
    start = Fit(extension.model, extension.z, extension.h, False)
    was, now = (
        known_noise_point(fit.model, linearise(fit.model.problem, jnp.asarray(fit.z)), known_scales(fit)).record().chi2
        for fit in (before, start)
    )
    return finite(was - now)
