"""Constants to use on board, as a record: the JSON of `imubayes export --format json`, and its conventions.

The conventions of the constants (sign, order, frame and unit) stand in one table.  The correction of a sample by the
constants is computed here, and what kalibr's model makes of them.

kalibr's `scale-misalignment` model goes from the truth to the reading, r_a = M_a f + b_a and r_g = M_g C ω + A C f +
b_g in the frame i of its IMU, with M_a and M_g lower triangular and C = C_gyro_i a rotation
(kalibr_imu_camera_calibration/IccSensors.py, IccScaledMisalignedImu).  Frame i is therefore fixed by the
accelerometers: the inverse of the matrix of the constants is split into a lower triangle and a rotation, C_i_body.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from imubayes.foundations.quantity_names import name_of
from imubayes.foundations.records import Record
from imubayes.foundations.units import BIAS_CONVENTION
from imubayes.inference.identifiability import WeakDirection
from imubayes.model.model_file import UncertainEquipment


class ThermalPowers(Record):
    """One term of a polynomial: powers of T − T_ref of the sensor and T_c − T_ref of the converter."""

    sensor: int
    converter: int


class ThermalPolynomial(Record):
    """A polynomial in temperature for each channel: coefficients[channel][term] · (T − T_ref)^sensor · …."""

    terms: tuple[ThermalPowers, ...]
    coefficients: tuple[tuple[float, ...], ...]

    def order(self, device: Literal["sensor", "converter"]) -> int:
        """Return the highest power of a temperature."""
        return max((getattr(term, device) for term in self.terms), default=0)


class CarriedParameter(Record):
    """A parameter of an effect, with its factor to SI."""

    name: str
    value: float
    sd: float
    unit: str
    si_factor: float


Cause = Literal["nonlinear", "memory", "limit", "covariate"]


class UnexpressedEffect(Record):
    """An effect of the model that the constants do not express.

    Attributes
    ----------
    effect, channels, formula : as in the catalogue.
    cause : ``nonlinear`` in the input, with ``memory``, a ``limit``, or of a ``covariate`` that is not known.
    size, sd : largest error within the range of the campaign if it is left out, and its standard uncertainty, in
        m/s² or rad/s; None if only the parameters are known.
    parameters : with which it can be computed.
    """

    effect: str
    channels: tuple[str, ...]
    kind: str
    formula: str
    cause: Cause
    size: float | None
    sd: float | None
    parameters: tuple[CarriedParameter, ...]

    @property
    def standard_uncertainty(self) -> float:
        """Of leaving the effect out: that of a rectangular distribution over ± its size (GUM 4.3.7), and that of it."""
        return math.hypot((self.size or 0.0) / math.sqrt(3), self.sd or 0.0)


class TriadConstants(Record):
    """Constants of all gyros or all accelerometers of a unit (C channels).

    Attributes
    ----------
    channels : names, in the order of all columns.
    output_units, nominal_scale, nominal_offset : r = (output − offset)/scale, in rad/s or m/s².
    matrix : M, shape (3, C).
    bias : b(T), rad/s or m/s².
    gain : κ(T) − 1; no terms if the gain does not depend on temperature.
    g_sensitivity : A, shape (3, 3), rad/s per m/s²; None if the model has none.
    input_range : largest magnitude of input in the campaign, rad/s or m/s².
    error_left : largest error of these constants against the model over that range, with all that is not expressed.
    sample_noise : standard deviation of one sample of each channel, r.
    run_offset : standard deviation of the offset that a recording has of its own, of each channel, r.
    """

    kind: Literal["gyro", "accelerometer"]
    unit: str
    channels: tuple[str, ...]
    output_units: tuple[str, ...]
    nominal_scale: tuple[float, ...]
    nominal_offset: tuple[float, ...]
    matrix: tuple[tuple[float, ...], ...]
    bias: ThermalPolynomial
    gain: ThermalPolynomial
    g_sensitivity: tuple[tuple[float, ...], ...] | None
    input_range: float
    error_left: float
    sample_noise: tuple[float, ...]
    run_offset: tuple[float, ...]


class Constant(Record):
    """One constant with its marginal posterior.

    Attributes
    ----------
    from_data : share of information that came from the data.
    measured : whether it is at least a half; a constant that nothing in the model changes was never measured.
    """

    name: str
    unit: str
    value: float
    sd: float
    q025: float
    q975: float
    from_data: float | None
    measured: bool = True


class Convention(Record):
    """What a symbol means: sign, order, frame and unit."""

    symbol: str
    meaning: str
    unit: str


class WorkedSample(Record):
    """One sample taken through the constants, step by step, for every channel and axis.

    Attributes
    ----------
    temperature_degC, converter_temperature_degC : at which it was read.
    outputs : of the channels, output units.
    nominal, unbiased, unscaled : r, r − b(T) and (r − b(T))/κ(T).
    result : rate or specific force in body axes.
    """

    temperature_degC: float
    converter_temperature_degC: float
    channels: tuple[str, ...]
    outputs: tuple[float, ...]
    nominal: tuple[float, ...]
    unbiased: tuple[float, ...]
    unscaled: tuple[float, ...]
    rate_rad_s: tuple[float, float, float] | None
    force_m_s2: tuple[float, float, float] | None


class OnboardConstants(Record):
    """Constants with which a computer on board turns outputs into rate and specific force (format 1).

    Attributes
    ----------
    reference_degC : T_ref.
    ranges_degC : calibrated range of each temperature that the model depends on.
    interval, posterior : kind of interval, and of the draws it comes from.
    intervals_valid : whether the noise agrees with the model.
    constants : all constants of the triads with their uncertainties.
    covariance : of the constants, in their order and units.
    not_determined : constants that were not measured.
    weak_directions : of the parameters, as in `summary.json`.
    exact : what the model takes as exact of site and equipment; the uncertainties contain it nevertheless.
    """

    format: Literal[1] = 1
    serial: str
    campaign: str
    model: str
    version: str
    data_sha256: str
    model_sha256: str
    gravity_m_s2: float
    reference_degC: float
    needs: tuple[str, ...]
    ranges_degC: dict[str, tuple[float, float]]
    interval: str
    posterior: Literal["sampled", "laplace"]
    intervals_valid: bool
    triads: tuple[TriadConstants, ...]
    constants: tuple[Constant, ...]
    covariance: tuple[tuple[float, ...], ...]
    not_determined: tuple[str, ...]
    weak_directions: tuple[WeakDirection, ...]
    exact: tuple[UncertainEquipment, ...] = ()
    unexpressed: tuple[UnexpressedEffect, ...]
    slow_noise: tuple[str, ...]
    conventions: tuple[Convention, ...]
    worked_sample: WorkedSample

    def triad(self, kind: str) -> TriadConstants | None:
        """Return the constants of the gyros or the accelerometers."""
        return next((triad for triad in self.triads if triad.kind == kind), None)

    def sd(self, name: str) -> float:
        """Return the standard uncertainty of a constant by name."""
        return next(constant.sd for constant in self.constants if constant.name == name)


_MEANINGS = {
    ("body axes", ""): "the axes in which campaign.toml states input_axis; not rotated into any vehicle frame",
    ("r", "rad/s; m/s^2"): "output of a channel on its nominal scale: r = (output − nominal_offset)/nominal_scale; "
    "gyros and accelerometers each in the order of `channels`",
    ("b(T)", "rad/s; m/s^2"): f"r at zero input, of the sign of the output. {BIAS_CONVENTION[:-1]}: r − b(T)",
    ("κ(T)", "1"): "gain relative to that at T_ref, κ(T_ref) = 1: r − b(T) is divided by it, channel by channel",
    ("M", "1"): "matrix from channels (columns) to body axes (rows): scale factor errors and misalignment together, "
    "close to the identity where channels lie along the axes. It turns a reading into the truth: "
    "f = M_a (r_a − b_a(T))/κ_a(T). Kalibr's M goes the other way",
    ("A", "rad/s per m/s^2"): "g-sensitivity of the gyros, body axes: what is subtracted last, "
    "ω = M_g (r_g − b_g(T))/κ_g(T) − A f",
    ("f, ω", "m/s^2; rad/s"): "specific force, +g along an axis that points up at rest; inertial rate, right-handed, "
    "that of the Earth included; both in body axes",
    (
        "T, T_c",
        "degC",
    ): "temperature of the sensors and of the converter; polynomials are in T − T_ref and T_c − T_ref, "
    "without a limit at the ends of the calibrated range",
}
"""Symbol and unit → what it means."""
CONVENTIONS = tuple(
    Convention(symbol=symbol, meaning=meaning, unit=unit) for (symbol, unit), meaning in _MEANINGS.items()
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
    chosen = [places[name_of("bias", name)] for name in triad.channels]
    biases = np.array(constants.covariance)[np.ix_(chosen, chosen)]
    return noise, matrix @ (biases + np.diag(np.square(triad.run_offset))) @ matrix.T


@dataclass(frozen=True)
class KalibrMatrices:
    """Matrices of kalibr's model, shape (3, 3) each.

    Attributes
    ----------
    accelerometers, gyroscopes : M_a and M_g, lower triangular with positive diagonals.
    g_sensitivity : A, rad/s per m/s².
    gyro_from_imu : C_gyro_i.
    imu_from_body : rotation from the body axes of the constants to kalibr's frame i.
    """

    accelerometers: np.ndarray
    gyroscopes: np.ndarray
    g_sensitivity: np.ndarray
    gyro_from_imu: np.ndarray
    imu_from_body: np.ndarray


def kalibr_matrices(accelerometers: TriadConstants, gyros: TriadConstants) -> KalibrMatrices:
    """Return the constants at the reference temperature as kalibr's matrices; triads must have three channels."""
    lower, imu_from_body = lower_and_rotation(np.linalg.inv(np.array(accelerometers.matrix)))
    forward = np.linalg.inv(np.array(gyros.matrix))
    own, rotation = lower_and_rotation(forward @ imu_from_body.T)
    body = np.zeros((3, 3)) if gyros.g_sensitivity is None else forward @ np.array(gyros.g_sensitivity)
    return KalibrMatrices(lower, own, body @ imu_from_body.T @ rotation.T, rotation, imu_from_body)


def lower_and_rotation(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return L and Q of matrix = L Q: lower triangular with a positive diagonal, and orthogonal; shape (3, 3) each."""
    q, r = np.linalg.qr(matrix.T)
    signs = np.sign(np.diag(r))
    return (r.T * signs), (q * signs).T
