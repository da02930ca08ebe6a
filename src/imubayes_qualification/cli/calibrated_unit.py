"""Commands for a calibrated unit: `imubayes apply`, `carrier`, `export`, `mission` and `report`.

`apply` turns recordings of the unit into rate and specific force, with uncertainty.  `carrier` gives the motion of the
carrier of a rotating unit, without the rotation.  `export` writes constants for the computer on board, `mission`
computes the navigation errors due to their uncertainty.  `report` writes the uncertainty report for qualification.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import cyclopts

from imubayes.cli.session import Flag, Json, Trust, progress, show, start_jax, trusting
from imubayes.foundations.errors import input_error
from imubayes_qualification.onboard import Format

if TYPE_CHECKING:
    from imubayes.results.result import Result


def apply(
    result: Path,
    recording: Path,
    *,
    out: Path,
    run: str = "",
    temperature: float | None = None,
    converter_temperature: float | None = None,
    along_axes: Flag = False,
    trust: Trust = False,
) -> None:
    """Correct a recording of a calibrated unit: outputs become rates and accelerations, with uncertainty.

    A recording with all gyros or accelerometers of a unit is solved for rate and specific force in body axes, all
    channels jointly. The systematic uncertainty of the calibration and the random one of the row are separate.
    Readings of single channels, or of channels that do not span three axes, become inputs along the axis of each
    channel. Effects of the model that depend on quantities missing from the recording are not corrected. They are
    named, and the uncertainty includes them.

    Example: imubayes apply results/desk-imu data/desk-imu --out results/desk-imu-corrected.csv

    Parameters
    ----------
    result
        Result folder of a fit of the unit.
    recording
        Table (CSV or Parquet) with a column per channel in output units, and `converter_temperature_degC` and
        `temperature_degC` if the model depends on them; or a campaign folder.
    out
        The table to write: CSV, or Parquet by the ending .parquet.
    run
        Run of the campaign, if it has several.
    temperature
        Temperature of the sensors in °C, if no column gives it.
    converter_temperature
        Temperature of the converters in °C, if no column gives it.
    along_axes
        Treat every channel alone: there was no input across its axis.
    trust
        Trust the effect files that come with the input, and remember them. They are code, which runs only if trusted.
    """
    trusting(result, trust)
    stated = {"temperature": temperature, "converter_temperature": converter_temperature}
    known = {name: value for name, value in stated.items() if value is not None}
    for line in (*_corrected(result, recording, out, run, known, along_axes), f"wrote {out}"):
        print(line)


def _corrected(
    result: Path, recording: Path, out: Path, run: str, temperatures: dict[str, float], along_axes: bool
) -> list[str]:
    """Write the table; return what to say of it."""
    with progress() as tell:
        start_jax()
        from imubayes.campaign.run_tables import read_header
        from imubayes.results.result import read_result
        from imubayes_qualification.api import calibrated_unit as api
        from imubayes_qualification.display.corrected_readings import correction_lines
        from imubayes_qualification.onboard.response import complete_kinds

        tell("reading the fit")
        found = read_result(result)
        channels = found.fit.model.campaign.channels
        whole = not recording.is_file() or bool(complete_kinds(channels, read_header(recording)))
        if along_axes or not whole:
            return _along_axes(found, recording, out, temperatures, along_axes)
        return correction_lines(api.correct(found, recording, out, run=run, temperatures=temperatures, progress=tell))


def _along_axes(
    result: "Result", readings: Path, out: Path, temperatures: dict[str, float], nothing_across: bool
) -> list[str]:
    from imubayes.foundations.files import write_text
    from imubayes_qualification.api import calibrated_unit as api
    from imubayes_qualification.display.corrected_readings import inputs_lines

    found = api.apply(result, readings, temperatures=temperatures, nothing_across=nothing_across)
    write_text(out, found.table.write_csv())
    return inputs_lines(found, nothing_across)


def carrier(campaign: Path, run: str, *, out: Path, result: Path | None = None) -> None:
    """Subtract the measured rotation of the table: write rate and specific force of the carrier, and a picture.

    Example: imubayes carrier data/rotation-modulation pyramid-forward --out carrier.csv

    Parameters
    ----------
    campaign
        Folder with campaign.toml.
    run
        A run in which the unit turns, with the table angle recorded.
    out
        The table to write (CSV); a picture of the turning bias goes beside it.
    result
        Result folder of a fit of the same campaign, whose fitted errors are corrected first.
    """
    with progress() as tell:
        from imubayes import load_campaign
        from imubayes.display.layout import Report, print_report
        from imubayes.results.history_tree import refuse_other_data
        from imubayes.results.result import read_result
        from imubayes_qualification.display.corrected_readings import carrier_sheet, rotating_run, write_carrier
        from imubayes_qualification.onboard.corrected_outputs import corrected_run, estimate_carrier

        tell("reading the campaign")
        loaded = load_campaign(campaign)
        chosen = rotating_run(loaded, run)
        corrected = None
        if result is not None:
            refuse_other_data(result, loaded)
            fitted = read_result(result)
            corrected = corrected_run(loaded, chosen, fitted.residuals, fitted.summary)
        tell("turning")
        found = estimate_carrier(loaded, chosen, corrected)
        written = write_carrier(out, loaded, chosen, found)
    for file in written:
        print(f"wrote {file}")
    print_report(Report((), [carrier_sheet(found, loaded, chosen)]))


def export(
    result: Path,
    *,
    out: Path,
    format: Format = "json",
    noise: Path | None = None,
    noise_of_another_unit: Flag = False,
    rate_hz: float | None = None,
    topic: str = "/imu0",
    accept_loss: Flag = False,
    trust: Trust = False,
) -> None:
    """Write the constants of a unit in the format of the program that will use them.

    Matrix, biases and gains over temperature with the joint covariance of all of them (json), as a C header with the
    function that applies them, as kalibr's imu.yaml, as PX4 or ArduPilot parameters, or as covariances of a ROS Imu
    message. A format is refused if it cannot hold an error that is larger than its uncertainty.

    Example: imubayes export results/desk-imu --format c --out results/constants.h

    Parameters
    ----------
    result
        Result folder of a fit of the unit.
    out
        The file to write.
    format
        json, c, kalibr, px4, ardupilot or ros.
    noise
        noise.json of `imubayes noise` on a static record of the unit, for kalibr.
    noise_of_another_unit
        Use the noise even if the record is of another unit, or does not name its unit.
    rate_hz
        Rate of the samples on board in Hz, for kalibr.
    topic
        ROS topic, for kalibr.
    accept_loss
        Leave out the terms that the format cannot hold; the file lists them with their size.
    trust
        Trust the effect files that come with the input, and remember them. They are code, which runs only if trusted.
    """
    start_jax()
    trusting(result, trust)
    from imubayes_qualification.api import calibrated_unit as api
    from imubayes_qualification.display.onboard.formats import in_words

    if rate_hz is not None and not 0 < rate_hz < float("inf"):
        raise input_error(f"a rate of {rate_hz:g} Hz", "--rate-hz", "a number above 0", "correct it")
    for loss in api.export_constants(
        result, out, format, noise=noise, noise_of_another_unit=noise_of_another_unit, rate=rate_hz, topic=topic,
        accept_loss=accept_loss,
    ):  # fmt: skip
        print(f"left out: {in_words(loss)}")
    print(f"wrote {out}")


def mission(
    result: Path,
    *,
    trajectory: Path | None = None,
    duration_min: float = 60.0,
    speed_m_s: float = 0.0,
    heading_deg: float = 0.0,
    latitude_deg: float | None = None,
    temperature: float | None = None,
    rate_hz: float | None = None,
    aided_height: bool = True,
    picture: Path | None = None,
    as_json: Json = False,
    trust: Trust = False,
) -> None:
    """Compute the navigation errors due to the uncertainty of a calibration.

    Example: imubayes mission results/desk-imu --duration-min 10 --speed-m-s 20

    Parameters
    ----------
    result
        Result folder of a unit with three axes of each kind. After `imubayes diagnose`, undetectable effects are shown.
    trajectory
        CSV file with time_s, latitude_deg, longitude_deg, height_m, roll_deg, pitch_deg and heading_deg. Without it the
        mission is level.
    duration_min
        Duration of a level mission.
    speed_m_s
        Its speed; 0 is at rest.
    heading_deg
        Its heading, clockwise from North.
    latitude_deg
        Latitude of its beginning; by default that of the site.
    temperature
        Temperature of the unit in degC, for the effects that depend on it; by default that of the constants.
    rate_hz
        Rate of the samples; without it their noise is left out.
    aided_height
        Whether height and vertical velocity are known, as from a barometer.
    picture
        PNG file to draw.
    as_json
        Print one JSON object on standard output.
    trust
        Trust the effect files that come with the input, and remember them. They are code, which runs only if trusted.
    """
    with progress("propagating"):
        start_jax()
        trusting(result, trust)
        from imubayes_qualification.api.calibrated_unit import navigation_impact
        from imubayes_qualification.display.onboard.navigation import navigation_figure, navigation_report

        found = navigation_impact(
            result, trajectory, duration=60 * duration_min, speed=speed_m_s, heading=heading_deg,
            latitude=latitude_deg, temperature=temperature, rate=rate_hz, aided_height=aided_height,
        )  # fmt: skip
        if picture is not None:
            navigation_figure(found).save(picture)
    show(lambda: found, lambda: navigation_report(found), as_json)


Out = Annotated[list[Path], cyclopts.Parameter(consume_multiple=True, negative="")]


Annexes = Annotated[
    list[Literal["results", "budgets", "evidence", "all", "none"]] | None,
    cyclopts.Parameter(consume_multiple=True, negative=""),
]


def report(
    result: Path,
    *,
    out: Out,
    spec: Path | None = None,
    certificate: Path | None = None,
    annex: Annexes = None,
    trust: Trust = False,
) -> int:
    """Write the uncertainty report of a unit as a page, a PDF file or a JSON record.

    Example: imubayes report results/full --spec models/qualification-spec.toml --out report.html report.pdf

    The exit status is 1 if the unit does not pass the specification, or if the fit did not converge.

    Parameters
    ----------
    result
        Result folder of a fit that `imubayes diagnose` has examined.
    out
        Files to write, by their endings: .html, .pdf, .json; .xml for a digital calibration certificate (DCC), .csv for
        the covariance of the quantities (GTC, METAS UncLib).
    spec
        Specification: limits and decision rules. Without one nothing is decided.
    certificate
        Certificate block: laboratory, customer, method, standards, signatories (`imubayes schema certificate`). By
        default that of the specification, if it contains one.
    annex
        Annexes of page and PDF: results, budgets, evidence, all or none. Without it a page has all of them, and a PDF
        file the results. The JSON record has everything.
    trust
        Trust the effect files that come with the input, and remember them. They are code, which runs only if trusted.
    """
    with progress() as tell:
        start_jax()
        trusting(result, trust)
        from imubayes_qualification.api.calibrated_unit import report as make_report

        found = make_report(result, spec, certificate=certificate, annexes=annex, out=out, progress=tell)
    from imubayes_qualification.display.report.first_page import alarms, banner
    from imubayes_qualification.display.report.words import more_draws_text

    said = banner(found)
    print(f"{said.word}: {said.sentence}")
    for line in alarms(found):
        print(line)
    if remedy := more_draws_text(found):
        print(remedy)
    for file in out:
        print(f"written: {file}")
    if any(file.suffix.lower() == ".pdf" for file in out):
        from imubayes_qualification.display.report.pdf_file import shown_by_code_points

        if unknown := shown_by_code_points(found.json_text()):
            print(f"note: no font has {' '.join(unknown)}: the PDF file has the code points instead; install a font")
    return 0 if found.accepted else 1
