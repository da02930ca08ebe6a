"""The models tried, as a tree: what each was made from, what that brought, and which one is selected.

A node is what `history.json` of a result folder says; its parent is named by its folder, relative to the node's own, so
that results may move together.  It is written with the fit and never again: a model made from it leaves it as it is.
Of a tree one node is selected: the one that is exported.

What a change of a model brought is reported, among other things, by the prediction of rows that were left out.  The
odds of effects that are removed come from the diagnosis that found them: they are the reverse of the odds of adding
them.
"""

import hashlib
import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from imubayes.adequacy.adequacy_record import ChannelRms
from imubayes.criticism.explanation_records import EffectChoice, EffectSlot, Evidence, RmsChange, Verdict
from imubayes.foundations.records import Presented, Record

HeldOutVerdict = Literal["helps", "unclear", "not", "costs", "spares"]
"""An addition helps or does not; a removal costs prediction or spares it; either is unclear."""


class GroupGain(Record):
    """Rise of the log predictive density of one group of rows that was left out."""

    name: str
    delta: float


class CrossValidation(Record):
    """Effect of a change of a model on the prediction of rows that were left out.

    Attributes
    ----------
    by : what is left out at a time.
    delta, se : rise of the expected log predictive density (Δ elpd) and its standard error, from the scatter among the
        groups; None for a single group.
    helped, of : number of groups that are predicted better, and of all groups.
    verdict : whether the addition ``helps`` (Δ elpd above two standard errors, or beyond chance if the signs of the
        groups were random), is ``unclear``, or does ``not`` help.  A removal ``costs`` prediction if adding the same
        would help, and ``spares`` it if it would not.
    each : Δ elpd of each group.
    rates : of poses: rms of each gyro at rest about its prediction, before and after.
    """

    by: Literal["run", "pose", "block"]
    delta: float
    se: float | None
    helped: int
    of: int
    verdict: HeldOutVerdict
    each: tuple[GroupGain, ...] = ()
    rates: tuple[RmsChange, ...] = ()


# Effects of one step that its title names.
_MOST_NAMED = 3


class ChiSquareDrop(Record):
    """Δχ² of a change at the noise scales of its parent, negative if χ² rises; None if unknown."""

    predicted: float | None = None
    observed: float | None = None


class Node(Record):
    """One model tried.

    Attributes
    ----------
    id : of twelve characters, from data, model, seed and parent.
    model : name of the model.
    parent : folder of the model it was made from, relative to its own; None for the first.
    added, removed : effects that it has more and less than its parent.
    priors, aside : parameters with another prior than in its parent, and runs with other readings set aside.
    verdict : of the diagnosis that led here; None if there was none.
    chi2, dof, rms : χ², its degrees of freedom and the residual rms of each channel, at the noise known beforehand.
    offsets_moved : the channels whose residual rms rose because the offsets of runs moved into it.
    delta_chi2 : against its parent.
    held_out : cross-validation against its parent; None if there was none.
    data_hash, model_hash, seed : what was fitted.
    taken, message : whether the fit may be used, and why not.
    selected : whether this is the model that counts, as its tree says; not kept in the file.
    """

    format: Literal[3] = 3
    id: str
    model: str
    parent: str | None = None
    added: tuple[EffectChoice, ...] = ()
    removed: tuple[EffectChoice, ...] = ()
    priors: tuple[str, ...] = ()
    aside: tuple[str, ...] = ()
    verdict: Verdict | None = None
    chi2: float | None
    dof: float | None
    rms: tuple[ChannelRms, ...]
    offsets_moved: tuple[str, ...] = ()
    delta_chi2: ChiSquareDrop = ChiSquareDrop()
    held_out: CrossValidation | None = None
    data_hash: str
    model_hash: str
    seed: int
    taken: bool = True
    message: str = ""
    selected: bool = False

    def file_text(self) -> str:
        """Return the text of `history.json`."""
        return self.model_dump_json(indent=1, exclude={"selected"}) + "\n"

    @property
    def title(self) -> str:
        """What distinguishes it from its parent: the first of what was changed, or the name of the first model."""
        changed = [f"+ {choice.effect}" for choice in self.added]
        changed += [f"− {choice.effect}" for choice in self.removed]
        changed += [f"prior of {name}" for name in self.priors] + [f"readings of {name}" for name in self.aside]
        more, named = len(changed) - _MOST_NAMED, changed[:_MOST_NAMED]
        return " ".join([*named, *([f"and {more} more"] if more > 0 else [])]) or self.model

    @property
    def chi2_per_dof(self) -> float | None:
        """χ² per degree of freedom; None if the fit was not taken."""
        return self.chi2 / self.dof if self.chi2 is not None and self.dof else None


def node_id(data_hash: str, model_hash: str, seed: int, parent: str) -> str:
    """Return the name of a node: the same steps on the same data have the same name."""
    return hashlib.sha256("\0".join((data_hash, model_hash, str(seed), parent)).encode()).hexdigest()[:12]


@dataclass(frozen=True, repr=False)
class Tree(Presented):
    """Models tried, by place.

    Attributes
    ----------
    nodes : place (a folder) → node.
    parents : place → place of its parent, None if that is not available.
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

    def path_to(self, place: str) -> tuple[str, ...]:
        """Return the places from the root to a node, both included."""
        path = [place]
        while (parent := self.parents[path[0]]) is not None:
            path.insert(0, parent)
        return tuple(path)

    def together_with(self, place: str) -> tuple[str, ...]:
        """Return the places of the whole tree that a node stands in."""
        root = self.path_to(place)[0]
        return tuple(other for other in self.nodes if self.path_to(other)[0] == root)


def rms_by_unit(channels: Iterable[ChannelRms]) -> dict[str, float]:
    """Return the root mean square over the channels of each unit."""
    sizes: dict[str, list[float]] = {}
    for channel in channels:
        sizes.setdefault(channel.unit, []).append(channel.rms)
    return {unit: math.sqrt(sum(size**2 for size in each) / len(each)) for unit, each in sizes.items()}


def removal_log_odds(found: Evidence, removed: Collection[str], kept: Collection[str]) -> float | None:
    """Return the natural logarithm of the odds of a model with effects against the one without them.

    If an effect that stays may stand in the place of one that goes, the odds are those between the two.

    Parameters
    ----------
    found : of the diagnosis of a model that had none of the effects.
    removed, kept : effects that go, and that the model keeps.

    Returns
    -------
    None if the most probable explanation does not name them all.
    """
    total, told = 0.0, set()
    for slot in found.slots:
        names = {each.effect for each in slot.candidates}
        if names & set(removed):
            told |= names & set(removed)
            total += _slot_log_odds(slot, removed, kept)
    return total if told and told == set(removed) and math.isfinite(total) else None


def _slot_log_odds(slot: EffectSlot, removed: Collection[str], kept: Collection[str]) -> float:
    gone, stay = (
        sum(each.probability for each in slot.candidates if each.effect in names) for names in (removed, kept)
    )
    if not stay:
        return slot.gain
    return math.log(gone / stay) if gone else -math.inf
