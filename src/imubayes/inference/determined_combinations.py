"""Combinations of parameters that the data determine although they do not determine the parameters themselves.

A weak direction leaves all its members uncertain, but not every function of them: D_F and D_II of a tumble may be known
to 0.06 °/h each and their sum to 0.002 °/h.  Members are the parameters whose posterior variance comes mostly from
weak directions.  With C their posterior covariance a combination wᵀx is determined where √(wᵀCw) is much less than
|w_i| √C_ii of every member: it is the residual of the regression of one member on some others.

The standard combinations of the procedures come first, then for every member the regression on the fewest others,
which is sparse where an echelon form of the well-determined subspace is not, with coefficients rounded as far as the
uncertainty allows.  Every combination that is returned adds a direction to those before it.  Since the weights are
constants, the posterior of a combination is calibrated as that of its members is, whatever the rounding.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from imubayes.inference.identifiability import WEAK_SHARE
from imubayes.procedures.standard_combinations import LinearCombination, ProjectedScaleFactor, StandardCombination

# A parameter is a member where weak directions contribute more than this share of its posterior variance.
_FROM_WEAK = 0.5
# A combination is determined where its standard deviation is below this share of that of each of its members.
MUCH_LESS = 0.2
# Another member is worth while where it divides the standard deviation by this; what it adds must be that much larger
# than what rounding its weight may add.
_WORTH, _ROUNDING_COST = 4.0, 1.25
_MOST_MEMBERS, _MOST_DIGITS = 8, 5
# Least part of a combination, in units of the posterior standard deviations of its members, that is new.
_LEAST_NEW = 0.1
# Correlation: a member with less variance than this left is a function of those chosen before it.
_SINGULAR = 1e-13


@dataclass(frozen=True)
class DeterminedCombination:
    """constant + wᵀx, or k cos θ.

    Attributes
    ----------
    quantities : names of the members; of k cos θ the scale factor and the angle.
    weights : of the members, in `unit` over the unit of each; None for k cos θ.
    unit : of the combination.
    constant : in `unit`.
    symbol : of the standard combination; empty for one that has none.
    """

    quantities: tuple[str, ...]
    weights: tuple[float, ...] | None
    unit: str
    constant: float = 0.0
    symbol: str = ""


class Draws(NamedTuple):
    """Posterior draws of quantities: names, units, and values in these units, shape (S, n)."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: np.ndarray


def members(precision: np.ndarray) -> np.ndarray:
    """Return which parameters owe their uncertainty to weak directions, (P,) bool, from the posterior precision in z.

    Along an eigenvector of eigenvalue λ, where the prior has 1, the data contribute 1 − 1/λ of the information.
    """
    values, vectors = np.linalg.eigh(precision)
    parts = vectors**2 / values
    weak = 1 - 1 / np.maximum(values, 1.0) < WEAK_SHARE
    return parts[:, weak].sum(axis=1) > _FROM_WEAK * parts.sum(axis=1)


def determined_combinations(
    parameters: Draws, candidates: np.ndarray, derived: Draws, standard: Sequence[StandardCombination] = ()
) -> list[DeterminedCombination]:
    """Return independent combinations of the candidates that are much better determined than each of their members.

    Parameters
    ----------
    parameters : joint posterior draws of the parameters.
    candidates : shape (P,), which of them may be members.
    derived : draws of the derived quantities, row by row those of the first of the parameters' draws or of all.
    standard : combinations to prefer, in order.
    """
    found, space = [], _Space(parameters.values)
    for each in standard:
        if isinstance(each, ProjectedScaleFactor):
            made = _projected(each, derived, parameters, space)
        else:
            made = _linear(each, parameters, candidates, space)
        if made is not None:
            found.append(made)
    chosen = np.flatnonzero(candidates & (space.deviation > 0))
    for lead, weights in _sparse(space.covariance[np.ix_(chosen, chosen)]):
        whole = np.zeros(len(candidates))
        whole[chosen] = weights
        if space.add(whole):
            places = [chosen[lead], *(place for place in np.flatnonzero(whole) if place != chosen[lead])]
            names = tuple(parameters.names[place] for place in places)
            sizes = tuple(float(whole[place]) for place in places)
            found.append(DeterminedCombination(names, sizes, parameters.units[chosen[lead]]))
    return found


class _Space:
    """The combinations found so far, in units of the posterior standard deviation of each parameter."""

    def __init__(self, values: np.ndarray):
        self.covariance = np.cov(values.T).reshape(values.shape[1], values.shape[1])
        self.deviation = np.sqrt(np.diag(self.covariance))
        self.basis = np.zeros((0, len(self.deviation)))

    def add(self, weights: np.ndarray) -> bool:
        """Return whether a combination is independent of those before it; it is one of them from then on."""
        unit = weights * self.deviation
        unit = unit / np.linalg.norm(unit)
        rest = unit - self.basis.T @ (self.basis @ unit)
        if np.linalg.norm(rest) < _LEAST_NEW:
            return False
        self.basis = np.vstack([self.basis, rest / np.linalg.norm(rest)])
        return True


def _linear(
    standard: LinearCombination, parameters: Draws, candidates: np.ndarray, space: _Space
) -> DeterminedCombination | None:
    """Return a standard sum of parameters where it is determined and its members are not."""
    place = {name: index for index, name in enumerate(parameters.names)}
    known = {name: weight for name, weight in standard.weights.items() if name in place}
    if len(known) < len(standard.weights) and not standard.total:
        return None
    weights = np.zeros(len(parameters.names))
    for name, weight in known.items():
        weights[place[name]] = weight
    spread = float(np.sqrt(max(weights @ space.covariance @ weights, 0.0)))
    combined = candidates & (MUCH_LESS * np.abs(weights) * space.deviation > spread)
    # A total may hold members that are known by themselves as well.
    enough = np.count_nonzero(combined) >= 2 and (standard.total or not np.any(weights[~combined]))
    if not enough or not space.add(weights):
        return None
    return DeterminedCombination(tuple(known), tuple(known.values()), standard.unit, standard.constant, standard.name)


def _projected(
    standard: ProjectedScaleFactor, derived: Draws, parameters: Draws, space: _Space
) -> DeterminedCombination | None:
    """Return k cos θ where it is much better determined than k and than θ."""
    if standard.scale not in derived.names or standard.angle not in derived.names:
        return None
    scale, angle = (derived.values[:, derived.names.index(name)] for name in (standard.scale, standard.angle))
    cosine = np.cos(np.radians(angle))
    values = scale * cosine
    parts = np.std(scale) * abs(np.mean(cosine)), abs(np.mean(scale)) * np.std(cosine)
    if not np.std(values) < MUCH_LESS * min(parts) or not space.add(_slopes(parameters.values, values)):
        return None
    return DeterminedCombination((standard.scale, standard.angle), None, standard.unit, symbol=standard.name)


def _slopes(points: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the slopes of a quantity on the parameters, (P,), by regression over draws."""
    centred = points - points.mean(axis=0)
    scale = np.maximum(centred.std(axis=0), np.finfo(float).tiny)
    slopes, *_ = np.linalg.lstsq(centred / scale, values - values.mean())
    return slopes / scale


def _sparse(covariance: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """Return leading member and weights, (n,), of determined combinations, those of the fewest members first."""
    deviation = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(deviation, deviation)
    found = [(lead, weights) for lead in range(len(deviation)) if (weights := _fewest(correlation, lead)) is not None]
    for lead, weights in sorted(found, key=lambda pair: (np.count_nonzero(pair[1]), pair[0])):
        yield lead, _rounded(weights * deviation[lead] / deviation, covariance)


def _fewest(correlation: np.ndarray, lead: int) -> np.ndarray | None:
    """Return the residual of the regression of one member on the fewest others, (n,), 1 at `lead`; None without any.

    Forward selection, then elimination of what the others make superfluous.
    """
    best, deviation = None, np.inf
    others: list[int] = []
    left = correlation.copy()
    while len(others) < min(_MOST_MEMBERS, len(correlation)) - 1:
        variance = np.diag(left).copy()
        variance[variance < _SINGULAR] = np.inf
        variance[[lead, *others]] = np.inf
        new = int(np.argmax(left[lead] ** 2 / variance))
        if not np.isfinite(variance[new]):
            break
        others.append(new)
        left = left - np.outer(left[:, new], left[new]) / left[new, new]
        kept = _without_superfluous(correlation, lead, others)
        weights = _residual(correlation, lead, kept)
        reached = _spread(correlation, weights)
        if reached < MUCH_LESS * np.min(np.abs(weights[[lead, *kept]])) and reached < deviation / _WORTH:
            best, deviation = weights, reached
    return best


def _without_superfluous(correlation: np.ndarray, lead: int, others: Sequence[int]) -> list[int]:
    """Return the regressors without those that divide the residual deviation by little."""
    kept = list(others)
    while len(kept) > 1:
        now = _spread(correlation, _residual(correlation, lead, kept))
        trials = [[other for other in kept if other != gone] for gone in kept]
        spreads = [_spread(correlation, _residual(correlation, lead, trial)) for trial in trials]
        least = int(np.argmin(spreads))
        if spreads[least] > _WORTH * now:
            break
        kept = trials[least]
    return kept


def _residual(correlation: np.ndarray, lead: int, others: Sequence[int]) -> np.ndarray:
    """Return 1 at `lead` and minus the regression coefficients at the others, (n,)."""
    weights = np.zeros(len(correlation))
    weights[lead] = 1.0
    weights[others] = -np.linalg.lstsq(correlation[np.ix_(others, others)], correlation[others, lead], rcond=1e-14)[0]
    return weights


def _spread(covariance: np.ndarray, weights: np.ndarray) -> float:
    return float(np.sqrt(max(weights @ covariance @ weights, 0.0)))


def _rounded(weights: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the weights to as few significant digits as cost little of what is known."""
    sizes = np.abs(weights[weights != 0]) * np.sqrt(np.diag(covariance)[weights != 0])
    allowed = min(_ROUNDING_COST * _spread(covariance, weights), MUCH_LESS * sizes.min())
    for digits in range(1, _MOST_DIGITS + 1):
        simple = np.array([float(f"{weight:.{digits - 1}e}") for weight in weights])
        if _spread(covariance, simple) <= allowed:
            return simple
    return weights
