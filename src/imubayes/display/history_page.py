"""The models tried on one HTML page: the tree, residual rms per step, the evidence of each step, the next command.

One file without scripts, links or external styles; pictures are embedded, on white, so that the page reads in light and
dark mode.
"""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from imubayes.criticism.model_history import Node, Tree, rms_by_unit
from imubayes.display.addition_report import (
    addition_lines,
    channel_sheet,
    coefficient_sheet,
    next_command,
    run_change_sheet,
)
from imubayes.display.figures.evidence_pictures import added_variable, before_after
from imubayes.display.figures.history_steps import error_per_step_figure, history_figure
from imubayes.display.history_table import history_sheet
from imubayes.display.table_layout import Sheet
from imubayes.display.templates import render
from imubayes.display.theme import Picture
from imubayes.results.history_file import shown_place
from imubayes.results.loop_files import HistoryStep


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
    """What the page shows of the path to a selected model."""

    place: str
    errors: Picture | None
    steps: Sequence[StepSection]
    next: str


def history_page(tree: Tree, paths: Mapping[str, Sequence[HistoryStep]]) -> str:
    """Return the page of the trees of models tried.

    Parameters
    ----------
    paths : place of each selected model → the steps that lead to it.
    """
    sections = [_path(tree, place, steps) for place, steps in paths.items()]
    models, drawn = history_sheet(tree), history_figure(tree)
    return render("history", models=models, tree=drawn, paths=sections, data=_data).lstrip() + "\n"


def _data(picture: Picture) -> str:
    return base64.b64encode(picture.png()).decode("ascii")


def _path(tree: Tree, place: str, steps: Sequence[HistoryStep]) -> PathSection:
    nodes = [tree.nodes[each] for each in tree.path_to(place)]
    addition = steps[-1].addition if steps else None
    command = next_command(addition) if addition is not None else f"imubayes diagnose {shown_place(place)}"
    return PathSection(shown_place(place), _errors(nodes), [_section(step) for step in steps], command)


def _errors(nodes: Sequence[Node]) -> Picture | None:
    """Return the picture of the residual rms of each node; None where no fit was taken."""
    errors = [rms_by_unit(node.rms) for node in nodes]
    units = dict.fromkeys(unit for error in errors for unit in error)
    series = {unit: [error.get(unit, float("nan")) for error in errors] for unit in units}
    if not series:
        return None
    return error_per_step_figure([node.title for node in nodes], series, rms_by_unit(nodes[-1].floor))


def _section(step: HistoryStep) -> StepSection:
    node, addition = step.node, step.addition
    verdict = (node.verdict or "").replace("_", " ")
    if addition is None:
        return StepSection(node.title, verdict, ["The facts of this step are no longer in its folder."])
    names = ", ".join(choice.effect for choice in node.added)
    pictures = []
    if step.before is not None and step.after is not None:
        floors = {channel.channel: channel.rms for channel in node.floor}
        pictures.append(before_after(step.before, step.after, names, floors, step.group))
    if step.added_variable is not None:
        pictures.append(added_variable(step.added_variable, names, step.before))
    sheets = [coefficient_sheet(addition), channel_sheet(addition), run_change_sheet(addition)]
    drawn = [picture for picture in pictures if picture is not None]
    return StepSection(node.title, verdict, addition_lines(addition), drawn, sheets)
