"""The population of a batch as one page, from which the loop of each unit is opened: `imubayes explore RESULTS`."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import polars as pl
from markupsafe import Markup

from imubayes.display.figure_style import MOST_PANELS, Picture
from imubayes.display.layout import render
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.progress import Tell
from imubayes.results.unit_page import UNIT_LINK, UnitPage, UnitToExplore
from imubayes_archive.display.figures.population import drawn, population_picture, ranked
from imubayes_archive.display.population_report import population_report
from imubayes_archive.population.hierarchical_fit import HierarchicalFit, hierarchical_fit
from imubayes_archive.unit_fits.batch_folder import UnitSource
from imubayes_archive.unit_fits.posterior_table import MODEL_FILE, chosen_model, model_folder, read_outcomes

_WIDE = 120


@dataclass(frozen=True)
class _UnitLine:
    """A unit in the list: its address, its name, and why it has no estimate."""

    link: str
    name: str
    said: str


def population_page(place: Path, progress: Tell) -> UnitPage | None:
    """Return the page of a results folder of a batch; None of another folder.

    Parameters
    ----------
    place : results folder, or that of one model in it.
    progress : called with a short text as units are given their population, which is kept in the folder.

    Raises
    ------
    InputError
        if the folder holds the results of several models, and for effect files that are not trusted.
    """
    results, model = (place.parent, place.name.removeprefix("model-")) if _of_model(place) else (place, None)
    if not any(map(_of_model, results.glob("model-*"))):
        return None
    key = chosen_model(results, model)
    fit, outcomes = hierarchical_fit(results, key, progress=progress), read_outcomes(results, key)
    return UnitPage(_html(results, fit, outcomes), dict(_units(results, key, outcomes)))


def _of_model(place: Path) -> bool:
    """Return whether a folder is that of one model of a batch."""
    return place.name.startswith("model-") and (place / MODEL_FILE).is_file() and any(place.glob("part-*"))


def _html(results: Path, fit: HierarchicalFit, outcomes: pl.DataFrame) -> str:
    report = population_report(fit.populations, fit)
    lines = [
        _UnitLine(UNIT_LINK.format(row["digest"]), _name(row), f": {row['reason']}" if row["reason"] else "")
        for row in outcomes.iter_rows(named=True)
    ]
    return render(
        "population", package="imubayes_archive.display", place=results.name, report=report,
        sheets=[block for sheet in report.sheets for block in sheet.blocks(_WIDE)],
        pictures=list(_pictures(fit)), svg=lambda picture: Markup(picture.svg()), units=lines,
    )  # fmt: skip


def _name(row: Mapping[str, Any]) -> str:
    """Return the unit, its campaign and date, of which the names of campaigns often have the others in them."""
    name = row["campaign"] if row["unit"] in row["campaign"] else f"{row['unit']}, {row['campaign']}"
    return name if row["date"] is None or str(row["date"]) in name else f"{name}, {row['date']}"


def _pictures(fit: HierarchicalFit) -> Iterator[Picture]:
    """Yield pictures of all parameters with a population, in the order in which their units deviate."""
    names = [each.parameter for each in ranked(drawn(fit.populations))]
    for first in range(0, len(names), MOST_PANELS):
        yield population_picture(fit.populations, fit.units, names[first : first + MOST_PANELS])


def _units(results: Path, key: str, outcomes: pl.DataFrame) -> Iterator[tuple[str, UnitToExplore]]:
    """Yield the units by the digests of their campaigns."""
    for row in outcomes.iter_rows(named=True):
        out = results.with_name(f"{results.name}-units") / f"{row['unit']}-{row['digest']}"
        yield (
            row["digest"],
            UnitToExplore(_Reader(UnitSource.of_row(row)), model_folder(results, key) / MODEL_FILE, out),
        )


@dataclass(frozen=True)
class _Reader:
    """Returns the campaign of a unit: its folder, or what an archive holds."""

    source: UnitSource

    def __call__(self) -> Campaign | Path:
        return self.source.read() if self.source.archived else Path(self.source.path)
