"""The record of a change of a model: predicted and observed, cross-validation, residual rms before and after."""

from typing import Literal

import numpy as np
import polars as pl
from pydantic import PrivateAttr

from imubayes.adequacy.adequacy_record import ChannelRms
from imubayes.criticism.verdict import CoefficientEstimate, EffectChoice, RmsChange
from imubayes.inference.prior_conflict import PriorConflict
from imubayes.json_record import Record, finite
from imubayes.loop.changed_model import ChangedModel
from imubayes.loop.held_out_record import CrossValidation
from imubayes.loop.not_distinguished import NotDistinguished, not_distinguished
from imubayes.loop.refit import Prediction, Refit
from imubayes.representation import Presented
from imubayes.results.estimate_changes import EstimateChange, estimate_changes
from imubayes.results.output_units import in_output_units
from imubayes.results.result import Result
from imubayes.results.summary import Summary

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
    """A number of the fit before and after a change; None where it is unknown, or the refit is not taken."""

    before: float | None
    after: float | None


class Observation(Record):
    """What the refit found.

    Attributes
    ----------
    delta_chi2 : drop at the noise known beforehand, negative where χ² rose; where noise itself was changed, twice the
        rise of the log likelihood.
    coefficients : the new parameters.
    """

    delta_chi2: float | None
    coefficients: tuple[CoefficientEstimate, ...]


class ModelChange(Presented, Record):
    """Effects added to a model or removed from it, with the facts before and after.

    Attributes
    ----------
    added, removed : effects with their channels.
    widened : priors widened because the estimate lies outside the typical range, by ``effect.parameter``.
    taken, message : whether the refit converged and is no worse than the fit before, and why not.
    predicted, observed : Δχ² and coefficients before and after the refit.
    prior_conflicts : new parameters whose prior disagrees with the data.
    held_out : cross-validation; None where there was none.
    runs : residual rms of the fits in input units; empty where the refit is not taken.
    channels : the same at the noise known beforehand, offsets of runs included.
    moved : estimates that both fits have, those that moved most first; empty where the refit is not taken.
    undistinguished : of the effects added, those that the data do not distinguish.
    log_odds : natural logarithm of the odds of the effects removed, by the diagnosis that led to adding them; None
        where that is not at hand.
    offsets_moved : the channels whose residual rms rose although the residual within runs did not: the new effect no
        longer takes up the offsets of their runs.
    parent, folder : result folders before and after; None where there are none.
    """

    __repr__, __str__ = Presented.__repr__, Presented.__str__

    format: Literal[2] = 2
    added: tuple[EffectChoice, ...] = ()
    removed: tuple[EffectChoice, ...] = ()
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
    fresh = _new_parameters(refit, before)
    change = ModelChange(
        added=refit.change.added,
        removed=refit.change.removed,
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
    """Return the residual rms of each channel at the noise known beforehand, where both are known."""
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
    """Return the observed drop of χ² (see `Observation`)."""
    same = refit.fit.model.hyper_layout.names == refit.before.model.hyper_layout.names
    if not same or before.known_noise is None or after.known_noise is None:
        return finite(refit.delta_chi2)
    return before.known_noise.chi2 - after.known_noise.chi2


def added_variable(change: ChangedModel) -> pl.DataFrame:
    """Return the added-variable plot as a table: run, channel, added, residual; entries that the effect reaches."""
    model, entries = change.model, change.model.entries
    names = [*(channel.name for channel in model.campaign.channels), "closure_x", "closure_y", "closure_z"]
    runs = [run.name for run in model.campaign.runs]
    # Every entry changes slightly through what the old model absorbs; those are omitted.
    reached = np.abs(change.explained) > 1e-3 * np.max(np.abs(change.explained), initial=0.0)
    return pl.DataFrame(
        {
            "run": np.array(runs)[entries.run[reached]],
            "channel": np.array(names)[entries.channel[reached]],
            "added": change.explained[reached],
            "residual": change.residual[reached],
        }
    )
