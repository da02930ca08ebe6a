"""Errors of the instruments beside the unit: thermometers, clock, vibration sensor, counters and meters of outputs.

A model reads temperature, time and vibration as the campaign records them, and outputs as they were counted.  If the
campaign states no uncertainty of a thermometer, the model takes its reading as exact; of the other instruments it never
knows an error.  Such an error is no parameter of any effect.  The response to it is the change of the predicted outputs
with the record: true = recorded + δ for a thermometer, true = recorded · (1 + δ) for clock and vibration, and for
outputs predicted · δ.  A clock that is fast by δ makes rates of change of temperature smaller by δ.

A thermometer that runs name has one δ for all of them, and one gain about 25 °C.  Any other run has a δ of its own, and
a gain about its mean temperature, at which δ is meant.

The sizes are those that the campaign states under `[instruments]`; else those of instruments of which nothing is
stated: the priors of the errors of thermometers (a gain of 0.3 % is that of class B of IEC 60751), a quartz without an
oven, an accelerometer for vibration, a multimeter of six digits.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import jax
import numpy as np

from imubayes.compiled.in_numpy import in_numpy
from imubayes.effects.base import RecordEffect
from imubayes.effects.thermometer import TemperatureOffset, UncertainTemperature
from imubayes.foundations.arrays import Array
from imubayes.foundations.campaign_data import THERMOMETERS, Campaign
from imubayes.foundations.covariates import COVARIATES
from imubayes.foundations.quantity_names import name_of
from imubayes.foundations.signal_path_state import Ambient, Records
from imubayes.foundations.units import to_si
from imubayes.inference.fitted_model import Fit
from imubayes.model.problem import Problem, predict_from
from imubayes.parameters.declarations import declared_parameters
from imubayes.parameters.priors import parse_prior

CLOCK, VIBRATION_SENSOR, TIME_BASE, METER = "clock_error", "vibration_sensor_error", "output_time_base", "output_meter"
"""Causes that are no effects of the catalogue: clock, vibration sensor, and what outputs are counted or metered by."""
INSTRUMENTS = (
    "thermometer_error", "converter_thermometer_error", "thermometer_calibration", "converter_thermometer_calibration",
    CLOCK, VIBRATION_SENSOR, TIME_BASE, METER,
)  # fmt: skip
"""Causes that instruments have, as effects are named; of the thermometers they are effects."""
_PPM, _PERCENT = 1e-6, 1e-2
# Relative sizes if the campaign states none.
_SIZES = {CLOCK: 10 * _PPM, VIBRATION_SENSOR: 5 * _PERCENT, TIME_BASE: 10 * _PPM, METER: 50 * _PPM}
# Steps of the central differences: predictions are quadratic in a temperature at most, and nearly linear in the others.
_KELVIN, _SHARE = 0.1, 1e-3
_TIMES, _PER_TIME = ("time", "campaign_time", "power_on"), ("temperature_rate", "converter_temperature_rate")
_STATED = {"temperature": "temperature_uncertainty", "converter_temperature": "converter_temperature_uncertainty"}
_READ_BY = dict(zip(_STATED, THERMOMETERS, strict=True))


@dataclass(frozen=True)
class InstrumentError:
    """An error of an instrument that is no parameter of the model.

    Attributes
    ----------
    effect, name, unit : cause, parameter as a model would name it, and its unit.
    size : its standard uncertainty, as stated, or one that is plausible.
    column : shape (E,), change of the predicted entries per unit.
    stated : whether the campaign states the size.
    """

    effect: str
    name: str
    unit: str
    size: float
    column: np.ndarray
    stated: bool = False


def stated_instruments(campaign: Campaign) -> dict[str, float]:
    """Return the relative uncertainties above 0 that a campaign states of instruments, by cause."""
    return {cause: size for cause, size in _of_campaign(campaign).items() if size}


def _of_campaign(campaign: Campaign) -> dict[str, float | None]:
    own = campaign.instruments
    return {CLOCK: own.clock, VIBRATION_SENSOR: own.vibration, TIME_BASE: own.time_base, METER: own.meter}


def instrument_errors(fit: Fit, only: Sequence[str] = INSTRUMENTS) -> Iterator[InstrumentError]:
    """Yield the errors that change what a model predicts.

    Parameters
    ----------
    only : causes that are looked at.
    """
    for error in _all(fit, only):
        if error.effect in only and error.size > 0 and np.any(error.column):
            yield error


def _all(fit: Fit, only: Sequence[str]) -> Iterator[InstrumentError]:
    registry, at = fit.model.registry, _Response(fit)
    effects = [registry.effects[each.name] for each in fit.model.spec.effects]
    read = {need for effect in effects for need in effect.needs}
    yield from _of_thermometers(fit, [name for name in only if name in registry.effects], read, at)
    timed = any(issubclass(effect, RecordEffect) for effect in effects) or read & {*_TIMES, *_PER_TIME}
    if CLOCK in only and timed:
        scaled = dict.fromkeys(_TIMES, 1.0) | dict.fromkeys(_PER_TIME, -1.0)
        yield _relative(fit, CLOCK, f"{CLOCK}.rate[all]", "ppm", at.scaled(scaled, 1.0))
    if VIBRATION_SENSOR in only and "vibration" in read:
        column = at.scaled({"vibration": 1.0}, 0.0)
        yield _relative(fit, VIBRATION_SENSOR, f"{VIBRATION_SENSOR}.gain[all]", "%", column)
    if {TIME_BASE, METER}.intersection(only):
        yield from _of_outputs(fit, at)


def _of_thermometers(
    fit: Fit, only: Sequence[str], read: Collection[str], at: "_Response"
) -> Iterator[InstrumentError]:
    """Yield the errors of temperatures that effects of the model read, `read`, which are not in the model."""
    for effect in map(fit.model.registry.effects.__getitem__, only):
        if issubclass(effect, UncertainTemperature) and effect.covariate in read:
            yield from _of_runs(fit, effect, at) if issubclass(effect, TemperatureOffset) else _shared(fit, effect, at)


def _relative(fit: Fit, effect: str, name: str, unit: str, column: np.ndarray) -> InstrumentError:
    """Return an error that is a share of what is read; `column` is the response to the whole of it."""
    stated, factor = _of_campaign(fit.model.campaign)[effect], to_si(unit)
    size = _SIZES[effect] if stated is None else stated
    return InstrumentError(effect, name, unit, size / factor, column * factor, stated is not None)


def _of_runs(fit: Fit, effect: type[TemperatureOffset], at: "_Response") -> Iterator[InstrumentError]:
    """Yield the error of each run that states no uncertainty of its temperature; 0 is one that is stated."""
    column = None
    for place, run in enumerate(fit.model.campaign.runs):
        name = name_of(f"{effect.name}.offset", run.name)
        known = name in fit.model.layout.names or getattr(run, _STATED[effect.covariate]) is not None
        if known or effect.covariate not in run.covariates or getattr(run, _READ_BY[effect.covariate]) is not None:
            continue
        column = at.offset(effect.covariate) if column is None else column
        yield _of_effect(fit, effect, "offset", run.name, np.where(_entries(fit, [place]), column, 0.0))


def _shared(fit: Fit, effect: type[UncertainTemperature], at: "_Response") -> Iterator[InstrumentError]:
    """Yield the errors of thermometers that are not stated, and the gain of each run without a thermometer."""
    campaign, key, covariate = fit.model.campaign, effect.per[0], effect.covariate
    readers: dict[str, list[int]] = {}
    alone: list[int] = []
    for place, run in enumerate(campaign.runs):
        if covariate in run.covariates:
            name = getattr(run, key)
            (alone if name is None else readers.setdefault(name, [])).append(place)
    for name, places in readers.items():
        own, member = campaign.thermometers[name], _entries(fit, places)
        if own.offset_uncertainty is None:
            yield _of_effect(fit, effect, "offset", name, np.where(member, at.offset(covariate), 0.0))
        if own.gain_uncertainty is None:
            yield _of_effect(fit, effect, "gain", name, np.where(member, at.gain(covariate), 0.0))
    for place in alone:
        run = campaign.runs[place]
        values = run.covariates[covariate]
        if np.ptp(values) > 0 and getattr(run, _STATED[covariate]) != 0:
            about = at.gain(covariate) - (values.mean() - COVARIATES[covariate].centre) * at.offset(covariate)
            yield _of_effect(fit, effect, "gain", run.name, np.where(_entries(fit, [place]), about, 0.0))


def _entries(fit: Fit, runs: Sequence[int]) -> np.ndarray:
    """Return whether each entry is of some runs, (E,)."""
    return np.isin(fit.model.assembly.grouping.entries.run, runs)


def _of_effect(
    fit: Fit, effect: type[UncertainTemperature], field: str, owner: str, column: np.ndarray
) -> InstrumentError:
    """Return a parameter that an effect would have; `column` is the response in SI."""
    declared = declared_parameters(effect)[field]
    factor = to_si(declared.unit)
    size = parse_prior(declared.prior, declared.unit, fit.model.campaign.site.gravity, effect.name).sd() / factor
    return InstrumentError(effect.name, name_of(f"{effect.name}.{field}", owner), declared.unit, size, column * factor)


def _of_outputs(fit: Fit, at: "_Response") -> Iterator[InstrumentError]:
    """Yield the error of what outputs were counted or measured by, one for each of their units."""
    grouping, channels = fit.model.assembly.grouping, fit.model.campaign.channels
    for unit in dict.fromkeys(channel.output_unit for channel in channels):
        effect = readout(unit)
        if effect is None:
            continue
        own = [place for place, channel in enumerate(channels) if channel.output_unit == unit]
        counted = np.isin(grouping.entries.channel, own) & ~grouping.entries.closing
        yield _relative(fit, effect, name_of(f"{effect}.gain", unit), "ppm", np.where(counted, at.predicted, 0.0))


def readout(unit: str) -> str | None:
    """Return what outputs of a unit are measured by, as a cause; None of numbers that the unit under test gives."""
    if unit.lower() in ("pulse/s", "pulses/s", "count/s", "counts/s", "hz", "khz", "mhz"):
        return TIME_BASE
    return METER if unit in ("V", "mV", "uV", "A", "mA", "uA", "nA") else None


class _Response:
    """Changes of the predicted entries of a fit with what its campaign records."""

    def __init__(self, fit: Fit):
        problem, z = fit.model.problem, np.asarray(fit.z)
        self._problem = problem
        self._values = np.concatenate([np.asarray(problem.priors.values(z)), np.asarray(problem.nulls)])

    @property
    def predicted(self) -> np.ndarray:
        """The prediction, output units (E,)."""
        return np.asarray(_predicted(self._problem, self._values))

    def offset(self, covariate: str) -> np.ndarray:
        """Return the derivative by what is added to a covariate, SI (E,)."""
        return self._difference({covariate: (0.0, 1.0)}, 0.0, _KELVIN)

    def gain(self, covariate: str) -> np.ndarray:
        """Return the derivative by the gain of a thermometer, about its centre, with the rate of change (E,)."""
        scaled = self.scaled({covariate: 1.0, f"{covariate}_rate": 1.0}, 0.0)
        return scaled - COVARIATES[covariate].centre * self.offset(covariate)

    def scaled(self, covariates: Mapping[str, float], seconds: float) -> np.ndarray:
        """Return the derivative by δ if covariates are multiplied by (1 + δ) to a power (E,).

        Parameters
        ----------
        covariates : name → power.
        seconds : power for the steps of time that memories look back on.
        """
        return self._difference({name: (power, 0.0) for name, power in covariates.items()}, seconds, _SHARE)

    def _difference(self, changes: Mapping[str, tuple[float, float]], seconds: float, step: float) -> np.ndarray:
        up, down = (
            np.asarray(_predicted(_changed(self._problem, changes, seconds, side * step), self._values))
            for side in (1, -1)
        )
        return (up - down) / (2 * step)


@in_numpy
def _predicted(problem: Problem, values: Array) -> Array:
    return predict_from(problem, values)


def _changed(problem: Problem, changes: Mapping[str, tuple[float, float]], seconds: float, delta: float) -> Problem:
    """Return a problem with covariates x → x (1 + δ)^power + slope δ, wherever it has them."""

    def ambient(at: Ambient) -> Ambient:
        moved = {
            name: np.asarray(at.values[name]) * (1 + delta) ** power + slope * delta
            for name, (power, slope) in changes.items()
            if name in at.values
        }
        return at.updated(**moved)

    def changed(leaf):
        if isinstance(leaf, Records):
            lasting = np.asarray(leaf.seconds) * (1 + delta) ** seconds
            return Records(leaf.node, leaf.place, leaf.begins, lasting, ambient(leaf.ambient))
        return ambient(leaf) if isinstance(leaf, Ambient) else leaf

    return jax.tree.map(changed, problem, is_leaf=lambda leaf: isinstance(leaf, Records | Ambient))
