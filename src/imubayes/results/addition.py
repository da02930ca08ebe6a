"""The record of an addition: what was predicted and observed, cross-validation, residual rms before and after."""

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
import polars as pl
from pydantic import PrivateAttr

from imubayes.criticism.addition import Prediction, Refit
from imubayes.criticism.diagnosis_record import CoefficientEstimate
from imubayes.criticism.held_out_record import CrossValidation
from imubayes.criticism.model_history import ChannelRms
from imubayes.criticism.verdict import EffectChoice, RmsChange
from imubayes.criticism.warm_start import Extension
from imubayes.inference.prior_conflict import PriorConflict
from imubayes.json_record import Record, finite
from imubayes.representation import Presented
from imubayes.results.output_units import in_output_units
from imubayes.results.result import Result
from imubayes.results.summary import Summary


class RunRmsChange(Record):
    """Residual rms of one channel in one run before and after an addition; `n` entries."""

    name: str
    channel: str
    n: int
    before: float | None
    after: float | None
    unit: str


class BeforeAfter(Record):
    """A number of the fit before and after an addition; None where it is unknown, or the refit is not taken."""

    before: float | None
    after: float | None


class Observation(Record):
    """What the refit found.

    Attributes
    ----------
    delta_chi2 : at the noise scales of the fit before.
    delta_chi2_remaining : in units of the noise after the refit, as `Prediction.screened`; None where a noise scale is
        new, and where the refit is not taken.
    coefficients : the new parameters.
    """

    delta_chi2: float | None
    delta_chi2_remaining: float | None = None
    coefficients: tuple[CoefficientEstimate, ...]


class Addition(Presented, Record):
    """An addition to a model with the facts before and after.

    Attributes
    ----------
    added : effects with their channels.
    widened : priors widened because the estimate lies outside the typical range, by ``effect.parameter``.
    taken, message : whether the refit converged and is no worse than the fit before, and why not.
    predicted, observed : Δχ² and coefficients before and after the refit.
    prior_conflicts : new parameters whose prior disagrees with the data.
    held_out : cross-validation; None where there was none.
    runs, channels : residual rms in input units; empty where the refit is not taken.
    within_runs : of each channel about its mean in each run; empty where it is unknown as well.
    parent, folder : result folders before and after; None where there are none.
    """

    __repr__, __str__ = Presented.__repr__, Presented.__str__

    format: Literal[2] = 2
    added: tuple[EffectChoice, ...]
    widened: dict[str, str]
    taken: bool
    message: str
    predicted: Prediction
    observed: Observation
    prior_conflicts: tuple[PriorConflict, ...] = ()
    held_out: CrossValidation | None
    runs: tuple[RunRmsChange, ...]
    channels: tuple[RmsChange, ...]
    within_runs: tuple[RmsChange, ...] = ()
    chi2: BeforeAfter
    dof: BeforeAfter
    log_evidence: BeforeAfter
    parent: str | None
    folder: str | None
    _result: Result | None = PrivateAttr(None)

    @property
    def result(self) -> Result:
        """The refit; of an addition that was read from a folder, read it with `read_result`."""
        if self._result is None:
            raise AttributeError("the refit of an addition that was read from a folder: imubayes.read_result(folder)")
        return self._result

    def with_result(self, result: Result) -> "Addition":
        """Return the same record with its refit."""
        copy = self.model_copy()
        copy._result = result
        return copy


def addition_of(refit: Refit, result: Result, refitted: Result) -> Addition:
    """Return the record of an addition, from the refit and the results before and after."""
    before, after = result.summary, refitted.summary
    parent, folder = (str(each.folder) if each.folder is not None else None for each in (result, refitted))
    taken = not refit.objection
    fresh = _new_parameters(refit, before)
    added = refit.extension.model.spec.effects[len(refit.before.model.spec.effects) :]
    addition = Addition(
        added=tuple(EffectChoice(effect=spec.name, channels=spec.channels) for spec in added),
        widened=dict(refit.extension.widened),
        taken=taken,
        message=refit.objection,
        predicted=refit.predicted,
        observed=Observation(
            delta_chi2=finite(refit.delta_chi2),
            delta_chi2_remaining=refit.delta_chi2_remaining,
            coefficients=_estimates(after, fresh),
        ),
        prior_conflicts=tuple(conflict for conflict in after.prior_conflicts if conflict.name in fresh),
        held_out=refit.held_out,
        runs=_by_run(before, after) if taken else (),
        channels=_by_channel(before, after) if taken else (),
        within_runs=_by_channel(before, after, within=True) if taken else (),
        chi2=BeforeAfter(before=before.chi2, after=after.chi2 if taken else None),
        dof=BeforeAfter(before=before.dof, after=after.dof if taken else None),
        log_evidence=BeforeAfter(before=before.log_evidence, after=after.log_evidence),
        parent=parent,
        folder=folder,
    )
    return addition.with_result(refitted)


def _new_parameters(refit: Refit, before: Summary) -> set[str]:
    """Return the names of the parameters, those of the noise among them, that the model before lacks."""
    model, new = refit.extension.model, refit.extension.new.tolist()
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


def _by_channel(before: Summary, after: Summary, within: bool = False) -> tuple[RmsChange, ...]:
    """Return the residual rms of each channel, as a whole or about the mean of each run, where both are known."""

    def size(channel: ChannelRms) -> float | None:
        return channel.within if within else channel.rms

    was = {channel.channel: size(channel) for channel in channel_rms(before)}
    return tuple(
        RmsChange(channel=channel.channel, before=then, after=now, unit=channel.unit, within=within)
        for channel in channel_rms(after)
        if (then := was.get(channel.channel)) is not None and (now := size(channel)) is not None
    )


def channel_rms(summary: Summary) -> tuple[ChannelRms, ...]:
    """Return residual rms, as a whole and within runs, and assumed noise of each channel over all runs."""
    found = []
    for channel in dict.fromkeys(run.channel for run in summary.runs):
        runs = [run for run in summary.runs if run.channel == channel and run.n]
        rms = _pooled([(run.n, run.rms) for run in runs])
        if rms is not None:
            noise = _pooled([(run.n, run.noise) for run in runs])
            within = _pooled([(run.n, run.within) for run in runs])
            found.append(ChannelRms(channel=channel, rms=rms, unit=runs[0].unit, within=within, noise=noise))
    return tuple(found)


def _pooled(sizes: Sequence[tuple[int, float | None]]) -> float | None:
    """Return the rms over runs of (number, rms); None where no run has one."""
    known = [(count, size) for count, size in sizes if size is not None]
    if not known:
        return None
    return math.sqrt(sum(count * size**2 for count, size in known) / sum(count for count, _ in known))


def added_variable(extension: Extension) -> pl.DataFrame:
    """Return the added-variable plot as a table: run, channel, added, residual; entries that the effect reaches."""
    model, entries = extension.model, extension.model.entries
    names = [*(channel.name for channel in model.campaign.channels), "closure_x", "closure_y", "closure_z"]
    runs = [run.name for run in model.campaign.runs]
    # Every entry changes slightly through what the old model absorbs; those are omitted.
    reached = np.abs(extension.added) > 1e-3 * np.max(np.abs(extension.added), initial=0.0)
    return pl.DataFrame(
        {
            "run": np.array(runs)[entries.run[reached]],
            "channel": np.array(names)[entries.channel[reached]],
            "added": extension.added[reached],
            "residual": extension.residual[reached],
        }
    )
