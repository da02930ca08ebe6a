"""`fit.json`: what it takes to go on from a result without fitting again, and what the fit comes from.

The data stay in the campaign folder; a result says where that was and what its content was, so that a campaign that has
moved is found and one that has changed is noticed.

The provenance of a fit is its unit, dates of the recordings, hashes of data and model, seed and software.
"""

import math
import os
import platform
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from imubayes.campaign import load_campaign
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.errors import input_error
from imubayes.foundations.records import finite
from imubayes.inference.fitted_model import Fit
from imubayes.inference.run_fit import campaign_hash, model_hash
from imubayes.loop.model_history import Node, node_id
from imubayes.model.bind import Model, bind
from imubayes.model.model_file import read_carried_model
from imubayes.parameters.declarations import Layout
from imubayes.procedures.ambient import starts_of
from imubayes.results.folder_files import FIT, MODEL
from imubayes.results.history_tree import CampaignPlaces, FitRecord, _folder, read_fit_record
from imubayes.results.summary import FitProvenance, SoftwareVersion, Summary


def fit_record(fit: Fit, folder: Path, seed: int) -> FitRecord:
    """Return the contents of `fit.json` of a result in `folder`."""
    model = fit.model
    return FitRecord(
        campaign=_places(model.campaign, folder),
        data_hash=campaign_hash(model),
        model_hash=model_hash(model),
        z=_by_name(model.layout, fit.z),
        h=_by_name(model.hyper_layout, fit.h),
        converged=fit.converged,
        optimised=fit.optimised,
        message=fit.message,
        seed=seed,
        campaign_notes=model.campaign.notes,
    )


def _places(campaign: Campaign, folder: Path) -> CampaignPlaces:
    if not campaign.folder:
        return CampaignPlaces()
    absolute = Path(campaign.folder).resolve()
    from_result = os.path.relpath(absolute, folder.resolve())
    return CampaignPlaces(given=campaign.folder, absolute=str(absolute), from_result=from_result)


def _by_name(layout: Layout, z: np.ndarray) -> dict[str, float | None]:
    numbers = np.asarray(z).tolist()
    return {name: finite(value) for name, value in zip(layout.names, numbers, strict=True)}


def read_fit(folder: str | Path) -> Fit:
    """Return the fit of a result folder, its campaign read again and its model declared; nothing is refit.

    Parameters
    ----------
    folder : as written by a fit.

    Raises
    ------
    InputError
        if the folder holds no fit, the campaign is gone, or campaign or model are not those that were fit.
    """
    folder = Path(folder)
    record, spec = read_fit_record(folder), read_carried_model(folder / MODEL)
    # The fit has held the same outputs against the same set-up.
    found = load_campaign(_folder(record.campaign, folder), judge_setup=record.campaign_notes is None)
    found = replace(found, notes=record.campaign_notes or found.notes)
    model = bind(spec, found)
    if campaign_hash(model) != record.data_hash:
        raise input_error(
            f"the campaign '{found.name}' is no longer the one that was fitted",
            found.folder or f"{folder / FIT}, key 'data_hash'",
            "the files exactly as they were fitted, campaign.toml included",
            "restore the campaign, or fit it as it is now: `imubayes fit CAMPAIGN --model "
            f"{folder / MODEL} --out FOLDER`",
        )
    z, h = _in_order(model.layout, record.z, folder), _in_order(model.hyper_layout, record.h, folder)
    if model_hash(model) != record.model_hash:
        raise input_error(
            "the model is no longer the one that was fitted: an effect file or the version of imubayes has changed",
            str(folder / MODEL),
            "the effect files and the version of the fit, which `provenance` in summary.json states",
            "restore them; to fit the model as it is now: "
            f"`imubayes fit CAMPAIGN --model {folder / MODEL} --out ANOTHER`",
        )
    optimised = record.converged if record.optimised is None else record.optimised
    return Fit(model, z, h, optimised, record.message, sampled=record.converged or not optimised)


def _in_order(layout: Layout, by_name: dict[str, float | None], folder: Path) -> np.ndarray:
    if set(by_name) != set(layout.names):
        changed = sorted(set(by_name) ^ set(layout.names))
        raise input_error(
            f"the model declares other parameters than were fitted: {', '.join(changed[:4])}",
            f"{folder / MODEL}",
            "the model file as the fit wrote it, and the effects as they were at that time",
            "run the fit again",
        )
    numbers = [by_name[name] for name in layout.names]
    return np.array([math.nan if value is None else value for value in numbers], dtype=float)


# Packages whose version can change a number of a result.
PACKAGES = ("imubayes", "jax", "equinox", "optimistix", "emcee", "arviz-base", "numpy", "scipy", "polars", "pydantic")


def provenance(fit: Fit, seed: int) -> FitProvenance:
    """Return what a fit made now comes from."""
    campaign = fit.model.campaign
    starts = starts_of(campaign.runs)
    return FitProvenance(
        serial=campaign.serial,
        first_run=starts[0] if starts else None,
        last_run=starts[-1] if starts else None,
        fitted=datetime.now(UTC).isoformat(timespec="seconds"),
        data_sha256=campaign_hash(fit.model),
        model_sha256=model_hash(fit.model),
        seed=seed,
        software=software(),
        priors_from=fit.model.spec.priors_from,
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


def node_of(model: Model, summary: Summary, seed: int, above: str = "", **more: Any) -> Node:
    """Return the node of a fit in the history of models, `history.json`.

    Parameters
    ----------
    above : id of the node that it was made from; empty for a fit that was made from no other.
    more : what else is known of it; whether it is taken, and why not, follow from the fit if they do not stand here.
    """
    data, made = campaign_hash(model), model_hash(model)
    said = {"taken": summary.converged, "message": summary.message} | more
    known = summary.known_noise if said["taken"] else None
    return Node(
        id=node_id(data, made, seed, above),
        model=model.spec.name,
        chi2=known.chi2 if known is not None else None,
        dof=known.dof if known is not None else None,
        rms=known.channels if known is not None else (),
        data_hash=data,
        model_hash=made,
        seed=seed,
        **said,
    )
