"""Combinations of parameters that the data determine although they do not determine the parameters themselves.

A weak direction leaves all its members uncertain, but not every function of them: D_F and D_II of a tumble may be known
to 0.06 °/h each and their sum to 0.002 °/h.  With C the posterior covariance a combination wᵀx is determined if
√(wᵀCw) is less than the largest |w_i| √C_ii: than half of it for the standard combinations, which need no search, and
than a fifth for others.  That member is then uncertain together with others, as no sum of independent terms is better
known than one of them; a parameter that is known by itself combines with nothing.  Members whose own prior is narrow,
such as K3 beside K1, may contribute no more than the combination does.

The standard combinations of the procedures come first, whether a weak direction or a mere correlation joins their
members.  Then comes, for every parameter whose posterior variance comes mostly from weak directions, the residual of
its regression on the fewest others, which is sparse if an echelon form of the well-determined subspace is not, with
coefficients rounded as far as the uncertainty allows.  Every combination that is returned adds a direction to those
before it.  Since the weights are constants, the posterior of a combination is calibrated as that of its members is,
whatever the rounding.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from imubayes.inference.identifiability import WEAK_SHARE
from imubayes.procedures.fitted_terms import LinearCombination, ProjectedScaleFactor, StandardCombination

# A parameter is a member if weak directions contribute more than this share of its posterior variance.
_FROM_WEAK = 0.5
# A combination is determined if its standard deviation is below this share of what its leading member contributes.
MUCH_LESS = 0.2
# A standard combination, which the test is made for, needs no search: it is reported if it is twice as well known.
HALF = 0.5
# Another member is worth while if it divides the standard deviation by the first of these, or by the second if
# without it nothing is determined; what it adds must be that much larger than what rounding its weight may add.
_WORTH, _NEEDED, _ROUNDING_COST = 4.0, 2.0, 1.25
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
    middle_of : run in the middle of whose record it holds, if it changes with time; else empty.
    """

    quantities: tuple[str, ...]
    weights: tuple[float, ...] | None
    unit: str
    constant: float = 0.0
    symbol: str = ""
    middle_of: str = ""


def combined(weights: Sequence[float] | None, constant: float, members: Sequence[np.ndarray]) -> np.ndarray:
    """Return draws of a combination, (S,), from those of its members; of k cos θ from k and θ in degrees."""
    if weights is None:
        scale, angle = members
        return scale * np.cos(np.radians(angle))
    return constant + np.array(weights) @ np.stack(members)


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
    """Return independent combinations that are much better determined than their leading members.

    Parameters
    ----------
    parameters : joint posterior draws of the parameters.
    candidates : shape (P,), which of them may be members of combinations that are not standard.
    derived : draws of the derived quantities, row by row those of the first of the parameters' draws or of all.
    standard : combinations to prefer, in order.
    """
    found, space = [], _Space(parameters.values)
    for each in standard:
        if isinstance(each, ProjectedScaleFactor):
            made = _projected(each, derived, parameters, space)
        else:
            made = None if _part_of_one(each, found) else _linear(each, parameters, space)
        if made is not None:
            found.append(made)
    chosen = np.flatnonzero(candidates & (space.deviation > 0))
    mean = parameters.values.mean(axis=0)
    for lead, weights in _sparse(space.covariance[np.ix_(chosen, chosen)], mean[chosen]):
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


def _part_of_one(standard: LinearCombination, found: Sequence[DeterminedCombination]) -> bool:
    """Return whether a standard sum only lacks members of one that was found."""
    wholes = [dict(zip(each.quantities, each.weights, strict=True)) for each in found if each.weights is not None]
    return any(standard.weights.items() <= whole.items() for whole in wholes)


def _linear(standard: LinearCombination, parameters: Draws, space: _Space) -> DeterminedCombination | None:
    """Return a standard sum of parameters if it is determined and its leading member is not."""
    place = {name: index for index, name in enumerate(parameters.names)}
    known = {name: weight for name, weight in standard.weights.items() if name in place}
    if not known or (len(known) < len(standard.weights) and not standard.total):
        return None
    weights = np.zeros(len(parameters.names))
    for name, weight in known.items():
        weights[place[name]] = weight
    largest = float(np.max(np.abs(weights) * space.deviation))
    if not _spread(space.covariance, weights) < HALF * largest or not space.add(weights):
        return None
    return DeterminedCombination(
        tuple(known), tuple(known.values()), standard.unit, standard.constant, standard.name, standard.middle_of
    )


def _projected(
    standard: ProjectedScaleFactor, derived: Draws, parameters: Draws, space: _Space
) -> DeterminedCombination | None:
    """Return k cos θ if it is much better determined than k and than θ."""
    if standard.scale not in derived.names or standard.angle not in derived.names:
        return None
    scale, angle = (derived.values[:, derived.names.index(name)] for name in (standard.scale, standard.angle))
    cosine = np.cos(np.radians(angle))
    values = scale * cosine
    parts = np.std(scale) * abs(np.mean(cosine)), abs(np.mean(scale)) * np.std(cosine)
    if not np.std(values) < HALF * min(parts) or not space.add(_slopes(parameters.values, values)):
        return None
    return DeterminedCombination((standard.scale, standard.angle), None, standard.unit, symbol=standard.name)


def _slopes(points: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the slopes of a quantity on the parameters, (P,), by regression over draws."""
    centred = points - points.mean(axis=0)
    scale = np.maximum(centred.std(axis=0), np.finfo(float).tiny)
    slopes, *_ = np.linalg.lstsq(centred / scale, values - values.mean())
    return slopes / scale


def _sparse(covariance: np.ndarray, mean: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """Return leading member and weights, (n,), of determined combinations, those of the fewest members first.

    The member that makes most of the sum, which has the mean wᵀ`mean`, leads it with the weight 1.
    """
    deviation = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(deviation, deviation)
    fewest = (_fewest(correlation, each) for each in range(len(deviation)))
    found = [weights / deviation for weights in fewest if weights is not None]
    for weights in sorted(found, key=np.count_nonzero):
        lead = int(np.argmax(np.abs(weights * mean)))
        yield lead, _rounded(weights / weights[lead], covariance)


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
        # If a shorter one is determined, each further member must be much less known than the sum.
        clear = reached < MUCH_LESS * np.min(np.abs(weights[[lead, *kept]]))
        if (clear or (best is None and _determined(weights, reached))) and reached < deviation / _WORTH:
            best, deviation = weights, reached
    return best


def _without_superfluous(correlation: np.ndarray, lead: int, others: Sequence[int]) -> list[int]:
    """Return the regressors without those that divide the residual deviation by little and are not needed."""
    kept = list(others)
    while len(kept) > 1:
        now = _spread(correlation, _residual(correlation, lead, kept))
        trials = [[other for other in kept if other != gone] for gone in kept]
        spreads = [_spread(correlation, _residual(correlation, lead, trial)) for trial in trials]
        least = int(np.argmin(spreads))
        without = _residual(correlation, lead, trials[least])
        worth = _WORTH if _determined(without, spreads[least]) else _NEEDED
        if spreads[least] > worth * now:
            break
        kept = trials[least]
    return kept


def _determined(weights: np.ndarray, spread: float) -> bool:
    """Return whether a combination is much better known than its leading member; weights in posterior deviations."""
    return spread < MUCH_LESS * float(np.max(np.abs(weights)))


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
    allowed = min(_ROUNDING_COST * _spread(covariance, weights), MUCH_LESS * sizes.max())
    for digits in range(1, _MOST_DIGITS + 1):
        simple = np.array([float(f"{weight:.{digits - 1}e}") for weight in weights])
        if _spread(covariance, simple) <= allowed:
            return simple
    return weights
