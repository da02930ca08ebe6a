"""Priors, each as the map from a standard normal z to the value.

Inference runs in z, where every prior is the same standard normal: `value(z)` is the prior's inverse
distribution function at Φ(z).  Positivity is then free, walkers start sensibly, and a posterior standard
deviation near 1 in z means that the data are uninformative.

A prior is written ``normal(0, 2000 ppm)``; the unit may be any of the parameter's dimension.
"""

import math
import re
from abc import abstractmethod
from collections.abc import Callable, Mapping
from functools import lru_cache

import equinox as eqx
import jax.numpy as jnp
from jax.scipy.special import ndtr, ndtri
from scipy import special

from imubayes.foundations.arrays import Array, Float, Scalar
from imubayes.foundations.errors import InputError, closest_first, input_error
from imubayes.foundations.tail_probabilities import normal_survival
from imubayes.foundations.units import same_dimension, to_si


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

    @abstractmethod
    def support(self) -> tuple[float, float]:
        """Return the smallest and the largest possible value: the physical domain of a parameter."""


def rounded_width(value: float) -> float:
    """Return the next 1, 2 or 5 times a power of ten: the width of a prior with room for a value above 0."""
    decade = 10.0 ** math.floor(math.log10(value))
    return next(step * decade for step in (1, 2, 5, 10) if step * decade >= value)


Number = float | Float[Array, "..."]
Refuse = Callable[[str, str], InputError]  # what is wrong, what is allowed → the error


class Normal(Prior):
    """normal(mean, standard deviation)."""

    mean: Number
    deviation: Number

    def value(self, z: Scalar) -> Scalar:
        return self.mean + self.deviation * z

    def z(self, value: float) -> float:
        return float((value - self.mean) / self.deviation)

    def sd(self) -> float:
        return float(self.deviation)

    def support(self) -> tuple[float, float]:
        return -math.inf, math.inf


class Uniform(Prior):
    """uniform(low, high)."""

    low: Number
    high: Number

    def value(self, z: Scalar) -> Scalar:
        return self.low + (self.high - self.low) * ndtr(z)

    def z(self, value: float) -> float:
        return float(special.ndtri((value - self.low) / (self.high - self.low)))

    def sd(self) -> float:
        return float((self.high - self.low) / math.sqrt(12))

    def support(self) -> tuple[float, float]:
        return float(self.low), float(self.high)


class LogNormal(Prior):
    """lognormal(median, standard deviation of the natural logarithm)."""

    median: Number
    log_deviation: Number

    def value(self, z: Scalar) -> Scalar:
        return self.median * jnp.exp(self.log_deviation * z)

    def z(self, value: float) -> float:
        return float(math.log(value / self.median) / self.log_deviation)

    def sd(self) -> float:
        s2 = float(self.log_deviation) ** 2
        return float(self.median) * math.sqrt((math.exp(s2) - 1) * math.exp(s2))

    def support(self) -> tuple[float, float]:
        return 0.0, math.inf


_FAR = 20.0


class HalfNormal(Prior):
    """halfnormal(scale): the absolute value of normal(0, scale)."""

    scale: Number

    def value(self, z: Scalar) -> Scalar:
        # ½(1 + Φ(z)) written through its complement keeps the digits of the upper tail.  Far out Φ(−z) underflows, in
        # derivatives first; there the root x of φ(x)/x = ½ φ(z)/z is written as a series in 1/z.
        near, far = jnp.minimum(z, _FAR), jnp.maximum(z, _FAR)
        beyond = far + math.log(2) / (far + 1 / far) - math.log(2) ** 2 / (2 * far**3)
        return self.scale * jnp.where(z > _FAR, beyond, -ndtri(0.5 * ndtr(-near)))

    def z(self, value: float) -> float:
        x = value / float(self.scale)
        if x < _FAR:
            return -float(special.ndtri(2 * float(normal_survival(x))))
        # The tail probability underflows: φ(x)/x = ½ φ(z)/z is solved for z.
        z = x
        for _ in range(4):
            z = math.sqrt(x**2 - 2 * math.log(2) + 2 * math.log(x / z))
        return z

    def sd(self) -> float:
        return float(self.scale) * math.sqrt(1 - 2 / math.pi)

    def support(self) -> tuple[float, float]:
        return 0.0, math.inf


class HalfCauchy(Prior):
    """halfcauchy(scale): the absolute value of a Cauchy variable."""

    scale: Number

    def value(self, z: Scalar) -> Scalar:
        return self.scale / jnp.tan(0.5 * jnp.pi * ndtr(-z))

    def z(self, value: float) -> float:
        return -float(special.ndtri(2 / math.pi * math.atan(self.scale / value)))

    def sd(self) -> float:
        return math.inf

    def support(self) -> tuple[float, float]:
        return 0.0, math.inf


class LogUniform(Prior):
    """loguniform(low, high)."""

    low: Number
    high: Number

    def value(self, z: Scalar) -> Scalar:
        return self.low * (self.high / self.low) ** ndtr(z)

    def z(self, value: float) -> float:
        return float(special.ndtri(math.log(value / self.low) / math.log(self.high / self.low)))

    def sd(self) -> float:
        low, high = float(self.low), float(self.high)
        log_ratio = math.log(high / low)
        mean = (high - low) / log_ratio
        return math.sqrt((high**2 - low**2) / (2 * log_ratio) - mean**2)

    def support(self) -> tuple[float, float]:
        return float(self.low), float(self.high)


# name → class, and for each argument whether it carries the parameter's unit
FAMILIES: dict[str, tuple[type[Prior], tuple[bool, ...]]] = {
    "normal": (Normal, (True, True)),
    "halfnormal": (HalfNormal, (True,)),
    "lognormal": (LogNormal, (True, False)),
    "uniform": (Uniform, (True, True)),
    "loguniform": (LogUniform, (True, True)),
    "halfcauchy": (HalfCauchy, (True,)),
}
# Units whose size depends on the channel.
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
    # The catalogue is parsed for every channel of every candidate model, mostly the same text: hence the cache.
    known = tuple(sorted((own or {}).items())) if _OF_CHANNEL.search(text + " " + unit) else ()
    return _parse_prior(text, unit, gravity, where, known)


@lru_cache(maxsize=4096)
def _parse_prior(text: str, unit: str, gravity: float, where: str, known: tuple[tuple[str, float], ...]) -> Prior:
    def refuse(what: str, allowed: str) -> InputError:
        example = f"normal(0, 1 {unit})" if unit != "1" else "normal(0, 1)"
        return input_error(what, where, allowed, f"write the prior like {example}")

    def in_si(number: str, written: str, carries: bool) -> float:
        if not carries and written != "1":
            raise refuse(
                f"'{written}' is not a unit here: a standard deviation of a logarithm has none", "a plain number"
            )
        if not same_dimension(written, unit if carries else "1", where):
            raise refuse(f"'{written}' is not a unit of this parameter", unit if carries else "a plain number")
        return float(number) * (to_si(written, gravity, where, dict(known)) if carries else 1.0)

    family, with_unit, arguments = _split(text, refuse)
    # The last unit that is given holds for the arguments without one: normal(0, 2000 ppm).
    stated = [argument["unit"] for argument, carries in zip(arguments, with_unit, strict=True) if carries]
    common = next((each for each in reversed(stated) if each), unit)
    numbers = [
        in_si(argument["number"], argument["unit"] or (common if carries else "1"), carries)
        for argument, carries in zip(arguments, with_unit, strict=True)
    ]
    _refuse_impossible(family, numbers, text, refuse)
    return family(*numbers)


def _split(text: str, refuse: Refuse) -> tuple[type[Prior], tuple[bool, ...], list[re.Match[str]]]:
    """Return the family of a prior, whether each argument carries a unit, and the arguments as written."""
    form = _FORM.match(text)
    if form is None:
        raise refuse(f"'{text}' is not a prior", ", ".join(f"{name}(…)" for name in FAMILIES))
    if form["family"] not in FAMILIES:
        raise refuse(f"'{form['family']}' is not a prior", closest_first(form["family"], FAMILIES))
    family, with_unit = FAMILIES[form["family"]]
    written = form["arguments"].split(",")
    arguments = [argument for argument in map(_ARGUMENT.match, written) if argument is not None]
    if not len(arguments) == len(written) == len(with_unit):
        fields = ", ".join(family.__dataclass_fields__)
        raise refuse(f"'{text}' does not have the arguments of {form['family']}", f"{form['family']}({fields})")
    return family, with_unit, arguments


def _refuse_impossible(family: type[Prior], numbers: list[float], text: str, refuse: Refuse) -> None:
    if not all(math.isfinite(number) for number in numbers):
        raise refuse(f"'{text}' has a number that is not finite", "finite numbers")
    if family in (Uniform, LogUniform):
        if not numbers[0] < numbers[1] or (family is LogUniform and numbers[0] <= 0):
            raise refuse(f"'{text}' has limits that cannot be used", "low < high, and low > 0 for loguniform")
    elif any(number <= 0 for number in (numbers[1:] if family is Normal else numbers)):
        raise refuse(f"'{text}' has a width that is not positive", "a standard deviation or scale above 0")
