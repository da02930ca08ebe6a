"""Mistakes of the axes that carry the inner axis of a table: their zeros, their senses, and columns exchanged.

Those of the inner axis are mistakes of the table itself.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from imubayes.campaign.setup_gate.equipment_mistakes import (
    RIGHT_ANGLES,
    Mistake,
    Scope,
    single_runs,
    tables_of,
    wide_first,
)
from imubayes.campaign.setup_gate.setup_view import CarryingAxes, RunView, changed
from imubayes.foundations.campaign_data import Campaign

OUTER = ("outer", "middle")
AXES = (*OUTER, "table")
_LEAST_ANGLE = math.radians(1.0)  # of columns that differ


def _scopes(campaign: Campaign, views: Sequence[RunView]) -> Iterator[tuple[Scope, int]]:
    """Yield every table of several axes, and every run on one, with each of its axes that carry another."""
    for scope in wide_first(tables_of(views), single_runs(views)):
        table = views[scope.runs[0]].table
        if table is not None and all(views[place].outer is not None for place in scope.runs):
            yield scope, 0
            if campaign.tables[table].middle_axis is not None:
                yield scope, 1


def _carrying(view: RunView) -> CarryingAxes:
    assert view.outer is not None
    return view.outer


@dataclass(frozen=True)
class _OfAxis(Mistake):
    """A mistake of an axis that carries another one."""

    axis: int

    @property
    def variant(self) -> str:
        """The axis."""
        return OUTER[self.axis]


@dataclass(frozen=True)
class AxisZero(_OfAxis):
    """The zero of the outer or of the middle axis of a table is off, in all its runs or one."""

    kind: ClassVar[str] = "axis_zero"
    estimated: ClassVar[bool] = True
    usual_within: ClassVar[float] = math.radians(3.5)
    sizes: ClassVar[tuple[float, ...]] = tuple(np.radians(np.arange(-150, 181, 30)))

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield both axes of every table that has them, and of its runs."""
        return (cls(scope, axis) for scope, axis in _scopes(campaign, views))

    def usual(self, views: Sequence[RunView]) -> tuple[float, ...]:
        """Return right angles."""
        return RIGHT_ANGLES

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the zero moved."""
        outer = _carrying(views[place])
        angle = outer.angle.copy()
        angle[:, self.axis] += size
        return changed(views[place], outer=replace(outer, angle=angle))


@dataclass(frozen=True)
class AxisSense(_OfAxis):
    """The outer or the middle axis of a table turns against the stated sense, in all its runs or one.

    The columns of the angle and of the rate are reversed, or one of them (`columns`).
    """

    columns: tuple[str, ...] = ("angle", "rate")
    kind: ClassVar[str] = "axis_reversed"

    @property
    def variant(self) -> str:
        """The axis, and its columns."""
        return " ".join((OUTER[self.axis], *self.columns))

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield the axes that move in the runs concerned."""
        for scope, axis in _scopes(campaign, views):
            moved = [_carrying(views[k]) for k in scope.runs]
            turned = any(np.any(each.rate[:, axis]) for each in moved)
            tilted = any(np.any(np.nan_to_num(each.angle[:, axis])) for each in moved)
            for columns in (("angle", "rate"), *((("angle",), ("rate",)) if turned and tilted else ())):
                if turned or tilted:
                    yield cls(scope, axis, columns)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with angle and rate of the axis reversed."""
        outer, sign = _carrying(views[place]), np.where(np.arange(2) == self.axis, -1.0, 1.0)
        angle, rate = (sign if column in self.columns else 1.0 for column in ("angle", "rate"))
        turned = replace(outer, angle=outer.angle * angle, rate=outer.rate * rate, span=outer.span * rate)
        return changed(views[place], outer=turned)


@dataclass(frozen=True)
class AxisColumns(Mistake):
    """The columns of two axes of a table are exchanged, in all its runs or one; `first` and `second` of `AXES`."""

    first: int
    second: int
    kind: ClassVar[str] = "axis_columns"

    @property
    def variant(self) -> str:
        """The axes."""
        return f"{AXES[self.first]} {AXES[self.second]}"

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield the pairs of axes whose columns differ."""
        scopes = dict.fromkeys(scope for scope, _ in _scopes(campaign, views))
        for scope, (first, second) in itertools.product(scopes, itertools.combinations(range(len(AXES)), 2)):
            motions = [_columns(views[k]) for k in scope.runs]
            apart = [np.nan_to_num(each[:, :, first] - each[:, :, second]) for each in motions]
            if any(np.any(np.abs(each) > _LEAST_ANGLE) for each in apart):
                yield cls(scope, first, second)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the columns of the two axes in their places."""
        order = np.arange(len(AXES))
        order[[self.first, self.second]] = self.second, self.first
        angle, rate, span = _columns(views[place])[:, :, order]
        outer = replace(_carrying(views[place]), angle=angle[:, :2], rate=rate[:, :2], span=span[:, :2])
        return changed(views[place], outer=outer, angle=angle[:, 2], rate=rate[:, 2], span=span[:, 2])


def _columns(view: RunView) -> np.ndarray:
    """Return angle, rate and span of all axes, shape (3, R, 3)."""
    outer = _carrying(view)
    pairs = ((outer.angle, view.angle), (outer.rate, view.rate), (outer.span, view.span))
    return np.stack([np.column_stack(each) for each in pairs])


def recorded_column(view: RunView, column: str) -> np.ndarray:
    """Return a column of angles or rates of an axis, such as ``middle_angle``, or of temperatures, (R,)."""
    if column in view.temperatures:
        return view.temperatures[column]
    axis, quantity = column.rsplit("_", 1)
    if axis == AXES[-1]:
        return getattr(view, quantity)
    return getattr(_carrying(view), quantity)[:, OUTER.index(axis)]


def with_column(view: RunView, column: str, values: np.ndarray) -> RunView:
    """Return a view with another column of angles or rates of an axis, or of temperatures."""
    if column in view.temperatures:
        return changed(view, temperatures={**view.temperatures, column: values})
    axis, quantity = column.rsplit("_", 1)
    if axis == AXES[-1]:
        return changed(view, **{quantity: values})
    both = getattr(_carrying(view), quantity).copy()
    both[:, OUTER.index(axis)] = values
    return changed(view, outer=replace(_carrying(view), **{quantity: both}))
