"""Recordings in counts and with running numbers: what loggers write in place of signed numbers, times and units."""

from pathlib import Path

import numpy as np
import pytest
from recording_writers import NAMES
from scipy.spatial.transform import Rotation
from tumble_recordings import GRAVITY, Recording, random_attitudes

from imubayes.foundations.errors import InputError
from imubayes_recordings.convert import ReadRecordings, read_recordings

HZ = 100.0
ACCEL, GYRO = 16384 / 9.80665, 131 * np.degrees(1)  # counts per m/s² and per rad/s, of ±2 g and ±250 deg/s
FACES = np.vstack([np.eye(3), -np.eye(3)])


def counts(made: Recording) -> np.ndarray:
    """Return whole counts of the six channels, (N, 6), clipped as by a converter of 16 bits."""
    columns = made.columns()
    values = np.stack([columns[name] for name in NAMES], axis=1) * np.repeat([ACCEL, GYRO], 3)
    return np.clip(np.round(values), -32768, 32767)


def table(file: Path, rows: np.ndarray, names: str) -> Path:
    np.savetxt(file, rows, header=names, delimiter=",", fmt="%.9g", comments="")
    return file


def scales(read: ReadRecordings) -> np.ndarray:
    return np.array([entry["scale"] for entry in read.campaign.document["channel"]])


def notes(read: ReadRecordings) -> str:
    return "\n".join(read.campaign.document["notes"])


def test_signed_counts_that_were_written_as_unsigned(tmp_path: Path) -> None:
    rows = counts(random_attitudes(3, 14))
    time = np.arange(len(rows)) / HZ
    names = ",".join(("time_s", *NAMES))
    signed = read_recordings([table(tmp_path / "signed.csv", np.c_[time, rows], names)])
    unsigned = read_recordings([table(tmp_path / "unsigned.csv", np.c_[time, rows % 65536], names)])
    recorded, expected = (next(iter(each.campaign.tables.values())) for each in (unsigned, signed))
    for name in NAMES:
        np.testing.assert_array_equal(recorded[name], expected[name])
    assert "written as unsigned" in notes(unsigned)
    assert "written as unsigned" not in notes(signed)


def test_counts_about_an_offset_stay_as_they_are(tmp_path: Path) -> None:
    rows = counts(random_attitudes(3, 14)) + 32768
    file = table(tmp_path / "offset.csv", np.c_[np.arange(len(rows)) / HZ, rows], ",".join(("time_s", *NAMES)))
    made = read_recordings([file])
    np.testing.assert_array_equal(next(iter(made.campaign.tables.values()))["gx"], rows[:, 3])
    assert "written as unsigned" not in notes(made)


def test_running_number_of_the_sample_is_no_number_of_samples(tmp_path: Path) -> None:
    columns = random_attitudes(5, 14).columns()
    rows = np.c_[1028 + np.arange(len(columns["ax"])), np.stack([columns[name] for name in NAMES], axis=1)]
    file = table(tmp_path / "log.csv", rows, ",".join(("samples", *NAMES)))
    with pytest.raises(InputError, match="no time, and no sampling rate"):
        read_recordings([file])
    made = read_recordings([file], sample_rate_hz=HZ)
    assert made.campaign.document["run"][0]["procedure"] == "free_tumble"
    assert "samples" not in next(iter(made.campaign.tables.values()))


@pytest.mark.parametrize("tilt", [0.0, 0.05])
def test_six_position_test_in_counts(tmp_path: Path, tilt: float) -> None:
    """Six faces are enough for a nominal scale: of rows that are means, and without gyros."""
    rng = np.random.default_rng(2)
    force = np.array([Rotation.from_rotvec(rng.normal(0, tilt, 3)).apply(face) for face in FACES]) * GRAVITY
    scale, offset = ACCEL * np.array([1.02, 0.99, 1.01]), np.array([120.0, -340.0, 800.0])
    rows = np.c_[force * scale + offset, np.full(6, 500.0)]
    file = table(tmp_path / "faces.csv", rows, "ax,ay,az,samples")
    made = read_recordings([file], accel_unit="count", gravity_m_s2=GRAVITY)
    np.testing.assert_allclose(scales(made), scale, rtol=0.02)
    read = np.array([entry["offset"] for entry in made.campaign.document["channel"]])
    np.testing.assert_allclose(read, offset, atol=0.02 * ACCEL * GRAVITY)


def test_six_poses_that_leave_an_axis_open_are_refused(tmp_path: Path) -> None:
    angle = np.radians([0, 60, 120, 180, 240, 300])
    rows = 16384 * np.c_[np.cos(angle), np.sin(angle), np.full(6, 1e-3) * [1, -1, 2, -2, 1, 3]]
    file = table(tmp_path / "plane.csv", np.c_[np.round(rows), np.full(6, 500.0)], "ax,ay,az,samples")
    with pytest.raises(InputError, match="the accelerometer scale cannot be estimated from 6 static poses"):
        read_recordings([file], accel_unit="count")


def test_gyros_of_pose_means_in_counts_need_a_scale(tmp_path: Path) -> None:
    rows = np.c_[np.round(16384 * FACES), np.full((6, 3), 12.0), np.full(6, 500.0)]
    file = table(tmp_path / "faces.csv", rows, ",".join((*NAMES, "samples")))
    with pytest.raises(InputError, match="the gyro scale cannot be estimated") as refused:
        read_recordings([file], accel_unit="count", gyro_unit="count")
    assert "--gyro-scale" in refused.value.issues[0].remedy


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_rate_of_the_samples_that_turns_contradict(tmp_path: Path, factor: float) -> None:
    columns = random_attitudes(7, 14).columns()
    rows = np.stack([columns[name] for name in NAMES], axis=1) * np.repeat([1.0, np.degrees(1)], 3)
    file = table(tmp_path / "log.csv", rows, ",".join(NAMES))
    with pytest.raises(InputError, match="the unit of the gyros is not known") as refused:
        read_recordings([file], sample_rate_hz=factor * HZ)
    near = refused.value.issues[0].remedy.partition("sampling rate of ")[2].split()[0]
    assert float(near) == pytest.approx(HZ, rel=0.02)
    with pytest.raises(InputError, match="the gyros are in deg/s, and turns between poses integrate to") as stated:
        read_recordings([file], sample_rate_hz=factor * HZ, gyro_unit="deg/s")
    scale = float(stated.value.issues[0].remedy.partition("--gyro-scale ")[2].split()[0])
    made = read_recordings(
        [file], sample_rate_hz=factor * HZ, gyro_unit="count", gyro_scale=[scale] * 3, gyro_offset=[0.0] * 3
    )
    assert scales(made)[3:] == pytest.approx(np.degrees(1) / factor, rel=0.02)


@pytest.mark.parametrize("hold", [2, 5])
def test_samples_that_a_fast_logger_repeats_are_counted_once(tmp_path: Path, hold: int) -> None:
    columns = random_attitudes(5, 14).columns()
    rows = np.repeat(np.stack([columns[name] for name in NAMES], axis=1), hold, axis=0)
    time = np.arange(len(rows)) / (hold * HZ)
    held = read_recordings([table(tmp_path / "held.csv", np.c_[time, rows], ",".join(("time_s", *NAMES)))])
    assert len(next(iter(held.campaign.tables.values()))["ax"]) == len(columns["ax"])
    assert "the logger repeats each sample" in notes(held)
    unnamed = read_recordings([table(tmp_path / "rate.csv", rows, ",".join(NAMES))], sample_rate_hz=hold * HZ)
    recorded = next(iter(unnamed.campaign.tables.values()))
    np.testing.assert_allclose(np.diff(recorded["time_s"]), 1 / HZ, rtol=1e-9)


def test_a_quiet_unit_that_reads_the_same_again_keeps_its_samples(tmp_path: Path) -> None:
    """Rounding to a step above the noise repeats most samples at rest, and none in motion."""
    columns = random_attitudes(5, 14).columns(noise=(1e-3, 1e-4))
    step = np.repeat([0.02, 0.002], 3)
    rows = np.round(np.stack([columns[name] for name in NAMES], axis=1) / step) * step
    time = np.arange(len(rows)) / HZ
    file = table(tmp_path / "quiet.csv", np.c_[time, rows], ",".join(("time_s", *NAMES)))
    made = read_recordings([file])
    assert np.mean((np.diff(rows, axis=0) == 0).all(axis=1)) > 0.4
    assert len(next(iter(made.campaign.tables.values()))["ax"]) == len(rows)
    still = np.c_[time[:1000], rows[:1000]]
    at_rest = read_recordings([table(tmp_path / "still.csv", still, ",".join(("time_s", *NAMES)))], gyro_unit="rad/s")
    assert len(next(iter(at_rest.campaign.tables.values()))["ax"]) == 1000


@pytest.mark.parametrize("value", [0.0, None])
def test_rows_of_a_logger_that_lost_its_sensor_are_left_out(tmp_path: Path, value: float | None) -> None:
    """Noughts, or the last reading, in all channels of a log of gyros alone."""
    rng = np.random.default_rng(8)
    rates = rng.normal([0.02, -0.01, 0.03], 2e-3, (4000, 3))
    rates[1000:1240] = rates[999] if value is None else value
    made = read_recordings([table(tmp_path / "gyro.csv", rates, "gx,gy,gz")], sample_rate_hz=HZ, gyro_unit="rad/s")
    recorded = next(iter(made.campaign.tables.values()))
    assert 3759 <= len(recorded["gx"]) <= 3760
    assert recorded["time_s"][-1] == pytest.approx(39.99)
    assert abs(np.mean(recorded["gx"]) - 0.02) < 2e-4
    assert "lost its sensor" in notes(made)


@pytest.mark.parametrize(("label", "numbers"), [("imu", True), ("device", False)])
def test_rows_of_two_units_in_one_file_are_refused(tmp_path: Path, label: str, numbers: bool) -> None:
    rng = np.random.default_rng(6)
    levels = np.array([[0.1, 0.2, 9.7, 0.01, 0.0, 0.02], [-0.3, 0.6, 9.9, -0.02, 0.03, -0.01]])
    place = np.arange(4000) % 2
    rows = levels[place] + rng.normal(0, np.repeat([0.02, 1e-3], 3), (4000, 6))
    words = [str(unit) if numbers else f"/{'ab'[unit]}/raw" for unit in place]
    lines = [f"{0.005 * k},{words[k]}," + ",".join(f"{value:.5f}" for value in row) for k, row in enumerate(rows)]
    file = tmp_path / "two.csv"
    file.write_text("\n".join([f"time_s,{label},{','.join(NAMES)}", *lines]) + "\n")
    with pytest.raises(InputError, match="one file held the rows of several units") as refused:
        read_recordings([file], gyro_unit="rad/s")
    assert f"column 2 {label}" in refused.value.issues[0].remedy
    one = tmp_path / "one.csv"
    one.write_text("\n".join([f"time_s,{label},{','.join(NAMES)}", *lines[::2]]) + "\n")
    assert "several units" not in notes(read_recordings([one], gyro_unit="rad/s"))
