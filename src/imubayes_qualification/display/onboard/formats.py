"""Constants of a unit as files: C header, ROS, PX4, ArduPilot and kalibr; and what each format cannot express.

The C header has the function that applies its constants.  For ROS it is the covariances of `sensor_msgs/Imu`.

PX4 (lib/sensor_calibration, modules/temperature_compensation), in SI units, d = T − TREF with T kept within
TMIN … TMAX:

    accelerometer = (r − (X0 + X1 d + X2 d² + X3 d³) − OFF) · SCALE,    gyro = r − (X0 + … + X3 d³) − OFF

ArduPilot (AP_InertialSensor_Backend.cpp, AP_InertialSensor_tempcal.cpp), with P(d) = (c1 d + c2 d² + c3 d³) · 10⁻⁶ and
temperatures kept within TMIN … TMAX:

    accelerometer = (r − P(T − 35) + P(CALTEMP − 35) − OFFS) · SCAL,    gyro = r − P(T − 35) + P(CALTEMP − 35) − OFFS
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.polynomial import Polynomial

from imubayes.display.fit_cautions import exact_text
from imubayes.display.numbers_and_labels import value_and_sd
from imubayes.foundations.errors import Issue, refuse
from imubayes.foundations.files import write_text
from imubayes.foundations.units import BIAS_CONVENTION
from imubayes_qualification.display.onboard.kalibr import kalibr_yaml, yaml_row
from imubayes_qualification.onboard import Format
from imubayes_qualification.onboard.losses import Abilities, Loss, along_axes, losses
from imubayes_qualification.onboard.record import (
    OnboardConstants,
    ThermalPolynomial,
    TriadConstants,
    measurement_covariances,
)
from imubayes_recordings.noise_analysis.noise_record import NoiseDensity


@dataclass(frozen=True)
class ExportOptions:
    """What formats need beside the constants.

    Attributes
    ----------
    rate : of the samples, Hz; None if unknown.
    topic : ROS topic.
    noise : kind of channel → noise density.
    accept_loss : whether a file may leave out what is larger than its uncertainty.
    """

    rate: float | None = None
    topic: str = "/imu0"
    noise: Mapping[str, NoiseDensity] = field(default_factory=dict)
    accept_loss: bool = False


_WORDS = {
    "misalignment": "misalignment of the {triad}s (it has no matrix)",
    "scale_factor": "scale factor errors of the {triad}s (it has no scale factor)",
    "g_sensitivity": "g-sensitivity of the {triad}s",
    "gain_temperature": "temperature dependence of the {triad}s' gain",
    "bias_order": "terms of the {triad}s' bias beyond the third order in temperature",
    "converter_temperature": "dependence of the {triad}s' bias on the converter's temperature",
    "effect": "{effect} of the {triad}s",
}


def in_words(loss: Loss) -> str:
    """Return one loss: what it is and how large."""
    what = _WORDS[loss.kind].format(triad=loss.triad, effect=loss.effect)
    size, sd = value_and_sd(loss.size, loss.sd)
    return f"{what}: up to {size} ± {sd} {loss.unit}"


def _refuse_losses(found: Sequence[Loss], program: str, where: str) -> None:
    """Raise InputError with every significant loss."""
    refuse(
        Issue(
            f"{program} cannot hold the {in_words(loss)}",
            where,
            "an error within its expanded uncertainty (k = 2)",
            "export as json, which holds all terms, or accept the errors with --accept-loss",
        )
        for loss in found
        if loss.significant
    )


def heading(constants: OnboardConstants, found: Sequence[Loss]) -> list[str]:
    """Return what stands at the top of every file, one line each."""
    of = f"unit {constants.serial}" if constants.serial else f"campaign {constants.campaign}"
    lines = [
        f"Constants of {of}, model {constants.model}; imubayes {constants.version}.",
        f"Data {constants.data_sha256[:16]}, model {constants.model_sha256[:16]}.",
        "Uncertainties: one standard deviation of the joint posterior"
        + (f", with {exact_text(constants.exact)}, taken as exact by the model." if constants.exact else "."),
        BIAS_CONVENTION,
    ]
    if not constants.intervals_valid:
        lines.append("CAUTION: the noise differs from that of the model; the uncertainties are not valid.")
    if constants.not_determined:
        lines.append(f"Not measured, but fixed by the model or its priors: {', '.join(constants.not_determined)}.")
    lines += [f"Left out: {in_words(loss)}." for loss in found]
    return lines


_VECTOR = {"gyro": "rate", "accelerometer": "force"}
_POLYNOMIAL = """\
static inline imu_real imu_polynomial(const imu_real *coefficient, const int (*power)[2], int terms,
                                      imu_real warmer, imu_real converter_warmer)
{
    imu_real sum = 0;
    int k, n;
    for (k = 0; k < terms; k++) {
        imu_real term = coefficient[k];
        for (n = 0; n < power[k][0]; n++) term *= warmer;
        for (n = 0; n < power[k][1]; n++) term *= converter_warmer;
        sum += term;
    }
    return sum;
}
"""


def _c_header(constants: OnboardConstants) -> list[str]:
    """Return the header: constants, and a function for rate and for specific force, in C99."""
    lines = [" *", " * Conventions"]
    lines += [f" * {each.symbol}{f' [{each.unit}]' if each.unit else ''}: {each.meaning}." for each in
              constants.conventions]  # fmt: skip
    lines += [" *", " * Constants"]
    lines += [
        f" *   {each.name} = {each.value:.9g} +/- {each.sd:.3g} {each.unit}"
        + ("" if each.measured else ", not measured")
        for each in constants.constants
    ]
    lines += [" */", "#ifndef IMUBAYES_CONSTANTS_H", "#define IMUBAYES_CONSTANTS_H", ""]
    lines += ["#ifndef IMU_REAL", "#define IMU_REAL double", "#endif", "typedef IMU_REAL imu_real;", ""]
    lines += [f"#define IMU_REFERENCE_DEGC {constants.reference_degC!r}", "", _POLYNOMIAL]
    for triad in constants.triads:
        lines += _arrays(triad) + _function(triad)
    return [*lines, "#endif"]


def _arrays(triad: TriadConstants) -> list[str]:
    name, count = f"imu_{_VECTOR[triad.kind]}", len(triad.channels)
    lines = [
        f"/* channels: {', '.join(triad.channels)} */",
        f"#define {name.upper()}_CHANNELS {count}",
        f"static const imu_real {name}_scale[{count}] = {_row(triad.nominal_scale)};",
        f"static const imu_real {name}_offset[{count}] = {_row(triad.nominal_offset)};",
        f"static const imu_real {name}_matrix[3][{count}] = {_initialiser(triad.matrix)};",
        *_polynomial(f"{name}_bias", triad.bias),
    ]
    if triad.gain.terms:
        lines += _polynomial(f"{name}_gain", triad.gain)
    if triad.g_sensitivity is not None:
        lines.append(f"static const imu_real {name}_g_sensitivity[3][3] = {_initialiser(triad.g_sensitivity)};")
    return lines


def _polynomial(name: str, found: ThermalPolynomial) -> list[str]:
    terms = ", ".join(f"{{{term.sensor}, {term.converter}}}" for term in found.terms)
    shape = np.array(found.coefficients).shape
    return [
        f"static const int {name}_power[{shape[1]}][2] = {{{terms}}};",
        f"static const imu_real {name}[{shape[0]}][{shape[1]}] = {_initialiser(found.coefficients)};",
    ]


def _function(triad: TriadConstants) -> list[str]:
    """Return the function of one vector; that of the rate takes the specific force."""
    vector = _VECTOR[triad.kind]
    name, count = f"imu_{vector}", len(triad.channels)
    force = "const imu_real force[3], " if triad.kind == "gyro" else ""
    result = "rate" if triad.kind == "gyro" else "force"
    bias = len(triad.bias.terms)
    lines = [
        "",
        "/* Outputs in output units, temperatures of sensor and converter in degC. */",
        f"static inline void {name}(const imu_real output[{count}], {force}imu_real temperature,",
        f"                           imu_real converter_temperature, imu_real {result}[3])",
        "{",
        "    const imu_real t = temperature - IMU_REFERENCE_DEGC, tc = converter_temperature - IMU_REFERENCE_DEGC;",
        f"    imu_real x[{count}];",
        "    int i, k;",
        f"    for (i = 0; i < {count}; i++) {{",
        f"        x[i] = (output[i] - {name}_offset[i]) / {name}_scale[i];",
        f"        x[i] -= imu_polynomial({name}_bias[i], {name}_bias_power, {bias}, t, tc);",
    ]
    if triad.gain.terms:
        terms = len(triad.gain.terms)
        lines.append(f"        x[i] /= 1 + imu_polynomial({name}_gain[i], {name}_gain_power, {terms}, t, tc);")
    lines += ["    }", "    for (k = 0; k < 3; k++) {", f"        {result}[k] = 0;"]
    lines.append(f"        for (i = 0; i < {count}; i++) {result}[k] += {name}_matrix[k][i] * x[i];")
    if triad.g_sensitivity is not None:
        lines.append(f"        for (i = 0; i < 3; i++) {result}[k] -= {name}_g_sensitivity[k][i] * force[i];")
    lines += ["    }", *(["    (void)force;"] if triad.kind == "gyro" and triad.g_sensitivity is None else []), "}", ""]
    return lines


def _row(values: Sequence[float]) -> str:
    return "{" + ", ".join(repr(float(value)) for value in values) + "}"


def _initialiser(rows: Sequence[Sequence[float]]) -> str:
    return "{" + ", ".join(map(_row, rows)) + "}"


_FIELDS = {"gyro": ("angular_velocity", "rad^2/s^2"), "accelerometer": ("linear_acceleration", "m^2/s^4")}


def _ros_covariances(constants: OnboardConstants) -> list[str]:
    """Return the covariances of a corrected sample as YAML, row-major about x, y, z."""
    lines = [
        "# Of samples that were corrected with the constants (`imubayes export --format json` or c), in body axes.",
        "# *_covariance: noise of one sample, independent from sample to sample, as filters assume.",
        "# *_systematic_covariance: calibration at zero input and run-to-run offset; the same for all samples of a",
        "# recording. It does not average, and is not part of the message: a filter estimates it as a bias.",
    ]
    if constants.slow_noise:
        lines.append(f"# In neither: {', '.join(constants.slow_noise)}.")
    lines.append(f"orientation_covariance: {yaml_row([-1.0] + [0.0] * 8)}  # no orientation")
    for triad in constants.triads:
        field, unit = _FIELDS[triad.kind]
        noise, systematic = measurement_covariances(constants, triad)
        lines += [
            f"{field}_covariance: {_flat(noise)}  # {unit}",
            f"{field}_systematic_covariance: {_flat(systematic)}  # {unit}",
        ]
    return lines


def _flat(matrix: np.ndarray) -> str:
    return yaml_row([float(f"{value:.9g}") for value in matrix.ravel()])


_ARDUPILOT_REFERENCE, _ARDUPILOT_FACTOR, _ORDER = 35.0, 1e6, 3
# Column "type" of a QGroundControl parameter file: MAV_PARAM_TYPE.
_INT32, _REAL32 = 6, 9


def _px4_parameters(constants: OnboardConstants) -> list[str]:
    """Return the lines of a file for QGroundControl: CAL_ACC0_…, CAL_GYRO0_… and, over temperature, TC_A0_…, TC_G0_….

    Raises
    ------
    InputError
        if the channels of a triad do not lie along the body axes.
    """
    _refuse_other_axes(constants, "px4")
    values: list[tuple[str, float | int]] = []
    for triad in constants.triads:
        sensor, letter = ("GYRO", "G") if triad.kind == "gyro" else ("ACC", "A")
        biases = list(_biases(triad))
        values += [(f"CAL_{sensor}0_{axis}OFF", bias.coef[0]) for axis, bias in zip("XYZ", biases, strict=True)]
        if triad.kind == "accelerometer":
            values += [(f"CAL_ACC0_{axis}SCALE", scale) for axis, scale in zip("XYZ", _scales(triad), strict=True)]
        values += _px4_thermal(constants, biases, f"TC_{letter}")
    values += [("IMU_GYRO_CAL_EN", 0), ("SENS_IMU_AUTOCAL", 0)]
    return [
        "# Offsets and scales of the sensor's axes x, y, z, as the driver publishes them in SI units, before rotation.",
        "# Set CAL_ACC0_ID, CAL_GYRO0_ID, TC_A0_ID and TC_G0_ID to the device ids of the sensors on the vehicle.",
        "# IMU_GYRO_CAL_EN and SENS_IMU_AUTOCAL are off: PX4 would overwrite the offsets with its own, at rest and in",
        "# flight. A calibration in QGroundControl overwrites them too.",
        "# vehicle\tcomponent\tname\tvalue\ttype",
        *(f"1\t1\t{name}\t{_number(value)}\t{_INT32 if isinstance(value, int) else _REAL32}" for name, value in values),
    ]


def _ardupilot_parameters(constants: OnboardConstants) -> list[str]:
    """Return the lines of a parameter file for ArduPilot: INS_ACCOFFS_…, INS_ACCSCAL_…, INS_GYROFFS_… and INS_TCAL1_….

    Raises
    ------
    InputError
        if the channels of a triad do not lie along the body axes.
    """
    _refuse_other_axes(constants, "ardupilot")
    low, high = constants.ranges_degC.get("temperature", (constants.reference_degC,) * 2)
    at = float(np.clip(constants.reference_degC, low, high))
    values: list[tuple[str, float | int]] = []
    thermal: list[tuple[str, float | int]] = []
    for triad in constants.triads:
        sensor = "GYR" if triad.kind == "gyro" else "ACC"
        biases = list(_biases(triad))
        offsets = [bias(at - constants.reference_degC) for bias in biases]
        values += [(f"INS_{sensor}OFFS_{axis}", offset) for axis, offset in zip("XYZ", offsets, strict=True)]
        if triad.kind == "accelerometer":
            values += [(f"INS_ACCSCAL_{axis}", scale) for axis, scale in zip("XYZ", _scales(triad), strict=True)]
        if any(bias.degree() > 0 for bias in biases):
            values.append((f"INS_{sensor}1_CALTEMP", at))
            thermal += _ardupilot_thermal(constants, biases, sensor)
    if thermal:
        values += [("INS_TCAL1_ENABLE", 1), ("INS_TCAL1_TMIN", low), ("INS_TCAL1_TMAX", high), *thermal]
    values.append(("INS_GYR_CAL", 0))
    return [
        "# Offsets and scales of the axes x, y, z after the sensor's orientation, before that of the board.",
        "# Set INS_ACC_ID and INS_GYR_ID to the device ids of the sensors on the vehicle: under another id ArduPilot",
        "# treats a sensor as not calibrated.",
        "# INS_GYR_CAL is 0: ArduPilot would overwrite the offsets of the gyros with its own at every start. An",
        "# accelerometer or gyro calibration by the ground station overwrites them too.",
        *(f"{name},{_number(value)}" for name, value in values),
    ]


def _px4_thermal(
    constants: OnboardConstants, biases: Sequence[Polynomial], prefix: str
) -> list[tuple[str, float | int]]:
    """Return the thermal table of PX4; the offset at the reference temperature is in CAL_…OFF."""
    if not any(bias.degree() > 0 for bias in biases):
        return []
    low, high = constants.ranges_degC["temperature"]
    found: list[tuple[str, float | int]] = [
        (f"{prefix}_ENABLE", 1), (f"{prefix}0_TREF", constants.reference_degC), (f"{prefix}0_TMIN", low),
        (f"{prefix}0_TMAX", high),
    ]  # fmt: skip
    for order in range(_ORDER, -1, -1):
        for axis, bias in enumerate(biases):
            known = bias.coef[order] if 0 < order < len(bias.coef) else 0.0
            found.append((f"{prefix}0_X{order}_{axis}", float(known)))
    return found


def _ardupilot_thermal(
    constants: OnboardConstants, biases: Sequence[Polynomial], sensor: str
) -> Iterator[tuple[str, float | int]]:
    """Yield the coefficients of P, about 35 °C: the constant term is in the offsets."""
    shifted = [bias(Polynomial([_ARDUPILOT_REFERENCE - constants.reference_degC, 1.0])) for bias in biases]
    for order in range(1, _ORDER + 1):
        for axis, bias in zip("XYZ", shifted, strict=True):
            known = bias.coef[order] if order < len(bias.coef) else 0.0
            yield (f"INS_TCAL1_{sensor}{order}_{axis}", float(known) * _ARDUPILOT_FACTOR)


def _biases(triad: TriadConstants) -> Iterator[Polynomial]:
    """Yield b(T) of each channel in T − T_ref of the sensor, to the third order."""
    for coefficients in triad.bias.coefficients:
        own = np.zeros(_ORDER + 1)
        for term, coefficient in zip(triad.bias.terms, coefficients, strict=True):
            if term.converter == 0 and term.sensor <= _ORDER:
                own[term.sensor] = coefficient
        yield Polynomial(own[: max(np.flatnonzero(own), default=0) + 1])


def _number(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:.9g}"


def _scales(triad: TriadConstants) -> list[float]:
    return np.diag(np.array(triad.matrix)).tolist()


def _refuse_other_axes(constants: OnboardConstants, target: str) -> None:
    refuse(
        Issue(
            f"the {triad.kind} channels {', '.join(triad.channels)} do not lie along the body axes x, y and z",
            f"--format {target}", "three channels, one along each axis", "export as json or c",
        )
        for triad in constants.triads if not along_axes(triad)
    )  # fmt: skip


@dataclass(frozen=True)
class ExportFormat:
    """A format of the constants.

    Attributes
    ----------
    lines : what stands below the heading.
    program : that reads it, as it is named in sentences.
    able : what it can hold; None if nothing is lost.
    opening, comment : before the lines of the heading, and at the beginning of each.
    """

    lines: Callable[[OnboardConstants, ExportOptions], list[str]]
    program: str = ""
    able: Abilities | None = None
    opening: tuple[str, ...] = ()
    comment: str = "# "


_BOTH = ("gyro", "accelerometer")
_AUTOPILOT = Abilities(False, False, False, ("accelerometer",), 3, False)
# Kalibr estimates biases itself, as functions of time.
_KALIBR = Abilities(True, True, False, _BOTH, None, True)
_ALL = Abilities(True, True, True, _BOTH, None, True)
_FORMATS: dict[Format, ExportFormat] = {
    "c": ExportFormat(lambda constants, _: _c_header(constants), "the C header", _ALL, ("/*",), " * "),
    "kalibr": ExportFormat(
        lambda constants, given: kalibr_yaml(constants, given.noise, given.rate, given.topic), "kalibr", _KALIBR
    ),
    "px4": ExportFormat(lambda constants, _: _px4_parameters(constants), "PX4", _AUTOPILOT),
    "ardupilot": ExportFormat(lambda constants, _: _ardupilot_parameters(constants), "ArduPilot", _AUTOPILOT),
    "ros": ExportFormat(lambda constants, _: _ros_covariances(constants)),
}
"""All formats but json, which is the record itself."""


def losses_of(constants: OnboardConstants, format: Format) -> tuple[Loss, ...]:
    """Return what a format leaves out."""
    able = None if format == "json" else _FORMATS[format].able
    return () if able is None else losses(constants, able)


def write_constants(constants: OnboardConstants, format: Format, out: Path, options: ExportOptions) -> tuple[Loss, ...]:
    """Write the constants; return what the format leaves out.

    Raises
    ------
    InputError
        if the format cannot hold the constants, or needs what is not known.
    """
    if format == "json":
        write_text(out, constants.json_text())
        return ()
    chosen, found = _FORMATS[format], losses_of(constants, format)
    if not options.accept_loss:
        _refuse_losses(found, chosen.program, str(out))
    head = [f"{chosen.comment}{line}" for line in heading(constants, found)]
    write_text(out, "\n".join([*chosen.opening, *head, *chosen.lines(constants, options), ""]))
    return found
