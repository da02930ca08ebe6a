"""The models tried, as a tree: each node knows what it was made from, what that brought, and whether it is selected.

A node is what `history.json` of a result folder says; parents and children are named by their folders, as seen from
the node's own, so that results may move together.  Of a tree one node is selected: what is exported.
"""

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Node:
    """One model tried.

    Attributes
    ----------
    id : of twelve characters, from data, model, seed and parent.
    model : name of the model.
    parent : folder of the model it was made from, as seen from its own; None for the first.
    children : folders of the models made from it, as seen from its own.
    added : effects that it has more than its parent, each with its channels (None for all of the unit).
    verdict : of the diagnosis that led here, empty where there was none.
    chi2, dof : at the noise scales of its own fit.
    rms : channel → (residual error, unit).
    delta_chi2 : drop of chi² against its parent, at the parent's noise scales: expected and found; None where unknown.
    held_out : gain of the log predictive density of what was left out: gain, se, helped, of, by, verdict; empty where
        there was no comparison.
    data_hash, model_hash, seed : what was fitted.
    taken, message : whether the fit may be used, and why not.
    selected : whether this is the model that counts.
    floor : channel → (noise of the rows, unit), where the noise of a sample is known.
    """

    id: str
    model: str
    parent: str | None
    children: tuple[str, ...]
    added: tuple[Mapping[str, Any], ...]
    verdict: str
    chi2: float | None
    dof: float | None
    rms: Mapping[str, tuple[float, str]]
    delta_chi2: Mapping[str, float | None]
    held_out: Mapping[str, Any]
    data_hash: str
    model_hash: str
    seed: int
    taken: bool = True
    message: str = ""
    selected: bool = True
    floor: Mapping[str, tuple[float, str]] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """What tells it from its parent: the effects added, or the name of the first model."""
        names = " ".join(f"+ {one['effect']}" for one in self.added)
        return names or self.model


def node_id(data_hash: str, model_hash: str, seed: int, parent: str) -> str:
    """Return the name of a node: the same steps on the same data have the same name."""
    return hashlib.sha256("\0".join((data_hash, model_hash, str(seed), parent)).encode()).hexdigest()[:12]


@dataclass(frozen=True)
class Tree:
    """Models tried, by place.

    Attributes
    ----------
    nodes : place (a folder) → node.
    parents : place → place of its parent, None where that is not at hand.
    """

    nodes: Mapping[str, Node]
    parents: Mapping[str, str | None]
    children: Mapping[str, tuple[str, ...]] = field(init=False)

    def __post_init__(self):
        below: dict[str, list[str]] = {place: [] for place in self.nodes}
        for place, parent in self.parents.items():
            if parent is not None:
                below[parent].append(place)
        object.__setattr__(self, "children", {place: tuple(found) for place, found in below.items()})

    @property
    def roots(self) -> tuple[str, ...]:
        """Places of the nodes without a parent at hand."""
        return tuple(place for place, parent in self.parents.items() if parent is None)

    @property
    def selected(self) -> tuple[str, ...]:
        """Places of the selected nodes, one for each tree."""
        return tuple(place for place, node in self.nodes.items() if node.selected)

    def in_order(self) -> tuple[tuple[int, str], ...]:
        """Return depth and place of every node, each below its parent."""
        found: list[tuple[int, str]] = []

        def visit(place: str, depth: int) -> None:
            found.append((depth, place))
            for child in self.children[place]:
                visit(child, depth + 1)

        for root in self.roots:
            visit(root, 0)
        return tuple(found)

    def way_to(self, place: str) -> tuple[str, ...]:
        """Return the places from the root to a node, both included."""
        way = [place]
        while (parent := self.parents[way[0]]) is not None:
            way.insert(0, parent)
        return tuple(way)

    def together_with(self, place: str) -> tuple[str, ...]:
        """Return the places of the whole tree that a node stands in."""
        root = self.way_to(place)[0]
        return tuple(one for one in self.nodes if self.way_to(one)[0] == root)

    def selecting(self, place: str) -> dict[str, bool]:
        """Return which nodes of the tree are selected once this one is."""
        return {one: one == place for one in self.together_with(place)}


def error_by_kind(rms: Mapping[str, tuple[float, str]]) -> dict[str, float]:
    """Return the residual error by unit: the root mean square over channels of one unit."""
    units = dict.fromkeys(unit for _, unit in rms.values())
    return {unit: mean_square(value for value, one in rms.values() if one == unit) for unit in units}


def mean_square(values: Iterable[float]) -> float:
    """Return the root mean square."""
    listed = [value**2 for value in values]
    return (sum(listed) / len(listed)) ** 0.5 if listed else float("nan")
