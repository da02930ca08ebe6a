"""`imubayes apply`: outputs of a calibrated unit to inputs, with uncertainty."""

from pathlib import Path


def apply(result: Path, readings: Path, *, out: Path) -> int:
    """Turn readings of a calibrated unit into accelerations and rates, with uncertainty.

    The fitted model is inverted at the recorded temperatures: output and converter temperature give the input along the
    axis of each channel, with the uncertainty of the calibration and that of the row.

    Example: imubayes apply results/accel-channel readings.csv --out accelerations.csv

    Parameters
    ----------
    result
        Result folder of a fit of the unit.
    readings
        Table (CSV or Parquet) with a column per channel in output units, and `converter_temperature_degC` and
        `temperature_degC` where the model depends on them.
    out
        The table to write (CSV).
    """
    from imubayes.cli.session import start_jax

    start_jax()
    from imubayes import api
    from imubayes.atomic_files import write_text

    found = api.apply(result, readings)
    write_text(out, found.table.write_csv())
    for note in found.notes:
        print(f"note: {note}")
    print(f"wrote {out}")
    return 0
