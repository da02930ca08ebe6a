"""Hamiltonian Monte Carlo for densities that ensemble moves cannot follow: its step size follows the local geometry.

A funnel is a thousand times narrower in its neck than in its mouth.  Stretch and differential-evolution moves never
enter the neck, and no single step size of Hamiltonian Monte Carlo (NUTS included) suits both ends.  Here each
transition doubles or halves its step size until the energy error is right where the walker is, and is refused unless
the way back would choose the same one, so that the density is kept exactly.

Source: Liu, Surjanovic, Biron-Lattes, Bouchard-Côté, Campbell, "AutoStep: locally adaptive involutive MCMC", 2024;
Bou-Rabee, Carpenter, Marsden, "GIST: Gibbs self-tuning for locally adaptive Hamiltonian Monte Carlo", 2024; the
implementation is blackjax's.
"""

import importlib
import importlib.util
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from imubayes.foundations.deferred_modules import DeferredModule

if TYPE_CHECKING:
    import emcee
else:
    emcee = DeferredModule("emcee")  # takes long to import, and only sampling needs it

Single = Callable[[jax.Array], jax.Array]
"""A log density of one point, (D,) → (), which JAX can differentiate."""

# The step that is doubled or halved, in standard deviations as the user states them, leapfrog steps a transition, and
# doublings or halvings at most: a walker may begin where the density is a million times steeper than in its bulk.
_STEP, _LEAPS, _DOUBLINGS = 0.5, 16, 20


class GradientMove:
    """Move every walker by one transition of its own, whatever the others do.

    Parameters
    ----------
    scaled : log density at (x − start)/scale.
    start, scale : shape (D,).
    spend : called with the number of evaluations of each step: those that are computed for all walkers, which is as
        many for each as the longest search for a step size takes.
    """

    def __init__(self, scaled: Single, start: np.ndarray, scale: np.ndarray, spend: Callable[[int], None]):
        step_size = importlib.import_module("blackjax.mcmc.composed.step_size")  # takes long, and is an extra
        kernel, metric = step_size.build_kernel(max_search_steps=_DOUBLINGS), jnp.ones(len(start))

        def density(at: jax.Array) -> jax.Array:
            value = scaled(at)
            return jnp.where(jnp.isnan(value), -jnp.inf, value)

        def transition(key: jax.Array, point: jax.Array) -> tuple[jax.Array, ...]:
            state, about = kernel(key, step_size.init((point - start) / scale, density), density, _STEP, metric, _LEAPS)
            # One trajectory more than the doublings shows that they suffice, and one is the transition.
            tried = jnp.abs(about.step_index) + jnp.abs(about.reverse_step_index) + 5
            return start + scale * state.position, state.logdensity, about.is_accepted, tried

        self._spend = spend
        self._transitions = jax.jit(jax.vmap(transition))

    def forget(self) -> None:
        """Nothing is kept from step to step."""

    def propose(self, model: Any, state: Any) -> "tuple[emcee.State, np.ndarray]":
        """Advance the whole ensemble; emcee asks nothing else of a move."""
        keys = jax.random.split(jax.random.key(model.random.randint(2**31)), len(state.coords))
        # What blackjax promotes is no concern of the caller, who may have it refused.
        with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
            points, height, accepted, tried = map(np.asarray, self._transitions(keys, state.coords))
        self._spend(int(tried.max()) * _LEAPS * len(tried))
        return emcee.moves.Move().update(state, emcee.State(points, log_prob=height), accepted), accepted


def gradient_move(
    scaled: Single, start: np.ndarray, scale: np.ndarray, spend: Callable[[int], None]
) -> GradientMove | None:
    """Return the move of a log density at (x − start)/scale; None without blackjax, of the extra `gradient`."""
    return GradientMove(scaled, start, scale, spend) if importlib.util.find_spec("blackjax") is not None else None
