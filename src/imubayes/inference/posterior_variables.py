"""Variables of the posterior: draws by name, unit and labelled dimensions, without gaps.

An array has a number for every combination of its labels, but parameters come as they are declared: a gyro has no
accelerometer bias.  So a dimension holds exactly the labels that its variables have.  It is called ``channel`` where
these are all channels of the campaign, ``gyro_channel`` where they are all gyros, and so on; where combinations of
labels do not make a full grid, such as the angles between pairs of axes, they share one dimension of joint labels.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product

import numpy as np

from imubayes.campaign_data import Campaign
from imubayes.inference.fitted_model import Fit
from imubayes.model.bind import Model

SAMPLE = ("chain", "draw")
# What the labels of a derived quantity are.
_DERIVED_LABELS = {
    "scale_factor": ("channel",),
    "input_axis": ("channel", "component"),
    "mounting_angle": ("channel", "mounting"),
    "axis_angle": ("axis", "axis"),
    "delta_k": ("channel", "run"),
}

Labels = tuple[str, ...]
_PAIRS: dict[Labels, str] = {("axis", "axis"): "axis_pair"}


@dataclass(frozen=True)
class Members:
    """The members of one variable before they are arranged.

    Attributes
    ----------
    owner : effect or derived quantity that the variable belongs to.
    kinds : what each part of a label names: channel, component, run, mounting, table, pose.
    columns, labels, units : of each member, its place in a flat array of draws, its label and its unit.
    """

    owner: str
    kinds: Labels
    columns: list[int] = field(default_factory=list)
    labels: list[Labels] = field(default_factory=list)
    units: list[str] = field(default_factory=list)

    def append(self, column: int, label: Labels, unit: str) -> None:
        """Add a member with one label for each kind."""
        self.columns.append(column)
        self.labels.append(label if self.kinds else ())
        self.units.append(unit)

    @property
    def unit(self) -> str:
        """The unit of all members, or each unit with the members that have it."""
        if len(set(self.units)) == 1:
            return self.units[0]
        having = {unit: [] for unit in self.units}
        for label, unit in zip(self.labels, self.units, strict=True):
            having[unit].append(",".join(label))
        return "; ".join(f"{unit} ({', '.join(labels)})" for unit, labels in having.items())


@dataclass(frozen=True)
class Labelled:
    """An array with a name for each of its dimensions, and attributes such as its unit."""

    dimensions: Labels
    values: np.ndarray
    attributes: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Variable:
    """A variable: its dimensions, and for each place of its array the column in a flat array of draws."""

    unit: str
    dimensions: Labels
    columns: np.ndarray

    def of(self, draws: np.ndarray) -> Labelled:
        """Return draws (chain, draw, D) as (chain, draw, dimensions…)."""
        return Labelled((*SAMPLE, *self.dimensions), draws[..., self.columns], {"units": self.unit})


class Dimensions:
    """Names of dimensions, each with its labels; one name never stands for two lists of labels."""

    def __init__(self, campaign: Campaign):
        self.labels: dict[str, Labels] = {}
        self._whole = dict(_lists_with_names(campaign))

    def arranged(self, name: str, members: Members) -> Variable:
        """Return a variable on dimensions of its own labels."""
        by_kind = [dict.fromkeys(label[place] for label in members.labels) for place in range(len(members.kinds))]
        place_of = dict(zip(members.labels, members.columns, strict=True))
        grid = [self._in_order(kind, labels) for kind, labels in zip(members.kinds, by_kind, strict=True)]
        if len(place_of) < np.prod([len(labels) for labels in grid], dtype=int):
            joint = _PAIRS.get(members.kinds, "_and_".join(members.kinds))
            texts = tuple(",".join(label) for label in members.labels)
            dimension = self._named(texts, (joint, f"{members.owner}_{joint}", f"{name}_{joint}"))
            return Variable(members.unit, (dimension,), np.array(members.columns))
        dimensions = tuple(
            self._named(labels, (*self._standard(kind, labels), f"{members.owner}_{kind}", f"{name}_{kind}"))
            for kind, labels in zip(members.kinds, grid, strict=True)
        )
        columns = np.array([place_of[label] for label in product(*grid)]).reshape([len(labels) for labels in grid])
        return Variable(members.unit, dimensions, columns)

    def _standard(self, kind: str, labels: Labels) -> Iterator[str]:
        """Yield the names of dimensions that are known to have just these labels."""
        if kind not in self._whole:
            yield kind
        known = (name for name, whole in self._whole.items() if whole == labels)
        yield from (name for name in known if name == kind or name.endswith(f"_{kind}"))

    def _in_order(self, kind: str, labels: Iterable[str]) -> Labels:
        order = {label: place for place, label in enumerate(self._whole.get(kind, ()))}
        return tuple(sorted(labels, key=lambda label: order.get(label, len(order))))

    def _named(self, labels: Labels, names: Sequence[str]) -> str:
        name = next(name for name in names if self.labels.get(name, labels) == labels)
        self.labels[name] = labels
        return name


def _lists_with_names(campaign: Campaign) -> Iterator[tuple[str, Labels]]:
    """Yield each list of labels that has a name of its own, in the order of the campaign."""
    yield "channel", tuple(channel.name for channel in campaign.channels)
    for kind in ("gyro", "accelerometer"):
        yield f"{kind}_channel", tuple(channel.name for channel in campaign.of_kind(kind))
    yield "run", tuple(run.name for run in campaign.runs)
    for procedure in dict.fromkeys(run.procedure for run in campaign.runs):
        yield f"{procedure}_run", tuple(run.name for run in campaign.runs if run.procedure == procedure)
    used = [run.mounting for run in campaign.runs if run.mounting is not None]
    yield "mounting", tuple(dict.fromkeys(used))
    yield "table", tuple(dict.fromkeys(run.table for run in campaign.runs if run.table is not None))


def variables_of(fit: Fit) -> tuple[dict[str, Variable], dict[str, Variable], Mapping[str, Labels]]:
    """Return the variables of parameters and of derived quantities, and the labels of each dimension.

    The columns of the first are those of the draws in units, (…, P + H), those of the second are of the derived
    quantities, (…, D).
    """
    dimensions = Dimensions(fit.model.campaign)
    own = {name: dimensions.arranged(name, members) for name, members in _parameters(fit.model).items()}
    derived = {name: dimensions.arranged(name, members) for name, members in _derived(fit).items()}
    return own, derived, dimensions.labels


def _parameters(model: Model) -> dict[str, Members]:
    """Return the variables of parameters and noise scales, ``effect.parameter``, in the order of the flat vector."""
    per: dict[str, set[Labels]] = {}
    for effect in model.assembly.effects:
        for name in effect.declared:
            per.setdefault(f"{effect.name}.{name}", set()).add(effect.per_of(name))
    found: dict[str, Members] = {}
    for column, parameter in enumerate(model.layout.parameters + model.hyper_layout.parameters):
        name = f"{parameter.effect}.{parameter.field}"
        if len(per[name]) == 1:
            kinds, label = next(iter(per[name])), parameter.label
        else:  # an effect that the model lists twice, its values belonging to different things
            kinds, label = ("label",), (",".join(parameter.label),)
        found.setdefault(name, Members(parameter.effect, kinds)).append(column, label, parameter.shown_unit)
    return found


def _derived(fit: Fit) -> dict[str, Members]:
    """Return the variables of derived quantities, by family."""
    found: dict[str, Members] = {}
    for column, quantity in enumerate(fit.derived.names):
        family, _, label = quantity.name.removesuffix("]").partition("[")
        kinds = _DERIVED_LABELS[family]
        # Names of channels have no comma; those of mountings and runs, which come second, may.
        members = found.setdefault(family, Members(family, kinds))
        members.append(column, tuple(label.split(",", len(kinds) - 1)), quantity.unit)
    return found
