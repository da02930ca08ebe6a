"""Declarations of an effect's parameters and options, kept in the metadata of its fields."""

from dataclasses import dataclass
from types import ModuleType
from typing import Any

import equinox as eqx

from imubayes.parameters.unit_grades import Grade, graded_prior


@dataclass(frozen=True)
class Domain:
    """What a parameter can be in a unit and with equipment that exist: beyond, a fit has gone wrong.

    Attributes
    ----------
    low, high : ends, both excluded, in `unit`.
    unit : any of the parameter's dimension.
    """

    low: float
    high: float
    unit: str


_POSITION = Domain(-5, 5, "m")
DOMAINS: dict[str, Domain] = {
    "ppm": Domain(-100, 100, "%"), "arcsec": Domain(-45, 45, "deg"), "mm": _POSITION, "um": _POSITION,
}  # fmt: skip
"""Domain of a parameter by its unit, where it declares none.  An error in ppm is that of a factor: at −100 % the output
no longer follows the input, and above 100 % the nominal factor is that of another unit.  An error in arcsec is that of
a direction: beyond 45° another axis is nearer.  One in mm or µm is that of a place on a table."""
GRAVITY_ERROR = Domain(-6, 6, "mg")
"""Of gravity at a site: between the equator and the poles it varies by 5.3 mg, with height by 0.3 mg a kilometre."""


@dataclass(frozen=True)
class Declared:
    """The declaration of one parameter.

    Attributes
    ----------
    unit : datasheet unit used in files, tables and reports.
    prior : default prior, as written in a model file.
    typical : smallest and largest magnitude met in practice, in `unit`; where that is of the output, in `scale`
        instead of `output`, since channels differ in their output units.
    meaning : a phrase that completes "this is …".
    equipment : name of the equipment fact (see `imubayes.model.bind`) that replaces the default prior's
        width where the campaign states it, or empty.
    null : the value, in SI, at which the effect is the identity.
    per : what a value belongs to, where that differs from the effect's own `per`.
    spread : name of the effect's parameter that is this one's standard deviation, learnt from the data.
    shape : for a nonlinear parameter that is not identified while the effect's coefficient is zero (a time constant,
        a limit): the grid, in `unit`, of the profile scan.
    coarse : width of the default prior for an industrial and for a consumer unit, in `unit`; None where it is the same
        for all grades.
    domain : what it can be, by its unit where none is declared; None where only the prior says so.
    """

    unit: str
    prior: str
    typical: tuple[float, float]
    meaning: str
    equipment: str = ""
    null: float = 0.0
    per: tuple[str, ...] | None = None
    spread: str = ""
    shape: tuple[float, ...] = ()
    coarse: tuple[float, float] | None = None
    domain: Domain | None = None

    def prior_of(self, grade: Grade) -> str:
        """Return the default prior for a grade of unit, as written in a model file."""
        return graded_prior(self.prior, self.unit, self.coarse, grade)


def parameter(
    unit: str,
    prior: str,
    typical: tuple[float, float],
    meaning: str,
    equipment: str = "",
    null: float = 0.0,
    per: tuple[str, ...] | None = None,
    spread: str = "",
    shape: tuple[float, ...] = (),
    coarse: tuple[float, float] | None = None,
    domain: Domain | None = None,
) -> Any:
    """Declare a field of an effect as a parameter; see `Declared` for the arguments."""
    possible = domain or DOMAINS.get(unit)
    declared = Declared(unit, prior, typical, meaning, equipment, null, per, spread, shape, coarse, possible)
    return eqx.field(metadata={"parameter": declared})


def time_constant(meaning: str) -> Any:
    """Declare a field as the time constant of a transient, minutes to hours, with a scan grid of half-decades."""
    shape = (1.0, 3.0, 10.0, 30.0, 100.0)
    return parameter("min", "lognormal(10 min, 1.0)", (0.5, 120), meaning, null=600.0, shape=shape)


def thermal_play() -> Any:
    """Declare a field as the play w of a thermal hysteresis, half the width of its loop, with a scan grid."""
    shape = (0.5, 1.5, 3.0, 6.0, 12.0)
    meaning = "the play w, half the width of the loop"
    return parameter("degC", "lognormal(3 degC, 0.7)", (0.5, 20), meaning, null=3.0, shape=shape)


def option(default: float, meaning: str) -> Any:
    """Declare a field of an effect as a fixed setting that a model file may change, such as a reference."""
    # By keyword, so that a shared formula can declare it before the parameters of the effects.
    return eqx.field(default=default, kw_only=True, metadata={"option": meaning})


def reference_temperature() -> Any:
    """Declare a field as the reference temperature of a temperature coefficient, °C."""
    return option(25.0, "reference temperature T_ref, °C")


def declared_parameters(effect: type) -> dict[str, Declared]:
    """Return the parameters an effect or noise class declares, in the order of its fields."""
    fields = effect.__dataclass_fields__.values()
    return {field.name: field.metadata["parameter"] for field in fields if "parameter" in field.metadata}


def declared_options(effect: type) -> dict[str, float]:
    """Return the fixed settings an effect class has, with their defaults."""
    fields = effect.__dataclass_fields__.values()
    return {field.name: field.default for field in fields if "option" in field.metadata}


def named_in[Member](module: ModuleType, base: type[Member]) -> list[type[Member]]:
    """Return the subclasses of a base that a module defines under a `name`, in the order of definition."""
    members = [value for value in vars(module).values() if isinstance(value, type) and issubclass(value, base)]
    return [member for member in members if member.__module__ == module.__name__ and "name" in vars(member)]
