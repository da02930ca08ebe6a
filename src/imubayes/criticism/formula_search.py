"""Formula search: the simplest formula in the covariates that explains a channel's residual.

Orthogonal matching pursuit over the library of simple terms, past what the leading explanation fits: the term with the
strongest evidence is selected and projected out, until the odds are against a further one.  The inclusion frequency,
how often a term is selected first when whole runs are resampled, says how far to trust it.
"""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.criticism.evidence.evidence_record import NAMED_ODDS, NEAR
from imubayes.criticism.evidence.hypothesis import Evaluated, EvidenceOf
from imubayes.criticism.evidence.linear_problem import NEGLIGIBLE
from imubayes.criticism.evidence.proposals import base_columns
from imubayes.criticism.term_library import Term, library
from imubayes.inference.fitted_model import Fit
from imubayes.json_record import Record, finite
from imubayes.responses.residual_covariates import ResidualCovariate

_MOST_TERMS, _RESAMPLES = 3, 200
"""Terms of a formula at most; times that runs are resampled."""


class FormulaTerm(Record):
    """One term of a formula, with its coefficient at the input.

    Attributes
    ----------
    shape : the term in symbols.
    expression : the term in Python, in SI, for an effect's `sample`.
    needs : covariates that a run has to supply.
    value, sd, unit : coefficient.
    delta_chi2 : drop of χ² when the term was selected.
    log_odds : natural logarithm of the odds for it, all terms of the library counted.
    """

    shape: str
    expression: str
    needs: tuple[str, ...]
    value: float
    sd: float | None
    unit: str
    delta_chi2: float
    log_odds: float


@dataclass(frozen=True)
class Formula:
    """The formula found for one channel.

    Attributes
    ----------
    channel, kind : name and kind.
    terms : in the order of selection.
    inclusion : inclusion frequency of the first term.
    near : terms that explain almost as much as the first, in symbols.
    """

    channel: str
    kind: str
    terms: tuple[FormulaTerm, ...]
    inclusion: float
    near: tuple[str, ...]

    @property
    def text(self) -> str:
        """The sum of the terms, in symbols."""
        return " + ".join(term.shape for term in self.terms)


@dataclass(frozen=True)
class _Pursuit:
    """Terms beside an explanation: V (T, T) and u (T,) past what it fits, in units of the noise."""

    own: np.ndarray
    right: np.ndarray

    def drops(self, whole: np.ndarray) -> np.ndarray:
        """Return the drop of χ² by each term, of squared length `whole` at first, (T,)."""
        left = np.diag(self.own)
        told = left > NEGLIGIBLE * whole
        return np.where(told, self.right**2 / np.where(told, left, 1.0), 0.0)

    def without(self, place: int) -> "_Pursuit":
        """Return the same with a term projected out."""
        along = self.own[:, place] / self.own[place, place]
        return _Pursuit(self.own - np.outer(along, self.own[place]), self.right - along * self.right[place])


def find_formula(
    of: EvidenceOf, at: Evaluated, scale: np.ndarray, fitted: Fit, covariates: Sequence[ResidualCovariate], channel: int
) -> Formula | None:
    """Return the simplest formula for what a hypothesis leaves of a channel; None where no term is worth its odds.

    Parameters
    ----------
    at : the hypothesis, without a form.
    scale : shape (K,), noise scales with the form that explains the rest.
    """
    model = fitted.model
    gravity, constants = model.campaign.site.gravity, model.campaign.channels[channel]
    here = (model.entries.channel == channel) & ~model.entries.closing
    terms = library(covariates, here, gravity)
    if not terms:
        return None
    factor, base = coefficient_unit(constants.kind, constants.scale_si, gravity)
    rows, solved = of.problem.rows[channel], of.solved(at, scale)
    columns = np.stack([term.values[rows.entry] for term in terms], axis=1) * factor
    size = np.maximum(np.abs(columns).max(axis=0), np.finfo(float).tiny)
    columns = columns / size * of.problem.root[rows.entry][:, None]
    white = of.whiten(at.hypothesis, columns, channel, at.weight.get(channel)) / scale[channel]
    taken = base_columns(of, at, channel) / scale[channel]
    where = of.taking_part(channel, at.columns, None)
    left = white - taken[:, :-1] @ (solved.covariance[np.ix_(where, where)] @ (taken[:, :-1].T @ white))
    residual = taken[:, -1] - taken[:, :-1] @ solved.mean[where]
    first = _Pursuit(white.T @ left, white.T @ residual)
    selected = _pursue(first, terms, np.sum(white**2, axis=0), len(residual))
    if not selected:
        return None
    places = [place for place, _, _ in selected]
    covariance = np.linalg.inv(first.own[np.ix_(places, places)])
    values, sds = covariance @ first.right[places], np.sqrt(np.diag(covariance))
    drops = first.drops(np.sum(white**2, axis=0))
    return Formula(
        channel=constants.name,
        kind=constants.kind,
        terms=tuple(
            _formula_term(terms[place], drop, odds, value, sd, base)
            for (place, drop, odds), value, sd in zip(selected, values / size[places], sds / size[places], strict=True)
        ),
        inclusion=_inclusion(of.problem.run[rows.entry], left, residual, places[0]),
        near=tuple(
            term.text
            for place, (term, drop) in enumerate(zip(terms, drops, strict=True))
            if drop > drops[places[0]] - 2 * NEAR and place != places[0]
        ),
    )


def coefficient_unit(kind: str, scale: float, gravity: float) -> tuple[float, str]:
    """Return output units per unit of the coefficient, and that unit."""
    return (scale * np.pi / 180 / 3600, "deg/h") if kind == "gyro" else (scale * 1e-6 * gravity, "ug")


def _pursue(at: _Pursuit, terms: Sequence[Term], whole: np.ndarray, rows: int) -> list[tuple[int, float, float]]:
    """Return the places of the terms selected, with the drop of χ² and log odds of each (Schwarz's criterion)."""
    # Sorts are equally likely, and so are the terms of each: what is chosen from many pays for it.
    members = Counter(term.sort for term in terms)
    cost = np.log([len(members) * members[term.sort] for term in terms])
    selected: list[tuple[int, float, float]] = []
    while len(selected) < _MOST_TERMS:
        drops = at.drops(whole)
        odds = 0.5 * drops - 0.5 * math.log(rows) - cost
        best = int(np.argmax(odds))
        if odds[best] < NAMED_ODDS:
            break
        selected.append((best, float(drops[best]), float(odds[best])))
        at = at.without(best)
    return selected


def _formula_term(term: Term, drop: float, odds: float, value: float, sd: float, base: str) -> FormulaTerm:
    return FormulaTerm(
        shape=term.text,
        expression=term.expression,
        needs=term.needs,
        value=float(value),
        sd=finite(sd),
        unit=f"{base}/{term.divisor}" if term.divisor else base,
        delta_chi2=drop,
        log_odds=odds,
    )


def _inclusion(run: np.ndarray, left: np.ndarray, residual: np.ndarray, best: int) -> float:
    """Return how often the same term is selected first when whole runs are resampled."""
    names, place = np.unique(run, return_inverse=True)
    along, square = np.zeros((len(names), left.shape[1])), np.zeros((len(names), left.shape[1]))
    np.add.at(along, place, left * residual[:, None])
    np.add.at(square, place, left**2)
    count = len(names)
    drawn = np.random.default_rng(0).multinomial(count, np.full(count, 1 / count), size=_RESAMPLES)
    whole = drawn @ square
    score = np.where(whole > 1e-12, (drawn @ along) ** 2 / np.where(whole > 1e-12, whole, 1.0), 0.0)
    return float(np.mean(np.argmax(score, axis=1) == best))
