"""Runs that were not fitted, joined to those of a fit, so that its model says what they share with it.

Equipment of one name belongs to both: channels, tables and mountings.  Equipment of the same name that is stated
otherwise, or that the user says was changed (a unit taken off its seat and put back), is another one, with parameters
of its own.  A run that was fitted is no prediction, and is left out.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from imubayes.effects.base import MotionEffect, Stage
from imubayes.foundations.campaign_data import Campaign, Channel, Run
from imubayes.foundations.errors import Issue, closest_first, input_error, refuse
from imubayes.inference.fitted_model import Fit
from imubayes.model.bind import Model, bind

_NEW = " (new)"
# Axes and scales that agree so well are the same: files state them to so many digits.
_SAME = 1e-9


@dataclass(frozen=True)
class JoinedCampaign:
    """Runs of one campaign and of another of the same unit, at the site of the latter.

    Attributes
    ----------
    campaign : all runs; those of the other campaign that bear the name of one before have another.
    runs : names of the runs of the other campaign that are new.
    fitted : names of those that the first has already; they are left out.
    changed : tables and mountings that bear the name of one of the first and are another one.
    elsewhere : whether the sites differ, whose errors are then their own.
    """

    campaign: Campaign
    runs: tuple[str, ...]
    fitted: tuple[str, ...]
    changed: tuple[str, ...]
    elsewhere: bool

    def of_site(self, model: Model) -> set[str]:
        """Return the parameters of a model that are errors of the site; none if the sites are one."""
        return {
            parameter.name
            for effect in model.assembly.effects
            if self.elsewhere and issubclass(effect.effect_class, MotionEffect)
            if effect.effect_class.stage == Stage.STAND and "table" not in effect.sharing
            for parameter in effect.parameters
        }

    def lasting(self, model: Model) -> set[str]:
        """Return the parameters of a model that are of the unit, or of equipment and site that stayed."""
        return {
            parameter.name
            for effect in model.assembly.effects
            for parameter in effect.parameters
            if not any(
                axis in ("run", "pose") or (axis in ("table", "mounting") and part in self.changed)
                for axis, part in zip(effect.per_of(parameter.field), parameter.label, strict=False)
            )
        } - self.of_site(model)


@dataclass(frozen=True)
class JoinedRuns:
    """The model of a fit, bound to its runs and to new ones."""

    model: Model
    together: JoinedCampaign

    @property
    def entries(self) -> np.ndarray:
        """Which entries are of new runs, (E,) bool."""
        known = [run.name in self.together.runs for run in self.model.campaign.runs]
        return np.array(known, dtype=bool)[self.model.entries.run]

    def shared_with(self, fit: Fit) -> np.ndarray:
        """Return which parameters, (P,) bool, the fit informs on: what it has, less the errors of another site."""
        own = set(fit.model.layout.names) - self.together.of_site(fit.model)
        return np.array([name in own for name in self.model.layout.names], dtype=bool)


def joined_runs(fit: Fit, campaign: Campaign, changed: Sequence[str] = (), any_unit: bool = False) -> JoinedRuns:
    """Return the model of a fit on its runs and on those of another campaign; see `joined_campaign`.

    Raises
    ------
    InputError
        as of `joined_campaign`, and if the model does not fit the new runs.
    """
    together = joined_campaign(fit.model.campaign, campaign, changed, any_unit)
    registry = fit.model.registry.without_files()
    return JoinedRuns(bind(fit.model.spec_of_known, together.campaign, registry, single_runs=True), together)


def joined_campaign(
    known: Campaign, campaign: Campaign, changed: Sequence[str] = (), any_unit: bool = False
) -> JoinedCampaign:
    """Return the runs of two campaigns of one unit.

    Parameters
    ----------
    changed : tables and mountings that are not those of the first, although they are named alike.
    any_unit : whether the second may be of another unit.

    Raises
    ------
    InputError
        for a campaign of another unit, with other channels, or without a run that the first has not.
    """
    _refuse_other_unit(known, campaign, any_unit)
    _refuse_unknown_names(campaign, changed)
    channels = _all_channels(known, campaign)
    new = _new_runs(known, campaign)
    tables, renamed_tables = _beside(known.tables, campaign.tables, changed)
    mountings, renamed_mountings = _beside(known.mountings, campaign.mountings, changed)
    thermometers, renamed_thermometers = _beside(known.thermometers, campaign.thermometers, changed)
    taken = {run.name for run in known.runs}
    runs = [
        replace(
            _over(run, campaign.channels, channels),
            name=run.name + (_NEW if run.name in taken else ""),
            table=renamed_tables.get(run.table or "", run.table),
            mounting=renamed_mountings.get(run.mounting or "", run.mounting),
            thermometer=renamed_thermometers.get(run.thermometer or "", run.thermometer),
            converter_thermometer=renamed_thermometers.get(run.converter_thermometer or "", run.converter_thermometer),
        )
        for run in new
    ]
    together = replace(
        known,
        site=campaign.site,
        channels=channels,
        tables=tables,
        mountings=mountings,
        thermometers=thermometers,
        runs=(*(_over(run, known.channels, channels) for run in known.runs), *runs),
        digest="",
    )
    return JoinedCampaign(
        campaign=together,
        runs=tuple(run.name for run in runs),
        fitted=tuple(run.name for run in campaign.runs if not any(run is other for other in new)),
        changed=(*renamed_tables, *renamed_mountings, *renamed_thermometers),
        elsewhere=campaign.site != known.site,
    )


def _new_runs(known: Campaign, campaign: Campaign) -> list[Run]:
    new = [run for run in campaign.runs if not any(_same_readings(run, old) for old in known.runs)]
    if new:
        return new
    raise input_error(
        f"all runs of '{campaign.name}' are in the fit already",
        campaign.folder or campaign.name,
        "a campaign with runs that the fit does not contain",
        "name a campaign with other runs, or a result of one; `imubayes history` compares models of the same runs",
    )


def _refuse_other_unit(known: Campaign, campaign: Campaign, any_unit: bool) -> None:
    if any_unit or known.serial == campaign.serial or not (known.serial and campaign.serial):
        return
    raise input_error(
        f"the campaign is of unit '{campaign.serial}', the fit of '{known.serial}'",
        campaign.folder or campaign.name,
        f"runs of the unit '{known.serial}'",
        "name a campaign of that unit; to compare two units: --any-unit",
    )


def _refuse_unknown_names(campaign: Campaign, changed: Sequence[str]) -> None:
    equipment = [*campaign.tables, *campaign.mountings, *campaign.thermometers]
    refuse(
        Issue(
            f"'{name}' is not a table, mounting or thermometer of the campaign",
            "--changed",
            closest_first(name, equipment),
            "name tables, mountings and thermometers of the new runs",
        )
        for name in changed
        if name not in equipment
    )


def _all_channels(known: Campaign, campaign: Campaign) -> tuple[Channel, ...]:
    """Return the channels of the fit, and the angle of a table if new runs alone have it."""
    names = {channel.name: channel for channel in known.channels}
    issues, further = [], []
    for channel in campaign.channels:
        fitted = names.get(channel.name)
        if fitted is None and channel.kind == "angle":
            further.append(channel)
        elif fitted is None or not _same_channel(fitted, channel):
            what = "is not one of the fit" if fitted is None else "has another axis, scale or offset than in the fit"
            where = f"{campaign.folder or campaign.name}, channel '{channel.name}'"
            allowed = "kind, axes, scale and offset as in the campaign that was fitted"
            remedy = "state the same kind, axes, scale and offset: estimated errors are deviations from these values"
            issues.append(Issue(f"channel '{channel.name}' {what}", where, allowed, remedy))
    refuse(issues)
    return (*known.channels, *further)


def _same_channel(one: Channel, other: Channel) -> bool:
    numbers = np.array([[each.scale_si, each.offset] for each in (one, other)])
    alike = np.allclose(numbers[0], numbers[1], rtol=_SAME, atol=0) and np.allclose(one.axes, other.axes, atol=_SAME)
    return one.kind == other.kind and bool(alike)


def _same_readings(one: Run, other: Run) -> bool:
    """Return whether two runs are one record: the same readings, whatever the channels beside them."""
    if one.rows != other.rows or one.procedure != other.procedure:
        return False
    first, second = (run.observed[:, np.isfinite(run.observed).any(axis=0)] for run in (one, other))
    return first.shape == second.shape and bool(np.array_equal(first, second, equal_nan=True))


def _beside[Equipment](
    known: Mapping[str, Equipment], others: Mapping[str, Equipment], changed: Sequence[str]
) -> tuple[dict[str, Equipment], dict[str, str]]:
    """Return all equipment by name, and the new names of what is not that of the fit."""
    renamed = {
        name: name + _NEW
        for name, each in others.items()
        if name in known and (name in changed or not _equal(known[name], each))
    }
    further = {renamed.get(name, name): each for name, each in others.items()}
    return {**further, **known}, renamed


def _equal(one: object, other: object) -> bool:
    pairs = [(getattr(one, each.name), getattr(other, each.name)) for each in fields(one)]  # pyright: ignore[reportArgumentType]
    return all(
        np.allclose(a, b, atol=_SAME) if isinstance(a, np.ndarray) and isinstance(b, np.ndarray) else a == b
        for a, b in pairs
    )


def _over(run: Run, own: Sequence[Channel], channels: Sequence[Channel]) -> Run:
    """Return a run with a column for each of some channels; what it did not record is NaN."""
    names, wanted = [channel.name for channel in own], [channel.name for channel in channels]
    if names == wanted:
        return run
    places = [names.index(name) if name in names else -1 for name in wanted]

    def placed(values: np.ndarray, missing: float) -> np.ndarray:
        none = np.full((*values.shape[:-1], 1), missing)
        return np.concatenate([values, none], axis=-1)[..., places]

    tumble = run.tumble
    if tumble is not None:
        tumble = replace(tumble, readings=placed(tumble.readings, 0.0))
    return replace(
        run, observed=placed(run.observed, np.nan), sample_sd=placed(run.sample_sd, np.nan), tumble=tumble
    )  # fmt: skip
