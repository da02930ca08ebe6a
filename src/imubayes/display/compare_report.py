"""Model against measurement: all tables and pictures of a result folder, and the index page of the comparison.

Pictures go to `figures/` one by one, each written beside and then put in its place, so that no incomplete picture is
ever seen.  `figures/captions.json` lists what was drawn; what an earlier comparison drew and this one does not is
removed.  If the folder cannot be written to, the tables are all that is shown.

The page shows the five figures that matter first, all others folded, and the tables.  It is one file beside the folder
`figures`, without scripts or external styles; its pictures are the files of that folder.
"""

import gc
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import polars as pl
from markupsafe import Markup
from rich.console import Console, ConsoleOptions

from imubayes.display.classical_comparison import (
    ClassicalComparison,
    compare_classical,
    discrepancy_sheet,
    of_prediction,
)
from imubayes.display.figure_selection import corner_choice, most_telling_first, plan, runs_shown
from imubayes.display.figure_style import Picture
from imubayes.display.fit_cautions import alarm_of, disagreement_lines
from imubayes.display.fit_quality_tables import combination_sheet, fit_sheet, run_sheet, weak_sheet
from imubayes.display.fit_report import summary_html
from imubayes.display.layout import SheetTable, render, terminal
from imubayes.display.loop.kept_causes import causes_of
from imubayes.display.named_covariate import named_covariate
from imubayes.display.progress import progress_of
from imubayes.display.quantity_tables import derived_sheet, parameter_sheet
from imubayes.display.residual_columns import ordered
from imubayes.foundations import wording
from imubayes.foundations.errors import InputError, Issue, closest_first, input_error, kept_if_possible, refuse
from imubayes.foundations.files import write_json, write_text
from imubayes.foundations.progress import Tell, counted
from imubayes.foundations.quantity_names import family_of
from imubayes.foundations.records import several
from imubayes.model.model_file import read_model
from imubayes.procedures import classical
from imubayes.results.folder_files import CAPTIONS, FIGURES, MODEL, PAGE, POSTERIOR, damaged, pictures_compared
from imubayes.results.history_tree import campaign_of
from imubayes.results.stored_tables import draws_of, read_summary_and_residuals
from imubayes.results.summary import Summary
from imubayes.results.temperature_range import ThermalModel, thermal_model

if TYPE_CHECKING:
    from imubayes.results.result import Result

FIRST = 5
"""Number of figures that are shown unfolded."""


@dataclass(frozen=True)
class PageFigure:
    """A figure of the page: its file, relative to the page, and its caption."""

    file: str
    caption: str


def comparison_page(
    title: str, tables: Markup, ranked: Sequence[str], captions: Mapping[str, str], notes: Sequence[str], alarm: str
) -> str:
    """Return the page.

    Parameters
    ----------
    title : campaign and model.
    tables : as HTML.
    ranked : files in `figures`, those that matter most first.
    captions : of each file.
    notes : what was left out.
    alarm : the warning that precedes everything else; the tables are without it.
    """
    shown = [PageFigure(f"figures/{name}", captions[name]) for name in ranked]
    page = {"first": shown[:FIRST], "others": shown[FIRST:], "notes": notes, "tables": tables, "alarm": alarm}
    return render("comparison", title=title, **page).lstrip() + "\n"


_MOST_COLUMNS = 9


@dataclass(frozen=True)
class Comparison:
    """Tables and figures of a comparison.

    Attributes
    ----------
    folder : the result folder.
    pictures : files written, overview first; none if the folder cannot be written to.
    captions : file name → caption.
    summary : of the fit.
    notes : what was left out.
    page : the index page of the figures, `compare.html` of the result folder.
    classical : classical estimates beside those of the joint fit; None if the campaign is not available.
    """

    folder: Path
    pictures: tuple[Path, ...]
    captions: Mapping[str, str]
    summary: Summary
    notes: tuple[str, ...]
    page: Path
    classical: ClassicalComparison | None = None

    @property
    def converged(self) -> bool:
        """Whether the result may be used."""
        return self.summary.converged

    @property
    def runs(self) -> SheetTable:
        """Goodness of fit: a line per run, or per run and channel if there are many channels."""
        channels = {run.channel for run in self.summary.runs}
        return terminal((fit_sheet if len(channels) <= _MOST_COLUMNS else run_sheet)(self.summary))

    @property
    def tables(self) -> tuple[SheetTable, ...]:
        """Goodness of fit, runs in detail, parameters, derived quantities and weak directions, for the terminal."""
        optional = (
            (self.summary.derived, derived_sheet),
            (self.summary.combinations, combination_sheet),
            (self.summary.weak_directions, weak_sheet),
        )
        sheets = [run_sheet(self.summary), parameter_sheet(self.summary)]
        sheets += [sheet(self.summary) for content, sheet in optional if content]
        return self.runs, *map(terminal, sheets)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterable[Any]:
        yield self.runs
        if self.pictures:
            yield from self.notes
            count = wording.counted(len(self.pictures), "figure")
            yield f"{count} in {self.folder / FIGURES}; the most important ones: {self.page}"

    def _repr_html_(self) -> str:
        return summary_html(self.summary)


def compare(
    result: "Result | str | Path",
    parameters: str | Sequence[str] | None = None,
    runs: str | Sequence[str] | None = None,
    *,
    every: bool = False,
    progress: Tell | None = None,
) -> Comparison:
    """Make the tables of a result folder, and a page with the five figures that matter most.

    Parameters
    ----------
    result : a result that has a folder, or the folder.
    parameters : for a corner plot; if None, with `every` the mounting angles and scale factors determined least.
    runs : that have a figure of their own, or ``("all",)``; with `every` the six that fit worst if None.
    every : draw all figures, not only the five that matter most and those requested.
    progress : called with a short text as the work goes on.

    Raises
    ------
    InputError
        if the folder is missing or damaged, a parameter or run is not in it, or no prediction is a finite number.

    Examples
    --------
    >>> import imubayes
    >>> found = imubayes.compare("results/accel-channel")
    >>> found.page.name
    'compare.html'
    """
    folder, parameters, runs = _folder_of(result), several(parameters), several(runs)
    summary, read = read_summary_and_residuals(folder)
    residuals = read.table
    _refuse_non_finite(residuals, folder)
    names, draws = _for_corner(summary, folder, parameters, every)
    chosen = _chosen_runs(residuals, folder, runs) if runs else runs_shown(summary, residuals)
    campaign = campaign_of(folder)
    named = named_covariate(folder, residuals)
    figures = dict(plan(summary, residuals, names, draws, chosen, campaign, _thermal(folder, summary, draws), named))
    ranked = most_telling_first(list(figures), summary, residuals, chosen, named)
    if not every:
        ranked = [*ranked[:FIRST], *(name for name in ranked[FIRST:] if _is_asked(name, parameters, runs))]
    wanted = {name: draw for name, draw in figures.items() if name in ranked}
    classical_estimates = None
    if campaign is not None:
        predicted = of_prediction(campaign, residuals, summary)
        classical_estimates = compare_classical(classical(campaign), summary, predicted)
        if classical_estimates.beyond:
            classical_estimates = classical_estimates.with_causes(causes_of(folder, residuals, summary))
    notes = tuple(_notes(residuals, draws, chosen) if every else _left_out(len(figures) - len(wanted)))
    page, made, captions = folder / PAGE, (), {}
    with kept_if_possible(folder), progress_of(progress) as tell:
        drawn, captions = draw_figures(wanted, folder, tell)
        title, tables = f"{summary.campaign}, model {summary.model}", Markup(summary_html(summary, alarm=False))
        files = [f"{name}.png" for name in ranked]
        write_text(page, comparison_page(title, tables, files, captions, notes, alarm_of(summary)))
        made = tuple(drawn)
    return Comparison(folder, made, captions, summary, notes, page, classical_estimates)


def _folder_of(result: "Result | str | Path") -> Path:
    if isinstance(result, str | Path):
        return Path(result)
    if result.folder is None:
        remedy = "fit with out=FOLDER"
        raise input_error("the result is in no folder", "result", "a result that has a folder, or the folder", remedy)
    return result.folder


def _thermal(folder: Path, summary: Summary, draws: Mapping[str, Any]) -> ThermalModel | None:
    """Return what the draws of a result lack to follow its quantities over temperature."""
    if not draws or not (folder / MODEL).is_file():
        return None
    units = {entry.name: entry.unit for entry in (*summary.parameters, *summary.derived)}
    return thermal_model(read_model(folder / MODEL), units)


def _is_asked(name: str, parameters: Sequence[str] | None, runs: Sequence[str] | None) -> bool:
    return bool((parameters and name == "corner") or (runs and name.startswith("run-")))


def _left_out(count: int) -> Iterator[str]:
    if count:
        yield f"--every draws {count} more figures and a corner plot; --runs NAME… draws single runs."


def _for_corner(
    summary: Summary, folder: Path, parameters: Sequence[str] | None, every: bool
) -> tuple[list[str], Mapping[str, Any]]:
    """Return the quantities of the corner plot and their draws; none if it is not asked for."""
    if not parameters and not every:
        return [], {}
    posterior = folder / POSTERIOR
    if parameters:
        names = _checked(summary, folder, parameters)
        if not posterior.is_file():
            raise input_error(
                "there are no posterior draws", str(folder),
                "a result with posterior.nc, which every fit that converged writes",
                "correct the cause, fit again until it converges, then compare",
            )  # fmt: skip
        return names, _draws(posterior, names, asked=True)
    if not posterior.is_file():
        return [], {}
    looked_at = [each.name for each in summary.parameters if not each.nuisance]
    looked_at += [each.name for each in summary.derived]
    draws = _draws(posterior, looked_at, asked=False)
    return corner_choice(summary, draws), draws


def _chosen_runs(residuals: pl.DataFrame, folder: Path, runs: Sequence[str]) -> list[str]:
    known = ordered(residuals, "run")
    if list(runs) == ["all"]:
        return known
    where, remedy = f"{folder}, option --runs", "take names of runs, or 'all'"
    refuse(
        Issue(f"'{name}' is not a run of the result", where, closest_first(name, known), remedy)
        for name in runs
        if name not in known
    )
    return [name for name in known if name in runs]


def draw_figures(
    figures: Mapping[str, Callable[[], Picture]], folder: Path, tell: Tell
) -> tuple[list[Path], dict[str, str]]:
    """Write figures one by one into `figures` of a folder; return the files, and the caption of each by file name."""
    target = folder / FIGURES
    target.mkdir(exist_ok=True)
    made: list[Path] = []
    captions: dict[str, str] = {}
    with _light_collection():
        for name, draw in counted(tell, "drawing", list(figures.items())):
            figure = draw()
            made.append(figure.save(target / f"{name}.png"))
            captions[f"{name}.png"] = figure.caption
    earlier = pictures_compared(folder)
    write_json(target / CAPTIONS, captions)
    for name in {*earlier} - {*captions}:
        (target / name).unlink(missing_ok=True)
    return made, captions


def _refuse_non_finite(residuals: pl.DataFrame, folder: Path) -> None:
    """Raise if predictions are not finite: such a fit has nothing to draw."""
    bad = residuals.filter(~residuals["predicted"].is_finite())
    if bad.is_empty():
        return
    first = bad.row(0, named=True)
    raise input_error(
        f"{len(bad)} of {len(residuals)} predictions are not finite: "
        f"the first is {first['channel']} in row {first['row']} of {first['run']}",
        str(folder),
        "a model that is finite for every observation",
        "correct the model (an effect of your own may divide by zero), fit again, then compare",
    )


def _checked(summary: Summary, folder: Path, parameters: Sequence[str]) -> list[str]:
    known = [entry.name for entry in (*summary.parameters, *summary.derived)]
    members: list[str] = []
    issues = []
    for name in dict.fromkeys(parameters):
        # A family stands for its members: gyro_scale_factor.scale for [gx], [gy], [gz].
        own = [name] if name in known else [member for member in known if family_of(member) == name]
        members += own
        if not own:
            where = f"{folder / 'summary.json'}, option --parameters"
            remedy = "take a name from the tables of the result; a name without its brackets means all its members"
            issues.append(Issue(f"'{name}' is not in the result", where, closest_first(name, known), remedy))
    refuse(issues)
    return members


def _draws(file: Path, names: Sequence[str], asked: bool) -> Mapping[str, Any]:
    if not names:
        return {}
    try:
        draws = draws_of(file, names)
    except (OSError, KeyError, ValueError, RuntimeError) as error:
        raise InputError(damaged(file, error)) from error
    absent = [name for name in names if name not in draws]
    if absent and asked:
        raise InputError(damaged(file, f"it has no draws of {', '.join(absent[:5])}"))
    return draws


def _notes(residuals: pl.DataFrame, draws: Mapping[str, Any], chosen: Sequence[str]) -> Iterator[str]:
    runs = ordered(residuals, "run")
    if len(chosen) < len(runs):
        yield f"{len(chosen)} of {len(runs)} runs have a separate figure; others: --runs NAME, or --runs all."
    if not draws:
        yield "No corner plot: the result holds no posterior draws."


def print_comparison(comparison: Comparison) -> None:
    """Print goodness of fit, the classical estimates that disagree with the joint fit, and the files of the figures."""
    console = Console()
    console.print(comparison.runs)
    if comparison.classical is not None and (sheet := discrepancy_sheet(comparison.classical)).rows:
        console.print(terminal(sheet))
    for note in comparison.notes if comparison.pictures else ():
        console.print(note, highlight=False)
    for line in disagreement_lines(comparison.summary, str(comparison.folder)):
        console.print(line, highlight=False, soft_wrap=True)
    if comparison.pictures:
        count = wording.counted(len(comparison.pictures), "figure")
        console.print(f"{count} in {comparison.folder / FIGURES}", highlight=False, soft_wrap=True)
        console.print(f"the most important ones: {comparison.page}", highlight=False, soft_wrap=True)


@contextmanager
def _light_collection() -> Iterator[None]:
    """Collect garbage seldom while figures are drawn: a third of the time would go into walking all loaded modules."""
    thresholds = gc.get_threshold()
    gc.freeze()
    gc.set_threshold(200_000, 50, 1000)
    try:
        yield
    finally:
        gc.set_threshold(*thresholds)
        gc.unfreeze()
