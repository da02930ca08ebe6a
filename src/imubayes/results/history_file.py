"""`history.json`: the models tried, read from and written to the result folders that hold them."""

import json
import os
from collections.abc import Iterable, Sequence
from dataclasses import asdict, fields, replace
from pathlib import Path

import numpy as np

from imubayes.atomic_files import write_json
from imubayes.criticism.model_history import Node, Tree, mean_square, node_id
from imubayes.errors import InputError, Issue
from imubayes.inference.joint_fit import model_hash
from imubayes.model.bind import Model
from imubayes.results.fit_file import campaign_hash
from imubayes.results.residuals import INPUT_UNIT
from imubayes.results.summary import Summary
from imubayes.units import to_si

HISTORY = "history.json"


def channel_errors(summary: Summary) -> dict[str, tuple[float, str]]:
    """Return the residual error of each channel over all runs, and its unit."""
    found: dict[str, tuple[float, str]] = {}
    for channel in dict.fromkeys(run.channel for run in summary.runs):
        runs = [run for run in summary.runs if run.channel == channel]
        values = [run.rms for run in runs if run.rms is not None for _ in range(run.n)]
        if values:
            found[channel] = (mean_square(values), runs[0].unit)
    return found


def first_node(model: Model, summary: Summary, seed: int) -> Node:
    """Return the node of a fit that was made from no other."""
    data, made = campaign_hash(model), model_hash(model)
    converged = summary.converged
    return Node(
        id=node_id(data, made, seed, ""),
        model=model.spec.name,
        parent=None,
        children=(),
        added=(),
        verdict="",
        chi2=summary.chi2 if converged else None,
        dof=summary.dof if converged else None,
        rms=channel_errors(summary) if converged else {},
        delta_chi2={},
        held_out={},
        data_hash=data,
        model_hash=made,
        seed=seed,
        taken=converged,
        message=summary.message,
        selected=True,
        floor=noise_floor(model),
    )


def noise_floor(model: Model) -> dict[str, tuple[float, str]]:
    """Return the noise of the rows of each channel, of stated or pooled noise of one sample, in input units."""
    campaign, entries = model.campaign, model.entries
    found = {}
    for place, channel in enumerate(campaign.channels):
        here = (entries.channel == place) & ~entries.closing
        unit = INPUT_UNIT[channel.kind]
        if channel.noise is not None and here.any():
            size = channel.noise * float(np.sqrt(np.mean(1 / entries.samples[here])))
            found[channel.name] = (size / abs(channel.scale_si * to_si(unit, campaign.site.gravity)), unit)
    return found


def write_node(folder: Path, node: Node) -> None:
    """Write `history.json` of a result folder."""
    write_json(folder / HISTORY, {"format": 1, **asdict(node)})


def read_node(folder: Path) -> Node:
    """Return the node of a result folder; raises InputError where there is none or it is damaged."""
    file = folder / HISTORY
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        known = {key: value for key, value in content.items() if key in {one.name for one in fields(Node)}}
        for key in ("rms", "floor"):
            known[key] = {channel: (float(size), str(unit)) for channel, (size, unit) in known[key].items()}
        for key in ("children", "added"):
            known[key] = tuple(known[key])
        return Node(**known)
    except (OSError, ValueError, TypeError, AttributeError, KeyError) as error:
        raise InputError(
            Issue(
                "this result has no history" if not file.is_file() else f"the history is damaged ({error})",
                str(file),
                "a folder written by `imubayes fit` or `imubayes add`",
                "correct the path, or run the fit again",
            )
        ) from None


def join(parent: Path, child: Path, node: Node) -> None:
    """Write a node below its parent; where it is selected, no other of the tree is.

    Parameters
    ----------
    parent, child : result folders.
    node : of the child; its `parent` is set here.
    """
    above = read_node(parent)
    place = os.path.relpath(child.resolve(), parent.resolve())
    write_node(child, replace(node, parent=os.path.relpath(parent.resolve(), child.resolve())))
    write_node(parent, replace(above, children=tuple(dict.fromkeys((*above.children, place)))))
    if node.selected:
        select(child)


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
    if not tree.nodes[place].taken:
        raise InputError(
            Issue(
                f"this model was not taken: {tree.nodes[place].message}",
                str(folder),
                ", ".join(shown_place(one) for one in tree.together_with(place) if tree.nodes[one].taken)
                or "a fit that converged",
                "select one of these",
            )
        )
    for other, chosen in tree.selecting(place).items():
        if tree.nodes[other].selected != chosen:
            write_node(Path(other), replace(tree.nodes[other], selected=chosen))
    return read_tree([folder])


def shown_place(place: str) -> str:
    """Return a folder as seen from here, whole where it lies elsewhere."""
    relative = os.path.relpath(place)
    return place if relative.startswith("..") else relative
