"""Campaign folders: campaign.toml, truth.toml and one table per run."""

import datetime
from pathlib import Path

import numpy as np
import tomlkit

from plan import Plan, Readings, Run
from sensor import REFERENCE_TEMPERATURE
from truth import UNITS

HEADER = """\
# {purpose}
# Simulated by data/generators/{script}.py with seed {seed}; the true values stand in truth.toml.
# Columns and units: data/README.md.

"""
DECIMALS = 5


def _without_none(**entries) -> dict:
    return {key: value for key, value in entries.items() if value is not None}


def _matrix(matrix: np.ndarray) -> list[list[float]]:
    return [[float(value) for value in row] for row in matrix]


def channel_entry(channel) -> dict:
    return _without_none(
        name=channel.name,
        kind=channel.kind,
        input_axis=list(channel.input_axis),
        output_axis=None if channel.output_axis is None else list(channel.output_axis),
        output_unit=channel.output_unit,
        scale=channel.scale,
        per=channel.per,
        offset=channel.offset,
        noise=channel.noise,
        current_mA_per_g=channel.current_mA_per_g,
    )


def table_entry(table) -> dict:
    return _without_none(
        name=table.name,
        azimuth_deg=table.azimuth_deg,
        elevation_deg=table.elevation_deg,
        axis_uncertainty_arcsec=table.axis_uncertainty_arcsec,
        rate_uncertainty_ppm=table.rate_uncertainty_ppm,
        angle_uncertainty_arcsec=table.angle_uncertainty_arcsec,
        **getattr(table, "more", {}),
    )


def mounting_entry(mounting) -> dict:
    return _without_none(
        name=mounting.name,
        preset=mounting.preset,
        body_to_table=None if mounting.preset else _matrix(mounting.body_to_table),
        uncertainty_arcmin=mounting.uncertainty_arcmin,
    )


def run_entry(run, suffix: str = "csv", **more) -> dict:
    start = None if run.start is None else datetime.datetime.fromisoformat(run.start)
    return _without_none(
        name=run.name,
        procedure=run.procedure,
        file=f"runs/{run.name}.{suffix}",
        table=run.table,
        mounting=run.mounting,
        start=start,
        **more,
    )


def run_entries(runs) -> list[dict]:
    """Entries of runs; where some warm the converter, the others state its temperature."""
    warmed = [run.rows[0].converter_temperature is not None for run in runs]
    held = {"converter_temperature_degC": REFERENCE_TEMPERATURE} if any(warmed) else {}
    return [run_entry(run, **({} if warms else held)) for run, warms in zip(runs, warmed, strict=True)]


def write_campaign_file(folder: Path, plan: Plan, seed: int, runs: list[dict]) -> None:
    document = {
        "format": 1,
        "name": plan.name,
        "site": {"latitude_deg": plan.site.latitude_deg, "height_m": plan.site.height_m},
        "unit": {"serial": plan.serial},
        "channel": [channel_entry(channel) for channel in plan.channels],
        "table": [table_entry(table) for table in plan.tables],
        "mounting": [mounting_entry(mounting) for mounting in plan.mountings],
        "run": runs,
    }
    header = HEADER.format(purpose=plan.purpose, script=plan.script or plan.name.replace("-", "_"), seed=seed)
    text = tomlkit.dumps({key: value for key, value in document.items() if value != []})
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "campaign.toml").write_text(header + text, encoding="utf-8")


def write_truth(
    folder: Path, plan: Plan, seed: int, values: dict, derived: dict, nuisance: dict, hidden: dict | None = None
) -> None:
    kinds = {name.split("[")[0] for name in values}
    document = {
        "format": 1,
        "campaign": plan.name,
        "seed": seed,
        "parameters": values,
        "derived": derived,
        "units": {kind: unit for kind, unit in UNITS.items() if kind in kinds},
        "nuisance": nuisance,
    } | ({"hidden": hidden} if hidden else {})
    (folder / "truth.toml").write_text(tomlkit.dumps(document), encoding="utf-8")


def _columns(plan: Plan, run: Run, readings: Readings) -> dict[str, list[str]]:
    rows = run.rows
    columns = {"time_s": [f"{row.time:.3f}" for row in rows]}
    if run.procedure in ("rate_table", "rotation_modulation"):
        columns["table_rate_deg_s"] = [f"{row.rate:g}" for row in rows]
    if run.procedure in ("rate_table", "rotation_modulation", "dividing_head", "polar_tumble", "reference_gyro"):
        columns["table_angle_deg"] = ["" if row.angle is None else f"{row.angle:g}" for row in rows]
    if rows[0].span is not None:
        columns["table_angle_span_deg"] = [f"{row.span:g}" for row in rows]
    if rows[0].axes is not None:
        columns |= {name: [row.axes[place] for row in rows] for place, name in enumerate(("i_axis", "o_axis"))}
    if readings.reference is not None:
        for axis, values in zip("xyz", readings.reference.T, strict=True):
            columns[f"reference_{axis}_deg_s"] = [f"{value:.8f}" for value in values]
    columns["temperature_degC"] = [f"{row.temperature:.3f}" for row in rows]
    if rows[0].converter_temperature is not None:
        columns["converter_temperature_degC"] = [f"{row.converter_temperature:.4f}" for row in rows]
    if rows[0].current is not None:
        columns["current_mA"] = [f"{row.current:.4f}" for row in rows]
    if rows[0].power_on is not None:
        columns["power_on_s"] = [f"{row.power_on:.3f}" for row in rows]
    columns["samples"] = [str(row.samples) for row in rows]
    for name, table in (("{}", readings.mean), ("{}_sd", readings.sd)):
        for channel, values in zip(plan.channels, table.T, strict=True):
            if run.procedure == "current_injection" and channel.current_mA_per_g is None:
                continue
            columns[name.format(channel.name)] = [f"{value:.{DECIMALS}f}" for value in values]
    return columns


def write_run(folder: Path, plan: Plan, run: Run, readings: Readings) -> None:
    columns = _columns(plan, run, readings)
    lines = [",".join(columns), *(",".join(cells) for cells in zip(*columns.values(), strict=True))]
    (folder / "runs").mkdir(parents=True, exist_ok=True)
    (folder / "runs" / f"{run.name}.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
