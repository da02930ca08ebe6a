"""Structure without a name: whether the residual of a channel depends on anything, whatever the form.

Each channel, and all channels of a kind together, are looked at against each covariate with a form free enough to
follow any broad cause: one value per level where a covariate was stepped through few of them, a cubic spline where it
varied freely, harmonics for the table angle, steps in time for each run by itself.  What is narrow, fast or sudden, and
products of two covariates, are covered by `imubayes.criticism.localised_structure`.  Everything goes through the same
projection as the candidates, so what the model absorbs is not taken for structure.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats
from scipy.interpolate import BSpline

from imubayes.criticism import thresholds
from imubayes.criticism.localised_structure import STEP, Feature, FeatureScan, FeatureSet, in_time, time_in_run
from imubayes.criticism.projection import Projection
from imubayes.criticism.residual_covariates import ResidualCovariate
from imubayes.criticism.score_test import ScoreTest, explain, sizes
from imubayes.criticism.term_library import levels


@dataclass(frozen=True)
class Structure:
    """The dependence of residuals on one covariate, or on a pair of them.

    Attributes
    ----------
    channel : name; of several that were looked at together the one with most of it.
    covariates : one or two.
    test : what form was allowed.
    score : what it explains.
    text : of a detail: what it is in brief.
    height : of a step: its height in the channel and the standard deviation of that, in output units.
    """

    channel: str
    covariates: tuple[ResidualCovariate, ...]
    test: str
    score: ScoreTest
    text: str = ""
    height: tuple[float, float] | None = None


@dataclass(frozen=True)
class Form:
    """A free form on one or more channels: columns over the entries, before whitening, shape (E, C)."""

    channels: tuple[str, ...]
    covariate: ResidualCovariate
    test: str
    columns: np.ndarray


def forms(projection: Projection, known: Sequence[ResidualCovariate]) -> list[Form]:
    """Return the free forms of every channel, and of all of a kind, in every covariate."""
    fitted = projection.fitted
    entries, found = fitted.model.entries, []
    kinds: dict[str, list[list[Form]]] = {}
    for place, channel in enumerate(fitted.model.campaign.channels):
        here = (entries.channel == place) & ~entries.closing
        alone = _of_channel(projection, channel.name, here, known)
        kinds.setdefault(channel.kind, []).append(alone)
        found += [*alone, *_courses(projection, channel.name, here)]
    for each in kinds.values():
        found.extend(_together(each))
    return found


def _of_channel(
    projection: Projection, channel: str, here: np.ndarray, known: Sequence[ResidualCovariate]
) -> list[Form]:
    found = []
    usable = [one for one in known if _rows(one, here).sum() >= thresholds.FORM_MIN_ROWS]
    for one in usable:
        test, columns = _alone(one, _rows(one, here))
        if columns.shape[1]:
            found.append(Form((channel,), one, test, columns))
    return found


def _together(channels: Sequence[Sequence[Form]]) -> list[Form]:
    """Return the forms of several channels in the same covariates as one each, every channel with its own values."""
    alike: dict[str, list[Form]] = {}
    for one in (form for forms in channels for form in forms):
        alike.setdefault(one.covariate.name, []).append(one)
    return [
        Form(
            tuple(name for one in each for name in one.channels),
            each[0].covariate,
            each[0].test,
            np.concatenate([one.columns for one in each], axis=1),
        )
        for each in alike.values()
        if len(each) > 1
    ]


def _courses(projection: Projection, channel: str, here: np.ndarray) -> list[Form]:
    """Return the course of each run by itself: what happens once belongs to no covariate that runs share."""
    model, found = projection.fitted.model, []
    for index in range(len(model.campaign.runs)):
        rows = here & (model.entries.run == index)
        count = int(rows.sum())
        if count < thresholds.COURSE_MIN_ROWS:
            continue
        place = np.zeros(len(rows), dtype=int)
        place[rows] = in_time(projection, rows)
        segment = place[rows] * min(thresholds.MAX_SEGMENTS, count // thresholds.SEGMENT_ROWS) // count
        covariate = time_in_run(projection, index, rows, place)
        steps = np.eye(segment.max() + 1)[segment]
        found.append(Form((channel,), covariate, "course of one run", _spread(steps, rows)))
    return found


def _rows(one: ResidualCovariate, here: np.ndarray) -> np.ndarray:
    rows = here & np.isfinite(one.values)
    return rows if rows.any() and np.ptp(one.values[rows]) > 0 else np.zeros_like(rows)


def _alone(one: ResidualCovariate, rows: np.ndarray) -> tuple[str, np.ndarray]:
    values = one.values[rows]
    if one.name == "table_angle_deg":
        angle = np.radians(values)
        basis = np.stack([f(k * angle) for k in range(1, thresholds.HARMONICS + 1) for f in (np.sin, np.cos)], axis=1)
        return f"harmonics to {thresholds.HARMONICS}", _spread(basis, rows)
    level = levels(values)
    if level.max() + 1 <= thresholds.MAX_LEVELS:
        return "levels", _spread(np.eye(level.max() + 1)[level], rows)
    return "spline", _spread(_spline(values), rows)


def _spline(values: np.ndarray) -> np.ndarray:
    """Return a cubic B-spline basis with knots at quantiles, (n, columns)."""
    inner = np.unique(np.quantile(values, np.linspace(0, 1, thresholds.SPLINE_COLUMNS - 2)))
    knots = np.concatenate([[inner[0]] * 3, inner, [inner[-1]] * 3])
    return BSpline.design_matrix(values, knots, 3).toarray()


def _spread(basis: np.ndarray, rows: np.ndarray) -> np.ndarray:
    columns = np.zeros((len(rows), basis.shape[1]))
    columns[rows] = basis
    return columns


@dataclass(frozen=True)
class ProjectedForm:
    """A form as projected rows (R, C), with the lengths of its columns before."""

    form: Form
    columns: np.ndarray
    length: np.ndarray


def lay(projection: Projection, found: Sequence[Form]) -> list[ProjectedForm]:
    """Return forms as rows of the projection."""
    if not found:
        return []
    whitened = projection.whitened(np.concatenate([one.columns for one in found], axis=1))
    projected = projection.project(whitened)
    length = np.linalg.norm(whitened, axis=0)
    ends = np.cumsum([one.columns.shape[1] for one in found])
    parts = [slice(end - one.columns.shape[1], end) for one, end in zip(found, ends, strict=True)]
    return [ProjectedForm(one, projected[:, part], length[part]) for one, part in zip(found, parts, strict=True)]


def look(projection: Projection, laid: Sequence[ProjectedForm], scans: Sequence[FeatureScan]) -> list[Structure]:
    """Return what each form, and the best detail against each covariate, explains; the least likely by chance first."""
    found = []
    for one in laid:
        explained = explain(projection, one.columns, one.length, thresholds.FORM_RETAINED_MIN)
        channel = dominant_channel(projection, one.form.channels, explained)
        found.append(Structure(channel, (one.form.covariate,), one.form.test, explained))
    found += [_detailed(projection, one.details, detail) for one in scans for detail in _best(projection, one)]
    return sorted((one for one in found if one.score.span.shape[1]), key=lambda one: one.score.p)


def _detailed(projection: Projection, of: FeatureSet, detail: Feature) -> Structure:
    """Return what one detail explains."""
    whole = of.whole(detail, len(projection.residual))
    columns = projection.project(whole)
    explained = explain(projection, columns, np.linalg.norm(whole, axis=0), thresholds.FORM_RETAINED_MIN)
    channel = dominant_channel(projection, of.channels, explained)
    if detail.test != STEP:
        return Structure(channel, detail.covariates, detail.test, explained, detail.text)
    value, sd = sizes(projection, columns, explained.fitted, explained.variance)
    place = of.channels.index(channel)
    return Structure(
        channel, detail.covariates, detail.test, explained, detail.text, (float(value[place]), float(sd[place]))
    )


def _best(projection: Projection, one: FeatureScan) -> list[Feature]:
    """Return the detail with the strongest evidence against each covariate."""
    best: dict[str, tuple[float, Feature]] = {}
    for batch, scores in one.scores(projection.residual[None, :]):
        log_p = stats.chi2.logsf(scores[0], np.maximum(batch.freedom, 1))
        for place, value, freedom in zip(batch.members.tolist(), log_p.tolist(), batch.freedom.tolist(), strict=True):
            detail = one.details.found[place]
            key = " × ".join(each.phrase for each in detail.covariates)
            if freedom and (key not in best or value < best[key][0]):
                best[key] = (value, detail)
    return [detail for _, detail in best.values()]


def dominant_channel(projection: Projection, channels: Sequence[str], found: ScoreTest) -> str:
    """Return the channel in which most is explained."""
    if len(channels) == 1:
        return channels[0]
    names = [one.name for one in projection.fitted.model.campaign.channels]
    squares = projection.strata.sums(found.fitted**2)[:-1]
    worth = {name: float(squares[projection.strata.channel == names.index(name)].sum()) for name in channels}
    return max(worth, key=lambda name: worth[name])
