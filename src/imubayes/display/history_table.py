"""The models tried as a table and as JSON: the tree, residual rms, cross-validation, and which one is selected."""

from typing import Any

from imubayes.criticism.model_history import Node, Tree, rms_by_unit
from imubayes.display.labels import pretty, readable
from imubayes.display.report import Report
from imubayes.display.rounding import ratio_text, significant
from imubayes.display.sheet import Cell, Sheet
from imubayes.results.history_file import shown_place


def history_report(tree: Tree) -> Report:
    """Return the models tried, and why some were not taken."""
    refused = [f"{shown_place(place)}: {node.message}" for place, node in tree.nodes.items() if not node.taken]
    return Report((), [history_sheet(tree)], refused)


def history_json(tree: Tree) -> dict[str, Any]:
    """Return the tree as one object: nodes in order, each below its parent."""
    nodes = []
    for depth, place in tree.in_order():
        parent = tree.parents[place]
        where = {"folder": shown_place(place), "depth": depth}
        content = tree.nodes[place].model_dump(mode="json", exclude={"format", "children", "floor"})
        nodes.append(where | content | {"parent": None if parent is None else shown_place(parent)})
    return {"format": 2, "nodes": nodes, "selected": [shown_place(place) for place in tree.selected]}


def history_sheet(tree: Tree) -> Sheet:
    """Return a line for each model tried."""
    errors = {place: rms_by_unit(node.rms) for place, node in tree.nodes.items()}
    units = list(dict.fromkeys(unit for error in errors.values() for unit in error))
    scales = {unit: readable(unit, max(error.get(unit, 0.0) for error in errors.values())) for unit in units}
    rows, slim, roots = [], [], []
    for place, (depth, folder) in enumerate(tree.in_order()):
        node, error = tree.nodes[folder], errors[folder]
        if depth == 0 and place:
            roots.append(place)
        sizes = [Cell(significant(error[unit] * scales[unit][0]) if unit in error else "–") for unit in units]
        mark = "●" if node.selected else ("✕" if not node.taken else "○")
        indented = f"{'   ' * (depth - 1)}└─ {node.title}" if depth else node.title
        title = Cell(f"{mark} {indented}", "" if node.taken else "dim")
        mood = "bad" if node.held_out is not None and node.held_out.verdict == "not" else ""
        gain = Cell(gain_text(node), mood)
        fit = (Cell(ratio_text(node.chi2_per_dof)), Cell(significant(node.delta_chi2.observed)))
        rows.append((title, *fit, *sizes, gain, Cell(shown_place(folder))))
        slim.append((title, *sizes, gain))
    columns = (*(f"residual / {pretty(scales[unit][1])}" for unit in units), "Δ elpd")
    head = ("model", "χ²/dof", "Δχ²", *columns, "folder")
    note = (
        "● selected, the model that is exported; ✕ not taken. Δχ²: drop at the noise scales of the model before; "
        "Δ elpd: rise of the log predictive density in cross-validation."
    )
    title, dividers = "Models tried", frozenset(roots)
    narrow = Sheet(title, ("model", *columns), slim, (0,), "", note, dividers)
    return Sheet(title, head, rows, (0, len(head) - 1), "", note, dividers, narrow)


def gain_text(node: Node) -> str:
    """Return the outcome of cross-validation in short."""
    found = node.held_out
    if found is None:
        return "–" if node.taken else "not taken"
    text = f"{found.delta:+.1f} ± {significant(found.se, 2)} ({found.helped}/{found.of} {found.by}s)"
    return text + {"not": " no gain", "unclear": " unclear", "helps": ""}[found.verdict]
