"""`imubayes compare`: the model against the measurements."""

from pathlib import Path

from imubayes.cli.options import Flag, Trust


def compare(
    result: Path,
    *,
    parameters: list[str] | None = None,
    runs: list[str] | None = None,
    every: Flag = False,
    trust: Trust = False,
) -> int:
    """Compare the model with the measurements: figures, and goodness of fit per run and channel.

    Example: imubayes compare results/trihedral-imu

    Parameters
    ----------
    result
        Result folder of a fit.
    parameters
        Names for a corner plot; with --every the mounting angles and scale factors that are determined least.
    runs
        Runs that have a figure of their own, or 'all'; with --every the six that fit worst.
    every
        Draw all figures; by default the five that matter most are drawn, and those asked for.
    trust
        Trust the effect files that come along: they are code, and run, now and later, only where they are trusted.
    """
    from imubayes.cli.session import progress, trusting

    with progress() as tell:
        trusting(result, trust)
        from imubayes.display.model_against_measurement import compare as compare_result
        from imubayes.display.model_against_measurement import print_comparison

        comparison = compare_result(result, parameters=parameters, runs=runs, every=every, progress=tell)
    print_comparison(comparison)
    return 0
