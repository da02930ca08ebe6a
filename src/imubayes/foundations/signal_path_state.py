"""The state of the signal path, from the table's motion down to one channel's signal.

The forward model is evaluated at *nodes*: instants at which the stimulus is known.  A recorded row is a mean over
an interval, so a row owns one node when nothing moved and several, with weights, when the table turned meanwhile.
A procedure turns a run into a `Stimulus` (`imubayes.procedures.kinematics`, NumPy alone); the classes here are
each written for one node, and batched by vmap.
"""

import equinox as eqx
import jax

from imubayes.foundations.arrays import Array, Bool, Float, Int, Matrices, Scalars, Vectors
from imubayes.foundations.covariates import ambient_names


class Ambient(eqx.Module):
    """The covariates of one instant that effects see, in SI: `ambient.temperature` and so on.

    A covariate that the run does not carry is 0 here.  An effect that needs it does not act on that run, and cannot be
    bound if the covariate has some value in spite of that (`Covariate.absent`).

    Examples
    --------
    >>> import jax.numpy as jnp
    >>> import imubayes
    >>> warm = imubayes.Ambient(temperature=jnp.array(55.0))
    >>> warm.updated(temperature=jnp.array(25.0)).temperature.item()
    25.0
    """

    values: dict[str, Scalars]

    def __init__(self, **values: Scalars):
        self.values = values

    def __getattr__(self, name: str) -> Scalars:
        if name == "values" or name not in self.values:
            raise AttributeError(f"no covariate '{name}' that effects see: {', '.join(ambient_names())}")
        return self.values[name]

    def updated(self, **values: Scalars) -> "Ambient":
        """Return the covariates with some values replaced."""
        return Ambient(**self.values | values)


class OuterAxes(eqx.Module):
    """The outer and the middle axis of a table, in this order; one that a table lacks stands still.

    Each axis has a frame with z along it that turns with it.

    Attributes
    ----------
    link : shape (2, 3, 3), from the frame of the next axis at angle 0 to that of this one.
    arm : shape (2, 3), from this axis to the next, in the frame of this one, m.
    angle, rate, acceleration : shape (2,); rad, rad/s, rad/s².
    """

    link: Float[Array, "*batch 2 3 3"]
    arm: Float[Array, "*batch 2 3"]
    angle: Float[Array, "*batch 2"]
    rate: Float[Array, "*batch 2"]
    acceleration: Float[Array, "*batch 2"]


class HandMotion(eqx.Module):
    """How a unit that is carried by hand has moved since its pose, at one instant.

    Attributes
    ----------
    turn : body at the instant → body in the pose, the product of the rotations that the gyros saw.
    elapsed : time since the pose, s; negative before it.
    rate : inertial rate of the body as its gyros saw it, rad/s, body axes.
    acceleration : its derivative, rad/s².
    carried : 1 if the unit is carried; 0 if it stands on a table, and all else is the identity or 0.
    """

    turn: Matrices
    elapsed: Scalars
    rate: Vectors
    acceleration: Vectors
    carried: Scalars


class Motion(eqx.Module):
    """Attitude and rotation of the unit at one instant.

    Attributes
    ----------
    base : rotation from the table at angle 0 to the local level n, shape (3, 3).
    mounting : rotation from body to table, shape (3, 3).
    table_angle, table_rate, table_acceleration : of the table about its axis; rad, rad/s, rad/s².
    reference_rate, reference_acceleration : inertial rotation that a reference gyro measured, in body axes, rad/s and
        rad/s²; zero if there is none.
    gravity : specific force of a body at rest, in n, m/s².
    earth_rate : the Earth's rotation in n, rad/s; zero if the reference has measured it along.
    outer : the axes that carry the inner one, with `base` the frame of the outer one at angle 0; None if no run has
        any.
    hand : motion since the pose of a unit that is carried; None if no run has any.

    Examples
    --------
    >>> import imubayes
    >>> [name for name in imubayes.Motion.__dataclass_fields__ if name.startswith("table")]
    ['table_angle', 'table_rate', 'table_acceleration']
    """

    base: Matrices
    mounting: Matrices
    table_angle: Scalars
    table_rate: Scalars
    table_acceleration: Scalars
    reference_rate: Vectors
    reference_acceleration: Vectors
    gravity: Vectors
    earth_rate: Vectors
    outer: OuterAxes | None = None
    hand: HandMotion | None = None


class Records(eqx.Module):
    """All N nodes in the order in which they were passed, run after run: what an effect with memory looks back on.

    Attributes
    ----------
    node : shape (N,), the node at each place of this order.
    place : shape (n,), the place in this order of each node of a path; a path may hold chosen nodes alone.
    begins : shape (N,), whether a run begins here.
    seconds : shape (N,), since the place before, 0 if a run begins or has no time.
    ambient : circumstances, in this order.
    """

    node: Int[Array, " N"]
    place: Int[Array, " n"]
    begins: Bool[Array, " N"]
    seconds: Float[Array, " N"]
    ambient: Ambient

    def at(self, chosen: Array) -> "Records":
        """Return the same records for a path of chosen nodes."""
        return Records(self.node, self.place[chosen], self.begins, self.seconds, self.ambient)


class Nodes(eqx.Module):
    """The nodes of all runs, one after the other.

    The quantities that are constant over a run or pose, its *stand*, are kept once: S stands serve N nodes, and the
    rotations of table and mounting are worked out once for each of them.

    Attributes
    ----------
    stands : nominal motion of each stand, at rest at angle 0.
    stand_ambient : circumstances at the first node of each stand.
    stand : shape (N,), the stand of each node.
    table_angle, table_rate, table_acceleration : shape (N,).
    reference_rate, reference_acceleration : shape (N, 3).
    ambient : circumstances of each node.
    injected : shape (N,), 1 where a current is injected.
    records : the nodes in the order of time.
    outer : the axes that carry the inner one, leaves (N, …); None if no run has any.
    hand : motion since the pose, leaves (N, …), by the nominal gyros; None if no unit is carried.
    """

    stands: Motion
    stand_ambient: Ambient
    stand: Int[Array, " N"]
    table_angle: Float[Array, " N"]
    table_rate: Float[Array, " N"]
    table_acceleration: Float[Array, " N"]
    reference_rate: Float[Array, "N 3"]
    reference_acceleration: Float[Array, "N 3"]
    ambient: Ambient
    injected: Float[Array, " N"]
    records: Records
    outer: OuterAxes | None = None
    hand: HandMotion | None = None

    def at(self, chosen: Array) -> "Nodes":
        """Return chosen nodes, with all stands."""
        common = ("stands", "stand_ambient", "records")
        of_nodes = {name: value for name, value in vars(self).items() if name not in common}
        of_chosen = jax.tree.map(lambda leaf: leaf[chosen], of_nodes)
        return Nodes(self.stands, self.stand_ambient, records=self.records.at(chosen), **of_chosen)


class Experience(eqx.Module):
    """Motion and specific force at the place of one channel, in body axes; vectors have the shape (3,).

    `rate` is inertial (rad/s), `force` the specific force (m/s²); `table_rate` and `table_acceleration` are the
    table's rotation, which moves a point off the axis; `north` and `up` are unit vectors of the local level,
    zero if the attitude of the unit is unknown.

    Examples
    --------
    >>> import jax.numpy as jnp
    >>> import imubayes
    >>> still, up = jnp.zeros(3), jnp.array([0.0, 0.0, 1.0])
    >>> at_rest = imubayes.Experience(still, 9.81 * up, still, still, jnp.array([0.0, 1.0, 0.0]), up)
    >>> at_rest.force[2].item()
    9.81
    """

    rate: Vectors
    force: Vectors
    table_rate: Vectors
    table_acceleration: Vectors
    north: Vectors
    up: Vectors


class Sample(eqx.Module):
    """Motion and specific force along the nominal (I, O, S) axes of one channel, shape (3,) each, with the covariates.

    `acceleration` is angular, of the table; the other vectors are those of `Experience`.
    `output_scale` is the channel's nominal scale, output units per rad/s or m/s².

    Examples
    --------
    >>> import imubayes
    >>> list(imubayes.Sample.__dataclass_fields__)
    ['rate', 'force', 'acceleration', 'north', 'up', 'ambient', 'output_scale']
    """

    rate: Vectors
    force: Vectors
    acceleration: Vectors
    north: Vectors
    up: Vectors
    ambient: Ambient
    output_scale: Scalars


class SignalPath(eqx.Module):
    """What travels along the path: filled in from left to right as the stages are passed.

    Leading axes are stands, then nodes for `motion` and `ambient`, nodes × channels for the others, which are kept
    per kind of channel.  `signal` is input-referred in SI up to the converter, and in output units from there on.
    `nodes` are those that the stands are spread over, `records` what effects with memory look back on: None
    if the unit has been as it is for ever.
    """

    motion: Motion
    ambient: Ambient
    experience: dict[str, Experience]
    sample: dict[str, Sample]
    signal: dict[str, Float[Array, "N C"]]
    nodes: Nodes | None = None
    records: Records | None = None
