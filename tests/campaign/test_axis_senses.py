"""Reversed and exchanged axes of a unit in motion are named with the lines to check; right ones are not doubted."""

import numpy as np
import pytest
from motion_recordings import GRAVITY, NAMES, drilled, random_unit, waved

from imubayes.campaign.reduction.carried_rows import reduce_motion
from imubayes.campaign.stream_checks import Finding
from imubayes.foundations.campaign_data import Channel

AXES = {axis: np.roll(np.eye(3), -place, axis=0) for place, axis in enumerate("xyz")}
CHANNELS = [
    Channel(name, "accelerometer" if name[0] == "a" else "gyro", AXES[name[1]], "SI", 1.0, "SI", 1.0) for name in NAMES
]


def found(columns: dict[str, np.ndarray]) -> list[Finding]:
    return [each for each in reduce_motion(columns, CHANNELS, GRAVITY, "log").findings if each.name != "knocks"]


@pytest.fixture(scope="module", params=[1, 2, 3])
def hand(request: pytest.FixtureRequest) -> dict[str, np.ndarray]:
    """A unit waved vigorously: gyro biases of about 1 deg/s, and a hand that accelerates by some 30 mg."""
    seed = request.param
    return waved(random_unit(np.random.default_rng(40 + seed)), seed, seconds=60.0, reach=0.04)


@pytest.mark.parametrize(
    ("reversed_", "named", "other"),
    [
        (("gx",), "'gx'", ""), (("gz",), "'gz'", ""), (("gx", "gy", "gz"), "'gx', 'gy', 'gz'", ""),
        (("ay",), "'ay'", "'gx', 'gz'"), (("gx", "gy"), "'az'", "'gx', 'gy'"),
    ],
)  # fmt: skip
def test_reversed_axes_of_a_waved_unit_are_named(
    hand: dict[str, np.ndarray], reversed_: tuple[str, ...], named: str, other: str
) -> None:
    (finding,) = found(hand | {name: -hand[name] for name in reversed_})
    assert finding.name == "sign_reversed"
    assert f"with {named} reversed it is" in finding.what
    assert finding.remedy.startswith(f"check the sign of input_axis of {named}")
    assert (f"or of {other}: this recording does not distinguish the two" in finding.remedy) == bool(other)


def test_exchanged_axes_of_a_waved_unit_come_with_their_lines(hand: dict[str, np.ndarray]) -> None:
    (finding,) = found(hand | {"gx": hand["gy"], "gy": -hand["gx"]})
    assert finding.name == "axes_do_not_fit"
    assert "'gx': input_axis = [0, 1, 0]; 'gy': input_axis = [-1, 0, 0]" in finding.remedy


def test_a_right_set_up_is_not_doubted(hand: dict[str, np.ndarray]) -> None:
    assert not found(hand)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_about_one_axis_only_a_reversal_that_shows_is_named(axis: int) -> None:
    turned = drilled(random_unit(np.random.default_rng(9)), 9, axis, 1.0)
    about, *across = np.roll(np.array(["gx", "gy", "gz"]), -axis).tolist()
    assert not found(turned)
    assert not found(turned | {across[0]: -turned[across[0]]})
    assert any(each.name == "sign_reversed" for each in found(turned | {about: -turned[about]}))


def test_clipped_samples_divide_a_log_and_the_rest_is_used(hand: dict[str, np.ndarray]) -> None:
    """A second at the end of the range every 9 s of a minute: at least two thirds of the record remain."""
    clipped = np.where(hand["time_s"] % 9.0 < 0.5, 4.4, hand["gx"])
    reduced = reduce_motion(hand | {"gx": clipped}, CHANNELS, GRAVITY, "log", {"gx": (4.4,)})
    time = reduced.numbers["time_s"]
    assert np.all(time % 9.0 > 0.5)
    note = next(note for note in reduced.notes if "no rests" in note)
    windows, length = int(note.split()[2]), float(note.split("windows of ")[1].split()[0])
    assert windows * length > 40.0
    assert any("gx: clipped; 350 samples left out" in each for each in reduced.notes)


def test_short_pieces_of_a_log_are_used_together(hand: dict[str, np.ndarray]) -> None:
    """Half a second of each 4.5 s is missing: no piece of the minute has 5 s, and all of them together have."""
    there = hand["time_s"] % 4.5 > 0.5
    reduced = reduce_motion({name: values[there] for name, values in hand.items()}, CHANNELS, GRAVITY, "log")
    assert len(reduced.numbers["time_s"]) > 10
    assert not [each for each in reduced.findings if each.name == "sign_reversed"]
