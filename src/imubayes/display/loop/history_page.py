"""The models tried on one HTML page: the tree, the error by step, the evidence of each step, and the selected model.

One file without scripts, links or external styles; pictures are embedded, on white, so that the page reads in light and
dark mode.
"""

import base64
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from imubayes.display.figure_style import Picture
from imubayes.display.figures.history_steps import ChannelSteps, error_per_step_figure
from imubayes.display.figures.residual_evidence import added_variable, before_after
from imubayes.display.fit_report import provenance_line
from imubayes.display.layout import Sheet, render
from imubayes.display.loop.change_report import change_lines, change_sheets
from imubayes.display.loop.diagnosis_report import next_command
from imubayes.display.loop.diagnosis_sentences import sentence
from imubayes.display.loop.history import history_sheet
from imubayes.display.numbers_and_labels import command_line, listed
from imubayes.display.quantity_tables import derived_sheet, parameter_sheet
from imubayes.foundations.errors import InputError
from imubayes.loop.model_history import Node, Tree
from imubayes.results.change_records import HistoryStep, read_diagnosis
from imubayes.results.history_tree import shown_place
from imubayes.results.stored_tables import read_summary_and_residuals


@dataclass(frozen=True)
class StepSection:
    """What the page shows of one step."""

    title: str
    verdict: str
    lines: Sequence[str]
    pictures: Sequence[Picture] = ()
    sheets: Sequence[Sheet] = ()


@dataclass(frozen=True)
class PathSection:
    """What the page shows of the path to a selected model.

    Attributes
    ----------
    verdict : lines on what the diagnosis of the selected model says.
    sheets : parameters and derived quantities of the selected model.
    next : command to run next; empty if nothing is left to do.
    origin : serial number, dates, hashes and software.
    """

    place: str
    errors: Picture | None
    steps: Sequence[StepSection]
    verdict: Sequence[str]
    sheets: Sequence[Sheet]
    next: str
    origin: str


def history_page(tree: Tree, paths: Mapping[str, Sequence[HistoryStep]]) -> str:
    """Return the page of the trees of models tried.

    Parameters
    ----------
    paths : place of each selected model → the steps that lead to it.
    """
    sections = [_path(tree, place, steps) for place, steps in paths.items()]
    return render("history", models=history_sheet(tree), paths=sections, data=_data).lstrip() + "\n"


def _data(picture: Picture) -> str:
    return base64.b64encode(picture.png()).decode("ascii")


def _path(tree: Tree, place: str, steps: Sequence[HistoryStep]) -> PathSection:
    nodes = [tree.nodes[each] for each in tree.path_to(place)]
    folder, sections = Path(place), [_section(step) for step in steps]
    diagnosis = read_diagnosis(folder)
    shown = shown_place(place)
    if diagnosis is None:
        verdict, command = ["Not diagnosed yet."], command_line("diagnose", shown)
    else:
        verdict, command = [sentence(diagnosis)], next_command(diagnosis)
    try:
        summary = read_summary_and_residuals(folder)[0]
    except InputError:
        return PathSection(shown, _errors(nodes), sections, verdict, (), command, "")
    sheets = [parameter_sheet(summary), *([derived_sheet(summary)] if summary.derived else [])]
    return PathSection(shown, _errors(nodes), sections, verdict, sheets, command, provenance_line(summary.provenance))


def _errors(nodes: Sequence[Node]) -> Picture | None:
    """Return the picture of the residual rms of each model; None if no fit was taken."""
    names = dict.fromkeys((each.channel, each.unit) for node in nodes for each in node.rms)
    channels = []
    for name, unit in names:
        found = [next((each for each in node.rms if each.channel == name), None) for node in nodes]
        rms = [math.nan if each is None else each.rms for each in found]
        noise = [math.nan if each is None or each.noise is None else each.noise for each in found]
        channels.append(ChannelSteps(name, unit, rms, noise))
    if not channels:
        return None
    return error_per_step_figure([node.title for node in nodes], channels)


def _section(step: HistoryStep) -> StepSection:
    node, change = step.node, step.change
    verdict = (node.verdict or "").replace("_", " ")
    if change is None:
        return StepSection(node.title, verdict, ["The facts of this step are no longer in its folder."])
    # All of them are in the text; titles of pictures have room for two.
    names = listed([choice.effect for choice in node.added or node.removed], 2)
    pictures = []
    if step.before is not None and step.after is not None and not node.aside:  # the same readings
        floors = {each.channel: each.noise for each in node.rms if each.noise is not None}
        done, group = (f"adding {names}", step.group) if node.added else (f"removing {names}", None)
        done = done if names else f"the prior of {listed(node.priors, 2)}"
        pictures.append(before_after(step.before, step.after, done, floors, group))
    if step.added_variable is not None:
        pictures.append(added_variable(step.added_variable, names, step.before))
    drawn = [picture for picture in pictures if picture is not None]
    return StepSection(node.title, verdict, change_lines(change), drawn, change_sheets(change))
