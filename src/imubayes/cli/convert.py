"""`imubayes convert`: foreign recordings into a campaign."""

from pathlib import Path


def convert(
    kind: str,
    *files: Path,
    out: Path,
    accel_unit: str = "m/s^2",
    gyro_unit: str = "rad/s",
    accel_scale: list[float] | None = None,
    accel_offset: list[float] | None = None,
    gyro_scale: list[float] | None = None,
    gyro_offset: list[float] | None = None,
    sample_rate_hz: float | None = None,
    time_unit: str = "s",
    column: list[str] | None = None,
    delimiter: str | None = None,
    gravity_m_s2: float | None = None,
    latitude_deg: float | None = None,
    height_m: float = 0.0,
    temperature_degc: float | None = None,
    initial_rest_s: float | None = None,
    procedure: str = "free_tumble",
    name: str = "",
    serial: str = "",
) -> int:
    """Convert a foreign recording into a campaign folder.

    Example: imubayes convert imu-tk acc.mat gyro.mat --out campaigns/xsens --accel-unit count --gyro-unit count
    --gravity-m-s2 9.81744

    Parameters
    ----------
    kind
        imu-tk (two text files, accelerometers and gyros, each time x y z) or six-column (ax ay az gx gy gz).
    files
        The recording.
    out
        Campaign folder to make.
    accel_unit
        m/s^2, g or count.
    gyro_unit
        rad/s, deg/s or count.
    accel_scale
        Nominal counts per m/s², one or three numbers; estimated where not given.
    accel_offset
        Counts at zero input, one or three numbers.
    gyro_scale
        Nominal counts per rad/s, one or three numbers; estimated where not given.
    gyro_offset
        Counts at zero rate, one or three numbers.
    sample_rate_hz
        For recordings without a time column.
    time_unit
        s, ms, us or ns.
    column
        COLUMN=SOURCE, once for each column to take, SOURCE being a name or a number from 1.
    delimiter
        comma, semicolon, tab or space; recognised where not given.
    gravity_m_s2
        Measured gravity of the site.
    latitude_deg
        Latitude of the site.
    height_m
        Height of the site.
    temperature_degc
        Temperature during the recording.
    initial_rest_s
        Length of the rest at the beginning.
    procedure
        What was done.
    name
        Name of the campaign.
    serial
        Serial number of the unit.
    """
    from imubayes.campaign.convert import convert as convert_recording
    from imubayes.errors import InputError, Issue

    columns = {}
    for word in column or []:
        key, equals, source = word.partition("=")
        if not (key and equals and source):
            raise InputError(
                Issue(
                    f"'{word}' is not COLUMN=SOURCE",
                    "option --column",
                    "such as gx=imu.gyro.x or gx=4",
                    "write the column of the campaign, an equals sign, and the column of the recording",
                )
            )
        columns[key] = int(source) if source.isdigit() else source
    given = {
        "accel_unit": accel_unit, "gyro_unit": gyro_unit, "accel_scale": accel_scale, "accel_offset": accel_offset,
        "gyro_scale": gyro_scale, "gyro_offset": gyro_offset, "sample_rate_hz": sample_rate_hz,
        "time_unit": time_unit, "columns": columns, "delimiter": delimiter, "gravity_m_s2": gravity_m_s2,
        "latitude_deg": latitude_deg, "height_m": height_m, "temperature_degC": temperature_degc,
        "initial_rest_s": initial_rest_s, "procedure": procedure, "name": name, "serial": serial,
    }  # fmt: skip
    folder = convert_recording(kind, list(files), out, **given)
    print(f"campaign in {folder}; next: imubayes check {folder}")
    return 0
