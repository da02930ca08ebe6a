"""The tree of models tried, read from result folders, and the record of a fit with the campaign it belongs to.

The tree is read from the `history.json` of the folders.  A node names its parent, so that a parent is never written to;
children are looked for in the folders beside it.
"""

import os
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Literal

from imubayes.campaign import load_campaign
from imubayes.campaign.campaign_reader import CAMPAIGN_FILE
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.errors import InputError, input_error
from imubayes.foundations.records import Record
from imubayes.loop.model_history import Node, Tree
from imubayes.results.folder_files import AGAIN, FIT, HISTORY, checked, mark_selected, read_record


class CampaignPlaces(Record):
    """Folder of a campaign as given, whole, and as seen from the result; None if it has none."""

    given: str | None = None
    absolute: str | None = None
    from_result: str | None = None


class FitRecord(Record):
    """The contents of `fit.json`.

    Attributes
    ----------
    campaign : folder of the campaign.
    data_hash, model_hash : SHA-256 of campaign and model.
    z, h : parameters and hyperparameters at the mode by name, on the scale of the layout; None for a non-finite value.
    converged, message : of optimiser and sampling.
    optimised : whether the optimiser converged; None in folders of earlier versions.
    seed : of the sampler.
    campaign_notes : of the campaign, including findings about its set-up; None in folders of earlier versions.
    """

    format: Literal[1] = 1
    campaign: CampaignPlaces
    data_hash: str
    model_hash: str
    z: dict[str, float | None]
    h: dict[str, float | None]
    converged: bool
    optimised: bool | None = None
    message: str
    seed: int
    campaign_notes: tuple[str, ...] | None = None


def read_fit_record(folder: str | Path) -> FitRecord:
    """Return `fit.json` of a result folder; raises InputError if that is not whole."""
    checked(Path(folder))
    return read_record(Path(folder) / FIT, FitRecord)


def refuse_other_data(folder: str | Path, campaign: Campaign) -> None:
    """Raise InputError if a result folder is not of a campaign as it is now."""
    if read_fit_record(folder).data_hash != campaign.digest:
        raise input_error(
            f"the result is not of the campaign '{campaign.name}' as it is now",
            str(folder),
            f"the result of a fit of {campaign.folder or campaign.name}",
            "name the result that belongs to it, or fit the campaign as it is now",
        )


def campaign_of(folder: str | Path) -> Campaign | None:
    """Return the campaign of a result folder, read again; None if it is gone or no longer what was fit."""
    try:
        record = read_fit_record(folder)
        found = load_campaign(_folder(record.campaign, Path(folder)), judge_setup=False)
    except InputError:
        return None
    return found if found.digest == record.data_hash else None


def _folder(places: CampaignPlaces, folder: Path) -> Path:
    """Return the first place that holds a campaign: where it was, or as far from the result as it was."""
    roots = ((Path(), places.absolute), (Path(), places.given), (folder, places.from_result))
    candidates = [root / place for root, place in roots if place]
    for place in candidates:
        if (place / CAMPAIGN_FILE).is_file():
            return place
    what = f"the campaign is not at '{places.given}' any more" if candidates else "the campaign was never in a folder"
    raise input_error(
        what,
        f"{folder / FIT}, key 'campaign'",
        " or ".join(str(place) for place in candidates) or "a fit of a campaign folder",
        "put the campaign back, or fit it at its new place",
    )


def read_node(folder: Path) -> Node:
    """Return the node of a result folder; raises InputError if that is not whole or has none."""
    if not checked(folder).holds(HISTORY):
        allowed = "a folder written by `imubayes fit`, `imubayes add` or `imubayes remove`"
        raise input_error("this result has no history", str(folder / HISTORY), allowed, AGAIN)
    return read_record(folder / HISTORY, Node)


def read_tree(folders: Sequence[str | Path]) -> Tree:
    """Return the trees that result folders stand in, with all ancestors that are still there, and descendants beside.

    Raises
    ------
    InputError
        if one of the folders, or an ancestor of one, is no whole result.
    """
    nodes = {str(Path(folder).resolve()): read_node(Path(folder)) for folder in folders}
    waiting = list(nodes)
    while waiting:
        place = Path(waiting.pop(0))
        for found, node in (*_above(place, nodes[str(place)]), *_below(place)):
            if str(found) not in nodes:
                nodes[str(found)] = node
                waiting.append(str(found))
    parents = {place: _parent_place(Path(place), node) for place, node in nodes.items()}
    tree = Tree(nodes, {place: above if above in nodes else None for place, above in parents.items()})
    chosen = {_selected(tree, root) for root in tree.roots}
    marked = {place: node.model_copy(update={"selected": place in chosen}) for place, node in nodes.items()}
    return Tree(marked, tree.parents)


def _parent_place(place: Path, node: Node) -> str | None:
    return str((place / node.parent).resolve()) if node.parent else None


def _above(place: Path, node: Node) -> Iterator[tuple[Path, Node]]:
    parent = _parent_place(place, node)
    if parent is not None and (Path(parent) / HISTORY).is_file():
        yield Path(parent), read_node(Path(parent))


def _below(place: Path) -> Iterator[tuple[Path, Node]]:
    """Yield whole results in the folders beside one that were made from it."""
    for file in sorted(place.parent.glob(f"*/{HISTORY}")):
        with suppress(InputError):
            if _parent_place(file.parent, read_record(file, Node)) == str(place):
                yield file.parent.resolve(), read_node(file.parent)


def _selected(tree: Tree, root: str) -> str:
    """Return the place of the model that was selected last in the tree below a root; the root if none was."""
    together = tree.together_with(root)
    return max((place for _, place in tree.in_order() if place in together), key=_selection)


def _selection(place: str) -> int:
    return checked(Path(place)).selection


def next_selection(folder: Path) -> int:
    """Return the number that selects a model of the tree that a folder stands in, or one to be made from it."""
    place = str(folder.resolve())
    return 1 + max(map(_selection, read_tree([folder]).together_with(place)))


def select(folder: str | Path) -> Tree:
    """Make a node the selected one of its tree; return the tree.

    Raises
    ------
    InputError
        if its fit was not taken.
    """
    place = str(Path(folder).resolve())
    tree = read_tree([folder])
    if not tree.nodes[place].taken:
        together = tree.together_with(place)
        raise input_error(
            f"this model was not taken: {tree.nodes[place].message}",
            str(folder),
            ", ".join(shown_place(other) for other in together if tree.nodes[other].taken) or "a fit that converged",
            "select one of these",
        )
    if not tree.nodes[place].selected:
        mark_selected(Path(folder), next_selection(Path(folder)))
    return read_tree([folder])


def shown_place(place: str) -> str:
    """Return a folder as seen from here, whole if it lies elsewhere."""
    relative = os.path.relpath(place)
    return place if relative.startswith("..") else relative
