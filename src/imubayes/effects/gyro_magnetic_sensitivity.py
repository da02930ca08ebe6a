"""Gyro that answers to the Earth's magnetic field."""

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.frames import cross
from imubayes.parameters.parameter import option, parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar

_TESLA_PER_UT = 1e-6


class GyroMagneticSensitivity(SignalEffect):
    """Drift linear in the magnetic field: signal + M_I B_I + M_O B_O + M_S B_S.

    The field is that of the test place, constant in the local level, and turns through the unit with its attitude; set
    it to what a magnetometer shows there.  In a free tumble it is felt as far as the heading is known.
    """

    name = "gyro_magnetic_sensitivity"
    stage, order = Stage.SENSOR, Order.SENSITIVITY
    kinds = ("gyro",)
    confused_with = (
        "g-sensitivity, and misalignment against the Earth's rotation: field, gravity and Earth rate lie near one plane"
    )
    reference = "IEEE Std 952, magnetic sensitivity; 1 … 50 deg/h/gauss without a shield"

    m_i: Scalar = parameter(
        "deg/h/gauss", "normal(0, 20 deg/h/gauss)", (0.1, 50), "the drift per gauss along the input axis"
    )
    m_o: Scalar = parameter(
        "deg/h/gauss", "normal(0, 20 deg/h/gauss)", (0.1, 50), "the drift per gauss along the output axis"
    )
    m_s: Scalar = parameter(
        "deg/h/gauss", "normal(0, 20 deg/h/gauss)", (0.1, 50), "the drift per gauss along the spin axis"
    )
    north_uT: float = option(25.0, "the field towards true North, µT")
    east_uT: float = option(0.0, "the field towards East, µT")
    up_uT: float = option(-40.0, "the field upwards, µT; negative in the northern hemisphere")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        east = cross(sample.north, sample.up)
        level = self.east_uT * east + self.north_uT * sample.north + self.up_uT * sample.up
        field = level * _TESLA_PER_UT
        return signal + self.m_i * field[0] + self.m_o * field[1] + self.m_s * field[2]
