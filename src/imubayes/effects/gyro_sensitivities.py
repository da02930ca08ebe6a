"""Effects of a gyro's inputs: input axis, acceleration sensitivity, scale factor nonlinearity, magnetic field."""

from imubayes.array_shapes import Scalar
from imubayes.effects.base import Order, SignalEffect
from imubayes.effects.shared_formulas import (
    Gyro,
    Misalignment,
    ScaleAsymmetry,
    SecondOrderNonlinearity,
    ThirdOrderNonlinearity,
)
from imubayes.parameters.parameter_declarations import option, parameter
from imubayes.rotations import cross
from imubayes.signal_path_state import Sample

_TESLA_PER_UT = 1e-6


class GyroMisalignment(Gyro, Misalignment):
    """The true input axis is the unit vector along I + a·O + b·S: a is the angle toward O, b toward S."""

    name = "gyro_misalignment"
    confused_with = "mounting error common to all axes"
    reference = "IEEE Std 952, input axis misalignment"
    toward_o: Scalar = parameter(
        "arcsec", "normal(0, 200 arcsec)", (10, 200), "the misalignment toward O", coarse=(700, 4000)
    )
    toward_s: Scalar = parameter(
        "arcsec", "normal(0, 200 arcsec)", (10, 200), "the misalignment toward S", coarse=(700, 4000)
    )

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return self.misaligned(signal, sample, self.toward_o, self.toward_s)


class GyroGSensitivity(Gyro, SignalEffect):
    """Drift proportional to specific force: signal + D_I f_I + D_O f_O + D_S f_S."""

    name = "gyro_g_sensitivity"
    order = Order.SENSITIVITY
    confused_with = "levelling error and Earth rate components"
    reference = "IEEE Std 517, D_I, D_O, D_S"
    d_i: Scalar = parameter(
        "deg/h/g", "normal(0, 100 deg/h/g)", (1, 576), "the drift per g along the input axis", coarse=(200, 500)
    )
    d_o: Scalar = parameter(
        "deg/h/g", "normal(0, 100 deg/h/g)", (1, 576), "the drift per g along the output axis", coarse=(200, 500)
    )
    d_s: Scalar = parameter(
        "deg/h/g", "normal(0, 100 deg/h/g)", (1, 576), "the drift per g along the spin axis", coarse=(200, 500)
    )

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        force = sample.force
        return signal + self.d_i * force[0] + self.d_o * force[1] + self.d_s * force[2]


class GyroG2Sensitivity(Gyro, SignalEffect):
    """signal + D_II f_I² + D_OO f_O² + D_SS f_S² + D_IO f_I f_O + D_OS f_O f_S + D_SI f_S f_I.

    In a 1 g field f_I² + f_O² + f_S² = g², so that the common part of the three squares is a bias.
    """

    name = "gyro_g2_sensitivity"
    order = Order.SENSITIVITY
    confused_with = "the bias: D_II, D_OO and D_SS together, in a 1 g field; table_axis_tilt"
    reference = "IEEE Std 517, D_II … D_SI; 0.01 … 20 deg/h/g²"
    d_ii: Scalar = parameter(
        "deg/h/g^2", "normal(0, 10 deg/h/g^2)", (0.01, 20), "the drift per g² along I", coarse=(30, 100)
    )
    d_oo: Scalar = parameter(
        "deg/h/g^2", "normal(0, 10 deg/h/g^2)", (0.01, 20), "the drift per g² along O", coarse=(30, 100)
    )
    d_ss: Scalar = parameter(
        "deg/h/g^2", "normal(0, 10 deg/h/g^2)", (0.01, 20), "the drift per g² along S", coarse=(30, 100)
    )
    d_io: Scalar = parameter(
        "deg/h/g^2", "normal(0, 10 deg/h/g^2)", (0.01, 20), "the drift per g² along I and O", coarse=(30, 100)
    )
    d_os: Scalar = parameter(
        "deg/h/g^2", "normal(0, 10 deg/h/g^2)", (0.01, 20), "the drift per g² along O and S", coarse=(30, 100)
    )
    d_si: Scalar = parameter(
        "deg/h/g^2", "normal(0, 10 deg/h/g^2)", (0.01, 20), "the drift per g² along S and I", coarse=(30, 100)
    )

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        f_i, f_o, f_s = sample.force[0], sample.force[1], sample.force[2]
        squares = self.d_ii * f_i**2 + self.d_oo * f_o**2 + self.d_ss * f_s**2
        return signal + squares + self.d_io * f_i * f_o + self.d_os * f_o * f_s + self.d_si * f_s * f_i


class GyroScaleAsymmetry(Gyro, ScaleAsymmetry):
    name = "gyro_scale_asymmetry"
    confused_with = "gyro_scale_quadratic, where few rates are tested; a bias, at one rate"
    reference = "IEEE Std 952, asymmetry error; 10 … 300 ppm"
    asymmetry: Scalar = parameter(
        "ppm", "normal(0, 100 ppm)", (10, 300), "half the scale factor difference", coarse=(1000, 3000)
    )


class GyroScaleQuadratic(Gyro, SecondOrderNonlinearity):
    """Second-order nonlinearity: signal + K2·Ω².

    Even in rate: the error has the same sign in both directions; 25 … 50 ppm at 200 … 400 °/s is 0.1 ppm/(°/s).
    """

    name = "gyro_scale_quadratic"
    confused_with = "gyro_scale_asymmetry, where few rates are tested; g-sensitivity to centripetal acceleration"
    reference = "IEEE Std 952, scale factor nonlinearity; 25 … 50 ppm at 200 … 400 °/s"
    quadratic: Scalar = parameter(
        "ppm/(deg/s)", "normal(0, 1 ppm/(deg/s))", (0.01, 1), "the coefficient K2", coarse=(5, 20)
    )


class GyroScaleCubic(Gyro, ThirdOrderNonlinearity):
    """Third-order nonlinearity: signal + K3·Ω³.

    50 ppm at 400 °/s is 3·10⁻⁴ ppm/(°/s)².
    """

    name = "gyro_scale_cubic"
    confused_with = "the scale factor, over a narrow range of rates; saturation near full scale"
    reference = "IEEE Std 952, scale factor nonlinearity; 25 … 50 ppm at 200 … 400 °/s"
    cubic: Scalar = parameter(
        "ppm/(deg/s)^2", "normal(0, 0.005 ppm/(deg/s)^2)", (1e-5, 1e-2), "the coefficient K3", coarse=(0.05, 1)
    )


class GyroScaleGDependence(Gyro, SignalEffect):
    """Scale factor linear in specific force: signal + S_g·f_I·Ω."""

    name = "gyro_scale_g_dependence"
    order = Order.SENSITIVITY
    confused_with = "the scale factor, where the angle between input axis and gravity is constant"
    reference = "IEEE Std 952, scale factor acceleration sensitivity; 1 … 100 ppm/g"
    dependence: Scalar = parameter(
        "ppm/g", "normal(0, 50 ppm/g)", (1, 100), "the relative change of scale per g", coarse=(200, 1000)
    )

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.dependence * sample.force[0] * sample.rate[0]


class GyroMagneticSensitivity(Gyro, SignalEffect):
    """Drift linear in the magnetic field: signal + M_I B_I + M_O B_O + M_S B_S.

    The field is constant in the local level frame and is rotated into the unit's axes; set it to the field measured at
    the test place.  In a free tumble it acts as far as the heading is determined.
    """

    name = "gyro_magnetic_sensitivity"
    order = Order.SENSITIVITY
    confused_with = "g-sensitivity and misalignment: field, gravity and Earth rate are nearly coplanar"
    reference = "IEEE Std 952, magnetic sensitivity; 1 … 50 deg/h/gauss without a shield"
    m_i: Scalar = parameter(
        "deg/h/gauss", "normal(0, 20 deg/h/gauss)", (0.1, 50), "the drift per gauss along I", coarse=(200, 1000)
    )
    m_o: Scalar = parameter(
        "deg/h/gauss", "normal(0, 20 deg/h/gauss)", (0.1, 50), "the drift per gauss along O", coarse=(200, 1000)
    )
    m_s: Scalar = parameter(
        "deg/h/gauss", "normal(0, 20 deg/h/gauss)", (0.1, 50), "the drift per gauss along S", coarse=(200, 1000)
    )
    north_uT: float = option(25.0, "the field towards true North, µT")
    east_uT: float = option(0.0, "the field towards East, µT")
    up_uT: float = option(-40.0, "the field upwards, µT; negative in the northern hemisphere")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        east = cross(sample.north, sample.up)
        level = self.east_uT * east + self.north_uT * sample.north + self.up_uT * sample.up
        field = level * _TESLA_PER_UT
        return signal + self.m_i * field[0] + self.m_o * field[1] + self.m_s * field[2]


class GyroOutputAxisAcceleration(Gyro, SignalEffect):
    """Drift linear in angular acceleration: signal + k·dω_O/dt.

    For a single-degree-of-freedom gyro k is the float's moment of inertia over the wheel's angular momentum.
    """

    name = "gyro_output_axis_acceleration"
    order = Order.SENSITIVITY
    confused_with = "time_skew, between table and unit"
    reference = "IEEE Std 517, output-axis angular acceleration; 0.1 … 10 ms"
    coefficient: Scalar = parameter("ms", "normal(0, 5 ms)", (0.01, 50), "the rate per angular acceleration")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.coefficient * sample.acceleration[1]
