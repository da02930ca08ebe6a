"""Information of the data on θ at any noise scales, from statistics that are taken once about a linearisation.

Rows that have the same variance v at every h form a class, and the rows of one class in one run and channel a cell.
With unit weights a class has the statistics A = JᵀJ, a = Jᵀe, c = eᵀe and n, and a cell the sums m of its rows of J,
s of e and n.  With Σ(h) = D + Σ_g T_g 1 1ᵀ they give, p = 1/v,

    Λ = Σ p A − Σ_g ω_g m_g m_gᵀ + π,  b = Σ p a − Σ_g ω_g s_g m_g − π z,  ω_g = T_g/(1 + T_g n_g),

with m_g, s_g and n_g the sums of p m, p s and p n over the cells of g, and π the precision of the prior.  The Laplace
marginal −½ q + ½ bᵀΛ⁻¹b − ½ log det Λ − ½ log det Σ then has a gradient in closed form: traces of A with Λ⁻¹.

That holds if noise is normal and rows are independent but for the offset of their run; `scale_statistics` returns
None elsewhere, and the marginal is differentiated automatically.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import equinox as eqx
import jax
import numpy as np

from imubayes.foundations.arrays import Scalars, cholesky, inverse_lower, solve_each
from imubayes.inference.alike_groups import AlikeGroups, alike_groups, one_hot
from imubayes.model.likelihood import has_heavy_tails
from imubayes.model.noise_covariance import rows_correlate
from imubayes.model.problem import (
    NoiseLayer,
    Problem,
    evaluated,
    hyper_prior_square,
    prior_widths,
    shared_variance_of,
    slopes_of,
    variance_of,
)
from imubayes.noise.components import Entry, EntryNoise, SharedNoise

# Rows are of one class if their variances agree to so many digits at the middle of the prior and at a few points
# besides.
_DIGITS, _PROBES = 10, 3
# Above so many numbers in the statistics of all classes, products of rows are formed anew for each h.
_MOST_STORED = 4_000_000
# Noise scales whose precisions are formed together: of more, what is read again is no longer in the cache.
_AT_ONCE = 32


@dataclass(frozen=True)
class NormalDensity:
    """The normal density of θ about a linearisation, the prior included, for noise scales (…, H).

    Attributes
    ----------
    precision, gradient : Λ, shape (…, P, P), and b, shape (…, P).
    square, log_determinant : shape (…), the quadratic form q at ẑ, and log det Σ − log det π.
    """

    precision: np.ndarray
    gradient: np.ndarray
    square: Scalars
    log_determinant: Scalars


@dataclass(frozen=True)
class RowClasses:
    """Classes of rows, and the noise that each is subject to.

    Attributes
    ----------
    class_of : shape (E,), class of each row; K for one that is masked out.
    layers, entry : noise of the independent part, for one row of each class.
    shared : noise that the rows of a run and channel share.
    cell_class, cell_group : shape (C,), class and place among `groups` of each cell; only of runs that share noise.
    cell_of : shape (E,), cell of each row; C where it has none.
    groups : shape (S,), runs and channels that share noise.
    probed : shape (n, S), the variance that the rows of each group share, at the points by which classes are told.
    """

    class_of: np.ndarray
    layers: tuple[NoiseLayer, ...]
    entry: Entry
    shared: tuple[NoiseLayer, ...]
    cell_class: np.ndarray
    cell_group: np.ndarray
    cell_of: np.ndarray
    groups: np.ndarray
    probed: np.ndarray

    @property
    def count(self) -> int:
        """Number K of classes."""
        return len(self.entry.samples)

    @cached_property
    def turns(self) -> list[tuple[np.ndarray | slice, np.ndarray]]:
        """The cells, one of each group in turn: places among `groups`, and cells."""
        nth = np.arange(len(self.cell_group)) - np.searchsorted(self.cell_group, self.cell_group)
        turns = [np.flatnonzero(nth == k) for k in range(nth.max(initial=-1) + 1)]
        whole = len(self.groups)  # a slice takes no copy
        return [(slice(None) if len(cells) == whole else self.cell_group[cells], cells) for cells in turns]

    def variances(self, values: np.ndarray) -> np.ndarray:
        """Return the variance of each class, (…, K), at values of the noise parameters (…, H), SI."""
        found = np.zeros((*values.shape[:-1], self.count))
        for layer in self.layers:
            found = found + evaluated(layer, values, variance_of, self.entry)
        return found

    def shared_variances(self, values: np.ndarray) -> np.ndarray:
        """Return the variance that the rows of each of `groups` share, (…, S)."""
        found = np.zeros((*values.shape[:-1], len(self.groups)))
        for layer in self.shared:
            found = found + evaluated(layer, values, shared_variance_of)
        return found


def row_classes(problem: Problem) -> RowClasses | None:
    """Return the classes of rows; None if rows are correlated or have heavy tails."""
    if problem.timeline is not None or rows_correlate(problem) or has_heavy_tails(problem):
        return None
    observations, values = problem.observations, problem.hyper_priors.values
    own = tuple(layer for layer in problem.noise if issubclass(layer.noise, EntryNoise))
    shared = tuple(layer for layer in problem.noise if issubclass(layer.noise, SharedNoise))
    random = np.random.default_rng(0)
    probes = np.concatenate([np.zeros((1, problem.size[1])), random.normal(size=(_PROBES, problem.size[1]))])
    variances = sum(layer.entry_variances(values(probes), observations.entry) for layer in own)
    there = np.flatnonzero(observations.weight > 0)
    signature = np.round(np.log(np.asarray(variances).T[there]), _DIGITS)
    _, first, inverse = np.unique(signature, axis=0, return_index=True, return_inverse=True)
    class_of = np.full(len(observations.value), len(first))
    class_of[there] = inverse
    acts = sum((np.asarray(layer.acts) for layer in shared), np.zeros(observations.members.shape[0]))
    groups = np.flatnonzero(acts > 0)
    place = np.full(len(acts), -1)
    place[groups] = np.arange(len(groups))
    group_of = np.where(class_of < len(first), place[observations.group], -1)
    in_cell = np.flatnonzero(group_of >= 0)
    cells, cell = np.unique(np.stack([group_of, class_of])[:, in_cell], axis=1, return_inverse=True)
    cell_of = np.full(len(class_of), cells.shape[1])
    cell_of[in_cell] = cell.reshape(-1)
    rows = there[first]
    classes = RowClasses(
        class_of, tuple(_at(layer, rows) for layer in own), jax.tree.map(lambda leaf: leaf[rows], observations.entry),
        tuple(_at(layer, groups) for layer in shared), cells[1], cells[0], cell_of, groups, np.zeros((0, len(groups))),
    )  # fmt: skip
    return replace(classes, probed=classes.shared_variances(values(probes)))


def _at(layer: NoiseLayer, rows: np.ndarray) -> NoiseLayer:
    chosen = {field: np.asarray(place)[rows] for field, place in layer.places.items()}
    return eqx.tree_at(lambda known: (known.places, known.acts), layer, (chosen, np.asarray(layer.acts)[rows]))


@dataclass(frozen=True)
class ScaleStatistics:
    """Statistics of a linearisation, and the marginal of the noise scales that they give.

    Attributes
    ----------
    classes : of the rows.
    z : shape (P,), if the model is linearised.
    jacobian, ordered : rows of the Jacobian (n, P) by classes, and the class of each.
    gram : shape (K, P²), sums of products of rows of the Jacobian; None if it is not stored.
    pulled : shape (K, P), JᵀE of each class; square, rows : shape (K,), sums of squared misfits, and number of rows.
    along, misfit, size : shapes (C, P), (C,), (C,), sums over each cell of the Jacobian, of the misfit, and of rows.
    alike : what the rows of groups share, by kinds of groups; None if it is summed group by group.
    """

    problem: Problem
    classes: RowClasses
    z: np.ndarray
    jacobian: np.ndarray
    ordered: np.ndarray
    gram: np.ndarray | None
    pulled: np.ndarray
    square: np.ndarray
    rows: np.ndarray
    along: np.ndarray
    misfit: np.ndarray
    size: np.ndarray
    alike: AlikeGroups | None

    def normal(self, h: np.ndarray) -> NormalDensity:
        """Return the density of θ at noise scales (…, H)."""
        return self._known(self.problem.hyper_priors.values(h), prior_widths(self.problem, h) ** -2)

    def log_marginals(self, h: np.ndarray) -> np.ndarray:
        """Return log p(y, h) with θ integrated out at several noise scales (n, H); shape (n,)."""
        return np.concatenate([self._log_marginals(some) for some in _blocks(h)])

    def _log_marginals(self, h: np.ndarray) -> np.ndarray:
        known = self.normal(h)
        factor = cholesky(known.precision)
        half = solve_each(factor, known.gradient)
        return self._value(h, known, factor, np.sum(half**2, axis=1))

    def slopes(self, h: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return log p(y, h) with θ integrated out, (n,), and its gradient, (n, H), at noise scales (n, H)."""
        parts = [self._slopes(some) for some in _blocks(h)]
        return np.concatenate([value for value, _ in parts]), np.concatenate([gradient for _, gradient in parts])

    def _slopes(self, h: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        problem, classes = self.problem, self.classes
        values, widths = problem.hyper_priors.values(h), prior_widths(problem, h)
        prior = widths**-2
        known = self._known(values, prior)
        factor = cholesky(known.precision)
        half = inverse_lower(factor)
        inverse = np.swapaxes(half, 1, 2) @ half
        step = (inverse @ known.gradient[..., None])[..., 0]
        value = self._value(h, known, factor, np.sum(known.gradient * step, axis=1))

        weight, shared = 1 / classes.variances(values), classes.shared_variances(values)
        of_weight = (
            -0.5 * (self.square + self._moments(inverse, step)) + step @ self.pulled.T + 0.5 * self.rows / weight
        )
        in_common, of_shared = self._of_common_noise(weight, shared, inverse, step)
        of_weight = of_weight + in_common
        of_prior = 0.5 * (1 / prior - (self.z + step) ** 2 - np.diagonal(inverse, axis1=1, axis2=2))
        by_values = self._by_values(values, -(weight**2) * of_weight, of_shared, of_prior * -2 * widths**-3)
        return value, by_values * problem.hyper_priors.slopes(h) - self._prior_pull(h)

    def _of_common_noise(
        self, weight: np.ndarray, shared: np.ndarray, inverse: np.ndarray, step: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivatives of what `_taken` takes, by 1/v of classes, (n, K), and by shared variances, (n, S)."""
        if self.alike is not None:
            moments = _moment(inverse, step).reshape(len(step), -1) @ self.alike.gram.T
            of_pairs = 0.5 * (self.alike.square + moments) - step @ self.alike.pulled.T
            return self.alike.slopes(weight, shared, of_pairs)
        along, misfit, size = self._of_groups(weight)
        drawn, left = shared / (1 + shared * size), misfit - (along @ step[..., None])[..., 0]
        spread = along @ inverse
        mean_square = left**2 + np.sum(spread * along, axis=-1)
        group, cells = self.classes.cell_group, self.classes.cell_class
        of_cell = (
            drawn[:, group]
            * (left[:, group] * (self.misfit - step @ self.along.T) + np.sum(self.along * spread[:, group], axis=-1))
            - 0.5 * self.size * (drawn**2 * mean_square + drawn)[:, group]
        )
        of_shared = 0.5 * (mean_square / (1 + shared * size) ** 2 - size / (1 + shared * size))
        return of_cell @ one_hot(cells, self.classes.count), of_shared

    def _value(self, h: np.ndarray, known: NormalDensity, factor: np.ndarray, explained: np.ndarray) -> np.ndarray:
        """Return log p(y, h), (n,), from bᵀΛ⁻¹b, (n,), which θ explains of the quadratic form at ẑ."""
        half = np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
        constant = 0.5 * np.log(2 * np.pi) * (self.rows.sum() + h.shape[1])
        square = known.square + hyper_prior_square(self.problem, h)
        return 0.5 * (explained - square - known.log_determinant) - half - constant

    def _known(self, values: np.ndarray, prior: np.ndarray) -> NormalDensity:
        weight, shared = 1 / self.classes.variances(values), self.classes.shared_variances(values)
        taken = self._taken(weight, shared)
        precision = self._weighted(weight)
        precision -= taken.precision
        count = np.arange(len(self.z))
        precision[..., count, count] += prior
        pulled = weight @ self.pulled - taken.gradient - prior * self.z
        square = weight @ self.square - taken.square + (prior * self.z**2).sum(-1)
        log_determinant = taken.log_determinant - np.log(weight) @ self.rows - np.log(prior).sum(-1)
        return NormalDensity(precision, pulled, square, log_determinant)

    def _taken(self, weight: np.ndarray, shared: np.ndarray) -> NormalDensity:
        """Return what rows with noise in common take from the density of independent ones."""
        if self.alike is not None:
            pairs, log_gain = self.alike.weights(weight, shared)
            precision = (pairs @ self.alike.gram).reshape(*weight.shape[:-1], len(self.z), len(self.z))
            return NormalDensity(precision, pairs @ self.alike.pulled, pairs @ self.alike.square, log_gain)
        along, misfit, size = self._of_groups(weight)
        gain = 1 + shared * size
        drawn = shared / gain
        # Of one array with itself BLAS forms half.
        root = np.sqrt(drawn)[..., None] * along
        gradient = ((drawn * misfit)[..., None, :] @ along)[..., 0, :]
        square, log_gain = (drawn * misfit**2).sum(-1), np.log(gain).sum(-1)
        return NormalDensity(np.swapaxes(root, -1, -2) @ root, gradient, square, log_gain)

    def _of_groups(self, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the weighted sums of the Jacobian (…, S, P), the misfit (…, S), and the information (…, S)."""
        of_cell = weight[..., self.classes.cell_class]
        along = np.zeros((*weight.shape[:-1], len(self.classes.groups), len(self.z)))
        for groups, cells in self.classes.turns:
            along[..., groups, :] += of_cell[..., cells, None] * self.along[cells]
        return along, self._summed(of_cell * self.misfit), self._summed(of_cell * self.size)

    def _summed(self, of_cells: np.ndarray) -> np.ndarray:
        """Return sums (…, S) over the cells (…, C) of each run and channel."""
        found = np.zeros((*of_cells.shape[:-1], len(self.classes.groups)))
        for groups, cells in self.classes.turns:
            found[..., groups] += of_cells[..., cells]
        return found

    def _weighted(self, weight: np.ndarray) -> np.ndarray:
        """Return Σ p A, shape (…, P, P)."""
        size = len(self.z)
        if self.gram is not None:
            return (weight @ self.gram).reshape(*weight.shape[:-1], size, size)
        rows = weight[..., self.ordered]
        return self.jacobian.T @ (rows[..., None] * self.jacobian)

    def _moments(self, inverse: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Return the trace of A with Λ⁻¹ + δδᵀ of each class, (n, K)."""
        moment = _moment(inverse, step)
        if self.gram is not None:
            return moment.reshape(len(step), -1) @ self.gram.T
        each = np.sum((self.jacobian @ moment) * self.jacobian, axis=-1)
        return np.stack([np.bincount(self.ordered, one, self.classes.count) for one in each])

    def _by_values(self, values: np.ndarray, of_own: np.ndarray, of_shared: np.ndarray, of_widths: np.ndarray):
        """Return the derivative by the noise parameters in SI, (n, H), from those by variances and prior widths."""
        problem, classes = self.problem, self.classes
        found, count = np.zeros(values.shape), values.shape[1]
        for layer in classes.layers:
            for place, slope in slopes_of(layer, values, variance_of, classes.entry):
                found += (slope * of_own) @ one_hot(place, count)
        for layer in classes.shared:
            for place, slope in slopes_of(layer, values, shared_variance_of):
                found += (slope * of_shared) @ one_hot(place, count)
        learnt = problem.spread_of < count
        if learnt.any():
            found += (of_widths / problem.spread_unit)[:, learnt] @ one_hot(problem.spread_of[learnt], count)
        return found

    def _prior_pull(self, h: np.ndarray) -> np.ndarray:
        correlation = self.problem.hyper_correlation
        return h if correlation is None else correlation.pull(h.T).T


def _moment(inverse: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Return Λ⁻¹ + δδᵀ, (n, P, P)."""
    return inverse + step[:, :, None] * step[:, None, :]


def _blocks(h: np.ndarray) -> list[np.ndarray]:
    return np.split(h, range(_AT_ONCE, len(h), _AT_ONCE))


def scale_statistics(
    problem: Problem, classes: RowClasses | None, z: np.ndarray, misfit: np.ndarray, jacobian: np.ndarray
) -> ScaleStatistics | None:
    """Return the statistics of a linearisation; None if there are no classes.

    Parameters
    ----------
    z, misfit, jacobian : shapes (P,), (E,) and (E, P), the model linearised about z.
    """
    if classes is None:
        return None
    order = np.argsort(classes.class_of, kind="stable")
    order = order[classes.class_of[order] < classes.count]
    rows, of, e = jacobian[order], classes.class_of[order], misfit[order]
    begin = np.searchsorted(of, np.arange(classes.count + 1))
    parts = [slice(*ends) for ends in pairwise(begin)]
    stored = classes.count * len(z) ** 2 <= min(_MOST_STORED, len(of) * len(z) ** 2)
    gram = np.stack([(rows[part].T @ rows[part]).reshape(-1) for part in parts]) if stored else None
    pulled = np.stack([rows[part].T @ e[part] for part in parts])
    square = np.array([e[part] @ e[part] for part in parts])
    cells, cell = len(classes.cell_class), classes.cell_of[order]
    along = np.zeros((cells + 1, len(z)))
    np.add.at(along, cell, rows)
    of_misfit, of_rows = (np.bincount(cell, each, cells + 1)[:cells] for each in (e, np.ones(len(e))))
    sums, alike = (along[:cells], of_misfit, of_rows), None
    if stored:
        alike = alike_groups(classes.cell_class, classes.cell_group, classes.probed, classes.count, sums)
    size = np.diff(begin).astype(float)
    return ScaleStatistics(
        problem, classes, z, rows, of, gram, pulled, square, size, along[:cells], of_misfit, of_rows, alike
    )
