"""A share among simulated cases with its 95 % interval, by Clopper and Pearson."""

from scipy.stats import binomtest


def interval(hits: int, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a share."""
    found = binomtest(hits, count).proportion_ci(0.95, method="exact")
    return float(found.low), float(found.high)


def told(hits: int, count: int, digits: int = 0) -> str:
    """Return a share with its interval."""
    low, high = interval(hits, count)
    return f"{hits} of {count} ({100 * low:.{digits}f} … {100 * high:.{digits}f} %)" if count else "–"
