"""`imubayes compare`: the model against the measurements."""

from pathlib import Path


def compare(result: Path, *, parameters: list[str] | None = None) -> int:
    """Compare the model with the measurements: pictures and a table per run and channel.

    Example: imubayes compare results/trihedral-imu

    Parameters
    ----------
    result
        Result folder of a fit.
    parameters
        Names for the corner plot; by default the mounting angles and scale factors that matter most.
    """
    from imubayes.display.comparison import compare as compare_result
    from imubayes.display.terminal import print_comparison

    comparison = compare_result(result, parameters=parameters)
    print_comparison(comparison.runs, comparison.textbook, comparison.pictures)
    return 0
