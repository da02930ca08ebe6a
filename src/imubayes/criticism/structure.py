"""Structure without a name: whether the residual of a channel depends on anything, whatever the form.

Each channel is looked at against each covariate with a form free enough to follow any cause: one value per level
where a covariate was stepped through few of them, a cubic spline where it varied freely, harmonics for the table
angle, products for pairs, steps in time for each run by itself.  Everything goes through the same projection as the
candidates, so what the model absorbs is not taken for structure.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.interpolate import BSpline

from imubayes.criticism.covariates import Covariate
from imubayes.criticism.projection import Projection
from imubayes.criticism.screen import Explained, explain

# A covariate with so few levels gets one value per level.
_MOST_LEVELS = 16
_SPLINE_COLUMNS, _HARMONICS = 7, 6
_FEWEST_ROWS = 8
# The course of a run is followed in steps of so many rows at least.
_FEWEST_COURSE, _ROWS_OF_SEGMENT, _MOST_SEGMENTS = 12, 3, 8


@dataclass(frozen=True)
class Structure:
    """The dependence of one channel's residual on one covariate, or on a pair of them.

    Attributes
    ----------
    channel : name.
    covariates : one or two.
    test : what form was allowed.
    found : what it explains.
    """

    channel: str
    covariates: tuple[Covariate, ...]
    test: str
    found: Explained


@dataclass(frozen=True)
class Form:
    """A free form: columns over the entries, before whitening, shape (E, C)."""

    channel: str
    covariates: tuple[Covariate, ...]
    test: str
    columns: np.ndarray


def forms(projection: Projection, known: Sequence[Covariate]) -> list[Form]:
    """Return the free forms of every channel in every covariate and pair of covariates."""
    fitted = projection.fitted
    entries, found = fitted.model.entries, []
    for place, channel in enumerate(fitted.model.campaign.channels):
        here = (entries.channel == place) & ~entries.closing
        usable = [one for one in known if _rows(one, here).sum() >= _FEWEST_ROWS]
        for one in usable:
            test, columns = _alone(one, _rows(one, here))
            if columns.shape[1]:
                found.append(Form(channel.name, (one,), test, columns))
        for one, other in combinations(usable, 2):
            both = _rows(one, here) & _rows(other, here)
            if both.sum() >= 2 * _FEWEST_ROWS and one.name != "time_s" and other.name != "time_s":
                found.append(Form(channel.name, (one, other), "products", _products(one, other, both)))
        found.extend(_courses(projection, channel.name, here))
    return found


def _courses(projection: Projection, channel: str, here: np.ndarray) -> list[Form]:
    """Return the course of each run by itself: what happens once belongs to no covariate that runs share."""
    model, found = projection.fitted.model, []
    rank = np.asarray(model.problem.observations.rank)
    for index, run in enumerate(model.campaign.runs):
        rows = here & (model.entries.run == index)
        count = int(rows.sum())
        if count < _FEWEST_COURSE:
            continue
        place = np.argsort(np.argsort(rank[rows], kind="stable"))
        segment = place * min(_MOST_SEGMENTS, count // _ROWS_OF_SEGMENT) // count
        values = np.full(len(rows), np.nan)
        time = run.covariates.get("time")
        values[rows] = time[model.entries.row[rows]] if time is not None else place
        covariate = Covariate("time_s" if time is not None else "row", "s", values, f"time within run {run.name}")
        steps = np.eye(segment.max() + 1)[segment]
        found.append(Form(channel, (covariate,), "course of one run", _spread(steps, rows)))
    return found


def _rows(one: Covariate, here: np.ndarray) -> np.ndarray:
    rows = here & np.isfinite(one.values)
    return rows if rows.any() and np.ptp(one.values[rows]) > 0 else np.zeros_like(rows)


def _alone(one: Covariate, rows: np.ndarray) -> tuple[str, np.ndarray]:
    values = one.values[rows]
    if one.name == "table_angle_deg":
        angle = np.radians(values)
        basis = np.stack([f(k * angle) for k in range(1, _HARMONICS + 1) for f in (np.sin, np.cos)], axis=1)
        return f"harmonics to {_HARMONICS}", _spread(basis, rows)
    levels = _levels(values)
    if levels.max() + 1 <= _MOST_LEVELS:
        return "levels", _spread(np.eye(levels.max() + 1)[levels], rows)
    return "spline", _spread(_spline(values), rows)


def _levels(values: np.ndarray) -> np.ndarray:
    """Number the levels of a covariate: values closer than a thousandth of the range, or a tenth, are one."""
    order = np.argsort(values)
    gaps = np.diff(values[order]) > 0.02 * np.ptp(values)
    level = np.empty(len(values), dtype=int)
    level[order] = np.concatenate([[0], np.cumsum(gaps)])
    widths = [np.ptp(values[level == one]) for one in range(level.max() + 1)]
    # A chain of close values is a continuum, not a level.
    return level if max(widths) < 0.02 * np.ptp(values) or level.max() == 0 else np.arange(len(values))


def _spline(values: np.ndarray) -> np.ndarray:
    """Return a cubic B-spline basis with knots at quantiles, (n, columns)."""
    inner = np.unique(np.quantile(values, np.linspace(0, 1, _SPLINE_COLUMNS - 2)))
    knots = np.concatenate([[inner[0]] * 3, inner, [inner[-1]] * 3])
    return BSpline.design_matrix(values, knots, 3).toarray()


def _products(one: Covariate, other: Covariate, rows: np.ndarray) -> np.ndarray:
    def powers(values: np.ndarray) -> np.ndarray:
        scaled = (values - values.mean()) / max(float(np.abs(values - values.mean()).max()), 1e-300)
        return np.stack([scaled, scaled**2], axis=1)

    a, b = powers(one.values[rows]), powers(other.values[rows])
    return _spread((a[:, :, None] * b[:, None, :]).reshape(len(a), 4), rows)


def _spread(basis: np.ndarray, rows: np.ndarray) -> np.ndarray:
    columns = np.zeros((len(rows), basis.shape[1]))
    columns[rows] = basis
    return columns


@dataclass(frozen=True)
class Laid:
    """A form as projected rows (R, C), with the lengths of its columns before."""

    form: Form
    columns: np.ndarray
    length: np.ndarray


def lay(projection: Projection, found: Sequence[Form]) -> list[Laid]:
    """Return forms as rows of the projection."""
    if not found:
        return []
    whitened = projection.whitened(np.concatenate([one.columns for one in found], axis=1))
    projected = projection.project(whitened)
    length = np.linalg.norm(whitened, axis=0)
    ends = np.cumsum([one.columns.shape[1] for one in found])
    parts = [slice(end - one.columns.shape[1], end) for one, end in zip(found, ends, strict=True)]
    return [Laid(one, projected[:, part], length[part]) for one, part in zip(found, parts, strict=True)]


def look(projection: Projection, laid: Sequence[Laid]) -> list[Structure]:
    """Return what each form explains of the residual, the least likely by chance first."""
    found = [
        Structure(
            one.form.channel, one.form.covariates, one.form.test, explain(projection, one.columns, one.length, 1e-6)
        )
        for one in laid
    ]
    return sorted((one for one in found if one.found.span.shape[1]), key=lambda one: one.found.p)
