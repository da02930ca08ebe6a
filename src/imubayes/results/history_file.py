"""What `history.json` of a result says: the model, and what it was made from."""

import os
from pathlib import Path

from imubayes.criticism.diagnosis_record import Diagnosis
from imubayes.inference.run_fit import model_hash
from imubayes.loop.model_history import ChiSquareDrop, Node, node_id
from imubayes.model.bind import Model
from imubayes.results.fit_file import campaign_hash
from imubayes.results.history_tree import read_node
from imubayes.results.model_change import ModelChange
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


def next_node(parent: Path | None, change: ModelChange, diagnosis: Diagnosis | None, seed: int) -> Node:
    """Return the node of a changed model; of one that was made from no folder, a first one.

    Parameters
    ----------
    parent : result folder that it was made from.
    change : what was done, with the refit, whose folder is known.
    diagnosis : that led to it.
    """
    refitted = change.result
    if parent is None or refitted.folder is None:
        return first_node(refitted.fit.model, refitted.summary, seed)
    model, above = refitted.fit.model, read_node(parent)
    data, made, held_out = campaign_hash(model), model_hash(model), change.held_out
    known = refitted.summary.known_noise if change.taken else None
    return Node(
        id=node_id(data, made, seed, above.id),
        model=model.spec.name,
        parent=os.path.relpath(parent.resolve(), refitted.folder.resolve()),
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
    )
