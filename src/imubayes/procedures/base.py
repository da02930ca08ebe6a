"""What a procedure is: kinematics of the equipment, without any effect.

A procedure turns a recorded run into its nominal stimulus.  It knows the table and the mounting as drawn, not as
they truly are; everything that is wrong with them is an effect.
"""

import math
from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np

from imubayes.earth import table_to_local
from imubayes.run import Campaign, Run
from imubayes.stimulus import AMBIENT_NAMES, Stimulus

# A mean over a turn is the mean over equally spaced angles, exact for harmonics below their number.  About a
# vertical axis gravity along an input axis varies by the tilt alone, so products up to the third are covered by 4;
# about an inclined axis it swings by ±1 g and powers up to the fifth, times small harmonics, must average out.
_NODES_VERTICAL, _NODES_INCLINED = 4, 12
_VERTICAL_WITHIN = math.radians(1.0)
# A partial turn is followed by Gauss–Legendre nodes: exact for polynomials of degree 9 over the arc.
_NODES_ARC = 5


class Procedure(ABC):
    """One kind of run.

    Attributes
    ----------
    name : as in campaign files.
    needs : columns without which the run cannot be interpreted.
    reference : where the procedure is described.
    """

    name: ClassVar[str]
    needs: ClassVar[tuple[str, ...]] = ()
    reference: ClassVar[str] = ""

    @abstractmethod
    def stimulus(self, run: Run, campaign: Campaign) -> Stimulus:
        """Return the nominal stimulus of a run, at the nodes of its rows."""


def _angle_nodes(angle: float, span: float, whole_turn_nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Return table angles and weights that stand for one row."""
    if math.isnan(angle):
        count = whole_turn_nodes
        return 2 * math.pi * np.arange(count) / count, np.full(count, 1 / count)
    if abs(span) > 0:
        points, weights = np.polynomial.legendre.leggauss(_NODES_ARC)
        return angle + 0.5 * span * points, weights / 2
    return np.array([angle]), np.ones(1)


def table_stimulus(run: Run, campaign: Campaign, injected: bool = False) -> Stimulus:
    """Return the stimulus of a run on a single-axis table; without a table the unit stands level and still."""
    table = campaign.tables[run.table] if run.table is not None else None
    azimuth, elevation = (table.azimuth, table.elevation) if table else (0.0, math.pi / 2)
    vertical = abs(abs(elevation) - math.pi / 2) < _VERTICAL_WITHIN
    whole_turn_nodes = _NODES_VERTICAL if vertical else _NODES_INCLINED
    angles, spans = run.covariates["table_angle"], run.covariates["table_angle_span"]
    per_row = [_angle_nodes(a, s, whole_turn_nodes) for a, s in zip(angles, spans, strict=True)]
    row = np.repeat(np.arange(run.rows), [len(nodes) for nodes, _ in per_row])
    angle = np.concatenate([nodes for nodes, _ in per_row])
    count = len(row)
    mounting = campaign.mountings[run.mounting].body_to_table if run.mounting is not None else np.eye(3)
    return Stimulus(
        row=row,
        weight=np.concatenate([weights for _, weights in per_row]),
        base=np.broadcast_to(table_to_local(azimuth, elevation), (count, 3, 3)),
        mounting=np.broadcast_to(mounting, (count, 3, 3)),
        table_angle=angle,
        table_rate=run.covariates["table_rate"][row],
        table_acceleration=np.zeros(count),
        ambient=ambient_of(run, row) | {"table_angle": angle},
        injected=injected,
        pose=np.full(count, -1),
    )


def ambient_of(run: Run, row: np.ndarray) -> dict[str, np.ndarray]:
    """Return the circumstances that the run recorded, at the given rows."""
    return {name: run.covariates[name][row] for name in AMBIENT_NAMES if name in run.covariates}
