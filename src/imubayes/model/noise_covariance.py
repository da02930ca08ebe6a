"""The covariance of the data and its inverse root, in closed form: correlated rows, slow noise, Student's t.

Σ = D^½ R D^½ + Σ_g T_g 1 1ᵀ (see `imubayes.noise.components`), R = I unless a member correlates; the covariance S of
slow noise counts as R = I + D^(−½) S D^(−½).  A model with heavy tails has a Σ too: that of the normal distribution
with the same Fisher information (`imubayes.model.likelihood`).

Slow noise gives the rows of a run and channel a covariance that is semiseparable: beyond the diagonal it passes through
a few decaying states (`imubayes.noise.components.StateCovariance`).  The Cholesky factor has the same form
(Foreman-Mackey, Agol, Ambikasaran & Angus, Astron. J. 154 (2017), 220, § 5), which is the Kalman filter of the states
in its covariance form.  The root of the precision takes a number of operations proportional to the number of rows.
States are referred to the ends of rows, so that no exponent is positive.

Student's t is that of one observation: x is the residual over the scale of the distribution, κ one over the degrees of
freedom ν, so that κ = 0 is the normal distribution.  Formulas: Lange, Little and Taylor, Robust statistical modeling
using the t distribution (J. Am. Stat. Assoc. 84, 1989).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import gammaln

from imubayes.foundations.arrays import Array, Float, Int, Scalar, take
from imubayes.model.nodes_and_entries import Timeline
from imubayes.model.problem import Observations, Problem
from imubayes.noise import components


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


def slow_series(timeline: Timeline, covariance: components.StateCovariance, root: Float[Array, " E"]) -> SlowSeries:
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


# Below this a series is used; the first neglected term is its third power over 4.
_SMALL = 1e-5


def deviance(x: Float[Array, "..."], tail: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return the deviance (ν + 1) log(1 + x²/ν), which replaces x² in −2 log density."""
    return x**2 * _flattened(x, tail)


def irls_weight(x: Float[Array, "..."], tail: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return (ν + 1)/(ν + x²): half the slope of the deviance over x, the weight in reweighted least squares."""
    return (1 + tail) / (1 + tail * x**2)


def curvature(x: Float[Array, "..."], tail: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return half the second derivative of the deviance: 1 for a normal distribution, negative for outliers."""
    return (1 + tail) * (1 - tail * x**2) / (1 + tail * x**2) ** 2


def deviance_root_slope(x: Float[Array, "..."], tail: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return the derivative by x of the signed root of the deviance."""
    return irls_weight(x, tail) / jnp.sqrt(_flattened(x, tail))


def deviance_root_over_slope(x: Float[Array, "..."], tail: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return the signed root of the deviance over its derivative: the residual of its linearisation."""
    return x * _flattened(x, tail) / irls_weight(x, tail)


def fisher_information(tail: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return the Fisher information about the location, (ν + 1)/(ν + 3), for a scale of 1."""
    return (1 + tail) / (1 + 3 * tail)


def normaliser(tail: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return 2 log of the density of N(0, 1) over that of the t distribution, both at zero."""
    heavy = tail > 0
    degrees = 1 / jnp.where(heavy, tail, 1.0)
    at_zero = gammaln((degrees + 1) / 2) - gammaln(degrees / 2) - 0.5 * jnp.log(degrees / 2)
    return jnp.where(heavy, -2 * at_zero, 0.0)


def log_determinant_correction(tail: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return what one observation adds to the log determinant of the normal distribution of the same information."""
    return jnp.log(fisher_information(tail)) + normaliser(tail)


def _flattened(x: Float[Array, "..."], tail: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return the deviance over x²: (1 + κ) log(1 + κx²)/(κx²)."""
    grown = tail * x**2
    small = grown < _SMALL
    safe = jnp.where(small, 1.0, grown)
    return (1 + tail) * jnp.where(small, 1 - grown / 2 + grown**2 / 3, jnp.log1p(safe) / safe)


def heavy_tailed(tail: np.ndarray, stream: np.random.Generator) -> np.ndarray:
    """Return the factors that turn normal variates into Student's t; `tail` is the inverse degrees of freedom."""
    if not tail.any():
        return np.ones(tail.shape)
    degrees = 1 / np.where(tail > 0, tail, 1.0)
    return np.where(tail > 0, np.sqrt(degrees / stream.chisquare(degrees)), 1.0)


class Series(eqx.Module):
    """The root A of R⁻¹, R = AR(1) along each group: (A x)_k = (x_k − ρ_k x_(k−1))/√(1 − ρ_k²).

    Attributes
    ----------
    before : shape (E,), the entry before in the same group that is not masked, E where there is none.
    correlation : shape (E,), ρ with that entry, 0 where there is none.
    """

    before: Int[Array, " E"]
    correlation: Float[Array, " E"]

    def forward(self, x: Float[Array, "E *columns"]) -> Float[Array, "E *columns"]:
        """Return A x."""
        gain, carried = self._factors(x.ndim)
        return gain * x - carried * take(jnp.concatenate([x, jnp.zeros((1, *x.shape[1:]))]), self.before)

    def back(self, x: Float[Array, " E"]) -> Float[Array, " E"]:
        """Return Aᵀ x."""
        gain, carried = self._factors(1)
        return gain * x - jnp.zeros(len(x) + 1).at[self.before].add(carried * x)[:-1]

    def diagonal(self) -> Float[Array, " E"]:
        """Return the diagonal of AᵀA = R⁻¹."""
        gain, carried = self._factors(1)
        return gain**2 + jnp.zeros(len(gain) + 1).at[self.before].add(carried**2)[:-1]

    def log_determinants(self) -> Float[Array, " E"]:
        """Return what each entry adds to log det R."""
        return jnp.log1p(-(self.correlation**2))

    def _factors(self, dimensions: int):
        gain = 1 / jnp.sqrt(1 - self.correlation**2)
        shape = (-1, *(1,) * (dimensions - 1))
        return gain.reshape(shape), (gain * self.correlation).reshape(shape)


class Whitener(eqx.Module):
    """Σ(h)^(−½) of the data, in closed form, and its log determinant.

    Attributes
    ----------
    precision_root : shape (E,), D^(−½), 0 where masked.
    shrink : shape (G,), reduction by the shared variance along each group's direction.
    log_determinant : log det Σ.
    series : the correlation in time; None in a model without.
    """

    precision_root: Float[Array, " E"]
    shrink: Float[Array, " G"]
    log_determinant: Scalar
    series: Series | SlowSeries | None

    @property
    def direction(self) -> Float[Array, " E"]:
        """Scaled direction of the shared part: u = A D^(−½) 1."""
        return self.precision_root if self.series is None else self.series.forward(self.precision_root)

    def scale(self, values: Float[Array, "E *columns"]) -> Float[Array, "E *columns"]:
        """Return A D^(−½) · values."""
        root = self.precision_root if values.ndim == 1 else self.precision_root[:, None]
        return root * values if self.series is None else self.series.forward(root * values)


def group_sum(values: Float[Array, "E *columns"], observations: Observations) -> Float[Array, "G *columns"]:
    """Return the sums over the entries of each group."""
    padded = jnp.concatenate([values, jnp.zeros((1, *values.shape[1:]))])
    return take(padded, observations.members).sum(axis=1)


class NoiseDistribution(eqx.Module):
    """Distribution of the observations about the prediction, at given hyperparameters.

    Attributes
    ----------
    squared_scale : shape (E,), squared scale of the independent part of each entry; its variance if normal.
    shared_variance : shape (G,), variance of what all entries of a group have in common.
    tail : shape (E,), 1/ν of Student's t, 0 for a normal distribution; None in a model without heavy tails.
    """

    squared_scale: Float[Array, " E"]
    shared_variance: Float[Array, " G"]
    tail: Float[Array, " E"] | None


def noise_distribution(problem: Problem, h: Float[Array, " H"]) -> NoiseDistribution:
    """Return the distribution of the observations at hyperparameters h (in z)."""
    values, observations = problem.hyper_priors.values(h), problem.observations
    own, tail = jnp.zeros_like(observations.value), None
    shared = jnp.zeros(observations.members.shape[0])
    for layer in problem.noise:
        if issubclass(layer.noise, components.EntryNoise):
            own = own + layer.entry_variances(values, observations.entry)
        elif issubclass(layer.noise, components.SharedNoise):
            shared = shared + layer.shared_variances(values)
        elif issubclass(layer.noise, components.TailNoise):
            here = take(layer.tails(values), observations.group)
            tail = here if tail is None else tail + here
    return NoiseDistribution(own, shared, tail)


@jax.jit
def whitener(problem: Problem, h: Float[Array, " H"]) -> Whitener:
    """Return the whitener at hyperparameters h (in z).

    Under heavy tails an entry has the Fisher information of its distribution as precision, and the log determinant
    includes the normaliser of that distribution.
    """
    noise = noise_distribution(problem, h)
    if noise.tail is None:
        return whitener_of(problem, h, noise.squared_scale, noise.shared_variance)
    by = whitener_of(problem, h, noise.squared_scale / fisher_information(noise.tail), noise.shared_variance)
    beyond = jnp.sum(problem.observations.weight * log_determinant_correction(noise.tail))
    return eqx.tree_at(lambda known: known.log_determinant, by, by.log_determinant + beyond)


def whitener_of(
    problem: Problem, h: Float[Array, " H"], own: Float[Array, " E"], shared: Float[Array, " G"]
) -> Whitener:
    """Return the whitener of given variances.

    The inverse of D + T 1 1ᵀ with u = D^(−½) 1 has the root (I − κ û ûᵀ) D^(−½), κ = 1 − 1/√(1 + T |u|²); with rows
    that are correlated u = A D^(−½) 1 and the root is (I − κ û ûᵀ) A D^(−½), AᵀA = R⁻¹.
    """
    observations = problem.observations
    root = observations.weight / jnp.sqrt(own)
    values = problem.hyper_priors.values(h)
    series = _series(problem, values) if problem.timeline is None else _slow_series(problem, values, root)
    along = root if series is None else series.forward(root)
    direction = group_sum(along**2, observations)
    gain = 1 + shared * direction
    safe = jnp.where(direction > 0, direction, 1.0)
    shrink = (1 - 1 / jnp.sqrt(gain)) / safe
    log_determinant = jnp.sum(observations.weight * jnp.log(own)) + jnp.sum(jnp.log(gain))
    if series is not None:
        log_determinant = log_determinant + jnp.sum(observations.weight * series.log_determinants())
    return Whitener(root, shrink, log_determinant, series)


def rows_correlate(problem: Problem) -> bool:
    """Whether a member of the noise correlates the rows of a run."""
    return any(issubclass(layer.noise, components.SeriesNoise) for layer in problem.noise)


def row_correlations(problem: Problem, values: Float[Array, " H"]) -> Float[Array, " G"]:
    """Return the correlation of neighbouring rows of every run and channel, at values of the noise scales in SI."""
    one_row = jnp.zeros(problem.observations.in_time.shape[0])
    for layer in problem.noise:
        if issubclass(layer.noise, components.SeriesNoise):
            one_row = one_row + layer.correlations(values)
    return one_row


def _series(problem: Problem, values: Float[Array, " H"]) -> Series | None:
    """Return each entry's correlation with the one before it that is not masked; None where nothing correlates."""
    if not rows_correlate(problem):
        return None
    observations = problem.observations
    groups, most = observations.in_time.shape
    none = len(observations.value)
    seen = jnp.concatenate([observations.weight > 0, jnp.zeros(1, dtype=bool)])[observations.in_time]
    last = jax.lax.cummax(jnp.where(seen, jnp.arange(most)[None, :], -1), axis=1)
    last = jnp.concatenate([jnp.full((groups, 1), -1), last[:, :-1]], axis=1)
    entry = jnp.where(last < 0, none, jnp.take_along_axis(observations.in_time, jnp.maximum(last, 0), axis=1))
    before = jnp.full(none + 1, none, dtype=entry.dtype).at[observations.in_time].set(entry)[:-1]
    before = jnp.where(observations.weight > 0, before, none)
    apart = (
        observations.rank - jnp.concatenate([observations.rank, jnp.zeros(1, dtype=observations.rank.dtype)])[before]
    )
    linked, one_row = before < none, row_correlations(problem, values)
    steps = jnp.where(linked, apart, 1).astype(float)
    return Series(before, jnp.where(linked, take(one_row, observations.group) ** steps, 0.0))


def _slow_series(problem: Problem, values: Float[Array, " H"], root: Float[Array, " E"]) -> SlowSeries:
    """Return the root of R⁻¹ under the slow noise of all members."""
    timeline = problem.timeline
    assert timeline is not None
    parts = [
        layer.states(values, timeline.row) for layer in problem.noise if issubclass(layer.noise, components.SlowNoise)
    ]
    mean, end, over_gap, over_row = (
        jnp.concatenate([getattr(part, name) for part in parts], axis=1)
        for name in ("mean", "end", "over_gap", "over_row")
    )
    variance = jnp.sum(jnp.stack([part.variance for part in parts]), axis=0)
    return slow_series(timeline, components.StateCovariance(variance, mean, end, over_gap, over_row), root)


def whiten(problem: Problem, by: Whitener, residual: Float[Array, "E *columns"]) -> Float[Array, "E *columns"]:
    """Return Σ^(−½) · residual, of one or of many columns."""
    columns = (-1, *(1,) * (residual.ndim - 1))
    scaled, direction = by.scale(residual), by.direction.reshape(columns)
    along = group_sum(direction * scaled, problem.observations)
    return scaled - direction * take(by.shrink.reshape(columns) * along, problem.observations.group)


def inverse_covariance(
    problem: Problem, by: Whitener, residual: Float[Array, " E"]
) -> tuple[Float[Array, " E"], Float[Array, " E"]]:
    """Return Σ⁻¹ · residual and the diagonal of Σ⁻¹, both of shape (E,)."""
    observations = problem.observations
    direction = by.direction
    # (I − κ û ûᵀ)² = I − (2 shrink − shrink² |u|²) u uᵀ, with shrink = κ/|u|²
    rank_one = 2 * by.shrink - by.shrink**2 * group_sum(direction**2, observations)
    if by.series is not None:
        scaled = by.scale(residual)
        along = group_sum(direction * scaled, observations)
        pulled = by.series.back(scaled - direction * take(rank_one * along, observations.group))
        shared = take(rank_one, observations.group) * by.series.back(direction) ** 2
        return by.precision_root * pulled, by.precision_root**2 * (by.series.diagonal() - shared)
    weight = direction**2
    along = group_sum(weight * residual, observations)
    pulled = weight * (residual - take(rank_one * along, observations.group))
    return pulled, weight * (1 - take(rank_one, observations.group) * weight)


def noise_deviation(problem: Problem, by: Whitener) -> Float[Array, " E"]:
    """Return the standard deviation of the noise of each entry, including the part common to a run, shape (E,)."""
    weight = by.precision_root**2
    direction = group_sum(by.direction**2, problem.observations)
    # shrink = (1 − 1/√(1 + T|u|²))/|u|² solved for T
    safe = jnp.where(direction > 0, direction, 1.0)
    shared = ((1 - by.shrink * direction) ** -2 - 1) / safe
    return jnp.sqrt(1 / jnp.where(weight > 0, weight, jnp.inf) + shared[problem.observations.group])
