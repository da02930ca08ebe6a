"""Who shares one value: from labels to places in the parameter vector, and which entries a value can reach.

Every effect's values belong to something: a channel, a mounting, a table, a run, a pose, or a combination.  This module
knows, for each node and channel and for each measured entry, which channel, mounting, … it belongs to.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from imubayes.model.nodes import Entries, NodeTable
from imubayes.run import Campaign

Label = tuple[str, ...]
RUN_AXES = ("run", "mounting", "table")


@dataclass(frozen=True)
class Grouping:
    """What nodes and entries of a campaign belong to."""

    campaign: Campaign
    nodes: NodeTable
    entries: Entries

    def label_of_run(self, axis: str, run: int) -> str | None:
        """Return the run's own name, or its mounting or table; None where it has none."""
        one = self.campaign.runs[run]
        return {"run": one.name, "mounting": one.mounting, "table": one.table}[axis]

    def labels(self, per: Sequence[str], channels: Sequence[str], runs: Iterable[int]) -> list[Label]:
        """Return the labels of an effect that acts on some channels in some runs, in a stable order."""
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
        by_channel = list(per).index("channel") if "channel" in per else None
        order = {name: place for place, name in enumerate(channels)}
        return sorted(found, key=lambda label: order[label[by_channel]] if by_channel is not None else 0)

    def _poses(self, run: int) -> list[str]:
        tumble = self.campaign.runs[run].tumble
        return [] if tumble is None else [str(pose) for pose in tumble.pose]

    def node_places(
        self, per: Sequence[str], places: dict[Label, int], null: int, channels: Sequence[str], gated: set[int] | None
    ) -> np.ndarray:
        """Return places of values, (1 or N, 1 or C): one per node and channel of one kind.

        Parameters
        ----------
        per : what a value belongs to.
        places : label → place in the vector.
        null : place of the null value, for what the effect does not touch.
        channels : names of all channels of the kind; empty for effects on the motion.
        gated : runs in which the effect does not act, or None where it need not be kept from any.
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
        """Return which entries a value can change, shape (E,).

        Parameters
        ----------
        per, label : what the value belongs to.
        channels : channels the effect acts on, None for effects on the motion, which every channel feels.
        runs : runs in which the effect acts.
        """
        entries = self.entries
        names = [channel.name for channel in self.campaign.channels]
        reached = np.isin(entries.run, list(runs))
        if channels is not None:
            own = [label[per.index("channel")]] if "channel" in per else list(channels)
            # Closing rotations are integrated from every channel, inverted together.
            angles = [place for place, channel in enumerate(self.campaign.channels) if channel.kind == "angle"]
            # A gyro that drives a table is seen in its angle.
            felt = [names.index(name) for name in own]
            driven = angles if any(self.campaign.channels[place].kind == "gyro" for place in felt) else []
            reached &= np.isin(entries.channel, [*felt, *driven]) | entries.closing
        for axis, part in zip(per, label, strict=True):
            if axis == "pose":
                reached &= (entries.pose == int(part)) | (entries.pose_stop == int(part))
            elif axis in RUN_AXES:
                members = [run for run in runs if self.label_of_run(axis, run) == part]
                reached &= np.isin(entries.run, members)
        return reached


def colour_columns(reach: np.ndarray) -> np.ndarray:
    """Return a colour for each parameter so that no two of one colour reach a common entry; reach is (P, E).

    Greedy, widest reach first, which for block structure finds as many colours as the fullest entry has parameters.
    """
    meet = (reach.astype(np.float32) @ reach.T.astype(np.float32)) > 0
    colour = np.full(len(reach), -1)
    for parameter in np.argsort(-reach.sum(axis=1), kind="stable"):
        taken = set(colour[meet[parameter] & (colour >= 0)].tolist())
        colour[parameter] = next(c for c in range(len(reach)) if c not in taken)
    return colour
