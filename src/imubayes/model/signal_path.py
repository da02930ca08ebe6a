"""The signal path: one loop over layers, from the motion of the table to the output of every channel.

A layer is an effect together with the places of its values in the parameter vector, or one of five junctions that every
path has: `Broadcast` (the stand of a run → its nodes), `Resolve` (motion → rate, force in body axes), `Project` (body →
channel axes, where the signal starts), `Convert` (SI → output units; an injected current takes the sensor's place) and
`AddOffset` (the nominal offset).  There is no case per kind of run and none per effect.

The axes that carry a table's inner one decide where its frame is, and what acts there.  Their formulas are those of
`imubayes.procedures.kinematics`, here with the errors of the axes in them.
"""

import math
from abc import abstractmethod
from collections.abc import Sequence
from functools import partial
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from imubayes.effects.base import Effect, Stage
from imubayes.foundations import arrays
from imubayes.foundations.arrays import Array, Float, Matrix3, Vector3
from imubayes.foundations.signal_path_state import Ambient, Experience, HandMotion, Motion, Nodes, Sample, SignalPath


class Carried(eqx.Module):
    """What the outer axes make of the frame that the inner axis starts from.

    Attributes
    ----------
    to_local : C of that frame to the local level.
    rate, acceleration : its rotation against the Earth, rad/s and rad/s², in that frame.
    force : specific force of a point on the inner axis, m/s², in that frame.
    """

    to_local: Matrix3
    rate: Vector3
    acceleration: Vector3
    force: Vector3


def carried(motion: Motion) -> Carried:
    """Return what the outer axes make of the frame of the inner axis."""
    outer = motion.outer
    if outer is None:
        still = jnp.zeros(3)
        return Carried(motion.base, still, still, arrays.rotate_back(motion.base, motion.gravity))
    z, frame = jnp.array([0.0, 0.0, 1.0]), motion.base
    rate = acceleration = jnp.zeros(3)
    force = arrays.rotate_back(frame, motion.gravity)
    for place in range(2):
        speed = outer.rate[place] * z
        acceleration = acceleration + outer.acceleration[place] * z + arrays.cross(rate, speed)
        turn = arrays.exponential(outer.angle[place] * z)
        rate, acceleration, force = (arrays.rotate_back(turn, v) for v in (rate + speed, acceleration, force))
        frame = arrays.compose(frame, turn)
        velocity = arrays.cross(rate, outer.arm[place])
        coriolis = 2 * arrays.cross(arrays.rotate_back(frame, motion.earth_rate), velocity)
        force = force + arrays.cross(rate, velocity) + arrays.cross(acceleration, outer.arm[place]) + coriolis
        link = outer.link[place]
        frame = arrays.compose(frame, link)
        rate, acceleration, force = (arrays.rotate_back(link, v) for v in (rate, acceleration, force))
    return Carried(frame, rate, acceleration, force)


class Channels(eqx.Module):
    """Constants of all channels of one kind (C of them).

    Attributes
    ----------
    axes : shape (C, 3, 3), rows I, O, S in body axes.
    scale : shape (C,), nominal output units per rad/s or m/s².
    offset : shape (C,), output units.
    current_per_acceleration : shape (C,), A per m/s²; infinite if the channel has no current output.
    """

    axes: Float[Array, "C 3 3"]
    scale: Float[Array, " C"]
    offset: Float[Array, " C"]
    current_per_acceleration: Float[Array, " C"]


class Layer(eqx.Module):
    """One step of the signal path; a junction stands at the end of the stage that it closes."""

    closes: ClassVar[Stage]

    def sort_key(self) -> tuple[int, float]:
        """Return stage and order: layers are passed in the order of these."""
        return self.closes, math.inf

    def value_places(self) -> dict[str, Array]:
        """Return the indices of the values that the step needs, by field."""
        return {}

    @abstractmethod
    def __call__(self, path: SignalPath, chosen: dict[str, Array]) -> SignalPath:
        """Return the path after this step; `chosen` are the values at its `value_places`, by field."""


class EffectLayer(Layer):
    """An effect with the places of its values.

    Attributes
    ----------
    effect : the class.
    options : fixed settings of the effect.
    places : field → integer array (1 or N, 1 or C) of places in the values; null values for channels and nodes that
        the effect does not touch.
    kind : kind of channel it acts on, empty for effects on the motion.
    """

    effect: type[Effect] = eqx.field(static=True)
    options: tuple[tuple[str, float], ...] = eqx.field(static=True)
    places: dict[str, Array]
    kind: str = eqx.field(static=True)

    def sort_key(self) -> tuple[int, float]:
        return self.effect.stage, self.effect.order

    def value_places(self) -> dict[str, Array]:
        return self.places

    def __call__(self, path, chosen):
        options = dict(self.options)
        return self.effect.advance(lambda values: self.effect(**values, **options), chosen, path, self.kind)


class Broadcast(Layer):
    """From stands to nodes: each node gets the table and mounting of its stand, and its own angle and rate."""

    closes: ClassVar[Stage] = Stage.STAND

    def __call__(self, path, chosen):
        at, stand = path.nodes, path.motion
        assert at is not None
        motion = Motion(
            base=arrays.take(stand.base, at.stand),
            mounting=arrays.take(stand.mounting, at.stand),
            table_angle=at.table_angle,
            table_rate=at.table_rate,
            table_acceleration=at.table_acceleration,
            reference_rate=at.reference_rate,
            reference_acceleration=at.reference_acceleration,
            gravity=arrays.take(stand.gravity, at.stand),
            earth_rate=arrays.take(stand.earth_rate, at.stand),
            outer=at.outer,
            hand=at.hand,
        )
        return eqx.tree_at(lambda p: (p.motion, p.ambient), path, (motion, at.ambient))


class Resolve(Layer):
    """From the motion to what acts on the body, for every channel alike."""

    counts: tuple[tuple[str, int], ...] = eqx.field(static=True)
    closes: ClassVar[Stage] = Stage.TABLE

    def __call__(self, path, chosen):
        body = jax.vmap(on_body)(path.motion)
        experience = {
            kind: jax.tree.map(lambda leaf, count=count: jnp.broadcast_to(leaf[:, None], (len(leaf), count, 3)), body)
            for kind, count in self.counts
        }
        return eqx.tree_at(lambda p: p.experience, path, experience)


class Project(Layer):
    """From body axes to each channel's own: here the signal starts."""

    channels: dict[str, Channels]
    closes: ClassVar[Stage] = Stage.PLACE

    def __call__(self, path, chosen):
        sample = {
            kind: jax.vmap(jax.vmap(project, (0, 0, None)), (None, 0, 0))(
                channels.axes, path.experience[kind], path.ambient
            )
            for kind, channels in self.channels.items()
        }
        sample = {
            kind: eqx.tree_at(
                lambda s: s.output_scale,
                sample[kind],
                jnp.broadcast_to(channels.scale, sample[kind].output_scale.shape),
            )
            for kind, channels in self.channels.items()
        }
        first = {"gyro": lambda s: s.rate[..., 0], "accelerometer": lambda s: s.force[..., 0]}
        signal = {kind: first[kind](sample[kind]) for kind in self.channels}
        return eqx.tree_at(lambda p: (p.sample, p.signal), path, (sample, signal))


class Convert(Layer):
    """From SI to output units; if a current is injected it stands for the sensor's own."""

    channels: dict[str, Channels]
    injected: Float[Array, " N"]
    closes: ClassVar[Stage] = Stage.SENSOR

    def __call__(self, path, chosen):
        def converted(signal, channels):
            equivalent = path.ambient.current[:, None] / channels.current_per_acceleration[None, :]
            return channels.scale[None, :] * jnp.where(self.injected[:, None] > 0, equivalent, signal)

        signal = {kind: converted(path.signal[kind], channels) for kind, channels in self.channels.items()}
        return eqx.tree_at(lambda p: p.signal, path, signal)


class AddOffset(Layer):
    """The nominal offset."""

    channels: dict[str, Channels]
    closes: ClassVar[Stage] = Stage.CONVERTER

    def __call__(self, path, chosen):
        signal = {kind: path.signal[kind] + channels.offset[None, :] for kind, channels in self.channels.items()}
        return eqx.tree_at(lambda p: p.signal, path, signal)


@partial(jax.jit, inline=True)  # traced once for all that call it
def on_body(motion: Motion) -> Experience:
    """Return what acts on a body that moves like this, in body axes."""
    axis, frame = motion.mounting[2], carried(motion)
    turning = axis * motion.table_rate + motion.reference_rate
    faster = axis * motion.table_acceleration + motion.reference_acceleration
    if motion.outer is not None:
        own = motion.table_rate * jnp.array([0.0, 0.0, 1.0])
        turning = turning + into_body(motion, frame.rate)
        faster = faster + into_body(motion, frame.acceleration + arrays.cross(frame.rate, own))
    if motion.hand is not None:
        return _carried_on(motion, motion.hand, frame, turning, faster)
    return Experience(
        rate=turning + into_body(motion, arrays.rotate_back(frame.to_local, motion.earth_rate)),
        force=into_body(motion, frame.force),
        table_rate=turning,
        table_acceleration=faster,
        north=into_body(motion, arrays.rotate_back(frame.to_local, jnp.array([0.0, 1.0, 0.0]))),
        up=into_body(motion, arrays.rotate_back(frame.to_local, jnp.array([0.0, 0.0, 1.0]))),
    )


def _carried_on(motion: Motion, hand: HandMotion, frame: "Carried", turning: Vector3, faster: Vector3) -> Experience:
    """Return what acts on a body that may be carried on from its pose: C_nb = exp(−ω_E τ) · C_nb,pose · turn.

    A vector fixed to the local level is turned by exp(ω_E τ) first, then into the body of the pose, then into that of
    the instant.  The gyros see the Earth's rotation along; what moves a point of the body against the Earth is the
    rest.
    """
    earth_turn = arrays.exponential(-hand.elapsed * motion.earth_rate)

    def felt(local: Vector3) -> Vector3:
        posed = into_body(motion, arrays.rotate_back(frame.to_local, arrays.rotate_back(earth_turn, local)))
        return arrays.rotate_back(hand.turn, posed)

    earth = felt(motion.earth_rate)
    turning = turning + hand.carried * (hand.rate - earth)
    moved = frame.force - arrays.rotate_back(frame.to_local, motion.gravity)
    return Experience(
        rate=turning + earth,
        force=felt(motion.gravity) + arrays.rotate_back(hand.turn, into_body(motion, moved)),
        table_rate=turning,
        table_acceleration=faster + hand.acceleration,
        north=felt(jnp.array([0.0, 1.0, 0.0])),
        up=felt(jnp.array([0.0, 0.0, 1.0])),
    )


def into_body(motion: Motion, vector: Vector3) -> Vector3:
    """Return a vector, given in the frame that the inner axis starts from, in body axes.

    Turns of a vector cost less than the product of matrices.
    """
    return arrays.rotate_back(motion.mounting, arrays.turn_back_about_z(vector, motion.table_angle))


def project(axes: Matrix3, experience: Experience, ambient: Ambient) -> Sample:
    """Return what one channel experiences along its own axes."""
    return Sample(
        rate=arrays.rotate(axes, experience.rate),
        force=arrays.rotate(axes, experience.force),
        acceleration=arrays.rotate(axes, experience.table_acceleration),
        north=arrays.rotate(axes, experience.north),
        up=arrays.rotate(axes, experience.up),
        ambient=ambient,
        output_scale=jnp.zeros_like(ambient.time),
    )


def initial_path(instants: Nodes) -> SignalPath:
    """Return the nominal motion as a path that has passed no layer."""
    return SignalPath(instants.stands, instants.stand_ambient, {}, {}, {}, instants, instants.records)


def propagate(layers: Sequence[Layer], path: SignalPath, values: Float[Array, " V"]) -> SignalPath:
    """Pass every layer in turn; `values` are all parameters in SI, then the null values."""
    for layer, chosen in zip(layers, _chosen(layers, values), strict=True):
        path = layer(path, chosen)
    return path


def _chosen(layers: Sequence[Layer], values: Float[Array, " V"]) -> list[dict[str, Array]]:
    """Return the values of every layer, by one gather: a compiled program pays for each."""
    places, tree = jax.tree.flatten([layer.value_places() for layer in layers])
    if not places:
        return [{} for _ in layers]
    ends = np.cumsum([math.prod(place.shape) for place in places])[:-1]
    found = jnp.split(arrays.take(values, jnp.concatenate([jnp.ravel(place) for place in places])), ends)
    return jax.tree.unflatten(tree, [part.reshape(place.shape) for part, place in zip(found, places, strict=True)])
