"""Localised structure: narrow, fast or sudden features that a free form over the whole range is too stiff to follow.

Each family of terms of the library, and a step at each of some instants of each run, is tested on all channels of a
kind together, each channel with its own amplitude.  Products of two covariates are among them: a form free in both
would have too many degrees of freedom.  Features are many and each has few directions: their scores come from products
of matrices, and only the best against each covariate is tested in full.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from imubayes.criticism import thresholds
from imubayes.criticism.projection import Projection
from imubayes.criticism.residual_covariates import ResidualCovariate
from imubayes.criticism.term_library import Term, library

STEP = "step"


@dataclass(frozen=True)
class Step:
    """A step in one run: at a time in seconds, or from a row, as `unit` says."""

    run: str
    at: float
    unit: Literal["s", "row"]


@dataclass(frozen=True)
class Feature:
    """One family of terms: its covariates, one or two, sort of test, places of its columns, and symbols; or a step.

    `plain` tells whether it is of second order at most.
    """

    covariates: tuple[ResidualCovariate, ...]
    test: str
    columns: tuple[int, ...]
    family: str = ""
    step: Step | None = None
    plain: bool = False


@dataclass(frozen=True)
class FeatureSet:
    """The features of one kind of channel, whitened.

    Attributes
    ----------
    channels : names, C of them.
    rows : the rows of the projection that hold each channel.
    columns : one per channel, shape (rows of it, N), whitened.
    found : the features that the N columns belong to.
    """

    channels: tuple[str, ...]
    rows: tuple[np.ndarray, ...]
    columns: tuple[np.ndarray, ...]
    found: tuple[Feature, ...]

    def whole(self, feature: Feature, height: int) -> np.ndarray:
        """Return the whitened columns of a feature over all rows, (height, C · its columns), channel by channel."""
        chosen = list(feature.columns)
        result = np.zeros((height, len(self.channels) * len(chosen)))
        for place, (rows, columns) in enumerate(zip(self.rows, self.columns, strict=True)):
            result[rows, place * len(chosen) : (place + 1) * len(chosen)] = columns[:, chosen]
        return result

    def reweighted(self, root: np.ndarray) -> "FeatureSet":
        """Return the features of rows that were multiplied by `root`, (R,)."""
        columns = tuple(root[rows, None] * own for rows, own in zip(self.rows, self.columns, strict=True))
        return replace(self, columns=columns)


@dataclass(frozen=True)
class FeatureBatch:
    """Features with equally many columns, ready to be scored.

    Attributes
    ----------
    members : places among the features, (F,).
    index : shape (F, k), columns of each.
    white : shape (F, C · k, C · k), from the products of columns with a residual to independent scores.
    freedom : shape (F,), degrees of freedom that the model does not absorb.
    """

    members: np.ndarray
    index: np.ndarray
    white: np.ndarray
    freedom: np.ndarray


@dataclass(frozen=True)
class FeatureScan:
    """Features with what the model absorbs projected out."""

    features: FeatureSet
    basis: np.ndarray
    batches: tuple[FeatureBatch, ...]

    def scores(self, residuals: np.ndarray) -> list[tuple[FeatureBatch, np.ndarray]]:
        """Return for each batch the drops of χ², shape (n, F), of residuals (n, R); they need not be projected."""
        left = residuals - (residuals @ self.basis) @ self.basis.T
        products = [left[:, rows] @ each for rows, each in zip(self.features.rows, self.features.columns, strict=True)]
        found = []
        for batch in self.batches:
            along = np.concatenate([product[:, batch.index] for product in products], axis=2)
            found.append((batch, np.sum(np.einsum("nfa,fab->nfb", along, batch.white, optimize=True) ** 2, axis=2)))
        return found


def features(projection: Projection, covariates: Sequence[ResidualCovariate]) -> list[FeatureSet]:
    """Return the features of each kind of channel; none where there are too many samples."""
    model = projection.fitted.model
    entries, gravity = model.entries, model.campaign.site.gravity
    result = []
    for kind in dict.fromkeys(channel.kind for channel in model.campaign.channels):
        places = [place for place, channel in enumerate(model.campaign.channels) if channel.kind == kind]
        here = np.isin(entries.channel, places) & ~entries.closing
        if not thresholds.FEATURE_MIN_ROWS <= here.sum() <= thresholds.FEATURE_MAX_ROWS:
            continue
        columns, found = _of_terms(covariates, here, gravity)
        steps, sudden = _steps(projection, here, len(columns))
        columns, found = [*columns, *steps], (*found, *sudden)
        if columns:
            result.append(feature_set(projection, places, np.stack(columns, axis=1), found))
    return result


def feature_set(
    projection: Projection, places: Sequence[int], columns: np.ndarray, found: tuple[Feature, ...]
) -> FeatureSet:
    """Return features on some channels, by their places, of columns (E, N) in datasheet units."""
    entries, channels = projection.fitted.model.entries, projection.fitted.model.campaign.channels
    here = np.isin(entries.channel, places) & ~entries.closing
    rows = tuple(np.flatnonzero(here & (entries.channel == place)) for place in places)
    whitened = _whitened(projection, np.where(here[:, None], columns, 0.0), here)
    return FeatureSet(tuple(channels[k].name for k in places), rows, tuple(whitened[each] for each in rows), found)


def _of_terms(
    covariates: Sequence[ResidualCovariate], here: np.ndarray, gravity: float
) -> tuple[list[np.ndarray], list[Feature]]:
    columns: list[np.ndarray] = []
    families: dict[tuple[str, str], list[tuple[int, Term]]] = {}
    for term in library(covariates, here, gravity):
        families.setdefault((term.sort, term.family), []).append((len(columns), term))
        columns.append(np.where(here, term.values, 0.0))
    found = [
        Feature(term.covariates, term.sort, tuple(place for place, _ in terms), term.family, plain=term.plain)
        for terms in families.values()
        for term in [terms[0][1]]
    ]
    return columns, found


def _steps(projection: Projection, here: np.ndarray, first: int) -> tuple[list[np.ndarray], list[Feature]]:
    """Return a step at each of some instants of each run: what happens once depends on no covariate that runs share."""
    model = projection.fitted.model
    columns, found = [], []
    for index in range(len(model.campaign.runs)):
        within = here & (model.entries.run == index)
        # Rank in time among the samples of the same channel.
        place, count = np.zeros(len(within), dtype=int), 0
        for channel in np.unique(model.entries.channel[within]):
            rows = within & (model.entries.channel == channel)
            place[rows] = time_rank(projection, rows)
            count = max(count, int(rows.sum()))
        if count < thresholds.FEATURE_MIN_ROWS:
            continue
        covariate = time_in_run(projection, index, within, place)
        parts = min(thresholds.MAX_STEP_PARTS, count // thresholds.STEP_PART_ROWS)
        for part in range(1, parts):
            after = within & (place * parts >= part * count)
            at = float(np.nanmin(covariate.values[after]))
            step = Step(model.campaign.runs[index].name, at, "s" if covariate.name == "time_s" else "row")
            found.append(Feature((covariate,), STEP, (first + len(columns),), step=step))
            columns.append(after.astype(float))
    return columns, found


def time_rank(projection: Projection, rows: np.ndarray) -> np.ndarray:
    """Return the rank in time, from 0, of some entries, (E,) bool, of one run and channel."""
    rank = np.asarray(projection.fitted.model.problem.observations.rank)[rows]
    return np.argsort(np.argsort(rank, kind="stable"))


def time_in_run(projection: Projection, index: int, rows: np.ndarray, place: np.ndarray) -> ResidualCovariate:
    """Return time within one run, or the row where it has no time.

    Parameters
    ----------
    rows : shape (E,) bool.
    place : shape (E,), the row's number.
    """
    model = projection.fitted.model
    run = model.campaign.runs[index]
    time = run.covariates.get("time")
    values = np.full(len(rows), np.nan)
    values[rows] = time[model.entries.row[rows]] if time is not None else place[rows]
    return ResidualCovariate("time_s" if time is not None else "row", "s", values, f"time within run {run.name}")


def _whitened(projection: Projection, columns: np.ndarray, here: np.ndarray) -> np.ndarray:
    """Return columns (E, N) as rows, scaled to comparable lengths, (R, N)."""
    size = np.abs(columns[here]).max(axis=0)
    columns = columns / np.where(size > 0, size, 1.0)
    blocks = []
    for start in range(0, columns.shape[1], thresholds.WHITENING_BLOCK):
        block = columns[:, start : start + thresholds.WHITENING_BLOCK]
        padded = np.concatenate([block, np.zeros((len(block), thresholds.WHITENING_BLOCK - block.shape[1]))], axis=1)
        blocks.append(projection.whitened(padded)[:, : block.shape[1]])
    return np.concatenate(blocks, axis=1)


def scan_features(projection: Projection, of: FeatureSet) -> FeatureScan:
    """Return features with everything projected out that the projection removes."""
    basis = projection.basis
    taken = [basis[rows].T @ columns for rows, columns in zip(of.rows, of.columns, strict=True)]
    widths = np.array([len(feature.columns) for feature in of.found])
    batches = []
    for width in np.unique(widths).tolist():
        members = np.flatnonzero(widths == width)
        index = np.array([of.found[place].columns for place in members])
        batches.append(_batch(of, taken, members, index))
    return FeatureScan(of, basis, tuple(batches))


def _batch(of: FeatureSet, taken: Sequence[np.ndarray], members: np.ndarray, index: np.ndarray) -> FeatureBatch:
    absorbed = np.concatenate([each[:, index] for each in taken], axis=2)
    count, width = index.shape
    size = len(of.channels) * width
    squares = np.zeros((count, size, size))
    for place, columns in enumerate(of.columns):
        part = slice(place * width, (place + 1) * width)
        own = columns[:, index]
        squares[:, part, part] = np.einsum("rfa,rfb->fab", own, own, optimize=True)
    length = np.sqrt(np.einsum("faa->fa", squares))
    scale = np.where(length > 0, 1 / np.where(length > 0, length, 1.0), 0.0)
    left = squares - np.einsum("pfa,pfb->fab", absorbed, absorbed, optimize=True)
    values, axes = np.linalg.eigh(left * scale[:, :, None] * scale[:, None, :])
    retained = values > thresholds.FORM_RETAINED_MIN
    white = scale[:, :, None] * axes * np.where(retained, 1 / np.sqrt(np.where(retained, values, 1.0)), 0.0)[:, None, :]
    return FeatureBatch(members, index, white, retained.sum(axis=1))
