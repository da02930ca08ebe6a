"""Covariates available to effects: recorded ones, temperature rates, and time since the start of the campaign."""

from collections.abc import Collection, Iterable, Sequence
from datetime import UTC, datetime

import numpy as np

from imubayes.foundations.campaign_data import Campaign, Run
from imubayes.foundations.covariates import COVARIATES, ambient_names

# A temperature range below half a degree, or fewer rows than a line and its residual variance need, gives no usable
# rate; windows widen until the noise of the slopes is a tenth of their size.
_LEAST_CHANGE, _LEAST_ROWS, _SLOPE_NOISE = 0.5, 4, 0.1
# The line through rows on one side is taken if the standard deviation of its slope is below this share of that of
# the line through both: by chance in 1 % of the rows with two rows on either side.
_CORNER = 0.2
# So many changes between repeated values are steps of the resolution.
_LEAST_STEPS = 3


def ambient_of(run: Run, row: np.ndarray, campaign: Campaign | None = None) -> dict[str, np.ndarray]:
    """Return the recorded covariates of a run at the given rows, and those derived from them.

    Temperature rates are derived if temperature varies with recorded time.  `campaign_time` counts from the first
    dated run of the campaign, or from the start of the run itself if no run is dated; an undated run among dated ones
    has none.
    """
    covariates = {name: run.covariates[name] for name in ambient_names() if name in run.covariates}
    time = covariates.get("time")
    if time is not None:
        for name in ("temperature", "converter_temperature"):
            rate = rate_of_change(time, covariates[name]) if name in covariates else None
            if rate is not None:
                covariates[f"{name}_rate"] = rate
        delay = _since_first(run, campaign)
        if delay is not None:
            covariates["campaign_time"] = delay + time
    return {name: values[row] for name, values in covariates.items() if np.all(np.isfinite(values))}


def unknown_covariates(run: Run, needs: Sequence[str], supplied: Collection[str]) -> tuple[str, ...]:
    """Return those of the covariates that have some value in a run which nobody knows.

    A temperature that is known to be constant has no rate of change, and the rate of one that is unknown follows it.
    """
    return tuple(
        name
        for name in needs
        if name in COVARIATES and not COVARIATES[name].absent and name not in supplied
        and not (_is_steady(run, name) or _of_rate(name) in set(needs) - set(run.covariates))
    )  # fmt: skip


def _of_rate(name: str) -> str:
    """Return the covariate whose rate of change this one is; empty if it is none."""
    return name.removesuffix("_rate") if name.endswith("_rate") else ""


def _is_steady(run: Run, rate: str) -> bool:
    values = run.covariates.get(_of_rate(rate))
    return values is not None and bool(np.ptp(values) < _LEAST_CHANGE)


def _since_first(run: Run, campaign: Campaign | None) -> float | None:
    """Return the time from the start of the first dated run of the campaign to the start of this run, s."""
    starts = [other.start for other in campaign.runs if other.start] if campaign is not None else []
    if not starts and run.start is None:
        return 0.0
    if run.start is None:
        return None
    return (instant(run.start) - min(map(instant, [run.start, *starts]))).total_seconds()


def instant(start: str) -> datetime:
    """Return date and time as UTC unless a time zone is given, so that instants can be compared."""
    at = datetime.fromisoformat(start)
    return at if at.tzinfo else at.replace(tzinfo=UTC)


def starts_of(runs: Iterable[Run]) -> list[str]:
    """Return date and time at which runs began, if that is stated, the first first whatever their time zones."""
    return sorted((run.start for run in runs if run.start), key=instant)


def rate_of_change(time: np.ndarray, values: np.ndarray) -> np.ndarray | None:
    """Return the rate of a recorded temperature at every row, °C/s, shape (R,); None if it is constant.

    A straight line is fitted to the neighbours of each row: two on either side, or more (4, 8, … up to an eighth of
    the run) until the slopes are significant against their standard deviations.  If a ramp begins or ends, the line
    through as many rows on one side is taken that fits far better: a slope across the corner belongs to neither ramp
    (the edge-preserving choice of window of Kuwahara et al. 1976).

    Parameters
    ----------
    time : shape (R,), s, in any order.
    values : shape (R,), °C.
    """
    rows = len(time)
    finite = np.all(np.isfinite(time)) and np.all(np.isfinite(values))
    if rows < _LEAST_ROWS or not finite or np.ptp(time) == 0 or np.ptp(values) < _LEAST_CHANGE:
        return None
    order, reach = np.argsort(time, kind="stable"), 2
    while True:
        slope, deviation, sided, corner = _local_slopes(time[order], values[order], reach)
        chosen = np.where(corner, sided, slope)
        noise = np.sum(deviation[~corner] ** 2) / max(np.sum(~corner), 1)
        significant = noise <= _SLOPE_NOISE**2 * np.mean(chosen**2)
        if significant or 2 * reach > rows // 8:
            break
        reach *= 2
    found = np.empty(rows)
    # Of a slope that noise or resolution conceals a corner shows nothing.
    found[order] = chosen if significant else slope
    return found


def _local_slopes(
    time: np.ndarray, values: np.ndarray, reach: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return slopes from `reach` rows on either side, their standard deviations, those from one side, and the corners.

    All of shape (R,); `corner` states where the line through twice as many rows on one side fits far better.
    """
    row, last = np.arange(len(time)), len(time) - 1
    slope, deviation = _slopes_between(time, values, np.maximum(row - reach, 0), np.minimum(row + reach, last))
    before, scatter_before = _slopes_between(time, values, np.maximum(row - 2 * reach, 0), row)
    after, scatter_after = _slopes_between(time, values, row, np.minimum(row + 2 * reach, last))
    sided = np.where(scatter_before < scatter_after, before, after)
    return slope, deviation, sided, np.minimum(scatter_before, scatter_after) < _CORNER * deviation


def _slopes_between(
    time: np.ndarray, values: np.ndarray, first: np.ndarray, last: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the slope of the rows `first` to `last` (inclusive) and its standard deviation, from running sums.

    The standard deviation is infinite if there are fewer than three rows, or no time passes.
    """
    t, v = time - time.mean(), values - values.mean()

    def window(terms: np.ndarray) -> np.ndarray:
        total = np.concatenate([[0.0], np.cumsum(terms)])
        return total[last + 1] - total[first]

    count = (last - first + 1).astype(float)
    mean_t, mean_v = window(t) / count, window(v) / count
    spread = window(t * t) - count * mean_t**2
    common = window(t * v) - count * mean_t * mean_v
    timed = spread > 1e-12 * np.ptp(time) ** 2
    slope = np.where(timed, common / np.where(timed, spread, 1.0), 0.0)
    # What is left if a line fits exactly is rounding.
    least = np.maximum(1e-12 * np.ptp(values) ** 2, (count - 2) * resolution(values) ** 2 / 12)
    scatter = np.maximum(window(v * v) - count * mean_v**2 - slope * common, least)
    known = timed & (count > 2)
    return slope, np.sqrt(np.where(known, scatter / np.where(known, (count - 2) * spread, 1.0), np.inf))


def resolution(values: np.ndarray) -> float:
    """Return the resolution of a record that repeats values and then changes by one step, 0 if it does not.

    Parameters
    ----------
    values : shape (R,), in the order of time.
    """
    change = np.abs(np.diff(values))
    repeated = change <= 1e-9 * np.ptp(values)
    steps = change[1:-1][~repeated[1:-1] & repeated[:-2] & repeated[2:]]
    return float(np.median(steps)) if len(steps) >= _LEAST_STEPS else 0.0
