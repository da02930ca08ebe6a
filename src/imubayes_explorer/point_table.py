"""The readings of a fit as columns for the panels, and what of them a screen can show, as binary numbers.

Points beyond the resolution of a screen are never sent: of each place on the abscissa the lowest and the highest point
stand for all, selected points and others apart.  Numbers are sent as Float32 behind a header; sums are made before, in
float64.
"""

import math
import struct
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from imubayes.adequacy.known_noise_fit import KnownNoisePoint, noise_sd
from imubayes.criticism.diagnosis_record import CovariateLabel
from imubayes.display.numbers_and_labels import covariates, pretty, readable
from imubayes.display.residual_columns import NORMAL, band, numbers, temperature_levels, varies
from imubayes.foundations.errors import closest_first, input_error
from imubayes.results.result import Result, to_input_units
from imubayes_explorer.known_noise_view import KnownNoiseView
from imubayes_explorer.messages import (
    Brush,
    ExpectedCell,
    Grouping,
    GroupLabels,
    MapCell,
    Ordinate,
    PointsHead,
    PointsWanted,
)
from imubayes_explorer.refit_ahead import Ahead

_ARRAYS = ("x", "observed", "predicted", "band", "y", "sd", "group", "marked", "curve", "after", "entry")


class PointTable:
    """The entries of a fit, (E,) each, with every covariate and residual."""

    def __init__(self, result: Result, view: KnownNoiseView):
        table, model = result.residuals.table, view.fit.model
        self.table, self.view, self.summary = table, view, result.summary
        self.runs, self.run = np.unique(table["run"].to_numpy(), return_inverse=True)
        self.row = 1 + numbers(table, "row")
        order = {name: place for place, name in enumerate(table["run"].unique(maintain_order=True))}
        self.run_names = tuple(sorted(map(str, self.runs), key=lambda name: order[name]))
        self.channel = table["channel"].to_numpy().astype(str)
        self.channels = tuple(name for name in table["channel"].unique(maintain_order=True) if name in self._declared)
        self.to_input, self.units = to_input_units(model), table["input_unit"].to_numpy().astype(str)
        self._channels, self._orders = dict[str, np.ndarray](), dict[str, np.ndarray]()
        known = {each.column: numbers(table, each.column) for each in covariates() if each.column != "row"}
        known |= {each.name: each.values for each in view.known if each.name not in known}
        own = {each.name: (each.unit, each.phrase) for each in view.known}
        own |= {each.column: (each.unit, each.phrase) for each in covariates()}
        self.columns = {"reading": np.arange(len(table), dtype=float)} | {k: v for k, v in known.items() if varies(v)}
        self.abscissae = tuple(
            CovariateLabel(name=name, unit=pretty(own[name][0]), phrase=own[name][1]) if name in own
            else CovariateLabel(name=name, unit="", phrase="reading, in order")
            for name in self.columns
        )  # fmt: skip

    @cached_property
    def _declared(self) -> frozenset[str]:
        return frozenset(channel.name for channel in self.view.fit.model.campaign.channels)

    @cached_property
    def known_noise(self) -> np.ndarray:
        """Standard deviation of the noise known beforehand of every entry, (E,), output units."""
        return noise_sd(self.view.fit.model.problem, self.view.point.h)

    def noise(self, entry: int) -> float:
        """Return the standard deviation of the noise known beforehand of an entry, in the unit of its output."""
        return self._as_shown(entry, self.known_noise)

    def misfit(self, entry: int) -> float:
        """Return the residual of an entry at the noise known beforehand, in the unit of its output."""
        return self._as_shown(entry, self.view.point.misfit)

    def _as_shown(self, entry: int, values: np.ndarray) -> float:
        """Return one of the outputs; the closing rotation of a run is shown in degrees."""
        return float(values[entry]) * (math.degrees(1) if self.view.fit.model.entries.closing[entry] else 1.0)

    @cached_property
    def shown(self) -> dict[str, np.ndarray]:
        """What is drawn of every entry, output units: observed, predicted, and half the width of the 95 % band."""
        return {name: numbers(self.table, name) for name in ("observed", "predicted")} | {"band": band(self.table)}

    def curve(self, point: KnownNoisePoint) -> np.ndarray:
        """Return the prediction with causes previewed, (E,), output units."""
        return self.shown["predicted"] + self.view.point.misfit - point.misfit

    def column(self, name: str) -> np.ndarray:
        """Return an abscissa; raises InputError for an unknown one."""
        if name not in self.columns:
            raise input_error(f"no abscissa '{name}'", "x", closest_first(name, self.columns), "choose one of these")
        return self.columns[name]

    def ordinate(self, name: Ordinate, point: KnownNoisePoint | None = None) -> np.ndarray:
        """Return a residual, (E,): over a noise, or in input units; with causes previewed if a point is given."""
        point = point or self.view.point
        if name == "known":
            return self.view.whitened(point)
        if name == "input":
            return point.misfit * self.to_input
        # A preview leaves the noise as fitted if it is: what causes take off is divided by it.
        whole = self.view.point.misfit - point.misfit
        sd = numbers(self.table, "input_sd")
        return numbers(self.table, "whitened") - whole * self.to_input / np.where(sd > 0, sd, np.inf)

    def _of(self, channel: str) -> np.ndarray:
        """Return which entries are of a channel, (E,) bool."""
        if channel not in self._channels:
            self._channels[channel] = self.channel == channel
        return self._channels[channel]

    def _order(self, name: str) -> np.ndarray:
        """Return the places of all entries, (E,), along an abscissa."""
        if name not in self._orders:
            self._orders[name] = np.argsort(self.column(name), kind="stable")
        return self._orders[name]

    # ---- selections ----

    def chosen(self, brushes: Sequence[Brush]) -> np.ndarray:
        """Return which entries brushes select, (E,) bool: those of any of them."""
        found = np.zeros(len(self.table), dtype=bool)
        for brush in brushes:
            found |= self._within(brush)
        return found & self.view.entries

    def _within(self, brush: Brush) -> np.ndarray:
        here = np.ones(len(self.table), dtype=bool)
        if brush.channels:
            here &= np.logical_or.reduce([self._of(name) for name in brush.channels])
        if brush.rows:
            here &= np.isin(self.row, brush.rows)
        if brush.runs:
            here &= np.isin(self.runs, brush.runs)[self.run]
        if brush.x:
            x = self.column(brush.x)
            here &= (x >= brush.x_low) & (x <= brush.x_high)
        if brush.y is not None:
            y = self.ordinate(brush.y)
            here &= (y >= brush.y_low) & (y <= brush.y_high)
        return here

    def rms(self, chosen: np.ndarray) -> tuple[float | None, str]:
        """Return the rms of chosen entries, a mask or places, in a unit of plain numbers; None of several units."""
        units = np.unique(self.units[chosen])
        if len(units) != 1:
            return None, ""
        size = float(np.sqrt(np.mean(np.square((self.view.point.misfit * self.to_input)[chosen]))))
        factor, unit = readable(str(units[0]), size)
        return factor * size, pretty(unit)

    # ---- the map of runs and channels ----

    @cached_property
    def _cells(self) -> list[tuple[str, str, np.ndarray]]:
        found = []
        for run in self.run_names:
            here = (self.runs == run)[self.run] & self.view.entries
            for channel in self.channels:
                places = np.flatnonzero(here & self._of(channel))
                if len(places):
                    found.append((run, channel, places))
        return found

    def cells(self) -> tuple[MapCell, ...]:
        """Return χ² and rms of every run and channel."""
        square, fitted = self.view.whitened() ** 2, {(each.name, each.channel): each for each in self.summary.runs}
        found = []
        for run, channel, places in self._cells:
            rms, unit = self.rms(places)
            as_fitted = fitted.get((run, channel))
            found.append(MapCell(
                run=run, channel=channel, n=len(places), chi2=float(square[places].sum()),
                fitted=as_fitted.chi2 if as_fitted is not None else None, rms=rms or 0.0, unit=unit,
            ))  # fmt: skip
        return tuple(found)

    def expected(self, ahead: Ahead, of: "PointTable") -> tuple[ExpectedCell, ...]:
        """Return what is expected of the runs and channels of a table, in the order of its cells, with a preview."""
        own, square = {(run, channel): k for run, channel, k in self._cells}, self.view.whitened(ahead.point) ** 2
        found = (own.get((run, channel), np.zeros(0, dtype=int)) for run, channel, _ in of._cells)
        return tuple(ExpectedCell(n=int((~ahead.gone[k]).sum()), chi2=float(square[k].sum())) for k in found)

    # ---- colours ----

    def groupings(self) -> tuple[Grouping, ...]:
        """Return what distinguishes readings: run, and what runs differ in."""
        every: tuple[Grouping, ...] = ("mounting", "temperature", "table")
        return ("run", *(each for each in every if len(self.groups(each)[0]) > 1))

    def labels(self) -> tuple[GroupLabels, ...]:
        """Return the group of each run by everything that distinguishes runs."""
        return tuple(
            GroupLabels(by=by, labels=tuple(self.label(run, by) for run in self.run_names)) for by in self.groupings()
        )

    def groups(self, by: Grouping) -> tuple[tuple[str, ...], np.ndarray]:
        """Return the names of the groups, and the group of each entry, (E,)."""
        names = np.array([self.label(str(run), by) for run in self.runs])
        labels = dict.fromkeys(names[np.searchsorted(self.runs, run)] for run in self.run_names)
        places = {label: place for place, label in enumerate(labels)}
        return tuple(map(str, labels)), np.array([places[name] for name in names])[self.run]

    @cached_property
    def _levels(self) -> dict[str, str]:
        return temperature_levels(self.table)

    def label(self, run: str, by: Grouping) -> str:
        """Return the group of a run."""
        if by == "run":
            return run
        recorded = next(each for each in self.view.fit.model.campaign.runs if each.name == run)
        if by == "temperature":
            return self._levels.get(run, "no temperature")
        return (recorded.mounting if by == "mounting" else recorded.table) or "none"

    # ---- what is drawn ----

    def output_unit(self, channel: str) -> str:
        """Return the unit of the outputs of a channel, as it is shown."""
        declared = self.view.fit.model.campaign.channels
        return pretty(next(each.output_unit for each in declared if each.name == channel))

    def frame(self, wanted: PointsWanted, ahead: Ahead | None = None, refitted: bool = False) -> bytes:
        """Return the points of a view: the length of a header, the header as JSON, and the columns as Float32.

        Parameters
        ----------
        ahead : the fit with causes, or with a change, that is shown beside; None for none.
        refitted : whether it is the refit of a change, whose readings alone are drawn.

        Raises
        ------
        InputError
            for an unknown channel or abscissa.
        """
        if wanted.channel not in self.channels:
            allowed = closest_first(wanted.channel, self.channels)
            raise input_error(f"no channel '{wanted.channel}'", "channel", allowed, "choose one of these")
        x, view = self.column(wanted.x), self.view
        here = view.entries & self._of(wanted.channel) & np.isfinite(x)
        if wanted.runs:
            here &= np.isin(self.runs, wanted.runs)[self.run]
        if ahead is not None:
            here &= ~ahead.gone
        if wanted.between is not None:
            here &= (x >= wanted.between[0]) & (x <= wanted.between[1])
        order = self._order(wanted.x)
        places = order[here[order]]
        previewed = view.point if ahead is None else ahead.point
        factor, label = self._scale_of(wanted, places)
        label += " of the model before" if refitted and wanted.y == "fitted" else ""
        y, after = (factor * self.ordinate(wanted.y, point)[places] for point in (None, previewed))
        marked = self.chosen(wanted.brushes)[places]
        kept = decimated(x[places], y, marked, wanted.most)
        names, group = self.groups(wanted.colour)
        places, y, after, marked = places[kept], y[kept], after[kept], marked[kept]
        sd = numbers(self.table, "input_sd")[places] if wanted.y == "input" else np.ones(len(places))
        head = PointsHead(
            count=len(places), of=int(here.sum()), arrays=_ARRAYS, groups=names, x_label=self._label_of(wanted.x),
            y_label=label, y_factor=factor, output_label=f"{wanted.channel} / {self.output_unit(wanted.channel)}",
            refitted=refitted,
        )  # fmt: skip
        drawn = (*self.shown.values(), self.curve(previewed))
        observed, predicted, wide, curve = (each[places] for each in drawn)
        columns = (
            x[places],
            observed,
            predicted,
            wide,
            y,
            factor * NORMAL * sd,
            group[places],
            marked,
            curve,
            after,
            places,
        )
        return framed(head, columns)

    def _scale_of(self, wanted: PointsWanted, places: np.ndarray) -> tuple[float, str]:
        if wanted.y != "input" or not len(places):
            known = "known noise" if wanted.y == "known" else "fitted noise"
            return 1.0, f"residual / {known}"
        sd, unit = numbers(self.table, "input_sd")[places], str(self.units[places[0]])
        factor, name = readable(unit, float(np.nanmedian(sd)))
        return factor, f"residual / {pretty(name)}"

    def _label_of(self, name: str) -> str:
        axis = next(each for each in self.abscissae if each.name == name)
        return f"{axis.phrase} / {axis.unit}" if axis.unit else axis.phrase


def framed(head: PointsHead, columns: Sequence[np.ndarray]) -> bytes:
    """Return a header and columns as bytes, the header padded so that numbers stand at multiples of four bytes."""
    text = head.model_dump_json().encode()
    text += b" " * (-len(text) % 4)
    return struct.pack("<I", len(text)) + text + b"".join(np.asarray(each, dtype="<f4").tobytes() for each in columns)


def decimated(x: np.ndarray, y: np.ndarray, marked: np.ndarray, most: int) -> np.ndarray:
    """Return the places of at most `most` points, in order: the extremes of each bin of x, marked points apart.

    Parameters
    ----------
    x, y, marked : shapes (n,), x ascending.
    """
    if len(x) <= most:
        return np.arange(len(x))
    bins, width = max(most // 4, 1), (x[-1] - x[0]) or 1.0
    place = np.minimum((bins * (x - x[0]) / width).astype(int), bins - 1)
    apart = [_extremes(place, y, np.flatnonzero(marked == chosen)) for chosen in (False, True)]
    return np.unique(np.concatenate(apart))


def _extremes(place: np.ndarray, y: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Return the lowest and the highest of some points in each bin, by their places; bins (n,) ascend."""
    if not len(own):
        return own
    starts = np.flatnonzero(np.diff(place[own], prepend=-1))
    within, found = np.repeat(np.arange(len(starts)), np.diff(starts, append=len(own))), []
    for extreme in (np.minimum, np.maximum):
        there = np.flatnonzero(y[own] == extreme.reduceat(y[own], starts)[within])
        found.append(own[there[np.unique(within[there], return_index=True)[1]]])
    return np.concatenate(found)
