"""Unit and prior of every scalar parameter, and correlated priors of noise parameters.

A prior comes from the model file, the campaign's equipment or the effect's default.

The noise terms of a static record come with a covariance: what flicker noise does not explain is random walk.  As a
prior of other campaigns the terms keep it, by a Gaussian copula in z, where every prior is standard normal by itself.
Each parameter keeps its own prior; h as a whole is normal(0, C), with C the correlation matrix.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import equinox as eqx
import numpy as np

from imubayes.campaign.unit_grade import grade_of
from imubayes.foundations.arrays import Array, Float, Scalars, cho_solve, namespace, solve_lower
from imubayes.foundations.campaign_data import THERMOMETERS, Campaign, Channel, Run, Table, Thermometer
from imubayes.foundations.errors import Issue, closest_first, input_error, refuse
from imubayes.foundations.units import to_si
from imubayes.model.effect_registry import EffectClass
from imubayes.model.model_file import EffectSpec, PriorCorrelation
from imubayes.noise.components import Noise
from imubayes.parameters.declarations import Declared, Layout, Parameter, declared_parameters
from imubayes.parameters.priors import LogNormal, Normal, Prior, parse_prior

# Least eigenvalue of a correlation matrix: below, rounding of the printed digits may have made it singular.
_LEAST_EIGENVALUE = 1e-6


class HyperCorrelation(eqx.Module):
    """The prior normal(0, C) of h: `root` is the Cholesky factor of C, shape (H, H)."""

    root: Float[Array, "H H"]

    def square(self, h: Float[Array, "*batch H"]) -> Scalars:
        """Return hᵀC⁻¹h + log det C: twice the negative logarithm of the density, up to a constant."""
        independent = solve_lower(self.root, h.T)
        return (independent**2).sum(0) + 2 * namespace(self.root).log(self.root.diagonal()).sum()

    def pull(self, h: np.ndarray) -> np.ndarray:
        """Return C⁻¹h, half the gradient of `square`, of one column or of several, (H, …)."""
        return cho_solve(np.asarray(self.root), h)

    def coloured(self, independent: np.ndarray) -> np.ndarray:
        """Return draws (…, H) of the prior from independent standard normal ones."""
        return independent @ np.asarray(self.root).T


def hyper_correlation(listed: Sequence[PriorCorrelation], layout: Layout) -> HyperCorrelation | None:
    """Return the correlation of the priors of noise parameters in the order of a layout; None if there is none.

    Raises
    ------
    InputError
        for a name that is not in the layout or stands in two blocks, and for what is no correlation matrix.
    """
    if not listed:
        return None
    whole, taken, issues = np.eye(len(layout)), set[str](), []
    for block in listed:
        found = _faults(block, layout, taken)
        issues += found
        taken |= set(block.parameters)
        if not found:
            known = [place for place, name in enumerate(block.parameters) if name in layout.names]
            places = [layout.index(block.parameters[place]) for place in known]
            whole[np.ix_(places, places)] = np.array(block.matrix)[np.ix_(known, known)]
    refuse(issues)
    return HyperCorrelation(np.linalg.cholesky(whole))


def _faults(block: PriorCorrelation, layout: Layout, taken: set[str]) -> list[Issue]:
    faults = []
    for place, name in enumerate(block.parameters):
        if name not in layout.names and not block.optional:
            near = closest_first(name, layout.names)
            faults.append(
                Issue(
                    f"the model has no noise parameter '{name}'", block.where, near, "correct the name, or take it out"
                )
            )
        elif name in taken or name in block.parameters[:place]:
            allowed = "every parameter once, in one block"
            faults.append(Issue(f"'{name}' is listed twice", block.where, allowed, "join the blocks"))
    count = len(block.parameters)
    if any(len(row) != count for row in block.matrix) or len(block.matrix) != count:
        allowed = f"{count} rows of {count} numbers"
        return [*faults, Issue("the matrix does not suit its parameters", block.where, allowed, "correct the matrix")]
    matrix = np.array(block.matrix, dtype=float)
    plain = np.allclose(matrix, matrix.T) and np.allclose(np.diag(matrix), 1.0)
    if not plain or np.linalg.eigvalsh(matrix)[0] < _LEAST_EIGENVALUE:
        allowed = "a symmetric, positive definite matrix with ones on the diagonal"
        faults.append(Issue("the matrix is not a correlation matrix", block.where, allowed, "correct the matrix"))
    return faults


# If neither the campaign nor the spread of raw samples gives the noise of a channel: a thousandth of what was
# recorded, known to a factor of e³ = 20 either way.
_UNKNOWN_NOISE_SHARE, _UNKNOWN_NOISE_LOG_SD = 1e-3, 3.0

_OF_TABLES: dict[str, Callable[[Table], float | None]] = {
    "axis_x": lambda table: table.tilt_uncertainty[0],
    "axis_y": lambda table: table.tilt_uncertainty[1],
    "rate": lambda table: table.rate_uncertainty,
    "zero": lambda table: table.zero_uncertainty,
    "squareness": lambda table: table.squareness_uncertainty,
    "intersection": lambda table: table.intersection_uncertainty,
    "arm": lambda table: table.arm_uncertainty,
}
"""Equipment fact of a table → the uncertainty that the campaign states of it."""
_OF_RUNS: dict[str, Callable[[Run], float | None]] = {
    "temperature": lambda run: run.temperature_uncertainty,
    "converter_temperature": lambda run: run.converter_temperature_uncertainty,
}
"""Equipment fact of a run → the uncertainty that the campaign states of it; exact if it states none."""
_OF_THERMOMETERS: dict[str, tuple[str, Callable[[Thermometer], float | None]]] = {
    f"{key} {error}": (key, uncertainty)
    for key in THERMOMETERS
    for error, uncertainty in (
        ("offset", lambda thermometer: thermometer.offset_uncertainty),
        ("gain", lambda thermometer: thermometer.gain_uncertainty),
    )
}
"""Equipment fact of a thermometer → the key by which runs name it, and the uncertainty that the campaign states of it;
exact if it states none.
"""


def hyper_fields(effect_class: EffectClass) -> set[str]:
    """Return the fields that are hyperparameters: all of a noise member, the learnt prior widths of an effect."""
    declared = declared_parameters(effect_class)
    if issubclass(effect_class, Noise):
        return set(declared)
    return {declaration.spread for declaration in declared.values() if declaration.spread}


def default_prior(declared: Declared, kind: str, campaign: Campaign) -> str:
    """Return the default prior of a parameter on channels of a kind; empty for effects on no channel."""
    return declared.prior_of(grade_of(campaign, kind), kind) if kind else declared.prior


def parameter_of(
    spec: EffectSpec, effect_class: EffectClass, field: str, label: dict[str, str], campaign: Campaign
) -> Parameter:
    """Return one scalar parameter with its prior.

    Parameters
    ----------
    field : the declared field.
    label : what the value belongs to, axis → name; empty for one value for all.

    Raises
    ------
    InputError
        if the prior of the model file does not parse or does not suit the parameter.
    """
    declared = declared_parameters(effect_class)[field]
    gravity, where = campaign.site.gravity, f"{spec.where}, prior of {field}"
    channel = _representative_channel(effect_class, label, campaign)
    units = _channel_units(channel, campaign)
    if field in spec.prior:
        prior = parse_prior(spec.prior[field], declared.unit, gravity, where, units.si)
        _check_family(prior, field, declared, where, field in hyper_fields(effect_class))
    else:
        usual = default_prior(declared, "" if channel is None else channel.kind, campaign)
        prior = parse_prior(usual, declared.unit, gravity, where, units.si)
        prior = _from_equipment(declared.equipment, label, campaign, prior)
        if not units.noise_known and isinstance(prior, LogNormal) and "noise" in declared.prior:
            prior = LogNormal(prior.median, _UNKNOWN_NOISE_LOG_SD)
    as_scale = units.si | _output_as_scale(units.si.get("scale", 1.0))
    factor, of_scale = (to_si(declared.unit, gravity, where, own) for own in (units.si, as_scale))
    names = tuple(label.values()) or ("all",)
    output = _output_unit(effect_class, label, campaign)
    typical = declared.typical if channel is None else declared.typical_of(channel.kind)
    low, high = (size * of_scale / factor for size in typical)
    return Parameter(
        effect_class.name, field, names, declared.unit, factor, prior, effect_class.nuisance, output, (low, high)
    )


def unit_factors(effect_class: EffectClass, campaign: Campaign, channel: str = "") -> dict[str, float]:
    """Return the SI value of each parameter's unit, for a channel or the first that the class can act on."""
    units = _channel_units(_representative_channel(effect_class, {"channel": channel}, campaign), campaign)
    return {
        field: to_si(declared.unit, campaign.site.gravity, effect_class.name, units.si)
        for field, declared in declared_parameters(effect_class).items()
    }


def largest_typical(effect_class: EffectClass, campaign: Campaign, channel: str = "") -> dict[str, float]:
    """Return the largest typical size of each parameter, SI, for a channel or the first that the class can act on."""
    gravity, known = campaign.site.gravity, _representative_channel(effect_class, {"channel": channel}, campaign)
    scale = 1.0 if known is None else _nominal_scale(known, gravity)
    kind = "" if known is None else known.kind
    return {
        field: declared.typical_of(kind)[1] * to_si(declared.unit, gravity, effect_class.name, _output_as_scale(scale))
        for field, declared in declared_parameters(effect_class).items()
    }


def _output_as_scale(scale: float) -> dict[str, float]:
    """Return the values of the units of typical sizes, which are in the nominal scale if they are of the output."""
    return {"output": scale, "scale": scale}


def _check_family(prior: Prior, field: str, declared: Declared, where: str, hyper: bool) -> None:
    if declared.spread and not isinstance(prior, Normal):
        raise input_error(
            f"the prior width of '{field}' is estimated from the data, so its prior has to be normal",
            where,
            f"normal(0, 1 {declared.unit})",
            "write a normal prior, or leave it out",
        )
    if hyper and isinstance(prior, Normal):
        raise input_error(
            f"'{field}' is a standard deviation and may not be negative",
            where,
            "lognormal, halfnormal, uniform, loguniform or halfcauchy",
            f"write a prior of positive values, such as lognormal(1 {declared.unit}, 0.5)",
        )


def _representative_channel(effect_class: EffectClass, label: dict[str, str], campaign: Campaign) -> Channel | None:
    """Return the channel whose noise and scale serve as units: the labelled one, else the first of the right kind."""
    labelled = [channel for channel in campaign.channels if channel.name == label.get("channel")]
    suitable = [channel for channel in campaign.channels if channel.kind in effect_class.kinds]
    return next(iter(labelled + suitable), None)


def _output_unit(effect_class: EffectClass, label: dict[str, str], campaign: Campaign) -> str:
    """Return the output unit of the labelled channel, or of all of the right kind; empty if they have several."""
    own = {channel.output_unit for channel in campaign.channels if channel.name == label.get("channel")}
    units = own or {channel.output_unit for channel in campaign.channels if channel.kind in effect_class.kinds}
    return units.pop() if len(units) == 1 else ""


@dataclass(frozen=True)
class _ChannelUnits:
    """SI values of the channel-dependent units `noise` and `scale`, and whether the noise is stated."""

    si: dict[str, float]
    noise_known: bool = True


def _channel_units(channel: Channel | None, campaign: Campaign) -> _ChannelUnits:
    if channel is None:
        return _ChannelUnits({})
    scale = _nominal_scale(channel, campaign.site.gravity)
    if channel.noise is not None:
        return _ChannelUnits({"noise": channel.noise, "scale": scale})
    column = [known.name for known in campaign.channels].index(channel.name)
    outputs = (run.observed[:, column] for run in campaign.runs)
    spread = max((np.nanstd(values) for values in outputs if np.isfinite(values).any()), default=0.0)
    spread = spread if np.isfinite(spread) and spread > 0 else scale
    return _ChannelUnits({"noise": _UNKNOWN_NOISE_SHARE * float(spread), "scale": scale}, noise_known=False)


def _nominal_scale(channel: Channel, gravity: float) -> float:
    """Return the nominal output of a channel for 1 deg/s or 1 g."""
    return abs(channel.scale_si) * to_si("deg/s" if channel.kind == "gyro" else "g", gravity)


def exact_by_equipment(
    spec: EffectSpec, effect_class: EffectClass, field: str, label: dict[str, str], campaign: Campaign
) -> bool:
    """Return whether the campaign states that a parameter is zero: an uncertainty of 0, and no prior in the model."""
    stated = stated_uncertainty(declared_parameters(effect_class)[field].equipment, label, campaign)
    return stated == 0 and field not in spec.prior


def _from_equipment(fact: str, label: dict[str, str], campaign: Campaign, default: Prior) -> Prior:
    """Return the prior that the campaign's own statement about its equipment implies, else the default."""
    stated = stated_uncertainty(fact, label, campaign)
    return default if stated is None else Normal(0.0, stated)


def stated_uncertainty(fact: str, label: dict[str, str], campaign: Campaign) -> float | None:
    """Return the uncertainty that the campaign states of its equipment, SI; None if it states none."""
    stated = None
    if fact == "gravity":
        stated = campaign.site.gravity_uncertainty
    elif fact == "seat" and "mounting" in label:
        stated = campaign.mountings[label["mounting"]].uncertainty
    elif fact in _OF_TABLES and "table" in label:
        stated = _OF_TABLES[fact](campaign.tables[label["table"]])
    elif fact in _OF_RUNS and "run" in label:
        stated = next(_OF_RUNS[fact](run) or 0.0 for run in campaign.runs if run.name == label["run"])
    elif fact in _OF_THERMOMETERS and (key := _OF_THERMOMETERS[fact][0]) in label:
        stated = _OF_THERMOMETERS[fact][1](campaign.thermometers[label[key]]) or 0.0
    return stated
