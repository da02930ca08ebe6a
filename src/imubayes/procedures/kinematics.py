"""Nominal kinematics of a unit on a table or a centrifuge: nodes and stimulus of a run, input of a channel.

NumPy only, so that reading campaigns does not import JAX.  Table and mounting are taken as specified; their errors are
effects.  A table may have one axis or several.

On a table of several axes, or on a centrifuge, the outer axis carries the middle one, that the inner one, and that the
unit.  With e_k the unit vector of axis k, Ω_k the rotation of its frame against the Earth and d_k the distance to the
next axis, fixed in that frame,

    Ω_k = Σ_{j ≤ k} φ̇_j e_j,   Ω̇_k = Σ_{j ≤ k} (φ̈_j e_j + Ω_{j−1} × φ̇_j e_j),
    f = g + Σ_k (Ω_k × (Ω_k × d_k) + Ω̇_k × d_k + 2 ω_E × (Ω_k × d_k)),

exact for any simultaneous rotation: the last term is the Coriolis acceleration, 12 ppm of the centripetal one at 10
rad/s.  The axes of a row turn at constant rates about their angles at the middle of the row.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imubayes.foundations.campaign_data import Campaign, Channel, Mounting, Run, Site, Table
from imubayes.foundations.earth import earth_rate
from imubayes.foundations.errors import input_error
from imubayes.foundations.numerics import gauss_legendre
from imubayes.procedures.ambient import ambient_of
from imubayes.procedures.followed_rows import arc_slopes, followed, followed_nodes


@dataclass(frozen=True)
class OuterMotion:
    """The outer and the middle axis of a table at the nodes of a run, in SI; an axis that it lacks stands still.

    Attributes
    ----------
    links : shape (n, 2, 3, 3), nominal `imubayes.foundations.campaign_data.Table.links`.
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
class CarriedNodes:
    """Motion of a unit that is carried, at the nodes of a run, by its nominal gyros.

    Attributes
    ----------
    turn : shape (n, 3, 3), body at the node → body in its pose.
    elapsed : shape (n,), time since its pose, s.
    rate, acceleration : shape (n, 3), body axes, rad/s and rad/s².
    carried : shape (n,), 1 where the unit is carried, else 0.
    transition, step, back : shape (n,), where the node is in the transitions of its run, as in `Tumble`.
    """

    turn: np.ndarray
    elapsed: np.ndarray
    rate: np.ndarray
    acceleration: np.ndarray
    carried: np.ndarray
    transition: np.ndarray
    step: np.ndarray
    back: np.ndarray

    @staticmethod
    def none(count: int) -> "CarriedNodes":
        """Return the motion of a unit that is not carried, at some number of nodes."""
        zero, places = np.zeros((count, 3)), np.zeros(count, dtype=int)
        eye = np.broadcast_to(np.eye(3), (count, 3, 3))
        return CarriedNodes(
            eye, np.zeros(count), zero, zero, np.zeros(count), places, places, np.zeros(count, dtype=bool)
        )


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
    pose : shape (n,), static pose of a free tumble, else −1.
    injected : whether a current replaces the sensor at the converter input.
    driven : whether a gyro drives the table.
    directed : whether the attitude is set by directions of the site, north and the vertical.
    unstated : what nobody stated of where the unit was put (`Campaign.unstated`).
    outer : the axes that carry the table's inner one, whose frame at angle 0 is then no longer `base`; None if
        there are none.
    hand : motion since its pose of a unit that is carried; None if it is not.
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
    pose: np.ndarray
    injected: bool = False
    driven: bool = False
    directed: bool = False
    unstated: frozenset[str] = frozenset()
    outer: OuterMotion | None = None
    hand: CarriedNodes | None = None

    @property
    def referenced(self) -> bool:
        """Whether a reference gyro measures the rate."""
        return bool(np.any(self.reference_rate != 0))

    @property
    def supplies(self) -> frozenset[str]:
        """Names of what this run recorded, and of what happens in it."""
        # Between the poses of a free tumble the unit is turned by hand.
        carried = self.outer is not None and bool(np.any(self.outer.rate != 0))
        accelerations = [self.table_acceleration, self.reference_acceleration]
        accelerations += [self.outer.acceleration] if self.outer is not None else []
        if self.hand is not None:
            accelerations.append(self.hand.acceleration)
        told = {
            "hand": self.hand is not None,
            "carried": self.hand is not None and bool(np.any(self.hand.carried > 0)),
            "posed": self.hand is None and bool(np.any(self.pose >= 0)),
            "turning": bool(np.any(self.table_rate != 0) or np.any(self.pose >= 0)) or self.referenced or carried,
            "acceleration": any(np.any(values != 0) for values in accelerations),
            "reference": self.referenced,
            "injection": self.injected,
            "driven": self.driven,
            "directions": self.directed,
        }
        unstated = frozenset() if self.referenced else self.unstated
        return frozenset({*self.ambient, *(name for name, there in told.items() if there)}) | unstated


# The mean over a turn is taken at equally spaced angles, exact for harmonics below their number.  About a vertical
# axis gravity along an input axis varies only with the tilt, so 4 nodes suffice for products up to the third order;
# about an inclined axis it varies by ±1 g, and powers up to the fifth times low harmonics must average out.
_NODES_VERTICAL, _NODES_INCLINED = 4, 12
_VERTICAL_WITHIN = math.radians(1.0)
# A partial turn is integrated by Gauss–Legendre quadrature: exact for polynomials of degree 9 over the arc.
_ARC_POINTS, _ARC_WEIGHTS = gauss_legendre(5)
_NO_NODES = np.zeros(0)


def _angle_nodes(angle: float, span: float, whole_turn_nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the table angles and weights of the nodes of one row."""
    if math.isnan(angle):
        count = whole_turn_nodes
        return 2 * math.pi * np.arange(count) / count, np.full(count, 1 / count)
    if abs(span) > 0:
        return angle + 0.5 * span * _ARC_POINTS, _ARC_WEIGHTS / 2
    return np.array([angle]), np.ones(1)


def at_rest(
    run: Run, campaign: Campaign | None, weights: Sequence[np.ndarray], base: np.ndarray, mounting: np.ndarray
) -> Stimulus:
    """Return the stimulus of a run in which nothing turns.

    Parameters
    ----------
    weights : of the nodes of each row.
    base, mounting : of the run, shape (3, 3), or of each node.
    """
    row = np.repeat(np.arange(run.rows), [len(weight) for weight in weights])
    count = len(row)
    zero, vectors = np.zeros(count), np.zeros((count, 3))
    return Stimulus(
        row, np.concatenate(weights), np.broadcast_to(base, (count, 3, 3)), np.broadcast_to(mounting, (count, 3, 3)),
        table_angle=zero, table_rate=zero, table_acceleration=zero, reference_rate=vectors,
        reference_acceleration=vectors, ambient=ambient_of(run, row, campaign), pose=np.full(count, -1),
    )  # fmt: skip


def table_stimulus(run: Run, campaign: Campaign) -> Stimulus:
    """Return the stimulus of a run on a single-axis table; without a table the unit is level and at rest."""
    table = campaign.tables[run.table] if run.table is not None else None
    to_local = table.to_local if table else np.eye(3)
    vertical = abs(to_local[2, 2]) > math.cos(_VERTICAL_WITHIN)
    whole_turn_nodes = _NODES_VERTICAL if vertical else _NODES_INCLINED
    mounting = campaign.mountings[run.mounting].body_to_table if run.mounting is not None else np.eye(3)
    moves = followed(run)
    rows = zip(run.covariates["table_angle"], run.covariates["table_angle_span"], moves.tolist(), strict=True)
    per_row = [(_NO_NODES, _NO_NODES) if moving else _angle_nodes(a, s, whole_turn_nodes) for a, s, moving in rows]
    still = at_rest(run, campaign, [weights for _, weights in per_row], to_local, mounting)
    angle = np.concatenate([nodes for nodes, _ in per_row])
    constant = replace(
        still,
        table_angle=angle,
        table_rate=run.covariates["table_rate"][still.row],
        table_acceleration=run.covariates.get("table_acceleration", np.zeros(run.rows))[still.row],
        ambient=still.ambient | {"table_angle": angle},
    )
    return _with_motion(constant, run, campaign, to_local, mounting) if moves.any() else constant


def _with_motion(
    constant: Stimulus, run: Run, campaign: Campaign, to_local: np.ndarray, mounting: np.ndarray
) -> Stimulus:
    """Return the stimulus with the rows in which the angle of the table is followed."""
    nodes = followed_nodes(run)
    weights = np.split(nodes.weight, np.flatnonzero(np.diff(nodes.row)) + 1)
    per_row = dict(zip(np.unique(nodes.row).tolist(), weights, strict=True))
    moved = at_rest(run, campaign, [per_row.get(row, _NO_NODES) for row in range(run.rows)], to_local, mounting)
    ambient = moved.ambient | nodes.ambient | {"table_angle": nodes.angle, "table_rate": nodes.rate}
    still = np.zeros(len(constant.row))
    # A rotating vector changes within a row of constant rate as well, unless it is a mean over whole turns.
    held = (
        constant.ambient
        | dict.fromkeys(nodes.ambient, still)
        | arc_slopes(run, constant.row, _ARC_POINTS / 2, _ARC_WEIGHTS / 2)
    )
    joined = {
        name: np.concatenate([getattr(constant, name), getattr(moved, name)])
        for name in ("row", "weight", "base", "mounting", "reference_rate", "reference_acceleration", "pose")
    }
    return replace(
        constant,
        **joined,
        table_angle=np.concatenate([constant.table_angle, nodes.angle]),
        table_rate=np.concatenate([constant.table_rate, nodes.rate]),
        table_acceleration=np.concatenate([constant.table_acceleration, nodes.acceleration]),
        ambient={name: np.concatenate([held.get(name, still), values]) for name, values in ambient.items()},
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
    local = earth_rate(site.latitude) if channel.kind == "gyro" else np.array([0.0, 0.0, site.gravity])
    in_table = turned_back(table.to_local.T @ local, np.nan_to_num(angle), np.where(np.isnan(angle), 0.0, 1.0))
    if channel.kind == "gyro":
        in_table[2] += rate
    return in_table.T @ mounting.body_to_table @ channel.axes[0]


def turned_back(vector: np.ndarray, angle: np.ndarray, short: float | np.ndarray = 1.0) -> np.ndarray:
    """Return a vector of the table at angle 0 in axes that turn with the table, shape (3, n).

    Parameters
    ----------
    angle : of the table, rad, shape (n,).
    short : by which the part across the axis is shortened in a mean over an arc; 0 over whole turns.
    """
    (x, y, z), c, s = vector, short * np.cos(angle), short * np.sin(angle)
    return np.stack([c * x + s * y, c * y - s * x, np.full_like(c, z)])


AXES = ("outer", "middle", "table")
"""Covariates of the axes begin with these, from the outer to the inner one."""
# Whole turns at equally spaced angles are exact for harmonics below the number of nodes; squares and cubes of what
# turns with the axes have three, and those of harmonics of an axis a few more.  A partial turn is integrated by
# Gauss–Legendre quadrature, exact to rounding with as many nodes per turn and five more.
_NODES_PER_TURN, _FURTHER_NODES = 12, 5
_WHOLE = 1e-6


def serial_stimulus(run: Run, campaign: Campaign) -> Stimulus:
    """Return the stimulus of a run on a table of several axes.

    Raises
    ------
    InputError
        if the table states no inner axis, or two axes turn at unknown angles.
    """
    assert run.table is not None
    assert run.mounting is not None
    return _stimulus(run, campaign.tables[run.table], campaign.mountings[run.mounting], campaign)


def serial_input(
    run: Run, channel: Channel, site: Site, table: Table | None, mounting: Mounting | None
) -> np.ndarray | None:
    """Return the nominal input of a channel, mean over each row, rad/s or m/s², (R,); None without equipment."""
    if table is None or mounting is None:
        return None
    stimulus = _stimulus(run, table, mounting)
    rate, force = felt(stimulus, site)
    return row_means(stimulus, (rate if channel.kind == "gyro" else force) @ channel.axes[0])


def row_means(stimulus: Stimulus, values: np.ndarray) -> np.ndarray:
    """Return the means over rows of values at nodes, (n, …) → (R, …)."""
    found = np.zeros((int(stimulus.row.max(initial=-1)) + 1, *values.shape[1:]))
    np.add.at(found, stimulus.row, values * stimulus.weight.reshape(-1, *[1] * (values.ndim - 1)))
    return found


def _stimulus(run: Run, table: Table, mounting: Mounting, campaign: Campaign | None = None) -> Stimulus:
    if table.inner_axis is None:
        raise input_error(
            f"table '{table.name}' of run '{run.name}' states no inner axis",
            f"campaign.toml, table '{table.name}', key 'inner_axis'",
            "the direction at zero angles, in axes with z along the outer axis, such as [0, 0, 1]",
            "state the directions of the axes: inner_axis, and middle_axis of a table of three axes",
        )
    rate = axis_columns(run, "rate", 0.0)
    per_row = [row_path(*row) for row in zip(axis_angles(run), rate, axis_columns(run, "angle_span", 0.0), strict=True)]
    weights = [weight for _, weight in per_row]
    still = at_rest(run, campaign, weights, table.outer_to_local, mounting.body_to_table)
    angle, count = np.concatenate([path for path, _ in per_row]), len(still.row)
    rate, acceleration = (each[still.row] for each in (rate, axis_columns(run, "acceleration", 0.0)))
    links, arms = (
        np.broadcast_to(each, (count, *each.shape))
        for each in (table.links, np.array([[table.arm, 0.0, 0.0], [0.0, 0.0, 0.0]]))
    )
    there = [axis for axis in AXES if axis != "middle" or table.middle_axis is not None]
    return replace(
        still,
        table_angle=angle[:, 2],
        table_rate=rate[:, 2],
        table_acceleration=acceleration[:, 2],
        ambient=still.ambient | {f"{axis}_angle": angle[:, AXES.index(axis)] for axis in there},
        outer=OuterMotion(links, arms, angle[:, :2], rate[:, :2], acceleration[:, :2]),
    )


def axis_columns(run: Run, quantity: str, missing: float) -> np.ndarray:
    """Return a quantity of the three axes, (R, 3), with a value for what is not recorded."""
    absent = np.full(run.rows, missing)
    return np.stack([run.covariates.get(f"{axis}_{quantity}", absent) for axis in AXES], axis=1)


def axis_angles(run: Run) -> np.ndarray:
    """Return the angles of the axes, (R, 3): 0 where an axis at rest has none, NaN where it makes whole turns."""
    angle, turning = axis_columns(run, "angle", math.nan), axis_columns(run, "rate", 0.0) != 0
    unknown = np.isnan(angle) & turning
    if np.any(unknown.sum(axis=1) > 1):
        row = int(np.argmax(unknown.sum(axis=1) > 1))
        raise input_error(
            f"row {row + 1} of run '{run.name}' turns about two axes whose angles are both unknown",
            f"run '{run.name}', columns {', '.join(f'{axis}_angle_deg' for axis in AXES)}",
            "the angle of each turning axis at the middle of the row; of one at most empty, for whole turns",
            "record the angles, or turn about one axis at a time",
        )
    return np.where(np.isnan(angle) & ~turning, 0.0, angle)


def row_path(angle: np.ndarray, rate: np.ndarray, span: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return angles (k, 3) and weights (k,) of the nodes of one row; all arguments have shape (3,).

    An axis of unknown angle makes a whole turn from 0; if it has angle 0, axes that turn along have their own.
    """
    unknown = np.isnan(angle)
    span = np.where(np.isnan(span), 0.0, np.abs(span))
    if unknown.any():
        along = 2 * math.pi * np.abs(rate / rate[unknown][0])
        span = np.where(unknown, 2 * math.pi, np.where(rate != 0, along, 0.0))
    swept = np.sign(rate) * np.where(rate != 0, span, 0.0)
    turns = np.abs(swept).sum() / (2 * math.pi)
    middle = np.where(unknown, 0.0, angle)
    if turns == 0:
        return middle[None, :], np.ones(1)
    each = np.abs(swept) / (2 * math.pi)
    if np.all(np.abs(each - np.round(each)) < _WHOLE):
        count = _NODES_PER_TURN * max(1, round(turns))
        share, weight = np.arange(count) / count, np.full(count, 1 / count)
    else:
        count = _FURTHER_NODES + math.ceil(_NODES_PER_TURN * turns)
        share, weight = (part / 2 for part in gauss_legendre(count))
    return middle + share[:, None] * swept, weight


def rotation_matrices(vectors: np.ndarray) -> np.ndarray:
    """Return the rotations by vectors, (n, 3) rad → (n, 3, 3), by Rodrigues' formula."""
    angle = np.linalg.norm(vectors, axis=1)
    x, y, z = (vectors / np.where(angle == 0, 1.0, angle)[:, None]).T
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    sine, rest = np.sin(angle)[:, None, None], 1 - np.cos(angle)[:, None, None]
    return np.eye(3) + sine * cross + rest * (cross @ cross)


def about_z(angle: np.ndarray) -> np.ndarray:
    """Return rotations about z, (n,) → (n, 3, 3)."""
    c, s, zero, one = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    return np.stack([c, -s, zero, s, c, zero, zero, zero, one], axis=1).reshape(-1, 3, 3)


def turning_rate(stimulus: Stimulus) -> np.ndarray:
    """Return the nominal rate of the body against the Earth, body axes, rad/s, shape (n, 3)."""
    if stimulus.outer is None:
        return stimulus.mounting[:, 2] * stimulus.table_rate[:, None]
    still = replace(stimulus, base=np.broadcast_to(np.eye(3), stimulus.base.shape))
    return _felt(still, np.zeros(3), np.zeros(3))[0]


def felt(stimulus: Stimulus, site: Site) -> tuple[np.ndarray, np.ndarray]:
    """Return inertial rate (rad/s) and specific force (m/s²) of the unit at every node, body axes, (n, 3) each."""
    return _felt(stimulus, earth_rate(site.latitude), np.array([0.0, 0.0, site.gravity]))


def _felt(stimulus: Stimulus, earth: np.ndarray, gravity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    outer = stimulus.outer
    assert outer is not None
    count = len(stimulus.row)
    # All vectors in the frame that turns with the axis at hand; `rate`, `faster` are Ω_k and Ω̇_k.
    earth_here, force = (np.einsum("j,nji->ni", vector, stimulus.base) for vector in (earth, gravity))
    rate, faster, z = np.zeros((count, 3)), np.zeros((count, 3)), np.array([0.0, 0.0, 1.0])
    turns = [(outer.angle[:, k], outer.rate[:, k], outer.acceleration[:, k]) for k in range(2)]
    turns.append((stimulus.table_angle, stimulus.table_rate, stimulus.table_acceleration))
    onward = [outer.links[:, 0], outer.links[:, 1], stimulus.mounting]
    arms = [outer.arms[:, 0], outer.arms[:, 1], np.zeros((count, 3))]
    for (angle, speed, growth), link, arm in zip(turns, onward, arms, strict=True):
        faster = faster + growth[:, None] * z + np.cross(rate, speed[:, None] * z)
        rate = rate + speed[:, None] * z
        turned = about_z(angle)
        here = [np.einsum("nji,nj->ni", turned, vector) for vector in (earth_here, force, rate, faster)]
        velocity = np.cross(here[2], arm)
        here[1] = here[1] + np.cross(here[2], velocity) + np.cross(here[3], arm) + 2 * np.cross(here[0], velocity)
        earth_here, force, rate, faster = (np.einsum("nji,nj->ni", link, vector) for vector in here)
    return rate + earth_here, force
