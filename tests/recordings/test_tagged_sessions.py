"""Files of one session whose lines are tagged or labelled; and a campaign with a mistake, written to be corrected."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

import imubayes
from imubayes.campaign.physical_checks import check_gravity
from imubayes.cli.main import run
from imubayes.foundations.campaign_data import Site
from imubayes.foundations.errors import InputError
from imubayes_recordings.convert import read_recordings

STEP, COUNT = 0.012, 1200  # s, lines


def turn(file: Path, axis: int, seed: int) -> Path:
    """Write lines `acc …` (g) and `gyro …` (deg/s) of one full turn about a vertical body axis, from rest to rest."""
    rng, rate = np.random.default_rng(seed), np.zeros((COUNT, 3))
    part = (np.arange(800) + 0.5) / 800
    rate[200:1000, axis] = 360 / (800 * STEP) * (1 - np.cos(2 * np.pi * part))
    rate += np.array([0.3, 1.2, -4.0]) + rng.normal(0, 0.05, rate.shape)
    force = np.eye(3)[axis] + rng.normal(0, 0.004, rate.shape)
    lines = []
    for place in range(COUNT):
        for tag, values in (("acc", force[place]), ("gyro", rate[place])):
            lines.append(" ".join([tag, str(2060 + 12 * place), *(f"{value:.6f}" for value in values)]))
    file.write_text("\n".join(lines) + "\n")
    return file


def test_each_of_several_tagged_files_is_a_run(tmp_path: Path) -> None:
    files = [turn(tmp_path / f"turn-{'xyz'[axis]}.txt", axis, axis) for axis in range(3)]
    read = read_recordings(files, turn_deg=360, latitude_deg=48, gyro_unit="deg/s")
    runs = {run["name"]: run for run in read.campaign.document["run"]}
    assert {"turns-x-1", "turns-y-2", "turns-z-3"} < set(runs)
    # Each rest lies on the face that its own accelerometers determine.
    assert [runs[f"recording-{k}"]["mounting"] for k in (1, 2, 3)] == ["x-up", "y-up", "z-up"]


@pytest.mark.slow
def test_biases_of_a_session_of_tagged_files_are_within_their_uncertainty(tmp_path: Path) -> None:
    files = [turn(tmp_path / f"turn-{'xyz'[axis]}.txt", axis, axis) for axis in range(3)]
    read = read_recordings(files, turn_deg=360, latitude_deg=48, gyro_unit="deg/s")
    read.write(tmp_path / "unit")
    fitted = imubayes.fit(tmp_path / "unit", imubayes.new(tmp_path / "unit").model, sample=False)
    for name, bias in (("gx", 0.3), ("gy", 1.2), ("gz", -4.0)):
        found = fitted[f"gyro_bias.bias[{name}]"]
        assert abs(found.mean / 3600 - bias) < 4 * found.sd / 3600


def test_matrices_of_one_session_are_stated_together(tmp_path: Path) -> None:
    """Three turns about three axes in one MATLAB file; which of them are runs, the file does not say."""
    matrices = {}
    for axis, name in enumerate(("turn_x", "turn_y", "turn_z")):
        lines = np.loadtxt(turn(tmp_path / "one.txt", axis, axis), usecols=(1, 2, 3, 4), dtype=float)
        matrices[name] = np.column_stack([lines[::2, 0] / 1000, lines[::2, 1:] * 9.81, np.radians(lines[1::2, 1:])])
    savemat(tmp_path / "session.mat", matrices)
    options: dict[str, Any] = {"turn_deg": 360, "latitude_deg": 48, "gyro_unit": "rad/s"}
    with pytest.raises(InputError, match="no column has the name"):
        read_recordings([tmp_path / "session.mat"], **options)
    read = read_recordings([tmp_path / "session.mat"], topic=list(matrices), **options)
    assert {"turns-x-1", "turns-y-2", "turns-z-3"} < {run["name"] for run in read.campaign.document["run"]}


@pytest.mark.parametrize("banner", [["Initializing I2C devices...", "MPU6050 connection successful"], []])
def test_banner_and_labels_of_a_serial_monitor(tmp_path: Path, banner: list[str]) -> None:
    rng, rows = np.random.default_rng(3), 600
    counts = np.array([250, -167, 8430, 38, -22, 15]) + rng.normal(0, [17, 17, 17, 6, 6, 6], (rows, 6))
    lines = [f"12:00:00.00{k} -> {words}" for k, words in enumerate(banner)]
    for place, values in enumerate(np.round(counts).astype(int)):
        clock = f"12:{place // 3000:02d}:{place // 50 % 60:02d}.{place % 50 * 20:03d}"
        lines.append(f"{clock} -> a/g:\t" + "\t".join(map(str, values)))
    (tmp_path / "log.txt").write_text("\n".join(lines) + "\n")
    read = read_recordings(
        [tmp_path / "log.txt"], accel_unit="count", gyro_unit="count", accel_scale=[835.2], gyro_scale=[3752.9],
        accel_offset=[0.0], gyro_offset=[0.0],
    )  # fmt: skip
    table = next(iter(read.campaign.tables.values()))
    np.testing.assert_array_equal(table["az"], np.round(counts[:, 2]))
    np.testing.assert_array_equal(table["gx"], np.round(counts[:, 3]))
    np.testing.assert_allclose(np.diff(table["time_s"]), 0.02, atol=1e-9)
    assert any(
        "column 2 holds the same word in every line: a label" in note for note in read.campaign.document["notes"]
    )


def test_gravity_and_the_rest_in_separate_columns_are_summed(tmp_path: Path) -> None:
    """As phones write them; alone, what is left without gravity is no reading of an accelerometer."""
    rng = np.random.default_rng(1)
    down = np.repeat(np.vstack([np.eye(3), -np.eye(3)]), 300, axis=0)
    total = down * [1.003, 0.998, 1.001] + [0.01, -0.02, 0.015] + rng.normal(0, 0.002, down.shape)
    gravity = total / np.linalg.norm(total, axis=1)[:, None]
    rows = np.c_[np.arange(len(total)) / 100, rng.normal(0, 0.002, total.shape), gravity, total - gravity]
    parts = [
        f"{what}{axis}" for what in ("motionRotationRate", "motionGravity", "motionUserAcceleration") for axis in "XYZ"
    ]
    units = ["rad/s"] * 3 + ["G"] * 6
    names = ["loggingTime(s)", *(f"{name}({unit})" for name, unit in zip(parts, units, strict=True))]
    file = tmp_path / "phone.csv"
    np.savetxt(file, rows, delimiter=",", header=",".join(names), comments="", fmt="%.7f")
    read = read_recordings([file], latitude_deg=48)
    table = next(iter(read.campaign.tables.values()))
    np.testing.assert_allclose(np.stack([table[name] for name in ("ax", "ay", "az")], axis=1), total, atol=1e-6)
    assert "'motionUserAccelerationX(G)' + column 5 'motionGravityX(G)'" in "".join(read.campaign.document["notes"])
    read.write(tmp_path / "unit")
    again = read_recordings([file], mapping=tmp_path / "unit" / "mapping.toml", latitude_deg=48)
    np.testing.assert_array_equal(next(iter(again.campaign.tables.values()))["ax"], table["ax"])
    np.savetxt(file, rows[:, [0, 7, 8, 9]] * [1, 9.8, 9.8, 9.8], delimiter=",", header="t,ax,ay,az", comments="")
    with pytest.raises(InputError) as caught:
        read_recordings([file], latitude_deg=48)
    assert "if gravity was subtracted" in caught.value.issues[0].remedy


def test_a_campaign_with_a_mistake_is_written_to_be_corrected(tmp_path: Path, capsys) -> None:
    """The rate of the table is ten times too large in one of two recordings."""
    rng, level = np.random.default_rng(3), np.repeat([0.0, 20, -20, 60, -60, 100, -100, 0.0], 500)
    time = np.arange(len(level)) / 100
    files = [tmp_path / "first.csv", tmp_path / "second.csv"]
    for file, factor in zip(files, (1.0, 10.0), strict=True):
        rates = np.c_[np.zeros_like(level), np.zeros_like(level), level] + rng.normal(0, 0.02, (len(level), 3))
        rows = np.c_[time, factor * level, rates]
        header = "time_s,table_rate_deg_s,gx,gy,gz"
        np.savetxt(file, rows, delimiter=",", header=header, comments="", fmt="%.6f")
    folder = tmp_path / "unit"
    words = ["new", str(folder), *map(str, files), "--latitude-deg", "48", "--gyro-unit", "deg/s"]
    assert run(words) == 2
    said = capsys.readouterr().err
    assert f"written to be corrected: {folder}" in said
    text = (folder / "campaign.toml").read_text()
    assert text.startswith("# This campaign is not accepted yet.")
    with pytest.raises(InputError) as caught:
        imubayes.load_campaign(folder)
    # The places at its head are those of the file with its head.
    assert f"#   where:   {caught.value.issues[0].where}" in text
    second = next(each for each in sorted((folder / "runs").iterdir()) if "2" in each.name)
    names, *lines = second.read_text().splitlines()
    place = names.split(",").index("table_rate_deg_s")
    cells = [line.split(",") for line in lines]
    mended = [",".join([*own[:place], str(float(own[place]) / 10), *own[place + 1 :]]) for own in cells]
    second.write_text("\n".join([names, *mended]) + "\n")
    assert run(["new", str(folder)]) == 0
    assert (folder / "model.toml").is_file()


@pytest.mark.parametrize(
    ("gravity", "latitude", "height", "said"),
    [(9.7803, 52.3, 60.0, True), (9.81286, 52.3, 60.0, False), (9.8126, 52.3, 2000.0, True), (9.80, 47.0, 0.0, False)],
)
def test_gravity_of_another_place_is_told(gravity: float, latitude: float, height: float, said: bool) -> None:
    found = check_gravity(Site(np.radians(latitude), height, gravity), "site.gravity_m_s2")
    assert [each.name for each in found] == ["gravity_improbable"] * said
