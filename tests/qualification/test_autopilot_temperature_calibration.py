"""The temperature calibration of an autopilot: six biases cubic in temperature, from one warm-up at rest to parameters.

The recording is drawn by numpy alone; parameters are applied by the autopilots' own formulas.
"""

from pathlib import Path

import numpy as np
import pytest
from test_onboard_formats import ardupilot_corrected, px4_corrected, qgc

import imubayes
from imubayes.cli.main import run

# A fit of 36 parameters; what new proposes of such a recording is in tests/campaign.
pytestmark = pytest.mark.slow
GRAVITY = 9.80875
# Coefficients of 1, d, d² and d³, d = T − 25 °C; m/s² and deg/s.
TRUE = {
    "ax": (0.1, 2e-3, 3e-5, 6e-7), "ay": (-0.05, 1e-3, -2e-5, -4e-7), "az": (0.2, -3e-3, 4e-5, 9e-7),
    "gx": (0.3, 0.01, 2e-4, 4e-6), "gy": (-0.2, -0.006, 1e-4, -3e-6), "gz": (0.1, 0.002, -1e-4, 2e-6),
}  # fmt: skip
NOISE = {"a": 0.01, "g": 0.015}


@pytest.fixture(scope="module")
def unit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a recording, its campaign and model as `new` made them, and the fit."""
    folder, rng = tmp_path_factory.mktemp("warm-up"), np.random.default_rng(11)
    time = (np.arange(6000) + 0.5) / 2.5
    temperature = 50 - 60 * np.exp(-time / 600)
    powers = (temperature - 25)[:, None] ** np.arange(4)
    columns = [time, temperature]
    for name, true in TRUE.items():
        rest = GRAVITY if name == "az" else 0.0
        columns.append(rest + powers @ true + rng.normal(0, NOISE[name[0]], len(time)))
    header = ",".join(("time_s", "temperature_degC", *TRUE))
    np.savetxt(folder / "log.csv", np.stack(columns, axis=1), delimiter=",", header=header, comments="", fmt="%.8g")
    stated = ["--latitude-deg", "48", "--gravity-m-s2", str(GRAVITY), "--gyro-unit", "deg/s"]
    assert run(["new", str(folder / "unit"), str(folder / "log.csv"), *stated]) == 0
    campaign, model = str(folder / "unit"), str(folder / "unit" / "model.toml")
    assert run(["fit", campaign, "--model", model, "--no-sample", "--out", str(folder / "fit")]) == 0
    return folder


def test_every_term_is_found(unit: Path) -> None:
    result = imubayes.read_result(unit / "fit")
    found = {each.name: each for each in result.summary.parameters}
    pulls = []
    for name, true in TRUE.items():
        kind = "gyro" if name[0] == "g" else "accel"
        per = 3600.0 if kind == "gyro" else 1e6 / GRAVITY
        fields = (
            "_bias_temperature.slope",
            "_bias_temperature_quadratic.curvature",
            "_bias_temperature_cubic.coefficient",
        )
        for field, value in zip(fields, true[1:], strict=True):
            estimate = found[f"{kind}{field}[{name}]"]
            assert estimate.mean is not None
            assert estimate.sd is not None
            assert abs(estimate.mean) > 5 * estimate.sd
            pulls.append((estimate.mean - value * per) / estimate.sd)
    assert np.abs(pulls).max() < 3.5
    assert np.sqrt(np.mean(np.square(pulls))) < 1.6


def test_nothing_else_is_missing(unit: Path) -> None:
    assert imubayes.diagnose(unit / "fit").verdict == "adequate"


@pytest.mark.parametrize("target", ["px4", "ardupilot"])
def test_the_autopilot_corrects_the_drift_with_all_terms(unit: Path, tmp_path: Path, target: str) -> None:
    file = tmp_path / "unit.params"
    assert run(["export", str(unit / "fit"), "--format", target, "--out", str(file)]) == 0
    text = file.read_text()
    assert "Left out" not in text
    if target == "px4":
        parameters, corrected = qgc(text), px4_corrected
    else:
        rows = [line.split(",") for line in text.splitlines() if not line.startswith("#")]
        parameters, corrected = {name: float(value) for name, value in rows}, ardupilot_corrected
    for kind, names, factor in (("accelerometer", "ax ay az", 1.0), ("gyro", "gx gy gz", np.pi / 180)):
        left = []
        for warm in np.linspace(-8, 49, 12):
            bias = factor * np.array([np.polyval(TRUE[name][::-1], warm - 25) for name in names.split()])
            left.append(corrected(parameters, kind, bias, warm))
        drift = np.ptp(np.array(left), axis=0) / factor
        # The drift before is 0.1 to 0.4 m/s² and 0.2 to 1 deg/s.
        assert (drift < (0.005 if kind == "accelerometer" else 0.008)).all(), drift
