"""A step within a long temperature ramp is found at its row, with size, time and temperature; without it nothing."""

from pathlib import Path

import numpy as np
import pytest

import imubayes
from imubayes.display.loop.diagnosis_sentences import sentence

SIZE, AT = 0.03, 1417.0  # m/s², s


def recording(file: Path, size: float) -> None:
    """Write a warm-up of an accelerometer triad at rest, 2 Hz, with a step of ax."""
    rng, time = np.random.default_rng(5), np.arange(5000) * 0.5
    temperature = 50 - 60 * np.exp(-time / 900) + rng.normal(0, 0.05, len(time))
    warm = np.stack([temperature - 20, (temperature - 20) ** 2])
    force = np.array([[0.002, 2e-5], [-0.003, -1e-5], [0.004, 3e-5]]) @ warm + np.array([[0.0], [0.0], [9.81]])
    force[0] += size * (time > AT)
    columns = [time, temperature, *(force + rng.normal(0, 0.01, force.shape))]
    np.savetxt(
        file, np.stack(columns, axis=1), delimiter=",", header="time_s,temperature_degC,ax,ay,az", comments="",
        fmt="%.6f",
    )  # fmt: skip


def diagnosed(folder: Path, size: float) -> imubayes.Diagnosis:
    recording(folder / "log.csv", size)
    made = imubayes.new(folder / "unit", [folder / "log.csv"], latitude_deg=48.0, accel_unit="m/s^2")
    imubayes.fit(made.folder, made.model, folder / "result", sample=False)
    return imubayes.diagnose(folder / "result")


def test_a_step_is_told_with_its_size_and_place(tmp_path):
    found = diagnosed(tmp_path, SIZE)
    assert found.verdict == "unexplained_structure"
    form = found.explanations.form
    assert form.channels == ("ax",)
    (size,), (time, temperature) = form.step.sizes, form.step.settings
    assert size.value == pytest.approx(SIZE, abs=4 * size.sd)
    assert size.sd < 0.1 * SIZE
    assert time.value == pytest.approx(AT, abs=20)  # a row
    assert temperature.value == pytest.approx(50 - 60 * np.exp(-AT / 900), abs=0.3)
    assert "The step is 0.0" in sentence(found)


@pytest.mark.slow
def test_without_a_step_none_is_told(tmp_path):
    assert diagnosed(tmp_path, 0.0).verdict == "adequate"
