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

All of it is algebra of arrays: NumPy computes it if the arguments are NumPy's, and JAX if they are its own.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from imubayes.foundations.arrays import Array, Float, Int, Scalar, add_at, gammaln, namespace, scan, take
from imubayes.model.nodes_and_entries import Timeline
from imubayes.model.problem import Observations, Problem, evaluated, shared_variance_of, variance_of
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
        xp = namespace(x, self.variance)

        def step(state, row):
            value, mean, over_gap, over_row, gain, variance = row
            before = over_gap[..., None] * state
            innovation = value - xp.einsum("lj,ljc->lc", mean, before)
            after = over_row[..., None] * before + gain[..., None] * innovation[:, None, :]
            return after, innovation / xp.sqrt(variance)[:, None]

        return self._passed(step, x)

    def colour(self, x: Float[Array, "E *columns"]) -> Float[Array, "E *columns"]:
        """Return L x: noise of covariance R from independent normal values."""
        xp = namespace(x, self.variance)

        def step(state, row):
            value, mean, over_gap, over_row, gain, variance = row
            before = over_gap[..., None] * state
            innovation = value * xp.sqrt(variance)[:, None]
            after = over_row[..., None] * before + gain[..., None] * innovation[:, None, :]
            return after, innovation + xp.einsum("lj,ljc->lc", mean, before)

        return self._passed(step, x)

    def back(self, x: Float[Array, "E *columns"]) -> Float[Array, "E *columns"]:
        """Return Aᵀ x: `forward` passed from the last row to the first."""
        xp = namespace(x, self.variance)

        def step(later, row):
            value, mean, over_gap, over_row, gain, variance = row
            innovation = value / xp.sqrt(variance)[:, None] + xp.einsum("lj,ljc->lc", gain, later)
            here = over_row[..., None] * later - mean[..., None] * innovation[:, None, :]
            return over_gap[..., None] * here, innovation

        return self._passed(step, x, reverse=True)

    def diagonal(self) -> Float[Array, " E"]:
        """Return the diagonal of AᵀA = R⁻¹."""
        xp = namespace(self.variance)

        def step(later, row):
            mean, over_gap, over_row, gain, variance = row
            own = 1 / variance + xp.einsum("li,lij,lj->l", gain, later, gain)
            move = over_row[..., None] * xp.eye(mean.shape[-1])[None] - gain[..., None] * mean[:, None, :]
            here = mean[..., None] * mean[:, None, :] / variance[:, None, None]
            here = here + xp.einsum("lki,lkm,lmj->lij", move, later, move)
            return over_gap[..., None] * over_gap[:, None, :] * here, own

        rows = (self.mean, self.over_gap, self.over_row, self.gain, self.variance)
        lanes, states = self.mean.shape[1:]
        _, found = scan(step, xp.zeros((lanes, states, states)), rows, reverse=True)
        return take(found.reshape(-1), self.timeline.place)

    def log_determinants(self) -> Float[Array, " E"]:
        """Return what each entry adds to log det R."""
        return take(namespace(self.variance).log(self.variance).reshape(-1), self.timeline.place)

    def _passed(self, step, x, reverse: bool = False):
        xp = namespace(x, self.variance)
        values = x[:, None] if x.ndim == 1 else x
        laid = _in_lanes(self.timeline, values)
        rows = (laid, self.mean, self.over_gap, self.over_row, self.gain, self.variance)
        lanes, states = self.mean.shape[1:]
        _, found = scan(step, xp.zeros((lanes, states, values.shape[1])), rows, reverse=reverse)
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
    xp = namespace(total)

    def step(known, row):
        mean, end, over_gap, over_row, total = row
        before = over_gap[..., None] * over_gap[:, None, :] * known
        pulled = xp.einsum("lij,lj->li", before, mean)
        variance = total - xp.sum(mean * pulled, axis=-1)
        gain = (end - over_row * pulled) / variance[:, None]
        after = over_row[..., None] * over_row[:, None, :] * before
        after = after + variance[:, None, None] * gain[..., None] * gain[:, None, :]
        return after, (gain, variance)

    lanes, states = mean.shape[1:]
    _, (gain, variance) = scan(step, xp.zeros((lanes, states, states)), (mean, end, over_gap, over_row, total))
    return SlowSeries(timeline, mean, over_gap, over_row, gain, variance)


def _in_lanes(timeline: Timeline, values: Float[Array, "E C"]) -> Float[Array, "S L C"]:
    xp = namespace(values, timeline.lanes)
    return take(xp.concatenate([values, xp.zeros((1, values.shape[1]))]), timeline.lanes)


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
    return irls_weight(x, tail) / namespace(x, tail).sqrt(_flattened(x, tail))


def deviance_root_over_slope(x: Float[Array, "..."], tail: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return the signed root of the deviance over its derivative: the residual of its linearisation."""
    return x * _flattened(x, tail) / irls_weight(x, tail)


def fisher_information(tail: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return the Fisher information about the location, (ν + 1)/(ν + 3), for a scale of 1."""
    return (1 + tail) / (1 + 3 * tail)


def normaliser(tail: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return 2 log of the density of N(0, 1) over that of the t distribution, both at zero."""
    heavy, xp = tail > 0, namespace(tail)
    degrees = 1 / xp.where(heavy, tail, 1.0)
    at_zero = gammaln((degrees + 1) / 2) - gammaln(degrees / 2) - 0.5 * xp.log(degrees / 2)
    return xp.where(heavy, -2 * at_zero, 0.0)


def log_determinant_correction(tail: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return what one observation adds to the log determinant of the normal distribution of the same information."""
    return namespace(tail).log(fisher_information(tail)) + normaliser(tail)


def _flattened(x: Float[Array, "..."], tail: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return the deviance over x²: (1 + κ) log(1 + κx²)/(κx²)."""
    grown, xp = tail * x**2, namespace(x, tail)
    small = grown < _SMALL
    safe = xp.where(small, 1.0, grown)
    return (1 + tail) * xp.where(small, 1 - grown / 2 + grown**2 / 3, xp.log1p(safe) / safe)


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
        xp = namespace(x, self.correlation)
        return gain * x - carried * take(xp.concatenate([x, xp.zeros((1, *x.shape[1:]))]), self.before)

    def back(self, x: Float[Array, "E *columns"]) -> Float[Array, "E *columns"]:
        """Return Aᵀ x."""
        gain, carried = self._factors(x.ndim)
        return gain * x - add_at(len(x) + 1, self.before, carried * x)[:-1]

    def diagonal(self) -> Float[Array, " E"]:
        """Return the diagonal of AᵀA = R⁻¹."""
        gain, carried = self._factors(1)
        return gain**2 + add_at(len(gain) + 1, self.before, carried**2)[:-1]

    def log_determinants(self) -> Float[Array, " E"]:
        """Return what each entry adds to log det R."""
        return namespace(self.correlation).log1p(-(self.correlation**2))

    def _factors(self, dimensions: int):
        gain = 1 / namespace(self.correlation).sqrt(1 - self.correlation**2)
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
    xp = namespace(values, observations.members)
    if xp is np:
        return _grouped_sum(values, observations)
    padded = xp.concatenate([values, xp.zeros((1, *values.shape[1:]))])
    return take(padded, observations.members).sum(axis=1)


def _grouped_sum(values: np.ndarray, observations: Observations) -> np.ndarray:
    """Return the sums as `group_sum`: of rows in the order of their groups, which are rarely padded evenly."""
    count = observations.members.shape[0]
    if values.ndim == 1:
        return np.bincount(observations.group, values, count)
    order = np.argsort(observations.group, kind="stable")
    begin = np.searchsorted(observations.group[order], np.arange(count))
    some = np.diff(np.append(begin, len(order))) > 0
    found = np.zeros((count, *values.shape[1:]))
    if some.any():
        found[some] = np.add.reduceat(values[order], begin[some], axis=0)
    return found


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

    @property
    def scale(self) -> Float[Array, " E"]:
        """Scale of the independent part of each entry, shape (E,)."""
        return namespace(self.squared_scale).sqrt(self.squared_scale)


def noise_distribution(problem: Problem, h: Float[Array, " H"]) -> NoiseDistribution:
    """Return the distribution of the observations at hyperparameters h (in z)."""
    values, observations = problem.hyper_priors.values(h), problem.observations
    own, tail, shared = 0.0 * observations.value, None, np.zeros(observations.members.shape[0])
    for layer in problem.noise:
        if issubclass(layer.noise, components.EntryNoise):
            own = own + evaluated(layer, values, variance_of, observations.entry)
        elif issubclass(layer.noise, components.SharedNoise):
            shared = shared + evaluated(layer, values, shared_variance_of)
        elif issubclass(layer.noise, components.TailNoise):
            here = take(layer.tails(values), observations.group)
            tail = here if tail is None else tail + here
    return NoiseDistribution(own, shared, tail)


def whitener(problem: Problem, h: Float[Array, " H"]) -> Whitener:
    """Return the whitener at hyperparameters h (in z).

    Under heavy tails an entry has the Fisher information of its distribution as precision, and the log determinant
    includes the normaliser of that distribution.
    """
    noise = noise_distribution(problem, h)
    if noise.tail is None:
        return whitener_of(problem, h, noise.squared_scale, noise.shared_variance)
    by = whitener_of(problem, h, noise.squared_scale / fisher_information(noise.tail), noise.shared_variance)
    beyond = (problem.observations.weight * log_determinant_correction(noise.tail)).sum()
    return replace(by, log_determinant=by.log_determinant + beyond)


def whitener_of(
    problem: Problem, h: Float[Array, " H"], own: Float[Array, " E"], shared: Float[Array, " G"]
) -> Whitener:
    """Return the whitener of given variances.

    The inverse of D + T 1 1ᵀ with u = D^(−½) 1 has the root (I − κ û ûᵀ) D^(−½), κ = 1 − 1/√(1 + T |u|²); with rows
    that are correlated u = A D^(−½) 1 and the root is (I − κ û ûᵀ) A D^(−½), AᵀA = R⁻¹.
    """
    observations, xp = problem.observations, namespace(own, shared, h, problem.observations.weight)
    root = observations.weight / xp.sqrt(own)
    values = problem.hyper_priors.values(h)
    series = _series(problem, values) if problem.timeline is None else _slow_series(problem, values, root)
    along = root if series is None else series.forward(root)
    direction = group_sum(along**2, observations)
    gain = 1 + shared * direction
    safe = xp.where(direction > 0, direction, 1.0)
    shrink = (1 - 1 / xp.sqrt(gain)) / safe
    log_determinant = (observations.weight * xp.log(own)).sum() + xp.log(gain).sum()
    if series is not None:
        log_determinant = log_determinant + (observations.weight * series.log_determinants()).sum()
    return Whitener(root, shrink, log_determinant, series)


def rows_correlate(problem: Problem) -> bool:
    """Whether a member of the noise correlates the rows of a run."""
    return any(issubclass(layer.noise, components.SeriesNoise) for layer in problem.noise)


def row_correlations(problem: Problem, values: Float[Array, "*batch H"]) -> Float[Array, "*batch G"]:
    """Return the correlation of neighbouring rows of every run and channel, at values of the noise scales in SI."""
    one_row = np.zeros(problem.observations.in_time.shape[0])
    for layer in problem.noise:
        if issubclass(layer.noise, components.SeriesNoise):
            one_row = one_row + layer.correlations(values)
    return one_row


def _series(problem: Problem, values: Float[Array, " H"]) -> Series | None:
    """Return each entry's correlation with the one before it that is not masked; None if nothing correlates."""
    if not rows_correlate(problem):
        return None
    observations, one_row = problem.observations, row_correlations(problem, values)
    before = _row_before(observations)
    linked, xp = before < len(observations.value), namespace(before, one_row)
    rank = xp.concatenate([observations.rank, xp.zeros(1, dtype=observations.rank.dtype)])
    steps = xp.where(linked, observations.rank - rank[before], 1).astype(float)
    return Series(before, xp.where(linked, take(one_row, observations.group) ** steps, 0.0))


def _row_before(observations: Observations) -> Int[Array, " E"]:
    """Return the entry before each one in the same group, neither of them masked; E where there is none."""
    groups, most = observations.in_time.shape
    none, xp = len(observations.value), namespace(observations.in_time, observations.weight)
    seen = xp.concatenate([observations.weight > 0, xp.zeros(1, dtype=bool)])[observations.in_time]
    place = xp.where(seen, xp.arange(most)[None, :], -1)
    last = np.maximum.accumulate(place, axis=1) if xp is np else jax.lax.cummax(place, axis=1)
    last = xp.concatenate([xp.full((groups, 1), -1), last[:, :-1]], axis=1)
    entry = xp.where(last < 0, none, xp.take_along_axis(observations.in_time, xp.maximum(last, 0), axis=1))
    if xp is np:
        before = np.full(none + 1, none, dtype=entry.dtype)
        before[observations.in_time] = entry
    else:
        before = jnp.full(none + 1, none, dtype=entry.dtype).at[observations.in_time].set(entry)
    return xp.where(observations.weight > 0, before[:-1], none)


def _slow_series(problem: Problem, values: Float[Array, " H"], root: Float[Array, " E"]) -> SlowSeries:
    """Return the root of R⁻¹ under the slow noise of all members."""
    timeline = problem.timeline
    assert timeline is not None
    xp = namespace(values, root)
    parts = [
        layer.states(values, timeline.row) for layer in problem.noise if issubclass(layer.noise, components.SlowNoise)
    ]
    mean, end, over_gap, over_row = (
        xp.concatenate([getattr(part, name) for part in parts], axis=1)
        for name in ("mean", "end", "over_gap", "over_row")
    )
    variance = sum(part.variance for part in parts)
    return slow_series(timeline, components.StateCovariance(variance, mean, end, over_gap, over_row), root)


def whiten(problem: Problem, by: Whitener, residual: Float[Array, "E *columns"]) -> Float[Array, "E *columns"]:
    """Return Σ^(−½) · residual, of one or of many columns."""
    columns = (-1, *(1,) * (residual.ndim - 1))
    scaled, direction = by.scale(residual), by.direction.reshape(columns)
    along = group_sum(direction * scaled, problem.observations)
    return scaled - direction * take(by.shrink.reshape(columns) * along, problem.observations.group)


def inverse_covariance(
    problem: Problem, by: Whitener, residual: Float[Array, "E *columns"]
) -> tuple[Float[Array, "E *columns"], Float[Array, " E"]]:
    """Return Σ⁻¹ · residual, of one or of many columns, and the diagonal of Σ⁻¹, shape (E,)."""
    observations, columns = problem.observations, (-1, *(1,) * (residual.ndim - 1))
    direction = by.direction
    along_rows = direction.reshape(columns)
    # (I − κ û ûᵀ)² = I − (2 shrink − shrink² |u|²) u uᵀ, with shrink = κ/|u|²
    rank_one = 2 * by.shrink - by.shrink**2 * group_sum(direction**2, observations)
    scaled = by.scale(residual)
    along = group_sum(along_rows * scaled, observations)
    left = scaled - along_rows * take(rank_one.reshape(columns) * along, observations.group)
    of_rows = take(rank_one, observations.group)
    root = by.precision_root
    if by.series is None:
        return root.reshape(columns) * left, root**2 * (1 - of_rows * direction**2)
    diagonal = by.series.diagonal() - of_rows * by.series.back(direction) ** 2
    return root.reshape(columns) * by.series.back(left), root**2 * diagonal


def noise_deviation(problem: Problem, by: Whitener) -> Float[Array, " E"]:
    """Return the standard deviation of the noise of each entry, including the part common to a run, shape (E,)."""
    weight, xp = by.precision_root**2, namespace(by.precision_root)
    direction = group_sum(by.direction**2, problem.observations)
    # shrink = (1 − 1/√(1 + T|u|²))/|u|² solved for T
    safe = xp.where(direction > 0, direction, 1.0)
    shared = ((1 - by.shrink * direction) ** -2 - 1) / safe
    return xp.sqrt(1 / xp.where(weight > 0, weight, xp.inf) + shared[problem.observations.group])
