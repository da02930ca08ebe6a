"""Where a residual rms is told within runs as well: an offset of the run is no residual of a model that has one."""

WITHIN_RUNS = "Within runs: about the mean of each run, which an offset of the run explains."

_MUCH_LESS = 0.9


def much_less(within: float | None, whole: float | None) -> bool:
    """Tell whether the means of runs are a part of a residual rms that counts: a tenth of it."""
    return within is not None and whole is not None and within < _MUCH_LESS * whole
