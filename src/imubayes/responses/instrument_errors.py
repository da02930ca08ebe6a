"""Errors of the instruments beside the unit: thermometers, clock, vibration sensor, counters and meters of outputs.

A model reads temperature, time and vibration as the campaign records them, and outputs as they were counted.  Where the
campaign states no uncertainty of a thermometer, the model takes its reading as exact; of the other instruments it never
knows an error.  Such an error is no parameter of any effect.  The response to it is the change of the predicted outputs
with the record: true = recorded + δ for a thermometer, one δ for each run, true = recorded · (1 + δ) for clock and
vibration, and for outputs predicted · δ.  A clock that is fast by δ makes rates of change of temperature smaller by δ.

The sizes are those of instruments of which nothing is stated: the prior of `thermometer_error`, a quartz without an
oven, an accelerometer for vibration, a multimeter of six digits.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import jax
import numpy as np

from imubayes.compiled.in_numpy import in_numpy
from imubayes.effects.base import RecordEffect
from imubayes.effects.thermometer import TemperatureOffset
from imubayes.foundations.arrays import Array
from imubayes.foundations.campaign_data import Run
from imubayes.foundations.quantity_names import name_of
from imubayes.foundations.signal_path_state import Ambient, Records
from imubayes.inference.fitted_model import Fit
from imubayes.model.problem import Problem, predict_from
from imubayes.parameters.declarations import declared_parameters
from imubayes.parameters.priors import parse_prior

CLOCK, VIBRATION_SENSOR, TIME_BASE, METER = "clock_error", "vibration_sensor_error", "output_time_base", "output_meter"
INSTRUMENTS = ("thermometer_error", "converter_thermometer_error", CLOCK, VIBRATION_SENSOR, TIME_BASE, METER)
"""Causes that instruments have, as effects are named; of the thermometers they are effects."""
_PPM, _PERCENT = 1e-6, 1e-2
_CLOCK_PPM, _VIBRATION_PERCENT = 10.0, 5.0
_READOUT_PPM = {TIME_BASE: _CLOCK_PPM, METER: 50.0}
# Steps of the central differences: predictions are quadratic in a temperature at most, and nearly linear in the others.
_KELVIN, _SHARE = 0.1, 1e-3
_TIMES, _PER_TIME = ("time", "campaign_time", "power_on"), ("temperature_rate", "converter_temperature_rate")
_STATED = {"temperature": "temperature_uncertainty", "converter_temperature": "converter_temperature_uncertainty"}


@dataclass(frozen=True)
class InstrumentError:
    """An error of an instrument that nothing is stated of.

    Attributes
    ----------
    effect, name, unit : cause, parameter as a model would name it, and its unit.
    size : a standard uncertainty that is plausible.
    column : shape (E,), change of the predicted entries per unit.
    """

    effect: str
    name: str
    unit: str
    size: float
    column: np.ndarray


def instrument_errors(fit: Fit, only: Sequence[str] = INSTRUMENTS) -> Iterator[InstrumentError]:
    """Yield the errors that change what a model predicts.

    Parameters
    ----------
    only : causes that are looked at.
    """
    for error in _all(fit, only):
        if error.effect in only and np.any(error.column):
            yield error


def _all(fit: Fit, only: Sequence[str]) -> Iterator[InstrumentError]:
    registry, at = fit.model.registry, _Response(fit)
    effects = [registry.effects[each.name] for each in fit.model.spec.effects]
    read = {need for effect in effects for need in effect.needs}
    for effect in registry.effects.values():
        if issubclass(effect, TemperatureOffset) and effect.name in only and effect.covariate in read:
            yield from _of_thermometer(fit, effect, at)
    timed = any(issubclass(effect, RecordEffect) for effect in effects) or read & {*_TIMES, *_PER_TIME}
    if CLOCK in only and timed:
        scaled = dict.fromkeys(_TIMES, 1.0) | dict.fromkeys(_PER_TIME, -1.0)
        yield InstrumentError(CLOCK, f"{CLOCK}.rate[all]", "ppm", _CLOCK_PPM, at.scaled(scaled, 1.0) * _PPM)
    if VIBRATION_SENSOR in only and "vibration" in read:
        column = at.scaled({"vibration": 1.0}, 0.0) * _PERCENT
        yield InstrumentError(VIBRATION_SENSOR, f"{VIBRATION_SENSOR}.gain[all]", "%", _VIBRATION_PERCENT, column)
    if {TIME_BASE, METER}.intersection(only):
        yield from _of_outputs(fit, at)


def _of_thermometer(fit: Fit, effect: type[TemperatureOffset], at: "_Response") -> Iterator[InstrumentError]:
    """Yield the error of each run that states no uncertainty of its temperature; 0 is one that is stated."""
    (field, declared), campaign = next(iter(declared_parameters(effect).items())), fit.model.campaign
    prior = parse_prior(declared.prior, declared.unit, campaign.site.gravity, effect.name)
    column, run_of = None, fit.model.assembly.grouping.entries.run
    for place, run in enumerate(campaign.runs):
        name = name_of(f"{effect.name}.{field}", run.name)
        known = name in fit.model.layout.names or _uncertainty(run, effect.covariate) is not None
        if known or effect.covariate not in run.covariates:
            continue
        column = at.offset(effect.covariate) if column is None else column
        yield InstrumentError(effect.name, name, declared.unit, prior.sd(), np.where(run_of == place, column, 0.0))


def _uncertainty(run: Run, covariate: str) -> float | None:
    return getattr(run, _STATED[covariate])


def _of_outputs(fit: Fit, at: "_Response") -> Iterator[InstrumentError]:
    """Yield the error of what outputs were counted or measured by, one for each of their units."""
    grouping, channels = fit.model.assembly.grouping, fit.model.campaign.channels
    for unit in dict.fromkeys(channel.output_unit for channel in channels):
        effect = readout(unit)
        if effect is None:
            continue
        own = [place for place, channel in enumerate(channels) if channel.output_unit == unit]
        counted = np.isin(grouping.entries.channel, own) & ~grouping.entries.closing
        column = np.where(counted, at.predicted, 0.0) * _PPM
        yield InstrumentError(effect, name_of(f"{effect}.gain", unit), "ppm", _READOUT_PPM[effect], column)


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

    def scaled(self, covariates: Mapping[str, float], seconds: float) -> np.ndarray:
        """Return the derivative by δ where covariates are multiplied by (1 + δ) to a power (E,).

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
