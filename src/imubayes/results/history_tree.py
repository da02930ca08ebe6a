"""The tree of models tried, read from and written to the `history.json` of result folders."""

import os
from collections.abc import Iterable, Sequence
from pathlib import Path

from imubayes.atomic_files import write_text
from imubayes.errors import Issue, input_error
from imubayes.loop.model_history import Node, Tree
from imubayes.results.record_files import read_record

HISTORY = "history.json"


def write_node(folder: Path, node: Node) -> None:
    """Write `history.json` of a result folder."""
    write_text(folder / HISTORY, node.json_text())


def read_node(folder: Path) -> Node:
    """Return the node of a result folder; raises InputError where there is none or it is damaged."""
    file = folder / HISTORY
    allowed = "a folder written by `imubayes fit`, `imubayes add` or `imubayes remove`"
    remedy = "correct the path, or run the fit again"
    return read_record(file, Node, Issue("this result has no history", str(file), allowed, remedy))


def read_tree(folders: Sequence[str | Path]) -> Tree:
    """Return the trees that result folders stand in, with all ancestors and descendants that are still there.

    Raises
    ------
    InputError
        where one of the folders has no history.
    """
    nodes = {str(Path(folder).resolve()): read_node(Path(folder)) for folder in folders}
    waiting = list(nodes)
    while waiting:
        place = Path(waiting.pop(0))
        for found in _around(place, nodes[str(place)]):
            if str(found) not in nodes and (found / HISTORY).is_file():
                nodes[str(found)] = read_node(found)
                waiting.append(str(found))
    parents = {}
    for place, node in nodes.items():
        above = str((Path(place) / node.parent).resolve()) if node.parent else None
        parents[place] = above if above in nodes else None
    return Tree(nodes, parents)


def _around(place: Path, node: Node) -> Iterable[Path]:
    return [(place / other).resolve() for other in (*([node.parent] if node.parent else []), *node.children)]


def select(folder: str | Path) -> Tree:
    """Make a node the selected one of its tree; return the tree.

    Raises
    ------
    InputError
        where its fit was not taken.
    """
    place = str(Path(folder).resolve())
    tree = read_tree([folder])
    together = tree.together_with(place)
    if not tree.nodes[place].taken:
        raise input_error(
            f"this model was not taken: {tree.nodes[place].message}",
            str(folder),
            ", ".join(shown_place(other) for other in together if tree.nodes[other].taken) or "a fit that converged",
            "select one of these",
        )
    for other in together:
        if tree.nodes[other].selected != (other == place):
            write_node(Path(other), tree.nodes[other].model_copy(update={"selected": other == place}))
    return read_tree([folder])


def shown_place(place: str) -> str:
    """Return a folder as seen from here, whole where it lies elsewhere."""
    relative = os.path.relpath(place)
    return place if relative.startswith("..") else relative
