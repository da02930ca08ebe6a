"""The models tried as a table and as JSON: a tree, the error falling, what left-out data say, which one is selected."""

from typing import Any

from rich.console import Console

from imubayes.criticism.model_history import Node, Tree, error_by_kind
from imubayes.display.fit_tables import Cell, Sheet
from imubayes.display.labels import pretty, readable
from imubayes.display.rounding import ratio_text, significant
from imubayes.display.terminal_tables import terminal
from imubayes.results.history_file import shown_place


def history_json(tree: Tree) -> dict[str, Any]:
    """Return the tree as one object: nodes in order, each below its parent."""
    nodes = []
    for depth, place in tree.in_order():
        node = tree.nodes[place]
        parent = tree.parents[place]
        nodes.append(
            {
                "folder": shown_place(place),
                "depth": depth,
                "id": node.id,
                "parent": None if parent is None else shown_place(parent),
                "model": node.model,
                "added": list(node.added),
                "verdict": node.verdict,
                "chi2": node.chi2,
                "dof": node.dof,
                "delta_chi2": dict(node.delta_chi2),
                "rms": [{"channel": name, "rms": size, "unit": unit} for name, (size, unit) in node.rms.items()],
                "held_out": dict(node.held_out),
                "data_hash": node.data_hash,
                "model_hash": node.model_hash,
                "seed": node.seed,
                "taken": node.taken,
                "message": node.message,
                "selected": node.selected,
            }
        )
    return {"format": 1, "nodes": nodes, "selected": [shown_place(place) for place in tree.selected]}


def history_sheet(tree: Tree) -> Sheet:
    """Return a line for each model tried."""
    units = list(dict.fromkeys(unit for node in tree.nodes.values() for unit in error_by_kind(node.rms)))
    scales = {unit: readable(unit, _largest(tree, unit)) for unit in units}
    rows, slim, roots = [], [], []
    for place, (depth, folder) in enumerate(tree.in_order()):
        node = tree.nodes[folder]
        if depth == 0 and place:
            roots.append(place)
        error = error_by_kind(node.rms)
        sizes = (Cell(significant(error[unit] * scales[unit][0]) if unit in error else "–") for unit in units)
        mark = "●" if node.selected else ("✕" if not node.taken else "○")
        title = f"{'   ' * (depth - 1)}└─ {node.title}" if depth else node.title
        rows.append(
            (
                Cell(f"{mark} {title}", "" if node.taken else "dim"),
                Cell(ratio_text(node.chi2 / node.dof if node.chi2 is not None and node.dof else None)),
                Cell(significant(node.delta_chi2.get("found"))),
                *sizes,
                Cell(held_out_cell(node), "bad" if node.held_out.get("verdict") == "not" else ""),
                Cell(shown_place(folder)),
            )
        )
        slim.append((rows[-1][0], *rows[-1][3:-1]))
    errors = tuple(f"residual / {pretty(scales[unit][1])}" for unit in units)
    head = ("model", "chi2/dof", "Δχ²", *errors, "left-out gain", "folder")
    note = (
        "● selected: the one that is exported; ✕ not taken. Δχ² is the fall at the noise of the model before; the gain "
        "is that of the log predictive density of what was left out in turns."
    )
    title, dividers = "Models tried", frozenset(roots)
    narrow = Sheet(title, (head[0], *head[3:-1]), slim, (0,), "", note, dividers)
    return Sheet(title, head, rows, (0, len(head) - 1), "", note, dividers, narrow)


def _largest(tree: Tree, unit: str) -> float:
    return max((error_by_kind(node.rms).get(unit, 0.0) for node in tree.nodes.values()), default=0.0)


def held_out_cell(node: Node) -> str:
    """Return the gain on left-out data in short."""
    one = node.held_out
    if not one:
        return "–"
    text = f"{one['delta']:+.1f} ± {significant(one['se'], 2)} ({one['helped']}/{one['of']} {one['by']}s)"
    return text + {"not": " no help", "unclear": " unclear"}.get(one["verdict"], "")


def print_history(tree: Tree) -> None:
    """Print the models tried."""
    console = Console()
    console.print(terminal(history_sheet(tree)))
    for place, node in tree.nodes.items():
        if not node.taken:
            console.print(f"{shown_place(place)}: {node.message}", highlight=False, markup=False, soft_wrap=True)
