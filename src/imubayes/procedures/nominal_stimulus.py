"""Nominal stimulus of a run at its nodes (NumPy only, so that reading campaigns does not import JAX)."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class OuterMotion:
    """The outer and the middle axis of a table at the nodes of a run, in SI; an axis that it lacks stands still.

    Attributes
    ----------
    links : shape (n, 2, 3, 3), nominal `imubayes.campaign_data.Table.links`.
    arms : shape (n, 2, 3), from each axis to the next, in its own frame.
    angle, rate, acceleration : shape (n, 2).
    """

    links: np.ndarray
    arms: np.ndarray
    angle: np.ndarray
    rate: np.ndarray
    acceleration: np.ndarray

    @staticmethod
    def still(count: int) -> "OuterMotion":
        """Return the axes of a table that has none of them, at some number of nodes."""
        zero = np.zeros((count, 2))
        return OuterMotion(np.broadcast_to(np.eye(3), (count, 2, 3, 3)), np.zeros((count, 2, 3)), zero, zero, zero)


@dataclass(frozen=True)
class Stimulus:
    """The nodes of one run (n of them), in SI.

    Attributes
    ----------
    row : shape (n,), the row of the run each node belongs to.
    weight : shape (n,), sums to 1 over the nodes of a row.
    base, mounting : shape (n, 3, 3), nominal.
    table_angle, table_rate, table_acceleration : shape (n,).
    reference_rate, reference_acceleration : shape (n, 3), body axes; zero without a reference gyro.
    ambient : covariate name → shape (n,), the covariates of the run.
    injected : whether a current replaces the sensor at the converter input.
    pose : shape (n,), static pose of a free tumble, else −1.
    driven : whether a gyro drives the table.
    directed : whether the attitude is set by directions of the site, north and the vertical.
    outer : the axes that carry the table's inner one, whose frame at angle 0 is then no longer `base`; None where
        there are none.
    """

    row: np.ndarray
    weight: np.ndarray
    base: np.ndarray
    mounting: np.ndarray
    table_angle: np.ndarray
    table_rate: np.ndarray
    table_acceleration: np.ndarray
    reference_rate: np.ndarray
    reference_acceleration: np.ndarray
    ambient: dict[str, np.ndarray]
    injected: bool
    pose: np.ndarray
    driven: bool = False
    directed: bool = False
    outer: OuterMotion | None = None

    @property
    def referenced(self) -> bool:
        """Whether a reference gyro measures the rate."""
        return bool(np.any(self.reference_rate != 0))

    @property
    def supplies(self) -> frozenset[str]:
        """Names of what this run recorded, and of what happens in it."""
        seen = set(self.ambient)
        # Between the poses of a free tumble the unit is turned by hand.
        carried = self.outer is not None and np.any(self.outer.rate != 0)
        if np.any(self.table_rate != 0) or np.any(self.pose >= 0) or self.referenced or carried:
            seen.add("turning")
        if self.referenced:
            seen.add("reference")
        accelerations = [self.table_acceleration, self.reference_acceleration]
        accelerations += [self.outer.acceleration] if self.outer is not None else []
        if any(np.any(values != 0) for values in accelerations):
            seen.add("acceleration")
        if self.injected:
            seen.add("injection")
        if self.driven:
            seen.add("driven")
        if self.directed:
            seen.add("directions")
        return frozenset(seen)
