"""Effects added to the model of a fit: where the refit starts, and what is predicted of it."""

from collections.abc import Callable, Sequence

from imubayes.criticism.diagnosis_record import Diagnosis, ScreenedEffect
from imubayes.criticism.verdict import CoefficientEstimate
from imubayes.inference.fitted_model import Fit
from imubayes.loop.changed_model import ChangedModel
from imubayes.loop.refit import Refit, refit_changed, require_fit
from imubayes.loop.start_at_estimates import start_at_estimates
from imubayes.loop.warm_start import extend


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
    diagnosis : of the fit; its coefficients and scanned shapes are where the refit starts.
    progress : called with a short text as the work goes on.
    files : Python files that define effects, beside those of the model.

    Raises
    ------
    InputError
        for an effect that does not fit, and for a fit that cannot be started from.
    """
    require_fit(before)
    change = start_of_refit(before, effects, channels, diagnosis, files)
    screened = _screened(effects, diagnosis)
    known = screened[0] if screened and _one_finding(effects, diagnosis) else None
    return refit_changed(before, change, progress, _predicted_coefficients(change, known, len(effects) == 1))


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
) -> ChangedModel:
    """Return the model with effects added and the start of its refit (see `refit_with`)."""
    screened = _screened(effects, diagnosis)
    shape, hints = {}, {}
    for line in screened:
        shape |= {name if "." in name else f"{line.effect}.{name}": value for name, value in line.shape.items()}
        hints |= {each.name: each.value for each in line.coefficients if each.value is not None}
    estimates = [each for line in screened for each in line.coefficients]
    return start_at_estimates(extend(before, effects, channels, shape, hints, estimates, files), hints)


def _predicted_coefficients(
    change: ChangedModel, screened: ScreenedEffect | None, alone: bool
) -> tuple[CoefficientEstimate, ...]:
    """Return those of the diagnosis, where it estimated the same; of the linear model elsewhere."""
    of_diagnosis = screened is not None and (alone or change.delta_chi2 is None)
    return tuple(screened.coefficients if screened is not None and of_diagnosis else change.coefficients)
