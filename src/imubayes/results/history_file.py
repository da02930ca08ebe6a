"""`history.json`: the models tried, read from and written to the result folders that hold them."""

import os
from pathlib import Path

from imubayes.criticism.diagnosis_record import Diagnosis
from imubayes.errors import InputError
from imubayes.inference.run_fit import model_hash
from imubayes.loop.model_history import ChiSquareDrop, Node, node_id
from imubayes.model.bind import Model
from imubayes.results.fit_file import campaign_hash
from imubayes.results.history_tree import read_node, select, write_node
from imubayes.results.model_change import ModelChange
from imubayes.results.result import read_result
from imubayes.results.summary import Summary


def first_node(model: Model, summary: Summary, seed: int) -> Node:
    """Return the node of a fit that was made from no other."""
    data, made, converged = campaign_hash(model), model_hash(model), summary.converged
    known = summary.known_noise if converged else None
    return Node(
        id=node_id(data, made, seed, ""),
        model=model.spec.name,
        chi2=known.chi2 if known is not None else None,
        dof=known.dof if known is not None else None,
        rms=known.channels if known is not None else (),
        data_hash=data,
        model_hash=made,
        seed=seed,
        taken=converged,
        message=summary.message,
    )


def remember(parent: Path, folder: Path, change: ModelChange, diagnosis: Diagnosis | None, seed: int) -> None:
    """Write the node of a changed model below that of the result it was made from, which is begun where it has none."""
    model = change.result.fit.model
    try:
        above = read_node(parent)
    except InputError:
        before = read_result(parent)
        above = first_node(before.fit.model, before.summary, seed)
        write_node(parent, above)
    data, made, held_out = campaign_hash(model), model_hash(model), change.held_out
    known = change.result.summary.known_noise if change.taken else None
    node = Node(
        id=node_id(data, made, seed, above.id),
        model=model.spec.name,
        added=change.added,
        removed=change.removed,
        verdict=diagnosis.verdict if diagnosis is not None else None,
        chi2=known.chi2 if known is not None else None,
        dof=known.dof if known is not None else None,
        rms=known.channels if known is not None else (),
        offsets_moved=change.offsets_moved,
        delta_chi2=ChiSquareDrop(predicted=change.predicted.delta_chi2, observed=change.observed.delta_chi2),
        held_out=held_out.model_copy(update={"each": (), "rates": ()}) if held_out is not None else None,
        data_hash=data,
        model_hash=made,
        seed=seed,
        taken=change.taken,
        message=change.message,
        selected=change.taken,
    )
    join(parent, folder, node)


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
