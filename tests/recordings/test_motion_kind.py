"""How `new` and `convert` read a unit that moves: its procedure, and the unit of its gyros."""

import numpy as np
import pytest
from motion_recordings import NAMES, drilled, random_unit, waved
from tumble_recordings import random_attitudes

from imubayes import load_campaign
from imubayes.foundations.errors import InputError
from imubayes_recordings.convert import read_recordings
from imubayes_recordings.convert.motion_kind import per_radian_in_motion, procedure_in_motion
from imubayes_recordings.convert.proposed_effects import propose_effects
from imubayes_recordings.convert.unnamed_columns import rest_means, unit_of_gravity


def rates(columns: dict[str, np.ndarray]) -> np.ndarray:
    return np.stack([columns[name] for name in NAMES[3:]], axis=1)


@pytest.fixture(scope="module")
def unit():
    return random_unit(np.random.default_rng(3))


def test_a_unit_that_is_waved_is_slow_motion(unit) -> None:
    columns = waved(unit, 4, seconds=40.0)
    procedure, why = procedure_in_motion(columns, rates(columns))
    assert procedure == "slow_motion"
    assert "about all axes" in why


def test_accelerometers_alone_that_are_waved_are_in_slow_motion(unit) -> None:
    columns = {name: values for name, values in waved(unit, 4, seconds=40.0).items() if name[0] != "g"}
    procedure, why = procedure_in_motion(columns, np.zeros((len(columns["time_s"]), 0)))
    assert procedure == "slow_motion"
    assert "no gyros" in why


def test_accelerometers_alone_with_rests_stay_a_free_tumble() -> None:
    columns = {name: values for name, values in random_attitudes(6, 12).columns().items() if name[0] != "g"}
    assert procedure_in_motion(columns, np.zeros((len(columns["time_s"]), 0))) == ("free_tumble", "")


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_unit_on_a_drill_is_free_rotation(unit, axis) -> None:
    columns = drilled(unit, 5, axis, -1.0)
    procedure, why = procedure_in_motion(columns, rates(columns))
    assert procedure == "free_rotation"
    assert "about one axis" in why


def test_a_unit_with_rests_stays_a_free_tumble() -> None:
    columns = random_attitudes(6, 12).columns()
    assert procedure_in_motion(columns, rates(columns)) == ("free_tumble", "")


@pytest.mark.parametrize("factor", [1.0, 57.29578, 1000.0])
def test_gravity_tells_the_unit_of_the_gyros(unit, factor) -> None:
    columns = waved(unit, 4, seconds=40.0)
    scaled = columns | {name: factor * columns[name] for name in NAMES[3:]}
    assert per_radian_in_motion(scaled) == pytest.approx(factor, rel=0.1)


def test_a_force_that_does_not_follow_tells_nothing(unit) -> None:
    columns = waved(unit, 4, seconds=40.0)
    other = waved(unit, 8, seconds=40.0)
    assert per_radian_in_motion(columns | {name: other[name] for name in NAMES[3:]}) == 0.0


def test_a_log_that_may_be_reduced_is_in_motion_and_tells_the_unit_of_its_gyros(unit) -> None:
    """Of 8 s: a log of 5 s is reduced."""
    columns = drilled(unit, 5, 0, 1.0, seconds=8.0)
    assert procedure_in_motion(columns, rates(columns))[0] == "free_rotation"
    assert per_radian_in_motion(columns) == pytest.approx(1.0, rel=0.15)


def written(folder, columns: dict[str, np.ndarray], names: tuple[str, ...], step: int = 1, unit: str = "") -> None:
    folder.parent.mkdir(parents=True, exist_ok=True)
    rows = np.stack([columns[name] for name in ("time_s", *names)], axis=1)[::step]
    axes = names if not unit else [f"{axis} ({unit})" for axis in "XYZ"]
    header = ",".join(["time_s" if not unit else "Time (s)", *axes])
    np.savetxt(folder, rows, fmt="%.6f", delimiter=",", header=header, comments="")


@pytest.fixture(scope="module")
def session(unit, tmp_path_factory):
    """Two turns and a unit that is waved, each a folder with a file for each sensor, as a phone exports them."""
    place = tmp_path_factory.mktemp("phone")
    logs = {"x-forward": drilled(unit, 5, 0, 1.0, seconds=7.0), "x-reverse": drilled(unit, 6, 0, -1.0, seconds=7.0),
            "hand": waved(unit, 4, seconds=12.0)}  # fmt: skip
    for name, columns in logs.items():
        written(place / name / "Accelerometer.csv", columns, NAMES[:3], unit="m/s^2")
        written(place / name / "Gyroscope.csv", columns, NAMES[3:], step=2, unit="rad/s")
        (place / name / "Metadata.csv").write_text("device,app\nphone,recorder\n")
    return place


def test_folders_with_a_file_for_each_sensor_are_the_runs_of_a_session(session) -> None:
    made = read_recordings(sorted(session.iterdir())).campaign
    procedures = {run["name"]: run["procedure"] for run in made.document["run"]}
    assert list(procedures.values()) == ["slow_motion", "free_rotation", "free_rotation"]
    assert all(set(NAMES) < set(table) for table in made.tables.values())
    assert "about one axis of the body, (1.00, " in " ".join(made.document["notes"])


def test_a_stated_procedure_holds_for_all_runs(session) -> None:
    made = read_recordings(sorted(session.iterdir()), procedure="slow_motion").campaign
    assert {run["procedure"] for run in made.document["run"]} == {"slow_motion"}


def test_a_folder_without_a_table_is_refused(tmp_path) -> None:
    (tmp_path / "notes.txt").write_text("nothing\n")
    with pytest.raises(InputError, match="is a folder"):
        read_recordings([tmp_path])


def test_turns_with_the_times_of_one_clock_stay_runs_of_their_own(unit, tmp_path) -> None:
    """Joined they would be a unit that turns about all axes."""
    begin, files = 1.7e9, []
    for axis in range(2):
        columns = drilled(unit, 5 + axis, axis, 1.0, seconds=7.0)
        files.append(tmp_path / f"{'xy'[axis]}.csv")
        written(files[-1], columns | {"time_s": columns["time_s"] + begin}, NAMES)
        begin += 60.0
    made = read_recordings(files).campaign
    assert [run["procedure"] for run in made.document["run"]] == ["free_rotation"] * 2


@pytest.mark.parametrize(("axis", "off"), [(0, 0.0), (2, 0.05)])
def test_the_unit_of_accelerometers_on_a_wheel_is_that_of_turning_gravity(axis, off) -> None:
    """The mean of a vector that turns is short, and the centripetal acceleration at 5 cm is 0.2 g."""
    time = np.arange(1000) / 100.0
    turn = 2 * np.pi * time
    force = np.zeros((1000, 3))
    force[:, (axis + 1) % 3] = 9.81 * np.cos(turn) + off * (2 * np.pi) ** 2
    force[:, (axis + 2) % 3] = -9.81 * np.sin(turn)
    assert unit_of_gravity(force, rest_means(force))[0] == "m/s^2"
    assert unit_of_gravity(force / 9.81, rest_means(force / 9.81))[0] == "g"


@pytest.mark.slow
def test_a_hand_and_a_wheel_have_accelerations_of_their_own(session, tmp_path) -> None:
    """In one campaign; with one acceleration for all, the noise had heavy tails."""
    folders = sorted(session.iterdir())
    for names, per in ((folders, "run"), (folders[1:], None)):
        campaign = load_campaign(read_recordings(names).write(tmp_path / f"{per}"))
        proposed = {each.spec.name: each.spec.per for each in propose_effects(campaign).effects}
        assert proposed["hand_acceleration"] == per
