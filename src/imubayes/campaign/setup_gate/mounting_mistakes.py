"""Mistakes in how a unit was mounted, and in the axes of its channels."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from imubayes.campaign.setup_gate.equipment_mistakes import (
    Concealed,
    Mistake,
    Scope,
    all_runs,
    mountings_of,
    single_runs,
    tables_of,
    wide_first,
)
from imubayes.campaign.setup_gate.setup_view import RunView, changed
from imubayes.foundations.campaign_data import Campaign


@dataclass(frozen=True)
class MountingMislabelled(Mistake):
    """A run was made in `actual`, another mounting of the campaign."""

    actual: str
    matrix: np.ndarray
    kind: ClassVar[str] = "mounting_mislabelled"
    concealed: ClassVar[Concealed] = Concealed.BY_ONE_INPUT

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every other mounting of every run, and of all runs of a mounting."""
        for scope in wide_first(mountings_of(views), single_runs(views)):
            for name, mounting in campaign.mountings.items():
                if name != views[scope.runs[0]].mounting:
                    yield cls(scope, name, mounting.body_to_table)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run in its actual mounting."""
        return changed(views[place], mounting=self.actual, body_to_table=self.matrix)


@dataclass(frozen=True)
class MountingsExchanged(Mistake):
    """Two mountings, `first` and `second`, are exchanged in all runs, or all on a table."""

    first: str
    second: str
    kind: ClassVar[str] = "mountings_exchanged"
    concealed: ClassVar[Concealed] = Concealed.BY_ONE_INPUT

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every pair on every table, and on all."""
        seated = [k for k, view in enumerate(views) if view.mounting is not None and view.table is not None]
        tables = tables_of(views)
        for scope in ([all_runs(seated)] if len(tables) > 1 else []) + tables:
            names = dict.fromkeys(str(views[k].mounting) for k in scope.runs)
            for first, second in itertools.combinations(names, 2):
                runs = tuple(k for k in scope.runs if views[k].mounting in (first, second))
                # Of one run each it is an exchange of files.
                if len(runs) > 2:
                    yield cls(Scope(scope.section, scope.name, runs), first, second)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run in the other mounting."""
        actual = self.second if views[place].mounting == self.first else self.first
        matrix = next(views[k].body_to_table for k in self.scope.runs if views[k].mounting == actual)
        return changed(views[place], mounting=actual, body_to_table=matrix)


@dataclass(frozen=True)
class MountingWrong(Mistake):
    """The matrix of a mounting is wrong: transposed, or another of the 24 orientations of the unit."""

    matrix: np.ndarray
    transposed: bool
    kind: ClassVar[str] = "mounting_wrong"
    concealed: ClassVar[Concealed] = Concealed.BY_ONE_INPUT

    @property
    def unlikelihood(self) -> float:
        """A mounting is the same in all its runs."""
        return 15.0 if self.scope.section == "run" else 8.0

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield the transpose and the other orientations for every mounting and every run."""
        for scope in wide_first(mountings_of(views), single_runs(views)):
            matrix = views[scope.runs[0]].body_to_table
            if not np.allclose(matrix, matrix.T, atol=1e-6):
                yield cls(scope, matrix.T, True)
            for turn in ORIENTATIONS[1:]:
                yield cls(scope, turn @ matrix, False)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run in the other orientation."""
        return changed(views[place], body_to_table=self.matrix)


@dataclass(frozen=True)
class InputAxisWrong(Mistake):
    """The input axis of a channel is another axis of the body."""

    channel: int
    axes: np.ndarray
    kind: ClassVar[str] = "input_axis_wrong"
    concealed: ClassVar[Concealed] = Concealed.BY_ONE_INPUT
    rarity: ClassVar[float] = 8.0

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield every axis of the body that is none of a channel, for each channel with a triad of its kind."""
        for place, channel in enumerate(campaign.channels):
            if channel.kind == "angle" or len(campaign.of_kind(channel.kind)) < 2:
                continue
            for turn in ORIENTATIONS:
                # One orientation of each input axis.
                if abs(turn[0] @ channel.axes[0]) < 0.5 and turn[1].argmax() == (np.abs(turn[0]).argmax() + 1) % 3:
                    yield cls(all_runs(range(len(views))), place, turn)

    @property
    def variant(self) -> str:
        """Channel and axis."""
        return f"{self.channel} {self.axes[0].tolist()}"

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with the other axis."""
        axes = np.array(views[place].axes)
        axes[self.channel] = self.axes
        return changed(views[place], axes=axes)


def _orientations() -> Iterator[np.ndarray]:
    for order, signs in itertools.product(itertools.permutations(range(3)), itertools.product((1.0, -1.0), repeat=3)):
        matrix = np.eye(3)[list(order)] * np.array(signs)[:, None]
        if np.linalg.det(matrix) > 0:
            yield matrix


ORIENTATIONS = list(_orientations())
"""The 24 rotations that map the axes of a cube onto each other, the identity first."""
