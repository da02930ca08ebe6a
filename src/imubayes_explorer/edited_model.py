"""A model as edited on the page: another prior of a parameter, readings set aside with a reason, or taken back."""

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from imubayes.foundations.campaign_data import SetAside
from imubayes.foundations.errors import closest_first, input_error
from imubayes.model.bind import Model
from imubayes.model.bound_effects import BoundEffect, bind_effect
from imubayes.model.model_file import ModelSpec
from imubayes.model.parameter_priors import default_prior
from imubayes_explorer.messages import ChangeWanted
from imubayes_explorer.open_model import OpenModel


@dataclass(frozen=True)
class EditedModel:
    """A model as edited: what was done, in words, and in a word for its folder."""

    what: str
    word: str
    spec: ModelSpec


def edited_model(model: OpenModel, wanted: ChangeWanted) -> EditedModel:
    """Return a model edited as it was asked for; raises InputError for nothing, without a reason, or what is wrong."""
    fitted = model.readings.fit.model
    if wanted.prior_of:
        return EditedModel(f"prior of {wanted.prior_of}", "prior", with_prior(fitted, wanted.prior_of, wanted.prior))
    if wanted.take_back:
        return EditedModel("take readings back", "taken-back", with_taken_back(fitted.spec, wanted.take_back))
    if not wanted.aside:
        raise input_error("no change is named", "change", "effects, a prior, or readings", "choose one")
    if not wanted.reason.strip():
        raise input_error("no reason is given", "set aside", "the reason for leaving these readings out", "state it")
    spec = with_aside(model, model.table.chosen(wanted.aside), wanted.reason.strip())
    return EditedModel("set readings aside", "aside", spec)


def prior_text(model: Model, name: str) -> str:
    """Return the prior of a parameter as a model file has it; empty of what is no parameter."""
    if name not in model.parameter_names:
        return ""
    bound, field = _owner(model, name)
    declared, kind = bound.declared[field], next(iter(bound.kinds), "")
    return bound.spec.prior.get(field) or default_prior(declared, kind, model.campaign)


def with_prior(model: Model, name: str, text: str) -> ModelSpec:
    """Return a model with another prior of a parameter, and of those that share it; the default if it is empty.

    Raises
    ------
    InputError
        for an unknown parameter, and a prior that does not parse or does not suit the parameter, its unit included.
    """
    if name not in model.parameter_names:
        raise input_error(f"no parameter '{name}'", "prior", closest_first(name, model.parameter_names),
                          "choose a parameter of the model")  # fmt: skip
    bound, field = _owner(model, name)
    others = {each: said for each, said in bound.spec.prior.items() if each != field}
    edited = replace(bound.spec, prior=others | {field: text} if text else others)
    bind_effect(edited, model.assembly.grouping, model.registry)
    return replace(model.spec, effects=tuple(edited if each == bound.spec else each for each in model.spec.effects))


def _owner(model: Model, name: str) -> tuple[BoundEffect, str]:
    """Return the effect that a parameter belongs to, and its field."""
    for bound in model.assembly.effects:
        for parameter in (*bound.parameters, *bound.hyperparameters):
            if parameter.name == name:
                return bound, parameter.field
    raise AssertionError(name)


def with_aside(model: OpenModel, chosen: np.ndarray, reason: str) -> ModelSpec:
    """Return a model with chosen entries, (E,) bool, set aside: whole runs, channels of runs, or rows of these."""
    fitted, found = model.readings.fit.model, list[SetAside]()
    entries, names = fitted.entries, [channel.name for channel in fitted.campaign.channels]
    for place, run in enumerate(fitted.campaign.runs):
        own = (entries.run == place) & ~np.asarray(entries.closing)
        if not (chosen & own).any():
            continue
        if chosen[own].all() or run.tumble is not None:
            found.append(SetAside(run=run.name, reason=reason))
            continue
        alike: dict[tuple[int, ...], list[str]] = {}
        for k, name in enumerate(names):
            there = own & (entries.channel == k)
            rows = () if chosen[there].all() else tuple((1 + entries.row[there & chosen]).tolist())
            if (there & chosen).any():
                alike.setdefault(rows, []).append(name)
        found += [
            SetAside(run=run.name, channels=tuple(each), rows=rows, reason=reason) for rows, each in alike.items()
        ]
    if not found:
        raise input_error("no reading is selected", "set aside", "a selection", "select readings first")
    return replace(fitted.spec, set_aside=(*fitted.spec.set_aside, *found))


def with_taken_back(spec: ModelSpec, places: Collection[int]) -> ModelSpec:
    """Return a model without some of its entries of readings set aside."""
    left = (each for place, each in enumerate(spec.set_aside) if place not in places)
    return replace(spec, set_aside=tuple(left))
