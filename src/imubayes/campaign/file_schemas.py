"""Schemas of the two input files: `campaign.toml` (the measurements) and the model file.

A schema covers structure only: keys, types and ranges.  Cross-references and geometry are checked when the records are
built; whether an effect of the model exists is checked by the registry of effects.  Unknown keys are refused, so that a
misspelt key is never ignored silently.  The valid entries of a campaign file are kept beside invalid ones, so that one
invalid entry does not hide the errors of the others.

The docstring of a key is its description in the JSON Schema; a longer one stands as `description`.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date, datetime
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from imubayes.foundations.campaign_data import Grade
from imubayes.foundations.units import ABSURD

# Characters that steer a terminal, or turn the direction of text, instead of being shown.
_CONTROL = r"\x00-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069"
_NAME, _COLUMN_NAME = rf"^[^\s\[\],{_CONTROL}][^\[\],{_CONTROL}]*$", r"^[A-Za-z_][A-Za-z0-9_.\-]*$"
_TEXT = rf"^[^{_CONTROL}]*$"
# A part of a path that does not lead upwards: no dot first, one alone or before another character, or more than two.
_STEP = rf"(?:\.?[^/\\.{_CONTROL}][^/\\{_CONTROL}]*|\.|\.\.[^/\\{_CONTROL}]+)"
_FILE_WITHIN = rf"^{_STEP}(?:/{_STEP})*$"
Text = Annotated[str, Field(pattern=_TEXT)]  # without control characters
FileWithin = Annotated[str, Field(pattern=_FILE_WITHIN)]
Name = Annotated[str, Field(min_length=1, pattern=_NAME)]
COUNTRY = "^[A-Z]{2}$"  # pattern of a country code, ISO 3166-1 alpha-2
ColumnName = Annotated[str, Field(min_length=1, pattern=_COLUMN_NAME)]
Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Positive = Annotated[float, Field(gt=0)]
# Standard uncertainties: up to half a turn, the whole of a value, and a hundred metres.
Arcseconds = Annotated[float, Field(ge=0, le=648_000)]
Arcminutes = Annotated[float, Field(ge=0, le=10_800)]
Millionths = Annotated[float, Field(ge=0, le=1e6)]
Percent = Annotated[float, Field(ge=0, le=100)]
Micrometres = Annotated[float, Field(ge=0, le=1e8)]
_LEAST_LENGTH = 1e-9
Degrees = Annotated[float, Field(ge=-360, le=360)]
TemperatureUncertainty = Annotated[float, Field(ge=0, le=100)]


def _numbers_in(value: Any) -> list[float]:
    if isinstance(value, list):
        return [number for each in value for number in _numbers_in(each)]
    return [value] if isinstance(value, float) else []


class _Entry(BaseModel):
    model_config = ConfigDict(
        extra="forbid", strict=True, allow_inf_nan=False, frozen=True, use_attribute_docstrings=True
    )

    @field_validator("*")
    @classmethod
    def _measurable(cls, value: Any) -> Any:
        numbers = [each for each in _numbers_in(value) if each and not 1 / ABSURD <= abs(each) <= ABSURD]
        if numbers:
            raise PydanticCustomError("absurd", "{number} is not a physical size", {"number": f"{numbers[0]:g}"})
        return value


class SiteEntry(_Entry):
    """The test site; measured gravity takes precedence over the WGS 84 formula."""

    latitude_deg: float = Field(ge=-90, le=90)
    """geodetic, positive to the North"""
    height_m: float = Field(default=0.0, ge=-1000, le=20000)
    """above the ellipsoid"""
    gravity_m_s2: float | None = Field(default=None, ge=9.5, le=10.1)
    """as measured; by default WGS 84"""
    gravity_uncertainty_ug: Millionths | None = None
    """standard uncertainty of gravity; 0 means exact, by default unknown"""


class UnitEntry(_Entry):
    """The unit under test."""

    serial: Text = ""
    """serial number, repeated in results and reports"""
    description: Text = ""
    """type of the unit, in words"""
    grade: Grade | None = None
    """to which default priors belong; from the noise if absent"""
    labels: dict[Name, Text] = {}
    """attributes that may distinguish units of an archive, such as lot, operator or software"""


class ChannelEntry(_Entry):
    """One sensitive axis with its readout; `name` is its column in the run tables."""

    name: ColumnName
    """of the channel, and of its column in the run tables"""
    kind: Literal["gyro", "accelerometer"]
    """sensor of the channel"""
    input_axis: Vector
    """nominal sensitive axis in body axes, of any length"""
    output_axis: Vector | None = Field(
        default=None,
        description="nominal output axis in body axes, across the input axis; misalignments and cross terms count "
        "along it and along the third axis, input x output",
    )
    output_unit: Text
    """of the column: pulse/s, V, mA, or what the readout gives"""
    scale: float
    """nominal scale factor: output_unit per input; negative if the channel is reversed"""
    per: Literal["deg/s", "deg/h", "rad/s", "g", "m/s^2"]
    """unit of the input; g is the gravity of the site, not 9.80665 m/s^2"""
    offset: float = 0.0
    """nominal output at zero input, in output_unit"""
    noise: Positive | None = Field(
        default=None,
        description="sd of a raw sample in output_unit, the prior of white_noise; by default from the columns "
        "name_sd, or from repeated rows",
    )
    current_mA_per_g: float | None = None
    """nominal current of the accelerometer; required if a current is fed into its converter"""

    @field_validator("output_unit")
    @classmethod
    def _is_stated(cls, value: str) -> str:
        if value == "?":
            raise ValueError("the unit of the output is not stated")
        return value


class TableEntry(_Entry):
    """A table: directions of its axes, the outer one by azimuth and elevation; one-sigma uncertainties, 0 is exact.

    Angles and rates count right-handed about the axis z.  At angle 0 x is horizontal, 90 deg clockwise from the azimuth
    as seen from above, and y = z x x; see the picture in data/README.md.
    """

    name: Name
    """by which runs refer to the table"""
    azimuth_deg: Degrees | Literal["unknown"] = 0.0
    """of the rotation axis, clockwise from North; "unknown" if it is not known: without axis_uncertainty_arcsec a
    bench that is level to 1 deg"""
    elevation_deg: float = Field(ge=-90, le=90)
    """of the rotation axis: 90 a rate table, 0 a dividing head, the latitude a polar axis"""
    zero_angle_deg: Degrees = Field(
        default=0.0,
        description="reading of table_angle_deg at the zero of the table, subtracted from the column: there table x is "
        "horizontal, at azimuth_deg + 90, and y = z x x (East and North for azimuth 0 and elevation 90)",
    )
    settling_s: float = Field(default=0.0, ge=0)
    """least time left out of raw logs after each change of the stimulus"""
    rate_tolerance_deg_s: Positive | None = None
    """of raw logs: rates closer than this are equal; by default the noise of the column"""
    axis_uncertainty_arcsec: Arcseconds | None = None
    """of the direction of the rotation axis, about each of two axes across it"""
    azimuth_uncertainty_arcsec: Arcseconds | None = None
    """of azimuth_deg, if it differs from axis_uncertainty_arcsec: north is known less well"""
    elevation_uncertainty_arcsec: Arcseconds | None = None
    """of elevation_deg, if it differs from axis_uncertainty_arcsec: a level determines it"""
    rate_uncertainty_ppm: Millionths | None = None
    """of the commanded or measured rate"""
    angle_uncertainty_arcsec: Arcseconds | None = None
    """of an angle that is read; of the record of a servo table"""
    inner_axis: Vector | None = None
    """at zero angles, in axes with z along the outer axis"""
    middle_axis: Vector | None = None
    """as inner_axis, of a table of three axes"""
    arm_radius_m: Positive | None = None
    """of a centrifuge: from the outer to the inner axis"""
    zero_uncertainty_arcsec: Arcseconds | None = None
    """of the zero of each axis: the prior of inner_axis_zero, outer_axis_zero, middle_axis_zero"""
    squareness_uncertainty_arcsec: Arcseconds | None = None
    """of the right angle between two axes of the table"""
    intersection_uncertainty_um: Micrometres | None = None
    """of the distance between two axes that should intersect"""
    arm_uncertainty_um: Micrometres | None = None
    """of arm_radius_m"""

    @model_validator(mode="after")
    def _axes_of_a_table(self) -> "TableEntry":
        if self.inner_axis is None and (self.middle_axis is not None or self.arm_radius_m is not None):
            raise ValueError("a table of several axes and a centrifuge have an 'inner_axis', which carries the unit")
        for axis in (self.inner_axis, self.middle_axis):
            if axis is not None and math.hypot(*axis) < _LEAST_LENGTH:
                raise ValueError("the direction of an axis is not a zero vector")
        return self


class MountingEntry(_Entry):
    """Mounting of the unit on a table: a preset, or the rows of `body_to_table`; an uncertainty of 0 means exact."""

    name: Name
    """by which runs refer to the mounting"""
    preset: Literal["trihedral", "aligned"] | None = None
    """aligned: body axes along those of the table; trihedral: body diagonal along table z"""
    body_to_table: Annotated[list[Vector], Field(min_length=3, max_length=3)] | None = None
    """three rows; the columns are the body axes in axes of the table, at its zero"""
    uncertainty_arcmin: Arcminutes | None = None
    """of the attitude, about each axis; 0 is exact"""

    @model_validator(mode="after")
    def _one_of_two(self) -> "MountingEntry":
        if (self.preset is None) == (self.body_to_table is None):
            raise ValueError("a mounting has either 'preset' or 'body_to_table'")
        return self


class ThermometerEntry(_Entry):
    """A thermometer that several runs share: its error is common to all of them; an uncertainty of 0 means exact."""

    name: Name
    """by which runs refer to it"""
    offset_uncertainty_degC: TemperatureUncertainty | None = None
    """standard uncertainty of its error at 25 degC; by default unknown"""
    gain_uncertainty_percent: Percent | None = None
    """standard uncertainty of the error that grows with the distance from 25 degC, of that distance"""


class InstrumentsEntry(_Entry):
    """Standard uncertainties of other instruments, relative to their readings; 0 means exact, by default unknown."""

    clock_uncertainty_ppm: Millionths | None = None
    """of the clock of time_s, power_on_s and rates of temperature"""
    vibration_uncertainty_percent: Percent | None = None
    """of vibration_g_rms"""
    time_base_uncertainty_ppm: Millionths | None = None
    """of the time base of outputs that are counted per second"""
    meter_uncertainty_ppm: Millionths | None = None
    """of the meter of outputs in volts and amperes"""


class RunEntry(_Entry):
    """One run: procedure, equipment and the file of its run table."""

    name: Name
    """of the run in results, unique in the campaign"""
    procedure: str
    """test procedure: rate_table, dividing_head, …; `imubayes new FOLDER` without options lists them"""
    file: FileWithin
    """CSV or Parquet file of the run table, beside campaign.toml"""
    table: str | None = None
    """name of a [[table]]"""
    mounting: str | None = None
    """name of a [[mounting]]"""
    thermometer: str | None = None
    """name of the [[thermometer]] of temperature_degC"""
    converter_thermometer: str | None = None
    """name of the [[thermometer]] of converter_temperature_degC"""
    temperature_degC: float | None = Field(default=None, ge=-150, le=150)
    """of all rows, if the file has no column of that name"""
    converter_temperature_degC: float | None = Field(default=None, ge=-150, le=150)
    """of all rows, if the file has no column of that name"""
    temperature_uncertainty_degC: TemperatureUncertainty | None = Field(
        default=None,
        description="standard uncertainty of the error of temperature_degC that all rows of this run have in common, "
        "and no other run has: the prior of thermometer_error; exact if absent",
    )
    converter_temperature_uncertainty_degC: TemperatureUncertainty | None = None
    """the same of converter_temperature_degC: the prior of converter_thermometer_error"""
    start: datetime | date | None = None
    """when the run began; for timelines and trends"""
    initial_rest_s: Positive | None = None
    """of a free tumble: time at rest before the first motion; found if absent"""
    transitions: bool = False
    """of a raw log of a rate table with table_angle_deg: rows in motion are used as well, and follow that angle"""
    turn_uncertainty_deg: Positive | None = None
    """of a rate_table run whose turning rows are turns from rest to rest through a known angle, by hand or by a stop:
    standard uncertainty of that angle, which encoder_noise takes up"""
    ignore: list[str] = []
    """columns of the file that are not read"""


class EvaluationEntry(_Entry):
    """Limits of the classical evaluation and of the decisions made from a fit."""

    delta_k_threshold_percent: Positive | None = None
    """largest Δk up to which one line applies to all inputs of a converter"""


class CampaignFile(_Entry):
    """`campaign.toml`."""

    format: Literal[1]
    """of this file"""
    name: Name
    """of the campaign"""
    notes: list[str] = []
    """remarks, kept and not evaluated"""
    accepted: list[str] = []
    """names of findings about the set-up that are only warnings"""
    site: SiteEntry
    """site of the runs"""
    unit: UnitEntry = UnitEntry()
    """unit under test"""
    evaluation: EvaluationEntry = EvaluationEntry()
    """limits of decisions"""
    channel: list[ChannelEntry] = Field(min_length=1)
    """one for each sensitive axis"""
    table: list[TableEntry] = []
    """rate tables, dividing heads, polar axes, centrifuges"""
    mounting: list[MountingEntry] = []
    """seating of the unit on a table"""
    thermometer: list[ThermometerEntry] = []
    """those that several runs share"""
    instruments: InstrumentsEntry = InstrumentsEntry()
    """clock, vibration sensor, time base and meter of outputs"""
    run: list[RunEntry] = Field(min_length=1)
    """one for each recording"""


def _scalar(value: Any) -> float | int | str | bool:
    if not isinstance(value, int | float | str | bool) or (isinstance(value, float) and not math.isfinite(value)):
        raise ValueError(f"an option of an effect must be a finite number, a text, true or false (it is {value!r})")
    return value


Option = Annotated[Any, AfterValidator(_scalar)]


class EffectEntry(BaseModel):
    """One effect of a model; further keys are options of that effect and must be scalars."""

    model_config = ConfigDict(
        extra="allow",
        strict=True,
        allow_inf_nan=False,
        frozen=True,
        use_attribute_docstrings=True,
        json_schema_extra={"additionalProperties": {"type": ["number", "string", "boolean"]}},
    )
    __pydantic_extra__: dict[str, Option] = Field(init=False)  # pyright: ignore[reportIncompatibleVariableOverride]

    name: Name
    """of the effect; `imubayes effects` lists and explains them"""
    channels: Annotated[list[Name], Field(min_length=1)] | None = None
    """on which the effect acts; by default all of its kind"""
    per: Literal["channel", "all", "run", "mounting"] | None = None
    """scope over which a parameter has one value; by default as the effect declares"""
    prior: dict[str, str] = {}
    """prior by parameter, in place of the default"""
    optional: bool = False
    """leave the effect out if no run can show it"""

    @field_validator("channels")
    @classmethod
    def _no_channel_twice(cls, value: list[str] | None) -> list[str] | None:
        if value is not None and len(set(value)) < len(value):
            raise ValueError("a channel is listed twice")
        return value

    @property
    def options(self) -> dict[str, float | int | str | bool]:
        """The effect's own options, such as ``reference_degC``."""
        return dict(self.__pydantic_extra__ or {})


class PriorCorrelationEntry(_Entry):
    """Correlation of the priors of noise parameters; of their logarithms if these are lognormal."""

    parameters: list[str] = Field(min_length=2)
    """names as in results: flicker_noise.b[gx]"""
    matrix: list[list[float]] = Field(min_length=2)
    """symmetric, with ones on the diagonal"""
    optional: bool = False
    """leave out the parameters that the model does not have"""


class SetAsideEntry(_Entry):
    """Readings that are left out of the fit; their files stay as they are."""

    run: Name
    """of the campaign"""
    channels: list[Name] = []
    """of the unit; all if absent"""
    rows: list[Annotated[int, Field(ge=1)]] = []
    """of the run table, counted from 1; all if absent"""
    reason: Annotated[str, Field(min_length=1, max_length=400, pattern=_TEXT)]
    """why they are left out"""


class ModelFile(_Entry):
    """A model: a list of effects; `files` are Python sources of user-defined effects."""

    format: Literal[1]
    """of this file"""
    name: Name
    """of the model"""
    files: list[FileWithin] = []
    """Python files that define effects, beside the model file"""
    priors_from: Text = ""
    """source of the priors, such as the population of an archive; stated with each fit"""
    delta_k_threshold_percent: Positive | None = None
    """as in the campaign, whose value it overrides"""
    effect: list[EffectEntry] = Field(min_length=1)
    """the signal path; its order does not matter"""
    prior_correlation: list[PriorCorrelationEntry] = []
    """of noise parameters"""
    noise_priors: str | None = None
    """noise-priors.toml of `imubayes noise`, in place of the model's noise on its channels"""
    set_aside: list[SetAsideEntry] = []
    """readings that are left out of the fit, each with the reason"""


PATTERNS = {
    _NAME: "text without brackets, commas and control characters that does not begin with a blank",
    _TEXT: "text without control characters",
    COUNTRY: "two capital letters, ISO 3166-1",
    _FILE_WITHIN: "a file in the same folder or below, named from there without '..'",
    _COLUMN_NAME: "letters, digits, '_', '.' and '-', a letter or '_' first",
}
"""Pattern of a name → its description."""

FORMS = {
    "country": PATTERNS[COUNTRY],
    "start": "a date, or a date and time, without quotes: 2026-03-10T08:00:00Z",
    "azimuth_deg": 'a number from -360 to 360, or "unknown"',
    "input_axis": "three numbers: [1, 0, 0]",
    "inner_axis": "three numbers: [0, 0, 1]",
    "middle_axis": "three numbers: [1, 0, 0]",
    "output_axis": "three numbers: [0, 1, 0]",
    "body_to_table": "three rows of three numbers",
    "channels": 'a list of names: ["gx", "gy"]',
    "ignore": "a list of column names",
    "notes": "a list of texts",
    "accepted": 'a list of names of findings: ["table_zero"]',
    "files": "a list of Python files",
    "rows": "a list of numbers of rows, the first is 1: [3, 4]",
    "prior": 'texts by parameter: { bias = "normal(0, 10 deg/h)" }',
    "site": "a table [site]",
    "unit": "a table [unit]",
    "evaluation": "a table [evaluation]",
    "instruments": "a table [instruments]",
    "optional": "true or false, without quotes",
}
"""Key → form of its value, if the type alone does not describe it."""


@dataclass(frozen=True)
class Draft:
    """Entries that conform to the schema, by their index in the file.

    Attributes
    ----------
    site : None if missing or invalid.
    channels, tables, mountings, thermometers, runs : index in the file → entry.
    names : section → all names in it, including those of invalid entries.
    """

    site: SiteEntry | None
    channels: Mapping[int, ChannelEntry]
    tables: Mapping[int, TableEntry]
    mountings: Mapping[int, MountingEntry]
    thermometers: Mapping[int, ThermometerEntry]
    runs: Mapping[int, RunEntry]
    names: Mapping[str, list[str]]


def draft_of(content: Mapping[str, Any]) -> Draft:
    """Return the valid entries in the content of a campaign file."""
    sections = ("channel", "table", "mounting", "thermometer", "run")
    return Draft(
        _validated(content.get("site"), SiteEntry),
        _entries(content, "channel", ChannelEntry),
        _entries(content, "table", TableEntry),
        _entries(content, "mounting", MountingEntry),
        _entries(content, "thermometer", ThermometerEntry),
        _entries(content, "run", RunEntry),
        {section: _names(content, section) for section in sections},
    )


def _elements(content: Mapping[str, Any], section: str) -> list[Any]:
    value = content.get(section, [])
    return value if isinstance(value, list) else []


def _entries[Entry: BaseModel](content: Mapping[str, Any], section: str, kind: type[Entry]) -> dict[int, Entry]:
    entries = {index: _validated(value, kind) for index, value in enumerate(_elements(content, section))}
    return {index: entry for index, entry in entries.items() if entry is not None}


def _validated[Entry: BaseModel](value: Any, kind: type[Entry]) -> Entry | None:
    try:
        return kind.model_validate(value)
    except ValidationError:
        return None


def _names(content: Mapping[str, Any], section: str) -> list[str]:
    values = [value.get("name") for value in _elements(content, section) if isinstance(value, dict)]
    return [name for name in values if isinstance(name, str)]
