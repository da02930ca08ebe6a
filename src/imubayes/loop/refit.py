"""The refit of a changed model: what speaks for or against it, and which added effects are not distinguished.

A changed model is refitted from where the old fit stood.

Which of several effects that were added the data do not distinguish is determined by the correlation of their
estimates.  Of two effects that do the same the estimates are correlated by −1; of five that do the same any two hardly
are, but each is the opposite of the sum of the others.  So it is the multiple correlation of an estimate with those of
the other effects that counts; of two it is the size of their correlation.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.adequacy.known_noise import known_scales
from imubayes.adequacy.known_noise_fit import known_noise_point
from imubayes.criticism.explanation_records import CoefficientEstimate
from imubayes.foundations.errors import input_error
from imubayes.foundations.records import Record, finite
from imubayes.inference.fitted_model import Fit, Posterior
from imubayes.inference.parameter_fit import linearise
from imubayes.inference.run_fit import joint_fit
from imubayes.loop.cross_validation import cross_validate, objection, observed_delta_chi2
from imubayes.loop.model_history import CrossValidation
from imubayes.loop.warm_start import ChangedModel
from imubayes.model.bind import Model


class Prediction(Record):
    """Predicted results of a change.

    Attributes
    ----------
    delta_chi2 : drop at the noise known beforehand, negative if χ² rises; None if noise itself is changed.
    coefficients : of effects added: those of the diagnosis if it estimated the same; otherwise by the linear model,
        several effects together.
    """

    delta_chi2: float | None
    coefficients: tuple[CoefficientEstimate, ...]


_NOT_PREDICTED = Prediction(delta_chi2=None, coefficients=())


@dataclass(frozen=True)
class Refit:
    """A changed model after its fit.

    Attributes
    ----------
    before : the fit before.
    change : the changed model before its fit, with the prediction.
    fit : the refit.
    delta_chi2 : observed drop, at the noise scales of the fit before; NaN where the refit did not converge.
    objection : why the refit is not taken; empty if nothing speaks against it.
    held_out : cross-validation; None if there was none.
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
        raise input_error(
            f"there is no fit to continue from: {before.message}",
            before.model.spec.where,
            "a fit that converged",
            "remove the cause, fit again until it converges, then change the model",
        )


def refit_changed(
    before: Fit,
    change: ChangedModel,
    progress: Callable[[str], None],
    coefficients: tuple[CoefficientEstimate, ...] = (),
    same_readings: bool = True,
) -> Refit:
    """Fit a changed model from where the fit before stood, and compare the two.

    Parameters
    ----------
    before : the fit before.
    change : the changed model with its start.
    progress : called with a short text as the work goes on.
    coefficients : predicted, of effects added.
    same_readings : whether both are fits of the same readings; χ² and predictions are not compared if not.
    """
    progress("fitting")
    fit = joint_fit(change.model, None, start=(change.z, change.h), progress=progress)
    may_rise = bool(change.removed) or not change.added
    if not same_readings:
        return Refit(before, change, fit, float("nan"), objection(fit, 0.0, True), None, _NOT_PREDICTED)
    delta_chi2 = observed_delta_chi2(before, fit) if fit.converged else float("nan")
    against = objection(fit, delta_chi2, may_rise)
    unseen = None if against else cross_validate(before, fit, progress, bool(change.removed))
    prediction = Prediction(delta_chi2=_predicted_drop(before, change), coefficients=coefficients)
    return Refit(before, change, fit, delta_chi2, against, unseen, prediction)


def _predicted_drop(before: Fit, change: ChangedModel) -> float | None:
    """Return the drop of χ² at the noise known beforehand, the models linear about the fit and the start of the refit.

    None if the noise has other scales.
    """
    if change.model.hyper_layout.names != before.model.hyper_layout.names:
        return None
    start = Fit(change.model, change.z, change.h, False)
    was, now = (
        known_noise_point(fit.model, linearise(fit.model.problem, np.asarray(fit.z)), known_scales(fit)).record().chi2
        for fit in (before, start)
    )
    return finite(was - now)


LEAST_CORRELATION = 0.95
# Two effects belong together if they are correlated so much with the others held.
_LINKED = 0.3


class NotDistinguished(Record):
    """Effects that the data do not distinguish, in the order in which they were added.

    Attributes
    ----------
    correlation : of two, the one of largest size between their estimates; of more, the largest multiple correlation of
        an estimate with those of the other effects.
    """

    effects: tuple[str, ...]
    correlation: float


def not_distinguished(model: Model, posterior: Posterior, effects: Sequence[str]) -> tuple[NotDistinguished, ...]:
    """Return the sets of effects whose estimates are correlated beyond 0.95.

    Parameters
    ----------
    model : with the effects.
    posterior : of the Laplace approximation, or sampled.
    effects : those that were added.
    """
    names = tuple(dict.fromkeys(effects))
    parameters = (*model.layout.parameters, *model.hyper_layout.parameters)
    places = [
        place for place, parameter in enumerate(parameters) if parameter.effect in names and not parameter.nuisance
    ]
    owner = np.array([names.index(parameters[place].effect) for place in places], dtype=int)
    if len(set(owner.tolist())) < 2:
        return ()
    correlation = np.corrcoef(posterior.points[:, places], rowvar=False)
    return tuple(
        NotDistinguished(effects=tuple(names[each] for each in together), correlation=size)
        for together, size in correlated_owners(correlation, owner)
    )


def correlated_owners(correlation: np.ndarray, owner: np.ndarray) -> list[tuple[list[int], float]]:
    """Return the sets of owners whose parameters are correlated beyond 0.95, with the correlation.

    Parameters
    ----------
    correlation : shape (K, K), of K parameters.
    owner : shape (K,), whose each of them is, counted from 0.
    """
    correlation = np.where(np.isfinite(correlation), correlation, np.eye(len(owner)))
    multiple = np.array([_multiple(correlation, place, owner != owner[place]) for place in range(len(owner))])
    tied = multiple > LEAST_CORRELATION
    precision = np.linalg.pinv(correlation, hermitian=True)
    scale = np.sqrt(np.diag(precision))
    linked = np.abs(precision / np.outer(scale, scale)) > _LINKED
    groups: list[set[int]] = []
    for first, second in zip(*np.nonzero(linked & np.outer(tied, tied)), strict=True):
        pair = {int(owner[first]), int(owner[second])}
        joined = [group for group in groups if group & pair]
        groups = [group for group in groups if not group & pair] + [pair.union(*joined)]
    found = [sorted(group) for group in groups if len(group) > 1]
    return sorted((group, _size(correlation, multiple, owner, group)) for group in found)


def _multiple(correlation: np.ndarray, place: int, others: np.ndarray) -> float:
    """Return the multiple correlation of one parameter with others, shape (K,) bool."""
    along = correlation[others, place]
    share = float(along @ np.linalg.pinv(correlation[np.ix_(others, others)], hermitian=True) @ along)
    return float(np.sqrt(np.clip(share, 0.0, 1.0)))


def _size(correlation: np.ndarray, multiple: np.ndarray, owner: np.ndarray, group: Sequence[int]) -> float:
    if len(group) > 2:
        return float(np.max(multiple[np.isin(owner, group)]))
    between = correlation[np.ix_(owner == group[0], owner == group[1])].ravel()
    return float(between[np.argmax(np.abs(between))])
