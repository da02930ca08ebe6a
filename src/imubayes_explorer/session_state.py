"""State of a session that every window receives: the tree of models, open models, tasks, and kept items."""

import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path

from imubayes.display.loop.history import gain_text
from imubayes.foundations.records import Record
from imubayes.loop.model_history import ChiSquareDrop, Tree, rms_by_unit
from imubayes.results.folder_files import MANIFEST
from imubayes.results.history_tree import shown_place
from imubayes_explorer.kept_session import ModelNote
from imubayes_explorer.messages import OpenState
from imubayes_explorer.open_model import Stamp, stamp_of
from imubayes_explorer.worker import TaskProgress


class TreeLine(Record):
    """A model of the tree: its place in it, what it brought, and the user's words.

    Attributes
    ----------
    parent : id of the model that it was made from; empty without one.
    gain : outcome of the cross-validation, in words.
    rms : residual rms over the channels of each unit.
    """

    id: str
    parent: str
    depth: int
    title: str
    folder: str
    name: str = ""
    note: str = ""
    chi2: float | None
    dof: float | None
    delta_chi2: ChiSquareDrop
    gain: str
    rms: dict[str, float]
    selected: bool
    taken: bool


class SessionState(Record):
    """What every window of a session shows alike."""

    version: int
    tree: tuple[TreeLine, ...]
    opened: tuple[OpenState, ...] = ()
    tasks: tuple[TaskProgress, ...]
    commands: tuple[str, ...]
    locks: dict[str, str]


def tree_lines(tree: Tree | None, notes: Mapping[str, ModelNote]) -> tuple[TreeLine, ...]:
    """Return the models of a tree in order, each with the user's words."""
    return tuple(_lines(tree, notes)) if tree is not None else ()


def _lines(tree: Tree, notes: Mapping[str, ModelNote]) -> Iterator[TreeLine]:
    for depth, place in tree.in_order():
        node, parent = tree.nodes[place], tree.parents[place]
        kept = notes.get(Path(place).name, ModelNote())
        yield TreeLine(
            id=id_of(place), parent=id_of(parent) if parent else "", depth=depth, title=node.title,
            folder=shown_place(place), name=kept.name, note=kept.note, chi2=node.chi2, dof=node.dof,
            delta_chi2=node.delta_chi2, gain=gain_text(node), rms=rms_by_unit(node.rms), selected=node.selected,
            taken=node.taken,
        )  # fmt: skip


def id_of(place: str) -> str:
    """Return the name of a model on the page, from its folder."""
    return hashlib.sha256(str(Path(place).resolve()).encode()).hexdigest()[:12]


def marks_of(root: Path, tree: Tree | None) -> Stamp:
    """Return the manifests of a tree, and those beside: a model that is added is written there."""
    folders = {root.resolve().parent, *(Path(place).parent for place in (tree.nodes if tree is not None else ()))}
    return stamp_of(file for folder in folders for file in folder.glob(f"*/{MANIFEST}"))
