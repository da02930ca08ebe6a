"""From runs to arrays: the nodes of all runs, the entries measured in them, and the times of the entries.

NumPy only.  The nodes of all runs are concatenated.  An entry has the time that it averages over, and a place in the
order in which slow noise passes through the entries.

A run records the middle times of its rows and the numbers of their samples, not the length of a sample.  That is the
smallest distance of neighbouring rows per sample between their middles: exact if rows follow without a gap.  Rows of
a run without times follow each other without a gap.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Any

import equinox as eqx
import numpy as np

from imubayes.foundations.arrays import Array, Int
from imubayes.foundations.campaign_data import KINDS, Campaign, Run
from imubayes.foundations.covariates import ambient_names
from imubayes.foundations.earth import earth_rate
from imubayes.foundations.signal_path_state import Ambient, HandMotion, Motion, OuterAxes, Records
from imubayes.noise.components import RowSpan
from imubayes.procedures import PROCEDURES
from imubayes.procedures.kinematics import CarriedNodes, OuterMotion, Stimulus, turning_rate


@dataclass(frozen=True)
class NodeTable:
    """Nodes of all runs (N of them), sorted by how many nodes their row has.

    Attributes
    ----------
    stimulus : the arrays of `Stimulus`, joined; `ambient` has every covariate, 0 if a run lacks it.
    run, pose : shape (N,), index of the run and pose, −1 where there is no pose.
    stand : shape (N,), the stand of each node: its run, or its pose or position if the run has those.
    stand_node : shape (S,), the first node of each stand.
    turns : rows as (number of rows, nodes per row), in order.
    row_of : shape (R,), global row (run after run) at each place of the sorted rows.
    injected : shape (N,), 1 where a current is injected.
    supplies : for each run what it supplies.
    campaign, parts : whose nodes they are, and the stimulus of each of its runs.
    """

    stimulus: Stimulus
    run: np.ndarray
    pose: np.ndarray
    stand: np.ndarray
    stand_node: np.ndarray
    turns: tuple[tuple[int, int], ...]
    row_of: np.ndarray
    injected: np.ndarray
    supplies: tuple[frozenset[str], ...]
    campaign: Campaign
    parts: tuple[Stimulus, ...]


@dataclass(frozen=True)
class Entries:
    """What was measured, one entry per value (E of them).

    The channel index counts the campaign's channels; a closing rotation's components count on from there.
    `row` is the row within the run, or the transition for closing rotations.  `pose` and `pose_stop` are the poses that
    it joins, the same for readouts, −1 where there is none.  `closing` marks closing rotations; `carried` the readouts
    in motion, whose attitude every gyro has a part in.
    """

    run: np.ndarray
    row: np.ndarray
    channel: np.ndarray
    value: np.ndarray
    samples: np.ndarray
    pose: np.ndarray
    pose_stop: np.ndarray
    closing: np.ndarray
    carried: np.ndarray

    def __len__(self) -> int:
        return len(self.value)


def join_nodes(campaign: Campaign) -> NodeTable:
    """Return the nodes of all runs of a campaign."""
    return _joined(campaign, tuple(_stimulus(run, campaign) for run in campaign.runs))


def rejoin_nodes(nodes: NodeTable, campaign: Campaign) -> NodeTable:
    """Return the nodes of a campaign from those of one that differs in some runs."""
    before, surroundings = nodes.campaign, (field.name for field in fields(Campaign) if field.name != "runs")
    if any(getattr(campaign, name) is not getattr(before, name) for name in surroundings):
        return join_nodes(campaign)
    runs = zip(campaign.runs, before.runs, nodes.parts, strict=True)
    return _joined(campaign, tuple(part if run is known else _stimulus(run, campaign) for run, known, part in runs))


def _stimulus(run: Run, campaign: Campaign) -> Stimulus:
    return PROCEDURES[run.procedure].stimulus(run, campaign)


def _joined(campaign: Campaign, parts: tuple[Stimulus, ...]) -> NodeTable:
    first_row = np.cumsum([0, *(run.rows for run in campaign.runs)])
    row = np.concatenate([part.row + first for part, first in zip(parts, first_row, strict=False)])
    count = np.bincount(row, minlength=first_row[-1])
    order = np.lexsort((row, count[row]))
    sorted_rows = np.lexsort((np.arange(len(count)), count))
    sizes, numbers = np.unique(count, return_counts=True)
    run = np.concatenate([np.full(len(part.row), index) for index, part in enumerate(parts)])
    run, pose = run[order], np.concatenate([part.pose for part in parts])[order]
    joined = _join(parts, order)
    stands = np.column_stack([run, pose, joined.base.reshape(-1, 9)])
    _, stand_node, stand = np.unique(stands, axis=0, return_index=True, return_inverse=True)
    return NodeTable(
        stimulus=joined,
        run=run,
        pose=pose,
        stand=stand.reshape(-1),
        stand_node=stand_node,
        turns=tuple((int(n), int(size)) for size, n in zip(sizes, numbers, strict=True)),
        row_of=sorted_rows,
        injected=np.concatenate([np.full(len(part.row), float(part.injected)) for part in parts])[order],
        supplies=tuple(part.supplies for part in parts),
        campaign=campaign,
        parts=parts,
    )


# Columns of a stimulus that every procedure gives.
_OF_NODES = (
    "row", "weight", "base", "mounting", "pose", "table_angle", "table_rate", "table_acceleration", "reference_rate",
    "reference_acceleration",
)  # fmt: skip


def _join(parts: Sequence[Stimulus], order: np.ndarray) -> Stimulus:
    def joined(name: str) -> np.ndarray:
        return np.concatenate([getattr(part, name) for part in parts])[order]

    ambient = {
        name: np.concatenate([part.ambient.get(name, np.zeros(len(part.row))) for part in parts])[order]
        for name in ambient_names()
    }
    columns: dict[str, Any] = {name: joined(name) for name in _OF_NODES}
    return Stimulus(
        **columns, ambient=ambient, injected=False, outer=_join_outer(parts, order), hand=_join_hand(parts, order)
    )


def _join_hand(parts: Sequence[Stimulus], order: np.ndarray) -> CarriedNodes | None:
    if all(part.hand is None for part in parts):
        return None
    found = [part.hand or CarriedNodes.none(len(part.row)) for part in parts]
    return CarriedNodes(
        *(np.concatenate([getattr(each, name) for each in found])[order] for name in CarriedNodes.__dataclass_fields__)
    )


def _join_outer(parts: Sequence[Stimulus], order: np.ndarray) -> OuterMotion | None:
    if all(part.outer is None for part in parts):
        return None
    found = [part.outer or OuterMotion.still(len(part.row)) for part in parts]
    return OuterMotion(
        *(np.concatenate([getattr(each, name) for each in found])[order] for name in OuterMotion.__dataclass_fields__)
    )


def outer_axes(stimulus: Stimulus, chosen: np.ndarray) -> OuterAxes | None:
    """Return the axes that carry the inner one at chosen nodes, as they travel along the signal path."""
    outer = stimulus.outer
    if outer is None:
        return None
    return OuterAxes(
        outer.links[chosen], outer.arms[chosen], outer.angle[chosen], outer.rate[chosen], outer.acceleration[chosen]
    )


def hand_motion(stimulus: Stimulus, chosen: np.ndarray) -> HandMotion | None:
    """Return the motion since its pose of a unit that is carried, at chosen nodes, by its nominal gyros."""
    hand = stimulus.hand
    if hand is None:
        return None
    return HandMotion(
        hand.turn[chosen], hand.elapsed[chosen], hand.rate[chosen], hand.acceleration[chosen], hand.carried[chosen]
    )


def motion_at(campaign: Campaign, nodes: NodeTable, chosen: np.ndarray) -> Motion:
    """Return the motion at chosen nodes; a reference gyro there has the rotation of the Earth in its rate."""
    stimulus = nodes.stimulus
    referenced = np.any(stimulus.reference_rate[nodes.stand_node[nodes.stand[chosen]]] != 0, axis=1)
    return Motion(
        base=stimulus.base[chosen],
        mounting=stimulus.mounting[chosen],
        table_angle=stimulus.table_angle[chosen],
        table_rate=stimulus.table_rate[chosen],
        table_acceleration=stimulus.table_acceleration[chosen],
        reference_rate=stimulus.reference_rate[chosen],
        reference_acceleration=stimulus.reference_acceleration[chosen],
        gravity=np.tile([0.0, 0.0, campaign.site.gravity], (len(chosen), 1)),
        earth_rate=np.where(referenced[:, None], 0.0, earth_rate(campaign.site.latitude)),
        outer=outer_axes(stimulus, chosen),
        hand=hand_motion(stimulus, chosen),
    )


def records_of(nodes: NodeTable) -> Records:
    """Return the nodes in the order of time, run after run; if a run has no time, in the order of its rows."""
    stimulus = nodes.stimulus
    time = stimulus.ambient["time"]
    order = np.lexsort((stimulus.row, time, nodes.run))
    begins = np.diff(nodes.run[order], prepend=-1) != 0
    return Records(
        node=order,
        place=np.argsort(order),
        begins=begins,
        seconds=np.where(begins, 0.0, np.diff(time[order], prepend=0.0)),
        ambient=Ambient(**{name: values[order] for name, values in stimulus.ambient.items()}),
    )


def join_entries(campaign: Campaign) -> Entries:
    """Return all measured values of a campaign, readouts first, then closing rotations."""
    columns: dict[str, list[np.ndarray]] = {name: [] for name in Entries.__dataclass_fields__}
    for index, run in enumerate(campaign.runs):
        row, channel = np.nonzero(np.isfinite(run.observed))
        pose = run.tumble.pose[row] if run.tumble is not None else np.full(len(row), -1)
        in_motion = run.tumble is not None and run.tumble.in_motion
        values = run.observed[row, channel]
        _append(columns, index, row, channel, values, run.samples[row], pose, pose, False, in_motion)
    channels = len(campaign.channels)
    for index, run in enumerate(campaign.runs):
        if run.tumble is None:
            continue
        transition = np.repeat(np.arange(len(run.tumble.start)), 3)
        component = channels + np.tile(np.arange(3), len(run.tumble.start))
        start, stop = run.tumble.start[transition], run.tumble.stop[transition]
        nothing = np.zeros(len(transition))
        _append(columns, index, transition, component, nothing, nothing + 1, start, stop, True, False)
    return Entries(**{name: np.concatenate(parts) for name, parts in columns.items()})


def _append(columns, run, row, channel, value, samples, pose, pose_stop, closing, carried) -> None:
    count = len(row)
    marks = np.full(count, closing), np.full(count, carried)
    new = (np.full(count, run), row, channel, value, samples, pose, pose_stop, *marks)
    for name, part in zip(columns, new, strict=True):
        columns[name].append(np.asarray(part))


def output_indices(campaign: Campaign, nodes: NodeTable, entries: Entries) -> np.ndarray:
    """Return for each readout entry its place in the outputs: kind after kind as rows × channels, then table angles."""
    kinds = [channel.kind for channel in campaign.channels]
    counts = {kind: kinds.count(kind) for kind in (*KINDS, "angle")}
    within = np.array([kinds[:index].count(kind) for index, kind in enumerate(kinds)], dtype=int)
    rows = len(nodes.row_of)
    sensors = rows * counts["accelerometer"]
    base = {"accelerometer": 0, "gyro": sensors, "angle": sensors + rows * counts["gyro"]}
    first_row = np.cumsum([0, *(run.rows for run in campaign.runs)])
    place_of_row = np.argsort(nodes.row_of)
    readout = ~entries.closing
    row = place_of_row[first_row[entries.run[readout]] + entries.row[readout]]
    channel = entries.channel[readout]
    width = np.array([counts[kind] for kind in kinds])[channel]
    place = np.array([base[kind] for kind in kinds])[channel] + row * width + within[channel]
    # Angles of driven tables follow behind the sensors, run after run, padded to the longest.
    driven = servo_runs(campaign)
    longest = max((campaign.runs[run].rows for run in driven), default=0)
    number = np.array([driven.index(run) if run in driven else 0 for run in range(len(campaign.runs))])
    angle = np.array([kind == "angle" for kind in kinds])[channel]
    in_run = base["angle"] + number[entries.run[readout]] * longest + entries.row[readout]
    return np.where(angle, in_run, place)


def servo_runs(campaign: Campaign) -> list[int]:
    """Return the indices of the runs in which a gyro drives the table."""
    return [index for index, run in enumerate(campaign.runs) if PROCEDURES[run.procedure].driven]


def nominal_rates(campaign: Campaign, nodes: NodeTable, entries: Entries) -> np.ndarray:
    """Return for each entry of a gyro the size of the table's rate along its input axis, output units; 0 for others."""
    stimulus = nodes.stimulus
    first_row = np.cumsum([0, *(run.rows for run in campaign.runs)])
    rate = np.zeros((first_row[-1], 3))
    rate[first_row[nodes.run] + stimulus.row] = turning_rate(stimulus)
    return _along_gyros(campaign, entries, rate)


def _along_gyros(campaign: Campaign, entries: Entries, vectors: np.ndarray) -> np.ndarray:
    """Return for each entry of a gyro the size of its row's vector (R, 3) along the input axis, times its scale, SI."""
    first_row = np.cumsum([0, *(run.rows for run in campaign.runs)])
    gyro = np.array([channel.kind == "gyro" for channel in campaign.channels] + [False] * 3)[entries.channel]
    axes = np.array([channel.axes[0] * channel.scale_si for channel in campaign.channels] + [np.zeros(3)] * 3)
    row = np.where(entries.closing, 0, first_row[entries.run] + np.where(entries.closing, 0, entries.row))
    return np.where(gyro, np.abs(np.sum(axes[entries.channel] * vectors[row], axis=1)), 0.0)


def reference_scales(campaign: Campaign, nodes: NodeTable, entries: Entries) -> np.ndarray:
    """Return for each entry of a gyro beside a reference the size of its nominal scale, SI; 0 for others."""
    referenced = np.array(["reference" in supplies for supplies in nodes.supplies])[entries.run]
    scale = np.array([c.scale_si if c.kind == "gyro" else 0.0 for c in campaign.channels] + [0.0] * 3)[entries.channel]
    return np.where(referenced & ~entries.closing, np.abs(scale), 0.0)


def encoder_slopes(campaign: Campaign, nodes: NodeTable, entries: Entries) -> np.ndarray:
    """Return for each entry of a gyro its output per angle of the table, output units per rad; 0 if none is used.

    The mean rate of a row in which the table accelerates, or turns from rest to rest, is the difference of two angles
    over its length.
    """
    stimulus = nodes.stimulus
    by_turns = np.array([run.turn_uncertainty is not None for run in campaign.runs])[nodes.run]
    between = (stimulus.table_acceleration != 0) | by_turns & (turning_rate(stimulus) != 0).any(axis=1)
    if not between.any() or not has_row_times(campaign):
        return np.zeros(len(entries))
    first_row = np.cumsum([0, *(run.rows for run in campaign.runs)])
    axis = np.zeros((first_row[-1], 3))
    axis[first_row[nodes.run] + stimulus.row] = np.where(between[:, None], stimulus.mounting[:, 2], 0.0)
    axis /= np.concatenate([length for _, length in _spans(campaign)])[:, None]
    return _along_gyros(campaign, entries, axis)


def time_ranks(campaign: Campaign, entries: Entries) -> np.ndarray:
    """Return for each entry the place of its row in the order of time of its run; without a time, that of the rows."""
    rank = entries.row.copy()
    for index, run in enumerate(campaign.runs):
        if "time" in run.covariates:
            place = np.argsort(np.argsort(run.covariates["time"], kind="stable"))
            chosen = (entries.run == index) & ~entries.closing
            rank[chosen] = place[entries.row[chosen]]
    return rank


# Largest ratio of neighbouring correlation times: see `imubayes.noise.components.FlickerNoise`.
_RATIO = 5.0


class Timeline(eqx.Module):
    """Times of the entries, in the order in which slow noise passes through them.

    Runs and channels follow one another in lanes of nearly equal length, which are passed side by side.

    Attributes
    ----------
    row : leaves (E,), and times (J,).
    lanes : shape (S, L), entry at each step of each lane, E where there is none.
    place : shape (E,), place of each entry in the flattened lanes.
    """

    row: RowSpan
    lanes: Int[Array, "S L"]
    place: Int[Array, " E"]


def has_row_times(campaign: Campaign) -> bool:
    """Return whether any run shows how long a sample lasts."""
    return any(np.isfinite(_sample_length(run)) for run in campaign.runs)


def timeline(campaign: Campaign, entries: Entries, group: np.ndarray) -> Timeline:
    """Return the times of the entries.

    Parameters
    ----------
    group : shape (E,), run and channel of each entry.
    """
    spans = list(_spans(campaign))
    start, length = np.zeros(len(entries)), np.ones(len(entries))
    for index, (begin, lasting) in enumerate(spans):
        chosen = (entries.run == index) & ~entries.closing
        start[chosen], length[chosen] = begin[entries.row[chosen]], lasting[entries.row[chosen]]
    order = np.lexsort((start, group))
    first = np.diff(group[order], prepend=-1) != 0
    end = (start + length)[order]
    gap = np.empty(len(entries))
    gap[order] = np.where(first, np.inf, np.maximum(start[order] - np.roll(end, 1), 0.0))
    lanes = _lanes(np.split(order, np.flatnonzero(first)[1:]), len(entries))
    place = np.empty(len(entries), dtype=int)
    filled = lanes.reshape(-1) < len(entries)
    place[lanes.reshape(-1)[filled]] = np.flatnonzero(filled)
    return Timeline(RowSpan(start, length, gap, _times(spans)), lanes, place)


def _sample_length(run: Run) -> float:
    """Return the length of a sample in s, ∞ if the run does not show it."""
    if run.tumble is not None and run.tumble.carried:
        return float(np.median(run.tumble.row_seconds / run.samples))
    time = run.covariates.get("time")
    if time is None or run.rows < 2:
        return np.inf
    order = np.argsort(time, kind="stable")
    samples = run.samples[order]
    apart = np.diff(time[order]) / (0.5 * (samples[1:] + samples[:-1]))
    return float(np.min(apart[apart > 0], initial=np.inf))


def _spans(campaign: Campaign) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the start of every row since that of its run, and its length, run by run."""
    own = [_sample_length(run) for run in campaign.runs]
    usual = min(own)
    for run, sample in zip(campaign.runs, own, strict=True):
        if np.isfinite(sample):
            length = run.samples * sample
            start = run.covariates["time"] - length / 2
            yield (start - start.min(initial=np.inf), length)
        else:
            length = run.samples * usual
            yield (np.cumsum(length) - length, length)


def _times(spans: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Return correlation times from half of short rows to the longest run, at least two."""
    # A remainder of a few samples at the end of a record is no row of its own.
    shortest = float(np.quantile(np.concatenate([length for _, length in spans]), 0.05)) / 2
    longest = max(float((start + length).max()) for start, length in spans if len(length))
    count = 1 + max(1, int(np.ceil(np.log(longest / shortest) / np.log(_RATIO))))
    return np.geomspace(shortest, longest, count)


def _lanes(groups: Sequence[np.ndarray], none: int) -> np.ndarray:
    """Return the entries of all groups in as few lanes as fit beside the largest group (first fit, decreasing)."""
    most = max((len(group) for group in groups), default=0)
    lanes: list[list[np.ndarray]] = []
    room: list[int] = []
    for group in sorted(groups, key=len, reverse=True):
        lane = next((place for place, left in enumerate(room) if left >= len(group)), len(lanes))
        if lane == len(lanes):
            lanes.append([])
            room.append(most)
        lanes[lane].append(group)
        room[lane] -= len(group)
    table = np.full((most, len(lanes)), none)
    for place, lane in enumerate(lanes):
        joined = np.concatenate(lane)
        table[: len(joined), place] = joined
    return table
