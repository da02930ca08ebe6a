"""The effects that a drawn campaign may hide: where each acts, how large it typically is, and which plans show it."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

Draw = Callable[[np.random.Generator], float]


def between(low: float, high: float) -> Draw:
    """Log-uniform."""
    return lambda generator: float(np.exp(generator.uniform(np.log(low), np.log(high))))


def one_of(*values: float) -> Draw:
    return lambda generator: float(generator.choice(values))


@dataclass(frozen=True)
class Kind:
    """What an effect may act on, and how large it typically is.

    Attributes
    ----------
    on : gyro, accelerometer, any (channels), head (a table that is read at its angles), axes (those of a table of
        several, or a centrifuge), or station.
    sizes : coefficient → typical size in its unit; half widths are positive.
    shapes : parameters of shape → how they are drawn.
    templates : the plans that can show it; empty for all.
    """

    on: str
    sizes: dict[str, float]
    shapes: dict[str, Draw] = field(default_factory=dict)
    templates: tuple[str, ...] = ()


_THERMAL = ("cycle", "gyros", "static_record")
_WARM = ("cycle", "gyros", "temperatures", "head", "rate_table", "polar_tumble", "geographic_tumble")
_CONVERTER = ("converter", "converter_cycle", "thermal_ramp")
_CYCLES = ("converter_cycle", "thermal_ramp")
_TAU = between(4.0, 40.0)
_PLAY = between(1.0, 6.0)
_SERIAL = ("multi_axis_table", "centrifuge")
_PHASE: Draw = lambda generator: float(generator.uniform(0, 360))  # noqa: E731

CATALOGUE: dict[str, Kind] = {
    "gyro_scale_asymmetry": Kind("gyro", {"asymmetry": 100.0}),
    "gyro_scale_quadratic": Kind("gyro", {"quadratic": 0.5}),
    "gyro_scale_cubic": Kind("gyro", {"cubic": 0.003}),
    "gyro_g_sensitivity": Kind("gyro", {"d_i": 5.0, "d_o": 5.0, "d_s": 5.0}),
    "gyro_g2_sensitivity": Kind("gyro", {f"d_{pair}": 5.0 for pair in ("ii", "oo", "ss", "io", "os", "si")}),
    "gyro_scale_g_dependence": Kind("gyro", {"dependence": 50.0}),
    "gyro_bias_temperature": Kind("gyro", {"slope": 0.2}, templates=_WARM),
    "gyro_bias_temperature_quadratic": Kind("gyro", {"curvature": 0.01}, templates=_WARM),
    "gyro_bias_temperature_cubic": Kind("gyro", {"coefficient": 4e-4}, templates=_WARM),
    "gyro_bias_temperature_rate": Kind("gyro", {"slope": 10.0}, templates=_THERMAL),
    "gyro_thermal_lag": Kind("gyro", {"coefficient": 1.0}, {"tau": _TAU}, _THERMAL),
    "gyro_thermal_hysteresis": Kind("gyro", {"half_width": 10.0}, {"play": _PLAY}, ("cycle",)),
    "gyro_warm_up": Kind("gyro", {"amplitude": 10.0}, {"tau": _TAU}, _THERMAL),
    "gyro_scale_temperature": Kind("gyro", {"slope": 10.0}, templates=("temperatures", "gyros")),
    "gyro_scale_temperature_quadratic": Kind("gyro", {"curvature": 0.5}, templates=("temperatures", "gyros")),
    "gyro_bias_drift": Kind("gyro", {"slope": 1.0}),
    "gyro_dead_zone": Kind("gyro", {"half_width": 5.0}),
    "accel_quadratic": Kind("accelerometer", {"quadratic": 20.0}),
    "accel_cubic": Kind("accelerometer", {"cubic": 20.0}),
    "accel_odd_quadratic": Kind("accelerometer", {"odd_quadratic": 20.0}),
    "accel_cross_coupling": Kind("accelerometer", {"k_ip": 20.0, "k_io": 20.0}),
    "accel_cross_axis_quadratic": Kind("accelerometer", {"k_oo": 20.0, "k_pp": 20.0}),
    "accel_scale_asymmetry": Kind("accelerometer", {"asymmetry": 50.0}),
    "accel_bias_temperature": Kind("accelerometer", {"slope": 20.0}, templates=_WARM),
    "accel_bias_temperature_quadratic": Kind("accelerometer", {"curvature": 0.5}, templates=_WARM),
    "accel_bias_temperature_cubic": Kind("accelerometer", {"coefficient": 0.02}, templates=_WARM),
    "accel_bias_temperature_rate": Kind("accelerometer", {"slope": 100.0}, templates=_THERMAL),
    "accel_thermal_lag": Kind("accelerometer", {"coefficient": 30.0}, {"tau": _TAU}, _THERMAL),
    "accel_thermal_hysteresis": Kind("accelerometer", {"half_width": 300.0}, {"play": _PLAY}, ("cycle",)),
    "accel_warm_up": Kind("accelerometer", {"amplitude": 200.0}, {"tau": _TAU}, _THERMAL),
    "accel_scale_temperature": Kind("accelerometer", {"slope": 20.0}, templates=_WARM),
    "accel_scale_temperature_quadratic": Kind("accelerometer", {"curvature": 0.5}, templates=_WARM),
    "accel_bias_drift": Kind("accelerometer", {"slope": 10.0}),
    "accel_dead_zone": Kind("accelerometer", {"half_width": 20.0}),
    "converter_gain_drift": Kind("accelerometer", {"slope": 10.0}, templates=_CONVERTER),
    "converter_gain_drift_quadratic": Kind("accelerometer", {"curvature": 0.5}, templates=_CONVERTER),
    "converter_offset_drift": Kind("accelerometer", {"slope": 0.5}, templates=_CONVERTER),
    "converter_offset_drift_quadratic": Kind("accelerometer", {"curvature": 0.02}, templates=_CONVERTER),
    "converter_nonlinearity": Kind("accelerometer", {"quadratic": 5e-4, "cubic": 2.5e-9}, templates=_CONVERTER),
    "converter_leakage": Kind("accelerometer", {"leakage": 1.0}, {"doubling": between(7.0, 14.0)}, _CONVERTER),
    "converter_gain_temperature_rate": Kind("accelerometer", {"slope": 100.0}, templates=_CYCLES),
    "converter_gain_lag": Kind("accelerometer", {"coefficient": 10.0}, {"tau": _TAU}, _CYCLES),
    "converter_gain_hysteresis": Kind("accelerometer", {"half_width": 50.0}, {"play": _PLAY}, _CYCLES),
    "converter_offset_temperature_rate": Kind("accelerometer", {"slope": 5.0}, templates=_CYCLES),
    "converter_offset_lag": Kind("accelerometer", {"coefficient": 0.5}, {"tau": _TAU}, _CYCLES),
    "converter_offset_hysteresis": Kind("accelerometer", {"half_width": 2.0}, {"play": _PLAY}, _CYCLES),
    "converter_dead_zone": Kind("accelerometer", {"half_width": 1.0}, templates=_CONVERTER),
    "lever_arm": Kind("accelerometer", {"x": 10.0, "y": 10.0, "z": 10.0}),
    "encoder_harmonic": Kind("head", {f"{part}_{n}": 3.0 for n in (1, 2) for part in ("sin", "cos")}),
    "table_wobble": Kind(
        "head", {f"{axis}_{part}_{n}": 3.0 for n in (1, 2) for axis in "xy" for part in ("cos", "sin")}
    ),
    "table_axis_tilt": Kind("head", {"x": 60.0, "y": 60.0}),
    "outer_axis_zero": Kind("axes", {"zero": 20.0}, templates=("multi_axis_table",)),
    "middle_axis_zero": Kind("axes", {"zero": 20.0}, templates=("multi_axis_table",)),
    "inner_axis_zero": Kind("axes", {"zero": 20.0}, templates=_SERIAL),
    "outer_axis_squareness": Kind("axes", {"angle": 20.0}, templates=("multi_axis_table",)),
    "middle_axis_squareness": Kind("axes", {"angle": 20.0}, templates=("multi_axis_table",)),
    "outer_axis_intersection": Kind("axes", {"distance": 100.0}, templates=("multi_axis_table",)),
    "middle_axis_intersection": Kind("axes", {"distance": 100.0, "along": 100.0}, templates=("multi_axis_table",)),
    "platform_tilt": Kind("axes", {"x": 10.0, "y": 10.0}, templates=("centrifuge",)),
    "arm_error": Kind("axes", {"radius": 50.0, "stretch": 5.0}, templates=("centrifuge",)),
    "station_heading": Kind("station", {"heading": 300.0}, templates=("geographic_tumble",)),
    "station_level": Kind("station", {"east": 60.0, "north": 60.0}, templates=("geographic_tumble",)),
}
EQUIPMENT = ("head", "axes", "station")
"""What is no channel."""
HEADS = ("head", "polar", "rotary")
"""Tables that are read at their angles."""
OUTSIDE: dict[str, Kind] = {
    "outside_resonance": Kind(
        "gyro", {"amplitude": 5.0}, {"centre": between(20.0, 150.0), "width": between(5.0, 20.0)}
    ),
    "outside_root_rate": Kind("gyro", {"amplitude": 1.0}),
    "outside_temperature_wave": Kind(
        "any", {"amplitude": 20.0}, {"period": between(8.0, 20.0), "phase": _PHASE}, _THERMAL
    ),
    "outside_angle_harmonic": Kind(
        "any", {"amplitude": 20.0}, {"order": one_of(3, 5), "phase": _PHASE}, ("head", "table", "cycle")
    ),
    "outside_step": Kind(
        "any", {"amplitude": 20.0}, {"progress": lambda generator: float(generator.uniform(0.3, 0.7))}
    ),
    "outside_threshold": Kind(
        "accelerometer", {"amplitude": 50.0}, {"width": between(0.1, 0.4)}, ("head", "table", "cycle")
    ),
}
ALL = CATALOGUE | OUTSIDE
