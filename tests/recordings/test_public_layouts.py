"""Layouts that programs of makers and phones write, re-made by own simulation: each gives the readings of the unit."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from tumble_recordings import random_attitudes

from imubayes.foundations.errors import InputError
from imubayes.foundations.units import to_si
from imubayes_recordings.convert import read_recordings
from imubayes_recordings.convert.formats.stated_rate import stated_rate

HZ = 100.0
FORCE, RATE = ("ax", "ay", "az"), ("gx", "gy", "gz")


@pytest.fixture(scope="module")
def turned() -> tuple[np.ndarray, np.ndarray]:
    """Specific force, m/s², and rates, rad/s, of a unit turned by hand, (N, 3) each."""
    columns = random_attitudes(3, 14).columns()
    return tuple(np.stack([columns[name] for name in names], axis=1) for names in (FORCE, RATE))


def table(file: Path, header: str, columns: Sequence, delimiter: str = ",", above: str = "") -> list[Path]:
    """Write columns, (N,) each, numbers or words."""
    cells = ([each if isinstance(each, str) else f"{each:.6f}" for each in row] for row in zip(*columns, strict=True))
    file.write_text("\n".join([*above.splitlines(), header, *map(delimiter.join, cells)]) + "\n")
    return [file]


def counted(count: int, step: float = 1) -> list[str]:
    return [str(round(step * place)) for place in range(count)]


def labelled_cells(folder: Path, force: np.ndarray, rate: np.ndarray) -> list[Path]:
    head = "s_A;time_A;x_A;y_A;z_A;s_R;time_R;x_R;y_R;z_R"
    times = counted(len(force), 10)
    return table(
        folder / "watch.csv", head, [["A"] * len(force), times, *force.T, ["R"] * len(force), times, *rate.T], ";"
    )


def wireless(folder: Path, force: np.ndarray, rate: np.ndarray) -> list[Path]:
    head = "PacketCounter,SampleTimeFine,Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z,"
    columns = [counted(len(force)), counted(len(force), 10_000), *force.T, *np.degrees(rate).T, [""] * len(force)]
    return table(folder / "dot.csv", head, columns, above="sep=,\nDeviceTag:,W03\nOutputRate:,100Hz\n")


def prefixed_with_axes(folder: Path, force: np.ndarray, rate: np.ndarray) -> list[Path]:
    head = "DATA_CNTR\tTIME_MS\tXGYRO_OUT\tYGYRO_OUT\tZGYRO_OUT\tXACCL_OUT\tYACCL_OUT\tZACCL_OUT"
    columns = [counted(len(force)), counted(len(force), 10), *np.degrees(rate).T, *force.T]
    return table(folder / "evaluation.txt", head, columns, "\t")


def beside_linear(folder: Path, force: np.ndarray, rate: np.ndarray) -> list[Path]:
    units = [
        f"{name}{axis} ({unit})" for name, unit in (("Acc", "g"), ("Gyro", "deg/s"), ("LinAcc", "g")) for axis in "XYZ"
    ]
    columns = [np.arange(len(force)) / HZ, *(force / 9.80665).T, *np.degrees(rate).T, *np.zeros((3, len(force)))]
    return table(folder / "fusion.csv", ", ".join(["TimeStamp (s)", *units]), columns, ", ")


def nested_json(folder: Path, force: np.ndarray, rate: np.ndarray) -> list[Path]:
    named = [[dict(zip("xyz", map(float, row), strict=True)) for row in values] for values in (force, rate)]
    lines = [json.dumps({"t": 10 * k, "accel": a, "gyro": g}) for k, (a, g) in enumerate(zip(*named, strict=True))]
    (folder / "log.jsonl").write_text("\n".join(lines) + "\n")
    return [folder / "log.jsonl"]


def in_paths(folder: Path, force: np.ndarray, rate: np.ndarray) -> list[Path]:
    names = [f"{kind}/Raw.{axis}" for kind in ("Accelerometer", "Gyroscope") for axis in "xyz"]
    columns = [counted(len(force)), np.arange(len(force)) / HZ, *(force / 9.80665).T, *np.degrees(rate).T]
    above = "#Format/Version,CSV1.0.7\n#Imu/Version{},firmware,3.017,accelerometer,251"
    return table(folder / "mask.csv", ",".join(["Frame#", "Time", *names]), columns, above=above)


def one_file_a_sensor(folder: Path, force: np.ndarray, rate: np.ndarray) -> list[Path]:
    files = []
    for kind, unit, values in (("Accelerometer", "g", force / 9.80665), ("Gyroscope", "deg/s", np.degrees(rate))):
        head = ",".join(["epoch (ms)", "elapsed (s)", *(f"{axis}-axis ({unit})" for axis in "xyz")])
        columns = [counted(len(values), 10), np.arange(len(values)) / HZ, *values.T]
        files += table(folder / f"Unit_F1_{kind}_100.000Hz.csv", head, columns)
    return files


def spreadsheet(folder: Path, force: np.ndarray, rate: np.ndarray) -> list[Path]:
    head = "timestamp,seq_num,acc_x_mps2,acc_y_mps2,acc_z_mps2,gyr_x_deg,gyr_y_deg,gyr_z_deg,global_seq"
    stamps = [f"{1570338716 + place / HZ:.3f}" for place in range(len(force))]
    return table(
        folder / "bike.csv", head, [stamps, counted(len(force)), *force.T, *np.degrees(rate).T, counted(len(force))]
    )


def robot(folder: Path, force: np.ndarray, rate: np.ndarray) -> list[Path]:
    parts = [f"field.{name}.{axis}" for name in ("angular_velocity", "linear_acceleration") for axis in "xyz"]
    stamps = [str(1_600_000_000_000_000_000 + 10_000_000 * place) for place in range(len(force))]
    words = [stamps, counted(len(force)), ["imu"] * len(force), *rate.T, *force.T]
    return table(folder / "bag.csv", ",".join(["%time", "field.header.seq", "field.header.frame_id", *parts]), words)


LAYOUTS = (
    labelled_cells, wireless, prefixed_with_axes, beside_linear, nested_json, in_paths, one_file_a_sensor, spreadsheet,
    robot,
)  # fmt: skip


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.__name__)
def test_a_layout_gives_the_readings(tmp_path: Path, turned: tuple[np.ndarray, np.ndarray], layout: Callable) -> None:
    read = read_recordings(layout(tmp_path, *turned), latitude_deg=48)
    columns = next(iter(read.campaign.tables.values()))
    entries = {entry["name"]: entry for entry in read.campaign.document["channel"]}
    for names, values in zip((FORCE, RATE), turned, strict=True):
        for name, truth in zip(names, values.T, strict=True):
            entry = entries[name]
            found = np.asarray(columns[name]) / entry["scale"] * to_si(entry["per"])
            np.testing.assert_allclose(found, truth, atol=2e-3)


def test_a_magnetometer_before_the_accelerometers_is_no_gyro(tmp_path: Path, turned) -> None:
    """Twelve numbers without names, as of a serial sentence: three of a magnetometer come first."""
    force, rate = turned
    field = np.tile([0.2, -0.1, 0.45], (len(force), 1))
    rows = np.column_stack([field, force, rate, np.full(len(force), 25.3), np.full(len(force), 101.3)])
    lines = ["$VNIMU," + ",".join(f"{value:+010.5f}" for value in row) for row in rows]
    (tmp_path / "sentences.txt").write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match="the numbers do not show which are which") as caught:
        read_recordings([tmp_path / "sentences.txt"], latitude_deg=48, sample_rate_hz=HZ)
    assert "--column ax=5 --column ay=6" in caught.value.issues[0].remedy


def shaker(folder: Path, force: np.ndarray, rate: np.ndarray) -> list[Path]:
    above = (
        "# Own Data\n# Num. samples: 9, Duration: 9.0 s\n# Config: data_rate = 100.0 Hz, filter = 42 Hz, range = 4 g\n"
    )
    columns = [[str(place + 1) for place in range(len(force))], *(force / 9.80665).T, *np.degrees(rate).T]
    return table(folder / "shaker.csv", "count,a_x,a_y,a_z,g_x,g_y,g_z", columns, above=above)


def card_logger(folder: Path, force: np.ndarray, rate: np.ndarray) -> list[Path]:
    clock = [f"12:{place // 6000:02d}:{place % 6000 / HZ:05.2f}" for place in range(len(force))]
    warm = [f"{24.8 + 0.01 * (place % 7):.2f}" for place in range(len(force))]
    columns = [["06/29/2020"] * len(force), clock, *(force / 9.80665e-3).T, *np.degrees(rate).T, warm]
    return table(folder / "dataLog.TXT", "rtcDate,rtcTime,aX,aY,aZ,gX,gY,gZ,imu_degC,", [*columns, [""] * len(force)])


def factory_logger(folder: Path, force: np.ndarray, rate: np.ndarray) -> list[Path]:
    head = "Sample No.,time[s],Gx[dps],Gy[dps],Gz[dps],Ax[mG],Ay[mG],Az[mG],Ts[deg.C],Check"
    warm = [f"{26.1 + 0.01 * (place % 5):.2f}" for place in range(len(force))]
    columns = [counted(len(force)), np.arange(len(force)) / HZ, *np.degrees(rate).T, *(force / 9.80665e-3).T, warm]
    return table(folder / "LOG_IMU1.csv", head, [*columns, ["OK"] * len(force)], above="#Port,COM4,Sampling,10.00 ms\n")


def satellite_logger(folder: Path, force: np.ndarray, rate: np.ndarray) -> list[Path]:
    lines = ["# ", "# Header Description:", "# ", "# Raw,utcTimeMillis,TimeNanos"]
    for kind, unit, bias in (("Accel", "Mps2", "Bias"), ("Gyro", "RadPerSec", "Drift")):
        names = [f"{part}{axis}{unit}" for part in (f"Uncal{kind}", bias) for axis in "XYZ"]
        lines.append(f"# Uncal{kind},utcTimeMillis,elapsedRealtimeNanos,{','.join(names)}")
    for place, (forces, rates) in enumerate(zip(force, rate, strict=True)):
        times = f"{1_600_000_000_000 + 10 * place},{5_000_000_000 + 10_000_000 * place}"
        for kind, values in (("Accel", forces), ("Gyro", rates)):
            lines.append(f"Uncal{kind},{times},{','.join(f'{value:.6f}' for value in values)},0.0,0.001,0.0")
        lines += ["Fix,gps,48.1,11.5,500.0,0.0,3.9,16000"] if place % 100 == 0 else []
    (folder / "satellites.txt").write_text("\n".join(lines) + "\n")
    return [folder / "satellites.txt"]


@pytest.mark.parametrize(
    "layout", [shaker, card_logger, factory_logger, satellite_logger], ids=lambda each: each.__name__
)
def test_a_layout_found_later_gives_the_readings(tmp_path: Path, turned, layout: Callable) -> None:
    options = {"accel_unit": "mg"} if layout is card_logger else {}  # asked for: cm/s² and counts are near
    read = read_recordings(layout(tmp_path, *turned), latitude_deg=48, **options)
    columns = next(iter(read.campaign.tables.values()))
    entries = {entry["name"]: entry for entry in read.campaign.document["channel"]}
    for names, values in zip((FORCE, RATE), turned, strict=True):
        for name, truth in zip(names, values.T, strict=True):
            found = np.asarray(columns[name]) / entries[name]["scale"] * to_si(entries[name]["per"])
            np.testing.assert_allclose(found, truth, atol=2e-3)
    np.testing.assert_allclose(np.diff(columns["time_s"]), 1 / HZ, atol=2e-6)
    assert ("temperature_degC" in columns) == (layout in (card_logger, factory_logger))


def test_a_stated_rate_is_the_only_one_in_hertz() -> None:
    def stated(line: str) -> float | None:
        found = stated_rate([(1, line)])
        return found and found.hz

    assert stated("# Config: data_rate = 2000.0 Hz, filter = 488 Hz") == 2000.0
    assert stated("OutputRate:,100Hz") == 100.0
    assert stated('"sample_rate_hz": 52') == 52.0
    assert stated("# Sampling frequency: 1.6 kHz") == 1600.0
    assert stated("# sample rate of the accelerometer unknown, 4 g") is None
    assert stated("# accel sample rate 100 Hz, gyro sample rate 200 Hz") is None
    assert stated("# baud rate 115200, data rate 3") is None


def test_one_column_is_not_two_channels(tmp_path: Path, turned) -> None:
    np.savetxt(tmp_path / "log.txt", np.column_stack(turned))
    numbers = {f"{kind}{axis}": 1 + k for kind in "ag" for k, axis in enumerate("xyz")}
    with pytest.raises(InputError, match="column 1 '' would be ax and gx"):
        read_recordings([tmp_path / "log.txt"], latitude_deg=48, sample_rate_hz=HZ, columns=numbers)


def test_gyros_that_cannot_be_chosen_are_not_left_out_in_silence(tmp_path: Path, turned) -> None:
    force, rate = turned
    lines = ["# acc,ms,acc_x,acc_y,acc_z", "# gyro,ms,left_gyro_x,left_gyro_y,left_gyro_z,gyro_x,gyro_y,gyro_z"]
    for place, (forces, rates) in enumerate(zip(force[:600], rate[:600], strict=True)):
        lines.append(f"acc,{10 * place}," + ",".join(f"{value:.5f}" for value in forces))
        lines.append(f"gyro,{10 * place}," + ",".join(f"{value:.5f}" for value in (*rates, *(0.9 * rates))))
    (tmp_path / "log.txt").write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match="2 sets of columns may be gx gy gz"):
        read_recordings([tmp_path / "log.txt"], latitude_deg=48)
