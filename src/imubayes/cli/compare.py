"""`imubayes compare`: the model against the measurements."""

from pathlib import Path


def compare(result: Path, *, parameters: list[str] | None = None, runs: list[str] | None = None) -> int:
    """Compare the model with the measurements: figures, and goodness of fit per run and channel.

    Example: imubayes compare results/trihedral-imu

    Parameters
    ----------
    result
        Result folder of a fit.
    parameters
        Names for the corner plot; by default the mounting angles and scale factors that are determined least.
    runs
        Runs that have a figure of their own, or 'all'; by default the six that fit worst.
    """
    from imubayes.cli.session import progress

    with progress() as tell:
        from imubayes.display.model_against_measurement import compare as compare_result
        from imubayes.display.model_against_measurement import print_comparison

        comparison = compare_result(result, parameters=parameters, runs=runs, progress=tell)
    print_comparison(comparison)
    return 0
