"""Covariates available to effects: recorded ones, temperature rates, and time since the start of the campaign."""

from datetime import UTC, datetime

import numpy as np

from imubayes.campaign_data import Campaign, Run
from imubayes.covariates import ambient_names

# A temperature range below half a degree, or fewer rows than a line and its residual variance need, gives no usable
# rate; windows widen until the noise of the slopes is a tenth of their size.
_LEAST_CHANGE, _LEAST_ROWS, _SLOPE_NOISE = 0.5, 4, 0.1


def ambient_of(run: Run, row: np.ndarray, campaign: Campaign | None = None) -> dict[str, np.ndarray]:
    """Return the recorded covariates of a run at the given rows, and those derived from them.

    Temperature rates are derived where temperature varies with recorded time.  `campaign_time` counts from the first
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


def _since_first(run: Run, campaign: Campaign | None) -> float | None:
    """Return the time from the start of the first dated run of the campaign to the start of this run, s."""
    starts = [other.start for other in campaign.runs if other.start] if campaign is not None else []
    if not starts and run.start is None:
        return 0.0
    if run.start is None:
        return None
    return (_instant(run.start) - min(map(_instant, [run.start, *starts]))).total_seconds()


def _instant(start: str) -> datetime:
    """Return date and time as UTC unless a time zone is given, so that instants can be compared."""
    at = datetime.fromisoformat(start)
    return at if at.tzinfo else at.replace(tzinfo=UTC)


def rate_of_change(time: np.ndarray, values: np.ndarray) -> np.ndarray | None:
    """Return the rate of a recorded temperature at every row, °C/s, shape (R,); None if it is constant.

    A straight line is fitted to the neighbours of each row: two on either side, or more (4, 8, … up to an eighth of
    the run) until the slopes are significant against their standard deviations.

    Parameters
    ----------
    time : shape (R,), s, in any order.
    values : shape (R,), °C.
    """
    rows = len(time)
    finite = np.all(np.isfinite(time)) and np.all(np.isfinite(values))
    if rows < _LEAST_ROWS or not finite or np.ptp(time) == 0 or np.ptp(values) < _LEAST_CHANGE:
        return None
    order = np.argsort(time, kind="stable")
    reach = 2
    slope, deviation = _local_slopes(time[order], values[order], reach)
    while np.mean(deviation**2) > (_SLOPE_NOISE**2) * np.mean(slope**2) and 2 * reach <= rows // 8:
        reach *= 2
        slope, deviation = _local_slopes(time[order], values[order], reach)
    found = np.empty(rows)
    found[order] = slope
    return found


def _local_slopes(time: np.ndarray, values: np.ndarray, reach: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the slope at each row and its standard deviation, from running sums over `reach` rows on either side."""
    rows = len(time)
    first = np.maximum(np.arange(rows) - reach, 0)
    last = np.minimum(np.arange(rows) + reach + 1, rows)
    t, v = time - time.mean(), values - values.mean()

    def window(terms: np.ndarray) -> np.ndarray:
        total = np.concatenate([[0.0], np.cumsum(terms)])
        return total[last] - total[first]

    count = (last - first).astype(float)
    mean_t, mean_v = window(t) / count, window(v) / count
    spread = window(t * t) - count * mean_t**2
    common = window(t * v) - count * mean_t * mean_v
    timed = spread > 1e-12 * np.ptp(time) ** 2
    slope = np.where(timed, common / np.where(timed, spread, 1.0), 0.0)
    scatter = np.maximum(window(v * v) - count * mean_v**2 - slope * common, 0.0)
    freedom = np.maximum(count - 2, 1.0)
    return slope, np.sqrt(np.where(timed, scatter / freedom / np.where(timed, spread, 1.0), 0.0))
