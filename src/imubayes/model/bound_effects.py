"""Effects of a model bound to a campaign: channels, runs, labels and priors; and which effects it could show.

The fault of an effect that cannot be bound is reported.  For an effect that the campaign cannot show, what is
missing for it is named.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from imubayes.compiled.jax_settings import prepare_jax
from imubayes.effects.base import AmbientEffect, MotionEffect
from imubayes.foundations.campaign_data import Campaign, Run
from imubayes.foundations.covariates import COVARIATES, ambient_names, remedy
from imubayes.foundations.errors import InputError, Issue, closest_first
from imubayes.model.effect_registry import EffectClass, Registry, acts_on_channels
from imubayes.model.grouping import Grouping
from imubayes.model.model_file import EffectSpec
from imubayes.model.nodes_and_entries import join_entries, join_nodes
from imubayes.model.nominal_response import missing_stimulus, noisy_runs, probes, responding_runs
from imubayes.model.parameter_priors import exact_by_equipment, hyper_fields, parameter_of
from imubayes.noise.components import Noise, SharedNoise, SlowNoise
from imubayes.parameters.declarations import Declared, Parameter, declared_options, declared_parameters
from imubayes.procedures.ambient import unknown_covariates

# An effect that needs one of these, or a covariate that is absent there, must be switched off in the runs without it.
_GATES = (
    "injection", "reference", "driven", "directions", "unknown_heading", "unknown_level", "hand", "carried", "posed",
)  # fmt: skip
_SHARING = {"channel": ("channel",), "all": (), "run": ("channel", "run"), "mounting": ("channel", "mounting")}
_MOTION_SHARING = {"all": (), "run": ("run",), "mounting": ("mounting",)}
_WITH_UNCERTAINTY = ("temperature", "converter_temperature")


class NotObservableError(InputError):
    """No run of the campaign shows the effect.

    Attributes
    ----------
    missing : covariates that no run has recorded, or the stimulus that would bring the effect out; may be empty.
    """

    def __init__(self, issue: Issue, missing: tuple[str, ...] = ()):
        super().__init__(issue)
        self.missing = missing


class UnknownCovariateError(NotObservableError):
    """Some runs that the effect changes lack a covariate that it needs.

    Attributes
    ----------
    effect, where : its name, and its place in the model.
    runs : names of those runs.
    """

    def __init__(self, effect: str, runs: tuple[str, ...], missing: tuple[str, ...], where: str):
        super().__init__(unknown_covariates_issue((effect,), runs, missing, where), missing)
        self.effect, self.where, self.runs = effect, where, runs


def unknown_covariates_issue(effects: Sequence[str], runs: Sequence[str], missing: Sequence[str], where: str) -> Issue:
    """Return the issue of effects that depend on what some runs have not recorded."""
    named, quoted = " and ".join(COVARIATES[name].column for name in missing), [f"'{run}'" for run in runs]
    listed = ", ".join(f"'{effect}'" for effect in effects)
    uncertain = " and ".join(f"{name}_uncertainty_degC" for name in missing if name in _WITH_UNCERTAINTY)
    return Issue(
        f"{'run' if len(runs) == 1 else 'runs'} {', '.join(quoted)} {'has' if len(runs) == 1 else 'have'} no {named}, "
        f"on which {listed} {'depends' if len(effects) == 1 else 'depend'}",
        where,
        "in every run, " + "; ".join(remedy(name) for name in missing),
        f"state {named} of {'the run' if len(runs) == 1 else 'these runs'}"
        f"{f', with {uncertain} unless it is known well' if uncertain else ''}; or leave {listed} out of the model, or "
        f"{', '.join(quoted)} out of the campaign",
    )


class ExactEquipmentError(NotObservableError):
    """The campaign states that the equipment has no such error."""


class NoChannelError(NotObservableError):
    """The unit has no channel that the effect acts on."""


class SingleRunError(NotObservableError):
    """The effect differs from run to run, and each of its channels has one run.

    Attributes
    ----------
    channels : names of the channels.
    """

    def __init__(self, issue: Issue, channels: tuple[str, ...]):
        super().__init__(issue, ("second run",))
        self.channels = channels


@dataclass(frozen=True)
class BoundEffect:
    """An effect or noise member bound to a campaign.

    Attributes
    ----------
    spec, effect_class : the entry of the model file, and the class.
    declared : field → declaration.
    sharing : axes by which its values are labelled.
    channels, kinds : names and kinds of the channels it acts on; no names for effects on the motion.
    runs : indices of the runs that recorded the covariates it needs.
    shown_in : indices of those among them whose nominal signals it changes.
    gated : indices of the runs in which it is switched off because they do not supply what it needs.
    parameters, hyperparameters : its scalars, in order.
    left_out : names of the channels on which it cannot be known, each having one run.
    """

    spec: EffectSpec
    effect_class: EffectClass
    declared: dict[str, Declared]
    sharing: tuple[str, ...]
    channels: tuple[str, ...]
    kinds: tuple[str, ...]
    runs: set[int]
    shown_in: set[int]
    gated: set[int]
    parameters: tuple[Parameter, ...]
    hyperparameters: tuple[Parameter, ...]
    left_out: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Name of the effect or noise member."""
        return self.effect_class.name

    def per_of(self, field: str) -> tuple[str, ...]:
        """Return the axes by which the values of a field are labelled."""
        own = self.declared[field].per
        return self.sharing if own is None else own


def bind_effect(spec: EffectSpec, grouping: Grouping, registry: Registry, *, single_runs: bool = False) -> BoundEffect:
    """Return an effect of a model bound to a campaign.

    Parameters
    ----------
    single_runs : keep what differs from run to run on channels of one run as well, for data that are to be simulated.

    Raises
    ------
    InputError
        with everything that does not fit; `NotObservableError` if no run can show the effect.
    """
    effect_class = registry.find(spec.name, spec.where)
    settings = _Settings(spec, effect_class, grouping.campaign)
    sharing, channels = settings.sharing(), settings.channels()
    settings.check_names()
    settings.raise_issues()
    channels, left_out = _without_single_runs(spec, effect_class, sharing, channels, grouping, single_runs)
    runs, gated = _recorded_runs(spec, effect_class, grouping.nodes.supplies)
    declared = declared_parameters(effect_class)
    labelled = channels or tuple(channel.name for channel in grouping.campaign.channels)
    if not grouping.labels(sharing, labelled, runs):
        raise _without_label(spec, sharing, grouping)
    shown_in = _showing_runs(spec, effect_class, channels, runs, grouping)
    _refuse_unknown(spec, effect_class, channels, grouping)
    made: dict[str, list[Parameter]] = {}
    for name, declaration in declared.items():
        per = sharing if declaration.per is None else declaration.per
        made[name] = settings.parameters(name, per, grouping.labels(per, labelled, sorted(shown_in)))
    settings.raise_issues()
    _refuse_exact(spec, effect_class, made)
    hyper = hyper_fields(effect_class)
    return BoundEffect(
        spec=spec,
        effect_class=effect_class,
        declared=declared,
        sharing=sharing,
        channels=channels,
        kinds=tuple(dict.fromkeys(c.kind for c in grouping.campaign.channels if c.name in channels)),
        runs=runs,
        shown_in=shown_in,
        gated=gated,
        parameters=tuple(p for name, parameters in made.items() if name not in hyper for p in parameters),
        hyperparameters=tuple(p for name, parameters in made.items() if name in hyper for p in parameters),
        left_out=left_out,
    )


def _without_single_runs(
    spec: EffectSpec,
    effect_class: EffectClass,
    sharing: tuple[str, ...],
    channels: tuple[str, ...],
    grouping: Grouping,
    single_runs: bool,
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the channels that can show an effect, and those of one run, which for what differs between runs cannot.

    The default prior, which then decides alone how wide the bias of the run is, says nothing of this unit.  A prior
    that the model states does: the effect stays.

    Raises
    ------
    SingleRunError
        if no other channel is left.
    """
    learnt = "run" in sharing and hyper_fields(effect_class)
    if single_runs or spec.prior or not (issubclass(effect_class, SharedNoise) or learnt):
        return channels, ()
    found = tuple(name for name in channels if grouping.run_count(name) <= 1)
    if found and found == channels:
        raise SingleRunError(
            Issue(
                f"'{spec.name}' differs from run to run, and {' and '.join(found)} had only one run",
                spec.where,
                "channels of two runs and more, or a prior from earlier units",
                "leave the effect out, add a run, or state its prior",
            ),
            found,
        )
    return tuple(name for name in channels if name not in found), found


def _refuse_exact(spec: EffectSpec, effect_class: EffectClass, made: Mapping[str, list[Parameter]]) -> None:
    if made and not any(made.values()):
        of_runs = issubclass(effect_class, AmbientEffect)
        owners = effect_class.needs if effect_class.per == ("run",) else effect_class.per
        raise ExactEquipmentError(
            Issue(
                f"the campaign states that '{spec.name}' is zero: an uncertainty of 0 means exact",
                spec.where,
                "an uncertainty above 0 in campaign.toml, or a prior in the model",
                "leave the effect out, or state the uncertainty",
            ),
            tuple(f"{owner} uncertainty" for owner in owners) if of_runs else (),
        )


def _recorded_runs(
    spec: EffectSpec, effect_class: EffectClass, supplies: tuple[frozenset[str], ...]
) -> tuple[set[int], set[int]]:
    """Return the runs that recorded what the effect needs, and those in which it has to be switched off."""
    needs = effect_class.needs
    runs = {index for index, supplied in enumerate(supplies) if set(needs) <= supplied}
    if not runs:
        missing = tuple(need for need in needs if not any(need in supplied for supplied in supplies)) or needs
        raise _not_observable(spec, f"it needs {' and '.join(map(remedy, missing))}", supplies, missing)
    gating = {need for need in needs if need in ambient_names() or need in _GATES}
    return runs, {index for index, supplied in enumerate(supplies) if not gating <= supplied}


def _refuse_unknown(spec: EffectSpec, effect_class: EffectClass, channels: tuple[str, ...], grouping: Grouping) -> None:
    """Raise an error if the effect changes what was measured in runs that lack a covariate it needs."""
    runs, supplies = grouping.campaign.runs, grouping.nodes.supplies
    unknown = [unknown_covariates(run, effect_class.needs, each) for run, each in zip(runs, supplies, strict=True)]
    if issubclass(effect_class, Noise) or not any(unknown):
        return
    tried = probes(effect_class, dict(spec.options), channels, grouping.campaign)
    blocks = [at.elsewhere(*set().union(*unknown)) for at in grouping.samples]
    changed = set().union(*(responding_runs(probe, blocks) for probe in tried))
    places = [place for place, channel in enumerate(grouping.campaign.channels) if channel.name in channels]
    lacking = {runs[k].name: unknown[k] for k in sorted(changed) if unknown[k] and _measures(runs[k], places)}
    if lacking:
        missing = tuple(need for need in effect_class.needs if need in set().union(*lacking.values()))
        raise UnknownCovariateError(spec.name, tuple(lacking), missing, spec.where)


def _measures(run: Run, places: list[int]) -> bool:
    """Whether a run has outputs of some channels; of any if none are named."""
    return not places or bool(np.isfinite(run.observed[:, places]).any())


def _showing_runs(
    spec: EffectSpec, effect_class: EffectClass, channels: tuple[str, ...], runs: set[int], grouping: Grouping
) -> set[int]:
    """Return those of the runs whose nominal signals the effect changes.

    Raises
    ------
    NotObservableError
        if there is none.
    """
    if effect_class.nuisance:
        return runs  # unknowns of the procedures themselves
    if issubclass(effect_class, Noise):
        found = runs & noisy_runs(effect_class, grouping.campaign, grouping.nodes, grouping.entries)
        missing = ("time",) if issubclass(effect_class, SlowNoise) else ("turning",)
    else:
        tried = probes(effect_class, dict(spec.options), channels, grouping.campaign)
        found = runs & set().union(*map(grouping.responding, tried))
        missing = () if found else missing_stimulus(tried[0], grouping.samples)
    if not found:
        why = "its response is zero in all of them" + (f"; it needs {remedy(missing[0])}" if missing else "")
        raise _not_observable(spec, why, grouping.nodes.supplies, missing)
    return found


def _without_label(spec: EffectSpec, sharing: tuple[str, ...], grouping: Grouping) -> NotObservableError:
    """Return the error of an effect whose values belong to what no run has, such as a table."""
    missing = tuple(axis for axis in sharing if axis != "channel")
    return _not_observable(spec, f"no run has a {' and a '.join(missing)}", grouping.nodes.supplies, missing)


def _not_observable(
    spec: EffectSpec, why: str, supplies: tuple[frozenset[str], ...], missing: tuple[str, ...]
) -> NotObservableError:
    return NotObservableError(
        Issue(
            f"no run can show '{spec.name}': {why}",
            spec.where,
            "effects that need no other inputs than " + ", ".join(sorted(set().union(*supplies))),
            "leave the effect out or mark it 'optional = true', or add a run that shows it",
        ),
        missing,
    )


@dataclass
class _Settings:
    """The settings of one entry of a model file, checked against class and campaign; collects what is wrong."""

    spec: EffectSpec
    effect_class: EffectClass
    campaign: Campaign
    issues: list[Issue] = field(default_factory=list)

    def raise_issues(self) -> None:
        if self.issues:
            raise InputError(self.issues)

    def report(self, what: str, allowed: str, remedy: str) -> None:
        self.issues.append(Issue(what, self.spec.where, allowed, remedy))

    def sharing(self) -> tuple[str, ...]:
        """Return the axes by which the values are labelled."""
        per = self.spec.per
        # What states the uncertainty of a temperature has its error: the run, or its thermometer.
        of_ambient = {axis: (axis,) for axis in self.effect_class.per}
        of_unit = of_ambient if issubclass(self.effect_class, AmbientEffect) else _MOTION_SHARING
        allowed = of_unit if issubclass(self.effect_class, MotionEffect) else _SHARING
        if per is not None and per not in allowed:
            what = f"'{self.spec.name}' cannot have one value per {per}"
            self.report(what, closest_first(per, allowed), "correct 'per', or leave it out")
        return self.effect_class.per if per is None else allowed.get(per, self.effect_class.per)

    def channels(self) -> tuple[str, ...]:
        """Return the names of the channels it acts on; none for what acts on the whole unit."""
        spec, chosen = self.spec, self.spec.channels
        if not acts_on_channels(self.effect_class):
            if chosen is not None:
                what = f"'{spec.name}' acts on the whole unit, not on channels"
                self.report(what, "no 'channels' for this effect", "take 'channels' out")
            return ()
        kinds = self.effect_class.kinds
        suitable = [channel.name for channel in self.campaign.channels if channel.kind in kinds]
        if chosen is None:
            self._require_channel(suitable)
            return tuple(suitable)
        known = {channel.name for channel in self.campaign.channels}
        for name in (name for name in chosen if name not in suitable):
            fault = "is not a " + " or ".join(kinds) if name in known else "does not exist"
            self.report(f"channel '{name}' {fault}", closest_first(name, suitable), "correct 'channels'")
        if not chosen:
            self.report("'channels' is empty", ", ".join(suitable), "name at least one channel")
        return tuple(name for name in suitable if name in chosen)

    def _require_channel(self, suitable: list[str]) -> None:
        if not suitable:
            kinds = " and ".join(self.effect_class.kinds)
            raise NoChannelError(
                Issue(
                    f"'{self.spec.name}' acts on {kinds} channels and the unit has none",
                    self.spec.where,
                    "effects for " + ", ".join(sorted({channel.kind for channel in self.campaign.channels})),
                    "leave the effect out, or mark it 'optional = true'",
                )
            )

    def check_names(self) -> None:
        """Report priors and options that the class does not have, and options that are not numbers."""
        options = declared_options(self.effect_class)
        self._check_known(self.spec.prior, declared_parameters(self.effect_class), "parameter")
        self._check_known(self.spec.options, options, "setting")
        for name, value in self.spec.options.items():
            number = isinstance(value, int | float) and not isinstance(value, bool) and np.isfinite(value)
            if name in options and not number:
                self.report(f"'{name}' of '{self.spec.name}' is not a number", "a number", "give a number")

    def _check_known(self, given: Mapping[str, object], known: Mapping[str, object], what: str) -> None:
        for name in (name for name in given if name not in known):
            self.report(
                f"'{self.spec.name}' has no {what} '{name}'",
                closest_first(name, known) or f"no {what}s",
                f"correct the name; `imubayes effects {self.spec.name}` lists them",
            )

    def parameters(self, name: str, per: tuple[str, ...], labels: list[tuple[str, ...]]) -> list[Parameter]:
        """Return the scalars of one field, one per label."""
        made = []
        for label in labels:
            axes = dict(zip(per, label, strict=True))
            if exact_by_equipment(self.spec, self.effect_class, name, axes, self.campaign):
                continue
            try:
                made.append(parameter_of(self.spec, self.effect_class, name, axes, self.campaign))
            except InputError as error:
                self.issues.extend(issue for issue in error.issues if issue not in self.issues)
        return made


@dataclass(frozen=True)
class Observability:
    """What a campaign has for one effect or noise member.

    Attributes
    ----------
    effect_class : the class.
    runs : names of the runs that respond to it.
    channels : names of the channels it can act on; none for effects on the motion.
    missing : covariates that no run recorded, or that a run which it changes lacks, or the stimulus that no run has;
        empty if the campaign could show it.

    Examples
    --------
    >>> import imubayes
    >>> found = imubayes.observability(imubayes.load_campaign("data/accel-channel"))
    >>> next(each.channels for each in found if each.effect_class.name == "accel_bias")
    ('ax',)
    """

    effect_class: EffectClass
    runs: tuple[str, ...]
    channels: tuple[str, ...]
    missing: tuple[str, ...]


def observability(campaign: Campaign, registry: Registry | None = None) -> tuple[Observability, ...]:
    """Return for every effect and noise member what the campaign has for it; nothing is fitted.

    Parameters
    ----------
    campaign : whose runs may show it.
    registry : the effects; those of the package if None.

    Examples
    --------
    >>> import imubayes
    >>> found = imubayes.observability(imubayes.load_campaign("data/accel-channel"))
    >>> next(each.missing for each in found if each.effect_class.name == "gyro_bias")
    ('gyro',)
    """
    prepare_jax()
    registry = registry or Registry()
    grouping = Grouping(campaign, join_nodes(campaign), join_entries(campaign))
    return tuple(_of_class(known, grouping, registry) for known in registry.effects.values())


def _of_class(effect_class: EffectClass, grouping: Grouping, registry: Registry) -> Observability:
    if _of_tumbles(effect_class) and not any(run.tumble for run in grouping.campaign.runs):
        return Observability(effect_class, (), (), ("free tumble",))
    try:
        bound = bind_effect(EffectSpec(effect_class.name), grouping, registry)
    except NoChannelError:
        return Observability(effect_class, (), (), tuple(effect_class.kinds))
    except NotObservableError as error:
        return Observability(effect_class, (), (), error.missing or ("response",))
    return Observability(effect_class, _shown_in(bound, grouping.campaign), bound.channels, ())


def _of_tumbles(effect_class: EffectClass) -> bool:
    """Whether an effect is an unknown of free tumbles themselves."""
    return effect_class.nuisance and set(effect_class.needs) <= {"posed"}


def _shown_in(bound: BoundEffect, campaign: Campaign) -> tuple[str, ...]:
    """Return the names of the runs that respond; of an error in what they state, of those that state one."""
    names = [campaign.runs[run].name for run in sorted(bound.shown_in)]
    if issubclass(bound.effect_class, AmbientEffect):
        grouping = {run.name: run for run in campaign.runs}
        stated = {parameter.label for parameter in bound.parameters}
        names = [name for name in names if tuple(_owner(grouping[name], axis) for axis in bound.sharing) in stated]
    return tuple(names)


def _owner(run: Run, axis: str) -> str | None:
    """Return what an error of a temperature of a run belongs to: the run, or one of its thermometers."""
    return run.name if axis == "run" else getattr(run, axis)
