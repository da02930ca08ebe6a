"""Formula search: the simplest formula in the covariates that explains a channel's residual.

Orthogonal matching pursuit over the library of simple terms, all projected: the term with the strongest evidence is
selected and projected out, until no further term is significant.  The inclusion frequency, how often a term is selected
first when whole runs are resampled, says how far to trust it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.criticism import thresholds
from imubayes.criticism.projection import Projection
from imubayes.criticism.residual_covariates import ResidualCovariate
from imubayes.criticism.score_test import ScoreTest, score_test
from imubayes.criticism.term_library import Term, library
from imubayes.json_record import Record, finite

# Sorts of terms that are chosen from many: penalised against plain ones.
_ELABORATE = ("product", "wave")


class FormulaTerm(Record):
    """One term of a formula, with its coefficient at the input.

    Attributes
    ----------
    shape : the term in symbols.
    expression : the term in Python, in SI, for an effect's `sample`.
    needs : covariates that a run has to supply.
    value, sd, unit : coefficient.
    delta_chi2 : drop of χ² when the term was selected.
    p_global : its p-value, all terms of the library counted.
    """

    shape: str
    expression: str
    needs: tuple[str, ...]
    value: float
    sd: float | None
    unit: str
    delta_chi2: float
    p_global: float


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
class _Selected:
    """A selected term: its place in the library, its score test and its corrected p-value."""

    place: int
    score: ScoreTest
    p: float


def find_formula(projection: Projection, covariates: Sequence[ResidualCovariate], channel: str) -> Formula | None:
    """Return the simplest formula for the residual of a channel; None where no term is significant."""
    model = projection.fitted.model
    gravity = model.campaign.site.gravity
    index = [other.name for other in model.campaign.channels].index(channel)
    constants = model.campaign.channels[index]
    rows = (model.entries.channel == index) & ~model.entries.closing
    terms = library(covariates, rows, gravity)
    if not terms:
        return None
    factor, base = coefficient_unit(constants.kind, constants.scale_si, gravity)
    columns = np.stack([np.where(rows, term.values, 0.0) for term in terms], axis=1) * factor
    size = np.abs(columns).max(axis=0)
    whitened = projection.whitened(columns / size)
    first = _scores(projection, whitened)
    selected = _pursue(projection, terms, whitened, first)
    if not selected:
        return None
    places = [choice.place for choice in selected]
    values, sds = _solve(projection, whitened[:, places], selected[-1].score.variance)
    best = selected[0]
    return Formula(
        channel=channel,
        kind=constants.kind,
        terms=tuple(
            _formula_term(terms[choice.place], choice, value, sd, base)
            for choice, value, sd in zip(selected, values / size[places], sds / size[places], strict=True)
        ),
        inclusion=_inclusion(projection, projection.project(whitened), best.place),
        near=tuple(
            term.text
            for place, (term, score) in enumerate(zip(terms, first, strict=True))
            if score.delta_chi2 > best.score.delta_chi2 - thresholds.NEAR_CHI2 and place != best.place
        ),
    )


def coefficient_unit(kind: str, scale: float, gravity: float) -> tuple[float, str]:
    """Return output units per unit of the coefficient, and that unit."""
    return (scale * np.pi / 180 / 3600, "deg/h") if kind == "gyro" else (scale * 1e-6 * gravity, "ug")


def _scores(projection: Projection, whitened: np.ndarray) -> list[ScoreTest]:
    """Return the score test of every whitened column, (R, terms), by itself."""
    lengths = np.linalg.norm(whitened, axis=0)
    return [
        score_test(projection, column[:, None], lengths[place, None], thresholds.FORM_RETAINED_MIN)
        for place, column in enumerate(projection.project(whitened).T)
    ]


def _pursue(
    projection: Projection, terms: Sequence[Term], whitened: np.ndarray, scores: Sequence[ScoreTest]
) -> list[_Selected]:
    """Select terms one by one; `scores` are those before any was selected."""
    selected: list[_Selected] = []
    penalty = [thresholds.ELABORATE_PENALTY * (term.sort in _ELABORATE) for term in terms]
    while len(selected) < thresholds.MAX_TERMS:
        if selected:
            projection = projection.without(selected[-1].score.span)
            scores = _scores(projection, whitened)
        worth = [
            score.delta_chi2 - less if score.span.shape[1] else -np.inf
            for score, less in zip(scores, penalty, strict=True)
        ]
        best = int(np.argmax(worth))
        p = min(1.0, scores[best].p * len(terms))
        if p >= thresholds.TERM_P:
            break
        selected.append(_Selected(best, scores[best], p))
    return selected


def _formula_term(term: Term, choice: _Selected, value: float, sd: float, base: str) -> FormulaTerm:
    return FormulaTerm(
        shape=term.text,
        expression=term.expression,
        needs=term.needs,
        value=float(value),
        sd=finite(sd),
        unit=f"{base}/{term.divisor}" if term.divisor else base,
        delta_chi2=choice.score.delta_chi2,
        p_global=choice.p,
    )


def _solve(projection: Projection, whitened: np.ndarray, variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return least-squares coefficients of whitened columns, and their standard deviations."""
    inverse = np.linalg.pinv(projection.project(whitened))
    weight = projection.strata.at_rows(variance)
    return inverse @ projection.residual, np.sqrt(np.diag((inverse * weight) @ inverse.T))


def _inclusion(projection: Projection, projected: np.ndarray, best: int) -> float:
    """Return how often the same term is selected first when whole runs are resampled."""
    model = projection.fitted.model
    count, runs = len(model.entries), len(model.campaign.runs)
    along, square = np.zeros((runs, projected.shape[1])), np.zeros((runs, projected.shape[1]))
    np.add.at(along, model.entries.run, projected[:count] * projection.residual[:count, None])
    np.add.at(square, model.entries.run, projected[:count] ** 2)
    drawn = np.random.default_rng(0).multinomial(runs, np.full(runs, 1 / runs), size=thresholds.RESAMPLES)
    whole = drawn @ square
    score = np.where(whole > 1e-12, (drawn @ along) ** 2 / np.where(whole > 1e-12, whole, 1.0), 0.0)
    return float(np.mean(np.argmax(score, axis=1) == best))
