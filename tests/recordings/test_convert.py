"""Foreign recordings become campaigns that load: whole or not at all."""

from pathlib import Path

import numpy as np
import pytest
from tumble_files import NAMES, tumble_log

from imubayes.campaign import load_campaign
from imubayes.campaign.campaign_writer import write_campaign
from imubayes.foundations.errors import InputError
from imubayes_recordings.convert import convert

RECORDINGS = Path(__file__).parents[3] / "shared" / "data"
real = pytest.mark.skipif(not RECORDINGS.is_dir(), reason="the real recordings are not here")


def write_log(
    file: Path, columns: dict, names: tuple[str, ...] = NAMES, header: str = "", delimiter: str = " "
) -> Path:
    values = np.stack([columns[name] for name in names], axis=1)
    np.savetxt(file, values, delimiter=delimiter, header=header, comments="", fmt="%.7g")
    return file


def in_counts(columns: dict) -> tuple[dict, np.ndarray, np.ndarray]:
    scale = np.array([415.0, 413, 416, 4778, 4758, 4766])
    offset = np.array([33123.0, 33276, 32360, 32768, 32466, 32485])
    counts = {n: np.round(columns[n] * scale[i] + offset[i]) for i, n in enumerate(NAMES)}
    return {"time_s": columns["time_s"]} | counts, scale, offset


def test_six_column(tmp_path: Path) -> None:
    columns, _ = tumble_log()
    log = write_log(tmp_path / "unit.log", columns)
    folder = convert([log], tmp_path / "campaign", sample_rate_hz=100, gravity_m_s2=9.8, latitude_deg=50)
    campaign = load_campaign(folder)
    assert campaign.name == "campaign"
    assert campaign.site.gravity == 9.8
    assert [channel.per for channel in campaign.channels] == ["m/s^2"] * 3 + ["rad/s"] * 3
    assert campaign.runs[0].rows == 16
    assert campaign.runs[0].tumble is not None
    assert not list(tmp_path.glob(".campaign-*"))


def test_header_columns_and_units(tmp_path: Path) -> None:
    columns, _ = tumble_log()
    columns = columns | {name: np.rad2deg(columns[name]) for name in NAMES[3:]} | {"t": columns["time_s"] * 1e3 + 5e6}
    header = "stamp\timu.gx\timu.gy\timu.gz\timu.ax\timu.ay\timu.az"
    log = write_log(tmp_path / "unit.tsv", columns, ("t", *NAMES[3:], *NAMES[:3]), header, "\t")
    names = {name: f"imu.{name}" for name in NAMES} | {"time_s": "stamp"}
    folder = convert([log], tmp_path / "out", columns=names, time_unit="ms", gyro_unit="deg/s", temperature_degC=21.0)
    campaign = load_campaign(folder)
    assert campaign.runs[0].rows == 16
    assert campaign.channels[5].per == "deg/s"
    assert campaign.runs[0].covariates["temperature"][0] == 21.0
    assert any("latitude was not given" in note for note in campaign.notes)


def test_imu_tk_with_given_scale(tmp_path: Path) -> None:
    columns, scale, offset = in_counts(tumble_log()[0])
    files = [write_log(tmp_path / "acc.txt", columns, ("time_s", *NAMES[:3]))]
    files.append(write_log(tmp_path / "gyro.txt", columns, ("time_s", *NAMES[3:])))
    given = {"accel_scale": scale[:3], "accel_offset": offset[:3], "gyro_scale": scale[3:], "gyro_offset": offset[3:]}
    folder = convert(files, tmp_path / "c", accel_unit="count", gyro_unit="count", gravity_m_s2=9.8, **given)
    campaign = load_campaign(folder)
    assert campaign.runs[0].rows == 16
    assert campaign.channels[0].scale_si == 415
    assert campaign.channels[5].offset == 32485


def test_scale_of_counts_is_estimated(tmp_path: Path) -> None:
    columns, scale, offset = in_counts(tumble_log(poses=24)[0])
    log = write_log(tmp_path / "unit.log", columns)
    folder = convert([log], tmp_path / "c", sample_rate_hz=100, accel_unit="count", gyro_unit="count", gravity_m_s2=9.8)
    campaign = load_campaign(folder)
    np.testing.assert_allclose([channel.scale_si for channel in campaign.channels], scale, rtol=3e-3)
    biased = offset + np.r_[np.zeros(3), 0.01 * scale[3:]]
    np.testing.assert_allclose([channel.offset for channel in campaign.channels], biased, atol=4.0)
    assert sum("estimated" in note for note in campaign.notes) == 2


def test_two_clocks(tmp_path: Path) -> None:
    columns, _ = tumble_log()
    other = {name: values[3:-3] for name, values in columns.items()}
    files = [write_log(tmp_path / "acc.txt", columns, ("time_s", *NAMES[:3]))]
    files.append(write_log(tmp_path / "gyro.txt", other, ("time_s", *NAMES[3:])))
    assert load_campaign(convert(files, tmp_path / "c")).runs[0].rows == 16


def test_static_log_for_a_thermal_ramp(tmp_path: Path) -> None:
    time = np.arange(0, 600, 0.1)
    columns = {"a": 9.8 + 0 * time, "t": 20 + time / 100} | {n: np.sin(time) for n in NAMES[3:]}
    columns |= {"ax": np.sin(time) / 10, "ay": np.cos(time) / 10, "az": columns["a"] + np.sin(time) / 10}
    log = write_log(tmp_path / "ramp.csv", columns, (*NAMES, "t"), ",".join((*NAMES, "temp")), ",")
    folder = convert([log], tmp_path / "c", sample_rate_hz=10, procedure="thermal_ramp",
        columns={name: name for name in NAMES} | {"temperature_degC": "temp"},
    )  # fmt: skip
    assert load_campaign(folder).runs[0].rows > 10


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"accel_unit": "ft/s2"}, "accel_unit"),
        ({"acel_unit": "g"}, "not an option"),
        ({"gyro_scale": [1.0, 2.0]}, "gyro_scale has 2 numbers"),
        ({"sample_rate_hz": -1.0}, "not positive"),
        ({"sample_rate_hz": None}, "no sampling rate was given"),
        ({"clock": "evn"}, "clock = 'evn'"),
        ({"topic": ["imu"]}, "there is no topic 'imu'"),
        ({"mapping": "bad.log"}, "the mapping cannot be read"),
        ({"columns": {"ax": 9}}, "there is no column '9'"),
        ({"columns": {"acc_x": 1}}, "not a column of a run table"),
        ({"files": ["nothing.log"]}, "there is no file"),
        ({"files": ["bad.log"]}, r"bad\.log:2"),
        ({"files": ["empty.log"]}, "is empty"),
        ({"files": []}, "no file was given"),
        ({"out": "unit.log"}, "not an empty folder"),
        ({"out": "occupied"}, "not an empty folder"),
        ({"accel_unit": "g"}, "which is 9.805 g"),
        ({"procedure": "free_tumbel"}, "procedure = 'free_tumbel'"),
    ],
)
def test_refusals_leave_nothing_behind(tmp_path: Path, change: dict, text: str) -> None:
    columns, _ = tumble_log(poses=6)
    write_log(tmp_path / "unit.log", columns)
    (tmp_path / "bad.log").write_text("0 0 9.8 0 0 0\n0 0 x 0 0 0\n0 0 9.8 0 0 0\n")
    (tmp_path / "empty.log").write_text("")
    (tmp_path / "occupied").mkdir()
    (tmp_path / "occupied" / "precious").write_text("")
    before = sorted(tmp_path.rglob("*"))
    call = {"files": ["unit.log"], "out": "campaign", "sample_rate_hz": 100.0} | change
    files, out = [tmp_path / f for f in call.pop("files")], tmp_path / call.pop("out")
    call |= {key: tmp_path / call[key] for key in ("mapping",) if key in call}
    with pytest.raises(InputError, match=text) as caught:
        convert(files, out, **call)
    assert all(problem.where and problem.remedy for problem in caught.value.issues)
    assert sorted(tmp_path.rglob("*")) == before


def test_problems_are_placed_in_the_recording_and_its_options(tmp_path: Path) -> None:
    columns, _ = tumble_log(poses=6)
    columns["ax"][40] = np.nan
    log = write_log(tmp_path / "unit.log", columns)
    with pytest.raises(InputError) as caught:
        convert([log], tmp_path / "c", sample_rate_hz=100, latitude_deg=200.0, temperature_degC=1000.0)
    places = [problem.where for problem in caught.value.issues]
    assert {"option latitude_deg", "option temperature_degC"} <= set(places)
    columns["ax"][40] = 0.0
    columns["gy"][41] = np.inf
    with pytest.raises(InputError) as caught:
        convert([write_log(log, columns)], tmp_path / "c", sample_rate_hz=100)
    assert [problem.where for problem in caught.value.issues] == [f"{log}, sample 42, column 'gy'"]
    assert not (tmp_path / "c").exists()


def test_lines_that_cannot_be_read_are_counted_from_one(tmp_path: Path) -> None:
    for third in ("1 2 x 4 5 6", "1 2"):
        (tmp_path / "bad.log").write_text(f"1 2 3 4 5 6\n1 2 3 4 5 6\n{third}\n1 2 3 4 5 6\n")
        with pytest.raises(InputError, match=r"bad\.log:3"):
            convert([tmp_path / "bad.log"], tmp_path / "c", sample_rate_hz=100)


def test_writing_into_an_empty_folder(tmp_path: Path) -> None:
    (tmp_path / "c").mkdir()
    write_campaign(tmp_path / "c", {"format": 1}, {"runs/a.csv": {"x": np.arange(2.0)}}, check=False)
    assert (tmp_path / "c/runs/a.csv").read_text() == "x\n0\n1\n"
    assert (tmp_path / "c").stat().st_mode & 0o500 == 0o500


@real
def test_xsens(tmp_path: Path) -> None:
    files = [RECORDINGS / "xsens/xsens_acc.mat", RECORDINGS / "xsens/xsens_gyro.mat"]
    folder = convert(files, tmp_path / "c", accel_unit="count", gyro_unit="count", gravity_m_s2=9.81744)
    campaign = load_campaign(folder)
    np.testing.assert_allclose([c.scale_si for c in campaign.channels[:3]], [415, 413, 415], rtol=5e-3)
    np.testing.assert_allclose([c.scale_si for c in campaign.channels[3:]], [4778, 4758, 4766], rtol=3e-2)
    tumble = campaign.runs[0].tumble
    assert 36 <= len(tumble.flagged) <= 39
    assert not tumble.flagged.any()


@real
@pytest.mark.parametrize("unit", [0, 1])
def test_mpu9150(tmp_path: Path, unit: int) -> None:
    log = RECORDINGS / f"mpu9150/imu{unit}.log"
    campaign = load_campaign(convert([log], tmp_path / "c", sample_rate_hz=100, gravity_m_s2=9.81))
    tumble = campaign.runs[0].tumble
    assert len(tumble.flagged) == 22
    assert list(np.flatnonzero(tumble.flagged)) == [3]
    assert any("pose 3" in note and "disturbed" in note for note in campaign.runs[0].notes)
