"""The structure of the population of a parameter: what is found, how probable it is, and the units it is found in.

The laws of `population.population_structure` are compared by their evidence: one group, one group with heavy tails,
two groups or more of unknown members, a step or a trend over dates or serial numbers, and the levels of a covariate,
such as the lot, the table or the site.  The most probable one is kept as what is known, and the search goes on beside
it until one group is more probable than all other laws.  A lot and a table may then both be found.

A structure is found if its probability is above 0.8; a less probable one, above 0.5, is possible.  The prior
probability of a structure is 0.25 for each parameter, divided evenly over kinds and their covariates.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from imubayes_archive.population.population_structure import TAILS, Law, LawFit, UnitEstimates, fit_law

LawKind = Literal["one", "tails", "groups", "step", "trend", "levels"]
PRIOR_STRUCTURE = 0.25
"""Prior probability that the units of a parameter have a structure (convention)."""
FOUND = 0.8
"""Least probability of a structure that is taken as known (convention)."""
MEMBER, UNDECIDED = 0.5, 0.05
"""Probability from which a unit is listed with a group, and above which membership in another is possible."""
_KINDS = 4
_MOST_FINDINGS, _MOST_GROUPS, _LEAST_LEVEL = 3, 4, 2
# Correlation of two designs from which on the units do not distinguish them.
_ALIKE = 0.95


@dataclass(frozen=True)
class UnitCovariate:
    """A property of n units that may explain their differences.

    Attributes
    ----------
    name : such as ``lot`` or ``date``.
    ordered : shape (n,), in units of `per`; None for levels.
    levels : shape (n,), text; None for an ordered covariate.
    shown : shape (n,), the value as text.
    """

    name: str
    shown: tuple[str, ...]
    ordered: np.ndarray | None = None
    per: str = ""

    @property
    def known(self) -> bool:
        """Whether every unit has a value, and not all the same one."""
        stated = all(self.shown)
        return stated and len(set(self.shown)) > 1

    def of(self, places: np.ndarray) -> "UnitCovariate":
        """Return the covariate of some units."""
        ordered = None if self.ordered is None else self.ordered[places]
        return UnitCovariate(self.name, tuple(self.shown[int(place)] for place in places), ordered, self.per)


@dataclass(frozen=True)
class Candidate:
    """A law with the covariate that it uses, and what it says of the units by name."""

    kind: LawKind
    law: Law
    covariate: UnitCovariate | None = None
    at: str = ""

    @property
    def name(self) -> str:
        """What is compared: the kind, and the covariate."""
        return self.kind if self.covariate is None else f"{self.kind} over {self.covariate.name}"


@dataclass(frozen=True)
class Weighed:
    """A candidate with its fit and its probability; `also` are covariates that part the units as its own does."""

    candidate: Candidate
    fit: LawFit
    probability: float
    also: tuple[str, ...] = ()


@dataclass(frozen=True)
class Structure:
    """The structure of the population of one parameter, n units.

    Attributes
    ----------
    findings : laws that were found, the first most evident; empty for one group.
    possible : a law that is more probable than one group beside these, and not found; None without one.
    one : probability of no further structure beside them.
    rest : the last comparison, most probable first.
    explained : shape (n,), location of each unit by the findings, relative to the first groups.
    doubt : shape (n,), variance of that location, from the sizes of the findings and the memberships.
    """

    findings: tuple[Weighed, ...]
    possible: Weighed | None
    one: float
    rest: tuple[Weighed, ...]
    explained: np.ndarray = field(repr=False)
    doubt: np.ndarray = field(repr=False)


def search(units: UnitEstimates, covariates: Sequence[UnitCovariate]) -> Structure:
    """Return the structure of the population of one parameter.

    Parameters
    ----------
    units : n estimates.
    covariates : of these units; those that all units share are passed over.
    """
    usable = [each for each in covariates if each.known]
    base = shares = np.zeros((len(units.estimate), 0))
    findings: list[Weighed] = []
    while True:
        weighed = _compared(units, base, usable)
        one = sum(each.probability for each in weighed if each.candidate.kind in ("one", "tails"))
        best = weighed[0]
        leads = one < 0.5 and best.candidate.kind not in ("one", "tails")
        if not leads or one > 1 - FOUND or len(findings) == _MOST_FINDINGS:
            possible = best if leads and best.probability > 0.5 else None
            return Structure(tuple(findings), possible, one, tuple(weighed), *_explained(units, base, shares))
        findings.append(best)
        shares = np.column_stack([shares, _shares(best, base.shape[1])])
        base = np.column_stack([base, _assigned(best, base.shape[1])])
        usable = [each for each in usable if each is not best.candidate.covariate or each.ordered is not None]


def _explained(units: UnitEstimates, base: np.ndarray, shares: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the location of each unit by its memberships, shares (n, q), and the variance of that location, (n,)."""
    fitted = fit_law(units, Law(base))
    sizes, covariance = fitted.coefficients[1:], fitted.covariance[1:, 1:]
    # A membership that is in doubt is a choice between 0 and the offset; levels and steps are certain.
    chosen = np.clip(shares, 0.0, 1.0)
    doubt = (chosen * (1 - chosen) * (np.abs(shares - base) > 0)) @ sizes**2
    return shares @ sizes, doubt + np.einsum("np,pq,nq->n", shares, covariance, shares)


def _shares(found: Weighed, known: int) -> np.ndarray:
    """Return the design of a finding with the probabilities of memberships in place of members."""
    if found.candidate.kind != "groups":
        return found.candidate.law.design[:, known:]
    inside = found.fit.membership[:, :-1]
    total = inside.sum(axis=1, keepdims=True)
    return inside[:, 1:] / np.where(total > 0, total, 1.0)


def _assigned(found: Weighed, known: int) -> np.ndarray:
    """Return the design of a finding: of groups, each unit in the most probable one."""
    if found.candidate.kind != "groups":
        return found.candidate.law.design[:, known:]
    group = np.argmax(found.fit.membership[:, :-1], axis=1)
    return np.eye(found.candidate.law.groups)[group][:, 1:]


def _compared(units: UnitEstimates, base: np.ndarray, covariates: Sequence[UnitCovariate]) -> list[Weighed]:
    """Return all candidates beside a base design with their probabilities, most probable first."""
    fits: list[tuple[Candidate, LawFit, float]] = []

    def add(candidate: Candidate, prior: float, log_extra: float = 0.0) -> LawFit:
        fit = fit_law(units, candidate.law)
        fits.append((candidate, fit, fit.log_evidence + np.log(prior) + log_extra))
        return fit

    plain = add(Candidate("one", Law(base)), 0.75 * (1 - PRIOR_STRUCTURE))
    add(Candidate("tails", Law(base, components=(1.0, TAILS))), 0.25 * (1 - PRIOR_STRUCTURE))
    each = PRIOR_STRUCTURE / _KINDS
    best = plain.log_evidence
    for groups in range(2, _MOST_GROUPS + 1):
        found = add(Candidate("groups", Law(base, groups)), each / 2 ** (groups - 2))
        if found.log_evidence < best:
            break
        best = found.log_evidence
    ordered = [one for one in covariates if one.ordered is not None]
    levels = [one for one in covariates if one.ordered is None and _enough_levels(one)]
    for one in ordered:
        add(Candidate("trend", Law(np.column_stack([base, _line(one)])), one), each / len(ordered))
        step, log_extra = _likeliest_step(units, base, one, plain)
        if step is not None:
            add(step, each / len(ordered), log_extra)
    for one in levels:
        add(Candidate("levels", Law(np.column_stack([base, _of_levels(one)])), one), each / len(levels))
    total = np.logaddexp.reduce([log for _, _, log in fits])
    weighed = [Weighed(candidate, fit, float(np.exp(log - total))) for candidate, fit, log in fits]
    return _merged(sorted(weighed, key=lambda one: -one.probability))


def _merged(ordered: Sequence[Weighed]) -> list[Weighed]:
    """Return candidates with those of the same kind that explain the units alike as one, most probable first."""
    kept: list[Weighed] = []
    for each in ordered:
        place = next((place for place, one in enumerate(kept) if _alike(one.candidate, each.candidate)), None)
        if place is None:
            kept.append(each)
            continue
        one, covariate = kept[place], each.candidate.covariate
        also = (*one.also, *([covariate.name] if covariate is not None else []))
        kept[place] = replace(one, probability=one.probability + each.probability, also=also)
    return sorted(kept, key=lambda one: -one.probability)


def _alike(one: Candidate, other: Candidate) -> bool:
    """Whether two steps or two trends follow the units in nearly the same way: over dates and serial numbers, say."""
    if one.kind != other.kind or one.kind not in ("step", "trend"):
        return False
    mine, theirs = one.law.design[:, -1], other.law.design[:, -1]
    return bool(abs(np.corrcoef(mine, theirs)[0, 1]) > _ALIKE)


def _line(covariate: UnitCovariate) -> np.ndarray:
    """Return an ordered covariate with mean 0 and range 1."""
    assert covariate.ordered is not None
    return (covariate.ordered - covariate.ordered.mean()) / np.ptp(covariate.ordered)


def _enough_levels(covariate: UnitCovariate) -> bool:
    """Whether two levels or more have several units, and the levels are fewer than half of the units."""
    _, counts = np.unique(covariate.shown, return_counts=True)
    return int(np.sum(counts >= _LEAST_LEVEL)) >= 2 and 2 * len(counts) <= len(covariate.shown)


def _of_levels(covariate: UnitCovariate) -> np.ndarray:
    """Return one column for each level after the most frequent one."""
    names, place, counts = np.unique(covariate.shown, return_inverse=True, return_counts=True)
    return np.delete(np.eye(len(names))[place], int(np.argmax(counts)), axis=1)


def _likeliest_step(
    units: UnitEstimates, base: np.ndarray, covariate: UnitCovariate, plain: LawFit
) -> tuple[Candidate | None, float]:
    """Return the most probable step over an ordered covariate, and the logarithm of its share among all steps, negated.

    All places of the step are compared by weighted least squares at the spread of the most probable one.
    """
    assert covariate.ordered is not None
    values = np.unique(covariate.ordered)
    edges = [(low + high) / 2 for low, high in pairwise(values)]
    columns = np.stack([covariate.ordered > edge for edge in edges], axis=1).astype(float)
    large = (columns.sum(axis=0) >= _LEAST_LEVEL) & (len(columns) - columns.sum(axis=0) >= _LEAST_LEVEL)
    if not large.any():
        return None, 0.0
    columns, edges = columns[:, large], np.asarray(edges)[large]
    first = int(np.argmax(_log_gains(units, base, columns, plain.spread)))
    spread = fit_law(units, Law(np.column_stack([base, columns[:, first]]))).spread
    gain = _log_gains(units, base, columns, spread)
    best = int(np.argmax(gain))
    law = Law(np.column_stack([base, columns[:, best]]))
    after = [shown for shown, value in _in_order(covariate) if value > edges[best]]
    before = [shown for shown, value in _in_order(covariate) if value < edges[best]]
    share = float(np.logaddexp.reduce(gain)) - float(gain[best]) - np.log(len(edges))
    return Candidate("step", law, covariate, f"between {before[-1]} and {after[0]}"), share


def _in_order(covariate: UnitCovariate) -> Iterator[tuple[str, float]]:
    assert covariate.ordered is not None
    for place in np.argsort(covariate.ordered, kind="stable"):
        yield covariate.shown[int(place)], float(covariate.ordered[place])


def _log_gains(units: UnitEstimates, base: np.ndarray, columns: np.ndarray, spread: float) -> np.ndarray:
    """Return the log evidence of a step at each place over that of none, the spread given, (S,)."""
    weight = 1 / (spread**2 + units.variance)
    known = np.column_stack([np.ones(len(base)), base])
    root = np.sqrt(weight)[:, None]
    basis = np.linalg.qr(known * root)[0]
    misfit = units.estimate * root[:, 0]
    misfit = misfit - basis @ (basis.T @ misfit)
    # A unit outside all groups must not decide where the step is.
    misfit = np.clip(misfit, -4.0, 4.0)
    left = columns * root
    left = left - basis @ (basis.T @ left)
    information = np.sum(left**2, axis=0)
    pulled = left.T @ misfit
    total = information + units.difference**-2
    return 0.5 * pulled**2 / total - 0.5 * np.log(total * units.difference**2)
