"""Model against measurement, whole: all tables and pictures of a result folder.

Pictures go to `figures/` one by one, each written beside and then put in its place, so that a picture seen is a whole
picture.  `figures/captions.json` lists what was drawn; what an earlier comparison drew and this one does not is removed.
"""

import gc
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import polars as pl
from rich.console import Console, ConsoleOptions, RenderResult
from rich.table import Table

from imubayes.errors import InputError, Problem, closest_first
from imubayes.report.display import covariates_of, ordered
from imubayes.report.draws import read_draws
from imubayes.report.figures import (
    corner_figure,
    identifiability_figure,
    measurement_figure,
    prior_posterior_figure,
    residual_figure,
    run_chi2_figure,
)
from imubayes.report.figures.prior_posterior import mounting_quantities
from imubayes.report.html import summary_html
from imubayes.report.reading import StoredResult, damaged, read_stored
from imubayes.report.statistics import worst_first
from imubayes.report.tables import alarm_of, derived_table, parameter_table, run_table, weak_table
from imubayes.report.theme import MOST_PANELS, Picture

MOST_RUNS, MOST_CORNER = 24, 6
_INDEX = "captions.json"
_Plan = Iterator[tuple[str, Callable[[], Picture]]]


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
    """

    folder: Path
    pictures: tuple[Path, ...]
    captions: Mapping[str, str]
    summary: Mapping[str, Any]
    notes: tuple[str, ...]

    @property
    def converged(self) -> bool:
        """Whether the result may be used."""
        return not alarm_of(self.summary)

    @property
    def tables(self) -> tuple[Table, ...]:
        """Runs, parameters, derived quantities and weak directions, for the terminal."""
        made = [run_table(self.summary), parameter_table(self.summary)]
        if self.summary["derived"]:
            made.append(derived_table(self.summary))
        if self.summary.get("weak_directions"):
            made.append(weak_table(self.summary))
        return tuple(made)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        yield run_table(self.summary)
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
        if the folder is missing or damaged, or a parameter is not in it.
    """
    stored = read_stored(folder)
    names = _checked(stored, parameters) if parameters else corner_choice(stored.summary)
    draws = _draws(stored, names)
    notes = list(_notes(stored, draws))
    target = stored.folder / "figures"
    _make_folder(target)
    made: list[Path] = []
    captions: dict[str, str] = {}
    with _light_collection():
        for name, draw in _plan(stored, names, draws):
            figure = draw()
            made.append(figure.save(target / f"{name}.png"))
            captions[f"{name}.png"] = figure.caption
    _replace_index(target, captions)
    return Comparison(stored.folder, tuple(made), captions, stored.summary, tuple(notes))


def corner_choice(summary: Mapping[str, Any], most: int = MOST_CORNER) -> list[str]:
    """Return the quantities whose joint posterior tells most.

    Scale factor and mounting angle of one channel are told apart only by combining runs, and only where the axis is
    neither along nor across the rotation: those with the least from the data come first, each with its scale factor.
    """
    derived = [one for one in summary["derived"] if one.get("sd")]
    angles = [one for one in derived if one["name"].startswith("mounting_angle[")]
    oblique = [one for one in angles if 10 < abs(one["mean"]) % 90 < 80]
    scales = {one["name"][len("scale_factor[") : -1]: one["name"] for one in derived if _is_scale(one["name"])}
    chosen: list[str] = []
    for one in sorted(oblique or angles, key=_from_data)[: most // 2]:
        channel = one["name"].partition("[")[2].partition(",")[0]
        chosen += [one["name"], *([scales[channel]] if channel in scales else [])]
    rest = sorted((one for one in derived if _is_scale(one["name"])), key=_from_data)
    chosen += [one["name"] for one in rest]
    if len(dict.fromkeys(chosen)) < 2:
        loose = [one for one in summary["parameters"] if one.get("sd") and _from_data(one) > 0.1]
        chosen += [one["name"] for one in sorted(loose, key=_from_data)]
    unique = list(dict.fromkeys(chosen))[:most]
    return sorted(unique, key=lambda name: name.startswith("scale_factor"))


def _is_scale(name: str) -> bool:
    return name.startswith("scale_factor[")


def _from_data(one: Mapping[str, Any]) -> float:
    share = one.get("from_data")
    return 1.0 if share is None else float(share)


def _plan(stored: StoredResult, names: Sequence[str], draws: Mapping[str, Any]) -> _Plan:
    """Yield a name and a way to draw for every picture, the overview first."""
    summary, residuals = stored.summary, stored.residuals
    runs = ordered(residuals, "run")
    if summary["runs"]:
        yield "fit-of-runs", lambda: run_chi2_figure(summary)
    for one in covariates_of(residuals):
        for page, channels in _pages(ordered(residuals, "channel")):
            yield (
                f"residuals-{one.key.replace('_', '-')}{page}",
                lambda one=one, channels=channels: residual_figure(residuals, one, channels, runs),
            )
    if any(one.get("from_data") is not None for one in (*summary["parameters"], *summary["derived"])):
        yield "identifiability", lambda: identifiability_figure(summary)
    if mounting_quantities(summary):
        yield "mounting-prior-posterior", lambda: prior_posterior_figure(summary)
    drawn = [name for name in names if name in draws]
    if drawn:
        yield "corner", lambda: corner_figure(draws, drawn, summary)
    for run, file in _files_of_runs(_runs_shown(stored)):
        own = residuals.filter(pl.col("run") == run)
        for page, channels in _pages(ordered(own, "channel")):
            yield f"run-{file}{page}", lambda own=own, run=run, channels=channels: measurement_figure(own, run, channels)


def _pages(channels: Sequence[str]) -> list[tuple[str, list[str]]]:
    pages = [list(channels[start : start + MOST_PANELS]) for start in range(0, len(channels), MOST_PANELS)]
    return [(f"-{number}" if len(pages) > 1 else "", page) for number, page in enumerate(pages, 1)]


def _runs_shown(stored: StoredResult) -> list[str]:
    runs = ordered(stored.residuals, "run")
    if len(runs) <= MOST_RUNS:
        return runs
    ranked = [name for name in worst_first(stored.summary) if name in runs]
    kept = set((ranked + [name for name in runs if name not in ranked])[:MOST_RUNS])
    return [name for name in runs if name in kept]


def _files_of_runs(runs: Sequence[str]) -> list[tuple[str, str]]:
    """Return a file name for each run: its own, where that is one, and different from all others."""
    taken: set[str] = set()
    found = []
    for run in runs:
        plain = "".join(c if c.isascii() and (c.isalnum() or c in "-_.") else "_" for c in run)[:80]
        name, number = plain, 2
        while name.lower() in taken:
            name, number = f"{plain}_{number}", number + 1
        taken.add(name.lower())
        found.append((run, name))
    return found


def _checked(stored: StoredResult, parameters: Sequence[str]) -> list[str]:
    known = [one["name"] for one in (*stored.summary["parameters"], *stored.summary["derived"])]
    members: list[str] = []
    problems = []
    for name in dict.fromkeys(parameters):
        # A family stands for its members: gyro_scale_factor.scale for [gx], [gy], [gz].
        own = [name] if name in known else [one for one in known if one.partition("[")[0] == name]
        members += own
        if not own:
            where = f"{stored.folder / 'summary.json'}, option --parameters"
            remedy = "take a name from the tables of the result; a name without its brackets stands for all its members"
            problems.append(Problem(f"'{name}' is not in the result", where, closest_first(name, known), remedy))
    if stored.posterior is None:
        remedy = "fit without --no-sample, then compare"
        problems.append(
            Problem("there are no draws to show", str(stored.folder), "a result that was sampled", remedy)
        )
    if problems:
        raise InputError(problems)
    return members


def _draws(stored: StoredResult, names: Sequence[str]) -> Mapping[str, Any]:
    if stored.posterior is None or not names:
        return {}
    try:
        draws = read_draws(stored.posterior, names)
    except (OSError, KeyError, ValueError, RuntimeError) as error:
        raise InputError(damaged(stored.posterior, error)) from error
    absent = [name for name in names if name not in draws]
    if absent:
        raise InputError(damaged(stored.posterior, f"it has no draws of {', '.join(absent[:5])}"))
    return draws


def _notes(stored: StoredResult, draws: Mapping[str, Any]) -> Iterator[str]:
    runs = ordered(stored.residuals, "run")
    shown = _runs_shown(stored)
    if len(shown) < len(runs):
        yield f"Of {len(runs)} runs the {len(shown)} that fit worst have a picture of their own."
    if not draws:
        yield "No corner plot: the result was not sampled." if stored.posterior is None else "No corner plot."


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
        problem = Problem(
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
    beside = target / f".{_INDEX}.{os.getpid()}.part"
    beside.write_text(json.dumps(captions, indent=1, ensure_ascii=False), encoding="utf-8")
    beside.replace(index)
    for name in earlier if isinstance(earlier, dict) else ():
        if name not in captions and Path(name).name == name and name.endswith(".png"):
            (target / name).unlink(missing_ok=True)
