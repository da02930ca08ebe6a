"""The record of a fit, and the campaign it belongs to."""

from pathlib import Path
from typing import Literal

from imubayes.campaign import load_campaign
from imubayes.campaign_data import Campaign
from imubayes.errors import InputError, Issue, input_error
from imubayes.json_record import Record
from imubayes.results.manifest import checked
from imubayes.results.record_files import read_record
from imubayes.results.record_names import FIT


class CampaignPlaces(Record):
    """Folder of a campaign as given, whole, and as seen from the result; None where it has none."""

    given: str | None = None
    absolute: str | None = None
    from_result: str | None = None


class FitRecord(Record):
    """The contents of `fit.json`.

    Attributes
    ----------
    campaign : where the data were.
    data_hash, model_hash : identify campaign and model.
    z, h : parameters and hyperparameters at the mode by name, on the scale of the layout; None for a non-finite value.
    converged, message : of optimiser and sampling.
    optimised : whether the optimiser converged; None in folders of earlier versions.
    seed : of the sampler.
    campaign_notes : of the campaign, with what its outputs say against its set-up; None in folders of earlier versions.
    """

    format: Literal[1] = 1
    campaign: CampaignPlaces
    data_hash: str
    model_hash: str
    z: dict[str, float | None]
    h: dict[str, float | None]
    converged: bool
    optimised: bool | None = None
    message: str
    seed: int
    campaign_notes: tuple[str, ...] | None = None


def read_fit_record(folder: str | Path) -> FitRecord:
    """Return `fit.json` of a result folder; raises InputError where that is not whole."""
    checked(Path(folder))
    return read_record(Path(folder) / FIT, FitRecord)


def refuse_other_data(folder: str | Path, campaign: Campaign) -> None:
    """Raise InputError where a result folder is not of a campaign as it is now."""
    if read_fit_record(folder).data_hash != campaign.digest:
        raise input_error(
            f"the result is not of the campaign '{campaign.name}' as it is now",
            str(folder),
            f"the result of a fit of {campaign.folder or campaign.name}",
            "name the result that belongs to it, or fit the campaign as it is now",
        )


def campaign_of(folder: str | Path) -> Campaign | None:
    """Return the campaign of a result folder, read again; None where it is gone or no longer what was fit."""
    try:
        record = read_fit_record(folder)
        found = load_campaign(_folder(record.campaign, Path(folder)), judge_setup=False)
    except InputError:
        return None
    return found if found.digest == record.data_hash else None


def _folder(places: CampaignPlaces, folder: Path) -> Path:
    """Return the first place that holds a campaign: where it was, or as far from the result as it was."""
    roots = ((Path(), places.absolute), (Path(), places.given), (folder, places.from_result))
    candidates = [root / place for root, place in roots if place]
    for place in candidates:
        if (place / "campaign.toml").is_file():
            return place
    what = f"the campaign is not at '{places.given}' any more" if candidates else "the campaign was never in a folder"
    raise InputError(
        Issue(
            what,
            f"{folder / FIT}, key 'campaign'",
            " or ".join(str(place) for place in candidates) or "a fit of a campaign folder",
            "put the campaign back, or fit it at its new place",
        )
    )
