"""The motion of the carrier of a rotating unit, as a table and a figure."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import polars as pl

from imubayes.atomic_files import write_text
from imubayes.campaign_data import Campaign, Run
from imubayes.display.figures.modulation import modulation_figure
from imubayes.display.theme import Picture
from imubayes.earth import earth_rate, table_to_local
from imubayes.errors import InputError, Issue, closest_first
from imubayes.procedures.rotation_modulation import Carrier, attenuation, carrier
from imubayes.results.summary import Summary
from imubayes.units import to_si

_BIASES = {"gyro": "gyro_bias.bias", "accelerometer": "accel_bias.bias"}


def rotating_run(campaign: Campaign, name: str) -> Run:
    """Return a run in which the unit rotates on a table; raises InputError where it is none."""
    turning = [run for run in campaign.runs if run.table and run.mounting and np.any(run.covariates["table_rate"] != 0)]
    found = next((run for run in turning if run.name == name), None)
    if found is not None and np.isfinite(found.covariates["table_angle"]).all():
        return found
    fault = "is no run with a rotating table" if found is None else "has no table angle in some of its rows"
    known = [run.name for run in turning if np.isfinite(run.covariates["table_angle"]).all()]
    raise InputError(
        Issue(
            f"'{name}' {fault}",
            f"campaign '{campaign.name}'",
            closest_first(name, known) or "a run with table_rate_deg_s and table_angle_deg in every row",
            "name a run of procedure rotation_modulation",
        )
    )


def fitted_biases(campaign: Campaign, summary: Summary) -> dict[str, float]:
    """Return the estimated bias of each channel, rad/s or m/s²."""
    channel_of = {f"{_BIASES[channel.kind]}[{channel.name}]": channel.name for channel in campaign.channels}
    return {
        channel_of[parameter.name]: parameter.mean * to_si(parameter.unit, campaign.site.gravity)
        for parameter in summary.parameters
        if parameter.name in channel_of and parameter.mean is not None
    }


def carrier_table(motion: Carrier, gravity: float) -> pl.DataFrame:
    """Return the motion of a carrier as a table in deg/s and g."""
    columns = {"time_s": motion.time, "table_angle_deg": np.degrees(motion.angle)}
    columns |= {f"rate_{axis}_deg_s": np.degrees(motion.rate[:, place]) for place, axis in enumerate("xyz")}
    columns |= {f"force_{axis}_g": motion.force[:, place] / gravity for place, axis in enumerate("xyz")}
    return pl.DataFrame(columns)


def modulation_picture(campaign: Campaign, run: Run) -> Picture | None:
    """Return the figure of the gyro bias vector under rotation; None where fewer than three gyros determine it."""
    motion = carrier(campaign, run)
    if not np.isfinite(motion.rate).all() or run.table is None:
        return None
    table = campaign.tables[run.table]
    earth = table_to_local(table.azimuth, table.elevation).T @ earth_rate(campaign.site.latitude)
    felt = np.degrees(motion.rate - earth) * 3600
    weight = np.abs(run.covariates["table_angle_span"])
    arc = attenuation(run)[:, None]
    total = np.cumsum(weight)
    # Weighted by arc; the mean over a row shortens a rotating vector, as `attenuation` says.
    mean = np.cumsum(felt[:, :2] * arc * weight[:, None], axis=0) / total[:, None]
    along = np.cumsum(felt[:, 2] * weight) / total
    length = float(np.mean(np.hypot(felt[:, 0], felt[:, 1])))
    expected = length * np.abs(np.sinc(total / (2 * np.pi)))
    return modulation_figure(total / (2 * np.pi), felt[:, :2], mean, along, expected, "deg/h", run.name)


def write_carrier(file: Path, campaign: Campaign, run: Run, biases: Mapping[str, float] | None) -> list[Path]:
    """Write the table of the motion of a carrier, and the figure beside it; return the files."""
    write_text(file, carrier_table(carrier(campaign, run, biases), campaign.site.gravity).write_csv())
    drawn = modulation_picture(campaign, run)
    return [file, *([] if drawn is None else [drawn.save(file.with_suffix(".png"))])]
