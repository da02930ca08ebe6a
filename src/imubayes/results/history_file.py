"""`history.json`: the models tried, read from and written to the result folders that hold them."""

import os
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from imubayes.atomic_files import write_text
from imubayes.criticism.diagnosis_record import Diagnosis
from imubayes.criticism.model_history import ChannelRms, ChiSquareDrop, Node, Tree, node_id
from imubayes.errors import InputError, Issue, input_error
from imubayes.inference.run_fit import model_hash
from imubayes.model.bind import Model
from imubayes.results.addition import Addition, channel_rms
from imubayes.results.fit_file import campaign_hash
from imubayes.results.folder_state import read_record
from imubayes.results.residuals import INPUT_UNIT
from imubayes.results.result import read_result
from imubayes.results.summary import Summary
from imubayes.units import to_si

HISTORY = "history.json"


def first_node(model: Model, summary: Summary, seed: int) -> Node:
    """Return the node of a fit that was made from no other."""
    data, made, converged = campaign_hash(model), model_hash(model), summary.converged
    return Node(
        id=node_id(data, made, seed, ""),
        model=model.spec.name,
        chi2=summary.chi2 if converged else None,
        dof=summary.dof if converged else None,
        rms=channel_rms(summary) if converged else (),
        data_hash=data,
        model_hash=made,
        seed=seed,
        taken=converged,
        message=summary.message,
        floor=noise_floor(model),
    )


def remember(parent: Path, folder: Path, addition: Addition, diagnosis: Diagnosis | None, seed: int) -> None:
    """Write the node of an addition below that of the result it was made from, which is begun where it has none."""
    model = addition.result.fit.model
    try:
        above = read_node(parent)
    except InputError:
        before = read_result(parent)
        above = first_node(before.fit.model, before.summary, seed)
        write_node(parent, above)
    data, made, held_out = campaign_hash(model), model_hash(model), addition.held_out
    node = Node(
        id=node_id(data, made, seed, above.id),
        model=model.spec.name,
        added=addition.added,
        verdict=diagnosis.verdict if diagnosis is not None else None,
        chi2=addition.chi2.after,
        dof=addition.dof.after,
        rms=channel_rms(addition.result.summary) if addition.channels else (),
        delta_chi2=ChiSquareDrop(predicted=addition.predicted.delta_chi2, observed=addition.observed.delta_chi2),
        held_out=held_out.model_copy(update={"each": (), "rates": ()}) if held_out is not None else None,
        data_hash=data,
        model_hash=made,
        seed=seed,
        taken=addition.taken,
        message=addition.message,
        selected=addition.taken,
        floor=above.floor,
    )
    join(parent, folder, node)


def noise_floor(model: Model) -> tuple[ChannelRms, ...]:
    """Return the noise of the rows of each channel, of stated or pooled noise of one sample, in input units."""
    campaign, entries = model.campaign, model.entries
    found = []
    for place, channel in enumerate(campaign.channels):
        here = (entries.channel == place) & ~entries.closing
        unit = INPUT_UNIT[channel.kind]
        if channel.noise is not None and here.any():
            size = channel.noise * float(np.sqrt(np.mean(1 / entries.samples[here])))
            scale = abs(channel.scale_si * to_si(unit, campaign.site.gravity))
            found.append(ChannelRms(channel=channel.name, rms=size / scale, unit=unit))
    return tuple(found)


def write_node(folder: Path, node: Node) -> None:
    """Write `history.json` of a result folder."""
    write_text(folder / HISTORY, node.json_text())


def read_node(folder: Path) -> Node:
    """Return the node of a result folder; raises InputError where there is none or it is damaged."""
    file = folder / HISTORY
    allowed = "a folder written by `imubayes fit` or `imubayes add`"
    remedy = "correct the path, or run the fit again"
    return read_record(file, Node, Issue("this result has no history", str(file), allowed, remedy))


def join(parent: Path, child: Path, node: Node) -> None:
    """Write a node below its parent; where it is selected, no other of the tree is.

    Parameters
    ----------
    parent, child : result folders.
    node : of the child; its `parent` is set here.
    """
    above = read_node(parent)
    place = os.path.relpath(child.resolve(), parent.resolve())
    write_node(child, node.model_copy(update={"parent": os.path.relpath(parent.resolve(), child.resolve())}))
    write_node(parent, above.model_copy(update={"children": tuple(dict.fromkeys((*above.children, place)))}))
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
