"""Common properties and differences of the units of an archive, by name: groups, steps, trends and covariates."""

from collections.abc import Sequence

import numpy as np

from imubayes.foundations.records import Record
from imubayes_archive.population.population_search import MEMBER, UNDECIDED, LawKind, Structure, Weighed

_MOST_ALTERNATIVES = 4


class PopulationGroup(Record):
    """Units that a law sets apart.

    Attributes
    ----------
    name : of the group: a level of the covariate, a side of the step, or its rank by number of units.
    units : its members, each with a probability above 0.5.
    offset, offset_sd : location relative to the first group, with its standard deviation.
    """

    name: str
    units: tuple[str, ...]
    offset: float
    offset_sd: float


class PopulationFinding(Record):
    """A structure of the population that is more probable than one group.

    Attributes
    ----------
    kind : ``groups`` of unknown members, ``step`` or ``trend`` over an ordered covariate, ``levels`` of a covariate.
    covariate, at : its name, with those that part the units alike, and the place of a step; empty for groups.
    probability : among all laws that were compared, given the findings before it.
    groups : the first one is the reference; empty for a trend.
    slope, slope_sd, per : of a trend; None for other kinds.
    undecided : units whose membership is less certain than 0.95.
    """

    kind: LawKind
    covariate: str
    at: str
    probability: float
    groups: tuple[PopulationGroup, ...]
    slope: float | None
    slope_sd: float | None
    per: str
    undecided: tuple[str, ...]


class PopulationAlternative(Record):
    """A law that was compared, with its probability beside the findings."""

    law: str
    probability: float


class PopulationLaws(Record):
    """The comparison of the laws of one parameter.

    Attributes
    ----------
    findings : in the order in which they were found.
    possible : a structure that is more probable than one group and not found; None without one.
    nothing_else : probability of one group beside the findings.
    alternatives : the most probable laws of the last comparison.
    """

    findings: tuple[PopulationFinding, ...]
    possible: PopulationFinding | None
    nothing_else: float
    alternatives: tuple[PopulationAlternative, ...]


def laws_of(found: Structure, units: Sequence[str]) -> PopulationLaws:
    """Return the findings of one parameter by the names of its units."""
    return PopulationLaws(
        findings=tuple(_finding(each, units) for each in found.findings),
        possible=None if found.possible is None else _finding(found.possible, units),
        nothing_else=found.one,
        alternatives=tuple(
            PopulationAlternative(law=each.candidate.name, probability=each.probability)
            for each in found.rest[:_MOST_ALTERNATIVES]
        ),
    )


def _finding(found: Weighed, units: Sequence[str]) -> PopulationFinding:
    candidate, fit = found.candidate, found.fit
    covariate = candidate.covariate
    own = len(fit.coefficients) - (candidate.law.groups - 1)
    slope = candidate.kind == "trend" and covariate is not None and covariate.ordered is not None
    stretch = (
        float(np.ptp(covariate.ordered)) if slope and covariate is not None and covariate.ordered is not None else 1.0
    )
    return PopulationFinding(
        kind=candidate.kind,
        covariate=" or ".join((covariate.name, *found.also)) if covariate is not None else "",
        at=candidate.at,
        probability=found.probability,
        groups=() if slope else _groups(found, units),
        slope=float(fit.coefficients[own - 1]) / stretch if slope else None,
        slope_sd=float(np.sqrt(fit.covariance[own - 1, own - 1])) / stretch if slope else None,
        per=covariate.per if slope and covariate is not None else "",
        undecided=_undecided(found, units) if candidate.kind == "groups" else (),
    )


def _groups(found: Weighed, units: Sequence[str]) -> tuple[PopulationGroup, ...]:
    """Return the groups of a finding, the reference first."""
    candidate, fit = found.candidate, found.fit
    if candidate.kind == "groups":
        members = fit.membership[:, :-1] > MEMBER
        names = [f"group {place + 1}" for place in range(candidate.law.groups)]
        places = [None, *range(len(fit.coefficients) - candidate.law.groups + 1, len(fit.coefficients))]
    else:
        names, members, places = _of_covariate(found)
    return tuple(
        PopulationGroup(
            name=name,
            units=tuple(unit for unit, is_in in zip(units, own, strict=True) if is_in),
            offset=0.0 if place is None else float(fit.coefficients[place]),
            offset_sd=0.0 if place is None else float(np.sqrt(fit.covariance[place, place])),
        )
        for name, own, place in zip(names, members.T, places, strict=True)
    )


def _of_covariate(found: Weighed) -> tuple[list[str], np.ndarray, list[int | None]]:
    """Return names, members (n, G) and places of the offsets among the coefficients, of a step or of levels."""
    candidate, fit = found.candidate, found.fit
    assert candidate.covariate is not None
    last = len(fit.coefficients)
    if candidate.kind == "step":
        after = candidate.law.design[:, -1] > 0
        return ["before", "after"], np.stack([~after, after], axis=1), [None, last - 1]
    shown = np.array(candidate.covariate.shown)
    levels, counts = np.unique(shown, return_counts=True)
    reference = int(np.argmax(counts))
    others = [str(each) for place, each in enumerate(levels) if place != reference]
    names = [str(levels[reference]), *others]
    members = np.stack([shown == name for name in names], axis=1)
    return names, members, [None, *range(last - len(others), last)]


def _undecided(found: Weighed, units: Sequence[str]) -> tuple[str, ...]:
    share = np.sort(found.fit.membership[:, :-1], axis=1)
    doubtful = share[:, -2] > UNDECIDED
    return tuple(unit for unit, is_so in zip(units, doubtful, strict=True) if is_so)
