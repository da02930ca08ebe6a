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
from functools import lru_cache, reduce

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.special import erfc
from scipy import special

from imubayes.foundations.arrays import Array, Float, Scalars, namespace
from imubayes.foundations.errors import InputError, closest_first, input_error
from imubayes.foundations.tail_probabilities import error_complement, normal_survival
from imubayes.foundations.units import NUMBER_AND_UNIT, same_dimension, to_si


class Prior(eqx.Module):
    """A one-dimensional prior in SI units."""

    @abstractmethod
    def value(self, z: Scalars) -> Scalars:
        """Return the value at standard normal z."""

    @abstractmethod
    def slope(self, z: Scalars) -> Scalars:
        """Return the derivative of the value by z."""

    @abstractmethod
    def z(self, value: float) -> float:
        """Return the z of a value (the inverse of `value`)."""

    @abstractmethod
    def sd(self) -> float:
        """Return the prior's standard deviation; infinite if it has none."""

    @abstractmethod
    def support(self) -> tuple[float, float]:
        """Return the smallest and the largest possible value: the physical domain of a parameter."""


def rounded_width(value: float) -> float:
    """Return the next 1, 2 or 5 times a power of ten: the width of a prior with room for a value above 0."""
    decade = 10.0 ** math.floor(math.log10(value))
    return next(step * decade for step in (1, 2, 5, 10) if step * decade >= value)


Number = float | Float[Array, "..."]
Refuse = Callable[[str, str], InputError]  # what is wrong, what is allowed → the error


# Priors are part of nearly every compiled program, and their derivatives of most: few operations, and slopes in closed
# form, which `jax.scipy.special.ndtri` and `ndtr` lack, make a program as much as twice as fast to compile.


def _probability(z: Scalars) -> Scalars:
    """Return Φ(z)."""
    return _traced_probability(z) if namespace(z) is jnp else 0.5 * error_complement(-math.sqrt(0.5) * z)


def _density(z: Scalars) -> Scalars:
    """Return φ(z)."""
    return namespace(z).exp(-0.5 * z**2) / math.sqrt(2 * math.pi)


@jax.custom_jvp
def _traced_probability(z: Scalars) -> Scalars:
    return 0.5 * erfc(-math.sqrt(0.5) * z)


_traced_probability.defjvps(lambda slope, _, z: slope * _density(z))


def _half_normal(z: Scalars) -> Scalars:
    """Return x with Φ(x) = ½ (1 + Φ(z)), to 1e-15 of itself."""
    return _traced_half_normal(z) if namespace(z) is jnp else _half_normal_value(z)


def _half_normal_value(z: Scalars) -> Scalars:
    xp = namespace(z)
    probability = _probability(xp.minimum(z, 1.0))
    square = 0.180625 - (0.5 * probability) ** 2
    near = 0.5 * probability * _polynomial(_NEAR, square) / _polynomial(_UNDER_NEAR, square)
    inverse = 1 / xp.maximum(z, 1.0)
    far = z + inverse * _polynomial(_FAR, inverse) / _polynomial(_UNDER_FAR, inverse)
    return xp.where(z > 1, far, near)


def _half_normal_slope(z: Scalars, x: Scalars) -> Scalars:
    """Return the derivative of x = `_half_normal(z)`, ½ φ(z)/φ(x)."""
    return 0.5 * namespace(z).exp(0.5 * (x - z) * (x + z))


_traced_half_normal = jax.custom_jvp(_half_normal_value)


@_traced_half_normal.defjvp
def _traced_half_normal_slope(points: tuple[Scalars], slopes: tuple[Scalars]) -> tuple[Scalars, Scalars]:
    (z,), (slope,) = points, slopes
    x = _half_normal(z)
    return x, _half_normal_slope(z, x) * slope


def _polynomial(coefficients: tuple[float, ...], x: Scalars) -> Scalars:
    """Return Σ cₖ xᵏ, from the highest power."""
    return reduce(lambda total, coefficient: total * x + coefficient, reversed(coefficients))


# Φ⁻¹(½ + q) about q = 0: Wichura, algorithm AS 241 (PPND16), Applied Statistics 37 (1988), 477.
_NEAR = (
    3.3871328727963666080, 133.14166789178437745, 1971.5909503065514427, 13731.693765509461125,
    45921.953931549871457, 67265.770927008700853, 33430.575583588128105, 2509.0809287301226727,
)  # fmt: skip
_UNDER_NEAR = (
    1.0, 42.313330701600911252, 687.18700749205790830, 5394.1960214247511077,
    21213.794301586595867, 39307.895800092710610, 28729.085735721942674, 5226.4952788528545610,
)  # fmt: skip
# z (x − z) in 1/z for z ≥ 1: fitted to 50 digits of x; its value at 0 is log 2.
_FAR = (
    0.6931471806330266429, 8.896548410273446999, 61.387779083201256975, 269.70238282173199071,
    791.20572522015217178, 1529.0846859119659486, 1782.9208073118473365, 926.23582970776694183,
)  # fmt: skip
_UNDER_FAR = (
    1.0, 12.835006294251321843, 89.910416283579335386, 406.38164857158737575, 1257.9108845720519933,
    2693.8851399501306758, 3873.8851122709387706, 3401.3351267320960961, 1373.2392910040186523,
)  # fmt: skip


class Normal(Prior):
    """normal(mean, standard deviation)."""

    mean: Number
    deviation: Number

    def value(self, z: Scalars) -> Scalars:
        return self.mean + self.deviation * z

    def slope(self, z: Scalars) -> Scalars:
        return self.deviation + 0.0 * z

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

    def value(self, z: Scalars) -> Scalars:
        return self.low + (self.high - self.low) * _probability(z)

    def slope(self, z: Scalars) -> Scalars:
        return (self.high - self.low) * _density(z)

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

    def value(self, z: Scalars) -> Scalars:
        return self.median * namespace(z).exp(self.log_deviation * z)

    def slope(self, z: Scalars) -> Scalars:
        return self.log_deviation * self.value(z)

    def z(self, value: float) -> float:
        return float(math.log(value / self.median) / self.log_deviation)

    def sd(self) -> float:
        s2 = float(self.log_deviation) ** 2
        return float(self.median) * math.sqrt((math.exp(s2) - 1) * math.exp(s2))

    def support(self) -> tuple[float, float]:
        return 0.0, math.inf


class HalfNormal(Prior):
    """halfnormal(scale): the absolute value of normal(0, scale)."""

    scale: Number

    def value(self, z: Scalars) -> Scalars:
        return self.scale * _half_normal(z)

    def slope(self, z: Scalars) -> Scalars:
        return self.scale * _half_normal_slope(z, _half_normal(z))

    def z(self, value: float) -> float:
        x = value / float(self.scale)
        if x < 20:
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

    def value(self, z: Scalars) -> Scalars:
        return self.scale / namespace(z).tan(0.5 * math.pi * _probability(-z))

    def slope(self, z: Scalars) -> Scalars:
        angle = 0.5 * math.pi * _probability(-z)
        return self.scale * 0.5 * math.pi * _density(z) / namespace(z).sin(angle) ** 2

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

    def value(self, z: Scalars) -> Scalars:
        return self.low * (self.high / self.low) ** _probability(z)

    def slope(self, z: Scalars) -> Scalars:
        return namespace(self.high, z).log(self.high / self.low) * _density(z) * self.value(z)

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


def parse_prior(text: str, unit: str, gravity: float, where: str, own: Mapping[str, float] | None = None) -> Prior:
    """Read a prior such as ``normal(0, 2000 ppm)``.

    Parameters
    ----------
    text : the prior as written.
    unit : the parameter's own unit, used if the text gives none.
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
    arguments = [argument for argument in map(NUMBER_AND_UNIT.match, written) if argument is not None]
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
