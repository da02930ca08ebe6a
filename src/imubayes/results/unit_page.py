"""A page about the fits of many units, as a package beside the kernel offers it to the server of the loop."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from imubayes.foundations.campaign_data import Campaign

UNIT_LINK = "unit/{}"
"""Address of the loop of a unit, relative to the page."""


@dataclass(frozen=True)
class UnitToExplore:
    """A unit whose loop is opened from a page.

    Attributes
    ----------
    campaign : returns the folder of its campaign, or the campaign if it is in no folder; raises InputError.
    model, out : that it is fitted with, and the result folder of that fit.
    """

    campaign: Callable[[], Campaign | Path]
    model: Path
    out: Path


@dataclass(frozen=True)
class UnitPage:
    """A page about units.

    Attributes
    ----------
    html : the whole page, without scripts or other files; it links to `UNIT_LINK` of the keys of `units`.
    """

    html: str
    units: Mapping[str, UnitToExplore]
