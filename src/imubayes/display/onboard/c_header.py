"""Constants as a C header with the function that applies them."""

from collections.abc import Sequence

import numpy as np

from imubayes.display.onboard.losses_in_words import heading
from imubayes.qualification.onboard_losses import Loss
from imubayes.qualification.onboard_record import OnboardConstants, ThermalPolynomial, TriadConstants

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


def c_header(constants: OnboardConstants, found: Sequence[Loss]) -> str:
    """Return the header: constants, and a function for rate and for specific force, in C99."""
    lines = ["/*", *(f" * {line}" for line in heading(constants, found)), " *", " * Conventions"]
    lines += [f" * {each.symbol}{f' [{each.unit}]' if each.unit else ''}: {each.meaning}." for each in
              constants.conventions]  # fmt: skip
    lines += [" *", " * Constants"]
    lines += [f" *   {each.name} = {each.value:.9g} +/- {each.sd:.3g} {each.unit}" for each in constants.constants]
    lines += [" */", "#ifndef IMUBAYES_CONSTANTS_H", "#define IMUBAYES_CONSTANTS_H", ""]
    lines += ["#ifndef IMU_REAL", "#define IMU_REAL double", "#endif", "typedef IMU_REAL imu_real;", ""]
    lines += [f"#define IMU_REFERENCE_DEGC {constants.reference_degC!r}", "", _POLYNOMIAL]
    for triad in constants.triads:
        lines += _arrays(triad) + _function(triad)
    return "\n".join([*lines, "#endif", ""])


def _arrays(triad: TriadConstants) -> list[str]:
    name, count = f"imu_{_VECTOR[triad.kind]}", len(triad.channels)
    lines = [
        f"/* channels: {', '.join(triad.channels)} */",
        f"#define {name.upper()}_CHANNELS {count}",
        f"static const imu_real {name}_scale[{count}] = {_row(triad.nominal_scale)};",
        f"static const imu_real {name}_offset[{count}] = {_row(triad.nominal_offset)};",
        f"static const imu_real {name}_matrix[3][{count}] = {_matrix(triad.matrix)};",
        *_polynomial(f"{name}_bias", triad.bias),
    ]
    if triad.gain.terms:
        lines += _polynomial(f"{name}_gain", triad.gain)
    if triad.g_sensitivity is not None:
        lines.append(f"static const imu_real {name}_g_sensitivity[3][3] = {_matrix(triad.g_sensitivity)};")
    return lines


def _polynomial(name: str, found: ThermalPolynomial) -> list[str]:
    terms = ", ".join(f"{{{term.sensor}, {term.converter}}}" for term in found.terms)
    shape = np.array(found.coefficients).shape
    return [
        f"static const int {name}_power[{shape[1]}][2] = {{{terms}}};",
        f"static const imu_real {name}[{shape[0]}][{shape[1]}] = {_matrix(found.coefficients)};",
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


def _matrix(rows: Sequence[Sequence[float]]) -> str:
    return "{" + ", ".join(map(_row, rows)) + "}"
