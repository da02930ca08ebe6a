"""Constants as parameter files of PX4 and ArduPilot: offsets and scales by axis, and offsets over temperature.

PX4 (lib/sensor_calibration, modules/temperature_compensation), in SI units,
d = T − TREF with T kept within TMIN … TMAX:

    accelerometer = (r − (X0 + X1 d + X2 d² + X3 d³) − OFF) · SCALE,    gyro = r − (X0 + … + X3 d³) − OFF

ArduPilot (AP_InertialSensor_Backend.cpp, AP_InertialSensor_tempcal.cpp), with P(d) = (c1 d + c2 d² + c3 d³) · 10⁻⁶ and
temperatures kept within TMIN … TMAX:

    accelerometer = (r − P(T − 35) + P(CALTEMP − 35) − OFFS) · SCAL,    gyro = r − P(T − 35) + P(CALTEMP − 35) − OFFS
"""

from collections.abc import Sequence

import numpy as np
from numpy.polynomial import Polynomial

from imubayes.display.onboard.losses_in_words import heading
from imubayes.errors import InputError, Issue
from imubayes.qualification.onboard_losses import Loss, along_axes
from imubayes.qualification.onboard_record import OnboardConstants, TriadConstants

_ARDUPILOT_REFERENCE, _ARDUPILOT_FACTOR, _ORDER = 35.0, 1e6, 3
# Column "type" of a QGroundControl parameter file: MAV_PARAM_TYPE.
_INT32, _REAL32 = 6, 9


def px4_parameters(constants: OnboardConstants, found: Sequence[Loss]) -> str:
    """Return a parameter file for QGroundControl: CAL_ACC0_…, CAL_GYRO0_… and, over temperature, TC_A0_…, TC_G0_….

    Raises
    ------
    InputError
        where the channels of a triad do not lie along the body axes.
    """
    _refuse_other_axes(constants, "px4")
    values: list[tuple[str, float | int]] = []
    for triad in constants.triads:
        sensor, letter = ("GYRO", "G") if triad.kind == "gyro" else ("ACC", "A")
        biases = _biases(triad)
        values += [(f"CAL_{sensor}0_{axis}OFF", bias.coef[0]) for axis, bias in zip("XYZ", biases, strict=True)]
        if triad.kind == "accelerometer":
            values += [(f"CAL_ACC0_{axis}SCALE", scale) for axis, scale in zip("XYZ", _scales(triad), strict=True)]
        values += _px4_thermal(constants, biases, f"TC_{letter}")
    lines = [f"# {line}" for line in heading(constants, found)]
    lines += [
        "# Offsets and scales of the sensor's axes x, y, z, as the driver publishes them in SI units, before rotation.",
        "# Set CAL_ACC0_ID, CAL_GYRO0_ID, TC_A0_ID and TC_G0_ID to the device ids of the sensors on the vehicle.",
        "# vehicle\tcomponent\tname\tvalue\ttype",
    ]
    lines += [
        f"1\t1\t{name}\t{_number(value)}\t{_INT32 if isinstance(value, int) else _REAL32}" for name, value in values
    ]
    return "\n".join([*lines, ""])


def ardupilot_parameters(constants: OnboardConstants, found: Sequence[Loss]) -> str:
    """Return a parameter file for ArduPilot: INS_ACCOFFS_…, INS_ACCSCAL_…, INS_GYROFFS_… and INS_TCAL1_….

    Raises
    ------
    InputError
        where the channels of a triad do not lie along the body axes.
    """
    _refuse_other_axes(constants, "ardupilot")
    low, high = constants.ranges_degC.get("temperature", (constants.reference_degC,) * 2)
    at = float(np.clip(constants.reference_degC, low, high))
    values: list[tuple[str, float | int]] = []
    thermal: list[tuple[str, float | int]] = []
    for triad in constants.triads:
        sensor = "GYR" if triad.kind == "gyro" else "ACC"
        biases = _biases(triad)
        offsets = [bias(at - constants.reference_degC) for bias in biases]
        values += [(f"INS_{sensor}OFFS_{axis}", offset) for axis, offset in zip("XYZ", offsets, strict=True)]
        if triad.kind == "accelerometer":
            values += [(f"INS_ACCSCAL_{axis}", scale) for axis, scale in zip("XYZ", _scales(triad), strict=True)]
        if any(bias.degree() > 0 for bias in biases):
            values.append((f"INS_{sensor}1_CALTEMP", at))
            thermal += _ardupilot_thermal(constants, biases, sensor)
    if thermal:
        values += [("INS_TCAL1_ENABLE", 1), ("INS_TCAL1_TMIN", low), ("INS_TCAL1_TMAX", high), *thermal]
    lines = [f"# {line}" for line in heading(constants, found)]
    lines.append("# Offsets and scales of the axes x, y, z after the sensor's orientation, before that of the board.")
    lines += [f"{name},{_number(value)}" for name, value in values]
    return "\n".join([*lines, ""])


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
) -> list[tuple[str, float | int]]:
    """Return the coefficients of P, about 35 °C: the constant term is in the offsets."""
    found: list[tuple[str, float | int]] = []
    shifted = [bias(Polynomial([_ARDUPILOT_REFERENCE - constants.reference_degC, 1.0])) for bias in biases]
    for order in range(1, _ORDER + 1):
        for axis, bias in zip("XYZ", shifted, strict=True):
            known = bias.coef[order] if order < len(bias.coef) else 0.0
            found.append((f"INS_TCAL1_{sensor}{order}_{axis}", float(known) * _ARDUPILOT_FACTOR))
    return found


def _biases(triad: TriadConstants) -> list[Polynomial]:
    """Return b(T) of each channel in T − T_ref of the sensor, to the third order."""
    found = []
    for coefficients in triad.bias.coefficients:
        own = np.zeros(_ORDER + 1)
        for term, coefficient in zip(triad.bias.terms, coefficients, strict=True):
            if term.converter == 0 and term.sensor <= _ORDER:
                own[term.sensor] = coefficient
        found.append(Polynomial(own[: max(np.flatnonzero(own), default=0) + 1]))
    return found


def _number(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:.9g}"


def _scales(triad: TriadConstants) -> list[float]:
    return np.diag(np.array(triad.matrix)).tolist()


def _refuse_other_axes(constants: OnboardConstants, target: str) -> None:
    issues = [
        Issue(
            f"the {triad.kind} channels {', '.join(triad.channels)} do not lie along the body axes x, y and z",
            f"--format {target}", "three channels, one along each axis", "export as json or c",
        )
        for triad in constants.triads if not along_axes(triad)
    ]  # fmt: skip
    if issues:
        raise InputError(issues)
