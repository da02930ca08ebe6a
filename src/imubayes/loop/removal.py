"""Effects taken out of the model of a fit: what may go, and where the refit starts."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace

from imubayes.effects.thermometer import TemperatureOffset
from imubayes.errors import InputError, Issue, closest_first, input_error
from imubayes.inference.fitted_model import Fit
from imubayes.loop.changed_model import ChangedModel, beyond, new_in
from imubayes.loop.refit import Refit, refit_changed, require_fit
from imubayes.model.bind import bind
from imubayes.model.effect_registry import Registry, names_in
from imubayes.model.model_spec import EffectSpec, ModelSpec, PriorCorrelation


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
        issue, what=f"{without} cannot be removed: {issue.what}", remedy="keep it, or remove what needs it as well"
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
    return member.covariate if issubclass(member, TemperatureOffset) else None


def _among(block: PriorCorrelation, names: Collection[str]) -> PriorCorrelation | None:
    """Return a correlation of the parameters of these effects alone; None where it correlates none."""
    places = [place for place, name in enumerate(block.parameters) if name.partition(".")[0] in names]
    if len(places) < 2:
        return None
    matrix = tuple(tuple(block.matrix[row][column] for column in places) for row in places)
    return replace(block, parameters=tuple(block.parameters[place] for place in places), matrix=matrix)


def _refuse_required(effects: Sequence[str], old: ModelSpec, new: ModelSpec, registry: Registry) -> None:
    """Raise where an effect is in the model again once it is bound: others, or the campaign itself, require it."""
    back = {each.name for each in new.effects}
    for name in effects:
        if name in back:
            covariate = _covariate_of(name, registry)
            users = _users(covariate, new.effects, registry) if covariate is not None else []
            cause = ", ".join(users) if users else "a procedure of the campaign"
            remedy = f"remove {' '.join(users)} as well" if users else "keep it"
            what = f"'{name}' cannot be removed: {cause} {'require' if len(users) > 1 else 'requires'} it"
            raise input_error(what, old.where, "effects that nothing else of the model requires", remedy)
