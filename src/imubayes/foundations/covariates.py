"""The registry of covariates: what a run may carry beside the outputs of its channels, one entry each.

An entry holds every fact about a covariate: its column in run tables and results, the unit there and in SI, the words
and the symbol it is shown by, and whether effects see it, figures show it and diagnosis regresses residuals on it.
Adding a covariate is adding an entry.  In a unit, g is the gravity of the site.  Beside covariates, effects need
conditions of a run, such as a table that turns; they are registered at the end.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from imubayes.foundations.units import STANDARD_GRAVITY, to_si

Origin = Literal["recorded", "derived", "sample"]
REFERENCE_TEMPERATURE = 25.0
"""Temperature at which scale factors and biases are stated, and to which thermal terms refer by default, °C."""


@dataclass(frozen=True)
class Covariate:
    """One covariate.

    Attributes
    ----------
    name : key in `Run.covariates` and attribute of `sample.ambient`.
    column : name in run tables, residuals and diagnoses; the suffix is the unit.
    unit : unit of the column, for files and display.
    si : SI unit of the values inside (temperatures stay in °C).
    phrase : name in sentences and on axes.
    origin : ``recorded`` in a column, ``derived`` from recorded columns by the procedure, or evaluated by the model at
        each ``sample`` along the axes of the channel.
    ambient : whether effects see it as `sample.ambient.<name>`.
    shown : whether residual tables and figures have it.
    regressor : whether diagnosis looks for residuals that depend on it.
    symbol : symbol in formulas; empty if the formula search leaves it out.
    centre : value that formulas subtract from it, `unit`.
    expression : Python of the value in SI in a generated effect; `sample.ambient.<name>` if empty.
    needs : what a run must supply for it; its own name if None.
    source : what brings it into a run, if the column alone does not.
    periodic : whether it is an angle, which enters formulas by harmonics.
    relative : whether it acts by its change, not by its distance from zero, which is arbitrary.
    symmetric : whether it acts alike in both directions, so that a resonance lies at its magnitude.
    instrument : what a standard for its readings is called among the equipment of a certificate; empty if the table,
        the reference or the current source of a run supplies it, or the model.
    absent : what a run without it has; empty if it has some value that nobody knows, so that an effect that needs
        it cannot be bound to that run.
    """

    name: str
    column: str
    unit: str
    si: str
    phrase: str
    origin: Origin = "recorded"
    ambient: bool = True
    shown: bool = True
    regressor: bool = True
    symbol: str = ""
    centre: float = 0.0
    expression: str = ""
    needs: tuple[str, ...] | None = None
    source: str = ""
    periodic: bool = False
    relative: bool = False
    symmetric: bool = False
    absent: str = ""
    instrument: str = ""

    def factor(self, gravity: float = STANDARD_GRAVITY) -> float:
        """Return the factor from `unit` to SI at a site of the given gravity, m/s²."""
        return to_si(self.unit, gravity)

    @property
    def python(self) -> str:
        """The value less its centre, in SI, as a generated effect writes it."""
        plain = self.expression or f"sample.ambient.{self.name}"
        return f"({plain} - {self.centre})" if self.centre else plain

    @property
    def needed(self) -> tuple[str, ...]:
        """What a run must supply for it."""
        return (self.name,) if self.needs is None else self.needs


def _sample_axes() -> Iterable[Covariate]:
    quantities = (("rate", "deg/s", "rad/s", "rate", "Ω"), ("force", "g", "m/s^2", "specific force", "f"))
    for name, unit, si, phrase, symbol in quantities:
        for number, (letter, axis) in enumerate(zip("ios", ("input", "output", "third"), strict=True)):
            yield Covariate(
                f"{name}_{letter}", f"{name}_{letter}", unit, si, f"{phrase} along the {axis} axis", "sample",
                ambient=False, shown=False, symbol=f"{symbol}_{letter}", expression=f"sample.{name}[{number}]",
                needs=(), symmetric=True,
            )  # fmt: skip


def _outer_axes() -> Iterable[Covariate]:
    for name, letter in (("outer", "o"), ("middle", "m")):
        yield Covariate(
            f"{name}_rate", f"{name}_rate_deg_s", "deg/s", "rad/s", f"rate of the {name} axis", regressor=False,
            absent="no such axis",
        )  # fmt: skip
        yield Covariate(
            f"{name}_angle", f"{name}_angle_deg", "deg", "rad", f"angle of the {name} axis", symbol=f"φ_{letter}",
            periodic=True, source=f"a run on a table with {_ARTICLE[name]} {name} axis", absent="no such axis",
        )  # fmt: skip
        yield Covariate(
            f"{name}_angle_span", f"{name}_angle_span_deg", "deg", "rad", f"angle swept by the {name} axis",
            ambient=False, shown=False, regressor=False,
        )  # fmt: skip
        yield Covariate(
            f"{name}_acceleration", f"{name}_acceleration_deg_s2", "deg/s^2", "rad/s^2",
            f"acceleration of the {name} axis", ambient=False, shown=False, regressor=False,
        )  # fmt: skip


_ARTICLE = {"outer": "an", "middle": "a"}


def _rows_in_motion() -> Iterable[Covariate]:
    """Yield what is known of a row in which the table moves: its duration, and the path of the angle within it."""
    source = "a raw log of a rate table with table_angle_deg and transitions = true"
    facts = {"ambient": True, "shown": False, "regressor": False, "source": source, "absent": "a constant stimulus"}
    yield Covariate("row_seconds", "row_s", "s", "s", "duration of the row", **facts)
    for order, word in zip(HIGHER_DERIVATIVES, ("third", "fourth", "fifth", "sixth", "seventh", "eighth"), strict=True):
        yield Covariate(
            f"table_angle_d{order}", f"table_angle_d{order}_deg_s{order}", f"deg/s^{order}", f"rad/s^{order}",
            f"{word} derivative of the table angle", **facts,
        )  # fmt: skip
    for order, word in zip(ROW_SLOPES, ("first", "second", "third", "fourth", "fifth", "sixth"), strict=True):
        yield Covariate(
            f"row_slope_{order}", f"row_slope_{order}_s{order}", f"1/s^{order}", f"1/s^{order}",
            f"weight of an instant in the mean {word} derivative over its row, over its weight in the mean",
            "derived", **facts,
        )  # fmt: skip


HIGHER_DERIVATIVES = (3, 4, 5, 6, 7, 8)
"""Orders of the derivatives of the table angle that a row in motion has beside rate and acceleration.

A polynomial of the eighth degree follows 8 Hz over a row of 60 ms to 1e-6 of the rate, and its mean rate exactly."""
ROW_SLOPES = (1, 2, 3, 4, 5, 6)
"""Orders n of `row_slope_n`: the sum of weight · row_slope_n · x over the instants of a row is the mean of dⁿx/dtⁿ.

An effect that multiplies its signal by 1 − τ·row_slope_1 + τ²·row_slope_2 − … gives its row the mean of the lagged
signal. `shared_formulas.lagged` does."""
_KELVIN_PER_SECOND = "degC/s"
_CLOCK = "time"
_ENTRIES = (
    Covariate(
        "time", "time_s", "s", "s", "time since the start of the run", symbol="t", relative=True, instrument=_CLOCK
    ),
    Covariate(
        "campaign_time", "campaign_time_h", "h", "s", "time since the first run", "derived", shown=False,
        source="time_s, and 'start' of the run if other runs have it", relative=True, instrument=_CLOCK,
    ),
    Covariate(
        "power_on", "power_on_s", "s", "s", "time since power-on", symbol="t_on", absent="long since on",
        relative=True, instrument=_CLOCK,
    ),
    Covariate(
        "table_rate", "table_rate_deg_s", "deg/s", "rad/s", "table rate", regressor=False, absent="a table at rest"
    ),
    Covariate(
        "table_angle", "table_angle_deg", "deg", "rad", "table angle", symbol="φ", periodic=True,
        source="a run on a table", absent="no table, or means over whole turns",
    ),
    Covariate(
        "table_angle_span", "table_angle_span_deg", "deg", "rad", "table angle swept", ambient=False, shown=False,
        regressor=False,
    ),
    Covariate(
        "table_acceleration", "table_acceleration_deg_s2", "deg/s^2", "rad/s^2", "table acceleration", ambient=False,
        shown=False, regressor=False,
    ),
    *_rows_in_motion(),
    *_outer_axes(),
    Covariate(
        "temperature", "temperature_degC", "degC", "degC", "temperature", symbol="ΔT", centre=25.0, relative=True,
        source="temperature_degC, as a column or for the whole run", instrument="temperature",
    ),
    Covariate(
        "temperature_rate", "temperature_rate_degC_min", "degC/min", _KELVIN_PER_SECOND,
        "the rate of change of temperature", "derived", shown=False, symbol="dT/dt", symmetric=True,
        instrument="temperature",
        source="time_s and a temperature_degC that changes",
    ),
    Covariate(
        "converter_temperature", "converter_temperature_degC", "degC", "degC", "converter temperature", symbol="ΔT_c",
        centre=25.0, relative=True, instrument="converter_temperature",
        source="converter_temperature_degC, as a column or for the whole run",
    ),
    Covariate(
        "converter_temperature_rate", "converter_temperature_rate_degC_min", "degC/min", _KELVIN_PER_SECOND,
        "the rate of change of the converter's temperature", "derived", shown=False,
        instrument="converter_temperature",
        source="time_s and a converter_temperature_degC that changes",
    ),
    Covariate("current", "current_mA", "mA", "A", "injected current", absent="none"),
    Covariate(
        "vibration", "vibration_g_rms", "g", "m/s^2", "vibration, rms", shown=False, regressor=False, absent="none",
        instrument="vibration",
    ),
    *(
        Covariate(
            f"reference_{axis}", f"reference_{axis}_deg_s", "deg/s", "rad/s", f"rate of the reference about {axis}",
            ambient=False, shown=False, regressor=False,
        )
        for axis in "xyz"
    ),
    *_sample_axes(),
)  # fmt: skip

COVARIATES: dict[str, Covariate] = {covariate.name: covariate for covariate in _ENTRIES}
"""Name → covariate."""


TEMPERATURE_COLUMNS = tuple(each.column for each in COVARIATES.values() if each.si == "degC")
"""Columns of run tables that hold temperatures: of the sensors, and of the converter."""

RATE_COLUMNS = tuple(each.column for each in COVARIATES.values() if each.si == "rad/s" and each.origin == "recorded")
"""Columns of run tables that hold rates: of the axes of a table, and of a reference gyro."""


def recorded() -> tuple[Covariate, ...]:
    """Return the covariates that are columns of run tables."""
    return tuple(covariate for covariate in COVARIATES.values() if covariate.origin == "recorded")


def recorded_columns() -> tuple[str, ...]:
    """Return the columns of run tables that hold covariates."""
    return tuple(covariate.column for covariate in recorded())


def ambient_names() -> tuple[str, ...]:
    """Return the names of the covariates that effects see."""
    return tuple(covariate.name for covariate in COVARIATES.values() if covariate.ambient)


def shown() -> tuple[Covariate, ...]:
    """Return the covariates of residual tables and figures."""
    return tuple(covariate for covariate in COVARIATES.values() if covariate.shown)


def regressors() -> tuple[Covariate, ...]:
    """Return the covariates of diagnosis: rates and forces, temperatures, the other recorded ones, the derived."""
    order = {"sample": 0, "recorded": 1, "derived": 2}
    chosen = [covariate for covariate in COVARIATES.values() if covariate.regressor]
    return tuple(sorted(chosen, key=lambda covariate: (order[covariate.origin], covariate.si != "degC")))


INPUTS: dict[str, str] = {"gyro": "rate_i", "accelerometer": "force_i"}
"""Kind of channel → the covariate that its signal follows."""
CONDITIONS: dict[str, str] = {
    "turning": "a run that turns",
    "acceleration": "table_acceleration_deg_s2 that is not 0",
    "larger input": "a larger input",
    "response": "a run that responds to it",
    "second run": "a second run of the channel",
    "reference": "a reference gyro on the same table",
    "injection": "a run of procedure current_injection",
    "temperature uncertainty": "a run that states temperature_uncertainty_degC",
    "converter_temperature uncertainty": "a run that states converter_temperature_uncertainty_degC",
    "thermometer": "a run that names a [[thermometer]]",
    "converter_thermometer": "a run that names a [[thermometer]] of its converter",
    "thermometer uncertainty": "a [[thermometer]] that states an uncertainty",
    "converter_thermometer uncertainty": "a [[thermometer]] that states an uncertainty",
    "hand": "a unit in motion: slow_motion or free_rotation",
    "carried": "a unit in motion with gyros about three axes: slow_motion or free_rotation",
    "posed": "a free tumble",
    "driven": "a table that the gyro drives",
    "unknown_heading": 'a table with azimuth_deg = "unknown", or a record at rest without a table',
    "unknown_level": 'azimuth_deg = "unknown" without axis_uncertainty_arcsec, or a record at rest without a table',
    "directions": "positions named by directions of the site (i_axis, o_axis)",
    "stand": "a run",
    "table": "a run on a table",
    "mounting": "a run in a mounting",
    "pose": "a free tumble",
    "free tumble": "a free tumble",
    "gyro": "a gyro",
    "accelerometer": "an accelerometer",
}
"""Needs of an effect that no run shows, other than a covariate → the same in words."""


def instruments(names: Iterable[str]) -> tuple[str, ...]:
    """Return what standards for the readings of covariates are called; other words, such as conditions, have none."""
    known = (COVARIATES[name].instrument for name in names if name in COVARIATES)
    return tuple(dict.fromkeys(filter(None, known)))


def remedy(need: str) -> str:
    """Return what brings a covariate or condition into a run, in words."""
    if need in COVARIATES:
        return COVARIATES[need].source or COVARIATES[need].column
    return CONDITIONS.get(need, need)


def effects_by_need(lacking: Iterable[tuple[str, Iterable[str]]]) -> str:
    """Return what would bring out effects that no run shows: each need in words, with its effects."""
    by_need: dict[str, list[str]] = {}
    for effect, needs in lacking:
        by_need.setdefault("; ".join(map(remedy, needs)) or "a run that responds", []).append(effect)
    return "; ".join(f"{need} ({', '.join(effects)})" for need, effects in by_need.items())
