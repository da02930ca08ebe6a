"""Input quantities of an equation of the user's own: estimate, standard uncertainty, distribution, degrees of freedom.

Distributions are those of JCGM 101, table 1.  A normal input with ν degrees of freedom is drawn from Student's t scaled
by u (6.4.9): what is known after repeated readings.  A rectangular one whose limits are themselves known to ± d is the
curvilinear trapezoid of 6.4.3.  Draws, such as those of a fit, are their own distribution.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from imubayes.foundations.errors import input_error

DistributionName = Literal["normal", "t", "rectangular", "trapezoidal", "triangular", "arcsine", "draws"]
EvaluationType = Literal["A", "B"]
_OF_A_WIDTH = {"rectangular": 1 / math.sqrt(3), "triangular": 1 / math.sqrt(6), "arcsine": 1 / math.sqrt(2)}


@dataclass(frozen=True)
class InputQuantity:
    """An input quantity.  Made by one of its constructors: `normal`, `readings`, `between` or `from_draws`.

    Attributes
    ----------
    name : as the equation calls it.
    value, uncertainty : estimate and standard uncertainty.
    distribution : of its value.
    type : A from readings or draws of a fit, B from anything else (GUM 4).
    degrees_of_freedom : of the standard uncertainty; infinite if it is exact.
    half_width, inexact : half the distance of the limits, and half the range in which each limit lies; 0 without
        limits.
    top : of a trapezoid, its upper side over its base.
    draws : shape (S,), if these are the distribution; inputs with as many draws as each other are paired.

    Examples
    --------
    >>> import imubayes
    >>> mean = imubayes.InputQuantity.readings("t", [20.1, 20.3, 20.2])
    >>> round(mean.value, 3), round(mean.uncertainty, 4), mean.degrees_of_freedom
    (20.2, 0.0577, 2.0)
    """

    name: str
    value: float
    uncertainty: float
    distribution: DistributionName = "normal"
    type: EvaluationType = "B"
    degrees_of_freedom: float = math.inf
    half_width: float = 0.0
    inexact: float = 0.0
    top: float = 0.0
    draws: np.ndarray | None = None

    @classmethod
    def normal(
        cls, name: str, value: float, uncertainty: float, degrees_of_freedom: float = math.inf,
        type: EvaluationType = "B",
    ) -> "InputQuantity":  # fmt: skip
        """Return an input of estimate and standard uncertainty; Student's t if its degrees of freedom are finite.

        Raises
        ------
        InputError
            for an uncertainty or degrees of freedom that are not positive, and for values that are not finite.
        """
        if not (math.isfinite(value) and math.isfinite(uncertainty) and uncertainty >= 0):
            raise _error(name, f"the estimate {value:g} with the standard uncertainty {uncertainty:g}",
                         "finite numbers, the uncertainty 0 or more")  # fmt: skip
        if not degrees_of_freedom > 0:
            raise _error(name, f"{degrees_of_freedom:g} degrees of freedom", "a number above 0, or math.inf")
        shape: DistributionName = "normal" if math.isinf(degrees_of_freedom) else "t"
        return cls(name, float(value), float(uncertainty), shape, type, float(degrees_of_freedom))

    @classmethod
    def readings(cls, name: str, values: Sequence[float]) -> "InputQuantity":
        """Return the mean of independent readings, type A: u = s/√n with n − 1 degrees of freedom (GUM 4.2).

        Raises
        ------
        InputError
            for fewer than two readings, or readings that are not finite.
        """
        known = _finite(name, values, "readings")
        u = float(known.std(ddof=1)) / math.sqrt(len(known))
        return cls.normal(name, float(known.mean()), u, len(known) - 1.0, "A")

    @classmethod
    def between(
        cls, name: str, low: float, high: float,
        distribution: Literal["rectangular", "trapezoidal", "triangular", "arcsine"] = "rectangular", *,
        inexact: float = 0.0, top: float = 0.0, degrees_of_freedom: float = math.inf,
    ) -> "InputQuantity":  # fmt: skip
        """Return an input that is between limits.

        Parameters
        ----------
        inexact : half of the range that the limits themselves are in; a rectangular distribution only.
        top : of a trapezoid, its upper side over its base: 0 a triangle, 1 a rectangle.
        degrees_of_freedom : of the standard uncertainty, for the budget (GUM G.4.2); the draws do not depend on it.

        Raises
        ------
        InputError
            for limits that are crossed or not finite, and for invalid `top`, `inexact` or `degrees_of_freedom`.
        """
        half = (high - low) / 2
        if not (math.isfinite(half) and half > 0):
            raise _error(name, f"the limits {low:g} … {high:g}", "finite, low < high")
        if not 0 <= inexact <= half or (inexact and distribution != "rectangular"):
            raise _error(name, f"limits known to ± {inexact:g}", "0 … half their distance, for a rectangular one")
        if not 0 <= top <= 1:
            raise _error(name, f"the upper side {top:g} of a trapezoid", "0 … 1")
        if not degrees_of_freedom > 0:
            raise _error(name, f"{degrees_of_freedom:g} degrees of freedom", "a number above 0, or math.inf")
        if distribution == "trapezoidal":
            u = half * math.sqrt((1 + top**2) / 6)
        else:
            u = math.sqrt((half * _OF_A_WIDTH[distribution]) ** 2 + inexact**2 / 9)
        return cls(name, (low + high) / 2, u, distribution, "B", degrees_of_freedom, half, inexact, top)

    @classmethod
    def from_draws(cls, name: str, draws: np.ndarray) -> "InputQuantity":
        """Return an input with draws of its distribution, such as those of a quantity of a fit: `result.draws[…]`.

        Inputs with as many draws as each other keep their pairs, and with these their correlation.

        Raises
        ------
        InputError
            for fewer than two draws, or draws that are not finite.
        """
        known = _finite(name, draws, "draws")
        return cls(name, float(known.mean()), float(known.std()), "draws", "A", draws=known)

    def sampled(self, scores: np.ndarray, random: np.random.Generator) -> np.ndarray:
        """Return draws, (n,), from standard normal scores of the same shape if the input is normal or t."""
        count = len(scores)
        if self.distribution in ("normal", "t"):
            nu = self.degrees_of_freedom
            wider = 1.0 if math.isinf(nu) else np.sqrt(nu / random.chisquare(nu, count))
            return self.value + self.uncertainty * scores * wider
        half, first, second = self.half_width, random.uniform(size=count), random.uniform(size=count)
        if self.distribution == "arcsine":
            return self.value + half * np.cos(np.pi * first)
        if self.distribution == "rectangular":
            # JCGM 101, 6.4.3.4: limits whose half distance is between half − d and half + d.
            width = half + self.inexact * (2 * first - 1) if self.inexact else half
            return self.value + width * (2 * second - 1)
        top = self.top if self.distribution == "trapezoidal" else 0.0
        return self.value + half / 2 * ((1 + top) * (2 * first - 1) + (1 - top) * (2 * second - 1))


def _finite(name: str, values: Sequence[float] | np.ndarray, what: str) -> np.ndarray:
    """Return two or more finite values, (n,); raises InputError for others."""
    known = np.asarray(values, dtype=float).ravel()
    if len(known) < 2 or not np.isfinite(known).all():
        raise _error(name, f"{len(known)} {what}, or some that are not finite", f"two finite {what} or more")
    return known


def _error(name: str, what: str, allowed: str) -> Exception:
    return input_error(what, f"input quantity '{name}'", allowed, "correct it")
