"""`history.json`: the models tried, read from and written to the result folders that hold them."""

import os
from pathlib import Path

import numpy as np

from imubayes.campaign_data import INPUT_UNIT
from imubayes.criticism.diagnosis_record import Diagnosis
from imubayes.criticism.model_history import ChannelRms, ChiSquareDrop, Node, node_id
from imubayes.errors import InputError
from imubayes.inference.run_fit import model_hash
from imubayes.model.bind import Model
from imubayes.results.addition import Addition, channel_rms
from imubayes.results.fit_file import campaign_hash
from imubayes.results.history_tree import read_node, select, write_node
from imubayes.results.result import read_result
from imubayes.results.summary import Summary
from imubayes.units import to_si


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
