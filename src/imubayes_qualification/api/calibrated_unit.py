"""Use and report the calibration of a unit."""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import polars as pl

from imubayes.display.progress import progress_of
from imubayes.foundations.deferred_modules import DeferredModule
from imubayes.foundations.errors import input_error
from imubayes.foundations.records import several
from imubayes.results.change_records import read_diagnosis
from imubayes.results.result import Result, opened
from imubayes_qualification.certificate.report_build import report_of
from imubayes_qualification.certificate.report_record import QualificationReport, ReportSection
from imubayes_qualification.display.onboard.formats import ExportOptions, write_constants
from imubayes_qualification.onboard import Format
from imubayes_qualification.onboard.constants import onboard_constants as constants_of
from imubayes_qualification.onboard.effects_not_shown import effects_not_shown
from imubayes_qualification.onboard.inputs_along_axes import (
    CalibratedInputs,
    inputs_along_axes,
    read_readings,
)
from imubayes_qualification.onboard.losses import Loss, of_fit, read_noise, refuse_other_unit
from imubayes_qualification.onboard.navigation_impact import NavigationImpact, level_mission, motion_of, read_mission
from imubayes_qualification.onboard.navigation_impact import navigation_impact as impact_of
from imubayes_qualification.onboard.record import OnboardConstants
from imubayes_qualification.onboard.recording_files import (
    CorrectedRecording,
    correct_recording,
    open_recording,
)
from imubayes_recordings.noise_analysis.noise_record import of_record

report_files: Any = DeferredModule("imubayes_qualification.display.report.report_files")


def apply(
    result: Result | str | Path,
    readings: Any,
    *,
    temperatures: Mapping[str, float] | None = None,
    nothing_across: bool = False,
) -> CalibratedInputs:
    """Return the input along the axis of each channel of a calibrated unit from its output, with uncertainty.

    Parameters
    ----------
    result : a fit of the unit, or its folder.
    readings : a data frame (Polars, pandas, Arrow), a mapping of names to arrays, or a CSV or Parquet file: a column
        per channel in output units, and `converter_temperature_degC` and `temperature_degC` if the model depends on
        them.
    temperatures : `temperature` and `converter_temperature` of all rows, °C, if no column gives them.
    nothing_across : whether there was no input across the axes of the channels. Otherwise the uncertainty includes the
        possible effect of such an input.

    Raises
    ------
    InputError
        for a result without a posterior, and a table that cannot be read or lacks what the model needs.

    Examples
    --------
    >>> import imubayes
    >>> import polars as pl
    >>> readings = pl.DataFrame({"ax": [20000.0, 0.0], "converter_temperature_degC": [25.0, 40.0]})
    >>> found = imubayes.apply("results/accel-channel", readings, nothing_across=True)
    >>> found.table.columns
    ['ax', 'converter_temperature_degC', 'ax_g', 'ax_calibration_sd_g', 'ax_sd_g']
    """
    found = opened(result)
    if isinstance(readings, str | Path):
        table, where = read_readings(Path(readings)), str(readings)
    else:
        table, where = _frame(readings), "readings"
    return inputs_along_axes(found, table, where, temperatures=temperatures, nothing_across=nothing_across)


def _frame(readings: Any) -> pl.DataFrame:
    if not (isinstance(readings, Mapping) or hasattr(readings, "__arrow_c_stream__")):
        allowed = "a data frame, a mapping of names to arrays, or a CSV or Parquet file"
        what = f"the readings are of type {type(readings).__name__}"
        raise input_error(what, "readings", allowed, "pass one of these")
    try:
        return readings if isinstance(readings, pl.DataFrame) else pl.DataFrame(readings)
    except (pl.exceptions.PolarsError, TypeError, ValueError) as error:
        allowed = "columns of numbers of equal length"
        raise input_error(
            f"the readings are not a table: {error}", "readings", allowed, "correct the columns"
        ) from None


def correct(
    result: Result | str | Path,
    recording: str | Path,
    out: str | Path,
    *,
    run: str = "",
    temperatures: Mapping[str, float] | None = None,
    progress: Callable[[str], None] | None = None,
) -> CorrectedRecording:
    """Write a recording with rate and specific force in body axes, solved from all channels jointly, with uncertainty.

    Parameters
    ----------
    result : a fit of the unit, or its folder.
    recording : a CSV or Parquet table with a column per channel, of any length, or a campaign folder.
    out : the table to write, CSV or Parquet.
    run : of the campaign, if it has several.
    temperatures : `temperature` and `converter_temperature` of all rows, °C, if no column gives them.
    progress : called with a short text as the work goes on.

    Raises
    ------
    InputError
        for a result without a posterior, and a recording that cannot be read or lacks what the model needs.

    Examples
    --------
    >>> import imubayes
    >>> try:
    ...     imubayes.correct("results/accel-channel", "data/accel-channel", "corrected.csv", run="ramp-1g")
    ... except imubayes.InputError as error:
    ...     print(error.issues[0].what)
    neither the gyros nor the accelerometers of the unit span three axes
    """
    with progress_of(progress) as tell:
        tell("reading the fit")
        found = opened(result)
        source = open_recording(Path(recording), found.fit.model.campaign.channels, run, temperatures)
        tell("correcting")
        return correct_recording(found, source, Path(out), tell)


def onboard_constants(result: Result | str | Path) -> OnboardConstants:
    """Return the constants of a unit to use on board: matrix, biases, gains over temperature, with joint covariance.

    Parameters
    ----------
    result : a fit of the unit, or its folder.

    Raises
    ------
    InputError
        for a result without a posterior, and a unit whose channels do not span three axes.

    Examples
    --------
    >>> import imubayes
    >>> try:
    ...     imubayes.onboard_constants("results/accel-channel")
    ... except imubayes.InputError as error:
    ...     print(error.issues[0].what)
    neither the gyros nor the accelerometers of the unit span three axes
    """
    return constants_of(opened(result))


def export_constants(
    result: Result | str | Path,
    out: str | Path,
    format: Format = "json",
    *,
    noise: str | Path | None = None,
    noise_of_another_unit: bool = False,
    rate: float | None = None,
    topic: str = "/imu0",
    accept_loss: bool = False,
) -> tuple[Loss, ...]:
    """Write the constants of a unit in the format of another program; return the terms that the format leaves out.

    Parameters
    ----------
    result : a fit of the unit, or its folder.
    out : the file to write.
    format : json, c, kalibr, px4, ardupilot or ros.
    noise : record of `imubayes noise`, for kalibr.
    noise_of_another_unit : whether that record may be of another unit.
    rate : of the samples on board, Hz, for kalibr.
    topic : ROS topic, for kalibr.
    accept_loss : whether to leave out terms that are larger than their uncertainty.

    Raises
    ------
    InputError
        if the format cannot hold the constants or needs what is not known, and for the noise of another unit.

    Examples
    --------
    >>> import imubayes
    >>> try:
    ...     imubayes.export_constants("results/accel-channel", "constants.json")
    ... except imubayes.InputError as error:
    ...     print(error.issues[0].what)
    neither the gyros nor the accelerometers of the unit span three axes
    """
    found = opened(result)
    constants = constants_of(found)
    known = of_fit(found, constants, rate)
    if noise is not None:
        record, campaign = read_noise(Path(noise)), found.fit.model.campaign
        if not noise_of_another_unit:
            refuse_other_unit(record, campaign, str(noise))
        known |= of_record(record, campaign)
    return write_constants(constants, format, Path(out), ExportOptions(rate, topic, known, accept_loss))


def navigation_impact(
    result: Result | str | Path,
    trajectory: str | Path | None = None,
    *,
    duration: float = 3600.0,
    speed: float = 0.0,
    heading: float = 0.0,
    latitude: float | None = None,
    temperature: float | None = None,
    rate: float | None = None,
    aided_height: bool = True,
) -> NavigationImpact:
    """Return the position, velocity and attitude errors that the uncertainty of a calibration leaves in a mission.

    The joint covariance of the constants on board goes through the strapdown error equations in the ψ-angle form;
    start and alignment are exact.  Body axes are forward, right, down.  With a diagnosis in the result folder, effects
    that its runs could not show are propagated apart, each at the largest size that is met in practice.

    Parameters
    ----------
    result : a fit of the unit, or its folder.
    trajectory : CSV file with time_s, latitude_deg, longitude_deg, height_m, roll_deg, pitch_deg and heading_deg;
        without one the mission is level.
    duration, speed, heading : of a level mission: s, m/s and deg clockwise from North.
    latitude : of its beginning, deg; that of the site if None.
    temperature : of the unit, degC; the reference temperature of the constants if None.
    rate : of the samples, Hz; without it their noise is left out, which the record says.
    aided_height : whether height and vertical velocity are known from elsewhere, as by a barometer.

    Raises
    ------
    InputError
        for a unit without three axes of gyros and of accelerometers, and a mission that cannot be used.

    Examples
    --------
    >>> import imubayes
    >>> imu = imubayes.fit("data/desk-imu", "desk-imu", sample=False)
    >>> hour = imubayes.navigation_impact(imu, duration=3600, speed=50)
    >>> hour.errors[-1].time_s, hour.sources[0].horizontal_m > 0
    (3600.0, True)
    """
    found = opened(result)
    for name, value in (("duration", duration), ("speed", speed), ("heading", heading), ("rate", rate or 1.0)):
        if not math.isfinite(value) or (name == "rate" and value <= 0):
            raise input_error(f"a {name} of {value:g}", name, "a finite number, of a rate above 0", "correct it")
    if trajectory is not None:
        mission, name = read_mission(Path(trajectory)), f"trajectory {Path(trajectory).name}"
    else:
        site = found.fit.model.campaign.site
        at = site.latitude if latitude is None else math.radians(latitude)
        mission = level_mission(duration, at, speed, math.radians(heading))
        moving = f"at {speed:g} m/s, heading {heading:g}°" if speed else "at rest"
        name = f"{duration / 60:g} min {moving}, latitude {math.degrees(at):.4g}°"
    constants = constants_of(found)
    diagnosis = read_diagnosis(found.folder) if found.folder is not None else None
    hidden = None
    if diagnosis is not None:
        hidden = effects_not_shown(found, constants, diagnosis, motion_of(mission), temperature)
    return impact_of(constants, mission, name, temperature, rate, aided_height, hidden)


def report(
    result: Result | str | Path,
    specification: str | Path | None = None,
    *,
    certificate: str | Path | None = None,
    annexes: str | Sequence[str] | None = None,
    sections: Sequence[Callable[[QualificationReport], ReportSection]] = (),
    out: str | Path | Sequence[str | Path] = (),
    progress: Callable[[str], None] | None = None,
) -> QualificationReport:
    """Return the uncertainty report of a result as a record, of which ``report[name]`` is an estimate, and write it.

    Parameters
    ----------
    result : a result that has a folder, or the folder; its diagnosis and history are read from there.
    specification : file with limits and decision rules; None if nothing is to be decided.
    certificate : file with the certificate block (`imubayes schema certificate`); that of the specification if None.
    annexes : of page and PDF: results, budgets, evidence; None for all of a page, and the results alone of a PDF.
    sections : functions of the report that return further sections, such as a statement of traceability.
    out : file or files to write, by their endings: .html, .pdf, .json, .xml (DCC), .csv (covariance).
    progress : called with a short text as the work goes on.

    Raises
    ------
    InputError
        for a result that cannot be read, one whose campaign is gone or has changed, a specification that cannot be
        used with it, a function that returns no section, and a file that exists and is no report.

    Examples
    --------
    >>> import imubayes
    >>> found = imubayes.report("results/accel-channel", out="report.html")
    >>> found.accepted
    True
    >>> imubayes.conformity(found["converter_gain_drift.slope[ax]"], lower=-5, upper=5).outcome
    'pass'
    """
    files = [Path(file) for file in several(out)]
    # The record alone needs nothing that draws.
    with progress_of(progress) as tell, report_files.places_held(files) if files else nullcontext():
        chosen = report_files.known_annexes(None if annexes is None else several(annexes)) if files else None
        tell("evaluating the posterior")
        found = report_of(result, specification, certificate)
        if sections:
            found = found.model_copy(update={"supplied": tuple(_supplied(each, found) for each in sections)})
        if files:
            tell("drawing")
            report_files.write_report(found, files, chosen)
    return found


def _supplied(section: Callable[[QualificationReport], ReportSection], report: QualificationReport) -> ReportSection:
    made = section(report)
    if isinstance(made, ReportSection) and all(len(row) == len(made.head) for row in made.rows):
        return made
    fault = "rows that are not as wide as the head" if isinstance(made, ReportSection) else f"a {type(made).__name__}"
    name = getattr(section, "__name__", repr(section))
    raise input_error(
        f"'{name}' returned {fault}", "sections of the report", "an imubayes.ReportSection", "correct the function"
    )
