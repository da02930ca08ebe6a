"""The effects: one physical cause each.  A new effect is one class with a `name` in the module of its family.

The catalogue lists the families in the order of the signal path, each in the order of its definitions.
"""

from imubayes.effects import (
    accelerometer,
    converter,
    gyro_bias_and_scale,
    gyro_sensitivities,
    mounting,
    outer_axes,
    reference_gyro,
    table,
    thermometer,
)
from imubayes.effects.base import Effect, MotionEffect, Order, PlaceEffect, RecordEffect, SignalEffect, Stage
from imubayes.parameters.parameter_declarations import named_in

FAMILIES = (
    table,
    outer_axes,
    reference_gyro,
    thermometer,
    mounting,
    gyro_sensitivities,
    gyro_bias_and_scale,
    accelerometer,
    converter,
)
EFFECTS: tuple[type[Effect], ...] = tuple(effect for family in FAMILIES for effect in named_in(family, Effect))

__all__ = ["EFFECTS", "Effect", "MotionEffect", "Order", "PlaceEffect", "RecordEffect", "SignalEffect", "Stage"]
