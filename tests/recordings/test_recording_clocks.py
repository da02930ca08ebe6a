"""What is wrong with the clock of a recording is said, and mended if there is no doubt."""

from pathlib import Path

import numpy as np
import pytest
from recording_writers import as_matrix
from tumble_files import tumble_log

from imubayes.foundations.errors import InputError
from imubayes_recordings.convert import read_recordings

COLUMNS, _ = tumble_log(poses=3)
ROWS = as_matrix(COLUMNS)
EVEN = ROWS[:, 0]


def read(folder: Path, time: np.ndarray, *, name: str = "t", keep: np.ndarray | None = None, **options):
    rows = np.c_[time, ROWS[:, 1:]]
    rows = rows if keep is None else rows[keep]
    np.savetxt(folder / "log", rows, header=f"{name} ax ay az gx gy gz", fmt="%.12g")
    made = read_recordings([folder / "log"], accel_unit="m/s^2", gyro_unit="rad/s", **options).campaign
    return made.tables["runs/recording.csv"], "\n".join(made.document["notes"])


@pytest.mark.parametrize("name", ["t", "time", "timestamp", "Time [s]", "sec", "elapsed"])
def test_names_of_the_time(tmp_path: Path, name: str) -> None:
    table, _ = read(tmp_path, EVEN, name=name.replace(" [", "["))
    np.testing.assert_allclose(table["time_s"], EVEN, atol=1e-9)


@pytest.mark.parametrize(
    ("factor", "name", "unit"),
    [(1e3, "t", "ms"), (1e6, "timestamp", "us"), (1e9, "time", "ns"), (1e6, "ustime", ""), (1e3, "time_ms", "")],
)
def test_the_unit_of_the_time_is_guessed_and_said_or_named(tmp_path: Path, factor: float, name: str, unit: str) -> None:
    table, notes = read(tmp_path, np.round(EVEN * factor), name=name)
    np.testing.assert_allclose(table["time_s"], EVEN, atol=1e-9)
    assert (f"time_unit = {unit}: the mean step of {10 * factor / 1e3:.5g} is 100 Hz" in notes) == bool(unit)
    since, notes = read(tmp_path, np.round((EVEN + 1.7e9) * factor), name=name)
    np.testing.assert_allclose(since["time_s"], EVEN, atol=1e-6)


def test_a_unit_of_time_that_may_be_another_is_asked_for(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="the unit of the time is not known: its mean step is 1") as refused:
        read(tmp_path, np.arange(len(EVEN)) * 1.0, name="time")
    assert "s (1 Hz), ms (1000 Hz)" in refused.value.issues[0].allowed
    assert "--time-unit s" in refused.value.issues[0].remedy
    table, _ = read(tmp_path, EVEN / 3600, time_unit="h")
    assert table["time_s"][1] == pytest.approx(0.01)


def test_packets_are_taken_as_even(tmp_path: Path) -> None:
    place = np.arange(len(EVEN))
    arrival = 0.01 * (place // 10 * 10 + 9) + 2e-4 * (place % 10)
    keep = np.ones(len(EVEN), dtype=bool)
    table, notes = read(tmp_path, arrival, keep=keep)
    assert (
        "samples arrive in packets of 10 (steps of 0.2 ms within and 98.2 ms between): treated as even at 100" in notes
    )
    np.testing.assert_allclose(np.diff(table["time_s"]), 0.01, rtol=1e-3)
    # A packet that was lost leaves its gap.
    lost, notes = read(tmp_path, arrival, keep=(place < 500) | (place >= 520))
    assert np.diff(lost["time_s"]).max() == pytest.approx(0.21, rel=0.02)
    kept, notes = read(tmp_path, arrival, keep=keep, clock="recorded")
    assert "--clock even treats them as evenly spaced at 100" in notes
    np.testing.assert_allclose(kept["time_s"][1], 2e-4, atol=1e-9)


def test_gaps_and_jitter_are_said(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    keep = (np.arange(len(EVEN)) < 700) | (np.arange(len(EVEN)) >= 741)
    table, notes = read(tmp_path, EVEN, keep=keep)
    assert "1 gap, the longest of 0.42 s: 41 samples missing" in notes
    assert np.diff(table["time_s"]).max() == pytest.approx(0.42)
    late = EVEN + rng.uniform(0, 4e-3, len(EVEN))
    _, notes = read(tmp_path, late)
    assert "the time jitters by 1.6" in notes
    assert "--clock even" in notes
    table, notes = read(tmp_path, late, clock="even")
    np.testing.assert_allclose(np.diff(table["time_s"]), 0.01, rtol=1e-3)


def test_counters_wrap_and_miss_samples(tmp_path: Path) -> None:
    table, notes = read(tmp_path, (np.round(EVEN * 1e6) + 2**32 - 5e6) % 2**32, name="TimeUS")
    np.testing.assert_allclose(table["time_s"], EVEN, atol=1e-9)
    assert "the time wraps round 1 time at 4294967296" in notes
    rows = np.c_[np.arange(len(EVEN)), ROWS][np.arange(len(EVEN)) % 400 != 7]
    np.savetxt(tmp_path / "log", rows, header="counter t ax ay az gx gy gz", fmt="%.12g")
    made = read_recordings([tmp_path / "log"], accel_unit="m/s^2", gyro_unit="rad/s").campaign
    missing = len(EVEN) - len(rows)
    assert f"the counter misses {missing} samples in {missing} places" in "\n".join(made.document["notes"])


@pytest.mark.parametrize("wrap", [0, 256])
def test_a_counter_gives_the_places_of_samples_at_a_stated_rate(tmp_path: Path, wrap: int) -> None:
    """Samples that the logger missed are gaps: a rate that took the rest as evenly spaced would be off by them."""
    count = np.arange(len(EVEN)) % wrap if wrap else np.arange(len(EVEN))
    keep = (np.arange(len(EVEN)) < 700) | (np.arange(len(EVEN)) >= 730)
    np.savetxt(tmp_path / "log", np.c_[count, ROWS[:, 1:]][keep], header="counter ax ay az gx gy gz", fmt="%.12g")
    units = {"accel_unit": "m/s^2", "gyro_unit": "rad/s"}
    made = read_recordings([tmp_path / "log"], **units, sample_rate_hz=100.0).campaign
    np.testing.assert_allclose(made.tables["runs/recording.csv"]["time_s"], EVEN[keep], atol=1e-9)
    assert "the counter misses 30 samples in 1 place" in "\n".join(made.document["notes"])


def test_repeated_and_late_rows_are_left_out_and_a_reset_is_refused(tmp_path: Path) -> None:
    twice = np.sort(np.r_[np.arange(len(EVEN)), [100, 300]])
    table, notes = read(tmp_path, EVEN, keep=twice)
    assert "2 repeated samples left out" in notes
    assert len(table["time_s"]) == len(EVEN)
    late = np.arange(len(EVEN))
    late[[200, 201]] = late[[201, 200]]
    table, notes = read(tmp_path, EVEN, keep=late)
    assert "1 sample out of order left out" in notes
    reset = np.where(np.arange(len(EVEN)) < 800, EVEN, EVEN - 7.9)
    with pytest.raises(InputError, match=r"the time goes back 1 times, at sample 801 by 7\.89 s") as refused:
        read(tmp_path, reset)
    assert "--sample-rate-hz 100 treats the samples as evenly spaced" in refused.value.issues[0].remedy
    table, _ = read(tmp_path, reset, sample_rate_hz=100.0)
    np.testing.assert_allclose(table["time_s"], EVEN, atol=1e-9)


@pytest.mark.parametrize("delimiter", [" ", ","])
def test_a_few_damaged_lines_are_left_out_and_counted(tmp_path: Path, delimiter: str) -> None:
    lines = [delimiter.join(f"{value:.9g}" for value in row) for row in ROWS]
    lines[700] = lines[700].replace(delimiter, delimiter + "x", 1)
    torn = "\n".join([delimiter.join(("t", "ax", "ay", "az", "gx", "gy", "gz")), *lines])
    torn = torn[: torn.rindex(delimiter) - 3]
    (tmp_path / "log").write_text(torn)
    made = read_recordings([tmp_path / "log"], accel_unit="m/s^2", gyro_unit="rad/s").campaign
    table, notes = made.tables["runs/recording.csv"], "\n".join(made.document["notes"])
    assert f"2 damaged lines are left out of {len(ROWS)} (line 702, {len(ROWS) + 1}" in notes
    np.testing.assert_allclose(table["time_s"], np.delete(EVEN, [700, len(EVEN) - 1]), atol=1e-9)
    # With a rate the samples that are left keep their times.
    made = read_recordings([tmp_path / "log"], accel_unit="m/s^2", gyro_unit="rad/s", sample_rate_hz=100.0).campaign
    np.testing.assert_allclose(made.tables["runs/recording.csv"]["time_s"][700], 7.01)
    lines[701] = lines[702] = "nothing"
    (tmp_path / "log").write_text("\n".join(lines))
    with pytest.raises(InputError, match="3 of ") as refused:
        read_recordings([tmp_path / "log"], accel_unit="m/s^2", gyro_unit="rad/s")
    assert refused.value.issues[0].where.endswith(":701")


@pytest.mark.parametrize("empty", ["readings", "either"])
def test_rows_without_time_and_reading_are_refused(tmp_path: Path, empty: str) -> None:
    """All channels empty, or times and readings in alternate rows."""
    rows = ["time_s,ax,ay,az"]
    for n in range(60):
        with_time = empty == "readings" or n % 2 == 0
        rows.append(f"{0.01 * n:.2f},,," if with_time else ",0.1,0.2,9.8")
    log = tmp_path / "log.csv"
    log.write_text("\n".join(rows) + "\n")
    with pytest.raises(InputError, match="no row has"):
        read_recordings([log], accel_unit="m/s^2", time_unit="s", rows="samples")


@pytest.mark.parametrize("lost", [0, 300])
def test_packets_that_come_late_are_no_gaps(tmp_path: Path, lost: int) -> None:
    """A busy logger reads a buffer now and then: the rate is that of the sensor, and only lost samples are a gap."""
    rng, count, rate = np.random.default_rng(4), 20_000, 100.0
    taken = np.arange(count + lost) / rate
    taken = np.delete(taken, np.arange(9000, 9000 + lost))
    reads = np.cumsum(rng.choice([0.03, 0.04, 0.07, 0.1], size=8000, p=[0.5, 0.2, 0.2, 0.1]))
    place = np.searchsorted(reads, taken)
    within = np.arange(count) - np.searchsorted(place, place)
    rows = np.c_[
        reads[place] + 0.001 * within, rng.normal([0, 0, 9.81], 0.02, (count, 3)), rng.normal(0, 1e-3, (count, 3))
    ]
    file = tmp_path / "packets.csv"
    np.savetxt(file, rows, header="time_s,ax,ay,az,gx,gy,gz", delimiter=",", comments="")
    made = read_recordings([file]).campaign
    time = next(iter(made.tables.values()))["time_s"]
    steps = np.diff(time)
    assert np.median(steps) == pytest.approx(1 / rate, rel=2e-3)
    assert np.count_nonzero(steps > 0.5) == (1 if lost else 0)
    assert np.mean(steps) == pytest.approx((count - 1 + lost) / (count - 1) / rate, rel=2e-3)


def in_pairs_of_steps(short: float, long: float, each: int, count: int = 3000) -> np.ndarray:
    """Return times of short steps, every `each`-th step a long one, s."""
    steps = np.where(np.arange(1, count) % each == 0, long, short)
    return np.concatenate([[0.0], np.cumsum(steps)])


def swung(time: np.ndarray, noise: float = 1e-3) -> np.ndarray:
    """Return the six channels of a unit that swings about two axes, at times, (n, 6): m/s² and rad/s."""
    rng, angle = np.random.default_rng(5), 0.8 * np.sin(7.0 * time)
    rate = 5.6 * np.cos(7.0 * time)
    force = 9.81 * np.stack([-np.sin(angle), 0.3 * np.cos(5.0 * time), np.cos(angle)], axis=1)
    return np.c_[force, 1.5 * np.cos(5.0 * time), rate, 0.1 * rate] + rng.normal(0, noise, (len(time), 6))


@pytest.mark.parametrize("short", [0.5e-3, 2.1e-3])
def test_the_motion_decides_whether_steps_are_packets_or_pauses(tmp_path: Path, short: float) -> None:
    """Three samples arrive at once every 26 ms, or are taken at once: the same times of two clocks."""
    times = in_pairs_of_steps(short, 26e-3, 3)
    even = np.arange(len(times)) * np.mean(np.diff(times))
    for sampled, packets in ((even, True), (times, False)):
        np.savetxt(tmp_path / "log", np.c_[times, swung(sampled)], header="time ax ay az gx gy gz", fmt="%.12g")
        made = read_recordings([tmp_path / "log"], accel_unit="m/s^2", gyro_unit="rad/s").campaign
        table, notes = made.tables["runs/recording.csv"], "\n".join(made.document["notes"])
        assert ("samples arrive in packets of 3" in notes) == packets
        expected = even - even[0] if packets else times
        np.testing.assert_allclose(np.diff(table["time_s"]), np.diff(expected), rtol=5e-3)


def test_many_pauses_of_a_unit_at_rest_are_packets(tmp_path: Path) -> None:
    times = in_pairs_of_steps(2.1e-3, 26e-3, 3)
    rest = np.random.default_rng(6).normal([0, 0, 9.81, 0, 0, 0], 0.02, (len(times), 6))
    np.savetxt(tmp_path / "log", np.c_[times, rest], header="time ax ay az gx gy gz", fmt="%.12g")
    made = read_recordings([tmp_path / "log"], accel_unit="m/s^2", gyro_unit="rad/s").campaign
    assert "samples arrive in packets of 3" in "\n".join(made.document["notes"])
