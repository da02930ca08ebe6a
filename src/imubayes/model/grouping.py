"""Parameter sharing: from labels to indices in the parameter vector, and which entries a value can affect.

Every value of an effect is labelled by channel, mounting, table, run, pose or a combination.  `Grouping` finds these
labels for each node and channel and for each measured entry.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from imubayes.foundations.campaign_data import THERMOMETERS, Campaign
from imubayes.model.nodes_and_entries import Entries, NodeTable
from imubayes.model.nominal_response import NominalSamples, Probe, nominal_samples, responding_runs

Label = tuple[str, ...]
RUN_AXES = ("run", "mounting", "table", "stand", *THERMOMETERS)


def _natural(label: Label) -> Label:
    """Return what labels are sorted by: names with their numbers in order of size."""
    return tuple(re.sub(r"\d+", lambda number: number.group().zfill(12), part) for part in label)


@dataclass(frozen=True)
class Grouping:
    """Labels of the nodes and entries of a campaign."""

    campaign: Campaign
    nodes: NodeTable
    entries: Entries

    @cached_property
    def samples(self) -> tuple[NominalSamples, ...]:
        """Nominal samples of every run, by which it is judged what a run shows."""
        return nominal_samples(self.campaign, self.nodes)

    def responding(self, probe: Probe) -> set[int]:
        """Return the runs whose nominal signals an effect changes; worked out once for each effect."""
        key = probe.effect, tuple(sorted(probe.options.items())), tuple(probe.channels)
        if key not in self._responding:
            self._responding[key] = responding_runs(probe, self.samples)
        return self._responding[key]

    @cached_property
    def _responding(self) -> dict[tuple, set[int]]:
        return {}

    def run_count(self, channel: str) -> int:
        """Return the number of runs in which a channel was recorded."""
        place = [known.name for known in self.campaign.channels].index(channel)
        return len(set(self.entries.run[(self.entries.channel == place) & ~self.entries.closing].tolist()))

    def label_of_run(self, axis: str, run: int) -> str | None:
        """Return the run's own name, or its mounting, table or thermometer; None if it has none.

        It stands on its table in its mounting, which turns it about the vertical as well; without them, where it was
        put for itself.
        """
        recorded = self.campaign.runs[run]
        stand = "/".join(name for name in (recorded.table, recorded.mounting) if name) or recorded.name
        names = {"run": recorded.name, "mounting": recorded.mounting, "table": recorded.table, "stand": stand}
        return names[axis] if axis in names else getattr(recorded, axis)

    def labels(self, per: Sequence[str], channels: Sequence[str], runs: Iterable[int]) -> list[Label]:
        """Return the labels of an effect that acts on some channels in some runs, by channel, then by the other names.

        Whatever the order in which runs, channels and equipment are stated: random draws and triangular factors go by
        the order of the parameters.
        """
        found: dict[Label, None] = {}
        for run in runs:
            choices: list[list[str]] = []
            for axis in per:
                if axis == "channel":
                    choices.append(list(channels))
                elif axis == "pose":
                    choices.append(self._poses(run))
                else:
                    name = self.label_of_run(axis, run)
                    choices.append([] if name is None else [name])
            found.update(dict.fromkeys(product(*choices)))
        own = list(per).index("channel") if "channel" in per else None
        return sorted(found, key=lambda label: _natural(label if own is None else (label[own], *label)))

    def _poses(self, run: int) -> list[str]:
        tumble = self.campaign.runs[run].tumble
        return [] if tumble is None else [str(pose) for pose in tumble.pose]

    def node_places(
        self, per: Sequence[str], places: dict[Label, int], null: int, channels: Sequence[str], gated: set[int] | None
    ) -> np.ndarray:
        """Return indices of values, (1 or N, 1 or C): one per node and channel of one kind.

        Parameters
        ----------
        per : axes by which a value is labelled.
        places : label → index in the vector.
        null : index of the null value, used if the effect does not act.
        channels : names of all channels of the kind; empty for effects on the motion.
        gated : runs in which the effect is switched off; None for none.
        """
        columns = list(channels) if channels else [""]
        run_bound = any(axis in per for axis in RUN_AXES) or "pose" in per or bool(gated)
        if not run_bound:
            return np.array([[places.get(self.label(per, name), null) for name in columns]])
        table: dict[tuple[int, int], list[int]] = {}
        keys = list(zip(self.nodes.run.tolist(), self.nodes.pose.tolist(), strict=True))
        for run, pose in set(keys):
            if gated and run in gated:
                table[run, pose] = [null] * len(columns)
            else:
                table[run, pose] = [places.get(self.label(per, name, run, pose), null) for name in columns]
        return np.array([table[key] for key in keys], dtype=int).reshape(-1, len(columns))

    def label(self, per: Sequence[str], channel: str, run: int | None = None, pose: int | None = None) -> Label:
        """Return the label of a value at one channel, run and pose; empty for one value for all."""
        parts = []
        for axis in per:
            if axis == "channel":
                parts.append(channel)
            elif axis == "pose":
                parts.append(str(pose))
            else:
                assert run is not None
                parts.append(self.label_of_run(axis, run) or "")
        return tuple(parts)

    def reach(self, per: Sequence[str], label: Label, channels: Sequence[str] | None, runs: set[int]) -> np.ndarray:
        """Return which entries depend on a value, bool of shape (E,).

        Parameters
        ----------
        per, label : axes and names of the value.
        channels : channels the effect acts on; None for effects on the motion, which affect every channel.
        runs : runs in which the effect acts.
        """
        entries = self.entries
        names = [channel.name for channel in self.campaign.channels]
        reached = np.isin(entries.run, list(runs))
        if channels is not None:
            own = [label[per.index("channel")]] if "channel" in per else list(channels)
            # Closure errors and carried attitudes depend on every channel: the outputs are inverted jointly.
            angles = [place for place, channel in enumerate(self.campaign.channels) if channel.kind == "angle"]
            # A gyro that drives the table affects its angle.
            felt = [names.index(name) for name in own]
            driven = angles if any(self.campaign.channels[place].kind == "gyro" for place in felt) else []
            reached &= np.isin(entries.channel, [*felt, *driven]) | entries.closing | entries.carried
        for axis, part in zip(per, label, strict=True):
            if axis == "pose":
                reached &= (entries.pose == int(part)) | (entries.pose_stop == int(part))
            elif axis in RUN_AXES:
                members = [run for run in runs if self.label_of_run(axis, run) == part]
                reached &= np.isin(entries.run, members)
        return reached


def colour_columns(reach: np.ndarray) -> np.ndarray:
    """Colour the Jacobian columns: no two parameters of one colour affect a common entry; reach is (P, E).

    Curtis, Powell and Reid, On the estimation of sparse Jacobian matrices (J. Inst. Math. Appl. 13, 1974).

    Greedy, widest reach first, which for block structure finds as many colours as the fullest entry has parameters.
    """
    meet = (reach.astype(np.float32) @ reach.T.astype(np.float32)) > 0
    colour = np.full(len(reach), -1)
    for parameter in np.argsort(-reach.sum(axis=1), kind="stable"):
        taken = set(colour[meet[parameter] & (colour >= 0)].tolist())
        colour[parameter] = next(c for c in range(len(reach)) if c not in taken)
    return colour
