"""Structure of a population: one group, several groups, a step or a trend over dates or serial numbers, or a covariate.

The estimates yᵢ with variances vᵢ of n units follow

    yᵢ ~ (1 − ε) Σ_k π_k N(c + xᵢᵀβ + δ_k, τ² + vᵢ)  +  ε N(m, W² + vᵢ).

c is the location, xᵢ the known design of a law (a step, a trend, the levels of a covariate), δ_k the offset of a group
whose members are not known, and τ the spread within a group.  The last term is a unit that belongs to no group: W is
the width that the parameter may have at all, and m the median.  The priors are flat on c, N(0, D²) on β and δ, uniform
on π, and 1/(τ + s) on τ.  D is W or the range of the estimates, the smaller one, and s a third of a typical standard
uncertainty.  They are the same in all laws, so that the evidences compare.

The evidence of a law is integrated over τ on a grid.  At each τ the other parameters are found by expectation and
maximisation (Dempster, Laird & Rubin 1977) and integrated by Laplace's method with the information of the complete
data, π by the beta integral.  That information is too large if memberships are uncertain, so that the evidence of
groups is a lower bound.  Groups closer than two spreads are no groups: their mixture has one maximum, and a skewed law
of one group would pass for two.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import gammaln

CONTAMINATION = 0.01
"""Prior probability of a unit to belong to no group (convention)."""
LEAST_APART = 2.0
"""Fewest spreads between two groups: a mixture of closer ones has one maximum (derived, equal weights)."""
TAILS = 3.0
"""Ratio of the spreads of the two parts of a law with heavy tails (convention)."""
_TAUS, _COARSE, _STARTS = 48, 6, 8
_ROUNDS, _FEW_ROUNDS, _SETTLED = 30, 6, 1e-4
# A single unit is no group: it lies outside.
_LEAST_MEMBERS = 1.5
_NEARLY_FLAT = 1e-8


@dataclass(frozen=True)
class UnitEstimates:
    """Estimates of one parameter in n units.

    Attributes
    ----------
    estimate, variance : shape (n,), the prior of the model divided out.
    width : that the parameter may have at all, from the prior of its model.
    """

    estimate: np.ndarray
    variance: np.ndarray
    width: float

    @cached_property
    def middle(self) -> float:
        """Median of the estimates, about which a unit outside all groups lies."""
        return float(np.median(self.estimate))

    @cached_property
    def difference(self) -> float:
        """Standard deviation of the prior of differences between groups."""
        return min(self.width, float(np.ptp(self.estimate)) or self.width)

    @cached_property
    def spreads(self) -> np.ndarray:
        """Grid of τ, equal steps of the logarithm of τ + s, from 0 to three times the range."""
        least = np.sqrt(np.median(self.variance)) / 3 + 1e-12 * self.width
        most = 3 * np.ptp(self.estimate) + least
        return np.geomspace(least, most + least, _TAUS) - least


@dataclass(frozen=True)
class Law:
    """A law of the population.

    Attributes
    ----------
    design : shape (n, q), of the differences that are known but for their size.
    components : factors of the spread of the unknown groups: one of the same location, ``(1, TAILS)`` for heavy tails.
    groups : number of groups of unknown members.
    """

    design: np.ndarray
    groups: int = 1
    components: tuple[float, ...] = (1.0,)

    @property
    def count(self) -> int:
        """Number of components with a probability of their own."""
        return self.groups * len(self.components)


@dataclass(frozen=True)
class LawFit:
    """A law fitted to units.

    Attributes
    ----------
    log_evidence : up to a constant that all laws share.
    coefficients, covariance : shapes (p,), (p, p), of c, β and the offsets of the groups after the first.
    membership : shape (n, K + 1), probability of a unit to belong to each component; the last belongs to none.
    spread : τ, posterior mean.
    """

    law: Law
    log_evidence: float
    coefficients: np.ndarray
    covariance: np.ndarray
    membership: np.ndarray
    spread: float


def fit_law(units: UnitEstimates, law: Law) -> LawFit:
    """Return a law fitted to units: the best of several starts on a coarse grid of τ is fitted on the whole grid."""
    starts = list(_starts(units, law))
    if len(starts) > 1:
        coarse = [_fit_from(units, law, start, units.spreads[::_COARSE], _FEW_ROUNDS) for start in starts]
        starts = [max(coarse, key=lambda each: each.log_evidence).membership[:, :-1]]
    return _fit_from(units, law, starts[0], units.spreads, _ROUNDS)


def _starts(units: UnitEstimates, law: Law) -> Iterator[np.ndarray]:
    """Yield memberships to begin with, (n, K)."""
    count = len(units.estimate)
    if law.groups == 1:
        yield np.full((count, law.count), 1 / law.count)
        return
    rest = units.estimate - _of_design(units, law.design)
    order = np.argsort(rest)
    for cuts in _partitions(rest[order], law.groups):
        group = np.empty(count, dtype=int)
        group[order] = np.searchsorted(np.asarray(cuts), np.arange(count), side="right")
        yield np.eye(law.groups)[group] * 0.98 + 0.02 / law.groups


def _of_design(units: UnitEstimates, design: np.ndarray) -> np.ndarray:
    """Return what a known design explains, by least squares, (n,)."""
    if not design.shape[1]:
        return np.zeros(len(units.estimate))
    columns = np.column_stack([np.ones(len(design)), design])
    solution = np.linalg.lstsq(columns, units.estimate, rcond=None)[0]
    return design @ solution[1:]


def _partitions(ordered: np.ndarray, groups: int) -> Iterator[tuple[int, ...]]:
    """Yield the places where ordered values are cut into groups: by their gaps, and by their sums of squares."""
    gaps = np.argsort(-np.diff(ordered))[: _STARTS // 2] + 1
    tried: set[tuple[int, ...]] = set()
    singles = [(int(cut),) for cut in (*gaps, *_least_squares_cuts(ordered))]
    for cuts in singles if groups == 2 else _grown(ordered, singles, groups):
        if cuts not in tried:
            tried.add(cuts)
            yield cuts


def _least_squares_cuts(ordered: np.ndarray) -> list[int]:
    """Return the cuts into two with the least sums of squares, best first."""
    count = len(ordered)
    before, total = np.cumsum(ordered)[:-1], ordered.sum()
    size = np.arange(1, count)
    between = before**2 / size + (total - before) ** 2 / (count - size)
    return [int(place) + 1 for place in np.argsort(-between)[: _STARTS // 2]]


def _grown(ordered: np.ndarray, singles: Sequence[tuple[int, ...]], groups: int) -> Iterator[tuple[int, ...]]:
    """Yield cuts into more than two groups: the best further cut is added to each until there are enough."""
    for cuts in singles:
        chosen = list(cuts)
        while len(chosen) < groups - 1:
            rest = [place for place in range(1, len(ordered)) if place not in chosen]
            if not rest:
                return
            chosen.append(min(rest, key=lambda place: _within(ordered, sorted([*chosen, place]))))
        yield tuple(sorted(chosen))


def _within(ordered: np.ndarray, cuts: Sequence[int]) -> float:
    return sum(float(np.var(part)) * len(part) for part in np.split(ordered, cuts))


@dataclass(frozen=True)
class _Maximum:
    """A law at the maximum over its parameters, for each of T values of τ; estimates are about their median.

    Attributes
    ----------
    coefficients, gram : shapes (T, p), (T, p, p).
    shares : shape (T, K), probabilities of the components.
    membership, outside : shapes (T, n, K), (T, n, 1).
    log_likelihood : shape (T,).
    """

    coefficients: np.ndarray
    gram: np.ndarray
    shares: np.ndarray
    membership: np.ndarray
    outside: np.ndarray
    log_likelihood: np.ndarray


def _fit_from(units: UnitEstimates, law: Law, start: np.ndarray, taus: np.ndarray, rounds: int) -> LawFit:
    """Return a law fitted by expectation and maximisation from given memberships, on a grid of τ at once."""
    columns, precision, centred = _columns(units, law), _prior_precision(units, law), units.estimate - units.middle
    factor = np.repeat(np.asarray(law.components), law.groups)
    variance = (taus[:, None, None] * factor) ** 2 + units.variance[:, None]

    def step(membership: np.ndarray) -> _Maximum:
        coefficients, gram = _weighted_least_squares(columns, centred, membership / variance, precision)
        shares = membership.sum(axis=1) + 1.0
        shares /= shares.sum(axis=1, keepdims=True)
        fitted = np.einsum("knp,tp->tnk", columns, coefficients)
        log_density = np.log(shares)[:, None, :] + _log_normal(centred[:, None] - fitted, variance)
        return _Maximum(coefficients, gram, shares, *_memberships(units, log_density))

    before = np.broadcast_to(start, (len(taus), *start.shape))
    found = step(before)
    for _ in range(rounds - 1):
        if np.max(np.abs(found.membership - before)) < _SETTLED:
            break
        before = found.membership
        found = step(before)
    log_weight = found.log_likelihood + _log_volume(units, law, found, precision)
    if law.groups > 1:
        several = found.membership.sum(axis=1).min(axis=1) > _LEAST_MEMBERS
        log_weight = np.where(_apart(law, found.coefficients, taus) & several, log_weight, -np.inf)
    return _averaged(units, law, log_weight, taus, found)


def _weighted_least_squares(
    columns: np.ndarray, estimate: np.ndarray, weight: np.ndarray, precision: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return coefficients (T, p) and their precision (T, p, p) for weights (T, n, K) and columns (K, n, p)."""
    size = columns.shape[2]
    gram = np.broadcast_to(precision, (len(weight), size, size)).copy()
    pulled = np.zeros((len(weight), size))
    for place, own in enumerate(columns):
        products = (own[:, :, None] * own[:, None, :]).reshape(len(own), -1)
        gram += (weight[:, :, place] @ products).reshape(-1, size, size)
        pulled += weight[:, :, place] @ (own * estimate[:, None])
    return np.linalg.solve(gram, pulled[..., None])[..., 0], gram


def _averaged(units: UnitEstimates, law: Law, log_weight: np.ndarray, taus: np.ndarray, found: _Maximum) -> LawFit:
    """Return the average over the grid of τ, equal steps of which have equal prior weight."""
    log_evidence = float(np.logaddexp.reduce(log_weight)) - np.log(len(taus))
    weight = np.exp(log_weight - np.max(log_weight)) if np.isfinite(log_evidence) else np.full(len(taus), 1.0)
    weight = weight / weight.sum()
    mean = weight @ found.coefficients
    spread = found.coefficients - mean
    covariance = np.einsum("t,tpq->pq", weight, np.linalg.inv(found.gram))
    covariance += np.einsum("t,tp,tq->pq", weight, spread, spread)
    belongs = np.concatenate([found.membership, found.outside], axis=2)
    mean[0] += units.middle
    return LawFit(law, log_evidence, mean, covariance, np.einsum("t,tnk->nk", weight, belongs), float(weight @ taus))


def _columns(units: UnitEstimates, law: Law) -> np.ndarray:
    """Return the design of each component, (K, n, p): the location, the known differences, the offset of the group."""
    count = len(units.estimate)
    own = []
    for _ in law.components:
        for group in range(law.groups):
            offset = np.zeros((count, law.groups - 1))
            if group:
                offset[:, group - 1] = 1.0
            own.append(np.column_stack([np.ones(count), law.design, offset]))
    return np.stack(own)


def _prior_precision(units: UnitEstimates, law: Law) -> np.ndarray:
    size = 1 + law.design.shape[1] + law.groups - 1
    precision = np.eye(size) / units.difference**2
    # Flat but for a width that keeps the equations regular if every unit lies outside.
    precision[0, 0] *= _NEARLY_FLAT
    return precision


def _log_normal(distance: np.ndarray, variance: np.ndarray) -> np.ndarray:
    return -0.5 * (distance**2 / variance + np.log(2 * np.pi * variance))


def _memberships(units: UnitEstimates, log_density: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the memberships in each component and in none, and the log likelihood, on the grid of τ."""
    away = _log_normal(units.estimate - units.middle, units.width**2 + units.variance)
    away = np.broadcast_to(np.log(CONTAMINATION) + away[None, :, None], (*log_density.shape[:2], 1))
    every = np.concatenate([np.log1p(-CONTAMINATION) + log_density, away], axis=2)
    total = np.logaddexp.reduce(every, axis=2)
    share = np.exp(every - total[:, :, None])
    return share[:, :, :-1], share[:, :, -1:], total.sum(axis=1)


def _log_volume(units: UnitEstimates, law: Law, found: _Maximum, prior: np.ndarray) -> np.ndarray:
    """Return the logarithm of the prior at the maximum times the volume about it, on the grid of τ."""
    coefficients, shares = found.coefficients, found.shares
    size = coefficients.shape[1]
    widths = -(size - 1) * (np.log(units.difference) + 0.5 * np.log(2 * np.pi))
    at_mode = widths - 0.5 * coefficients[:, 1:] ** 2 @ np.diag(prior)[1:]
    volume = 0.5 * size * np.log(2 * np.pi) - 0.5 * np.linalg.slogdet(found.gram)[1]
    count = len(units.estimate)
    members = shares * (count + law.count) - 1
    # The likelihood holds π at its maximum: the integral over a uniform π, relative to that value.
    labels = gammaln(law.count) + gammaln(members + 1).sum(axis=1) - gammaln(members.sum(axis=1) + law.count)
    labels -= np.sum(members * np.log(shares), axis=1)
    return at_mode + volume + labels + gammaln(law.groups + 1)


def _apart(law: Law, coefficients: np.ndarray, taus: np.ndarray) -> np.ndarray:
    """Return whether all groups are apart, on the grid of τ."""
    offsets = np.concatenate([np.zeros((len(taus), 1)), coefficients[:, -(law.groups - 1) :]], axis=1)
    return np.min(np.diff(np.sort(offsets, axis=1), axis=1), axis=1) > LEAST_APART * taus
