"""One effect of a model, fitted to a campaign: its channels, runs, labels and priors, or what is wrong with it."""

from dataclasses import dataclass

import numpy as np

from imubayes.covariates import ambient_names
from imubayes.effects.base import Effect, MotionEffect
from imubayes.errors import InputError, Issue, closest_first
from imubayes.model.effect_registry import EffectClass, Registry
from imubayes.model.grouping import Grouping
from imubayes.model.model_spec import EffectSpec
from imubayes.noise.base import Noise
from imubayes.parameters.parameter import Declared, declared_options, declared_parameters
from imubayes.parameters.priors import LogNormal, Normal, Prior, parse_prior
from imubayes.parameters.vector import Parameter
from imubayes.run import Campaign, Channel
from imubayes.units import to_si

# Where neither the campaign nor the spread of raw samples says how noisy a channel is: a thousandth of what was
# recorded, known to a factor of e³ = 20 either way.
_UNKNOWN_NOISE_SHARE, _UNKNOWN_NOISE_LOG_SD = 1e-3, 3.0
# What some runs have and others lack altogether, so that an effect of it has to be kept from those.
_GATES = ("injection", "reference", "driven")
_SHARING = {"channel": ("channel",), "all": (), "run": ("channel", "run"), "mounting": ("channel", "mounting")}
_MOTION_SHARING = {"all": (), "run": ("run",), "mounting": ("mounting",)}


class NotObservableError(InputError):
    """No run of the campaign supplies what the effect needs."""


class NoChannelError(NotObservableError):
    """The unit has no channel that the effect acts on."""


@dataclass(frozen=True)
class BoundEffect:
    """An effect or noise member as it acts in a campaign.

    Attributes
    ----------
    spec, effect_class : what the model file says, and the class.
    declared : field → declaration.
    sharing : what its values belong to.
    channels, kinds : names and kinds of the channels it acts on; no names for effects on the motion.
    runs : indices of the runs in which it acts.
    gated : runs from which it has to be kept because they do not say what it needs.
    parameters, hyperparameters : its scalars, in order.
    """

    spec: EffectSpec
    effect_class: EffectClass
    declared: dict[str, Declared]
    sharing: tuple[str, ...]
    channels: tuple[str, ...]
    kinds: tuple[str, ...]
    runs: set[int]
    gated: set[int]
    parameters: tuple[Parameter, ...]
    hyperparameters: tuple[Parameter, ...]

    @property
    def name(self) -> str:
        """Name of the effect or noise member."""
        return self.effect_class.name

    @property
    def fields(self) -> dict[str, Declared]:
        """Field → declaration, all of them."""
        return self.declared

    @property
    def hyper_fields(self) -> set[str]:
        """Fields that are hyperparameters."""
        return hyper_fields(self.effect_class)

    def per_of(self, field: str) -> tuple[str, ...]:
        """Return what the values of a field belong to."""
        own = self.declared[field].per
        return self.sharing if own is None else own


def hyper_fields(member: EffectClass) -> set[str]:
    """Return the fields of a class that are hyperparameters: all of a noise member, the spreads of an effect."""
    declared = declared_parameters(member)
    if issubclass(member, Noise):
        return set(declared)
    return {one.spread for one in declared.values() if one.spread}


def bind_effect(spec: EffectSpec, belonging: Grouping, registry: Registry) -> BoundEffect:
    """Return an effect of a model as it acts in a campaign; raises InputError with what does not fit."""
    campaign = belonging.campaign
    effect_class = registry.find(spec.name, spec.where)
    declared = declared_parameters(effect_class)
    issues: list[Issue] = []
    sharing = _sharing(spec, effect_class, issues)
    channels = _channels(spec, effect_class, campaign, issues)
    options = declared_options(effect_class)
    _refuse_unknown(spec, declared, options, issues)
    if issues:
        raise InputError(issues)
    runs = {i for i, supplied in enumerate(belonging.nodes.supplies) if set(effect_class.needs) <= supplied}
    if not runs:
        missing = [need for need in effect_class.needs if not any(need in s for s in belonging.nodes.supplies)]
        raise NotObservableError(
            Issue(
                f"no run can show '{spec.name}': it needs {' and '.join(missing or effect_class.needs)}",
                spec.where,
                "effects that need what the runs supply: " + ", ".join(sorted(set().union(*belonging.nodes.supplies))),
                "leave the effect out or mark it 'optional = true', or add a run that supplies it",
            )
        )
    kinds = tuple(dict.fromkeys(channel.kind for channel in campaign.channels if channel.name in channels))
    gating = [need for need in effect_class.needs if need in ambient_names() or need in _GATES]
    gated = {i for i, s in enumerate(belonging.nodes.supplies) if not set(gating) <= s}
    made: dict[bool, list[Parameter]] = {False: [], True: []}
    for field, one in declared.items():
        per = sharing if one.per is None else one.per
        hyper = field in hyper_fields(effect_class)
        for label in belonging.labels(per, channels or tuple(c.name for c in campaign.channels), sorted(runs)):
            try:
                made[hyper].append(_parameter(spec, effect_class, field, one, per, label, campaign))
            except InputError as error:
                issues.extend(p for p in error.issues if p not in issues)
    if issues:
        raise InputError(issues)
    return BoundEffect(
        spec, effect_class, declared, sharing, channels, kinds, runs, gated, tuple(made[False]), tuple(made[True])
    )


def _sharing(spec: EffectSpec, effect_class: EffectClass, issues: list[Issue]) -> tuple[str, ...]:
    if spec.per is None:
        return effect_class.per
    allowed = _MOTION_SHARING if issubclass(effect_class, MotionEffect) else _SHARING
    if spec.per not in allowed:
        issues.append(
            Issue(
                f"'{spec.name}' cannot have one value per {spec.per}",
                spec.where,
                closest_first(spec.per, allowed),
                "correct 'per', or leave it out",
            )
        )
        return effect_class.per
    return allowed[spec.per]


def _channels(spec: EffectSpec, effect_class: EffectClass, campaign: Campaign, issues: list[Issue]) -> tuple[str, ...]:
    if issubclass(effect_class, MotionEffect) or "closure" in effect_class.kinds:
        if spec.channels is not None:
            issues.append(
                Issue(
                    f"'{spec.name}' acts on the whole unit, not on channels",
                    spec.where,
                    "no 'channels' for this effect",
                    "take 'channels' out",
                )
            )
        return ()
    fitting = [channel.name for channel in campaign.channels if channel.kind in effect_class.kinds]
    if spec.channels is None:
        if not fitting:
            raise NoChannelError(
                Issue(
                    f"'{spec.name}' acts on {' and '.join(effect_class.kinds)} channels and the unit has none",
                    spec.where,
                    "effects for " + ", ".join(sorted({channel.kind for channel in campaign.channels})),
                    "leave the effect out, or mark it 'optional = true'",
                )
            )
        return tuple(fitting)
    for name in spec.channels:
        if name not in fitting:
            known = any(channel.name == name for channel in campaign.channels)
            fault = "is not a " + " or ".join(effect_class.kinds) if known else "does not exist"
            issues.append(
                Issue(f"channel '{name}' {fault}", spec.where, closest_first(name, fitting), "correct 'channels'")
            )
    if not spec.channels:
        issues.append(Issue("'channels' is empty", spec.where, ", ".join(fitting), "name at least one channel"))
    return tuple(name for name in fitting if name in spec.channels)


def _refuse_unknown(spec: EffectSpec, declared: dict, options: dict, issues: list[Issue]) -> None:
    for given, known, what in ((spec.prior, declared, "parameter"), (spec.options, options, "setting")):
        issues.extend(
            Issue(
                f"'{spec.name}' has no {what} '{name}'",
                spec.where,
                closest_first(name, known) or f"no {what}s",
                f"correct the name; `imubayes effects {spec.name}` lists them",
            )
            for name in given
            if name not in known
        )
    for name, value in spec.options.items():
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if name in options and not (number and np.isfinite(value)):
            issues.append(Issue(f"'{name}' of '{spec.name}' is not a number", spec.where, "a number", "give a number"))


def _parameter(
    spec: EffectSpec,
    effect_class: EffectClass,
    field: str,
    declared: Declared,
    per: tuple[str, ...],
    label: tuple[str, ...],
    campaign: Campaign,
) -> Parameter:
    gravity = campaign.site.gravity
    channel = next((c for c in campaign.channels if "channel" in per and c.name == label[per.index("channel")]), None)
    shared = channel or next((c for c in campaign.channels if c.kind in effect_class.kinds), None)
    own, known = _own_units(shared, campaign)
    where = f"{spec.where}, prior of {field}"
    if field in spec.prior:
        prior = parse_prior(spec.prior[field], declared.unit, gravity, where, own)
        if declared.spread and not isinstance(prior, Normal):
            raise InputError(
                Issue(
                    f"the spread of '{field}' is learnt, so its prior has to be normal",
                    where,
                    f"normal(0, 1 {declared.unit})",
                    "write a normal prior, or leave it out",
                )
            )
        if field in hyper_fields(effect_class) and isinstance(prior, Normal):
            raise InputError(
                Issue(
                    f"'{field}' is a standard deviation and may not be negative",
                    where,
                    "lognormal, halfnormal, uniform, loguniform or halfcauchy",
                    f"write a prior of positive values, such as lognormal(1 {declared.unit}, 0.5)",
                )
            )
    else:
        prior = parse_prior(declared.prior, declared.unit, gravity, where, own)
        prior = _from_equipment(declared.equipment, dict(zip(per, label, strict=True)), campaign, prior)
        if not known and isinstance(prior, LogNormal) and "noise" in declared.prior:
            prior = LogNormal(prior.median, _UNKNOWN_NOISE_LOG_SD)
    factor = to_si(declared.unit, gravity, where, own)
    return Parameter(effect_class.name, field, label or ("all",), declared.unit, factor, prior, effect_class.nuisance)


def _own_units(channel: Channel | None, campaign: Campaign) -> tuple[dict[str, float], bool]:
    """Return what the units `noise` and `scale` stand for, and whether the noise is known."""
    if channel is None:
        return {}, True
    per = "deg/s" if channel.kind == "gyro" else "g"
    scale = abs(channel.scale_si) * to_si(per, campaign.site.gravity)
    if channel.noise is not None:
        return {"noise": channel.noise, "scale": scale}, True
    place = [c.name for c in campaign.channels].index(channel.name)
    spread = max((np.nanstd(run.observed[:, place]) for run in campaign.runs if run.rows), default=0.0)
    spread = spread if np.isfinite(spread) and spread > 0 else scale
    return {"noise": _UNKNOWN_NOISE_SHARE * float(spread), "scale": scale}, False


def _from_equipment(fact: str, label: dict[str, str], campaign: Campaign, default: Prior) -> Prior:
    """Return the prior that the campaign's own statement about its equipment implies."""
    if fact == "seat" and "mounting" in label:
        stated = campaign.mountings[label["mounting"]].uncertainty
    elif fact == "axis" and "table" in label:
        stated = campaign.tables[label["table"]].axis_uncertainty
    elif fact == "rate" and "table" in label:
        stated = campaign.tables[label["table"]].rate_uncertainty
    else:
        stated = None
    return default if stated is None else Normal(0.0, stated)


def is_effect(effect_class: EffectClass) -> bool:
    """Tell an effect from a noise effect_class."""
    return issubclass(effect_class, Effect)
