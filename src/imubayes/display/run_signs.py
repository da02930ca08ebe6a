"""How the runs of a result are told apart in its figures: the hue by mounting, the marker by temperature.

The hues are told apart by readers with normal vision, protanopia, deuteranopia and tritanopia: CIE 1976 colour
difference of at least 22 in each simulation of Machado, Oliveira and Fernandes (2009).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl

from imubayes.covariates import COVARIATES
from imubayes.display.labels import shortened

HUES = ("#0072b2", "#d55e00", "#56b4e9", "#7a3b00", "#8c8c8c", "#332288")
MARKERS = ("o", "^", "s", "D", "v", "P", "X")
_STYLES = 2 * len(HUES)
"""Filled and open markers of each hue."""
_ALIKE, _RAMP = 5.0, 8.0
"""Temperatures of one level differ by less, those of a ramp by more; degrees Celsius."""
_MOST_LEVELS = 5


@dataclass(frozen=True)
class Sign:
    """How points of a run are drawn: hue, marker, and whether the marker is filled."""

    hue: str
    marker: str = "o"
    filled: bool = True


@dataclass(frozen=True)
class LegendEntry:
    """A line of a legend; a heading where it has no sign."""

    label: str
    sign: Sign | None = None


class RunSigns:
    """The sign of every run, the same in all figures of a result.

    Runs of one mounting share a hue, runs at one temperature a marker.  Where all runs have one mounting, or there are
    too many, the hue is that of the run itself or, for more than 12 runs, of the procedure.
    """

    def __init__(
        self,
        runs: Sequence[str],
        mounting: Mapping[str, str] | None = None,
        temperature: Mapping[str, str] | None = None,
        procedure: Mapping[str, str] | None = None,
    ):
        self.runs = list(dict.fromkeys(runs))
        self._heading, self._hue_of = self._by_hue(mounting or {}, procedure or {})
        levels = {run: (temperature or {}).get(run, "") for run in self.runs}
        self._levels = sorted({*levels.values()}, key=_level_order)
        self._level_of = levels if len(self._levels) <= len(MARKERS) else dict.fromkeys(self.runs, "")
        self._classes = list(dict.fromkeys(self._hue_of.values()))

    def _by_hue(self, mounting: Mapping[str, str], procedure: Mapping[str, str]) -> tuple[str, dict[str, str]]:
        """Return what the hues mean, and the class of every run."""
        mounted = {run: mounting.get(run) or "no mounting" for run in self.runs}
        if 1 < len({*mounted.values()}) <= _STYLES:
            return "mounting", mounted
        kinds = {run: procedure.get(run, "").replace("_", " ") for run in self.runs}
        if len(self.runs) > _STYLES and 1 < len({*kinds.values()}) <= _STYLES:
            return "procedure", kinds
        return "run", {run: run for run in self.runs}

    def sign(self, run: str) -> Sign:
        """Return the sign of a run."""
        turn, place = divmod(self._classes.index(self._hue_of[run]), len(HUES))
        marker = MARKERS[self._levels.index(self._level_of[run])] if len(self._levels) > 1 else MARKERS[0]
        return Sign(HUES[place], marker, turn % 2 == 0)

    def legend(self, shown: Sequence[str] | None = None) -> list[LegendEntry]:
        """Return the entries of a legend of the runs that are shown: hues first, then markers."""
        runs = [run for run in self.runs if shown is None or run in shown]
        levels = sorted({self._level_of[run] for run in runs}, key=_level_order)
        first = {self._hue_of[run]: self.sign(run) for run in reversed(runs)}
        classes = list(dict.fromkeys(self._hue_of[run] for run in runs))
        if len(levels) < 2:
            heading = [] if self._heading == "run" else [LegendEntry(self._heading)]
            return heading + [LegendEntry(shortened(name, 25), first[name]) for name in classes]
        hues = [Sign(first[name].hue, MARKERS[0], first[name].filled) for name in classes]
        found = [LegendEntry(self._heading)]
        found += [LegendEntry(shortened(name, 25), sign) for name, sign in zip(classes, hues, strict=True)]
        found.append(LegendEntry("temperature"))
        for level in levels:
            sign = Sign("#222222", MARKERS[self._levels.index(level)])
            found.append(LegendEntry(level or "not recorded", sign))
        return found


def run_signs(residuals: pl.DataFrame, runs: Sequence[str] | None = None) -> RunSigns:
    """Return the signs of the runs of a residuals table, in its order or in that of `runs`.

    Results of earlier versions have no mountings in their table; their hues are those of the runs.
    """
    names = list(runs) if runs is not None else residuals["run"].unique(maintain_order=True).to_list()
    return RunSigns(names, _text(residuals, "mounting"), _levels(residuals), _text(residuals, "procedure"))


def _text(residuals: pl.DataFrame, column: str) -> dict[str, str]:
    """Return the text that each run has in a column; nothing where the table has no such column."""
    if column not in residuals.columns:
        return {}
    found = residuals.group_by("run").agg(pl.col(column).first())
    return {run: text for run, text in found.iter_rows() if text is not None}


def _levels(residuals: pl.DataFrame) -> dict[str, str]:
    """Return the temperature level of each run, "−40 °C" or "ramp"; nothing for runs that recorded none."""
    columns = [COVARIATES[name].column for name in ("temperature", "converter_temperature")]
    known = [pl.col(column) for column in columns if column in residuals.columns]
    if not known:
        return {}
    own = pl.coalesce(known)
    table = residuals.group_by("run").agg(own.median().alias("middle"), (own.max() - own.min()).alias("range"))
    table = table.drop_nulls().filter(pl.col("middle").is_finite()).sort("middle")
    ramps = dict.fromkeys(table.filter(pl.col("range") > _RAMP)["run"].to_list(), "ramp")
    steady = table.filter(pl.col("range") <= _RAMP)
    if steady.is_empty():
        return ramps
    middle = steady["middle"].to_numpy()
    level = np.cumsum(np.diff(middle, prepend=middle[0]) > _ALIKE)
    if level[-1] >= _MOST_LEVELS:
        return ramps
    names = [f"{np.mean(middle[level == place]):.0f} °C".replace("-", "−") for place in level]
    return ramps | dict(zip(steady["run"].to_list(), names, strict=True))


def _level_order(level: str) -> tuple[bool, float, str]:
    """Return the key that puts temperatures in ascending order, and ramps and unknown ones last."""
    number = level.removesuffix(" °C").replace("−", "-")
    try:
        return False, float(number), level
    except ValueError:
        return True, 0.0, level
