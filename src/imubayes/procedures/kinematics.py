"""Nominal kinematics of a unit on a single-axis table: the nodes of a run, and the nominal input of a channel.

Table and mounting are taken as specified; their errors are effects.
"""

import math

import numpy as np

from imubayes.campaign_data import Campaign, Channel, Mounting, Run, Site, Table
from imubayes.earth import earth_rate
from imubayes.procedures.ambient import ambient_of
from imubayes.procedures.nominal_stimulus import Stimulus

# The mean over a turn is taken at equally spaced angles, exact for harmonics below their number.  About a vertical
# axis gravity along an input axis varies only with the tilt, so 4 nodes suffice for products up to the third order;
# about an inclined axis it varies by ±1 g, and powers up to the fifth times low harmonics must average out.
_NODES_VERTICAL, _NODES_INCLINED = 4, 12
_VERTICAL_WITHIN = math.radians(1.0)
# A partial turn is integrated by Gauss–Legendre quadrature: exact for polynomials of degree 9 over the arc.
_ARC_POINTS, _ARC_WEIGHTS = np.polynomial.legendre.leggauss(5)


def _angle_nodes(angle: float, span: float, whole_turn_nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the table angles and weights of the nodes of one row."""
    if math.isnan(angle):
        count = whole_turn_nodes
        return 2 * math.pi * np.arange(count) / count, np.full(count, 1 / count)
    if abs(span) > 0:
        return angle + 0.5 * span * _ARC_POINTS, _ARC_WEIGHTS / 2
    return np.array([angle]), np.ones(1)


def table_stimulus(run: Run, campaign: Campaign) -> Stimulus:
    """Return the stimulus of a run on a single-axis table; without a table the unit is level and at rest."""
    table = campaign.tables[run.table] if run.table is not None else None
    to_local = table.to_local if table else np.eye(3)
    vertical = abs(to_local[2, 2]) > math.cos(_VERTICAL_WITHIN)
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
        base=np.broadcast_to(to_local, (count, 3, 3)),
        mounting=np.broadcast_to(mounting, (count, 3, 3)),
        table_angle=angle,
        table_rate=run.covariates["table_rate"][row],
        table_acceleration=run.covariates.get("table_acceleration", np.zeros(run.rows))[row],
        reference_rate=np.zeros((count, 3)),
        reference_acceleration=np.zeros((count, 3)),
        ambient=ambient_of(run, row, campaign) | {"table_angle": angle},
        injected=False,
        pose=np.full(count, -1),
    )


def table_input(
    run: Run, channel: Channel, site: Site, table: Table | None, mounting: Mounting | None
) -> np.ndarray | None:
    """Return the nominal input of a channel on a table, rad/s or m/s², shape (R,); None without table or mounting."""
    if table is None or mounting is None:
        return None
    rate, angle = run.covariates["table_rate"], run.covariates["table_angle"]
    return nominal_input(channel, table, mounting, site, rate, angle)


def nominal_outputs(campaign: Campaign, run: Run) -> np.ndarray:
    """Return what an ideal unit would read in a run on a table, mean over each row, output units, shape (R, C)."""
    found = [channel.scale_si * mean_input(campaign, run, channel) + channel.offset for channel in campaign.channels]
    return np.stack(found, axis=1)


def mean_input(campaign: Campaign, run: Run, channel: Channel) -> np.ndarray:
    """Return the nominal input of a channel, mean over the arc of each row, rad/s or m/s², shape (R,).

    Over an arc s about an angle, a rotating vector is shortened by sin(s/2)/(s/2).
    """
    assert run.table is not None
    assert run.mounting is not None
    equipment = campaign.tables[run.table], campaign.mountings[run.mounting], campaign.site
    rate, angle = run.covariates["table_rate"], run.covariates["table_angle"]
    whole = nominal_input(channel, *equipment, rate, np.full(run.rows, np.nan))
    there = nominal_input(channel, *equipment, rate, angle)
    return whole + (there - whole) * np.sinc(run.covariates["table_angle_span"] / (2 * np.pi))


def nominal_input(
    channel: Channel, table: Table, mounting: Mounting, site: Site, rate: np.ndarray, angle: np.ndarray
) -> np.ndarray:
    """Return the nominal input of a channel in rad/s or m/s², shape (R,).

    Parameters
    ----------
    rate, angle : of the table, rad/s and rad; NaN angles denote means over whole turns.
    """
    to_level = table.to_local
    local = earth_rate(site.latitude) if channel.kind == "gyro" else np.array([0.0, 0.0, site.gravity])
    fixed = to_level.T @ local
    cosine, sine = (np.where(np.isnan(angle), 0.0, f(np.nan_to_num(angle))) for f in (np.cos, np.sin))
    in_table = np.stack(
        [cosine * fixed[0] + sine * fixed[1], cosine * fixed[1] - sine * fixed[0], np.full_like(rate, fixed[2])], axis=1
    )
    if channel.kind == "gyro":
        in_table[:, 2] += rate
    return in_table @ mounting.body_to_table @ channel.axes[0]
