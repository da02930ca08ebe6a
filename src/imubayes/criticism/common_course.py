"""The same course of residuals in several runs of one input: structure, whatever the autocorrelation of the noise.

Runs that repeat one input profile are replicates, and noise is independent between them.  The mean of their residual
courses is compared with the scatter about it, as lack of fit with pure error: both have the same expectation and the
same autocorrelation under noise alone.  The autocorrelation, estimated from the scatter, where no common course is
left, reduces the degrees of freedom of both (Satterthwaite): ν = n / (1 + 2 Σ (1 − k/n) ρ_k²).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.campaign_data import Run
from imubayes.criticism import thresholds
from imubayes.criticism.free_form_dependence import FreeForm, FreeForms, Structure, project_forms
from imubayes.criticism.localised_structure import time_in_run
from imubayes.criticism.noise_tests import to_entries
from imubayes.criticism.projection import Projection
from imubayes.criticism.residual_covariates import ResidualCovariate
from imubayes.criticism.score_test import score_test
from imubayes.tail_probabilities import f_survival

COMMON_COURSE = "common course of runs"
_PROFILE = ("table_rate", "table_angle", "temperature", "converter_temperature", "current")


@dataclass(frozen=True)
class Replicates:
    """Runs of one input on one channel: their entries in the order of time, (runs, rows)."""

    channel: int
    runs: tuple[int, ...]
    entries: np.ndarray


def common_courses(projection: Projection) -> list[tuple[Structure, float]]:
    """Return the courses that residuals have in common in runs of one input, with p-values for all channels tested.

    Parameters
    ----------
    projection : without a further whitening.

    Returns
    -------
    list
        of those below `thresholds.COMMON_COURSE_P`, the most significant first.
    """
    found = replicates(projection)
    channels = sorted({each.channel for each in found})
    tested = []
    for channel in channels:
        own = [each for each in found if each.channel == channel]
        p = min(1.0, course_p_value(projection, own) * len(channels))
        if p < thresholds.COMMON_COURSE_P:
            tested.append((_structure(projection, own), p))
    return sorted(tested, key=lambda pair: pair[1])


def replicates(projection: Projection) -> list[Replicates]:
    """Return the runs that repeat one input, channel by channel."""
    model = projection.fitted.model
    entries, runs = model.entries, model.campaign.runs
    used = (np.asarray(model.problem.observations.weight) > 0) & ~entries.closing
    rank = np.asarray(model.problem.observations.rank)
    found = []
    for channel in range(len(model.campaign.channels)):
        alike: list[list[tuple[int, np.ndarray]]] = []
        for index in range(len(runs)):
            here = np.flatnonzero(used & (entries.channel == channel) & (entries.run == index))
            if len(here) < thresholds.COURSE_MIN_ROWS:
                continue
            here = here[np.argsort(rank[here], kind="stable")]
            same = next((each for each in alike if _same_input(projection, each[0], (index, here))), None)
            if same is None:
                alike.append([(index, here)])
            else:
                same.append((index, here))
        for group in alike:
            if len(group) > 1:
                rows = min(len(own) for _, own in group)
                members = np.stack([own[:rows] for _, own in group])
                found.append(Replicates(channel, tuple(index for index, _ in group), members))
    return found


def _same_input(projection: Projection, first: tuple[int, np.ndarray], second: tuple[int, np.ndarray]) -> bool:
    """Tell whether two runs repeat one input: every covariate that varies, and the input of the channel, row by row."""
    model = projection.fitted.model
    one, other = model.campaign.runs[first[0]], model.campaign.runs[second[0]]
    rows = min(len(first[1]), len(second[1]))
    if one.procedure != other.procedure or max(len(first[1]), len(second[1])) > rows + thresholds.COURSE_ROWS_APART:
        return False
    row = model.entries.row[first[1][:rows]], model.entries.row[second[1][:rows]]
    varies = False
    for name in _PROFILE:
        pair = _values(one, name, row[0]), _values(other, name, row[1])
        least = thresholds.STEADY_DEGREES if name.endswith("temperature") else 0.0
        if max(_range(pair[0]), _range(pair[1])) > least:
            varies = True
            if not _alike(*pair):
                return False
    felt = projection.input[first[1][:rows]], projection.input[second[1][:rows]]
    largest = max(float(np.abs(each).max()) for each in felt)
    if max(_range(each) for each in felt) > thresholds.STEADY_INPUT * largest:
        return _alike(*felt)
    return varies


def _values(run: Run, name: str, rows: np.ndarray) -> np.ndarray:
    values = run.covariates.get(name)
    return np.full(len(rows), np.nan) if values is None else np.asarray(values, dtype=float)[rows]


def _range(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(np.ptp(known)) if known.size else 0.0


def _alike(first: np.ndarray, second: np.ndarray) -> bool:
    """Tell whether two courses agree in every row, but for a small share of their range."""
    known = np.isfinite(first)
    if not np.array_equal(known, np.isfinite(second)):
        return False
    allowed = thresholds.SAME_LEVEL * max(_range(first), _range(second))
    return bool(np.all(np.abs(first - second)[known] <= allowed))


def course_p_value(projection: Projection, of: Sequence[Replicates]) -> float:
    """Return the p-value of a common course under noise that is independent between runs.

    Parameters
    ----------
    of : replicates on one channel, or several sets of them.
    """
    count = len(projection.fitted.model.entries)
    whole = to_entries(projection, np.concatenate([projection.residual[:, None], projection.basis], axis=1))
    common, scatter, freedom, apart = 0.0, 0.0, np.zeros(2), []
    assert len(whole) == count
    for each in of:
        courses = whole[each.entries]
        courses = courses - courses.mean(axis=1, keepdims=True)
        runs, rows = each.entries.shape
        mean = courses.mean(axis=0)
        rest = courses - mean
        common += runs * float(np.sum(mean[:, 0] ** 2))
        scatter += float(np.sum(rest[:, :, 0] ** 2))
        absorbed = np.array([runs * np.sum(mean[:, 1:] ** 2), np.sum(rest[:, :, 1:] ** 2)])
        freedom += np.array([rows - 1, (runs - 1) * (rows - 1)]) - absorbed
        apart.append(rest[:, :, 0])
    if freedom.min() < 1 or not scatter > 0:
        return 1.0
    effective = freedom / inflation(apart)
    ratio = (common / freedom[0]) / (scatter / freedom[1])
    return float(f_survival(ratio, *effective))


def inflation(apart: Sequence[np.ndarray]) -> float:
    """Return 1 + 2 Σ (1 − k/n) ρ_k² of courses, (runs, rows) each, to the first lag without positive correlation."""
    whole = sum(float(np.sum(each**2)) for each in apart)
    rows = min(each.shape[1] for each in apart)
    total = 1.0
    for lag in range(1, rows // 2):
        rho = sum(float(np.sum(each[:, lag:] * each[:, :-lag])) for each in apart) / whole
        # A mean and a slope removed from n rows lower each autocorrelation by some 2/n.
        rho += 2 * (1 + rho) / rows
        if rho <= 2 / rows:
            break
        total += 2 * (1 - lag / rows) * min(rho, 1.0) ** 2
    return total


def _structure(projection: Projection, of: Sequence[Replicates]) -> Structure:
    """Return the common course as a structure, one value per row of the replicated runs."""
    model = projection.fitted.model
    largest = max(of, key=lambda each: len(each.runs))
    rows = np.zeros(len(model.entries), dtype=bool)
    rows[largest.entries] = True
    columns = np.zeros((len(model.entries), largest.entries.shape[1]))
    place = np.zeros(len(model.entries), dtype=int)
    for own in largest.entries:
        columns[own, np.arange(len(own))] = 1.0
        place[own] = np.arange(len(own))
    first = time_in_run(projection, largest.runs[0], rows & (model.entries.run == largest.runs[0]), place)
    names = [model.campaign.runs[index].name for index in largest.runs]
    said = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
    covariate = ResidualCovariate(first.name, first.unit, first.values, f"time alike in runs of one input ({said})")
    channel = model.campaign.channels[largest.channel].name
    form = project_forms(projection, FreeForms((FreeForm(channel, covariate, COMMON_COURSE, columns),)))[0]
    score = score_test(projection, form.columns, form.length, thresholds.FORM_RETAINED_MIN)
    return Structure(channel, (covariate,), COMMON_COURSE, score)
