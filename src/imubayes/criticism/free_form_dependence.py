"""Lack of fit: whether the residual of a channel depends on any covariate, in any form.

Each channel, and all channels of a kind together, are tested against each covariate with a form free enough to follow
any broad dependence: one value per level where a covariate was stepped, a cubic spline where it varied freely,
harmonics of the table angle, segments in time for each run by itself.  Narrow, fast or sudden dependences, and products
of two covariates, are left to `imubayes.criticism.localised_structure`.  Forms are projected as candidates are, so that
what the model absorbs is not taken for structure.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy  # loads its parts when they are first used

from imubayes.criticism import thresholds
from imubayes.criticism.localised_structure import Feature, FeatureScan, FeatureSet, Step, time_in_run, time_rank
from imubayes.criticism.projection import Projection
from imubayes.criticism.residual_covariates import ResidualCovariate
from imubayes.criticism.score_test import ScoreTest, generalised_least_squares, score_test
from imubayes.criticism.term_library import levels
from imubayes.tail_probabilities import chi2_log_survival
from imubayes.units import to_si


@dataclass(frozen=True)
class Structure:
    """The dependence of residuals on one covariate, or on a pair of them.

    Attributes
    ----------
    channel : name; of several tested together, the one with most of it.
    covariates : one or two.
    test : the form that was fitted.
    score : what it explains.
    family : of a localised feature: its family of terms, in symbols.
    step : of a step: where it is.
    height : of a step: its height in the channel and the standard deviation of that, in output units.
    """

    channel: str
    covariates: tuple[ResidualCovariate, ...]
    test: str
    score: ScoreTest
    family: str = ""
    step: Step | None = None
    height: tuple[float, float] | None = None


@dataclass(frozen=True)
class FreeForm:
    """A free form on one channel: columns over the entries, before whitening, shape (E, C)."""

    channel: str
    covariate: ResidualCovariate
    test: str
    columns: np.ndarray


@dataclass(frozen=True)
class ProjectedForm:
    """A form on one or more channels as projected rows.

    Attributes
    ----------
    channels, covariate, test : what it is a form of.
    columns : shape (R, C).
    length : shape (C,), of the whitened columns before projection.
    """

    channels: tuple[str, ...]
    covariate: ResidualCovariate
    test: str
    columns: np.ndarray
    length: np.ndarray

    def reweighted(self, projection: Projection, root: np.ndarray) -> "ProjectedForm":
        """Return the same in a projection of rows that were multiplied by `root`, (R,).

        What is retained of a column is what both projections retain.
        """
        columns, before = root[:, None] * self.columns, np.linalg.norm(self.columns, axis=0)
        grown = np.linalg.norm(columns, axis=0) / np.where(before > 0, before, 1.0)
        return replace(self, columns=projection.project(columns), length=self.length * grown)


@dataclass(frozen=True)
class FreeForms:
    """Free forms of single channels, and which of them, by their places, are one form of all channels of a kind."""

    single: tuple[FreeForm, ...]
    together: tuple[tuple[int, ...], ...] = ()


def free_forms(projection: Projection, covariates: Sequence[ResidualCovariate]) -> FreeForms:
    """Return the free forms of every channel, and of all channels of a kind, in every covariate."""
    entries, found = projection.fitted.model.entries, []
    kinds: dict[tuple[str, str], list[int]] = {}
    for place, channel in enumerate(projection.fitted.model.campaign.channels):
        here = (entries.channel == place) & ~entries.closing
        for form in _of_channel(channel.name, here, covariates):
            kinds.setdefault((channel.kind, form.covariate.name), []).append(len(found))
            found.append(form)
        found += _courses(projection, channel.name, here)
    return FreeForms(tuple(found), tuple(tuple(places) for places in kinds.values() if len(places) > 1))


def _of_channel(channel: str, here: np.ndarray, covariates: Sequence[ResidualCovariate]) -> list[FreeForm]:
    found = []
    for covariate in covariates:
        rows = here & np.isfinite(covariate.values)
        if rows.sum() >= thresholds.FORM_MIN_ROWS and np.ptp(covariate.values[rows]) > 0:
            test, basis = _form(covariate, rows)
            if basis.shape[1]:
                found.append(FreeForm(channel, covariate, test, _at_rows(basis, rows)))
    return found


def _courses(projection: Projection, channel: str, here: np.ndarray) -> list[FreeForm]:
    """Return the course of each run by itself: what happens once depends on no covariate that runs share."""
    model, found = projection.fitted.model, []
    for index in range(len(model.campaign.runs)):
        rows = here & (model.entries.run == index)
        count = int(rows.sum())
        if count < thresholds.COURSE_MIN_ROWS:
            continue
        place = np.zeros(len(rows), dtype=int)
        place[rows] = time_rank(projection, rows)
        segment = place[rows] * min(thresholds.MAX_SEGMENTS, count // thresholds.SEGMENT_ROWS) // count
        columns = _at_rows(np.eye(segment.max() + 1)[segment], rows)
        found.append(FreeForm(channel, time_in_run(projection, index, rows, place), "course of one run", columns))
    return found


def _form(covariate: ResidualCovariate, rows: np.ndarray) -> tuple[str, np.ndarray]:
    """Return the name and basis, (n, columns), of the free form in a covariate over some rows."""
    values = covariate.values[rows]
    if covariate.periodic:
        orders, angle = range(1, thresholds.HARMONICS + 1), values * to_si(covariate.unit)
        basis = np.stack([f(order * angle) for order in orders for f in (np.sin, np.cos)], axis=1)
        return f"harmonics to {thresholds.HARMONICS}", basis
    level = levels(values)
    if level.max() + 1 <= thresholds.MAX_LEVELS:
        return "levels", np.eye(level.max() + 1)[level]
    # A cubic B-spline with knots at quantiles.
    inner = np.unique(np.quantile(values, np.linspace(0, 1, thresholds.SPLINE_COLUMNS - 2)))
    knots = np.concatenate([[inner[0]] * 3, inner, [inner[-1]] * 3])
    return "spline", scipy.interpolate.BSpline.design_matrix(values, knots, 3).toarray()


def _at_rows(basis: np.ndarray, rows: np.ndarray) -> np.ndarray:
    columns = np.zeros((len(rows), basis.shape[1]))
    columns[rows] = basis
    return columns


def project_forms(projection: Projection, forms: FreeForms) -> list[ProjectedForm]:
    """Return forms as rows of the projection, those of several channels after those of one."""
    if not forms.single:
        return []
    whitened = projection.whitened(np.concatenate([form.columns for form in forms.single], axis=1))
    ends = np.cumsum([form.columns.shape[1] for form in forms.single])[:-1]
    lengths = np.split(np.linalg.norm(whitened, axis=0), ends)
    columns = np.split(projection.project(whitened), ends, axis=1)
    found = [
        ProjectedForm((form.channel,), form.covariate, form.test, *each)
        for form, *each in zip(forms.single, columns, lengths, strict=True)
    ]
    return found + [_together([found[place] for place in places]) for places in forms.together]


def _together(forms: Sequence[ProjectedForm]) -> ProjectedForm:
    """Return the forms of several channels in the same covariate as one, each channel with its own values."""
    return replace(
        forms[0],
        channels=tuple(name for form in forms for name in form.channels),
        columns=np.concatenate([form.columns for form in forms], axis=1),
        length=np.concatenate([form.length for form in forms]),
    )


def screen_structure(
    projection: Projection, forms: Sequence[ProjectedForm], scans: Sequence[FeatureScan]
) -> list[Structure]:
    """Return what each form, and the best feature against each covariate, explains; the most significant first."""
    found = []
    for each in forms:
        score = score_test(projection, each.columns, each.length, thresholds.FORM_RETAINED_MIN)
        channel = dominant_channel(projection, each.channels, score)
        found.append(Structure(channel, (each.covariate,), each.test, score))
    found += [_of_feature(projection, each.features, best) for each in scans for best in _best(projection, each)]
    return sorted((each for each in found if each.score.span.shape[1]), key=lambda each: each.score.p)


def _of_feature(projection: Projection, of: FeatureSet, feature: Feature) -> Structure:
    """Return what one feature explains."""
    whitened = of.whole(feature, len(projection.residual))
    columns = projection.project(whitened)
    score = score_test(projection, columns, np.linalg.norm(whitened, axis=0), thresholds.FORM_RETAINED_MIN)
    channel, height = dominant_channel(projection, of.channels, score), None
    if feature.step is not None:
        value, sd = generalised_least_squares(projection, columns, score.fitted, score.variance)
        place = of.channels.index(channel)
        height = float(value[place]), float(sd[place])
    return Structure(channel, feature.covariates, feature.test, score, feature.family, feature.step, height)


def _best(projection: Projection, of: FeatureScan) -> list[Feature]:
    """Return the feature with the strongest evidence against each covariate."""
    best: dict[str, tuple[float, Feature]] = {}
    for batch, scores in of.scores(projection.residual[None, :]):
        log_p = chi2_log_survival(scores[0], np.maximum(batch.freedom, 1))
        for place, value, freedom in zip(batch.members.tolist(), log_p.tolist(), batch.freedom.tolist(), strict=True):
            feature = of.features.found[place]
            key = " × ".join(covariate.phrase for covariate in feature.covariates)
            if freedom and (key not in best or value < best[key][0]):
                best[key] = (value, feature)
    return [feature for _, feature in best.values()]


def dominant_channel(projection: Projection, channels: Sequence[str], score: ScoreTest) -> str:
    """Return the channel in which most is explained."""
    if len(channels) == 1:
        return channels[0]
    names = [channel.name for channel in projection.fitted.model.campaign.channels]
    squares = projection.strata.sums(score.fitted**2)[:-1]
    explained = {name: float(squares[projection.strata.channel == names.index(name)].sum()) for name in channels}
    return max(explained, key=lambda name: explained[name])
