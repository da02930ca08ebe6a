"""`imubayes apply`: recordings of a calibrated unit to rate and specific force, with uncertainty."""

from pathlib import Path
from typing import TYPE_CHECKING

from imubayes.cli.options import Flag, Trust

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
) -> int:
    """Correct a recording of a calibrated unit: outputs become rates and accelerations, with uncertainty.

    A recording with all gyros or accelerometers of a unit is solved for rate and specific force in body axes, all
    channels jointly; the systematic uncertainty of the calibration and the random one of the row are given apart.
    Readings of single channels, or of channels that do not span three axes, become inputs along the axis of each
    channel. Effects of the model that depend on what the recording does not tell are left in; they are named, and the
    uncertainty contains what they may do.

    Example: imubayes apply results/desk-imu data/desk-imu --out results/desk-imu-corrected.csv

    Parameters
    ----------
    result
        Result folder of a fit of the unit.
    recording
        Table (CSV or Parquet) with a column per channel in output units, and `converter_temperature_degC` and
        `temperature_degC` where the model depends on them; or a campaign folder.
    out
        The table to write: CSV, or Parquet by the ending .parquet.
    run
        Run of the campaign, where it has several.
    temperature
        Temperature of the sensors in °C, where no column gives it.
    converter_temperature
        Temperature of the converters in °C, where no column gives it.
    along_axes
        Treat every channel alone: there was no input across its axis.
    trust
        Trust the effect files that come along: they are code, and run, now and later, only where they are trusted.
    """
    from imubayes.cli.session import trusting

    trusting(result, trust)
    stated = {"temperature": temperature, "converter_temperature": converter_temperature}
    known = {name: value for name, value in stated.items() if value is not None}
    for line in (*_corrected(result, recording, out, run, known, along_axes), f"wrote {out}"):
        print(line)
    return 0


def _corrected(
    result: Path, recording: Path, out: Path, run: str, temperatures: dict[str, float], along_axes: bool
) -> list[str]:
    """Write the table; return what to say of it."""
    from imubayes.cli.session import progress, start_jax

    with progress() as tell:
        start_jax()
        from imubayes import api
        from imubayes.campaign.run_tables import read_header
        from imubayes.display.correction_report import correction_lines
        from imubayes.qualification.sensor_posterior import complete_kinds
        from imubayes.results.result import read_result

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
    from imubayes import api
    from imubayes.atomic_files import write_text
    from imubayes.display.correction_report import inputs_lines

    found = api.apply(result, readings, temperatures=temperatures, nothing_across=nothing_across)
    write_text(out, found.table.write_csv())
    return inputs_lines(found, nothing_across)
