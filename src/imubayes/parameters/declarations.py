"""Parameters and options that an effect declares, and the flat parameter vector that they form.

Declarations are kept in the metadata of the effect's fields.

The vector has names and places on the host, and the transform from z to values on the device.  A `Layout` is the list
of scalar parameters.  `Priors` holds their priors stacked by family, so that a whole vector is transformed from z to SI
values in a few array operations, and a stack of units in one vmap.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import ModuleType
from typing import Any

import equinox as eqx
import jax
import numpy as np

from imubayes.foundations.arrays import Array, Float, Int, namespace, on_host, take_last
from imubayes.foundations.campaign_data import Grade, graded_prior
from imubayes.foundations.quantity_names import name_of
from imubayes.foundations.units import with_output_unit
from imubayes.parameters.priors import Prior


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
"""Domain of a parameter by its unit, if it declares none.  An error in ppm is that of a factor: at −100 % the output
no longer follows the input, and above 100 % the nominal factor is that of another unit.  An error in arcsec is that of
a direction: beyond 45° another axis is nearer.  One in mm or µm is that of a place on a table."""
GRAVITY_ERROR = Domain(-6, 6, "mg")
"""Of gravity at a site: between the equator and the poles it varies by 5.3 mg, with height by 0.3 mg a kilometre."""


@dataclass(frozen=True)
class Declared:
    """The declaration of one parameter; `parameter` explains its facts."""

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
    of_gyro: tuple[str, tuple[float, float]] | None = None

    def prior_of(self, grade: Grade, kind: str = "") -> str:
        """Return the default prior on a kind of channel for a grade of unit, as written in a model file."""
        if kind == "gyro" and self.of_gyro is not None:
            return self.of_gyro[0]
        return graded_prior(self.prior, self.unit, self.coarse, grade)

    def typical_of(self, kind: str) -> tuple[float, float]:
        """Return the smallest and largest magnitude met in practice on a kind of channel."""
        return self.of_gyro[1] if kind == "gyro" and self.of_gyro is not None else self.typical


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
    of_gyro: tuple[str, tuple[float, float]] | None = None,
) -> Any:
    """Declare a field of an effect as a parameter.

    Parameters
    ----------
    unit : datasheet unit used in files, tables and reports.
    prior : default prior, as written in a model file.
    typical : smallest and largest magnitude met in practice, in `unit`; if that is of the output, in `scale`
        instead of `output`, since channels differ in their output units.
    meaning : a phrase that completes "this is …".
    equipment : name of the equipment fact (see `imubayes.model.bind`) that replaces the default prior's
        width if the campaign states it, or empty.
    null : the value, in SI, at which the effect is the identity.
    per : sharing of its values, if it differs from the effect's own `per`.
    spread : name of the effect's parameter that is this one's standard deviation, learnt from the data.
    shape : for a nonlinear parameter that is not identified while the effect's coefficient is zero (a time constant,
        a limit): the grid, in `unit`, of the profile scan.
    coarse : width of the default prior for an industrial and for a consumer unit, in `unit`; None if it is the same
        for all grades.
    domain : possible values, by default those of its unit; None if only the prior limits them.
    of_gyro : default prior and typical range on a gyro, if those of `prior` and `typical` hold on an accelerometer
        only: a coefficient of the output squared is per deg/s on a gyro, and per g on an accelerometer.

    Examples
    --------
    >>> import imubayes
    >>> bias = imubayes.parameter("deg/h", "normal(0, 10 deg/h)", (0.1, 50), "the bias")
    >>> bias.metadata["parameter"].prior
    'normal(0, 10 deg/h)'
    """
    possible = domain or DOMAINS.get(unit)
    declared = Declared(unit, prior, typical, meaning, equipment, null, per, spread, shape, coarse, possible, of_gyro)
    return eqx.field(metadata={"parameter": declared})


def time_constant(meaning: str) -> Any:
    """Declare a field as the time constant of a transient, minutes to hours, with a scan grid of half-decades.

    Parameters
    ----------
    meaning : a phrase that completes "this is …".

    Examples
    --------
    >>> import imubayes
    >>> imubayes.time_constant("the time constant").metadata["parameter"].unit
    'min'
    """
    shape = (1.0, 3.0, 10.0, 30.0, 100.0)
    return parameter("min", "lognormal(10 min, 1.0)", (0.5, 120), meaning, null=600.0, shape=shape)


def thermal_play() -> Any:
    """Declare a field as the play w of a thermal hysteresis, half the width of its loop, with a scan grid."""
    shape = (0.5, 1.5, 3.0, 6.0, 12.0)
    meaning = "the play w, half the width of the loop"
    return parameter("degC", "lognormal(3 degC, 0.7)", (0.5, 20), meaning, null=3.0, shape=shape)


def option(default: float, meaning: str) -> Any:
    """Declare a field of an effect as a fixed setting that a model file may change, such as a reference.

    Parameters
    ----------
    default : its value if the model file states none, in SI.
    meaning : a phrase that completes "this is …".

    Examples
    --------
    >>> import imubayes
    >>> imubayes.option(9.81, "reference specific force, m/s²").default
    9.81
    """
    # By keyword, so that a shared formula can declare it before the parameters of the effects.
    return eqx.field(default=default, kw_only=True, metadata={"option": meaning})


def reference_temperature() -> Any:
    """Declare a field as the reference temperature of a temperature coefficient, °C.

    Examples
    --------
    >>> import imubayes
    >>> imubayes.reference_temperature().default
    25.0
    """
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


@dataclass(frozen=True)
class Parameter:
    """One scalar parameter: `effect.parameter[label]` with unit, the unit's SI value, and prior in SI.

    `output` is what the word `output` in its unit stands for; empty if that is not one unit.  `typical` are the
    smallest and the largest magnitude met in practice, in the unit.
    """

    effect: str
    field: str
    label: tuple[str, ...]
    unit: str
    factor: float
    prior: Prior
    nuisance: bool = False
    output: str = ""
    typical: tuple[float, float] = (0.0, np.inf)

    @property
    def shown_unit(self) -> str:
        """The unit as it is shown; `unit` is that of model files and priors."""
        return with_output_unit(self.unit, self.output)

    @cached_property
    def name(self) -> str:
        """The full name, as in model files, on the command line and in results."""
        return name_of(f"{self.effect}.{self.field}", *self.label)

    @property
    def prior_sd(self) -> float:
        """Standard deviation of the prior in the datasheet unit."""
        return self.prior.sd() / self.factor

    def z_at(self, value: float) -> float | None:
        """Return z of a value in the parameter's unit; None if its prior excludes that value."""
        try:
            z = float(self.prior.z(value * self.factor))
        except (ValueError, ZeroDivisionError, OverflowError):
            return None
        return z if np.isfinite(z) else None

    def value_at(self, z: float) -> float:
        """Return the value at z, in the parameter's unit (the inverse of `z_at`)."""
        return float(prior_values(Priors.stack([self.prior]), np.array([z]))[0]) / self.factor


@dataclass(frozen=True)
class Layout:
    """The scalar parameters in the order of the flat vector."""

    parameters: tuple[Parameter, ...]

    def __len__(self) -> int:
        return len(self.parameters)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """All names in order."""
        return tuple(parameter.name for parameter in self.parameters)

    def index(self, name: str) -> int:
        """Return the place of a parameter; raises ValueError for an unknown name."""
        return self.names.index(name)

    def factors(self) -> np.ndarray:
        """Return the SI value of each parameter's unit, shape (P,)."""
        return np.array([parameter.factor for parameter in self.parameters], dtype=float)

    def carried(self, source: "Layout", point: np.ndarray, default: np.ndarray | float = 0.0) -> np.ndarray:
        """Return a point of another layout in this one, matched by name.

        Parameters
        ----------
        source : the other layout.
        point : z in that layout, shape (its length,).
        default : z of parameters that the other layout lacks, shape (P,) or a scalar; 0 is the prior median.
        """
        values = dict(zip(source.names, point.tolist(), strict=True))
        defaults = np.broadcast_to(default, len(self)).tolist()
        return np.array([values.get(name, z) for name, z in zip(self.names, defaults, strict=True)], dtype=float)

    def z_of(self, values: Sequence[float] | np.ndarray) -> np.ndarray:
        """Return z of values given in datasheet units, shape (P,)."""
        pairs = zip(self.parameters, values, strict=True)
        return np.array([float(p.prior.z(value * p.factor)) for p, value in pairs])


class Priors(eqx.Module):
    """The priors of a whole vector, stacked by family.

    `sorted_by_family` lists the places of the vector family by family; `order` is its inverse.
    """

    families: tuple[Prior, ...]
    sorted_by_family: Int[Array, " P"] | np.ndarray
    order: Int[Array, " P"] | np.ndarray
    counts: tuple[int, ...] = eqx.field(static=True)

    @staticmethod
    def stack(priors: Sequence[Prior]) -> "Priors":
        """Sort priors by family and stack their numbers."""
        kinds = list(dict.fromkeys(type(prior) for prior in priors))
        places = [[i for i, prior in enumerate(priors) if type(prior) is kind] for kind in kinds]
        stacked = tuple(
            jax.tree.map(lambda *leaves: np.asarray(leaves, dtype=float), *[priors[i] for i in indices])
            for indices in places
        )
        flat = np.array([i for indices in places for i in indices], dtype=int)
        return Priors(stacked, flat, np.argsort(flat, kind="stable"), tuple(map(len, places)))

    def values(self, z: Float[Array, "*batch P"]) -> Float[Array, "*batch P"]:
        """Return SI values of a vector of z, or of many."""
        return _by_family(self, lambda prior, chosen: type(prior).value(prior, chosen), z)

    def slopes(self, z: Float[Array, "*batch P"]) -> Float[Array, "*batch P"]:
        """Return the derivative of each value by its own z."""
        return _by_family(self, lambda prior, chosen: type(prior).slope(prior, chosen), z)


# Functions of their class are called here: bound to a module of Equinox they take longer to look up than to evaluate.
def _by_family(priors: Priors, function: Callable[[Prior, Array], Array], z: Array) -> Array:
    if not priors.families:
        return z
    sorted_z, parts, start = take_last(z, priors.sorted_by_family), [], 0
    for family, count in zip(priors.families, priors.counts, strict=True):
        parts.append(function(family, sorted_z[..., start : start + count]))
        start += count
    return take_last(namespace(*parts).concatenate(parts, axis=-1), priors.order)


def prior_values(priors: Priors, z: Float[Array, "*batch P"]) -> np.ndarray:
    """Return SI values of a vector of z."""
    return on_host(priors).values(np.asarray(z))


def prior_slopes(priors: Priors, z: Float[Array, "*batch P"]) -> np.ndarray:
    """Return the derivative of each value by its own z."""
    return on_host(priors).slopes(np.asarray(z))
