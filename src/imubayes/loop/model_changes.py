"""Effects added to the model of a fit or taken out of it: what may go, where the refit starts, what is predicted.

An added effect starts at the one-step estimate, or at the coefficients that a diagnosis estimated if the posterior
is higher there.  The one-step estimate is linear about the null values.  Of effects with a gradient there it agrees
with the diagnosis, and takes account of several effects at once.  Of others the diagnosis knows more: it scanned the
shape and the sign.
"""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from imubayes.criticism.diagnosis_record import Diagnosis, ScreenedEffect
from imubayes.criticism.explanation_records import CoefficientEstimate
from imubayes.effects.thermometer import UncertainTemperature
from imubayes.foundations.errors import InputError, Issue, closest_first, input_error
from imubayes.foundations.quantity_names import QuantityName
from imubayes.inference.fitted_model import Fit
from imubayes.inference.posterior_mode import heights
from imubayes.loop.refit import Refit, refit_changed, require_fit
from imubayes.loop.warm_start import ChangedModel, beyond, extend, new_in, whitened
from imubayes.model.bind import Model, bind
from imubayes.model.effect_registry import Registry, names_in
from imubayes.model.model_file import EffectSpec, ModelSpec, PriorCorrelation
from imubayes.parameters.declarations import prior_values


def start_at_estimates(change: ChangedModel, estimates: Mapping[str, float]) -> ChangedModel:
    """Return a changed model that starts at estimates of its new parameters, if the posterior is higher there.

    Estimates outside the support of their priors are left out.

    Parameters
    ----------
    change : with the one-step estimate as its start.
    estimates : parameter name → value in its unit.
    """
    told = {
        place: z
        for place in np.flatnonzero(change.new).tolist()
        if (parameter := change.model.layout.parameters[place]).name in estimates
        and (z := parameter.z_at(estimates[parameter.name])) is not None
    }
    if not told:
        return change
    # At the mode before, and with the one-step estimates of all others.
    starts = [change.z.copy(), np.where(change.new, change.z, change.null)]
    for start in starts:
        start[list(told)] = list(told.values())
    starts = [change.z, *(_others_fitted(change, start) for start in starts)]
    best = int(np.argmax(heights(change.model.problem, starts, np.asarray(change.h))))
    return replace(change, z=starts[best])


def _others_fitted(change: ChangedModel, start: np.ndarray) -> np.ndarray:
    """Return a start, shape (P,), after a Gauss–Newton step of the parameters that the model had before."""
    residual, jacobian, widths = whitened(change.model.problem, start, change.h)
    old = ~change.new
    columns, precision = jacobian[:, old], np.diag(widths[old] ** -2)
    moved = start.copy()
    gradient = columns.T @ residual - start[old] * np.diag(precision)
    moved[old] += np.linalg.solve(columns.T @ columns + precision, gradient)
    return moved if np.isfinite(moved).all() else start


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
    channels : for the new effects; all that they can act on if None.
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
    """Return whether effects stand for one finding: a single one, or several that the data do not distinguish."""
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
    """Return those of the diagnosis, if it estimated the same; of the linear model elsewhere."""
    of_diagnosis = screened is not None and (alone or change.delta_chi2 is None)
    return tuple(screened.coefficients if screened is not None and of_diagnosis else change.coefficients)


def refit_without(before: Fit, effects: Sequence[str], progress: Callable[[str], None]) -> Refit:
    """Take effects out of the model of a fit and fit again from where it stood.

    Parameters
    ----------
    before : the fit to start from.
    effects : names of effects or noise members of its model.
    progress : called with a short text as the work goes on.

    Raises
    ------
    InputError
        for an effect that is not in the model or that others require, and for a fit that cannot be started from.
    """
    require_fit(before)
    return refit_changed(before, reduce(before, effects), progress)


def refit_edited(before: Fit, model: Model, progress: Callable[[str], None]) -> Refit:
    """Fit an edited model, bound, from where a fit stood: other priors, readings set aside or taken back.

    Parameters keep their values, not their places in the priors.  If the readings differ there is no Δχ² and no
    cross-validation.

    Raises
    ------
    InputError
        for a fit that cannot be started from.
    """
    require_fit(before)
    old, priors = before.model, (before.model.problem.priors, before.model.problem.hyper_priors)
    values = np.concatenate([prior_values(*each) for each in zip(priors, (before.z, before.h), strict=True)])
    known = dict(zip(old.parameter_names, values.tolist(), strict=True))
    z, h = (
        np.array([each.z_at(known.get(each.name, math.nan) / each.factor) or 0.0 for each in layout.parameters])
        for layout in (model.layout, model.hyper_layout)
    )
    added, removed = beyond(model.spec, old.spec), beyond(old.spec, model.spec)
    change = ChangedModel(model, z, h, z, new_in(model.layout, old.layout), added, removed)
    return refit_changed(before, change, progress, same_readings=model.campaign.set_aside == old.campaign.set_aside)


def reduce(before: Fit, effects: Sequence[str]) -> ChangedModel:
    """Return the model of a fit without effects, and the start of its refit: what stays keeps its z.

    Raises
    ------
    InputError
        for an effect that is not in the model, or that others of the model or its campaign require.
    """
    old = before.model
    registry = old.registry.without_files()
    spec = _without(old.spec, effects, old.registry)
    try:
        model = bind(spec, old.campaign, registry)
    except InputError as error:
        raise InputError(_of_removal(issue, effects) for issue in error.issues) from error
    _refuse_required(effects, old.spec, model.spec, old.registry)
    z = model.layout.carried(old.layout, before.z)
    h = model.hyper_layout.carried(old.hyper_layout, before.h)
    new = new_in(model.layout, old.layout)
    return ChangedModel(model, z, h, z, new, removed=beyond(old.spec, model.spec))


def _of_removal(issue: Issue, effects: Sequence[str]) -> Issue:
    """Return what is wrong with a model, as the consequence of a removal."""
    without = ", ".join(f"'{name}'" for name in effects)
    return replace(
        issue,
        what=f"{without} cannot be removed: {issue.what}",
        remedy="keep it, or also remove the effects that need it",
    )


def _without(spec: ModelSpec, effects: Sequence[str], registry: Registry) -> ModelSpec:
    """Return a model less effects, and less what nothing needs without them."""
    listed = dict.fromkeys(each.name for each in spec.effects)
    strange = [name for name in dict.fromkeys(effects) if name not in listed]
    if strange:
        known = ", ".join(f"'{name}'" for name in strange)
        raise input_error(
            f"the model has no effect {known}", spec.where, closest_first(strange[0], listed),
            "correct the name: the model file lists its effects",
        )  # fmt: skip
    kept = _needed(tuple(each for each in spec.effects if each.name not in effects), registry)
    names = {each.name for each in kept}
    files = tuple(file for file in spec.files if names & set(names_in(file)))
    blocks = (_among(block, names) for block in spec.correlations)
    return replace(spec, effects=kept, files=files, correlations=tuple(each for each in blocks if each is not None))


def _needed(entries: tuple[EffectSpec, ...], registry: Registry) -> tuple[EffectSpec, ...]:
    """Return the entries without errors of temperatures that no other depends on."""
    covariates = {each.name: _covariate_of(each.name, registry) for each in entries}
    return tuple(
        each for each in entries if (covariate := covariates[each.name]) is None or _users(covariate, entries, registry)
    )


def _users(covariate: str, entries: Sequence[EffectSpec], registry: Registry) -> list[str]:
    """Return the effects that depend on a temperature, its error not among them."""
    names = dict.fromkeys(each.name for each in entries)
    return [
        name for name in names if covariate in registry.effects[name].needs and _covariate_of(name, registry) is None
    ]


def _covariate_of(name: str, registry: Registry) -> str | None:
    """Return the temperature that an effect is the error of; None for any other effect."""
    member = registry.effects[name]
    return member.covariate if issubclass(member, UncertainTemperature) else None


def _among(block: PriorCorrelation, names: Collection[str]) -> PriorCorrelation | None:
    """Return a correlation of the parameters of these effects alone; None if it correlates none."""
    places = [place for place, name in enumerate(block.parameters) if QuantityName.of(name).effect in names]
    if len(places) < 2:
        return None
    matrix = tuple(tuple(block.matrix[row][column] for column in places) for row in places)
    return replace(block, parameters=tuple(block.parameters[place] for place in places), matrix=matrix)


def _refuse_required(effects: Sequence[str], old: ModelSpec, new: ModelSpec, registry: Registry) -> None:
    """Raise if an effect is in the model again once it is bound: others, or the campaign itself, require it."""
    back = {each.name for each in new.effects}
    for name in effects:
        if name in back:
            covariate = _covariate_of(name, registry)
            users = _users(covariate, new.effects, registry) if covariate is not None else []
            cause = ", ".join(users) if users else "a procedure of the campaign"
            remedy = f"remove {' '.join(users)} as well" if users else "keep it"
            what = f"'{name}' cannot be removed: {cause} {'require' if len(users) > 1 else 'requires'} it"
            raise input_error(what, old.where, "effects that nothing else of the model requires", remedy)
