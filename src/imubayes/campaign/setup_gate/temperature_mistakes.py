"""Mistakes in the columns of temperatures, which show only where the outputs follow the temperature."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from imubayes.campaign.setup_gate.mistakes import Mistake, Scope, all_runs, single_runs
from imubayes.campaign.setup_gate.run_view import RunView, changed
from imubayes.campaign_data import Campaign

_LEAST_COURSE = 2.0  # °C; a temperature that changes by less is the same reversed
_MARGIN = 10.0  # °C, by which a corrected temperature may exceed those of the other runs
SENSOR, CONVERTER = "temperature", "converter_temperature"


def _recorded(views: Sequence[RunView], names: tuple[str, ...]) -> list[Scope]:
    """Return all runs with these temperatures together, and each by itself."""
    places = [scope for scope in single_runs(views) if set(names) <= set(views[scope.runs[0]].temperatures)]
    return [all_runs([place.runs[0] for place in places])] * (len(places) > 1) + places


def _among_others(mistake: Mistake, views: Sequence[RunView]) -> bool:
    """Whether the corrected temperatures of a run are among those of the other runs.

    Elsewhere no run tells what the outputs should be, and any temperature explains them.
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
class TemperatureUnit(Mistake):
    """Temperatures of a run are in degrees Fahrenheit.

    In all runs they would be another scale of temperature, with other coefficients, and describe the outputs as well.
    """

    names: tuple[str, ...]
    kind: ClassVar[str] = "temperature_unit"

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield each thermometer of each run, and both."""
        for names in ((SENSOR,), (CONVERTER,), (SENSOR, CONVERTER)):
            for scope in _recorded(views, names):
                mistake = cls(scope, names)
                if scope.section == "run" and _among_others(mistake, views):
                    yield mistake

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with its temperatures in °C."""
        view = views[place]
        return changed(
            view,
            temperatures={
                name: (values - 32) / 1.8 if name in self.names else values
                for name, values in view.temperatures.items()
            },
        )


@dataclass(frozen=True)
class ThermometersExchanged(Mistake):
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
class TemperatureReversed(Mistake):
    """Columns of temperatures run backwards in time."""

    names: tuple[str, ...]
    kind: ClassVar[str] = "temperature_reversed"

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield the runs in which a temperature changes, and those in which both do."""
        for names in ((SENSOR,), (CONVERTER,), (SENSOR, CONVERTER)):
            for scope in single_runs(views):
                recorded = views[scope.runs[0]].temperatures
                if all(name in recorded and np.ptp(recorded[name]) > _LEAST_COURSE for name in names):
                    yield cls(scope, names)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the columns in the order of time."""
        recorded = views[place].temperatures
        return changed(views[place], temperatures={**recorded, **{name: recorded[name][::-1] for name in self.names}})


TEMPERATURE_MISTAKES: tuple[type[Mistake], ...] = (ThermometersExchanged, TemperatureUnit, TemperatureReversed)
