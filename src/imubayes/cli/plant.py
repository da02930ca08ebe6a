"""`imubayes plant`: whether an effect would have been found."""

from pathlib import Path
from typing import Annotated

import cyclopts

from imubayes.cli.options import Json, Names, Trust, print_json, split


def plant(
    campaign: Path | None = None,
    *,
    model: Path | None = None,
    result: Path | None = None,
    effects: Names = None,
    size: float | None = None,
    delta_chi2: Annotated[float, cyclopts.Parameter(name="--delta-chi2")] = 50.0,
    draws: int = 20,
    seed: int = 0,
    as_json: Json = False,
    trust: Trust = False,
) -> int:
    """Plant effects into data simulated from the fit, and see which the diagnosis would have found.

    Example: imubayes plant data/trihedral-imu --model models/trihedral-imu.toml --effects gyro_g2_sensitivity

    Parameters
    ----------
    campaign
        Folder with campaign.toml; not needed with --result.
    model
        Model file, fitted first.
    result
        Result folder to take instead of fitting.
    effects
        Effects to plant; by default all that the model lacks.
    size
        Plant at this multiple of the largest size met in practice.
    delta_chi2
        Plant at the size at which adding the effect would lower chi2 by this much.
    draws
        Simulations with nothing planted, for the rate of false alarms.
    seed
        Seed of the simulations.
    as_json
        Print one JSON object on standard output.
    trust
        Trust the effect files that come along: they are code, and run, now and later, only where they are trusted.
    """
    from imubayes.cli.session import progress, start_jax, trusting

    with progress() as tell:
        start_jax()
        trusting(result, trust)
        from imubayes.api import plant as plant_effects
        from imubayes.display.injection_report import injection_json, injection_report
        from imubayes.display.report_layout import print_report
        from imubayes.loop.injection_recovery import Size

        trials = plant_effects(
            campaign, model, result=result, effects=split(effects),
            size=Size(delta_chi2, size), draws=draws, seed=seed, progress=tell,
        )  # fmt: skip
    if as_json:
        print_json(injection_json(trials))
    else:
        print_report(injection_report(trials))
    return 0
