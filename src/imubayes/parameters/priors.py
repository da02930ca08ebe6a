"""Priors, each as the map from a standard normal z to the value.

Inference runs in z, where every prior is the same standard normal: `value(z)` is the prior's inverse
distribution function at Φ(z).  Positivity is then free, walkers start sensibly, and a posterior standard
deviation near 1 in z means that the data said nothing.

A prior is written ``normal(0, 2000 ppm)``; the unit may be any of the parameter's dimension.
"""

import math
import re
from abc import abstractmethod
from collections.abc import Mapping
from functools import lru_cache

import equinox as eqx
import jax.numpy as jnp
from jax.scipy.special import ndtr, ndtri
from scipy import special

from imubayes.errors import InputError, Issue, closest_first
from imubayes.types import Array, Float, Scalar
from imubayes.units import same_dimension, to_si


class Prior(eqx.Module):
    """A one-dimensional prior in SI units."""

    @abstractmethod
    def value(self, z: Scalar) -> Scalar:
        """Return the value at standard normal z."""

    @abstractmethod
    def z(self, value: float) -> float:
        """Return the z of a value (the inverse of `value`)."""

    @abstractmethod
    def sd(self) -> float:
        """Return the prior's standard deviation; infinite where it has none."""


Number = float | Float[Array, "..."]


class Normal(Prior):
    """normal(mean, standard deviation)."""

    mean: Number
    deviation: Number

    def value(self, z):
        return self.mean + self.deviation * z

    def z(self, value):
        return float((value - self.mean) / self.deviation)

    def sd(self):
        return float(self.deviation)


class Uniform(Prior):
    """uniform(low, high)."""

    low: Number
    high: Number

    def value(self, z):
        return self.low + (self.high - self.low) * ndtr(z)

    def z(self, value):
        return float(special.ndtri((value - self.low) / (self.high - self.low)))

    def sd(self):
        return float((self.high - self.low) / math.sqrt(12))


class LogNormal(Prior):
    """lognormal(median, standard deviation of the natural logarithm)."""

    median: Number
    log_deviation: Number

    def value(self, z):
        return self.median * jnp.exp(self.log_deviation * z)

    def z(self, value):
        return float(math.log(value / self.median) / self.log_deviation)

    def sd(self):
        s2 = float(self.log_deviation) ** 2
        return float(self.median) * math.sqrt((math.exp(s2) - 1) * math.exp(s2))


class HalfNormal(Prior):
    """halfnormal(scale): the absolute value of normal(0, scale)."""

    scale: Number

    def value(self, z):
        # ½(1 + Φ(z)) written through its complement keeps the digits of the upper tail.
        return -self.scale * ndtri(0.5 * ndtr(-z))

    def z(self, value):
        return -float(special.ndtri(2 * special.ndtr(-value / self.scale)))

    def sd(self):
        return float(self.scale) * math.sqrt(1 - 2 / math.pi)


class HalfCauchy(Prior):
    """halfcauchy(scale): the absolute value of a Cauchy variable."""

    scale: Number

    def value(self, z):
        return self.scale / jnp.tan(0.5 * jnp.pi * ndtr(-z))

    def z(self, value):
        return -float(special.ndtri(2 / math.pi * math.atan(self.scale / value)))

    def sd(self):
        return math.inf


class LogUniform(Prior):
    """loguniform(low, high)."""

    low: Number
    high: Number

    def value(self, z):
        return self.low * (self.high / self.low) ** ndtr(z)

    def z(self, value):
        return float(special.ndtri(math.log(value / self.low) / math.log(self.high / self.low)))

    def sd(self):
        low, high = float(self.low), float(self.high)
        log_ratio = math.log(high / low)
        mean = (high - low) / log_ratio
        return math.sqrt((high**2 - low**2) / (2 * log_ratio) - mean**2)


# name → class, and for each argument whether it carries the parameter's unit
FAMILIES: dict[str, tuple[type[Prior], tuple[bool, ...]]] = {
    "normal": (Normal, (True, True)),
    "halfnormal": (HalfNormal, (True,)),
    "lognormal": (LogNormal, (True, False)),
    "uniform": (Uniform, (True, True)),
    "loguniform": (LogUniform, (True, True)),
    "halfcauchy": (HalfCauchy, (True,)),
}
# Units whose size is the channel's own.
_OF_CHANNEL = re.compile(r"\b(noise|scale)\b")
_FORM = re.compile(r"^\s*(?P<family>[A-Za-z_]+)\s*\((?P<arguments>(?:[^()]|\([^()]*\))*)\)\s*$")
_ARGUMENT = re.compile(r"^\s*(?P<number>[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(?P<unit>\S.*?)?\s*$")


def parse_prior(text: str, unit: str, gravity: float, where: str, own: Mapping[str, float] | None = None) -> Prior:
    """Read a prior such as ``normal(0, 2000 ppm)``.

    Parameters
    ----------
    text : the prior as written.
    unit : the parameter's own unit, used where the text gives none.
    gravity : gravity of the site in m/s², the value of the unit g.
    where : file and key, for the error.
    own : values of the units `noise` and `scale` for the channel at hand, output units.

    Raises
    ------
    InputError
        if the form, the family, a number or a unit cannot be used.
    """
    # The catalogue is read anew for every channel of every model looked at: most of it is the same text again.
    known = tuple(sorted((own or {}).items())) if _OF_CHANNEL.search(text + " " + unit) else ()
    return _parse_prior(text, unit, gravity, where, known)


@lru_cache(maxsize=4096)
def _parse_prior(text: str, unit: str, gravity: float, where: str, known: tuple[tuple[str, float], ...]) -> Prior:
    own = dict(known)

    def refuse(what: str, allowed: str) -> InputError:
        example = f"normal(0, 1 {unit})" if unit != "1" else "normal(0, 1)"
        return InputError(Issue(what, where, allowed, f"write the prior like {example}"))

    form = _FORM.match(text)
    if form is None:
        raise refuse(f"'{text}' is not a prior", ", ".join(f"{name}(…)" for name in FAMILIES))
    if form["family"] not in FAMILIES:
        raise refuse(f"'{form['family']}' is not a prior", closest_first(form["family"], FAMILIES))
    family, with_unit = FAMILIES[form["family"]]
    arguments = [_ARGUMENT.match(part) for part in form["arguments"].split(",")]
    if len(arguments) != len(with_unit) or any(argument is None for argument in arguments):
        fields = ", ".join(family.__dataclass_fields__)
        raise refuse(f"'{text}' does not have the arguments of {form['family']}", f"{form['family']}({fields})")
    found = [
        argument["unit"]
        for argument, carries in zip(arguments, with_unit, strict=True)
        if carries and argument is not None and argument["unit"]
    ]
    given = found[-1] if found else unit
    numbers: list[float] = []
    for argument, carries in zip(arguments, with_unit, strict=True):
        assert argument is not None
        written = argument["unit"] or (given if carries else "1")
        if not carries and written != "1":
            raise refuse(
                f"'{written}' is not a unit here: a standard deviation of a logarithm has none", "a plain number"
            )
        if not same_dimension(written, unit if carries else "1", where):
            raise refuse(f"'{written}' is not a unit of this parameter", unit if carries else "a plain number")
        numbers.append(float(argument["number"]) * (to_si(written, gravity, where, own) if carries else 1.0))
    _refuse_impossible(family, numbers, text, refuse)
    return family(*numbers)


def _refuse_impossible(family: type[Prior], numbers: list[float], text: str, refuse) -> None:
    if not all(math.isfinite(number) for number in numbers):
        raise refuse(f"'{text}' has a number that is not finite", "finite numbers")
    if family in (Uniform, LogUniform):
        if not numbers[0] < numbers[1] or (family is LogUniform and numbers[0] <= 0):
            raise refuse(f"'{text}' has limits that cannot be used", "low < high, and low > 0 for loguniform")
    elif any(number <= 0 for number in (numbers[1:] if family is Normal else numbers)):
        raise refuse(f"'{text}' has a width that is not positive", "a standard deviation or scale above 0")
