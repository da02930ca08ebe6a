"""Constants in the formats of other programs: each file is read back and applied by that program's own formula.

The formulas are written down here from the sources of PX4, ArduPilot and kalibr, in NumPy; the C header is compiled.
The corrected outputs must equal the inputs: the outputs are made in the test, from the physics alone.
"""

import itertools
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
import yaml

from imubayes.foundations.errors import InputError
from imubayes.foundations.units import BIAS_CONVENTION
from imubayes_qualification.display.onboard.formats import ExportOptions, losses_of, write_constants
from imubayes_qualification.display.onboard.kalibr import kalibr_yaml
from imubayes_qualification.onboard.constants import body_inputs
from imubayes_qualification.onboard.losses import NoiseDensity
from imubayes_qualification.onboard.record import (
    CONVENTIONS,
    Constant,
    OnboardConstants,
    ThermalPolynomial,
    ThermalPowers,
    TriadConstants,
    UnexpressedEffect,
    WorkedSample,
)

SKEW = np.array([[0.99, 0.012, -0.02], [0.004, 1.013, 0.009], [-0.003, 0.006, 0.985]])
STRAIGHT = np.diag([0.99, 1.013, 0.985])
SENSITIVITY = np.array([[3e-5, -1e-5, 2e-5], [1e-5, 2e-5, -4e-5], [0.0, 1e-5, 3e-5]])
RANGES = {"temperature": (-20.0, 60.0), "converter_temperature": (-10.0, 70.0)}
SAMPLE = WorkedSample(
    temperature_degC=25.0, converter_temperature_degC=25.0, channels=(), outputs=(), nominal=(), unbiased=(),
    unscaled=(), rate_rad_s=None, force_m_s2=None,
)  # fmt: skip


def thermal(order: int, converter: bool, size: float, constant: bool, seed: int) -> ThermalPolynomial:
    rng = np.random.default_rng(seed)
    terms = [(i, 0) for i in range(0 if constant else 1, order + 1)] + ([(0, 1), (1, 1)] if converter else [])
    rows = [tuple(float(size * rng.normal() / 40.0 ** (i + j)) for i, j in terms) for _ in range(3)]
    powers = tuple(ThermalPowers(sensor=i, converter=j) for i, j in terms)
    return ThermalPolynomial(terms=powers, coefficients=tuple(rows))


def triad(
    kind: Literal["gyro", "accelerometer"], matrix: np.ndarray, bias: ThermalPolynomial, gain: ThermalPolynomial, a=None
) -> TriadConstants:
    letter = kind[0]
    return TriadConstants(
        kind=kind, unit="rad/s" if kind == "gyro" else "m/s^2", channels=tuple(f"{letter}{axis}" for axis in "xyz"),
        output_units=("pulse/s",) * 3, nominal_scale=(200.0, -210.0, 190.0), nominal_offset=(3.0, 0.0, -8.0),
        matrix=tuple(map(tuple, matrix.tolist())), bias=bias, gain=gain,
        g_sensitivity=None if a is None else tuple(map(tuple, a.tolist())), input_range=20.0, error_left=0.0,
        sample_noise=(0.01, 0.02, 0.03), run_offset=(0.001, 0.0, 0.002),
    )  # fmt: skip


def unit(*triads: TriadConstants, sd: float = 1e-7, effects: tuple[UnexpressedEffect, ...] = ()) -> OnboardConstants:
    """A record of these constants, every one with the same independent uncertainty."""
    named: list[tuple[str, float, str]] = []
    for one in triads:
        named += [
            (f"M[{axis},{name}]", one.matrix[k][i], "1")
            for k, axis in enumerate("xyz") for i, name in enumerate(one.channels)
        ]  # fmt: skip
        for word, found in (("bias", one.bias), ("gain", one.gain)):
            for name, row in zip(one.channels, found.coefficients, strict=True):
                for term, value in zip(found.terms, row, strict=True):
                    power = f",{term.sensor},{term.converter}" if term.sensor or term.converter else ""
                    named.append((f"{word}[{name}{power}]", value, one.unit))
        if one.g_sensitivity is not None:
            named += [(f"A[{r},{c}]", one.g_sensitivity[i][j], "")
                      for i, r in enumerate("xyz") for j, c in enumerate("xyz")]  # fmt: skip
    constants = tuple(
        Constant(name=name, unit=word, value=value, sd=sd, q025=value, q975=value, from_data=1.0)
        for name, value, word in named
    )
    return OnboardConstants(
        serial="T1", campaign="test", model="test", version="0", data_sha256="d" * 64, model_sha256="m" * 64,
        gravity_m_s2=9.8, reference_degC=25.0, needs=("temperature",), ranges_degC=RANGES, interval="95 %",
        posterior="laplace", intervals_valid=True, triads=triads, constants=constants,
        covariance=tuple(map(tuple, (sd**2 * np.eye(len(constants))).tolist())), not_determined=(), weak_directions=(),
        unexpressed=effects, slow_noise=(), conventions=(), worked_sample=SAMPLE,
    )  # fmt: skip


NONE = ThermalPolynomial(terms=(), coefficients=((), (), ()))
WHOLE = unit(
    triad("accelerometer", SKEW, thermal(3, True, 0.2, True, 1), thermal(2, True, 0.01, False, 2)),
    triad("gyro", SKEW.T, thermal(2, True, 0.02, True, 3), thermal(1, True, 0.01, False, 4), SENSITIVITY),
)
PLAIN = unit(
    triad("accelerometer", STRAIGHT, thermal(3, False, 0.2, True, 5), NONE),
    triad("gyro", np.eye(3), thermal(3, False, 0.02, True, 6), NONE),
)


def at(found: ThermalPolynomial, warm: float, converter: float) -> np.ndarray:
    powers = [(warm - 25) ** term.sensor * (converter - 25) ** term.converter for term in found.terms]
    return np.array([sum(c * p for c, p in zip(row, powers, strict=True)) for row in found.coefficients])


def readings(one: TriadConstants, true: np.ndarray, force: np.ndarray, warm: float, converter: float) -> np.ndarray:
    """r of a unit that experiences `true`: M⁻¹ (u + A f) κ(T) + b(T)."""
    sensed = true + (np.array(one.g_sensitivity) @ force if one.g_sensitivity is not None else 0.0)
    return np.linalg.inv(np.array(one.matrix)) @ sensed * (1 + at(one.gain, warm, converter)) + at(
        one.bias, warm, converter
    )


def samples(count: int = 20):
    rng = np.random.default_rng(9)
    for _ in range(count):
        yield 10 * rng.normal(size=3), 2 * rng.normal(size=3), rng.uniform(-20, 60), rng.uniform(-10, 70)


def by_c(folder: Path, constants: OnboardConstants, outputs: Sequence[Sequence[float]], real: str) -> np.ndarray:
    """Return force and rate, shape (R, 6), by the header compiled; rows are outputs and the two temperatures."""
    assert not write_constants(constants, "c", folder / "constants.h", ExportOptions())
    lines = [" ".join(f"{value:.17g}" for value in row) for row in outputs]
    (folder / "main.c").write_text(
        f"""#define IMU_REAL {real}
#include <stdio.h>
#include "constants.h"
int main(void) {{
    double in[8]; imu_real a[3], g[3], f[3], w[3]; int k;
    while (scanf("%lf %lf %lf %lf %lf %lf %lf %lf", in, in+1, in+2, in+3, in+4, in+5, in+6, in+7) == 8) {{
        for (k = 0; k < 3; k++) {{ a[k] = (imu_real)in[k]; g[k] = (imu_real)in[3 + k]; }}
        imu_force(a, (imu_real)in[6], (imu_real)in[7], f);
        imu_rate(g, f, (imu_real)in[6], (imu_real)in[7], w);
        for (k = 0; k < 3; k++) printf("%.17g ", (double)f[k]);
        for (k = 0; k < 3; k++) printf("%.17g ", (double)w[k]);
        printf("\\n");
    }}
    return 0;
}}
"""
    )
    gcc = shutil.which("gcc")
    assert gcc is not None
    program = str(folder / "apply")
    strict = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-Wno-float-conversion"]
    subprocess.run([gcc, *strict, str(folder / "main.c"), "-o", program], check=True)
    said = subprocess.run([program], input="\n".join(lines), capture_output=True, text=True, check=True).stdout
    return np.array([line.split() for line in said.splitlines()], dtype=float)


@pytest.mark.parametrize(("constants", "real", "close"), [(WHOLE, "double", 1e-9), (WHOLE, "float", 1e-4)])
def test_the_c_header_compiled_gives_the_truth(tmp_path, constants, real, close):
    outputs, truth = [], []
    for force, rate, warm, converter in samples():
        row = []
        for one, vector in zip(constants.triads, (force, rate), strict=True):
            r = readings(one, vector, force, warm, converter)
            row += (r * np.array(one.nominal_scale) + np.array(one.nominal_offset)).tolist()
        outputs.append([*row, warm, converter])
        truth.append([*force, *rate])
    np.testing.assert_allclose(by_c(tmp_path, constants, outputs, real), truth, rtol=0, atol=close * 10)


def qgc(text: str) -> dict[str, float]:
    rows = [line.split("\t") for line in text.splitlines() if not line.startswith("#")]
    assert all(len(row) == 5 for row in rows)
    return {row[2]: float(row[3]) for row in rows}


def px4_corrected(p: dict[str, float], kind: str, r: np.ndarray, warm: float) -> np.ndarray:
    """As Accelerometer.hpp, Gyroscope.hpp and TemperatureCompensation.cpp have it."""
    sensor, letter = ("ACC0", "A") if kind == "accelerometer" else ("GYRO0", "G")
    thermal_offset = np.zeros(3)
    if p.get(f"TC_{letter}_ENABLE"):
        kept = min(max(warm, p[f"TC_{letter}0_TMIN"]), p[f"TC_{letter}0_TMAX"])
        d = kept - p[f"TC_{letter}0_TREF"]
        thermal_offset = np.array([sum(p[f"TC_{letter}0_X{n}_{k}"] * d**n for n in range(4)) for k in range(3)])
    offset = np.array([p[f"CAL_{sensor}_{axis}OFF"] for axis in "XYZ"])
    scale = np.array([p[f"CAL_ACC0_{axis}SCALE"] for axis in "XYZ"]) if kind == "accelerometer" else np.ones(3)
    return (r - thermal_offset - offset) * scale


def ardupilot_corrected(p: dict[str, float], kind: str, r: np.ndarray, warm: float) -> np.ndarray:
    """As AP_InertialSensor_Backend.cpp and AP_InertialSensor_tempcal.cpp have it."""
    sensor = "ACC" if kind == "accelerometer" else "GYR"

    def polynomial(d: float) -> np.ndarray:
        c = [np.array([p[f"INS_TCAL1_{sensor}{n}_{axis}"] for axis in "XYZ"]) for n in (1, 2, 3)]
        return (c[0] + (c[1] + c[2] * d) * d) * d * 1e-6

    if p.get("INS_TCAL1_ENABLE") == 1:
        low, high = p["INS_TCAL1_TMIN"], p["INS_TCAL1_TMAX"]
        r = r - polynomial(min(max(warm, low), high) - 35)
        r = r + polynomial(min(max(p[f"INS_{sensor}1_CALTEMP"], low), high) - 35)
    r = r - np.array([p[f"INS_{sensor}OFFS_{axis}"] for axis in "XYZ"])
    return r * np.array([p[f"INS_ACCSCAL_{axis}"] for axis in "XYZ"]) if kind == "accelerometer" else r


@pytest.mark.parametrize("target", ["px4", "ardupilot"])
def test_autopilots_correct_by_their_own_formulas(tmp_path, target):
    assert not write_constants(PLAIN, target, tmp_path / "unit.params", ExportOptions())
    text = (tmp_path / "unit.params").read_text()
    if target == "px4":
        parameters, corrected = qgc(text), px4_corrected
    else:
        rows = [line.split(",") for line in text.splitlines() if not line.startswith("#")]
        parameters, corrected = {name: float(value) for name, value in rows}, ardupilot_corrected
    assert all(len(name) <= 16 for name in parameters)
    # The program's own calibration would overwrite the offsets at the next start.
    own = {"px4": ("IMU_GYRO_CAL_EN", "SENS_IMU_AUTOCAL"), "ardupilot": ("INS_GYR_CAL",)}[target]
    assert [parameters[name] for name in own] == [0.0] * len(own)
    ids = {"px4": ("CAL_ACC0_ID", "CAL_GYRO0_ID"), "ardupilot": ("INS_ACC_ID", "INS_GYR_ID")}[target]
    assert all(name in text for name in ids)
    for force, rate, warm, converter in samples():
        for one, true in zip(PLAIN.triads, (force, rate), strict=True):
            r = readings(one, true, force, warm, converter)
            np.testing.assert_allclose(corrected(parameters, one.kind, r, warm), true, rtol=0, atol=1e-6)
            # Fault planted: the sign of the temperature.
            assert np.abs(corrected(parameters, one.kind, r, 50 - warm) - true).max() > 1e-6 or abs(warm - 25) < 1


@pytest.mark.parametrize("target", ["px4", "ardupilot"])
def test_what_an_autopilot_cannot_hold_is_refused_with_its_size(tmp_path, target):
    with pytest.raises(InputError) as refused:
        write_constants(WHOLE, target, tmp_path / "unit.params", ExportOptions())
    said = str(refused.value)
    for part in ("misalignment of the accelerometers", "scale factor errors of the gyros", "g-sensitivity",
                 "temperature dependence of the gyros' gain", "converter's temperature", "rad/s"):  # fmt: skip
        assert part in said
    assert not (tmp_path / "unit.params").exists()
    accepted = write_constants(WHOLE, target, tmp_path / "unit.params", ExportOptions(accept_loss=True))
    text = (tmp_path / "unit.params").read_text()
    assert len(accepted) == text.count("Left out:") == 8
    # The misalignment of the worst axis at 20 m/s².
    worst = max(np.linalg.norm(np.delete(SKEW[k], k)) for k in range(3)) * 20.0
    assert next(loss for loss in accepted if loss.kind == "misalignment").size == pytest.approx(worst, rel=1e-6)


def test_what_is_within_its_uncertainty_may_be_lost():
    vague = unit(triad("accelerometer", SKEW, thermal(1, False, 0.2, True, 5), NONE), sd=0.05)
    lost = losses_of(vague, "px4")
    assert [(loss.kind, loss.significant) for loss in lost] == [("misalignment", False)]
    sharp = unit(triad("accelerometer", SKEW, thermal(1, False, 0.2, True, 5), NONE), sd=0.001)
    assert losses_of(sharp, "px4")[0].significant
    quadratic = UnexpressedEffect(
        effect="accel_quadratic", channels=("ax",), kind="accelerometer", formula="", cause="nonlinear", size=0.01,
        sd=0.001, parameters=(),
    )  # fmt: skip
    with_effect = unit(*PLAIN.triads, effects=(quadratic,))
    assert [(loss.kind, loss.significant) for loss in losses_of(with_effect, "c")] == [("effect", True)]
    fourth = unit(triad("gyro", np.eye(3), thermal(4, False, 0.02, True, 7), NONE))
    assert [loss.kind for loss in losses_of(fourth, "ardupilot")] == ["bias_order"]


def test_axes_that_are_not_those_of_the_body_are_refused(tmp_path):
    turned = unit(triad("accelerometer", SKEW[[1, 2, 0]], thermal(1, False, 0.2, True, 5), NONE))
    with pytest.raises(InputError, match="do not lie along the body axes"):
        write_constants(turned, "px4", tmp_path / "x", ExportOptions(accept_loss=True))


def test_kalibr_reads_what_it_would_have_estimated(tmp_path):
    still = unit(*(one.model_copy(update={"gain": NONE}) for one in WHOLE.triads))
    noise = {"gyro": NoiseDensity(1e-4, 1e-6), "accelerometer": NoiseDensity(1e-3, 1e-5, True)}
    write_constants(still, "kalibr", tmp_path / "imu.yaml", ExportOptions(200.0, "/imu7", noise))
    found = yaml.safe_load((tmp_path / "imu.yaml").read_text())
    assert (found["rostopic"], found["update_rate"], found["gyroscope_noise_density"]) == ("/imu7", 200.0, 1e-4)
    assert (found["accelerometer_random_walk"], found["model"]) == (1e-5, "scale-misalignment")
    m_a, m_g = np.array(found["accelerometers"]["M"]), np.array(found["gyroscopes"]["M"])
    a, c = np.array(found["gyroscopes"]["A"]), np.array(found["gyroscopes"]["C_gyro_i"])
    to_imu = np.array(found["C_i_body"])
    assert max(np.abs(np.triu(each, 1)).max() for each in (m_a, m_g)) < 1e-12
    for rotation in (c, to_imu):
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1.0)
    for force, rate, _, _ in samples():
        f, w = to_imu @ force, to_imu @ rate
        r_a = readings(still.triads[0], force, force, 25.0, 25.0)
        r_g = readings(still.triads[1], rate, force, 25.0, 25.0)
        # IccScaledMisalignedImu: a = M (C_i_b a_b) + b, w = M (C_gyro_b w_b) + A (C_gyro_b a_b) + b.
        np.testing.assert_allclose(m_a @ f + at(still.triads[0].bias, 25.0, 25.0), r_a, atol=1e-9)
        np.testing.assert_allclose(m_g @ c @ w + a @ c @ f + at(still.triads[1].bias, 25.0, 25.0), r_g, atol=1e-9)
    with pytest.raises(InputError, match="random walk of the gyros is not known"):
        kalibr_yaml(still, {**noise, "gyro": NoiseDensity(1e-4, None)}, 200.0, "/imu0")
    with pytest.raises(InputError, match="sampling rate"):
        write_constants(still, "kalibr", tmp_path / "x", ExportOptions(noise=noise))


def test_ros_covariances_are_those_of_corrected_samples(tmp_path):
    write_constants(WHOLE, "ros", tmp_path / "ros.yaml", ExportOptions())
    found = yaml.safe_load((tmp_path / "ros.yaml").read_text())
    assert found["orientation_covariance"][0] == -1
    rng = np.random.default_rng(4)
    noise = rng.normal(size=(200_000, 3)) * np.array([0.01, 0.02, 0.03]) @ SKEW.T
    stated = np.array(found["linear_acceleration_covariance"]).reshape(3, 3)
    np.testing.assert_allclose(np.cov(noise, rowvar=False), stated, atol=2e-5 * 0.3, rtol=0.03)
    shared = np.array(found["angular_velocity_systematic_covariance"]).reshape(3, 3)
    own = SKEW.T @ np.diag(1e-14 + np.array([0.001, 0.0, 0.002]) ** 2) @ SKEW
    np.testing.assert_allclose(shared, own, rtol=1e-6, atol=1e-15)


def test_the_record_is_read_back_as_it_was(tmp_path):
    write_constants(WHOLE, "json", tmp_path / "constants.json", ExportOptions())
    assert OnboardConstants.model_validate_json((tmp_path / "constants.json").read_text()) == WHOLE
    assert list(itertools.chain.from_iterable(WHOLE.covariance)).count(1e-7**2) == len(WHOLE.constants)


# A MEMS unit: scale factor errors of a few per cent, and biases, referred to the input.
SCALE, BIAS = {"accelerometer": (0.03, -0.04, 0.025), "gyro": (-0.02, 0.035, 0.05)}, {
    "accelerometer": (0.4, -0.3, 0.2), "gyro": (0.02, -0.05, 0.03),
}  # fmt: skip


def by_the_model(kind: str, axes: np.ndarray, true: np.ndarray) -> np.ndarray:
    """r of a unit that experiences `true`: (1 + scale factor error) (input + bias)."""
    return (1 + np.array(SCALE[kind])) * (axes @ true + np.array(BIAS[kind]))


def mems(axes: np.ndarray, gyro_scale: bool = True, output_referred: bool = True) -> OnboardConstants:
    """Its constants: M undoes scale factors and axes, b is the bias referred to the output."""
    triads = []
    for kind in ("accelerometer", "gyro"):
        gain = 1 + np.array(SCALE[kind]) * (gyro_scale or kind != "gyro")
        b = np.array(BIAS[kind]) * (gain if output_referred else 1.0)
        constant = ThermalPolynomial(terms=(ThermalPowers(sensor=0, converter=0),), coefficients=tuple((x,) for x in b))
        triads.append(triad(kind, np.linalg.inv(np.diag(gain) @ axes), constant, NONE))
    return unit(*triads)


AXES = np.eye(3) + np.array([[0, 0.004, -0.003], [0.005, 0, 0.002], [-0.006, 0.001, 0]])


@pytest.mark.parametrize("output_referred", [True, False])
def test_a_bias_is_referred_to_the_input_by_the_model_and_to_the_output_by_every_export(tmp_path, output_referred):
    """Corrected output is true input with scale factor errors of a few per cent; b = bias would be 30 mg off."""
    skewed, straight = mems(AXES, output_referred=output_referred), mems(np.eye(3), False, output_referred)
    noise = {"gyro": NoiseDensity(1e-4, 1e-6), "accelerometer": NoiseDensity(1e-3, 1e-5)}
    write_constants(skewed, "kalibr", tmp_path / "kalibr", ExportOptions(200.0, "/imu0", noise))
    for target in ("px4", "ardupilot"):
        write_constants(straight, target, tmp_path / target, ExportOptions(accept_loss=True))
    rows = [line.split(",") for line in (tmp_path / "ardupilot").read_text().splitlines() if not line.startswith("#")]
    ardupilot, px4 = {name: float(value) for name, value in rows}, qgc((tmp_path / "px4").read_text())
    kalibr = yaml.safe_load((tmp_path / "kalibr").read_text())
    inside = np.array(kalibr["accelerometers"]["M"]) @ np.array(kalibr["C_i_body"])
    offset = np.array(skewed.triads[0].bias.coefficients)[:, 0]
    outputs, truth, errors = [], [], []
    for force, rate, *_ in samples():
        r = {k: by_the_model(k, AXES, u) for k, u in (("accelerometer", force), ("gyro", rate))}
        raw = [r[one.kind] * one.nominal_scale + one.nominal_offset for one in skewed.triads]
        named = {n: v[None] for one, each in zip(skewed.triads, raw, strict=True)
                 for n, v in zip(one.channels, each, strict=True)}  # fmt: skip
        found = body_inputs({one.kind: one for one in skewed.triads}, named, np.full((1, 2), 25.0), 25.0)
        errors += [found["accelerometer"][0] - force, found["gyro"][0] - rate]
        errors.append(np.linalg.solve(inside, r["accelerometer"] - offset) - force)
        along = by_the_model("accelerometer", np.eye(3), force)
        errors.append(px4_corrected(px4, "accelerometer", along, 25.0) - force)
        errors.append(ardupilot_corrected(ardupilot, "accelerometer", along, 25.0) - force)
        outputs.append([*raw[0], *raw[1], 25.0, 25.0])
        truth.append([*force, *rate])
    errors += list((by_c(tmp_path, skewed, outputs, "double") - truth).reshape(-1, 3))
    wrong = np.abs(errors).max(axis=1) > 1e-6
    assert not wrong.any() if output_referred else wrong.all()


@pytest.mark.parametrize("target", ["c", "kalibr", "px4", "ardupilot", "ros"])
def test_every_export_states_what_a_bias_is_referred_to(tmp_path, target):
    noise = {"gyro": NoiseDensity(1e-4, 1e-6), "accelerometer": NoiseDensity(1e-3, 1e-5)}
    write_constants(PLAIN, target, tmp_path / "file", ExportOptions(200.0, "/imu0", noise))
    assert BIAS_CONVENTION in (tmp_path / "file").read_text()
    assert any(BIAS_CONVENTION[:-1] in each.meaning for each in CONVENTIONS if each.symbol == "b(T)")
