"""Result folders made up for tests: right in form and plausible in size, out of plain NumPy."""

import math
from pathlib import Path

import numpy as np
import polars as pl
import xarray as xr

from imubayes.inference.candidate_runs import RunDesign
from imubayes.results.result import Residuals
from imubayes.results.summary import (
    CombinationSummary,
    DerivedSummary,
    NextRun,
    ParameterSummary,
    RunSummary,
    Seconds,
    Summary,
    WeakDirection,
)
from kept_results import listed

GYROS, ACCELEROMETERS = ("gx", "gy", "gz"), ("ax", "ay", "az")
CHANNELS = (*GYROS, *ACCELEROMETERS)
MOUNTINGS = ("x-up", "y-up", "z-up", "pyramid")
_RATES = (0, 300, -300, 150, -150, 60, -60, 20, -20, 10, -10, 1, -1, 0)
_ANGLES = tuple(range(0, 360, 15))
_SCALE = {**dict.fromkeys(GYROS, 1000.0), **dict.fromkeys(ACCELEROMETERS, 20000.0)}
_NOISE = {"gx": 0.33, "gy": 0.25, "gz": 0.19, "ax": 0.055, "ay": 0.062, "az": 0.06}
_SCATTER = {**dict.fromkeys(GYROS, 0.8), **dict.fromkeys(ACCELEROMETERS, 0.2)}


def unit_of(channel: str) -> str:
    return "deg/s" if channel.startswith("g") else "g"


def rows_of(run: str, procedure: str, covariates: dict, inputs: dict, random, planted=None) -> pl.DataFrame:
    """Return residual rows of one run; `planted` adds to the residual of a channel, in sd."""
    count = len(next(iter(inputs.values())))
    frames = []
    for channel, value in inputs.items():
        scale = _SCALE.get(channel, 1000.0)
        noise, scatter = _NOISE.get(channel, 0.2), _SCATTER.get(channel, 0.3)
        sd = np.full(count, np.hypot(noise, scatter))
        white = random.standard_normal(count)
        offset = scatter * random.standard_normal()
        extra = np.zeros(count) if planted is None else planted.get(channel, np.zeros(count))
        residual = offset + noise * (white + extra)
        predicted = scale * value
        frames.append(
            pl.DataFrame(
                {
                    "run": [run] * count,
                    "procedure": [procedure] * count,
                    "row": np.arange(count),
                    "channel": [channel] * count,
                    "kind": ["gyro" if channel.startswith("g") else "accelerometer"] * count,
                    **{name: np.asarray(values, float) for name, values in covariates.items()},
                    "samples": np.full(count, 1200),
                    "observed": predicted + residual,
                    "predicted": predicted,
                    "sd": sd,
                    "model_sd": 0.3 * sd,
                    "residual": residual,
                    "output_unit": ["pulse/s"] * count,
                    "input_observed": (predicted + residual) / scale,
                    "input_residual": residual / scale,
                    "input_sd": sd / scale,
                    "input_unit": [unit_of(channel)] * count,
                    "whitened": white + extra,
                }
            )
        )
    frame = pl.concat(frames)
    for name in ("power_on_s", "table_rate_deg_s", "table_angle_deg", "temperature_degC"):
        if name not in frame.columns:
            frame = frame.with_columns(pl.lit(None, dtype=pl.Float64).alias(name))
    for name in ("converter_temperature_degC", "current_mA"):
        if name not in frame.columns:
            frame = frame.with_columns(pl.lit(None, dtype=pl.Float64).alias(name))
    return frame.select(sorted(frame.columns))


def trihedral_residuals(temperatures=(-10, 25, 55), channels=CHANNELS, planted=False, seed=1) -> pl.DataFrame:
    random = np.random.default_rng(seed)
    frames = []
    for place, temperature in enumerate(temperatures):
        label = f"{temperature}C".replace("-", "minus")
        for mounting in MOUNTINGS:
            rates = np.array(_RATES, float)
            count = len(rates)
            share = {"pyramid": (0.577, 0.577, 0.577)}.get(mounting) or tuple(
                1.0 if m == mounting else 0.001 for m in MOUNTINGS[:3]
            )
            inputs = dict(zip(GYROS, (s * rates for s in share), strict=True))
            inputs |= dict(zip(ACCELEROMETERS, (s + 0 * rates for s in share), strict=True))
            extra = {c: 6 * np.abs(rates) / 300 for c in GYROS} if planted else None
            covariates = {
                "time_s": 30 + 80.0 * np.arange(count),
                "power_on_s": 30 + 80.0 * np.arange(count) + 3600 * len(frames),
                "table_rate_deg_s": rates,
                "table_angle_deg": np.where(rates == 0, 0.0, np.nan),
                "temperature_degC": temperature + 0.2 * random.standard_normal(count),
            }
            kept = {name: inputs[name] for name in channels if name in inputs}
            frames.append(rows_of(f"rate-{mounting}-{label}", "rate_table", covariates, kept, random, extra))
        for mounting in MOUNTINGS[:3]:
            angles = np.array(_ANGLES, float)
            count = len(angles)
            turn = np.radians(angles)
            parts = (0 * turn, np.cos(turn), np.sin(turn))
            shift = MOUNTINGS.index(mounting)
            inputs = {name: 0.003 * np.cos(turn + i) for i, name in enumerate(GYROS)}
            inputs |= {name: parts[(i - shift) % 3] for i, name in enumerate(ACCELEROMETERS)}
            covariates = {
                "time_s": 15 + 40.0 * np.arange(count),
                "power_on_s": 15 + 40.0 * np.arange(count) + 3600 * len(frames),
                "table_angle_deg": angles,
                "table_rate_deg_s": 0 * angles,
                "temperature_degC": temperature + 0.2 * random.standard_normal(count),
            }
            kept = {name: inputs[name] for name in channels if name in inputs}
            frames.append(rows_of(f"head-{mounting}-{label}", "dividing_head", covariates, kept, random))
        del place
    return pl.concat(frames)


def tumble_residuals(poses=30) -> pl.DataFrame:
    random = np.random.default_rng(2)
    poles = random.standard_normal((poses, 3))
    poles /= np.linalg.norm(poles, axis=1)[:, None]
    inputs = dict.fromkeys(GYROS, 0.004 + 0 * poles[:, 0])
    inputs |= {name: poles[:, i] for i, name in enumerate(ACCELEROMETERS)}
    covariates = {"time_s": 4.0 * np.arange(poses)}
    frame = rows_of("tumble", "free_tumble", covariates, inputs, random)
    closing = rows_of(
        "tumble", "free_tumble", covariates, {f"closure_{axis}": 0 * poles[:, 0] for axis in "xyz"}, random
    ).with_columns(
        kind=pl.lit("closure"),
        input_unit=pl.lit("deg"),
        output_unit=pl.lit("deg"),
        time_s=pl.lit(None, dtype=pl.Float64),
    )
    return pl.concat([frame, closing])


def thermal_residuals(rows=48) -> pl.DataFrame:
    random = np.random.default_rng(3)
    frames = []
    for run, level in (("ramp-1g", 1.0), ("ramp-trihedral", 0.577), ("inject-12g", 12.0)):
        covariates = {
            "time_s": 60.0 + 120 * np.arange(rows),
            "temperature_degC": 25 + 0.01 * random.standard_normal(rows),
            "converter_temperature_degC": np.linspace(15, 60, rows),
        }
        procedure = "current_injection" if run.startswith("inject") else "thermal_ramp"
        if procedure == "current_injection":
            covariates["current_mA"] = np.full(rows, 14.4)
        frames.append(rows_of(run, procedure, covariates, {"ax": np.full(rows, level)}, random))
    return pl.concat(frames)


def quantity(name, unit, mean, sd, from_data=0.999, **more) -> DerivedSummary:
    prior_sd = sd / math.sqrt(1 - from_data) if from_data < 1 else None
    return DerivedSummary(name=name, unit=unit, mean=mean, sd=sd, q025=mean - 1.96 * sd, q975=mean + 1.96 * sd,
                          from_data=from_data, prior_sd=prior_sd, **more)  # fmt: skip


def parameter(name, unit, mean, sd, from_data=0.999, **more) -> ParameterSummary:
    sampling = {"nuisance": False, "map": mean, "r_hat": 1.002, "ess_bulk": 2100.0, "ess_tail": 1800.0}
    plain = quantity(name, unit, mean, sd, from_data).model_dump(exclude={"within"})
    return ParameterSummary(**plain | sampling | more)


def without_estimates(entries):
    """Return quantities as a fit leaves them that failed."""
    empty = ("mean", "sd", "q025", "q975", "from_data", "r_hat", "ess_bulk", "ess_tail")
    return tuple(
        entry.model_copy(update=dict.fromkeys(set(empty) & set(type(entry).model_fields))) for entry in entries
    )


def trihedral_quantities(seed=4) -> tuple[list[ParameterSummary], list[DerivedSummary]]:
    random = np.random.default_rng(seed)
    parameters = []

    def add(name, labels, unit, spread, sd):
        for label in labels:
            own = sd * random.uniform(0.8, 1.3)
            mean = spread * random.standard_normal()
            parameters.append(parameter(f"{name}[{label}]", unit, mean, own, 1 - (own / spread) ** 2, prior_sd=spread))

    for axis, sd in (("x", 1.2), ("y", 1.1), ("z", 297.0)):
        add(f"mounting_error.{axis}", MOUNTINGS, "arcsec", 300.0, sd)
    for axis in "xy":
        add(f"table_axis_tilt.{axis}", ("rate", "head"), "arcsec", 20.0, 14.0)
    add("table_rate_error.rate_error", ("rate",), "ppm", 5.0, 4.99)
    for axis in "xyz":
        add(f"lever_arm.{axis}", ACCELEROMETERS, "mm", 10.0, 0.4)
    add("gyro_bias.bias", GYROS, "deg/h", 30.0, 0.6)
    add("gyro_scale_factor.scale", GYROS, "ppm", 500.0, 5.0)
    for part in ("toward_o", "toward_s"):
        add(f"gyro_misalignment.{part}", GYROS, "arcsec", 100.0, 1.4)
    add("gyro_bias_temperature.slope", GYROS, "deg/h/degC", 0.2, 0.02)
    add("gyro_scale_temperature.slope", GYROS, "ppm/degC", 10.0, 0.05)
    for part in ("d_i", "d_o", "d_s"):
        add(f"gyro_g_sensitivity.{part}", GYROS, "deg/h/g", 5.0, 0.4)
    add("accel_bias.bias", ACCELEROMETERS, "ug", 1000.0, 3.0)
    add("accel_scale_factor.scale", ACCELEROMETERS, "ppm", 300.0, 3.0)
    for part in ("toward_o", "toward_p"):
        add(f"accel_misalignment.{part}", ACCELEROMETERS, "arcsec", 100.0, 2.0)
    add("accel_bias_temperature.slope", ACCELEROMETERS, "ug/degC", 20.0, 0.1)
    add("accel_scale_temperature.slope", ACCELEROMETERS, "ppm/degC", 20.0, 0.1)
    add("accel_quadratic.quadratic", ACCELEROMETERS, "ug/g^2", 20.0, 2.5)
    add("white_noise.sigma", CHANNELS, "pulse/s", 8.0, 0.2)
    add("run_scatter.tau", CHANNELS, "pulse/s", 1.0, 0.12)
    derived = []
    for channel in CHANNELS:
        unit = "pulse/s per " + unit_of(channel)
        scale = _SCALE[channel]
        derived.append(quantity(f"scale_factor[{channel}]", unit, scale * 1.00018, scale * 5e-6, 0.9999))
        for mounting in MOUNTINGS:
            nominal = 54.73561 if mounting == "pyramid" else (0.0 if mounting[0] == channel[1] else 90.0)
            angle = abs(nominal + 0.05 * random.standard_normal())
            derived.append(quantity(f"mounting_angle[{channel},{mounting}]", "deg", angle, 1.3 / 3600, 0.99999))
    return parameters, derived


def run_entries(residuals: pl.DataFrame) -> tuple[RunSummary, ...]:
    return Residuals(residuals).by_run_and_channel()


def summary_of(residuals: pl.DataFrame, parameters=None, derived=None, **more) -> Summary:
    if parameters is None or derived is None:
        parameters, derived = trihedral_quantities()
    runs = run_entries(residuals)
    weak = WeakDirection(
        quantities=("mounting_error.z[x-up]", "mounting_error.z[y-up]"),
        weights=(1.0, -0.87),
        left_out=2,
        from_data=0.02,
    )
    sum_of_two = CombinationSummary(
        name="D_F+D_II[gx]", standard=True, quantities=("gyro_bias.bias[gx]", "gyro_g2_sensitivity.d_ii[gx]"),
        weights=(1.0, 1.0), unit="deg/h", mean=0.7087, sd=0.0021, q025=0.7046, q975=0.7128, prior_sd=5.0,
        from_data=0.9999,
    )  # fmt: skip
    sine = CombinationSummary(
        name="gyro_bias.bias[gy]-0.563·gyro_g_sensitivity.d_i[gy]", standard=False,
        quantities=("gyro_bias.bias[gy]", "gyro_g_sensitivity.d_i[gy]"), weights=(1.0, -0.563), unit="deg/h",
        mean=0.31, sd=0.011, q025=0.29, q975=0.33,
    )  # fmt: skip
    slope = CombinationSummary(
        name="k′[gx,pyramid]", standard=True, quantities=("scale_factor[gx]", "mounting_angle[gx,pyramid]"),
        weights=None, unit="pulse/s per deg/s", mean=577.35, sd=0.012, q025=577.33, q975=577.37,
    )  # fmt: skip
    design = RunDesign(procedure="dividing_head", mounting="pyramid", positions=12)
    candidate = NextRun(run=design, quantity="mounting_angle[gx,pyramid]",
                        sd_before=3.6e-4, sd_after=2.1e-4, unit="deg")  # fmt: skip
    return Summary(
        campaign="trihedral-imu", model="trihedral-imu", converged=True, message="", sampled=True,
        interval="95 % equal-tailed", uncertainty="standard deviation", acceptance=0.9, contributions=(),
        parameters=tuple(parameters), derived=tuple(derived), runs=runs,
        chi2=sum(run.chi2 or 0.0 for run in runs), dof=int(0.95 * residuals.height), log_evidence=-123.0,
        weak_directions=(weak,), combinations=(sum_of_two, slope, sine),
        next_runs=(candidate,), notes=(), seconds=Seconds(load=0.1, fit=1.2, sample=5.0),
    ).model_copy(update=more)  # fmt: skip


def posterior_of(summary: Summary, chains=8, draws=500, seed=5) -> xr.DataTree:
    """Return normal draws; scale factors and mounting angles of one gyro hang together."""
    random = np.random.default_rng(seed)
    common = {c: random.standard_normal((chains, draws)) for c in CHANNELS}
    families: dict[str, dict[tuple[str, ...], np.ndarray]] = {}
    for entry in (*summary.parameters, *summary.derived):
        name, _, label = entry.name.partition("[")
        labels: tuple[str, ...] = tuple(label.removesuffix("]").split(",")) if label else ()
        noise = random.standard_normal((chains, draws))
        joined = name.startswith("scale_factor") or label.endswith("pyramid]")
        if joined and label[:2] in common:
            noise = 0.8 * common[label[:2]] + 0.6 * noise
        families.setdefault(name, {})[labels] = entry.mean + entry.sd * noise
    variables = {}
    for name, members in families.items():
        keys = list(members)
        axes = [list(dict.fromkeys(key[i] for key in keys)) for i in range(len(keys[0]))]
        names = [_dimension(axis, name) for axis in axes]
        values = np.full((chains, draws, *(len(axis) for axis in axes)), np.nan)
        for key, array in members.items():
            place = tuple(axis.index(part) for axis, part in zip(axes, key, strict=True))
            values[(slice(None), slice(None), *place)] = array
        variables[name] = xr.DataArray(
            values, dims=("chain", "draw", *names), coords=dict(zip(names, axes, strict=True))
        )
    return xr.DataTree.from_dict({"posterior": xr.Dataset(variables)})


def _dimension(axis: list[str], name: str) -> str:
    if set(axis) <= set(CHANNELS):
        return f"channel_{'_'.join(axis)}" if len(axis) < 6 else "channel"
    return "mounting" if set(axis) <= set(MOUNTINGS) else f"{name}_label"


def write_folder(folder: Path, residuals: pl.DataFrame, summary: Summary, posterior: xr.DataTree | None = None) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "summary.json").write_text(summary.model_dump_json(), encoding="utf-8")
    residuals.write_parquet(folder / "residuals.parquet")
    if posterior is not None:
        posterior.to_netcdf(folder / "posterior.nc", engine="h5netcdf")
    return listed(folder)


def trihedral_folder(folder: Path, **more) -> Path:
    residuals = trihedral_residuals(**more)
    summary = summary_of(residuals)
    return write_folder(folder, residuals, summary, posterior_of(summary))
