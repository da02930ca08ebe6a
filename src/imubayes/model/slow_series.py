"""The root of the precision of slow noise, in a number of operations proportional to the number of rows.

Slow noise gives the rows of a run and channel a covariance that is semiseparable: beyond the diagonal it passes
through a few decaying states (`imubayes.noise.base.StateCovariance`).  The Cholesky factor has the same form
(Foreman-Mackey, Agol, Ambikasaran & Angus, Astron. J. 154 (2017), 220, § 5), which is the Kalman filter of the states
in its covariance form.  States are referred to the ends of rows, so that no exponent is positive.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from imubayes.array_shapes import Array, Float
from imubayes.gather import take
from imubayes.model.row_times import Timeline
from imubayes.noise.base import StateCovariance


class SlowSeries(eqx.Module):
    """The root A of R⁻¹, R = I + D^(−½) S D^(−½): A = L⁻¹ of the Cholesky factor L of R.

    The leaves are (S, L) or (S, L, J): steps, lanes and states.

    Attributes
    ----------
    timeline : order of the entries.
    mean, over_gap, over_row : see `StateCovariance`; the mean over the root of D.
    gain : change of the states at the end of a row per unit of its innovation.
    variance : of the innovation.
    """

    timeline: Timeline
    mean: Float[Array, "S L J"]
    over_gap: Float[Array, "S L J"]
    over_row: Float[Array, "S L J"]
    gain: Float[Array, "S L J"]
    variance: Float[Array, "S L"]

    def forward(self, x: Float[Array, "E *columns"]) -> Float[Array, "E *columns"]:
        """Return A x."""

        def step(state, row):
            value, mean, over_gap, over_row, gain, variance = row
            before = over_gap[..., None] * state
            innovation = value - jnp.einsum("lj,ljc->lc", mean, before)
            after = over_row[..., None] * before + gain[..., None] * innovation[:, None, :]
            return after, innovation / jnp.sqrt(variance)[:, None]

        return self._passed(step, x)

    def colour(self, x: Float[Array, "E *columns"]) -> Float[Array, "E *columns"]:
        """Return L x: noise of covariance R from independent normal values."""

        def step(state, row):
            value, mean, over_gap, over_row, gain, variance = row
            before = over_gap[..., None] * state
            innovation = value * jnp.sqrt(variance)[:, None]
            after = over_row[..., None] * before + gain[..., None] * innovation[:, None, :]
            return after, innovation + jnp.einsum("lj,ljc->lc", mean, before)

        return self._passed(step, x)

    def back(self, x: Float[Array, " E"]) -> Float[Array, " E"]:
        """Return Aᵀ x."""
        return jax.linear_transpose(self.forward, x)(x)[0]

    def diagonal(self) -> Float[Array, " E"]:
        """Return the diagonal of AᵀA = R⁻¹."""

        def step(later, row):
            mean, over_gap, over_row, gain, variance = row
            own = 1 / variance + jnp.einsum("li,lij,lj->l", gain, later, gain)
            move = over_row[..., None] * jnp.eye(mean.shape[-1])[None] - gain[..., None] * mean[:, None, :]
            here = mean[..., None] * mean[:, None, :] / variance[:, None, None]
            here = here + jnp.einsum("lki,lkm,lmj->lij", move, later, move)
            return over_gap[..., None] * over_gap[:, None, :] * here, own

        rows = (self.mean, self.over_gap, self.over_row, self.gain, self.variance)
        lanes, states = self.mean.shape[1:]
        _, found = jax.lax.scan(step, jnp.zeros((lanes, states, states)), rows, reverse=True)
        return take(found.reshape(-1), self.timeline.place)

    def log_determinants(self) -> Float[Array, " E"]:
        """Return what each entry adds to log det R."""
        return take(jnp.log(self.variance).reshape(-1), self.timeline.place)

    def _passed(self, step, x):
        values = x[:, None] if x.ndim == 1 else x
        laid = _in_lanes(self.timeline, values)
        rows = (laid, self.mean, self.over_gap, self.over_row, self.gain, self.variance)
        lanes, states = self.mean.shape[1:]
        _, found = jax.lax.scan(step, jnp.zeros((lanes, states, values.shape[1])), rows)
        return take(found.reshape(-1, values.shape[1]), self.timeline.place).reshape(x.shape)


def slow_series(timeline: Timeline, covariance: StateCovariance, root: Float[Array, " E"]) -> SlowSeries:
    """Return the root of the precision.

    Parameters
    ----------
    covariance : of every entry, leaves (E,) or (E, J).
    root : shape (E,), D^(−½), 0 where masked.
    """
    mean, end, over_gap, over_row = (
        _in_lanes(timeline, leaf)
        for leaf in (
            covariance.mean * root[:, None],
            covariance.end * root[:, None],
            covariance.over_gap,
            covariance.over_row,
        )
    )
    total = 1 + _in_lanes(timeline, (covariance.variance * root**2)[:, None])[..., 0]

    def step(known, row):
        mean, end, over_gap, over_row, total = row
        before = over_gap[..., None] * over_gap[:, None, :] * known
        pulled = jnp.einsum("lij,lj->li", before, mean)
        variance = total - jnp.sum(mean * pulled, axis=-1)
        gain = (end - over_row * pulled) / variance[:, None]
        after = over_row[..., None] * over_row[:, None, :] * before
        after = after + variance[:, None, None] * gain[..., None] * gain[:, None, :]
        return after, (gain, variance)

    lanes, states = mean.shape[1:]
    _, (gain, variance) = jax.lax.scan(step, jnp.zeros((lanes, states, states)), (mean, end, over_gap, over_row, total))
    return SlowSeries(timeline, mean, over_gap, over_row, gain, variance)


def _in_lanes(timeline: Timeline, values: Float[Array, "E C"]) -> Float[Array, "S L C"]:
    return take(jnp.concatenate([values, jnp.zeros((1, values.shape[1]))]), timeline.lanes)
