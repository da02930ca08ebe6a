"""The axes that carry the inner axis of a table of several axes, and the mean attitude of a unit that they turn."""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from imubayes.campaign_data import Run, Table
from imubayes.procedures.serial_axes import about_z, axis_angles, axis_columns, row_path


@dataclass(frozen=True)
class CarryingAxes:
    """The nominal motion of the outer and the middle axis in one run, in SI.

    Attributes
    ----------
    angle, rate, span : of both axes, at the middle of a row and swept during it; shape (R, 2).
    links : rotations from the frame of the next axis to that of the outer and of the middle axis, shape (2, 3, 3).
    """

    angle: np.ndarray
    rate: np.ndarray
    span: np.ndarray
    links: np.ndarray

    def at(self, rows: np.ndarray) -> "CarryingAxes":
        """Return the motion of other rows."""
        return replace(self, angle=self.angle[rows], rate=self.rate[rows], span=self.span[rows])

    def repeats(self) -> np.ndarray:
        """Return whether each row but the first repeats the angles of the row before it, shape (R − 1,)."""
        return np.all(np.nan_to_num(np.diff(self.angle, axis=0)) == 0, axis=1)

    def turned(self, inner: tuple[np.ndarray, np.ndarray, np.ndarray], to_local: np.ndarray) -> np.ndarray:
        """Return the rotation from local level to the table, mean over each row, shape (R, 3, 3).

        Parameters
        ----------
        inner : angle, rate and span of the inner axis, shape (R,) each.
        to_local : from the frame of the outer axis at angle 0, shape (3, 3).
        """
        return self._means(inner)[0] @ to_local.T

    def rate_of_table(self, inner: tuple[np.ndarray, np.ndarray, np.ndarray]) -> np.ndarray:
        """Return the rate of the table against the Earth in axes of the table, rad/s, mean over rows, shape (R, 3)."""
        return self._means(inner)[1]

    def _means(self, inner: tuple[np.ndarray, np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        own = (self.angle, self.rate, self.span)
        motion = [np.column_stack([outer, table]) for outer, table in zip(own, inner, strict=True)]
        return _means_of(*(each.tobytes() for each in (*motion, self.links)))


@lru_cache(maxsize=256)
def _means_of(angle: bytes, rate: bytes, span: bytes, links: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean over each row of the rotation from the frame of the outer axis to the table, and of its rate.

    Most suspected mistakes leave the motion of the axes as it is.
    """
    motion = [np.frombuffer(each).reshape(-1, 3) for each in (angle, rate, span)]
    paths = [row_path(*row) for row in zip(*motion, strict=True)]
    count = [len(weight) for _, weight in paths]
    weight, angles = (np.concatenate(parts) for parts in ([each for _, each in paths], [each for each, _ in paths]))
    speeds = np.repeat(motion[1], count, axis=0)
    stand, turning = np.broadcast_to(np.eye(3), (len(weight), 3, 3)), np.zeros((len(weight), 3))
    for place, link in enumerate([np.eye(3), *np.frombuffer(links).reshape(2, 3, 3)]):
        back = np.swapaxes(about_z(angles[:, place]), 1, 2)
        turning = turning @ link
        turning[:, 2] += speeds[:, place]
        stand, turning = back @ (link.T @ stand), np.einsum("nij,nj->ni", back, turning)
    starts = np.concatenate([[0], np.cumsum(count)[:-1]])
    return (
        np.add.reduceat(stand * weight[:, None, None], starts, axis=0),
        np.add.reduceat(turning * weight[:, None], starts, axis=0),
    )


def outer_axes(run: Run, table: Table) -> CarryingAxes:
    """Return the motion of the outer axes of a run on a table of several axes."""
    rate, span = axis_columns(run, "rate", 0.0), axis_columns(run, "angle_span", 0.0)
    return CarryingAxes(axis_angles(run)[:, :2], rate[:, :2], span[:, :2], table.links)
