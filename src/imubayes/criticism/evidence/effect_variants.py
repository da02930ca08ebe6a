"""Which effects may be missing, and in which form, and the evidence of their coefficients under normal priors.

A variant is all of an effect, one of its parameters, or the effect on one channel alone.  An effect of several
parameters is in practice often one of them, and on one channel: without these variants its prior would spread over
coefficients that are zero, and Occam's factor would prefer any special case that the catalogue has.  The evidence is
summed over the widths of the priors.
"""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imubayes.criticism.evidence.linear_problem import NEGLIGIBLE, LinearProblem, typical_sizes
from imubayes.criticism.explanation_records import EXPECTED
from imubayes.foundations.tail_probabilities import normal_log_survival

ONE_PARAMETER, ONE_OWNER = 0.5, 0.3
"""Shares of the prior of an effect for one of its parameters, and for one channel, mounting or table alone."""
_REACH, WIDTH_RATIO = 10.0, 4.0
"""Widths of the prior of coefficients: from a tenth of the smallest to ten times the largest typical size, in steps of
a ratio.  Derived: a coarser ratio costs more than a nat of Occam's factor; and of two effects with equal responses the
one whose size is within its range would win by its range alone."""
SHOWN, SEEN = 3.0, 1.0
"""Standard deviations at which an effect of its largest typical size would stand, to be looked for, and at which one of
a width would, for that width to be distinguished from nothing."""


@dataclass(frozen=True)
class EffectVariant:
    """An effect in one form.

    Attributes
    ----------
    response : place of its response, which determines the effect and its shape.
    owners : channels, mountings or tables.
    places : places of its coefficients.
    log_odds : logarithm of the prior odds that it is missing.
    widths : standard deviations of the prior of its coefficients, in their largest typical sizes; equally likely.
    """

    effect: str
    response: int
    owners: tuple[str, ...]
    places: tuple[int, ...]
    log_odds: float
    widths: tuple[float, ...]

    def excludes(self, other: "EffectVariant") -> bool:
        """Whether both are the same effect of the same owner."""
        return self.effect == other.effect and bool(set(self.owners) & set(other.owners))


def effect_variants(problem: LinearProblem) -> tuple[EffectVariant, ...]:
    """Return all variants of the effects that the rows respond to."""
    owned: dict[tuple[int, str], list[int]] = {}
    kind, first = {each.name: each.kind for each in problem.of_channels}, 0
    for place, response in enumerate(problem.candidates):
        for k, coefficient in enumerate(response.coefficients, first):
            if problem.shown[k]:
                owned.setdefault((place, kind.get(coefficient.owner, "")), []).append(k)
        first += len(response.coefficients)
    # Live coefficients of an effect that belong to one kind of owner are one cause; each of its shapes has a share.
    causes = [(problem.candidates[place].scan.effect, name) for place, name in owned]
    shapes, kinds = Counter(causes), Counter(effect for effect, _ in set(causes))
    odds = EXPECTED / max(len(kinds), 1)
    found: list[EffectVariant] = []
    for ((place, _), places), cause in zip(owned.items(), causes, strict=True):
        log_odds = math.log(odds / kinds[cause[0]] / shapes[cause])
        found += _variants(problem, place, places, log_odds)
    return tuple(found)


def visible(variants: Sequence[EffectVariant], information: np.ndarray) -> tuple[EffectVariant, ...]:
    """Return the variants that the runs can show, with the widths at which they would.

    An effect that the runs would not show at its largest typical size is no hypothesis at such sizes: its probability
    would stay that of the prior, and together such effects would outweigh that nothing is missing.  They are reported
    as undetectable. Only larger sizes, at which the runs would show them, remain, with their share of the prior.

    Parameters
    ----------
    information : shape (C, C), of the coefficients beside the model's own parameters, at the noise as known.
    """
    found = []
    for each in variants:
        size = float(np.sqrt(max(np.linalg.eigvalsh(information[np.ix_(each.places, each.places)])[-1], 0.0)))
        widths = tuple(width for width in each.widths if width * size >= SEEN)
        far = tuple(width for width in widths if width * size >= SHOWN)
        if size >= SHOWN and widths:
            found.append(replace(each, widths=widths))
        elif far:
            share = math.log(len(far) / len(each.widths))
            found.append(replace(each, widths=far, log_odds=each.log_odds + share))
    return tuple(found)


def _variants(problem: LinearProblem, response: int, live: Sequence[int], log_odds: float) -> list[EffectVariant]:
    effect = problem.candidates[response].scan.effect

    def variant(places: Sequence[int], log_share: float) -> EffectVariant:
        owners = tuple(dict.fromkeys(problem.coefficients[k].owner for k in places))
        widths = _widths(problem, places)
        return EffectVariant(effect, response, owners, tuple(places), log_odds + log_share, widths)

    fields: dict[str, list[int]] = {}
    owners: dict[str, list[int]] = {}
    for k in live:
        fields.setdefault(problem.coefficients[k].parameter.field, []).append(k)
        owners.setdefault(problem.coefficients[k].owner, []).append(k)
    several = math.log(1 - ONE_OWNER) if len(owners) > 1 else 0.0
    whole = math.log(1 - ONE_PARAMETER) if len(fields) > 1 else 0.0
    found = [variant(live, whole + several)]
    if len(owners) > 1:
        alone = math.log(ONE_OWNER / len(owners))
        found += [variant(places, whole + alone) for places in owners.values()]
    if len(fields) > 1:
        part = math.log(ONE_PARAMETER / len(fields))
        for places in fields.values():
            own: dict[str, list[int]] = {}
            for k in places:
                own.setdefault(problem.coefficients[k].owner, []).append(k)
            found.append(variant(places, part + (math.log(1 - ONE_OWNER) if len(own) > 1 else 0.0)))
            if len(own) > 1:
                found += [variant(each, part + math.log(ONE_OWNER / len(own))) for each in own.values()]
    return found


def _widths(problem: LinearProblem, places: Sequence[int]) -> tuple[float, ...]:
    typical = np.array([typical_sizes(problem.coefficients[k]) for k in places])
    least = float(np.exp(np.mean(np.log(np.maximum(typical[:, 0], 1e-300) / typical[:, 1]))))
    least = max(least / _REACH, NEGLIGIBLE)
    count = 1 + max(2, round(math.log(_REACH / least) / math.log(WIDTH_RATIO)))
    return tuple(np.geomspace(least, _REACH, count).tolist())


def gain_of_coefficients(own: np.ndarray, right: np.ndarray, widths: np.ndarray, sign: np.ndarray) -> np.ndarray:
    """Return the log evidence of coefficients b, exp(uᵀb − bᵀVb/2), under normal priors of given widths.

    Parameters
    ----------
    own, right : V (k, k) or (n, k, k), and u (k,) or (n, k).
    widths : shape (n, k).
    sign : shape (k,) or (n, k): −1 or 1 where only one sign is allowed.
    """
    scaled = widths[:, :, None] * own * widths[:, None, :] + np.eye(widths.shape[1])
    pull = widths * right
    if widths.shape[1] == 1:
        variance = 1 / scaled[:, 0, 0]
        mean, diagonal = pull * variance[:, None], variance[:, None]
        found = 0.5 * pull[:, 0] * mean[:, 0] + 0.5 * np.log(variance)
    else:
        mean = np.linalg.solve(scaled, pull[..., None])[..., 0]
        found = 0.5 * np.sum(pull * mean, axis=-1) - 0.5 * np.linalg.slogdet(scaled)[1]
        diagonal = np.diagonal(np.linalg.inv(scaled), axis1=-2, axis2=-1) if np.any(sign) else np.ones_like(mean)
    return found + _log_share_of_signs(sign, mean, diagonal) if np.any(sign) else found


# Up to so many coefficients one solution for each width is faster than what makes all widths alike.
_FEW = 16


def _gains_of_widths(
    own: np.ndarray, right: np.ndarray, mine: np.ndarray, widths: np.ndarray, grid: tuple[float, ...], sign: np.ndarray
) -> np.ndarray:
    """Return the log evidence of coefficients for each width of one variant, those of the others, (k,), held.

    Coefficients of the others are eliminated and those of the variant diagonalised once for all widths: an effect of
    a hundred runs may have as many coefficients, or six times.
    """
    if len(mine) <= _FEW:
        return gain_of_coefficients(own, right, np.where(mine, np.array(grid)[:, None], widths), sign)
    others = widths[~mine]
    root = np.linalg.cholesky(others[:, None] * own[np.ix_(~mine, ~mine)] * others + np.eye(len(others)))
    pull = np.linalg.solve(root, others * right[~mine])
    through = np.linalg.solve(root, others[:, None] * own[np.ix_(~mine, mine)])
    found, axes = np.linalg.eigh(own[np.ix_(mine, mine)] - through.T @ through)
    along, square = axes.T @ (right[mine] - through.T @ pull), np.square(grid)[:, None]
    variance = square / (1 + np.maximum(found, 0.0) * square)
    logarithms = np.log(variance / square).sum(axis=1) / 2 - np.log(np.diag(root)).sum()
    gain = (pull @ pull + variance @ along**2) / 2 + logarithms
    if np.any(sign):
        back = np.linalg.inv(root)
        across, alone = back.T @ through @ axes, np.square(back).sum(axis=0)
        gain += _log_share_of_signs(sign[mine], (variance * along) @ axes.T, variance @ np.square(axes).T)
        mean = back.T @ pull - (variance * along) @ across.T
        gain += _log_share_of_signs(sign[~mine], mean, alone + variance @ np.square(across).T)
    return gain


def _log_share_of_signs(sign: np.ndarray, mean: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Return the log share of the posterior, (…,), if coefficients (…, k) have their sign, over the prior's."""
    z = sign * mean / np.sqrt(np.maximum(variance, 1e-300))
    return np.sum(np.where(sign != 0, normal_log_survival(-z) + math.log(2), 0.0), axis=-1)


def summed_over_widths(
    own: np.ndarray,
    right: np.ndarray,
    owner: np.ndarray,
    grids: Sequence[tuple[float, ...]],
    sign: np.ndarray,
    start: Sequence[float],
) -> tuple[list[float], float]:
    """Return the most probable width of each variant and the log evidence summed over all, variant by variant."""
    best, each = list(start), [np.zeros(1)] * len(grids)
    before: list[float] = []
    while best != before:
        before = list(best)
        for n, grid in enumerate(grids):
            each[n] = _gains_of_widths(own, right, np.equal(owner, n), np.array([best[j] for j in owner]), grid, sign)
            best[n] = grid[int(np.argmax(each[n]))]
    means = [float(np.logaddexp.reduce(one)) - math.log(len(one)) for one in each]
    return best, sum(means) - sum(float(one.max()) for one in each[1:])
