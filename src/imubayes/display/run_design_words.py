"""A run that could be made, in words."""

from collections.abc import Iterator

from imubayes.covariates import COVARIATES
from imubayes.inference.candidate_runs import RunDesign, TemperatureProfile


def run_design_text(design: RunDesign) -> str:
    """Return procedure, table and mounting of a run, and what is varied in it."""
    place = design.procedure
    if design.table is not None:
        place += f" on another table than '{design.table}'" if design.another_table else f" on '{design.table}'"
    if design.mounting is not None:
        place += f" in mounting '{design.mounting}'"
    return ("another run: " if design.repeated else "") + ", ".join([place, *_varied(design)])


def _varied(design: RunDesign) -> Iterator[str]:
    if design.max_rate_deg_s is not None:
        yield f"rates to ±{design.max_rate_deg_s:.0f} deg/s"
    if design.positions is not None:
        yield f"{design.positions} positions"
    if design.current_mA is not None:
        yield f"current {design.current_mA:.3g} mA ({design.specific_force_g:g} g)"
    if design.temperature is not None:
        yield _profile(design.temperature)


def _profile(profile: TemperatureProfile) -> str:
    name = COVARIATES[profile.covariate].phrase
    between = f"from {profile.low_degC:.3g} to {profile.high_degC:.3g} degC"
    if profile.form == "ramp":
        return f"{name} ramped {between}"
    return f"{name} cycled within {profile.hours:.2g} h {between}, held, and back three times slower"
