"""The memory of an effect: maps of one state from one instant to the next, and their composition over a record.

A step of a memory is a map x → f(x).  The families of maps here are closed under composition, so that the state after
any number of steps is one map applied to the initial state 0, and a whole record is an inclusive scan.
"""

import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from imubayes.array_shapes import Scalar, Scalars


class Decay(eqx.Module):
    """One step of a first-order linear recurrence: x → gain·x + shift, 0 ≤ gain ≤ 1."""

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
    """One step of a play (backlash) operator: x → clip(x + shift, low, high)."""

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
