"""Small campaigns that show every effect: two tables, two mountings, a ramp and an injection, outputs by the model.

Made of records, not of files: these tests are about the floors below the reader.
"""

from dataclasses import replace
from functools import cache

import jax.numpy as jnp
import numpy as np

from imubayes.effects.base import Effect
from imubayes.foundations.campaign_data import Campaign, Channel, Mounting, Run, Site, Table, Tumble
from imubayes.foundations.earth import normal_gravity
from imubayes.model.bind import Model, bind
from imubayes.model.effect_registry import Registry
from imubayes.model.model_file import EffectSpec, ModelSpec
from imubayes.model.problem import predict

LATITUDE, HEIGHT = np.radians(34.25), 400.0
GRAVITY = normal_gravity(LATITUDE, HEIGHT)
DEGREE, ARCSEC = np.pi / 180, np.pi / 648000
GYRO_SCALE, ACCEL_SCALE = 1000.0 / DEGREE, 2000.0 / GRAVITY  # pulse/s per rad/s and per m/s²


def _axes(first: int) -> np.ndarray:
    return np.eye(3)[[first, (first + 1) % 3, (first + 2) % 3]]


def channels() -> tuple[Channel, ...]:
    gyros = [
        Channel(f"g{axis}", "gyro", _axes(i), "pulse/s", 1000.0, "deg/s", GYRO_SCALE, offset=3.0 * i, noise=0.5)
        for i, axis in enumerate("xyz")
    ]
    accels = [
        Channel(
            f"a{axis}", "accelerometer", _axes(i), "pulse/s", 2000.0, "g", ACCEL_SCALE,
            noise=0.05, current_per_acceleration=1.2e-3 / GRAVITY,
        )
        for i, axis in enumerate("xyz")
    ]  # fmt: skip
    return (*gyros, *accels)


def _run(name: str, procedure: str, table: str | None, mounting: str | None, rows: int, **columns) -> Run:
    zero = np.zeros(rows)
    covariates = {"table_rate": zero, "table_angle": zero, "table_angle_span": zero, **columns}
    filled = {key: np.broadcast_to(np.asarray(value, dtype=float), (rows,)).copy() for key, value in covariates.items()}
    shape = (rows, 6)
    return Run(name, procedure, table, mounting, filled, np.zeros(shape), np.full(rows, 100), np.full(shape, np.nan))


def _rate(name: str, mounting: str, temperature: float) -> Run:
    rates = np.array([0, 100, -100, 20, -20, 0]) * DEGREE
    angle = np.where(rates != 0, np.nan, 0.0)
    span = np.where(rates != 0, 2 * np.pi, 0.0)
    return _run(
        name, "rate_table", "rate", mounting, 6,
        table_rate=rates, table_angle=angle, table_angle_span=span,
        temperature=temperature, converter_temperature=temperature + 5,
    )  # fmt: skip


def _head(name: str, mounting: str, temperature: float) -> Run:
    angle = np.arange(8) * np.pi / 4 + 0.1
    return _run(
        name, "dividing_head", "head", mounting, 8,
        table_angle=angle, temperature=temperature, converter_temperature=temperature - 3,
    )  # fmt: skip


def campaign() -> Campaign:
    """Return the campaign without outputs."""
    root = np.sqrt
    azimuth = np.arange(3) * 2 * np.pi / 3
    pyramid = np.array([root(2 / 3) * np.cos(azimuth), root(2 / 3) * np.sin(azimuth), np.full(3, 1 / root(3))])
    runs = [
        _rate("rate-flat", "flat", 25.0),
        _rate("rate-pyramid", "pyramid", 35.0),
        _rate("rate-x-up", "x-up", 20.0),
        *(_head(f"head-{seat}-{t}", seat, float(t)) for seat in ("flat", "x-up", "pyramid") for t in (20, 45)),
        _run(
            "ramp", "thermal_ramp", "head", "flat", 6,
            table_angle=0.4, temperature=30.0, converter_temperature=np.linspace(20, 55, 6), time=np.arange(6) * 600.0,
        ),
        _injection("inject", 12.0),
        _injection("inject-low", 2.0),
    ]  # fmt: skip
    x_up = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    return Campaign(
        "small",
        Site(LATITUDE, HEIGHT, GRAVITY),
        channels(),
        {
            "rate": Table("rate", 0.0, np.pi / 2, 20 * ARCSEC, 5e-6, ARCSEC),
            "head": Table("head", 0.3, 0.0, 20 * ARCSEC, 5e-6, ARCSEC),
        },
        {
            "flat": Mounting("flat", np.eye(3), 300 * ARCSEC),
            "pyramid": Mounting("pyramid", pyramid, 300 * ARCSEC),
            "x-up": Mounting("x-up", x_up, 300 * ARCSEC),
        },
        tuple(runs),
    )


def wide_campaign() -> Campaign:
    """Return the campaign with what few records carry: temperature cycles, time since power-on, vibration, dates."""
    base = campaign()
    minutes = np.arange(16) * 240.0
    cycle = 30 + 20 * np.interp(np.arange(16), [0, 5, 8, 13, 15], [-1.0, 1.0, 1.0, -1.0, -0.8])
    slow = 25 + 12 * np.sin(np.arange(16) / 4)
    warming = [
        _run(
            f"cycle-{name}", "thermal_ramp", "head", "flat", 16,
            table_angle=angle, temperature=temperature, converter_temperature=temperature + 4,
            time=minutes, power_on=minutes + 60,
        )
        for name, angle, temperature in (("fast", 0.4, cycle), ("slow", 1.9, slow), ("up", 3.4, cycle[::-1]))
    ]  # fmt: skip
    angle = np.linspace(0.3, 6.0, 8)
    rates = np.array([40, -40, 80, -80, 40, -40, 80, -80]) * DEGREE
    swept = _run(
        "swept", "rate_table", "head", "x-up", 8,
        table_rate=rates, table_angle=angle, table_angle_span=rates * 0.05, time=np.arange(8) * 60.0,
        table_acceleration=np.array([1, -1, -1, 1, 2, -2, 1, 1]) * 200 * DEGREE,
    )  # fmt: skip
    moving = _run(
        "moving", "rate_table", "head", "x-up", 8,
        table_rate=rates, table_angle=angle, table_angle_span=rates * 0.05, time=np.arange(8) * 0.05,
        table_acceleration=np.array([1, -1, -1, 1, 2, -2, 1, 1]) * 200 * DEGREE, row_seconds=np.full(8, 0.05),
    )  # fmt: skip
    shaken = _run("shaken", "dividing_head", "head", "flat", 4, table_angle=0.2, vibration=np.arange(4) * 20.0)
    dated = [
        replace(run, start=f"2026-03-1{day}T08:00:00+00:00") for day, run in enumerate([*warming, swept])
    ]  # fmt: skip
    runs = (*base.runs[:9], *dated, shaken, moving, *base.runs[9:])
    return replace(base, name="wide", runs=tuple(map(_known, runs, range(len(runs)))))


def _known(run: Run, number: int) -> Run:
    """Return a run with time, date and temperatures, which every run has."""
    least = {"time": np.arange(run.rows) * 60.0} | dict.fromkeys(
        ("temperature", "converter_temperature"), np.full(run.rows, 25.0)
    )
    return replace(
        run, covariates=least | dict(run.covariates), start=run.start or f"2026-03-0{number % 9 + 1}T12:00:00+00:00"
    )


def referenced_campaign() -> Campaign:
    """Return the campaign with two runs beside a reference gyro, whose rate wanders."""
    base = campaign()
    time = np.arange(12) * 2.0
    wander = np.array([1.0, -1.0])[:, None] * DEGREE * (40 + 3 * np.sin(time / 3.0))
    runs = [
        _run(
            f"beside-{seat}-{way}", "reference_gyro", "rate", seat, 12,
            table_angle=np.nan, table_angle_span=2 * np.pi, time=time, temperature=25.0,
            **{f"reference_{axis}": wander[way] * axes["xyz".index(axis)] + 0.01 * DEGREE for axis in "xyz"},
        )
        for seat, axes in (("flat", (0, 0, 1)), ("x-up", (1, 0, 0))) for way in (0, 1)
    ]  # fmt: skip
    return replace(base, name="referenced", runs=(*base.runs[:5], *runs))


def serial_campaign() -> Campaign:
    """Return the campaign with a table of three axes, positions and turning about all of them, and a centrifuge."""
    base = campaign()
    turns = np.arange(16)
    posed = _run(
        "posed", "multi_axis_table", "gimbals", "flat", 16,
        outer_angle=turns * 0.9, middle_angle=turns * 2.1, table_angle=turns * 1.3,
    )  # fmt: skip
    rates = {f"{axis}_rate": DEGREE * size * np.cos(turns * k) for k, (axis, size) in enumerate(
        (("outer", 150.0), ("middle", 120.0), ("table", 90.0)), start=1)}  # fmt: skip
    spans = {f"{axis}_angle_span": np.full(16, 0.3) for axis in ("outer", "middle", "table")}
    turned = replace(posed, name="turned", covariates={**posed.covariates, **rates, **spans})
    arm = DEGREE * np.array([0, 200, 400, 500, 600, 0, 200, 400, 500, 600])
    spun = _run(
        "spun", "centrifuge", "arm", "flat", 10,
        outer_rate=arm, table_angle=np.where(np.arange(10) < 5, 0.2, 0.2 + np.pi / 2),
    )  # fmt: skip
    back = _run(
        "back", "centrifuge", "arm", "x-up", 10, outer_rate=arm, table_rate=-arm, table_angle=np.arange(10) // 5
    )
    tables = {
        "gimbals": Table(
            # About a vertical outer axis only the Earth rate shows its zero.
            "gimbals", 0.2, 0.4, 20 * ARCSEC, 5e-6, None, (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), 0.0,
            30 * ARCSEC, 30 * ARCSEC, 3e-4,
        ),
        "arm": Table(
            "arm", 0.0, np.pi / 2, 20 * ARCSEC, 5e-6, None, None, (0.0, 0.0, 1.0), 1.0, 30 * ARCSEC, 30 * ARCSEC,
            None, 3e-4,
        ),
    }  # fmt: skip
    runs = (*base.runs[:2], posed, turned, spun, back)
    return replace(base, name="serial", tables={**base.tables, **tables}, runs=runs)


def driven_campaign() -> Campaign:
    """Return a table that a gyro drives about the pole for a day and for a part of it, with a tumble beside it."""
    angle = Channel("table_angle", "angle", np.eye(3), "deg", 1.0, "deg", 1 / DEGREE, noise=1 / 3600)
    gyro = replace(channels()[0], per="deg/h")
    along = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    across = np.eye(3)

    def with_two(run: Run, read: int) -> Run:
        observed = np.full((run.rows, 2), np.nan)
        observed[:, read] = 0.0
        return replace(run, observed=observed, sample_sd=np.full((run.rows, 2), np.nan), samples=np.ones(run.rows))

    servos = [
        _run(
            name, "servo_table", "polar", "along", rows, time=np.linspace(0, hours * 3600, rows), temperature=25.0,
            table_angle=0.7 - 15.041 * DEGREE * np.linspace(0, hours, rows),
        )
        for name, hours, rows in (("day", 24.0, 60), ("part", 5.0, 20))
    ]  # fmt: skip
    tumble = _run("tumble", "polar_tumble", "polar", "across", 8, table_angle=np.arange(8) * np.pi / 4)
    return Campaign(
        "driven", Site(LATITUDE, HEIGHT, GRAVITY), (gyro, angle),
        {"polar": Table("polar", 0.0, LATITUDE, 20 * ARCSEC, None, ARCSEC)},
        {name: Mounting(name, seat, 300 * ARCSEC) for name, seat in (("along", along), ("across", across))},
        (*(with_two(run, 1) for run in servos), with_two(tumble, 0)),
    )  # fmt: skip


def directed_campaign() -> Campaign:
    """Return a campaign with a fine gyro at rest in positions named by directions, beside a run on a table."""
    toward = {"E": (1, 0, 0), "W": (-1, 0, 0), "N": (0, 1, 0), "S": (0, -1, 0), "U": (0, 0, 1), "D": (0, 0, -1)}
    pairs = ("EN", "ES", "EU", "ED", "WU", "WD", "UE", "UW", "DE", "NU", "ND", "SU", "SE")
    along, across = (np.array([toward[pair[k]] for pair in pairs], dtype=float) for k in (0, 1))
    gyro = replace(channels()[0], per="deg/h", noise=1e-4)
    at_rest = np.zeros((len(pairs), 1))
    run = Run(
        "positions", "geographic_tumble", None, None,
        {name: np.zeros(len(pairs)) for name in ("table_rate", "table_angle", "table_angle_span")},
        at_rest, np.full(len(pairs), 400), np.full_like(at_rest, np.nan),
        attitude=np.stack([along, across, np.cross(along, across)], axis=2) @ gyro.axes,
    )  # fmt: skip
    plain = campaign()
    beside = replace(plain.runs[0], observed=plain.runs[0].observed[:, :1], sample_sd=plain.runs[0].sample_sd[:, :1])
    return replace(plain, name="directed", channels=(gyro,), runs=(run, beside))


def anyhow_campaign() -> Campaign:
    """Return the campaign with a dividing head of which nobody states azimuth and level."""
    known = campaign()
    tables = {**known.tables, "head": replace(known.tables["head"], azimuth_known=False, axis_uncertainty=None)}
    return replace(known, name="anyhow", tables=tables)


def _injection(name: str, multiple: float) -> Run:
    run = _run(
        name, "current_injection", None, None, 4,
        current=multiple * 1.2e-3, converter_temperature=np.linspace(20, 50, 4),
    )  # fmt: skip
    observed = run.observed.copy()
    observed[:, :3] = np.nan  # a current goes into accelerometer channels alone
    return replace(run, observed=observed)


def tumble_campaign() -> Campaign:
    """Return a free tumble of five poses with the turns between them, without outputs."""
    poses = [(0.0, 0.0, 0.0), (1.5, 0.0, 0.0), (0.0, 1.5, 0.0), (0.0, -1.5, 0.3), (3.0, 0.0, 0.0)]
    attitude = np.stack([_rotation(np.array(pose)) for pose in poses])
    steps, transitions = 6, len(poses) - 1
    step = np.full((transitions, steps), 0.25)
    step[1, 5] = 0.0  # a shorter transition, padded
    readings = np.zeros((transitions, steps, 6))
    for k in range(transitions):
        turn = _vector(attitude[k].T @ attitude[k + 1])
        rate = turn / step[k].sum()
        readings[k, :, :3] = rate * GYRO_SCALE + np.array([0.0, 3.0, 6.0])
        readings[k, :, 3:] = attitude[k][2] * GRAVITY * ACCEL_SCALE
    tumble = Tumble(
        np.arange(len(poses)), attitude, np.arange(transitions), np.arange(1, transitions + 1), step, readings,
        np.zeros((transitions, steps, 3)), np.zeros(len(poses), dtype=bool),
    )  # fmt: skip
    rows = len(poses)
    run = Run(
        "tumble", "free_tumble", None, None, {"time": np.arange(rows) * 30.0, "temperature": np.full(rows, 25.0)},
        np.zeros((rows, 6)), np.full(rows, 100), np.full((rows, 6), np.nan), tumble=tumble,
    )  # fmt: skip
    return Campaign("tumble", Site(LATITUDE, HEIGHT, GRAVITY), channels(), {}, {}, (run,))


def _rotation(vector: np.ndarray) -> np.ndarray:
    angle = float(np.linalg.norm(vector))
    if angle == 0:
        return np.eye(3)
    x, y, z = vector / angle
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * skew @ skew


def _vector(matrix: np.ndarray) -> np.ndarray:
    angle = np.arccos(np.clip((np.trace(matrix) - 1) / 2, -1, 1))
    skew = np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]])
    return skew * (0.5 if angle == 0 else angle / (2 * np.sin(angle)))


def spec(*names: str, noise: tuple[str, ...] = ("white_noise",)) -> ModelSpec:
    """Return a model of the named effects and white noise."""
    return ModelSpec("small", tuple(EffectSpec(name, where=f"model: {name}") for name in (*names, *noise)))


TABLE_EFFECTS = (
    "table_axis_tilt", "table_rate_error", "mounting_error", "lever_arm", "gyro_misalignment", "gyro_g_sensitivity",
    "gyro_bias", "gyro_bias_temperature", "gyro_run_bias", "gyro_scale_factor", "gyro_scale_temperature",
    "accel_misalignment", "accel_quadratic", "accel_bias", "accel_bias_temperature", "accel_run_bias",
    "accel_scale_factor", "accel_scale_temperature", "injection_error", "converter_gain_drift",
    "converter_offset_drift",
)  # fmt: skip
"""The effects of a usual model of a unit on tables."""


def simulated(model: Model, z: np.ndarray, seed: int) -> Campaign:
    """Return the model's campaign with outputs at z and white noise as its channels state."""
    rng = np.random.default_rng(seed)
    predicted = np.asarray(predict(model.problem, z))
    entries, runs = model.entries, [replace(r, observed=r.observed.copy()) for r in model.campaign.runs]
    noise = np.array([channel.noise for channel in model.campaign.channels])
    for value, run, row, channel, samples, closing in zip(
        predicted, entries.run, entries.row, entries.channel, entries.samples, entries.closing, strict=True
    ):
        if not closing:
            runs[run].observed[row, channel] = value + noise[channel] / np.sqrt(samples) * rng.standard_normal()
    return replace(model.campaign, runs=tuple(runs))


def in_wide_campaign() -> list[type[Effect]]:
    """Return the effects that the wide campaign can show."""
    elsewhere = {"reference", "driven", "directions", "outer_angle", "middle_angle", "hand", "carried"}
    effects = [one for one in Registry().effects.values() if issubclass(one, Effect) and not one.nuisance]
    return [one for one in effects if not elsewhere & set(one.needs)]


@cache
def whole_catalogue() -> Model:
    """Return all of these in one model, compiled once for the tests of each of them."""
    return bind(spec(*(one.name for one in in_wide_campaign())), wide_campaign())


@cache
def at_null() -> np.ndarray:
    """Return z of all effects on the wide campaign at their nulls, shapes at the middle of their priors."""
    one = whole_catalogue()
    declared = {effect.name: effect.declared for effect in one.assembly.effects}
    truth = np.array([float(p.prior.value(jnp.asarray(0.0))) / p.factor for p in one.layout.parameters])
    for place, parameter in enumerate(one.layout.parameters):
        if not declared[parameter.name.partition(".")[0]][parameter.field].shape:
            truth[place] = 1e-12 if truth[place] else 0.0
    return one.layout.z_of(truth)


def predicted_with(name: str, label: str, **values: float) -> np.ndarray:
    """Return what every entry of the wide campaign reads with one effect at work on what is labelled, output units.

    All others are in the model, at their nulls.  A parameter that is not given is at the middle of its prior.
    """
    one, z = whole_catalogue(), at_null().copy()
    for place, parameter in enumerate(one.layout.parameters):
        if parameter.name.startswith(f"{name}.") and parameter.label in ((label,), ("head",), ("rate",), ("all",)):
            z[place] = (
                parameter.prior.z(values[parameter.field] * parameter.factor) if parameter.field in values else 0.0
            )
    return np.asarray(predict(one.problem, jnp.asarray(z)))


@cache
def full_model() -> Model:
    """Return the usual effects of a campaign on tables in one model."""
    chosen = tuple(name for name in TABLE_EFFECTS if not name.endswith("_run_bias"))
    return bind(spec(*chosen, noise=("white_noise", "run_scatter")), campaign())
