"""Model against measurement, whole: all tables and pictures of a result folder.

Pictures go to `figures/` one by one, each written beside and then put in its place, so that a picture seen is a whole
picture.  `figures/captions.json` lists what was drawn; what an earlier comparison drew and this one does not, goes.
"""

import gc
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console, ConsoleOptions
from rich.table import Table

from imubayes.atomic_files import write_json
from imubayes.display.classical_comparison import textbook_json
from imubayes.display.figure_selection import corner_choice, plan, runs_shown
from imubayes.display.fit_tables import alarm_of
from imubayes.display.html import summary_html
from imubayes.display.labels import ordered
from imubayes.display.terminal_tables import derived_table, fit_table, parameter_table, run_table, weak_table
from imubayes.errors import InputError, Issue, closest_first
from imubayes.procedures.classical import classical
from imubayes.results.fit_file import campaign_of
from imubayes.results.folder_state import damaged
from imubayes.results.posterior_draws import read_draws
from imubayes.results.result import Result, read_result

_MOST_COLUMNS = 9
_INDEX = "captions.json"


@dataclass(frozen=True)
class Comparison:
    """What a comparison made.

    Attributes
    ----------
    folder : the result folder.
    pictures : files made, in the order in which they tell the story.
    captions : file name → caption.
    summary : the content of `summary.json`.
    notes : what was left out, one sentence each.
    textbook : textbook estimates beside the joint ones, as `imubayes classical --json` prints them; None where the
        campaign is not at hand.
    """

    folder: Path
    pictures: tuple[Path, ...]
    captions: Mapping[str, str]
    summary: Mapping[str, Any]
    notes: tuple[str, ...]
    textbook: Mapping[str, Any] | None = None

    @property
    def converged(self) -> bool:
        """Whether the result may be used."""
        return not alarm_of(self.summary)

    @property
    def runs(self) -> Table:
        """How well each run and channel fits: a line per run, or per run and channel where there are many channels."""
        channels = {run["channel"] for run in self.summary["runs"]}
        return fit_table(self.summary) if len(channels) <= _MOST_COLUMNS else run_table(self.summary)

    @property
    def tables(self) -> tuple[Table, ...]:
        """Fit of the runs, runs in detail, parameters, derived quantities and weak directions, for the terminal."""
        made = [self.runs, run_table(self.summary), parameter_table(self.summary)]
        if self.summary["derived"]:
            made.append(derived_table(self.summary))
        if self.summary.get("weak_directions"):
            made.append(weak_table(self.summary))
        return tuple(made)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterable[Any]:
        yield self.runs
        yield from self.notes
        yield f"{len(self.pictures)} pictures in {self.folder / 'figures'}"

    def _repr_html_(self) -> str:
        return summary_html(self.summary)


def compare(folder: str | Path, parameters: Sequence[str] | None = None) -> Comparison:
    """Make all tables and pictures of a result folder.

    Parameters
    ----------
    folder : as written by the fit.
    parameters : for the corner plot; without them the mounting angles and scale factors that tell most, at most six.

    Raises
    ------
    InputError
        if the folder is missing or damaged, a parameter is not in it, or no prediction is a finite number.
    """
    folder = Path(folder)
    stored = read_result(folder)
    summary = stored.summary.model_dump()
    _refuse_no_numbers(stored)
    names = _checked(stored, parameters) if parameters else corner_choice(summary)
    draws = _draws(stored, names, asked=bool(parameters))
    notes = list(_notes(stored, draws))
    target = folder / "figures"
    _make_folder(target)
    made: list[Path] = []
    captions: dict[str, str] = {}
    with _light_collection():
        for name, draw in plan(stored, names, draws):
            figure = draw()
            made.append(figure.save(target / f"{name}.png"))
            captions[f"{name}.png"] = figure.caption
    _replace_index(target, captions)
    campaign = campaign_of(folder)
    textbook = None if campaign is None else textbook_json(classical(campaign), summary)
    return Comparison(folder, tuple(made), captions, summary, tuple(notes), textbook)


def _refuse_no_numbers(stored: Result) -> None:
    """Raise where the model could not be evaluated for some readings: such a fit has nothing to draw."""
    bad = stored.residuals.table.filter(~stored.residuals.table["predicted"].is_finite())
    if bad.is_empty():
        return
    first = bad.row(0, named=True)
    raise InputError(
        Issue(
            f"the model gave no finite number for {len(bad)} of {len(stored.residuals.table)} readings: "
            f"the first is {first['channel']} in row {first['row']} of {first['run']}",
            str(stored.folder),
            "a model that can be evaluated everywhere",
            "mend the model (an effect of your own may divide by zero), fit again, then compare",
        )
    )


def _checked(stored: Result, parameters: Sequence[str]) -> list[str]:
    known = [quantity.name for quantity in (*stored.summary.parameters, *stored.summary.derived)]
    members: list[str] = []
    issues = []
    for name in dict.fromkeys(parameters):
        # A family stands for its members: gyro_scale_factor.scale for [gx], [gy], [gz].
        own = [name] if name in known else [one for one in known if one.partition("[")[0] == name]
        members += own
        if not own:
            where = f"{stored.folder}/summary.json, option --parameters"
            remedy = "take a name from the tables of the result; a name without its brackets stands for all its members"
            issues.append(Issue(f"'{name}' is not in the result", where, closest_first(name, known), remedy))
    if stored.posterior_file is None:
        remedy = "mend what kept the fit from converging, fit again, then compare"
        allowed = "a result with posterior.nc, which every fit that converged writes"
        issues.append(Issue("there are no draws to show", str(stored.folder), allowed, remedy))
    if issues:
        raise InputError(issues)
    return members


def _draws(stored: Result, names: Sequence[str], asked: bool) -> Mapping[str, Any]:
    if stored.posterior_file is None or not names:
        return {}
    try:
        draws = read_draws(stored.posterior_file, names)
    except (OSError, KeyError, ValueError, RuntimeError) as error:
        raise InputError(damaged(stored.posterior_file, error)) from error
    absent = [name for name in names if name not in draws]
    if absent and asked:
        raise InputError(damaged(stored.posterior_file, f"it has no draws of {', '.join(absent[:5])}"))
    return draws


def _notes(stored: Result, draws: Mapping[str, Any]) -> Iterator[str]:
    runs = ordered(stored.residuals.table, "run")
    shown = runs_shown(stored)
    if len(shown) < len(runs):
        yield f"Of {len(runs)} runs the {len(shown)} that fit worst have a picture of their own."
    if not draws:
        yield "No corner plot: the result holds no draws of the posterior."


@contextmanager
def _light_collection() -> Iterator[None]:
    """Keep the garbage collector from walking all loaded modules for every few pictures it takes away."""
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def _make_folder(target: Path) -> None:
    try:
        target.mkdir(exist_ok=True)
    except OSError as error:
        problem = Issue(
            f"the pictures cannot be written: {error.strerror or error}",
            str(target),
            "a folder that can be written",
            "free the place or give yourself the right to write there",
        )
        raise InputError(problem) from error


def _replace_index(target: Path, captions: Mapping[str, str]) -> None:
    index = target / _INDEX
    try:
        earlier = json.loads(index.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        earlier = {}
    write_json(index, dict(captions))
    for name in earlier if isinstance(earlier, dict) else ():
        if name not in captions and Path(name).name == name and name.endswith(".png"):
            (target / name).unlink(missing_ok=True)
