r"""Base classes of effects: one physical cause, one formula, written for one sample; and the memory of an effect.

An effect is a small class whose fields are its parameters.  It declares its stage of the signal path and the recorded
covariates it needs; it never sees a procedure, a file or another effect.  Whether a run shows it follows from its
response there, not from a declaration.  At its null values it is the identity, so that it can be score-tested before it
is added.  The four bases differ in what they act on, and are vectorised over all nodes and channels.

A new effect is one class:

    class GyroScaleAsymmetry(SignalEffect):
        \"\"\"Scale factor asymmetry: signal + S_a·|Ω|.\"\"\"

        name = "gyro_scale_asymmetry"
        stage, order, kinds = Stage.SENSOR, Order.SCALE, ("gyro",)
        asymmetry: Scalar = parameter("ppm", "normal(0, 100 ppm)", (10, 300), "half the difference …")

        def apply(self, signal, sample):
            return signal + self.asymmetry * jnp.abs(sample.rate[0])

A `RecordEffect` has a memory, a state that passes from one instant to the next.  One step of it is a map x → f(x).  The
families of maps here are closed under composition, so that the state after any number of steps is one map applied to
the initial state 0, and a whole record is an inclusive scan.
"""

import math
from abc import abstractmethod
from collections.abc import Callable, Mapping
from enum import IntEnum
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp

from imubayes.foundations.arrays import Array, Float, Scalar, Scalars, take
from imubayes.foundations.campaign_data import Kind
from imubayes.foundations.signal_path_state import Ambient, Experience, Motion, Records, Sample, SignalPath


class Decay(eqx.Module):
    """One step of a first-order linear recurrence: x → gain·x + shift, 0 ≤ gain ≤ 1.

    Examples
    --------
    >>> import jax.numpy as jnp
    >>> import imubayes
    >>> half = imubayes.Decay(gain=jnp.array(0.5), shift=jnp.array(1.0))
    >>> half.then(half).from_rest().item()
    1.5
    """

    gain: Scalars
    shift: Scalars

    @staticmethod
    def lag(change: Scalar, elapsed: Scalar) -> "Decay":
        """Return the step of x − x_τ, x_τ the output of a first-order lag whose input x changes linearly.

        It decays by e^(−Δt/τ) and grows by Δx·(1 − e^(−Δt/τ))·τ/Δt, which is exact.

        Parameters
        ----------
        change : Δx of the input.
        elapsed : Δt/τ.
        """
        # Series for small Δt/τ; a step in no time passes into the lag in full.
        small = elapsed < 1e-4
        safe = jnp.where(small, 1.0, elapsed)
        gained = jnp.where(small, 1 - elapsed / 2, -jnp.expm1(-safe) / safe)
        return Decay(jnp.exp(-elapsed), gained * change)

    def then(self, later: "Decay") -> "Decay":
        """Return the composition of this step and a later one."""
        return Decay(self.gain * later.gain, later.gain * self.shift + later.shift)

    def from_rest(self) -> Scalars:
        """Return the state after this step from the initial state 0."""
        return self.shift


class Play(eqx.Module):
    """One step of a play (backlash) operator: x → clip(x + shift, low, high).

    Examples
    --------
    >>> import jax.numpy as jnp
    >>> import imubayes
    >>> step = imubayes.Play(shift=jnp.array(3.0), low=jnp.array(-1.0), high=jnp.array(1.0))
    >>> step.from_rest().item()
    1.0
    """

    shift: Scalars
    low: Scalars
    high: Scalars

    def then(self, later: "Play") -> "Play":
        """Return the composition of this step and a later one, a clipped shift again."""
        low, high = (jnp.clip(stop + later.shift, later.low, later.high) for stop in (self.low, self.high))
        return Play(self.shift + later.shift, low, high)

    def from_rest(self) -> Scalars:
        """Return the state after this step from the initial state 0."""
        return jnp.clip(self.shift, self.low, self.high)


def inclusive_scan(steps: Any) -> Any:
    """Return for every place the composition of all steps up to and including it; steps have leaves (N, C).

    Blocked: √N blocks of √N steps are scanned side by side, then the totals of the blocks.  `jax.lax.associative_scan`
    does the same in log N sweeps that all differ, and a program of these takes seconds to compile.
    """
    compose = jax.vmap(lambda earlier, later: earlier.then(later))
    compose_blocks = jax.vmap(compose)
    count = len(jax.tree.leaves(steps)[0])
    width = math.isqrt(max(count - 1, 0)) + 1
    blocks = -(-count // width)
    # Padding follows the last step and affects none before it.
    padded = jax.tree.map(lambda leaf: jnp.pad(leaf, ((0, blocks * width - count), (0, 0))), steps)
    by_block = jax.tree.map(lambda leaf: jnp.swapaxes(leaf.reshape(blocks, width, -1), 0, 1), padded)
    within = _sequential_scan(compose_blocks, by_block)
    totals = _sequential_scan(compose, jax.tree.map(lambda leaf: leaf[-1], within))
    before = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf[None, :-1], (width, blocks - 1, leaf.shape[1])), totals)
    joined = jax.vmap(compose_blocks)(before, jax.tree.map(lambda leaf: leaf[:, 1:], within))
    everywhere = jax.tree.map(lambda first, later: jnp.concatenate([first[:, :1], later], axis=1), within, joined)
    return jax.tree.map(lambda leaf: jnp.swapaxes(leaf, 0, 1).reshape(blocks * width, -1)[:count], everywhere)


def _sequential_scan(compose: Callable, steps: Any) -> Any:
    """Return the compositions of the first, the first two, … of steps along the first axis."""

    def advance(so_far, step):
        composed = compose(so_far, step)
        return composed, composed

    first = jax.tree.map(lambda leaf: leaf[0], steps)
    _, rest = jax.lax.scan(advance, first, jax.tree.map(lambda leaf: leaf[1:], steps))
    return jax.tree.map(lambda head, tail: jnp.concatenate([head[None], tail]), first, rest)


class Stage(IntEnum):
    """The stages of the signal path, in the order in which they are passed.

    Examples
    --------
    >>> import imubayes
    >>> [stage.name for stage in imubayes.Stage]
    ['STAND', 'TABLE', 'PLACE', 'SENSOR', 'CONVERTER']
    """

    STAND = 1  # how table and unit stand, constant over a run or pose: axis, mounting
    TABLE = 2  # the table's motion: its rate and angle
    PLACE = 3  # where a sensor sits in the unit
    SENSOR = 4  # the sensor: input-referred signal in SI
    CONVERTER = 5  # the readout: output units, without the nominal offset


class Order(IntEnum):
    """Places within the stages of table, sensor and converter.

    IEEE 1293 and 952 write the output as K1·(K0 + a_i + …): what is referred to the input is added first, the scale
    factor multiplies the sum.  What the input along the true axis causes by itself precedes what else is added, so
    that it does not act on a drift; a lag delays all of it.  For the table, the circumstances are corrected first, then
    the instant, the angle, and last rate and axis.

    Examples
    --------
    >>> import imubayes
    >>> imubayes.Order.BIAS < imubayes.Order.SCALE
    True
    """

    CIRCUMSTANCES = -30
    TIME = -20
    ANGLE = -10
    AXIS = 10
    INPUT = 15
    SENSITIVITY = 20
    BIAS = 30
    SCALE = 40
    LAG = 50
    GAIN = 10
    OFFSET = 20
    LIMIT = 90


class Effect(eqx.Module):
    """Base of all effects.

    A base that implements `apply` for several effects states the formula in its docstring; they inherit it.

    Attributes
    ----------
    name : as in model files, on the command line and in results.
    stage, order : where on the signal path.
    per : sharing of values: one for each channel, run, mounting, table or pose, whose names are in its label.
    kinds : kinds of channel that it can act on.
    needs : covariates that a run must have recorded (`imubayes.procedures.kinematics.Stimulus.supplies`).
    excludes : equivalent effects, which may not be in the same model for the same channel.
    confused_with : effects with a similar signature, in words.
    reference : source of the formula.
    nuisance : whether its values are of no interest in a report.

    Examples
    --------
    >>> import imubayes
    >>> bases = (imubayes.SignalEffect, imubayes.RecordEffect, imubayes.PlaceEffect, imubayes.MotionEffect)
    >>> all(issubclass(base, imubayes.Effect) for base in bases)
    True
    """

    name: ClassVar[str]
    stage: ClassVar[Stage]
    order: ClassVar[int] = 0
    per: ClassVar[tuple[str, ...]] = ("channel",)
    kinds: ClassVar[tuple[Kind, ...]] = ("gyro", "accelerometer")
    needs: ClassVar[tuple[str, ...]] = ()
    excludes: ClassVar[tuple[str, ...]] = ()
    confused_with: ClassVar[str] = ""
    reference: ClassVar[str] = ""
    nuisance: ClassVar[bool] = False

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if cls.__doc__ is None:
            cls.__doc__ = next((base.__doc__ for base in cls.__bases__ if _states_formula(base)), None)

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


def _states_formula(base: type) -> bool:
    apply = vars(base).get("apply")
    return apply is not None and not getattr(apply, "__isabstractmethod__", False) and "name" not in vars(base)


class MotionEffect(Effect):
    """An effect on the attitude and motion of the unit, at the stages STAND and TABLE.

    At STAND it may change `base` and `mounting`, and is evaluated once per run or pose, not at every node.

    Examples
    --------
    >>> import equinox as eqx
    >>> import imubayes
    >>> class Zero(imubayes.MotionEffect):
    ...     name = "my_angle_zero"
    ...     stage, order, per = imubayes.Stage.TABLE, imubayes.Order.ANGLE, ("table",)
    ...     zero: imubayes.Scalar = imubayes.parameter("arcsec", "normal(0, 30 arcsec)", (1, 600), "the zero")
    ...
    ...     def apply(self, motion: imubayes.Motion, ambient: imubayes.Ambient) -> imubayes.Motion:
    ...         return eqx.tree_at(lambda each: each.table_angle, motion, motion.table_angle + self.zero)
    >>> Zero.per
    ('table',)
    """

    @abstractmethod
    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        """Return the true motion at one instant."""

    @classmethod
    def advance(cls, make: Callable, values: dict[str, Array], path: SignalPath, kind: str) -> SignalPath:
        nodes = path.motion.table_angle.shape[0]
        at_nodes = jax.tree.map(lambda value: jnp.broadcast_to(value, (nodes,)), values)
        moved = jax.vmap(lambda value, motion, ambient: make(value).apply(motion, ambient))(
            at_nodes, path.motion, path.ambient
        )
        return eqx.tree_at(lambda p: p.motion, path, moved)


class AmbientEffect(MotionEffect):
    """An effect on the circumstances of the whole unit, at the stage TABLE: what was recorded of them is in error.

    The motion stays as it is.  Records that memories look back on stay, too, so the error has to be one that no change
    within a run shows.
    """

    @abstractmethod
    def true_ambient(self, ambient: Ambient) -> Ambient:
        """Return the true circumstances at one instant."""

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        return motion

    @classmethod
    def advance(cls, make: Callable, values: dict[str, Array], path: SignalPath, kind: str) -> SignalPath:
        nodes = path.ambient.time.shape[0]
        at_nodes = jax.tree.map(lambda value: jnp.broadcast_to(value, (nodes,)), values)
        true = jax.vmap(lambda value, ambient: make(value).true_ambient(ambient))(at_nodes, path.ambient)
        return eqx.tree_at(lambda p: p.ambient, path, true)


class PlaceEffect(Effect):
    """An effect of the position of a channel's sensor in the unit, at the stage PLACE.

    Examples
    --------
    >>> import imubayes
    >>> class Shifted(imubayes.PlaceEffect):
    ...     name = "my_lever_arm"
    ...     stage = imubayes.Stage.PLACE
    ...     x: imubayes.Scalar = imubayes.parameter("mm", "normal(0, 5 mm)", (0.1, 50), "the lever arm along body x")
    ...
    ...     def apply(self, experience: imubayes.Experience) -> imubayes.Experience:
    ...         arm = imubayes.vector3(self.x, 0 * self.x, 0 * self.x)
    ...         turning = imubayes.cross(experience.rate, imubayes.cross(experience.rate, arm))
    ...         return imubayes.Experience(
    ...             experience.rate, experience.force + turning, experience.table_rate, experience.table_acceleration,
    ...             experience.north, experience.up,
    ...         )
    >>> Shifted.stage.name
    'PLACE'
    """

    @abstractmethod
    def apply(self, experience: Experience) -> Experience:
        """Return motion and specific force at the sensor's own place, at one instant."""

    @classmethod
    def advance(cls, make: Callable, values: dict[str, Array], path: SignalPath, kind: str) -> SignalPath:
        apply = _over_channels(lambda value, experience: make(value).apply(experience), values)
        return eqx.tree_at(lambda p: p.experience[kind], path, apply(values, path.experience[kind]))


class SignalEffect(Effect):
    """An effect on one channel's signal, at the stages SENSOR and CONVERTER.

    Examples
    --------
    >>> import jax.numpy as jnp
    >>> import imubayes
    >>> class Asymmetry(imubayes.SignalEffect):
    ...     name = "my_asymmetry"
    ...     stage, order, kinds = imubayes.Stage.SENSOR, imubayes.Order.SCALE, ("gyro",)
    ...     asymmetry: imubayes.Scalar = imubayes.parameter("ppm", "normal(0, 100 ppm)", (10, 300), "the asymmetry")
    ...
    ...     def apply(self, signal: imubayes.Scalar, sample: imubayes.Sample) -> imubayes.Scalar:
    ...         return signal + self.asymmetry * jnp.abs(sample.rate[0])
    >>> Asymmetry(jnp.array(1e-5)).asymmetry.item()
    1e-05
    """

    @abstractmethod
    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        """Return the signal after this effect, for one sample of one channel.

        Parameters
        ----------
        signal : rad/s or m/s² at the sensor, output units at the converter.
        sample : what the channel experiences.
        """

    @classmethod
    def advance(cls, make: Callable, values: dict[str, Array], path: SignalPath, kind: str) -> SignalPath:
        apply = _over_channels(lambda value, signal, sample: make(value).apply(signal, sample), values)
        return eqx.tree_at(lambda p: p.signal[kind], path, apply(values, path.signal[kind], path.sample[kind]))


class RecordEffect(Effect):
    """An effect with memory on one channel's signal, at the stages SENSOR and CONVERTER.

    The memory is one number that starts from 0 in every run (steady state) and is carried from one instant to the
    next, for all runs and channels at once.

    Examples
    --------
    >>> import imubayes
    >>> class Lag(imubayes.RecordEffect):
    ...     name = "my_lag"
    ...     stage, order, kinds = imubayes.Stage.SENSOR, imubayes.Order.BIAS, ("gyro",)
    ...     needs = ("temperature",)
    ...     slope: imubayes.Scalar = imubayes.parameter("deg/h/degC", "normal(0, 1 deg/h/degC)", (0.01, 1), "the slope")
    ...     time: imubayes.Scalar = imubayes.time_constant("the time constant")
    ...
    ...     def carry(self, before, now, seconds):
    ...         return imubayes.Decay.lag(now.temperature - before.temperature, seconds / self.time)
    ...
    ...     def apply(self, signal, sample, memory):
    ...         return signal + self.slope * memory
    >>> Lag.needs
    ('temperature',)
    """

    @abstractmethod
    def carry(self, before: Ambient, now: Ambient, seconds: Scalar) -> Decay | Play:
        """Return the step of one channel's memory between two instants of a run."""

    @abstractmethod
    def apply(self, signal: Scalar, sample: Sample, memory: Scalar) -> Scalar:
        """Return the signal after this effect, for one sample of one channel, given the memory at that instant."""

    @classmethod
    def advance(cls, make: Callable, values: dict[str, Array], path: SignalPath, kind: str) -> SignalPath:
        records = path.records
        if records is None:
            return path
        in_order = _at(records.node, values)
        memory = take(cls.memories(make, in_order, records), records.place)
        at_nodes = _at(records.place, in_order)
        apply = _over_channels(lambda value, *state: make(value).apply(*state), at_nodes)
        signal = path.signal[kind]
        changed = apply(at_nodes, signal, path.sample[kind], jnp.broadcast_to(memory, signal.shape))
        return eqx.tree_at(lambda p: p.signal[kind], path, changed)

    @classmethod
    def memories(cls, make: Callable, values: dict[str, Array], records: Records) -> Float[Array, "N C"]:
        """Return the memory at every place of the records; values are (1 or N, 1 or C), in that order."""
        channels = max(value.shape[1] for value in values.values())
        count = len(records.node)
        previous = jnp.where(records.begins, jnp.arange(count), jnp.arange(count) - 1)
        now = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf[:, None], (count, channels)), records.ambient)
        before = jax.tree.map(lambda leaf: take(leaf, previous), now)
        seconds = jnp.broadcast_to(records.seconds[:, None], (count, channels))
        spread = {field: jnp.broadcast_to(value, (value.shape[0], channels)) for field, value in values.items()}
        carry = _over_channels(lambda value, *state: make(value).carry(*state), spread)
        # The first step of a run sets the memory to 0 whatever came before: x → 0·x + 0, or clipped to [0, 0].
        steps = jax.tree.map(
            lambda leaf: jnp.where(records.begins[:, None], 0.0, leaf), carry(spread, before, now, seconds)
        )
        return inclusive_scan(steps).from_rest()


def _at(places: Array, values: Mapping[str, Array]) -> dict[str, Array]:
    """Return the values at places along their node axis; an axis of length 1 is shared by all nodes."""
    return {field: value if value.shape[0] == 1 else take(value, places) for field, value in values.items()}


def _over_channels(function: Callable, values: Mapping[str, Array]) -> Callable:
    """Batch a function over nodes × channels; values with a node axis of length 1 are shared by all nodes."""
    shared = jax.tree.map(lambda value: value.shape[0] == 1, values)

    def batched(values, *state):
        squeezed = jax.tree.map(lambda value, is_shared: value[0] if is_shared else value, values, shared)
        node_axes = (jax.tree.map(lambda is_shared: None if is_shared else 0, shared), *(0 for _ in state))
        channel_axes = (0,) * (1 + len(state))
        return jax.vmap(jax.vmap(function, in_axes=channel_axes), in_axes=node_axes)(squeezed, *state)

    return batched
