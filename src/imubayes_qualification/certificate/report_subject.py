"""Subject of a report and origin of its numbers: unit, campaign, equipment, model, hashes, software."""

from imubayes.foundations.records import Record
from imubayes.results.summary import SoftwareVersion


class ReportedChannel(Record):
    """A channel as the campaign states it: axes in the body frame, nominal scale factor and offset."""

    name: str
    kind: str
    input_axis: tuple[float, float, float]
    output_axis: tuple[float, float, float]
    output_unit: str
    nominal_scale: float
    per: str
    nominal_offset: float


class ReportedTable(Record):
    """A table with its stated standard uncertainties; None if the campaign states none, or no azimuth."""

    name: str
    azimuth_deg: float | None
    elevation_deg: float
    axis_uncertainty_arcsec: float | None
    rate_uncertainty_ppm: float | None
    angle_uncertainty_arcsec: float | None
    azimuth_uncertainty_arcsec: float | None = None
    elevation_uncertainty_arcsec: float | None = None


class ReportedMounting(Record):
    """A mounting: nominal rotation from body to table, and the standard uncertainty of its seat."""

    name: str
    body_to_table: tuple[tuple[float, float, float], ...]
    uncertainty_arcmin: float | None


class ReportedThermometer(Record):
    """A thermometer that runs share, with its stated standard uncertainties; None if the campaign states none."""

    name: str
    offset_uncertainty_degC: float | None
    gain_uncertainty_percent: float | None


class ReportedInstruments(Record):
    """Stated standard uncertainties of other instruments, of their readings; None if the campaign states none."""

    clock_uncertainty_ppm: float | None = None
    vibration_uncertainty_percent: float | None = None
    time_base_uncertainty_ppm: float | None = None
    meter_uncertainty_ppm: float | None = None


class ReportedRun(Record):
    """A run: what it was, where, when, and how many values of it were used of how many rows and channels."""

    name: str
    procedure: str
    table: str | None
    mounting: str | None
    start: str | None
    rows: int
    values_used: int
    values_missing: int
    thermometer: str | None = None
    converter_thermometer: str | None = None


class Subject(Record):
    """Unit, campaign, site and equipment.

    Attributes
    ----------
    gravity_m_s2 : the unit g of this report.
    gravity_is_normal : whether it is that of the ellipsoid at latitude and height, not measured at the site.
    gravity_uncertainty_ug : its standard uncertainty; None if the campaign states none.
    """

    serial: str
    grade: str | None
    campaign: str
    latitude_deg: float
    height_m: float
    gravity_m_s2: float
    gravity_is_normal: bool = False
    gravity_uncertainty_ug: float | None = None
    channels: tuple[ReportedChannel, ...]
    tables: tuple[ReportedTable, ...]
    mountings: tuple[ReportedMounting, ...]
    runs: tuple[ReportedRun, ...]
    thermometers: tuple[ReportedThermometer, ...] = ()
    instruments: ReportedInstruments = ReportedInstruments()


class ReportedEffect(Record):
    """An effect of the model, with its fixed settings and the priors that the model file states."""

    name: str
    channels: tuple[str, ...] | None
    prior: dict[str, str]
    options: dict[str, float]


class Provenance(Record):
    """What the numbers come from: model, hashes, seed, software that made the report.

    Attributes
    ----------
    fitted, fit_software : when the fit was made, ISO 8601 in UTC, and the software that made it; None and empty for
        results of earlier versions.
    """

    model: str
    effects: tuple[ReportedEffect, ...]
    data_sha256: str
    model_sha256: str
    seed: int
    sampled: bool
    software: tuple[SoftwareVersion, ...]
    fitted: str | None = None
    fit_software: tuple[SoftwareVersion, ...] = ()
