"""Mistakes in how a unit was mounted, and in the axes of its channels."""

import itertools
import math
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
from imubayes.campaign.setup_gate.error_model import NormalTerms
from imubayes.campaign.setup_gate.evidence import ErrorModel, rotation
from imubayes.campaign.setup_gate.setup_view import RunView, changed, in_body
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
class MountingAngles(Mistake):
    """The matrix of a mounting is any other rotation: `matrix`, that of most evidence."""

    matrix: np.ndarray
    kind: ClassVar[str] = "mounting_wrong"
    rarity: ClassVar[float] = 30.0  # three angles are chosen by the outputs, among hundreds of each

    @property
    def variant(self) -> str:
        """Any angles."""
        return "angles"

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield the rotation that the runs of each mounting show beside all others."""
        model = ErrorModel(campaign)
        terms = model.terms_of_parts(len(views), model.seen_in_parts(views))
        for scope in mountings_of(views):
            rest = terms.total() - terms[list(scope.runs)].total()
            matrix = _shown_mounting(campaign, [views[k] for k in scope.runs], rest)
            if matrix is not None:
                yield cls(scope, matrix)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run in the other orientation."""
        return changed(views[place], body_to_table=self.matrix)


_WIDE, _LONGEST, _TURNS, _SETTLED = 1.0, 0.5, 6, 1e-3  # rad, of the angles of a mounting; steps
_LEAST_TURN = np.radians(3.0)


def _shown_mounting(campaign: Campaign, views: Sequence[RunView], rest: NormalTerms) -> np.ndarray | None:
    """Return the matrix of a mounting of some runs of most evidence, (3, 3); None if it is about the stated one.

    Parameters
    ----------
    rest : terms of the other runs.
    """
    model, stated = ErrorModel(campaign), views[0].body_to_table
    place, matrix = model.mountings[views[0].mounting or ""], stated

    def terms(of: np.ndarray) -> NormalTerms:
        turned = [changed(view, body_to_table=of) for view in views]
        return rest + model.terms_of_parts(len(turned), model.seen_in_parts(turned)).total()

    for width in (_WIDE, model.sd[place]):
        model.sd[place : place + 3] = width
        for _ in range(_TURNS):
            step = model.estimates(terms(matrix))[place : place + 3]
            step *= min(1.0, _LONGEST / max(float(np.linalg.norm(step)), _SETTLED))
            matrix = matrix @ rotation(step).T
            if float(np.linalg.norm(step)) < _SETTLED:
                break
    # A table that turns does not determine the angle about its axis: it is left as stated.
    about = matrix @ stated.T
    angle = np.arctan2(about[0, 1] - about[1, 0], about[0, 0] + about[1, 1])
    nearest = rotation(np.array([0.0, 0.0, angle])) @ matrix
    if model.score(terms(nearest)) < model.score(terms(matrix)) + 1.0:
        matrix = nearest
    return matrix if np.arccos(np.clip((np.trace(matrix @ stated.T) - 1) / 2, -1, 1)) > _LEAST_TURN else None


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


@dataclass(frozen=True)
class InputAxisAngles(InputAxisWrong):
    """The input axis of a channel has any other direction: that along which its outputs rise."""

    rarity: ClassVar[float] = 16.0  # two angles are chosen by the outputs

    @classmethod
    def suspected(cls, campaign: Campaign, views: Sequence[RunView]) -> Iterator[Mistake]:
        """Yield the direction that the outputs of each channel show, if it is far from the stated one."""
        inputs = [_inputs(view) for view in views]
        for place, channel in enumerate(campaign.channels):
            if channel.kind != "angle":
                felt = [each[channel.kind] for each in inputs]
                outputs = [(view.observed[:, place] - channel.offset) / channel.scale_si for view in views]
                axis = _shown_axis(felt, outputs, channel.axes[0])
                if axis is not None:
                    yield cls(all_runs(range(len(views))), place, _triad(axis, channel.axes[1]))


def _inputs(view: RunView) -> dict[str, np.ndarray]:
    """Return rate and force in body axes, each (R, 3), by the kind of channel that feels them."""
    stand = view.local_to_body()
    return {"gyro": view.rate_in_body(stand), "accelerometer": in_body(stand, view.up())}


_NULL, _UNIT = 1e-2, 0.02
"""Share of the largest input below which a direction has none, and of the length of a direction that is one."""


def _shown_axis(felt: Sequence[np.ndarray], outputs: Sequence[np.ndarray], stated: np.ndarray) -> np.ndarray | None:
    """Return the direction along which outputs rise with their full scale factor; None near the stated one.

    Parameters
    ----------
    felt, outputs : of each run, (R, 3) and (R,), SI; every run has an offset of its own.
    """
    kept = [np.isfinite(each) for each in outputs]
    if not any(rows.sum() > 1 for rows in kept):
        return None
    parts = [
        (x[rows] - x[rows].mean(axis=0), y[rows] - y[rows].mean())
        for x, y, rows in zip(felt, outputs, kept, strict=True) if rows.any()
    ]  # fmt: skip
    x, y = np.concatenate([each for each, _ in parts]), np.concatenate([each for _, each in parts])
    _, size, across = np.linalg.svd(x, full_matrices=False)
    seen = across[size > _NULL * max(size[0], np.finfo(float).tiny)]
    axis = seen.T @ np.linalg.lstsq(x @ seen.T, y, rcond=None)[0]
    # A direction without input takes what is missing of the length.
    rest, missing = stated - seen.T @ (seen @ stated), 1 - float(axis @ axis)
    if missing > 0 and np.linalg.norm(rest) > 0:
        axis = axis + math.sqrt(missing) * rest / np.linalg.norm(rest)
    length = float(np.linalg.norm(axis))
    if abs(length - 1) > _UNIT or axis @ stated / length > math.cos(_LEAST_TURN):
        return None
    return axis / length


def _triad(axis: np.ndarray, output_axis: np.ndarray) -> np.ndarray:
    """Return input, output and cross axis, (3, 3), with the output axis as near the stated one as it can be."""
    across = output_axis - (output_axis @ axis) * axis
    if np.linalg.norm(across) < _NULL:
        across = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    across = across / np.linalg.norm(across)
    return np.stack([axis, across, np.cross(axis, across)])


def _orientations() -> Iterator[np.ndarray]:
    for order, signs in itertools.product(itertools.permutations(range(3)), itertools.product((1.0, -1.0), repeat=3)):
        matrix = np.eye(3)[list(order)] * np.array(signs)[:, None]
        if np.linalg.det(matrix) > 0:
            yield matrix


ORIENTATIONS = list(_orientations())
"""The 24 rotations that map the axes of a cube onto each other, the identity first."""
