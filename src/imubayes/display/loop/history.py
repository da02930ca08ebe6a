"""The models tried as a table and as JSON: residual rms and cross-validation of each, and which one is selected."""

from collections.abc import Mapping, Sequence
from typing import Any

from imubayes.display import numbers_and_labels as numbers
from imubayes.display.layout import Cell, Report, Sheet, cells
from imubayes.loop.model_history import CrossValidation, Node, Tree, rms_by_unit
from imubayes.results.history_tree import shown_place

Scales = Mapping[str, tuple[float, str]]
"""Unit → factor to a unit of plain numbers, and that unit."""


def history_report(tree: Tree) -> Report:
    """Return the models tried, and why some were not taken."""
    refused = [f"{shown_place(place)}: {node.message}" for place, node in tree.nodes.items() if not node.taken]
    risen = [
        f"{shown_place(place)}: {offsets_moved_text(node.offsets_moved)}"
        for place, node in tree.nodes.items()
        if node.offsets_moved
    ]
    return Report((), [history_sheet(tree)], [*risen, *refused])


def history_json(tree: Tree) -> dict[str, Any]:
    """Return the tree as one object: nodes in order, each below its parent."""
    nodes = []
    for depth, place in tree.in_order():
        parent = tree.parents[place]
        where = {"folder": shown_place(place), "depth": depth}
        content = tree.nodes[place].model_dump(mode="json", exclude={"format"})
        nodes.append(where | content | {"parent": None if parent is None else shown_place(parent)})
    return {"format": 2, "nodes": nodes, "selected": [shown_place(place) for place in tree.selected]}


def history_sheet(tree: Tree) -> Sheet:
    """Return a line for each model tried."""
    nodes = list(tree.nodes.values())
    scales = _scales([rms_by_unit(node.rms) for node in nodes])
    ordered = tree.in_order()
    rows = [_row(tree.nodes[place], depth, place, scales) for depth, place in ordered]
    head = ("model", "χ²/dof", "Δχ²", *_heads("residual / ", scales), "Δ elpd", "folder")
    note = (
        "●: selected, the model that is exported. ✕: not taken. +: added. −: removed. χ², its drop Δχ² and the "
        "residual (rms over the channels with the same unit of measurement) are at the noise known beforehand and "
        "include the offsets of runs. Δ elpd: rise of the log predictive density in cross-validation."
    )
    dividers = frozenset(index for index, (depth, _) in enumerate(ordered) if index and depth == 0)
    slim = [_slim_row(row, tree.nodes[place]) for row, (_, place) in zip(rows, ordered, strict=True)]
    sheet = Sheet("Models tried", head, rows, (0, len(head) - 1), "", note, dividers)
    return sheet.with_narrow(("model", "Δχ²", *_heads("rms ", scales), "Δ elpd"), slim)


def _scales(errors: Sequence[Mapping[str, float]]) -> Scales:
    units = dict.fromkeys(unit for error in errors for unit in error)
    return {unit: numbers.readable(unit, max(error.get(unit, 0.0) for error in errors)) for unit in units}


def _heads(before: str, scales: Scales) -> list[str]:
    return [before + numbers.pretty(unit) for _, unit in scales.values()]


def _slim_row(row: Sequence[Cell], node: Node) -> tuple[Cell, ...]:
    """Return a row for a narrow terminal: no χ²/dof, no folder, the gain without its runs and verdict."""
    found = node.held_out
    gain = row[-2].text
    if found is not None:
        gain = elpd_text(found)
    return (row[0], row[2], *row[3:-2], Cell(gain, row[-2].mood))


def _row(node: Node, depth: int, place: str, scales: Scales) -> tuple[Cell, ...]:
    """Return title, goodness of fit, residual rms by unit, cross-validation and folder of a node."""
    sizes = _sizes(rms_by_unit(node.rms), scales)
    mark = "●" if node.selected else ("○" if node.taken else "✕")
    title = f"{'  ' * (depth - 1)}└ {node.title}" if depth else node.title
    useless = node.held_out is not None and node.held_out.verdict in ("not", "costs")
    return cells(
        Cell(f"{mark} {title}", "" if node.taken else "dim"),
        numbers.ratio_text(node.chi2_per_dof),
        numbers.significant(node.delta_chi2.observed),
        *sizes,
        Cell(gain_text(node), "bad" if useless else ""),
        shown_place(place),
    )


def _sizes(error: Mapping[str, float], scales: Scales) -> list[str]:
    return [numbers.significant(error[unit] * factor) if unit in error else "–" for unit, (factor, _) in scales.items()]


def gain_text(node: Node) -> str:
    """Return the outcome of cross-validation in short."""
    found = node.held_out
    if found is None:
        return "–" if node.taken else "not taken"
    text = f"{elpd_text(found)} ({found.helped}/{found.of} {found.by}s)"
    return text + {"not": " no gain", "unclear": " unclear", "spares": " no loss"}.get(found.verdict, "")


def elpd_text(held_out: CrossValidation) -> str:
    """Return Δ elpd with its standard error, to the digits that this supports: +303 ± 88."""
    gain, error = numbers.value_and_sd(held_out.delta, held_out.se)
    return numbers.with_minus(f"{'' if gain.startswith('-') else '+'}{gain} ± {error}")


def offsets_moved_text(channels: Sequence[str]) -> str:
    """Return why the residual rms of channels rose although χ² fell."""
    return (
        f"The residual rms of {numbers.listed(channels)} rises because it now contains offsets of runs that "
        "parameters absorbed before. Within runs it does not rise."
    )
