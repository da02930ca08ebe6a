"""The conventions of constants for use on board, one table, and what they do to a sample."""

from collections.abc import Mapping

import numpy as np

from imubayes.qualification.onboard_record import Convention, OnboardConstants, ThermalPolynomial, TriadConstants
from imubayes.units import BIAS_CONVENTION

CONVENTIONS = (
    Convention(
        symbol="body axes",
        meaning="the axes in which campaign.toml states input_axis; not rotated into any vehicle frame",
        unit="",
    ),
    Convention(
        symbol="r",
        meaning="output of a channel on its nominal scale: r = (output − nominal_offset)/nominal_scale; gyros and "
        "accelerometers each in the order of `channels`",
        unit="rad/s; m/s^2",
    ),
    Convention(
        symbol="b(T)",
        meaning=f"r at zero input, of the sign of the output. {BIAS_CONVENTION[:-1]}: r − b(T)",
        unit="rad/s; m/s^2",
    ),
    Convention(
        symbol="κ(T)",
        meaning="gain relative to that at T_ref, κ(T_ref) = 1: r − b(T) is divided by it, channel by channel",
        unit="1",
    ),
    Convention(
        symbol="M",
        meaning="matrix from channels (columns) to body axes (rows): scale factor errors and misalignment together, "
        "close to the identity where channels lie along the axes. It turns a reading into the truth: "
        "f = M_a (r_a − b_a(T))/κ_a(T). Kalibr's M goes the other way",
        unit="1",
    ),
    Convention(
        symbol="A",
        meaning="g-sensitivity of the gyros, body axes: what is subtracted last, ω = M_g (r_g − b_g(T))/κ_g(T) − A f",
        unit="rad/s per m/s^2",
    ),
    Convention(
        symbol="f, ω",
        meaning="specific force, +g along an axis that points up at rest; inertial rate, right-handed, that of the "
        "Earth included; both in body axes",
        unit="m/s^2; rad/s",
    ),
    Convention(
        symbol="T, T_c",
        meaning="temperature of the sensors and of the converter; polynomials are in T − T_ref and T_c − T_ref, "
        "without a limit at the ends of the calibrated range",
        unit="degC",
    ),
)


def polynomial(found: ThermalPolynomial, temperature: float, converter: float, reference: float) -> np.ndarray:
    """Return the polynomial of every channel at two temperatures in °C, shape (C,)."""
    warmer, converter_warmer = temperature - reference, converter - reference
    powers = np.array([warmer**term.sensor * converter_warmer**term.converter for term in found.terms])
    return np.array(found.coefficients).reshape(-1, len(powers)) @ powers


def nominal(triad: TriadConstants, outputs: Mapping[str, float]) -> np.ndarray:
    """Return r of the channels of a triad, shape (C,)."""
    read = np.array([outputs[name] for name in triad.channels])
    return (read - np.array(triad.nominal_offset)) / np.array(triad.nominal_scale)


def unscaled(
    triad: TriadConstants, r: np.ndarray, temperature: float, converter: float, reference: float
) -> np.ndarray:
    """Return (r − b(T))/κ(T), shape (C,)."""
    bias = polynomial(triad.bias, temperature, converter, reference)
    gain = 1 + (polynomial(triad.gain, temperature, converter, reference) if triad.gain.terms else np.zeros(len(r)))
    return (r - bias) / gain


def body_vector(triad: TriadConstants, unscaled_outputs: np.ndarray, force: np.ndarray | None) -> np.ndarray:
    """Return rate or specific force in body axes, shape (3,)."""
    found = np.array(triad.matrix) @ unscaled_outputs
    if triad.g_sensitivity is not None and force is not None:
        found = found - np.array(triad.g_sensitivity) @ force
    return found


def measurement_covariances(constants: OnboardConstants, triad: TriadConstants) -> tuple[np.ndarray, np.ndarray]:
    """Return the covariance of a corrected sample about x, y, z from its noise, and that which all samples share.

    The second is that of the bias at the reference temperature and of the offset of a recording: at zero input the
    matrix is multiplied by nothing else.  Shapes (3, 3), (rad/s)² or (m/s²)².
    """
    matrix = np.array(triad.matrix)
    noise = matrix @ np.diag(np.square(triad.sample_noise)) @ matrix.T
    places = {constant.name: place for place, constant in enumerate(constants.constants)}
    chosen = [places[f"bias[{name}]"] for name in triad.channels]
    biases = np.array(constants.covariance)[np.ix_(chosen, chosen)]
    return noise, matrix @ (biases + np.diag(np.square(triad.run_offset))) @ matrix.T
