"""What a fit comes from: unit, dates of the recordings, hashes of data and model, seed and software."""

import platform
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version

from imubayes.inference.fitted_model import Fit
from imubayes.inference.run_fit import model_hash
from imubayes.procedures.ambient import instant
from imubayes.results.fit_file import campaign_hash
from imubayes.results.provenance_record import FitProvenance, SoftwareVersion

# Packages whose version can change a number of a result.
PACKAGES = ("imubayes", "jax", "equinox", "optimistix", "emcee", "arviz-base", "numpy", "scipy", "polars", "pydantic")


def provenance(fit: Fit, seed: int) -> FitProvenance:
    """Return what a fit made now comes from."""
    campaign = fit.model.campaign
    starts = sorted((run.start for run in campaign.runs if run.start), key=instant)
    return FitProvenance(
        serial=campaign.serial,
        first_run=starts[0] if starts else None,
        last_run=starts[-1] if starts else None,
        fitted=datetime.now(UTC).isoformat(timespec="seconds"),
        data_sha256=campaign_hash(fit.model),
        model_sha256=model_hash(fit.model),
        seed=seed,
        software=software(),
    )


def software() -> tuple[SoftwareVersion, ...]:
    """Return the versions of Python and of the packages that make the numbers."""
    found = (SoftwareVersion(package=name, version=_version(name)) for name in PACKAGES)
    return SoftwareVersion(package="Python", version=platform.python_version()), *found


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed as a package"
