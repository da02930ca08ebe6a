"""A shape drawn by hand over a covariate: the formula that is like it, what the data say of it, and held-out runs.

The drawing says what the dependence looks like; its size and its level are estimated.  Terms of the library over the
covariate are selected by how much of the drawing they explain, not of the residual.  If none is like it, the drawing
itself is the term: a free form, linear between its points.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.criticism.explanation_records import ResidualFormula
from imubayes.criticism.formula_search import Term, TermsBeside
from imubayes.foundations.covariates import Covariate, regressors
from imubayes.foundations.errors import closest_first, input_error
from imubayes.foundations.records import Record
from imubayes.responses.residual_covariates import ResidualCovariate

LIKE = 0.95
"""Share of the variance of a drawing that a formula explains to stand for it.  Convention: a hand does no better."""
_MOST_TERMS, _MOST_POINTS = 2, 12


class DrawnCurve(Record):
    """A curve over a covariate: its name, and points, whose heights have any unit."""

    over: str
    points: tuple[tuple[float, float], ...]


class DrawnFormula(ResidualFormula):
    """The formula of a drawing.

    Attributes
    ----------
    likeness : share of the variance of the drawing that it explains; 1 of a free form.
    free_form : whether the drawing itself is the term.
    held_out : drop of χ² of runs, each predicted from all others; None of a single run.
    better, runs : runs that were predicted better with it, of all that it acts on.
    """

    likeness: float
    free_form: bool
    held_out: float | None
    better: int
    runs: int


@dataclass(frozen=True)
class DrawnShape:
    """A drawing as a term.

    Attributes
    ----------
    term : linear between its points, constant beyond.
    inside : shape (E,) bool, where it was drawn.
    """

    term: Term
    inside: np.ndarray


def drawn_shape(drawing: DrawnCurve, covariates: Sequence[ResidualCovariate], gravity: float) -> DrawnShape:
    """Return a drawing as a term; raises InputError if there is none, or its covariate stands in no formula."""
    entries = {each.column: each for each in regressors() if each.symbol}
    known = {each.name: each.values for each in covariates if each.name in entries}
    if drawing.over not in known:
        raise input_error(f"no formula has {drawing.over or 'this abscissa'} in it", "drawing",
                          closest_first(drawing.over, known), "draw against one of these")  # fmt: skip
    points = np.array(sorted(dict(drawing.points).items()), dtype=float).reshape(-1, 2)
    if len(points) < 2 or not np.isfinite(points).all() or not np.ptp(points[:, 1]) > 0:
        raise input_error("the drawing has no shape", "drawing", "two points or more, not all of one height",
                          "draw over the residuals")  # fmt: skip
    x = points[:, 0] if len(points) <= _MOST_POINTS else np.linspace(points[0, 0], points[-1, 0], _MOST_POINTS)
    y = np.interp(x, points[:, 0], points[:, 1])
    return _as_term(entries[drawing.over], known[drawing.over], x, (y - y.mean()) / np.abs(y - y.mean()).max(), gravity)


def _as_term(entry: Covariate, values: np.ndarray, x: np.ndarray, y: np.ndarray, gravity: float) -> DrawnShape:
    places = ", ".join(f"{each:.6g}" for each in (x - entry.centre) * entry.factor(gravity))
    heights = ", ".join(f"{each:.3f}" for each in y)
    term = Term(
        text=f"the drawn shape over {entry.symbol}, {len(x)} points",
        divisor="",
        expression=f"jnp.interp({entry.python}, jnp.array([{places}]), jnp.array([{heights}]))",
        covariates=(entry.column,),
        needs=entry.needed,
        values=np.where(np.isfinite(values), np.interp(values, x, np.round(y, 3)), 0.0),
        sort="drawing",
    )
    return DrawnShape(term, np.isfinite(values) & (values >= x[0]) & (values <= x[-1]))


def likest(beside: TermsBeside, drawn: DrawnShape) -> DrawnFormula:
    """Return the formula that is like a drawing, which is the last of the terms."""
    rows = beside.entry[drawn.inside[beside.entry]]
    shape = drawn.term.values[rows]
    _, first = np.unique(shape, return_index=True)  # a place counts once, however long the unit stood there
    places, share = _likest(np.stack([each.values[rows[first]] for each in beside.terms[:-1]], axis=1), shape[first])
    free = share < LIKE
    places = [len(beside.terms) - 1] if free else places
    selected, at, rivals = list[tuple[int, float, float]](), beside.first, len(beside.terms)
    for place in places:
        drop = float(at.drops(beside.whole)[place])
        odds = 0.5 * (drop - math.log(len(beside.residual))) - math.log(rivals)
        selected, at = [*selected, (place, drop, odds)], at.without(place)
    gains = _held_out(beside, places)
    return DrawnFormula(
        **beside.formula(selected).model_dump(exclude={"near"}), near=(), likeness=1.0 if free else share,
        free_form=free, held_out=float(gains.sum()) if len(gains) > 1 else None, better=int((gains > 0).sum()),
        runs=len(gains),
    )  # fmt: skip


def _likest(columns: np.ndarray, shape: np.ndarray) -> tuple[list[int], float]:
    """Return the fewest columns (n, T) that are like a shape (n,), and the share of its variance that they explain."""
    columns, shape = columns - columns.mean(axis=0), shape - shape.mean()
    whole, places, share = float(shape @ shape), list[int](), 0.0
    left, rest = columns.copy(), shape.copy()
    while whole > 0 and share < LIKE and len(places) < min(_MOST_TERMS, len(shape) - 2):
        length = np.linalg.norm(left, axis=0)
        told = length > 1e-6 * np.maximum(np.linalg.norm(columns, axis=0), np.finfo(float).tiny)
        unit = np.where(told, left / np.where(told, length, 1.0), 0.0)
        best = int(np.argmax(np.abs(unit.T @ rest)))
        along = unit[:, best]
        places.append(best)
        left, rest = left - np.outer(along, along @ left), rest - along * (along @ rest)
        share = 1.0 - float(rest @ rest) / whole
    return places, share


def _held_out(beside: TermsBeside, places: Sequence[int]) -> np.ndarray:
    """Return the drop of χ² of each run that terms act on, their coefficients from all other runs."""
    left, residual, gains = beside.left[:, places], beside.residual, list[float]()
    acting = np.any([beside.terms[place].values[beside.entry] != 0 for place in places], axis=0)
    for run in np.unique(beside.run[acting]):
        here = beside.run == run
        others = np.linalg.lstsq(left[~here], residual[~here], rcond=1e-8)[0]
        after = residual[here] - left[here] @ others
        gains.append(float(residual[here] @ residual[here] - after @ after))
    return np.array(gains)
