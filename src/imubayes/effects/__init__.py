"""The effects: one physical cause each.  A new effect is one class with a `name` in the module of its family.

The catalogue lists the families in the order of the signal path, each in the order of its definitions.
"""

from imubayes.effects import accelerometer, converter, gyro, mounting, table, thermometer
from imubayes.effects.base import Effect, MotionEffect, Order, PlaceEffect, RecordEffect, SignalEffect, Stage
from imubayes.parameters.declarations import named_in

FAMILIES = (table, mounting, thermometer, gyro, accelerometer, converter)
EFFECTS: tuple[type[Effect], ...] = tuple(effect for family in FAMILIES for effect in named_in(family, Effect))

__all__ = ["EFFECTS", "Effect", "MotionEffect", "Order", "PlaceEffect", "RecordEffect", "SignalEffect", "Stage"]
