"""The outcome of a change of a model, and its files: `history.json`, `diagnosis.json`, `change.json`.

The record of a change holds prediction and observation, cross-validation, residual rms, and the estimates that moved.
`history.json` of a result says the model and what it was made from, the others document the steps between models.
"""

import os
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np
import polars as pl
from pydantic import PrivateAttr

from imubayes.adequacy.adequacy_record import ChannelRms
from imubayes.criticism.diagnosis_record import Diagnosis, EffectGroup
from imubayes.criticism.explanation_records import CoefficientEstimate, EffectChoice, RmsChange
from imubayes.foundations.campaign_data import SetAside
from imubayes.foundations.errors import InputError
from imubayes.foundations.records import Presented, Record, finite
from imubayes.inference.identifiability import PriorConflict
from imubayes.loop.model_history import ChiSquareDrop, CrossValidation, Node, Tree, removal_log_odds
from imubayes.loop.refit import NotDistinguished, Prediction, Refit, not_distinguished
from imubayes.loop.warm_start import ChangedModel
from imubayes.model.model_file import ModelSpec
from imubayes.results.fit_file import node_of
from imubayes.results.folder_files import ADDED_VARIABLE, CHANGE, DIAGNOSIS, RESIDUALS, add_to, added, checked
from imubayes.results.history_tree import read_node, read_tree
from imubayes.results.result import Result
from imubayes.results.summary import ParameterSummary, Quantity, Summary, in_output_units


class EstimateChange(Record):
    """An estimate before and after a change of the model.

    Attributes
    ----------
    name, unit : of the quantity.
    before, sd_before, after, sd_after : estimate and standard uncertainty.
    in_sd : after less before, in the smaller of the two standard uncertainties.
    """

    name: str
    unit: str
    before: float
    sd_before: float
    after: float
    sd_after: float
    in_sd: float


def estimate_changes(before: Summary, after: Summary) -> tuple[EstimateChange, ...]:
    """Return the estimates that both results have, those that moved most first; nuisance parameters are left out."""
    known = {each.name: each for each in _of_interest(before)}
    pairs = [(known[each.name], each) for each in _of_interest(after) if each.name in known]
    moved = [change for was, now in pairs if (change := _change(was, now)) is not None]
    return tuple(sorted(moved, key=lambda change: -abs(change.in_sd)))


def _of_interest(summary: Summary) -> list[Quantity]:
    shown = in_output_units(summary)
    every = (*shown.parameters, *shown.derived)
    return [
        each
        for each in every
        if not (isinstance(each, ParameterSummary) and each.nuisance) and not each.repeats_misalignments
    ]


def _change(was: Quantity, now: Quantity) -> EstimateChange | None:
    """Return the change of one estimate; None of one that is exact or unknown."""
    if was.mean is None or now.mean is None or not was.sd or not now.sd:
        return None
    return EstimateChange(
        name=now.name,
        unit=now.unit,
        before=was.mean,
        sd_before=was.sd,
        after=now.mean,
        sd_after=now.sd,
        in_sd=(now.mean - was.mean) / min(was.sd, now.sd),
    )


# Less than a hundredth more is no rise.
_RISEN = 1.01


class RunRmsChange(Record):
    """Residual rms of one channel in one run before and after a change; `n` entries."""

    name: str
    channel: str
    n: int
    before: float | None
    after: float | None
    unit: str


class BeforeAfter(Record):
    """A number of the fit before and after a change; None if it is unknown, or the refit is not taken."""

    before: float | None
    after: float | None


class Observation(Record):
    """Results of the refit.

    Attributes
    ----------
    delta_chi2 : drop at the noise known beforehand; of changed noise, 2 Δ ln L; None if other readings were fitted.
    coefficients : the new parameters.
    """

    delta_chi2: float | None
    coefficients: tuple[CoefficientEstimate, ...]


class ModelChange(Presented, Record):
    """Effects added to a model or removed from it, with the facts before and after.

    Attributes
    ----------
    added, removed : effects with their channels.
    priors : changed in the model file, by ``effect.parameter``; empty for the default.
    set_aside, taken_back : readings that the model leaves out, and no longer leaves out.
    widened : priors widened because the estimate lies outside the typical range, by ``effect.parameter``.
    taken, message : whether the refit converged and is no worse than the fit before, and the reason if not.
    predicted, observed : Δχ² and coefficients before and after the refit.
    prior_conflicts : new parameters whose prior disagrees with the data.
    held_out : cross-validation; None if there was none.
    runs : residual rms of the fits in input units; empty if the refit is not taken.
    channels : the same at the noise known beforehand, offsets of runs included.
    moved : estimates that both fits have, those that moved most first; empty if the refit is not taken.
    undistinguished : of the effects added, those that the data do not distinguish.
    log_odds : ln odds of the effects removed, by the diagnosis that led to adding them; None if that is not available.
    offsets_moved : channels whose rms rose only because the new effect no longer takes up the offsets of their runs.
    parent, folder : result folders before and after; None if there are none.

    Examples
    --------
    >>> import imubayes
    >>> imubayes.remove("results/accel-channel", ["converter_offset_drift"]).removed[0].effect
    'converter_offset_drift'
    """

    __repr__, __str__ = Presented.__repr__, Presented.__str__

    format: Literal[2] = 2
    added: tuple[EffectChoice, ...] = ()
    removed: tuple[EffectChoice, ...] = ()
    priors: dict[str, str] = {}
    set_aside: tuple[SetAside, ...] = ()
    taken_back: tuple[SetAside, ...] = ()
    widened: dict[str, str]
    taken: bool
    message: str
    predicted: Prediction
    observed: Observation
    prior_conflicts: tuple[PriorConflict, ...] = ()
    held_out: CrossValidation | None
    runs: tuple[RunRmsChange, ...]
    channels: tuple[RmsChange, ...]
    moved: tuple[EstimateChange, ...] = ()
    undistinguished: tuple[NotDistinguished, ...] = ()
    log_odds: float | None = None
    offsets_moved: tuple[str, ...] = ()
    chi2: BeforeAfter
    dof: BeforeAfter
    log_evidence: BeforeAfter
    parent: str | None
    folder: str | None
    _result: Result | None = PrivateAttr(None)

    @property
    def signed(self) -> tuple[tuple[Literal["+", "−"], EffectChoice], ...]:
        """The effects added, each with a plus sign, and those removed, each with a minus sign."""
        return (*(("+", each) for each in self.added), *(("−", each) for each in self.removed))

    @property
    def result(self) -> Result:
        """The refit; of a change that was read from a folder, read it with `read_result`."""
        if self._result is None:
            raise AttributeError("the refit of a change that was read from a folder: imubayes.read_result(folder)")
        return self._result

    def with_result(self, result: Result) -> "ModelChange":
        """Return the same record with its refit."""
        copy = self.model_copy()
        copy._result = result
        return copy


def change_of(refit: Refit, result: Result, refitted: Result, log_odds: float | None = None) -> ModelChange:
    """Return the record of a change, from the refit and the results before and after.

    Parameters
    ----------
    refit : of the changed model.
    result, refitted : before and after.
    log_odds : of effects removed (see `ModelChange`).
    """
    before, after = result.summary, refitted.summary
    parent, folder = (str(each.folder) if each.folder is not None else None for each in (result, refitted))
    taken = not refit.objection
    was, now = refit.before.model.spec, refit.change.model.spec
    fresh = _new_parameters(refit, before)
    change = ModelChange(
        added=refit.change.added,
        removed=refit.change.removed,
        priors=_new_priors(was, now),
        set_aside=_left_out(now, was),
        taken_back=_left_out(was, now),
        widened=dict(refit.change.widened),
        taken=taken,
        message=refit.objection,
        predicted=refit.predicted,
        observed=Observation(
            delta_chi2=_drop(refit, before, after),
            coefficients=_estimates(after, fresh),
        ),
        prior_conflicts=tuple(conflict for conflict in after.prior_conflicts if conflict.name in fresh),
        held_out=refit.held_out,
        runs=_by_run(before, after) if taken else (),
        channels=_by_channel(before, after) if taken else (),
        moved=estimate_changes(before, after) if taken else (),
        undistinguished=_undistinguished(refit) if taken else (),
        log_odds=log_odds,
        offsets_moved=offsets_moved(before, after) if taken else (),
        chi2=BeforeAfter(before=before.chi2, after=after.chi2 if taken else None),
        dof=BeforeAfter(before=before.dof, after=after.dof if taken else None),
        log_evidence=BeforeAfter(before=before.log_evidence, after=after.log_evidence),
        parent=parent,
        folder=folder,
    )
    return change.with_result(refitted)


def _left_out(one: ModelSpec, other: ModelSpec) -> tuple[SetAside, ...]:
    """Return the readings that one model leaves out and another does not."""
    return tuple(each for each in one.set_aside if each not in other.set_aside)


def _new_priors(was: ModelSpec, now: ModelSpec) -> dict[str, str]:
    """Return the priors of effects that both models have, if they are written differently."""
    known = {(each.name, each.channels): dict(each.prior) for each in was.effects}
    return {
        f"{each.name}.{field}": each.prior.get(field, "")
        for each in now.effects
        if (before := known.get((each.name, each.channels))) is not None
        for field in before | dict(each.prior)
        if before.get(field) != each.prior.get(field)
    }


def _undistinguished(refit: Refit) -> tuple[NotDistinguished, ...]:
    """Return which of the effects added the data do not distinguish."""
    posterior = refit.fit.posterior
    if posterior is None:
        return ()
    return not_distinguished(refit.fit.model, posterior, [choice.effect for choice in refit.change.added])


def _new_parameters(refit: Refit, before: Summary) -> set[str]:
    """Return the names of the parameters, those of the noise among them, that the model before lacks."""
    model, new = refit.change.model, refit.change.new.tolist()
    known = {parameter.name for parameter in before.parameters}
    fresh = {name for name, is_new in zip(model.layout.names, new, strict=True) if is_new}
    return fresh | {name for name in model.hyper_layout.names if name not in known}


def _estimates(summary: Summary, names: set[str]) -> tuple[CoefficientEstimate, ...]:
    return tuple(
        CoefficientEstimate(name=parameter.name, value=parameter.mean, sd=parameter.sd, unit=parameter.unit)
        for parameter in in_output_units(summary).parameters
        if parameter.name in names
    )


def _by_run(before: Summary, after: Summary) -> tuple[RunRmsChange, ...]:
    was = {(run.name, run.channel): run.rms for run in before.runs}
    return tuple(
        RunRmsChange(
            name=run.name,
            channel=run.channel,
            n=run.n,
            before=was.get((run.name, run.channel)),
            after=run.rms,
            unit=run.unit,
        )
        for run in after.runs
    )


def _by_channel(before: Summary, after: Summary) -> tuple[RmsChange, ...]:
    """Return the residual rms of each channel at the noise known beforehand, if both are known."""
    return tuple(
        RmsChange(channel=now.channel, before=was.rms, after=now.rms, unit=now.unit)
        for was, now in _both(before, after)
    )


def offsets_moved(before: Summary, after: Summary) -> tuple[str, ...]:
    """Return the channels whose residual rms rose though not within runs, at the noise known beforehand."""
    return tuple(
        now.channel
        for was, now in _both(before, after)
        if was.within is not None and now.within is not None
        if now.rms > _RISEN * was.rms and now.within <= _RISEN * was.within
    )


def _both(before: Summary, after: Summary) -> list[tuple[ChannelRms, ChannelRms]]:
    known = {each.channel: each for each in channel_rms(before)}
    return [(known[each.channel], each) for each in channel_rms(after) if each.channel in known]


def channel_rms(summary: Summary) -> tuple[ChannelRms, ...]:
    """Return the residual of each channel at the noise known beforehand; empty in results of earlier versions."""
    return summary.known_noise.channels if summary.known_noise is not None else ()


def _drop(refit: Refit, before: Summary, after: Summary) -> float | None:
    """Return the observed drop of χ² (see `Observation`); None if the readings differ."""
    if refit.fit.model.campaign.set_aside != refit.before.model.campaign.set_aside:
        return None
    same = refit.fit.model.hyper_layout.names == refit.before.model.hyper_layout.names
    if not same or before.known_noise is None or after.known_noise is None:
        return finite(refit.delta_chi2)
    return before.known_noise.chi2 - after.known_noise.chi2


def added_variable(change: ChangedModel) -> pl.DataFrame:
    """Return the added-variable plot as a table: run, channel, added, residual; entries that the effect reaches."""
    model, entries = change.model, change.model.entries
    runs = [run.name for run in model.campaign.runs]
    # Every entry changes slightly through what the old model absorbs; those are omitted.
    reached = np.abs(change.explained) > 1e-3 * np.max(np.abs(change.explained), initial=0.0)
    return pl.DataFrame(
        {
            "run": np.array(runs)[entries.run[reached]],
            "channel": model.output_names[entries.channel[reached]],
            "added": change.explained[reached],
            "residual": change.residual[reached],
        }
    )


def next_node(parent: Path | None, change: ModelChange, diagnosis: Diagnosis | None, seed: int) -> Node:
    """Return the node of a changed model; of one that was made from no folder, a first one.

    Parameters
    ----------
    parent : result folder that it was made from.
    change : what was done, with the refit, whose folder is known.
    diagnosis : that led to it.
    """
    refitted = change.result
    if parent is None or refitted.folder is None:
        return node_of(refitted.fit.model, refitted.summary, seed)
    held_out = change.held_out
    return node_of(
        refitted.fit.model,
        refitted.summary,
        seed,
        read_node(parent).id,
        parent=os.path.relpath(parent.resolve(), refitted.folder.resolve()),
        added=change.added,
        removed=change.removed,
        priors=tuple(change.priors),
        aside=tuple(dict.fromkeys(each.run for each in (*change.set_aside, *change.taken_back))),
        verdict=diagnosis.verdict if diagnosis is not None else None,
        offsets_moved=change.offsets_moved,
        delta_chi2=ChiSquareDrop(predicted=change.predicted.delta_chi2, observed=change.observed.delta_chi2),
        held_out=held_out.model_copy(update={"each": (), "rates": ()}) if held_out is not None else None,
        taken=change.taken,
        message=change.message,
    )


def write_diagnosis(folder: Path, diagnosis: Diagnosis, identity: str = "") -> None:
    """Keep a diagnosis in the folder of the result that was diagnosed; `identity` is that of its fit."""
    add_to(folder, DIAGNOSIS, diagnosis.json_text(), identity)


def read_diagnosis(folder: Path) -> Diagnosis | None:
    """Return the diagnosis that a result folder holds; None if there is none of this version.

    Raises
    ------
    InputError
        if the result is not whole, or the diagnosis is altered or of another fit.
    """
    file = added(folder, DIAGNOSIS)
    return _read(file, Diagnosis) if file is not None else None


def read_change(folder: Path) -> ModelChange | None:
    """Return the change that made a result; None for a folder that holds none of this version."""
    return _read(folder / CHANGE, ModelChange) if checked(folder).holds(CHANGE) else None


def log_odds_of_removal(folder: Path, removed: Collection[str], kept: Collection[str]) -> float | None:
    """Return the log odds of effects by the latest diagnosis on the way to a result that names them; else None.

    Parameters
    ----------
    folder : of the result that the effects are removed from.
    removed, kept : effects that go, and that its model keeps.
    """
    try:
        tree = read_tree([folder])
    except InputError:
        return None
    for place in reversed(tree.path_to(str(folder.resolve()))):
        diagnosis = read_diagnosis(Path(place))
        found = diagnosis.explanations if diagnosis is not None else None
        odds = removal_log_odds(found, removed, kept) if found is not None else None
        if odds is not None:
            return odds
    return None


def _table(file: Path) -> pl.DataFrame | None:
    return pl.read_parquet(file) if file.is_file() else None


def _read[Kept: Record](file: Path, record: type[Kept]) -> Kept | None:
    try:
        return record.model_validate_json(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


@dataclass(frozen=True)
class HistoryStep:
    """A step from one model to the next, as the result folders on both sides of it hold it; None for what is gone.

    Attributes
    ----------
    node : of the model after the step.
    change : what the step brought.
    group : the effects that the diagnosis before found first.
    before, after : residuals of both fits.
    added_variable : the added-variable plot as a table.
    """

    node: Node
    change: ModelChange | None
    group: EffectGroup | None
    before: pl.DataFrame | None
    after: pl.DataFrame | None
    added_variable: pl.DataFrame | None


def read_steps(tree: Tree, place: str) -> Iterator[HistoryStep]:
    """Yield the steps from the first model to the one at a place."""
    for before, after in pairwise(map(Path, tree.path_to(place))):
        diagnosis = read_diagnosis(before)
        yield HistoryStep(
            node=tree.nodes[str(after)],
            change=read_change(after),
            group=diagnosis.groups[0] if diagnosis is not None and diagnosis.groups else None,
            before=_table(before / RESIDUALS),
            after=_table(after / RESIDUALS),
            added_variable=_table(after / ADDED_VARIABLE) if checked(after).holds(ADDED_VARIABLE) else None,
        )
