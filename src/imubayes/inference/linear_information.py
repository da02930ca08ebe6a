"""The information that the rows of a campaign carry, before anything is fitted.

The model is linear about nominal equipment and sensors, with the noise that the campaign states: the share of the
information on a coefficient that comes from the data follows from the rows alone, not from their readings.
"""

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from imubayes.effects.base import AmbientEffect
from imubayes.foundations.numerics import inverse_of_precision
from imubayes.inference.laplace_marginal import climb
from imubayes.inference.parameter_fit import Linearised, linearise_once, whitened_about
from imubayes.model.bind import Model
from imubayes.model.carried_motion import first_point
from imubayes.model.effect_registry import Registry
from imubayes.model.model_file import GRAVITY
from imubayes.parameters.declarations import Parameter, prior_slopes

STATION = ("station_heading", "station_level", "reference_alignment", "reference_scale_factor", "reference_bias",
           "injection_error")  # fmt: skip
"""Effects of the station and of reference sensors: no part of the unit under test."""
TOLD = 0.1
"""Least share of the information on a bias, scale factor or misalignment that comes from the data."""


def of_equipment() -> tuple[str, ...]:
    """Return the effects whose width a campaign states of its equipment, without those of ambient and gravity."""
    known = Registry()
    ambient = {name for name, member in known.effects.items() if issubclass(member, AmbientEffect)}
    return tuple(name for name in known.of_equipment() if name not in ambient and name != GRAVITY)


def untold_effects(model: Model) -> tuple[str, ...]:
    """Return the effects of sensors of a model of which the runs determine less than a tenth, beside all others."""
    known = linear_information(model)
    owner, told = known.owner, known.told
    others = {*of_equipment(), *STATION, *(e.name for e in model.assembly.effects if e.effect_class.nuisance)}
    names = [name for name in dict.fromkeys(owner.tolist()) if name not in others]
    return tuple(name for name in names if float(np.max(told[owner == name])) < TOLD)


@dataclass(frozen=True)
class LinearInformation:
    """A model linear about the middle of its priors; of a unit in motion, about the first estimate of its gyros.

    Attributes
    ----------
    parameters : P of them.
    precision, pull : shapes (P, P) and (P,), precision of θ with its prior, and precision × posterior mean.
    widths, slopes : shape (P,), prior widths, and SI units for one of z.
    scatter : root mean square of the whitened residuals of the whole model about its posterior mean; 1 if the noise is
        as assumed.
    about : the whole model linearised.
    """

    parameters: tuple[Parameter, ...]
    precision: np.ndarray
    pull: np.ndarray
    widths: np.ndarray
    slopes: np.ndarray
    scatter: float
    about: Linearised

    @cached_property
    def owner(self) -> np.ndarray:
        """The effects that the parameters belong to, (P,)."""
        return np.array([parameter.effect for parameter in self.parameters])

    @cached_property
    def covariance(self) -> np.ndarray:
        """Of the posterior of θ, (P, P)."""
        return inverse_of_precision(self.precision)

    @property
    def told(self) -> np.ndarray:
        """The share of the information on each parameter that comes from the data, (P,)."""
        return 1 - np.diag(self.covariance) / self.widths**2

    @property
    def expected_sd(self) -> np.ndarray:
        """Standard uncertainty of each parameter, (P,), SI, in noise as large as the residuals."""
        return max(1.0, self.scatter) * np.sqrt(np.diag(self.covariance)) * np.abs(self.slopes)

    @property
    def distances(self) -> np.ndarray:
        """Of the posterior means from the middle of the priors, (P,), in standard deviations of what is predicted.

        With posterior variance c and prior variance w a mean has the prior predictive variance w − c.
        """
        left = np.maximum(self.widths**2 - np.diag(self.covariance), np.finfo(float).tiny)
        return np.abs(self.covariance @ self.pull) / np.sqrt(left)

    def without(self, effects: Collection[str]) -> "LinearInformation":
        """Return the same of a model that lacks some effects."""
        inside = np.flatnonzero(~np.isin(self.owner, list(effects)))
        return LinearInformation(
            tuple(self.parameters[place] for place in inside), self.precision[np.ix_(inside, inside)],
            self.pull[inside], self.widths[inside], self.slopes[inside], self.scatter, self.about,
        )  # fmt: skip

    def widening(self, effect: str, of: Collection[str]) -> float:
        """Return the largest factor by which an effect widens the standard deviation of a parameter of some others."""
        other = self.owner != effect
        without = np.diag(self.without([effect]).covariance)
        ratio = (np.diag(self.covariance)[other] / without)[np.isin(self.owner[other], list(of))]
        return float(np.sqrt(np.max(ratio, initial=1.0)))


def linear_information(model: Model, h: np.ndarray | None = None, about: Linearised | None = None) -> LinearInformation:
    """Return the linear model at noise scales h, (H,), those of the campaign if None.

    Parameters
    ----------
    about : the model linearised, of a `LinearInformation` that is at hand.
    """
    about = about or _about_nominal(model)
    start = about.z
    scales = np.zeros(len(model.hyper_layout)) if h is None else h
    residual, jacobian, widths = whitened_about(model.problem, about, scales)
    precision = jacobian.T @ jacobian + np.diag(widths**-2)
    pull = jacobian.T @ (residual + jacobian @ start)
    left = residual + jacobian @ (start - np.linalg.solve(precision, pull))
    told = float(np.sum(1 - np.diag(inverse_of_precision(precision)) / widths**2))
    scatter = float(np.sqrt(left @ left / max(len(left) - told, 1.0)))
    slopes = np.asarray(prior_slopes(model.problem.priors, start))
    return LinearInformation(model.layout.parameters, precision, pull, widths, slopes, scatter, about)


def likely_scales(model: Model, about: Linearised | None = None) -> np.ndarray:
    """Return the most probable noise scales, (H,) in z, of a model linear about nominal equipment and sensors."""
    return climb(model.problem, about or _about_nominal(model), np.zeros(len(model.hyper_layout)))[0]


def _about_nominal(model: Model) -> Linearised:
    return linearise_once(model.problem, first_point(model.assembly))
