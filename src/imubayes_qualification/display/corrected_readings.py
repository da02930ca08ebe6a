"""Outcome of corrected readings: a recording in sentences, and the motion of the carrier of a rotating unit.

The motion of the carrier is a table and a figure.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import polars as pl

from imubayes.display.figure_style import Picture
from imubayes.display.fit_cautions import exact_text
from imubayes.display.layout import Sheet, cells
from imubayes.display.numbers_and_labels import pretty, value_and_sd
from imubayes.foundations.campaign_data import Campaign, Run
from imubayes.foundations.covariates import COVARIATES
from imubayes.foundations.earth import earth_rate
from imubayes.foundations.errors import closest_first, input_error
from imubayes.foundations.files import write_text
from imubayes.foundations.wording import counted
from imubayes.model.model_file import UncertainEquipment
from imubayes.procedures.rotation_modulation import attenuation
from imubayes_qualification.display.modulation_figure import modulation_figure
from imubayes_qualification.onboard.carrier_motion import carrier
from imubayes_qualification.onboard.corrected_outputs import CarrierEstimate
from imubayes_qualification.onboard.inputs_along_axes import CalibratedInputs
from imubayes_qualification.onboard.record import UnexpressedEffect
from imubayes_qualification.onboard.recording_files import CorrectedRecording

_WORDS = {"gyro": "rate from the gyros", "accelerometer": "specific force from the accelerometers"}
_UNITS = {"gyro": "rad/s", "accelerometer": "m/s²"}
_INPUTS = {"gyro": "rate", "accelerometer": "specific force"}
_CAUSES = {
    "memory": "it depends on earlier rows", "limit": "it acts at a limit of the input",
    "covariate": "it depends on a quantity that the recording lacks", "nonlinear": "it is not linear",
}  # fmt: skip


def left_in_lines(left_in: Iterable[UnexpressedEffect], uncertainty: str) -> Iterator[str]:
    """Yield each effect that is left in, with the size that it may have; `uncertainty` is the one that has it."""
    for effect in left_in:
        said = f"note: {effect.effect} of {', '.join(effect.channels)} is not corrected ({_CAUSES[effect.cause]})"
        if effect.size is not None and effect.sd is not None:
            where = "under the conditions of the runs that were fitted"
            said += (
                f": up to {effect.size:.2g} ± {effect.sd:.1g} {_UNITS[effect.kind]} {where}; {uncertainty} includes it"
            )
        yield said


def incomplete_lines(rows: int) -> list[str]:
    """Return that rows have empty cells, as a line; none if all are complete."""
    said = "without an output, a temperature or a number of samples; the cells are empty"
    return [f"note: {counted(rows, 'row')} {said}"] * bool(rows)


def taken_as_exact_lines(exact: Sequence[UncertainEquipment], uncertainty: str) -> list[str]:
    """Return what the model takes as exact and an uncertainty contains nevertheless, as a line; none for nothing."""
    said = f"note: taken as exact by the model: {exact_text(exact)}; {uncertainty} includes this"
    return [said] * bool(exact)


def beyond_lines(beyond: Mapping[str, int], ranges: Mapping[str, tuple[float, float]]) -> Iterator[str]:
    """Yield how many rows are beyond what was calibrated, for each quantity."""
    for name, rows in beyond.items():
        if rows and name in _INPUTS:
            largest = f"{ranges[name][1]:.4g} {_UNITS[name]}"
            yield f"note: {counted(rows, 'row')} beyond the largest {_INPUTS[name]} of the fitted runs, {largest}"
        elif rows:
            low, high = ranges[name]
            yield (
                f"note: {counted(rows, 'row')} outside the calibrated range of {COVARIATES[name].column}, "
                f"{low:.4g} … {high:.4g} °C"
            )


def correction_lines(found: CorrectedRecording) -> list[str]:
    """Return what the columns are, and what to know about them, one sentence each."""
    solved = " and ".join(_WORDS[kind] for kind in sorted(found.kinds, reverse=True))
    tally = found.tally
    lines = [
        f"{counted(tally.rows, 'row')}: {solved}, in body axes.",
        "The systematic uncertainty is the same for all rows; the random one averages out over rows.",
    ]
    for kind, words in _INPUTS.items():
        if kind not in found.kinds and (names := [channel.name for channel in found.lacking if channel.kind == kind]):
            lines.append(f"note: there is no {words}: the recording lacks {', '.join(names)}")
    lines += incomplete_lines(tally.incomplete)
    if tally.unsolved:
        lines.append(f"note: {counted(tally.unsolved, 'row')} outside the range of the model; the cells are empty")
    lines += beyond_lines(tally.beyond, found.ranges)
    if found.slow_noise:
        lines.append(f"note: {', '.join(found.slow_noise)} is in neither uncertainty")
    uncertainty = "the systematic uncertainty"
    return [*lines, *left_in_lines(found.uncorrected, uncertainty), *taken_as_exact_lines(found.exact, uncertainty)]


def inputs_lines(found: CalibratedInputs, nothing_across: bool) -> list[str]:
    """Return what to know about inputs along the axes of channels, one sentence each."""
    lines = [*incomplete_lines(found.incomplete), *beyond_lines(found.beyond, found.ranges)]
    lines += left_in_lines(found.left_in, "the uncertainty")
    lines += taken_as_exact_lines(found.exact, "the uncertainty")
    if found.left_in and not nothing_across:
        lines.append("note: each channel was treated alone; if there was no input across its axis, add --along-axes")
    return lines


_ROUNDING = 1e-9


def rotating_run(campaign: Campaign, name: str) -> Run:
    """Return a run in which the unit rotates on a table; raises InputError if it is none."""
    turning = [run for run in campaign.runs if run.table and run.mounting and np.any(run.covariates["table_rate"] != 0)]
    found = next((run for run in turning if run.name == name), None)
    if found is not None and np.isfinite(found.covariates["table_angle"]).all():
        return found
    fault = "is not a run with a rotating table" if found is None else "has no table angle in some of its rows"
    known = [run.name for run in turning if np.isfinite(run.covariates["table_angle"]).all()]
    allowed = closest_first(name, known) or "a run with table_rate_deg_s and table_angle_deg in every row"
    remedy = "name a run of procedure rotation_modulation"
    raise input_error(f"'{name}' {fault}", f"campaign '{campaign.name}'", allowed, remedy)


def carrier_table(found: CarrierEstimate, gravity: float, zero_angle: float = 0.0) -> pl.DataFrame:
    """Return the motion of a carrier as a table in deg/s and g; with uncertainties if it is corrected.

    Parameters
    ----------
    zero_angle : reading of the table angle at the zero of the table, rad.
    """
    motion = found.motion
    columns = {"time_s": motion.time, "table_angle_deg": np.degrees(motion.angle + zero_angle)}
    columns |= {f"rate_{axis}_deg_s": np.degrees(motion.rate[:, place]) for place, axis in enumerate("xyz")}
    columns |= {f"force_{axis}_g": motion.force[:, place] / gravity for place, axis in enumerate("xyz")}
    if found.corrected:
        rate, force = np.degrees(found.row_sd["gyro"]), found.row_sd["accelerometer"] / gravity
        columns |= {f"rate_{axis}_sd_deg_s": rate[:, place] for place, axis in enumerate("xyz")}
        columns |= {f"force_{axis}_sd_g": force[:, place] for place, axis in enumerate("xyz")}
    return pl.DataFrame(columns)


def carrier_sheet(found: CarrierEstimate, campaign: Campaign, run: Run) -> Sheet:
    """Return the mean motion of the carrier over a run, beside that of a carrier at rest."""
    assert run.table is not None
    table = campaign.tables[run.table]
    to_table = table.to_local.T
    hour, gravity = np.degrees(1.0) * 3600, campaign.site.gravity
    rest = {"gyro": to_table @ earth_rate(campaign.site.latitude) * hour, "accelerometer": to_table @ [0.0, 0.0, 1.0]}
    rows = []
    for kind, factor, unit in (("gyro", hour, "deg/h"), ("accelerometer", 1 / gravity, "g")):
        for place, axis in enumerate(("x, across the axis", "y, across the axis", "z, along the axis")):
            if not np.isfinite(found.mean[kind][place]):
                continue
            value, sd = value_and_sd(found.mean[kind][place] * factor, found.mean_sd[kind][place] * factor)
            name = "rate" if kind == "gyro" else "specific force"
            nominal = f"{rest[kind][place]:.6g}" if abs(rest[kind][place]) > _ROUNDING else "0"
            rows.append(cells(f"{name} {axis}", value, sd, nominal, pretty(unit)))
    taken = "Every fitted error is removed; sd contains noise, run offset and the uncertainty of the calibration."
    note = taken if found.corrected else "As recorded, with the errors of the unit; sd contains the noise alone."
    head = ("mean over the run", "value", "sd", "carrier at rest", "unit")
    return Sheet(f"Motion of the carrier: {run.name}", head, rows, (0, 4), "", note)


def modulation_picture(campaign: Campaign, run: Run) -> Picture | None:
    """Return the figure of the gyro bias vector under rotation; None if fewer than three gyros determine it."""
    motion = carrier(campaign, run)
    if not np.isfinite(motion.rate).all() or run.table is None:
        return None
    table = campaign.tables[run.table]
    earth = table.to_local.T @ earth_rate(campaign.site.latitude)
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


def write_carrier(file: Path, campaign: Campaign, run: Run, found: CarrierEstimate) -> list[Path]:
    """Write the table of the motion of a carrier, and the figure beside it; return the files."""
    zero = campaign.tables[run.table].zero_angle if run.table else 0.0
    write_text(file, carrier_table(found, campaign.site.gravity, zero).write_csv())
    drawn = modulation_picture(campaign, run)
    return [file, *([] if drawn is None else [drawn.save(file.with_suffix(".png"))])]
