"""What an effect is: one physical cause, one formula, written for one sample.

An effect is a small class whose fields are its parameters.  It says at which stage of the signal path it acts and which
covariates it needs; it never sees a procedure, a file or another effect.  At its null values it is the identity, so
that criticism can differentiate it before it is added.  The four bases differ in what they act on, and know how to
act on all nodes and channels at once; a `RecordEffect` remembers what went before.

A new effect is one class:

    class GyroScaleAsymmetry(SignalEffect):
        \"\"\"Scale factor that differs between the two directions of rotation.\"\"\"
        name = "gyro_scale_asymmetry"
        stage, order, kinds = Stage.SENSOR, Order.SCALE, ("gyro",)
        needs = ("turning",)
        asymmetry: Scalar = parameter("ppm", "normal(0, 100 ppm)", (10, 300), "half the difference …")

        def apply(self, signal, sample):
            return signal + self.asymmetry * jnp.abs(sample.rate[0])
"""

import math
from abc import abstractmethod
from collections.abc import Callable
from enum import IntEnum
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp

from imubayes.gather import take
from imubayes.run import Kind
from imubayes.stimulus import Ambient, Experience, Motion, Records, Sample, SignalPath
from imubayes.types import Array, Float, Scalar, Scalars


class Stage(IntEnum):
    """The stages of the signal path, in the order in which they are passed."""

    STAND = 1  # how table and unit stand, the same for all rows of a run or pose: axis, mounting
    TABLE = 2  # the table's motion: its rate and angle
    PLACE = 3  # where a sensor sits in the unit
    SENSOR = 4  # the sensor: input-referred signal in SI
    CONVERTER = 5  # the readout: output units, without the nominal offset


class Order(IntEnum):
    """Places within the stages of table, sensor and converter.

    IEEE 1293 and 952 write the output as K1·(K0 + a_i + …): what is referred to the input is added first, the scale
    factor multiplies the sum.  Of the table the instant is put right first, then its angle, then its rate and its axis.
    """

    TIME = -20
    ANGLE = -10
    AXIS = 10
    SENSITIVITY = 20
    BIAS = 30
    SCALE = 40
    GAIN = 10
    OFFSET = 20
    LIMIT = 90


class Effect(eqx.Module):
    """Base of all effects.

    Attributes
    ----------
    name : as in model files, on the command line and in results.
    stage, order : where on the signal path.
    per : what a value belongs to, for each value the names in its label: channel, run, mounting, table, pose.
    kinds : kinds of channel that it can act on.
    needs : what a run must supply (`imubayes.stimulus.Stimulus.supplies`).
    excludes : effects that may not stand in the same model for the same channel: they say the same in another way.
    confused_with : what else would look alike, in words.
    reference : source of the formula.
    """

    name: ClassVar[str]
    stage: ClassVar[Stage]
    order: ClassVar[int] = 0
    per: ClassVar[tuple[str, ...]] = ("channel",)
    kinds: ClassVar[tuple[Kind, ...]] = ("gyro", "accelerometer")
    needs: ClassVar[tuple[str, ...]] = ()
    excludes: ClassVar[tuple[str, ...]] = ()
    hierarchical: ClassVar[str] = ""
    confused_with: ClassVar[str] = ""
    reference: ClassVar[str] = ""
    nuisance: ClassVar[bool] = False

    @classmethod
    @abstractmethod
    def advance(cls, make: Callable, values: dict[str, Array], path: SignalPath, kind: str) -> SignalPath:
        """Act on every node (and channel of one kind) of the path.

        Parameters
        ----------
        make : builds the effect from one set of values.
        values : parameter name → values, batched over nodes, channels or both; an axis of length 1 is shared.
        path : the signal path so far.
        kind : the kind of channel to act on; not used by effects of table and mounting.
        """


class MotionEffect(Effect):
    """An effect on how the unit stands and moves, at the stages STAND and TABLE.

    At STAND it may change `base` and `mounting`, and is evaluated once per run or pose, not at every node.
    """

    @abstractmethod
    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        """Return the motion as it truly is, at one instant."""

    @classmethod
    def advance(cls, make, values, path, kind):
        nodes = path.motion.table_angle.shape[0]
        spread = jax.tree.map(lambda value: jnp.broadcast_to(value, (nodes,)), values)
        moved = jax.vmap(lambda one, motion, ambient: make(one).apply(motion, ambient))(
            spread, path.motion, path.ambient
        )
        return eqx.tree_at(lambda p: p.motion, path, moved)


class PlaceEffect(Effect):
    """An effect of where in the unit a channel's sensor sits, at the stage PLACE."""

    @abstractmethod
    def apply(self, experience: Experience) -> Experience:
        """Return what acts at the sensor's own place, at one instant."""

    @classmethod
    def advance(cls, make, values, path, kind):
        moved = _over_channels(lambda one, experience: make(one).apply(experience), values)(
            values, path.experience[kind]
        )
        return eqx.tree_at(lambda p: p.experience[kind], path, moved)


class SignalEffect(Effect):
    """An effect on one channel's signal, at the stages SENSOR and CONVERTER."""

    @abstractmethod
    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        """Return the signal after this effect, for one sample of one channel.

        Parameters
        ----------
        signal : rad/s or m/s² at the sensor, output units at the converter.
        sample : what the channel experiences.
        """

    @classmethod
    def advance(cls, make, values, path, kind):
        changed = _over_channels(lambda one, signal, sample: make(one).apply(signal, sample), values)(
            values, path.signal[kind], path.sample[kind]
        )
        return eqx.tree_at(lambda p: p.signal[kind], path, changed)


class Decay(eqx.Module):
    """A step of a memory that fades while it is fed: x → gain·x + shift, 0 ≤ gain ≤ 1."""

    gain: Scalars
    shift: Scalars

    @staticmethod
    def behind(change: Scalar, elapsed: Scalar) -> "Decay":
        """Return the step of x − x_τ, the distance of a first-order lag behind a quantity that goes straight.

        It fades by e^(−Δt/τ) and gains Δx·(1 − e^(−Δt/τ))·τ/Δt.

        Parameters
        ----------
        change : Δx of the quantity.
        elapsed : Δt/τ.
        """
        # By its series where Δt is small: a step in no time is a lag of that size.
        small = elapsed < 1e-4
        safe = jnp.where(small, 1.0, elapsed)
        gained = jnp.where(small, 1 - elapsed / 2, -jnp.expm1(-safe) / safe)
        return Decay(jnp.exp(-elapsed), gained * change)

    def then(self, later: "Decay") -> "Decay":
        """Return this step and a later one as one."""
        return Decay(self.gain * later.gain, later.gain * self.shift + later.shift)

    def from_rest(self) -> Scalars:
        """Return what the step makes of a memory of 0."""
        return self.shift


class Play(eqx.Module):
    """A step of a memory that is dragged along between two stops: x → x + shift, kept within [low, high]."""

    shift: Scalars
    low: Scalars
    high: Scalars

    def then(self, later: "Play") -> "Play":
        """Return this step and a later one as one: a shift between stops again."""
        low, high = (jnp.clip(stop + later.shift, later.low, later.high) for stop in (self.low, self.high))
        return Play(self.shift + later.shift, low, high)

    def from_rest(self) -> Scalars:
        """Return what the step makes of a memory of 0."""
        return jnp.clip(self.shift, self.low, self.high)


class RecordEffect(Effect):
    """An effect on one channel's signal that depends on what went before, at the stages SENSOR and CONVERTER.

    Its memory is one number that starts from 0 in every run (the unit has been as it is for long) and is carried from
    one instant to the next.  The steps are put together for all runs and channels at once.
    """

    @abstractmethod
    def carry(self, before: Ambient, now: Ambient, seconds: Scalar) -> Decay | Play:
        """Return what the time between two instants of a run does to the memory of one channel."""

    @abstractmethod
    def apply(self, signal: Scalar, sample: Sample, memory: Scalar) -> Scalar:
        """Return the signal after this effect, for one sample of one channel, given the memory at that instant."""

    @classmethod
    def advance(cls, make, values, path, kind):
        records = path.records
        if records is None:
            return path
        at_nodes = _at(records.node, values)
        remembered = take(cls.memories(make, at_nodes, records), records.place)
        there = _at(records.place, at_nodes)
        changed = _over_channels(lambda one, *state: make(one).apply(*state), there)(
            there, path.signal[kind], path.sample[kind], jnp.broadcast_to(remembered, path.signal[kind].shape)
        )
        return eqx.tree_at(lambda p: p.signal[kind], path, changed)

    @classmethod
    def memories(cls, make: Callable, values: dict, records: Records) -> Float[Array, "N C"]:
        """Return the memory at every place of the records; values are (1 or N, 1 or C), in that order."""
        channels = max(value.shape[1] for value in values.values())
        count = len(records.node)
        previous = jnp.where(records.begins, jnp.arange(count), jnp.arange(count) - 1)
        now = _of_all(records.ambient, channels)
        before = jax.tree.map(lambda leaf: take(leaf, previous), now)
        seconds = jnp.broadcast_to(records.seconds[:, None], (count, channels))
        spread = {field: jnp.broadcast_to(value, (value.shape[0], channels)) for field, value in values.items()}
        steps = _over_channels(lambda one, *state: make(one).carry(*state), spread)(spread, before, now, seconds)
        begins = records.begins[:, None]
        # What a run begins with is no step but the state of rest, whatever went before.
        steps = jax.tree.map(lambda leaf: jnp.where(begins, 0.0, leaf), steps)
        return put_together(steps).from_rest()


def put_together(steps: Any) -> Any:
    """Return for every place what all steps up to there do as one; steps have leaves (N, C).

    √N blocks of √N steps: all blocks at once step by step, then the blocks.  `jax.lax.associative_scan` does as much
    in log N sweeps that are all different, and a program of these takes seconds to compile.
    """
    join = jax.vmap(lambda one, later: one.then(later))
    join_all = jax.vmap(join)
    count = len(jax.tree.leaves(steps)[0])
    width = math.isqrt(max(count - 1, 0)) + 1
    blocks = -(-count // width)
    # What is added behind the last step reaches none before it.
    padded = jax.tree.map(lambda leaf: jnp.pad(leaf, ((0, blocks * width - count), (0, 0))), steps)
    in_turn = jax.tree.map(lambda leaf: jnp.swapaxes(leaf.reshape(blocks, width, -1), 0, 1), padded)
    within = _running(join_all, in_turn)
    whole = _running(join, jax.tree.map(lambda leaf: leaf[-1], within))
    before = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf[None, :-1], (width, blocks - 1, leaf.shape[1])), whole)
    joined = jax.vmap(join_all)(before, jax.tree.map(lambda leaf: leaf[:, 1:], within))
    everywhere = jax.tree.map(lambda first, later: jnp.concatenate([first[:, :1], later], axis=1), within, joined)
    return jax.tree.map(lambda leaf: jnp.swapaxes(leaf, 0, 1).reshape(blocks * width, -1)[:count], everywhere)


def _running(join: Callable, steps: Any) -> Any:
    """Return what the first, the first two, … of steps along the first axis do as one."""

    def further(so_far, step):
        both = join(so_far, step)
        return both, both

    first = jax.tree.map(lambda leaf: leaf[0], steps)
    _, rest = jax.lax.scan(further, first, jax.tree.map(lambda leaf: leaf[1:], steps))
    return jax.tree.map(lambda one, others: jnp.concatenate([one[None], others]), first, rest)


def _at(places: Array, values: dict) -> dict:
    """Return the values at places along their node axis; those with an axis of length 1 are the same everywhere."""
    return {field: value if value.shape[0] == 1 else take(value, places) for field, value in values.items()}


def _of_all(ambient: Ambient, channels: int) -> Ambient:
    return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf[:, None], (len(leaf), channels)), ambient)


def _over_channels(function: Callable, values: dict) -> Callable:
    """Batch a function over nodes × channels; values with a node axis of length 1 are shared by all nodes."""
    shared = jax.tree.map(lambda value: value.shape[0] == 1, values)

    def both(values, *state):
        squeezed = jax.tree.map(lambda value, one: value[0] if one else value, values, shared)
        node_axes = (jax.tree.map(lambda one: None if one else 0, shared), *(0 for _ in state))
        channel_axes = (0,) * (1 + len(state))
        return jax.vmap(jax.vmap(function, in_axes=channel_axes), in_axes=node_axes)(squeezed, *state)

    return both
