"""A share among simulated cases with its 95 % interval, by Clopper and Pearson."""

from scipy.stats import beta


def interval(hits: int, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a share."""
    low = float(beta.ppf(0.025, hits, count - hits + 1)) if hits else 0.0
    return low, float(beta.ppf(0.975, hits + 1, count - hits)) if hits < count else 1.0


def told(hits: int, count: int, digits: int = 0) -> str:
    """Return a share with its interval."""
    low, high = interval(hits, count)
    return f"{hits} of {count} ({100 * low:.{digits}f} … {100 * high:.{digits}f} %)" if count else "–"
