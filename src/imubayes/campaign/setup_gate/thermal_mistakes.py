"""Mistakes in the recorded temperatures: of a run, of two runs, or of the two thermometers.

They show only if the outputs follow the temperature.  Any temperature that the outputs agree with is a hypothesis,
and rivals the mistakes that have a name: degrees Fahrenheit, exchanged columns, a column in the wrong order.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from imubayes.campaign.setup_gate.equipment_mistakes import DOUBTED, Concealed, Mistake, Scope, all_runs, single_runs
from imubayes.campaign.setup_gate.setup_view import RunView, changed
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.covariates import COVARIATES
from imubayes.foundations.wrong_records import OPEN, WrongRecord, celsius

LEAST_COURSE = 2.0
"""°C; a temperature that changes by less is the same reversed, and one that is off by less is not told."""
_MARGIN = 10.0  # °C, by which a corrected temperature may exceed those of the other runs
_PLACES = 4  # of temperatures, between which the best one is found
SENSOR, CONVERTER = "temperature", "converter_temperature"


def _recorded(views: Sequence[RunView], names: tuple[str, ...]) -> list[Scope]:
    """Return all runs with these temperatures together, and each by itself."""
    places = [scope for scope in single_runs(views) if set(names) <= set(views[scope.runs[0]].temperatures)]
    return [all_runs([place.runs[0] for place in places])] * (len(places) > 1) + places


def _among_others(mistake: Mistake, views: Sequence[RunView]) -> bool:
    """Whether the corrected temperatures of a run are among those of the other runs.

    Elsewhere no run determines what the outputs should be, and any temperature explains them.
    """
    (place,) = mistake.scope.runs
    others = [view for k, view in enumerate(views) if k != place]
    for name, values in mistake.corrected(views, place, 0.0).temperatures.items():
        known = [view.temperatures[name] for view in others if name in view.temperatures]
        if not known:
            return False
        reach = np.concatenate(known)
        if np.min(values) < np.min(reach) - _MARGIN or np.max(values) > np.max(reach) + _MARGIN:
            return False
    return True


@dataclass(frozen=True)
class OfTemperatures(Mistake):
    """A mistake in recorded temperatures."""

    concealed: ClassVar[Concealed] = Concealed.BY_INPUTS | Concealed.BY_ONE_INPUT

    @property
    def passes_for(self) -> str:
        """Biases of a run, or a unit that the temperature does not move."""
        if self.scope.section == "run":
            return "biases and scale factors unlike those of other runs"
        return "outputs that ignore the temperature"

    @property
    def record(self) -> str:
        """Temperatures."""
        return SENSOR

    def _of_run(
        self, campaign: Campaign, names: Sequence[str], agreeing: Callable[[float], float], sd: float
    ) -> WrongRecord:
        """Return the mean temperature of the run that agrees with its outputs, as a function of that recorded."""
        run = next(run for run in campaign.runs if run.name == self.scope.name)
        recorded = float(np.mean(run.covariates[names[0]]))
        return WrongRecord(
            run=run.name, form="offset", quantity=" and ".join(COVARIATES[name].column for name in names),
            unit=COVARIATES[names[0]].unit, recorded=recorded, agreeing=(agreeing(recorded),), sd=(sd,) if sd else (),
        )  # fmt: skip


def _opposite(values: Any) -> Any:
    return -values


_NAMED: dict[str, Callable[[Any], Any]] = {"fahrenheit": celsius, "sign": _opposite}
"""What a temperature was taken for → the temperature in °C."""
_FREEZING = 2.0  # °C; nearer to zero a sign makes no difference


@dataclass(frozen=True)
class TemperatureUnit(OfTemperatures):
    """Temperatures of a run are in degrees Fahrenheit, or lack their sign (`how`).

    In all runs they would be another scale of temperature, with other coefficients, and describe the outputs as well.
    """

    names: tuple[str, ...]
    how: str
    kind: ClassVar[str] = "temperature_unit"

    @property
    def variant(self) -> str:
        """What the temperatures were taken for."""
        return self.how

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield each thermometer of each run, and both."""
        for names, how in itertools.product(((SENSOR,), (CONVERTER,), (SENSOR, CONVERTER)), _NAMED):
            for scope in _recorded(views, names):
                mistake = cls(scope, names, how)
                if scope.section == "run" and mistake.changes(views) and _among_others(mistake, views):
                    yield mistake

    def changes(self, views: Sequence[RunView]) -> bool:
        """Return whether the correction is one: near zero a sign makes no difference."""
        recorded = views[self.scope.runs[0]].temperatures
        return self.how != "sign" or all(abs(float(np.mean(recorded[name]))) > _FREEZING for name in self.names)

    def wrong_record(self, campaign: Campaign, size: float, sd: float) -> WrongRecord | None:
        """Return the mean temperature in °C."""
        return self._of_run(campaign, self.names, _NAMED[self.how], 0.0)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with its temperatures in °C."""
        view = views[place]
        return changed(
            view,
            temperatures={
                name: _NAMED[self.how](values) if name in self.names else values
                for name, values in view.temperatures.items()
            },
        )


@dataclass(frozen=True)
class ThermometersExchanged(OfTemperatures):
    """The temperatures of sensor and converter are exchanged."""

    kind: ClassVar[str] = "thermometers_exchanged"

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield all runs with both thermometers, and each; a converter at one temperature has it stated for the run."""
        columns = [k for k, view in enumerate(views) if np.ptp(view.temperatures.get(CONVERTER, 0.0)) > 0]
        for scope in _recorded([views[k] for k in columns], (SENSOR, CONVERTER)):
            scope = replace(scope, runs=tuple(columns[place] for place in scope.runs))
            mistake = cls(scope)
            if scope.section != "run" or _among_others(mistake, views):
                yield mistake

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the two columns in their places."""
        recorded = views[place].temperatures
        return changed(views[place], temperatures={SENSOR: recorded[CONVERTER], CONVERTER: recorded[SENSOR]})


@dataclass(frozen=True)
class TemperatureReversed(OfTemperatures):
    """Columns of temperatures run backwards in time."""

    names: tuple[str, ...]
    kind: ClassVar[str] = "temperature_reversed"

    @property
    def passes_for(self) -> str:
        """Biases of the run, which may drift."""
        return "biases that drift, or unlike those of other runs"

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield the runs in which a temperature changes, and those in which both do."""
        for names in ((SENSOR,), (CONVERTER,), (SENSOR, CONVERTER)):
            for scope in single_runs(views):
                recorded = views[scope.runs[0]].temperatures
                if all(name in recorded and np.ptp(recorded[name]) > LEAST_COURSE for name in names):
                    yield cls(scope, names)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the columns in the order of time."""
        recorded = views[place].temperatures
        return changed(views[place], temperatures={**recorded, **{name: recorded[name][::-1] for name in self.names}})


@dataclass(frozen=True)
class TemperatureValue(OfTemperatures):
    """The temperature of a run is another one; the size in °C is added to what was recorded.

    Attributes
    ----------
    reach : least and largest size that leads to temperatures of other runs.
    """

    names: tuple[str, ...]
    reach: tuple[float, float]
    kind: ClassVar[str] = "temperature_value"
    of_doubted_runs: ClassVar[int] = DOUBTED
    estimated: ClassVar[bool] = True
    open_value: ClassVar[bool] = True
    per_radian: ClassVar[float] = 100.0
    settled: ClassVar[float] = 1.0
    rarity: ClassVar[float] = OPEN

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield the thermometer of the sensors in each run; the only one of a converter goes with it."""
        for scope in single_runs(views):
            own = views[scope.runs[0]].temperatures
            names = tuple(own)
            others = [view.temperatures for k, view in enumerate(views) if k != scope.runs[0]]
            known = [np.concatenate([each[name] for each in others if name in each] or [[]]) for name in names]
            if names and all(len(each) for each in known):
                low = max(np.min(each) - _MARGIN - np.min(own[name]) for name, each in zip(names, known, strict=True))
                high = min(np.max(each) + _MARGIN - np.max(own[name]) for name, each in zip(names, known, strict=True))
                if low < high:
                    yield cls(scope, names, (float(low), float(high)))

    def grid(self) -> tuple[float, ...]:
        """Return sizes through the temperatures that other runs determine."""
        return tuple(np.linspace(*self.reach, _PLACES).tolist())

    def possible(self, size: float) -> bool:
        """Return whether other runs determine what the outputs are at such temperatures."""
        return self.reach[0] < size < self.reach[1] and abs(size) > LEAST_COURSE

    def wrong_record(self, campaign: Campaign, size: float, sd: float) -> WrongRecord | None:
        """Return the other mean temperature."""
        return self._of_run(campaign, self.names, lambda recorded: recorded + size, sd)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run at the other temperature."""
        recorded = views[place].temperatures
        return changed(views[place], temperatures={**recorded, **{name: recorded[name] + size for name in self.names}})


@dataclass(frozen=True)
class TemperaturesExchanged(OfTemperatures):
    """The temperatures of two runs are exchanged; `second` is the name of the second, `other` its place."""

    second: str
    other: int
    kind: ClassVar[str] = "temperatures_exchanged"
    of_doubted_runs: ClassVar[int] = DOUBTED

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every pair of runs at different temperatures, or with different courses of them."""
        for first, second in itertools.combinations([k for k, view in enumerate(views) if view.temperatures], 2):
            one, other, rows = views[first].temperatures, views[second].temperatures, views[first].rows
            if one.keys() == other.keys() and any(_differ(one[name], _as_long(other[name], rows)) for name in one):
                yield cls(Scope("run", views[first].name, (first, second)), views[second].name, second)

    def wrong_record(self, campaign: Campaign, size: float, sd: float) -> WrongRecord | None:
        """Return the exchange."""
        return WrongRecord(
            run=self.scope.name, form="exchange", quantity=COVARIATES[SENSOR].column, unit="1", recorded=0.0,
            agreeing=(1.0,), other=self.second,
        )  # fmt: skip

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the temperatures of the other."""
        view, source = views[place], views[self.scope.runs[0] if place == self.other else self.other]
        return changed(view, temperatures={name: _as_long(x, view.rows) for name, x in source.temperatures.items()})


def _differ(one: np.ndarray, other: np.ndarray) -> bool:
    return float(np.sqrt(np.mean((one - other) ** 2))) > LEAST_COURSE


def _as_long(values: np.ndarray, rows: int) -> np.ndarray:
    """Return a column as it is in a run of so many rows."""
    if len(values) == rows:
        return values
    return np.interp(np.linspace(0, 1, rows), np.linspace(0, 1, len(values)), values)
