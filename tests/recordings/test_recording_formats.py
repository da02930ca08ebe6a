"""One recording of each format, written by another writer than the reader's library, becomes the same campaign."""

import gzip
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import polars as pl
import pytest
import recording_writers as written
from recording_writers import NAMES, as_matrix
from tumble_files import HZ, tumble_log

from imubayes.campaign import load_campaign
from imubayes.foundations.campaign_data import Run
from imubayes.foundations.errors import InputError
from imubayes_recordings.convert import convert

COLUMNS, _ = tumble_log(poses=6)
ROWS = as_matrix(COLUMNS)
MICROSECONDS = np.round(1e6 * ROWS[:, :1])


def converted(folder: Path, *files: Path, **options: Any) -> tuple[Run, str]:
    campaign = load_campaign(convert(files, folder / "campaign", gravity_m_s2=9.8, latitude_deg=50, **options))
    return campaign.runs[0], "\n".join(campaign.notes)


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """The run as read from a plain table with the names of a campaign."""
    folder = tmp_path_factory.mktemp("expected")
    np.savetxt(folder / "log", ROWS, header=" ".join(("time_s", *NAMES)), fmt="%.9g")
    return converted(folder, folder / "log")[0]


def parquet(folder: Path) -> Path:
    names = ("timestamp", "acc_x", "acc_y", "acc_z", "gyr_x", "gyr_y", "gyr_z")
    stamps = pl.Series((1e9 * ROWS[:, 0]).round().astype(np.int64) + 1_700_000_000 * 10**9).cast(pl.Datetime("ns"))
    table = pl.DataFrame({name: ROWS[:, place] for place, name in enumerate(names)}).with_columns(timestamp=stamps)
    table.write_parquet(folder / "log.bin")
    return folder / "log.bin"


def plain_array(folder: Path) -> Path:
    (folder / "log.npy").write_bytes(written.npy(ROWS))
    return folder / "log.npy"


def named_arrays(folder: Path) -> Path:
    np.savez(folder / "log.npz", t=ROWS[:, 0], accel=ROWS[:, 1:4], gyro=ROWS[:, 4:].T, label=np.array("unit 7"))
    return folder / "log.npz"


def matlab(folder: Path) -> Path:
    arrays = {"acc": ROWS[:, 1:4], "time": ROWS[:, 0], "gyro": ROWS[:, 4:]}
    (folder / "log.mat").write_bytes(written.matlab5(arrays))
    return folder / "log.mat"


def matlab73(folder: Path) -> Path:
    with h5py.File(folder / "log.mat", "w", userblock_size=512) as file:
        file["imu/t"], file["imu/acc"], file["imu/gyr"] = ROWS[None, :, 0], ROWS[:, 1:4].T, ROWS[:, 4:].T
        file["imu/gyr"].attrs["units"] = np.bytes_("rad/s")
        file["#refs#/a"] = np.zeros(3)
    with (folder / "log.mat").open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\2IM")
    return folder / "log.mat"


def flight_log(folder: Path) -> Path:
    fields = [("uint64_t", "timestamp"), ("float[3]", "gyro_rad"), ("float[3]", "accelerometer_m_s2")]
    other = ([("uint64_t", "timestamp"), ("float", "xyz")], np.c_[MICROSECONDS[:9], np.ones(9)])
    rows = np.c_[MICROSECONDS, ROWS[:, 4:], ROWS[:, 1:4]]
    (folder / "log.ulg").write_bytes(written.ulog({"sensor_combined": (fields, rows), "other": other}))
    return folder / "log.ulg"


def dataflash(folder: Path) -> Path:
    (folder / "log.bin").write_bytes(written.dataflash(ROWS))
    return folder / "log.bin"


def mdf(folder: Path) -> Path:
    units = dict.fromkeys(("Acc_X", "Acc_Y", "Acc_Z"), "m/s2") | dict.fromkeys(("Gyro_X", "Gyro_Y", "Gyro_Z"), "rad/s")
    columns = {name: (unit, ROWS[:, place]) for place, (name, unit) in enumerate(units.items(), 1)}
    (folder / "log.mf4").write_bytes(written.mdf4({"t": ("s", ROWS[:, 0])} | columns))
    return folder / "log.mf4"


def ros2(folder: Path) -> Path:
    written.ros2_db3(folder / "bag.db3", ROWS + np.r_[1.7e9, np.zeros(6)])
    return folder / "bag.db3"


def tdms(folder: Path) -> Path:
    columns = {f"Acc {axis}": ROWS[:, 1 + place] for place, axis in enumerate("XYZ")}
    columns |= {f"Gyro {axis}": ROWS[:, 4 + place] for place, axis in enumerate("XYZ")}
    (folder / "log.tdms").write_bytes(written.tdms("IMU", columns, {"wf_increment": 0.01}))
    return folder / "log.tdms"


def euroc(folder: Path) -> Path:
    (folder / "mav0/imu0").mkdir(parents=True)
    header = "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m s^-2]," + (
        "a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]"
    )
    lines = [
        f"{round(1e9 * t) + 1403636579758555392}," + ",".join(f"{v:.9g}" for v in (*w, *f))
        for t, f, w in zip(ROWS[:, 0], ROWS[:, 1:4], ROWS[:, 4:], strict=True)
    ]
    (folder / "mav0/imu0/data.csv").write_text("\r\n".join([header, *lines]))
    return folder / "mav0"


def psins(folder: Path) -> Path:
    np.savetxt(folder / "imu.txt", np.c_[0.01 * ROWS[:, 4:], 0.01 * ROWS[:, 1:4], ROWS[:, 0]], fmt="%.12g")
    return folder / "imu.txt"


def betaflight_csv(folder: Path) -> Path:
    head = "loopIteration,time (us),gyroADC[0] (deg/s),gyroADC[1] (deg/s),gyroADC[2] (deg/s),accSmooth[0] (m/s/s)," + (
        "accSmooth[1] (m/s/s),accSmooth[2] (m/s/s)"
    )
    values = np.c_[np.arange(len(ROWS)), MICROSECONDS, np.degrees(ROWS[:, 4:]), ROWS[:, 1:4]]
    np.savetxt(folder / "log.csv", values, delimiter=", ", header=head, comments="", fmt="%.12g")
    return folder / "log.csv"


def spreadsheet(folder: Path) -> Path:
    """Lines about the unit, names, units below them, decimal commas, a date and a time of day over midnight."""
    lines = ["Unit;A-17;;;;;;;", "Rate;100 Hz", "", "Date;Time;Acc X;Acc Y;Acc Z;Gyro X;Gyro Y;Gyro Z;T"]
    lines.append("-;-;g;g;g;°/s;°/s;°/s;°C")
    for time, *values in ROWS:
        late = 86395 + time
        date, clock = ("03.11.2026", late) if late < 86400 else ("04.11.2026", late - 86400)
        cells = [date, f"{int(clock // 3600):02d}:{int(clock // 60) % 60:02d}:{clock % 60:06.3f}"]
        cells += [f"{v / 9.8:.9f}" for v in values[:3]] + [f"{np.degrees(v):.9f}" for v in values[3:]] + ["23.4"]
        lines.append(";".join(cells).replace(".", ",", 9).replace("03,11,", "03.11.").replace("04,11,", "04.11."))
    (folder / "log.csv.gz").write_bytes(gzip.compress("\r\n".join(lines).encode("cp1252")))
    return folder / "log.csv.gz"


def tagged(folder: Path) -> Path:
    lines = [
        f"{word} {round(1e3 * row[0])} {row[first]:.9g} {row[first + 1]:.9g} {row[first + 2]:.9g}"
        for row in ROWS
        for word, first in (("acc", 1), ("gyro", 4))
    ]
    (folder / "log.txt").write_text("\n".join(lines))
    return folder / "log.txt"


def unnamed(folder: Path) -> Path:
    """Thirteen columns and one: time, forces, rates, then raw readings that are no g, and a temperature."""
    raw = np.round(ROWS[:, 1:] * 1000)
    np.savetxt(folder / "log", np.c_[ROWS, raw, np.full(len(ROWS), 31.5)], delimiter="\t", fmt="%.9g")
    return folder / "log"


def vectornav(folder: Path) -> Path:
    (folder / "log.txt").write_text(written.vectornav(ROWS))
    return folder / "log.txt"


def gyroflow(folder: Path) -> Path:
    (folder / "log.gcsv").write_text(written.gyroflow(ROWS, (0.001, 1e-6, 1e-6)))
    return folder / "log.gcsv"


def receiver(folder: Path) -> Path:
    (folder / "log.txt").write_text(written.rawimu(COLUMNS, 1000.0, 50000.0))
    return folder / "log.txt"


WRITERS: dict[Callable[[Path], Path], dict[str, Any]] = {
    parquet: {}, plain_array: {}, named_arrays: {}, matlab: {}, matlab73: {}, flight_log: {}, dataflash: {}, ros2: {},
    tdms: {}, mdf: {}, euroc: {}, psins: {}, betaflight_csv: {}, spreadsheet: {}, tagged: {}, unnamed: {},
    vectornav: {"sample_rate_hz": HZ},
}  # fmt: skip
EXTRA = {flight_log: "pyulog", dataflash: "pymavlink", ros2: "rosbags", tdms: "nptdms", mdf: "asammdf"}


@pytest.mark.parametrize("write", WRITERS, ids=lambda write: write.__name__)
def test_each_format_gives_the_same_rows(tmp_path: Path, expected: Run, write: Callable[[Path], Path]) -> None:
    if write in EXTRA:
        pytest.importorskip(EXTRA[write])
    run, notes = converted(tmp_path, write(tmp_path), **WRITERS[write])
    factor = np.ones(6)
    if write is spreadsheet:
        factor = np.array([9.8] * 3 + [np.pi / 180] * 3)
    if write is betaflight_csv:
        factor = np.array([1.0] * 3 + [np.pi / 180] * 3)
    np.testing.assert_allclose(run.observed * factor, expected.observed, atol=3e-6)
    np.testing.assert_array_equal(run.samples, expected.samples)
    assert run.tumble is not None
    assert expected.tumble is not None
    np.testing.assert_allclose(run.tumble.step, expected.tumble.step, atol=2e-6)
    assert "guessed" in notes or write in (
        parquet,
        spreadsheet,
        euroc,
        flight_log,
        dataflash,
        ros2,
        mdf,
        betaflight_csv,
        vectornav,
    )


def test_counts_of_a_receiver_in_its_own_order(tmp_path: Path) -> None:
    (tmp_path / "log.txt").write_text(written.rawimu(COLUMNS, 1000.0, 50000.0))
    given = {"accel_scale": 1000.0, "accel_offset": 0.0, "gyro_scale": 50000.0, "gyro_offset": 0.0}
    run, _ = converted(tmp_path, tmp_path / "log.txt", **given)
    np.testing.assert_allclose(run.observed[0, :3], 1000 * ROWS[:900, 1:4].mean(0), atol=1.0)
    np.testing.assert_allclose(run.observed[0, 3:], 50000 * ROWS[:900, 4:].mean(0), atol=2.0)


def test_a_choice_of_topics_is_asked_for(tmp_path: Path, expected: Run) -> None:
    pytest.importorskip("pyulog")
    fields = [("uint64_t", "timestamp"), ("float[3]", "gyro_rad"), ("float[3]", "accelerometer_m_s2")]
    rows = np.c_[MICROSECONDS, ROWS[:, 4:], ROWS[:, 1:4]]
    (tmp_path / "log.ulg").write_bytes(written.ulog({"first": (fields, rows), "second": (fields, rows)}))
    with pytest.raises(InputError, match="2 topics hold channels") as refused:
        converted(tmp_path, tmp_path / "log.ulg")
    assert "--topic first" in refused.value.issues[0].remedy
    run, _ = converted(tmp_path, tmp_path / "log.ulg", topic=["second"])
    np.testing.assert_allclose(run.observed, expected.observed, atol=3e-6)


def test_what_cannot_be_read_lists_what_was_found(tmp_path: Path) -> None:
    np.savez(tmp_path / "log.npz", volts=np.arange(9.0), other=np.arange(9.0))
    with pytest.raises(InputError, match="no column has the name") as refused:
        converted(tmp_path, tmp_path / "log.npz")
    [issue] = refused.value.issues
    assert "volts, other" in issue.allowed
    assert "--column ax=NAME" in issue.remedy
    for name, content, text in (
        ("flight.bbl", b"H Product:Blackbox flight data recorder\nH \0\1", "blackbox_decode"),
        ("log.mf4", b"MDF     4.10    \0\0", "MDF file"),
        ("table.xlsx", b"PK\x03\x04\x14\0\x06\0[Content_Types].xml", "save the sheet as CSV"),
        ("picture", b"\x89PNG\r\n\x1a\n\0\0\0", "of no known kind"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=text):
            converted(tmp_path, tmp_path / name)


@pytest.mark.parametrize("write", [parquet, matlab, matlab73, tdms, mdf, named_arrays], ids=lambda w: w.__name__)
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # asammdf takes down a half-made reader
def test_a_damaged_file_is_refused(tmp_path: Path, write: Callable[[Path], Path]) -> None:
    if write in EXTRA:
        pytest.importorskip(EXTRA[write])
    file = write(tmp_path)
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    with pytest.raises(InputError) as refused:
        converted(tmp_path, file)
    assert all((refused.value.issues[0].what, refused.value.issues[0].where, refused.value.issues[0].remedy))


def test_a_damaged_bag_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    (tmp_path / "log.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(200))
    with pytest.raises(InputError, match="the ROS bag file cannot be read"):
        converted(tmp_path, tmp_path / "log.bag")
