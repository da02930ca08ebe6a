"""The rates of a table that were recorded without their signs, or not at all: the gyros determine them row by row.

The open value of a column of rates is a rate for each row.  Points with a name are the recorded rates with the signs
that the gyros show, or in another order, and a column that holds nothing but zeros.  The rates of a reference gyro may
have another sign or unit.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from imubayes.campaign.setup_gate.equipment_mistakes import Mistake, Scope, all_runs, single_runs
from imubayes.campaign.setup_gate.reading_mistakes import ChannelGain
from imubayes.campaign.setup_gate.setup_view import RunView, changed
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.wrong_records import RATE_UNITS, SCALE_OF_KIND

_LEAST_RATE = math.radians(0.5)  # rad/s, of rows that count as turning
_LEAST_ALONG = 0.3  # cosine between the axis of the table and that of the gyro that determines its rate
_SAME_FACTOR = 0.02  # relative difference of units that are one
_EXCHANGES: dict[tuple[int, ...], tuple[int, int, int]] = {(0, 1): (1, 0, 2), (0, 2): (2, 1, 0), (1, 2): (0, 2, 1)}
_AS_RECORDED = 0.2  # relative difference of rates that are alike but for the sign


def shown_rates(campaign: Campaign, view: RunView) -> np.ndarray | None:
    """Return the rate of the table in each row that the gyro nearest to its axis shows, rad/s; None without one."""
    if view.table is None or view.outer is not None or view.reference is not None:
        return None
    along = [
        float(channel.axes[0] @ view.body_to_table[2]) if channel.kind == "gyro" else 0.0
        for channel in campaign.channels
    ]
    place = int(np.argmax(np.abs(along)))
    if abs(along[place]) < _LEAST_ALONG:
        return None
    channel = campaign.channels[place]
    return (view.observed[:, place] - channel.offset) / (channel.scale_si * along[place])


@dataclass(frozen=True)
class RateWithoutSign(Mistake):
    """The rates of a run were recorded as magnitudes; `signs` are those of its rows."""

    signs: np.ndarray
    kind: ClassVar[str] = "rate_without_sign"

    @property
    def unlikelihood(self) -> float:
        """Every sign is chosen by the outputs."""
        return 2 * math.log(2) * len(self.signs)

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield the runs whose rates have one sign, and whose gyros show both at about these rates."""
        for scope in single_runs(views):
            view = views[scope.runs[0]]
            shown, turning = shown_rates(campaign, view), np.abs(view.rate) > _LEAST_RATE
            if shown is None or not turning.any() or len(np.unique(np.sign(view.rate[turning]))) > 1:
                continue
            alike = np.abs(np.abs(shown) - np.abs(view.rate)) < _AS_RECORDED * np.abs(view.rate)
            signs = np.where(turning & np.isfinite(shown), np.sign(shown * np.sign(view.rate[turning][0])), 1.0)
            if alike[turning].all() and 0 < np.sum(signs < 0) < np.sum(turning):
                yield cls(scope, signs)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with signed rates."""
        view = views[place]
        return changed(view, rate=view.rate * self.signs, span=view.span * self.signs)


@dataclass(frozen=True)
class RatesExchanged(Mistake):
    """The rates of some rows of a run are exchanged among them: row `order[k]` holds the rate of row k.

    Two rows, and all rows in reverse, are points on any other order.
    """

    order: tuple[int, ...]
    kind: ClassVar[str] = "rates_exchanged"

    @property
    def rows(self) -> tuple[int, ...]:
        """Places of the rows that hold the rate of another one, from 0."""
        return tuple(k for k, place in enumerate(self.order) if k != place)

    @property
    def reverse(self) -> bool:
        """Whether all rows are in reverse."""
        return self.order == tuple(reversed(range(len(self.order))))

    @property
    def unlikelihood(self) -> float:
        """The order is chosen by the outputs, among all of so many rows."""
        among, moved = len(self.order), len(self.rows)
        return 0.0 if self.reverse else 2 * (math.lgamma(among + 1) - math.lgamma(among - moved + 1) - math.log(2))

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield the runs in which the rows that are off have the rates of each other."""
        for scope in single_runs(views):
            view = views[scope.runs[0]]
            shown = shown_rates(campaign, view)
            if shown is None:
                continue
            if view.rows > 2 and _alike(shown, view.rate[::-1]).all() and not _alike(shown, view.rate).all():
                yield cls(scope, tuple(reversed(range(view.rows))))
                continue
            off = np.flatnonzero(~_alike(shown, view.rate))
            source = np.empty(len(off), dtype=int)
            source[np.argsort(shown[off], kind="stable")] = off[np.argsort(view.rate[off], kind="stable")]
            if len(off) > 1 and _alike(shown[off], view.rate[source]).all():
                order = np.arange(view.rows)
                order[off] = source
                yield cls(scope, tuple(order.tolist()))

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the rates in their places."""
        view, order = views[place], list(self.order)
        return changed(view, rate=view.rate[order], span=view.span[order])


@dataclass(frozen=True)
class ReferenceUnit(Mistake):
    """The rates of a reference gyro have the opposite sign about one axis, are exchanged, or all in another `unit`.

    Gyros that are all held against it may be wrong in the same way.

    Attributes
    ----------
    axes : of the reference gyro that are concerned.
    order : of the columns that hold the rates about x, y and z.
    """

    axes: tuple[int, ...]
    factor: float
    unit: str
    order: tuple[int, int, int] = (0, 1, 2)
    kind: ClassVar[str] = "reference_unit"

    @property
    def variant(self) -> str:
        """The axes and the unit."""
        return f"{self.axes} {self.unit}"

    @property
    def unlikelihood(self) -> float:
        """A reference is that of all runs."""
        return SCALE_OF_KIND if self.scope.section == "run" else 0.0

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield each axis reversed, each pair exchanged, and every unit, in all runs beside a reference gyro or one."""
        beside = [k for k, view in enumerate(views) if view.reference is not None]
        scopes = [all_runs(beside), *(Scope("run", views[k].name, (k,)) for k in beside)] if beside else []
        for scope in scopes:
            yield from (cls(scope, (axis,), -1.0, "") for axis in range(3))
            yield from (cls(scope, pair, 1.0, "", order) for pair, order in _EXCHANGES.items())
            yield from (cls(scope, (0, 1, 2), factor, unit) for unit, factor in RATE_UNITS.items())

    def like(self, other: Mistake) -> bool:
        """Return whether another mistake is the sign or the unit of gyros that does the same."""
        if not isinstance(other, ChannelGain) or self.factor == 1 or other.scope.runs != self.scope.runs:
            return False
        return abs(other.factor / self.factor - 1) < _SAME_FACTOR

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the rates of the reference converted, or in order."""
        reference = views[place].reference
        assert reference is not None
        reference = reference[:, list(self.order)]
        return changed(views[place], reference=reference * np.where(np.isin(range(3), self.axes), self.factor, 1.0))


def _alike(shown: np.ndarray, recorded: np.ndarray) -> np.ndarray:
    return np.abs(shown - recorded) < _AS_RECORDED * np.maximum(np.abs(recorded), _LEAST_RATE) + _LEAST_RATE


@dataclass(frozen=True)
class RatesMissing(Mistake):
    """The column of rates holds zeros in runs that turned; `rates` are those that the gyros show, run by run."""

    rates: tuple[np.ndarray, ...]
    kind: ClassVar[str] = "rates_missing"

    @property
    def unlikelihood(self) -> float:
        """Every rate is chosen by the outputs: among as many as a gyro distinguishes over its range."""
        return 2 * math.log(1e4) * sum(map(len, self.rates))

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield all runs together, and each, whose rates are zero while a gyro shows that the table turns."""
        shown = {k: shown_rates(campaign, view) for k, view in enumerate(views) if not np.any(view.rate)}
        turned = {
            k: np.nan_to_num(each) for k, each in shown.items()
            if each is not None and np.nanmax(np.abs(each), initial=0.0) > 10 * _LEAST_RATE
        }  # fmt: skip
        if turned:
            name = views[next(iter(turned))].name
            scope = Scope("run", name, tuple(turned)) if len(turned) == 1 else all_runs(tuple(turned))
            yield cls(scope, tuple(turned.values()))

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the rates that the gyro shows."""
        return changed(views[place], rate=self.rates[self.scope.runs.index(place)])
