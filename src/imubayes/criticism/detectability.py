"""Who would swallow an effect that the model lacks, and how small an effect these runs could still show."""

from dataclasses import dataclass

import numpy as np
from scipy import stats

from imubayes.criticism import thresholds
from imubayes.criticism.projection import Projection
from imubayes.criticism.score_test import ProjectedResponse


@dataclass(frozen=True)
class Absorber:
    """What hides an effect: parameter family (`effect.parameter`, or `run offsets`) and its share."""

    parameter: str
    share: float


@dataclass(frozen=True)
class ParameterBias:
    """What an effect of the largest usual size does unseen to the parameter it shifts most.

    Attributes
    ----------
    parameter, unit : name and unit.
    value, in_sd : the shift, in that unit and in posterior standard deviations.
    """

    parameter: str
    unit: str
    value: float
    in_sd: float


@dataclass(frozen=True)
class Detectability:
    """How well the runs can see one effect.

    Attributes
    ----------
    effect, unit, name : of the coefficient that is seen best, relative to its typical size.
    retained : share of its response that the model cannot absorb.
    smallest_detectable : size that would be found with a chance of 80 %, in its unit; infinite where none would.
    typical : smallest and largest magnitude met in practice.
    absorbed_by : what swallows the rest, largest first.
    bias : what it would do to the reported parameters where it is there and not modelled; None where nothing is.
    """

    effect: str
    name: str
    unit: str
    retained: float
    smallest_detectable: float
    typical: tuple[float, float]
    absorbed_by: tuple[Absorber, ...]
    bias: ParameterBias | None

    @property
    def undetectable(self) -> bool:
        """Whether even the largest size met in practice would be missed."""
        return self.smallest_detectable > self.typical[1]


def detectability(projection: Projection, one: ProjectedResponse, threshold: float, looks: float) -> Detectability:
    """Return how well the runs can see a candidate: by the coefficient that they see best.

    Parameters
    ----------
    threshold : chance of a false alarm over all looks.
    looks : how many independent looks there are.
    """
    length = np.linalg.norm(one.projected, axis=0)
    raw = np.sum((projection.root[:, None] * one.response.columns) ** 2, axis=0)
    needed = stats.norm.isf(threshold / max(looks, 1.0) / 2) + stats.norm.ppf(thresholds.DETECTION_POWER)
    typical = np.array([coefficient.typical[1] for coefficient in one.response.coefficients])
    with np.errstate(divide="ignore"):
        smallest = needed * np.where(length > 1e-9 * np.sqrt(raw), 1 / length, np.inf)
    best = int(np.argmin(smallest / typical))
    coefficient = one.response.coefficients[best]
    retained = float(length[best] ** 2 / raw[best]) if raw[best] > 0 else 0.0
    return Detectability(
        effect=one.response.scan.effect,
        name=coefficient.parameter.name,
        unit=coefficient.parameter.unit,
        retained=retained,
        smallest_detectable=float(smallest[best]),
        typical=coefficient.typical,
        absorbed_by=_absorbers(projection, one.whitened[:, best], float(raw[best])),
        bias=_bias(projection, one.whitened[:, best] * coefficient.typical[1]),
    )


def _bias(projection: Projection, whitened: np.ndarray) -> ParameterBias | None:
    """Return the shift of the parameter that a change of the readings moves most, in its posterior sd."""
    shift = projection.absorb(whitened)
    if not len(shift):
        return None
    in_sd = shift / projection.posterior_sd
    most = int(np.argmax(np.abs(in_sd)))
    parameter = projection.fitted.model.layout.parameters[most]
    value = float(shift[most] * projection.slopes[most] / parameter.factor)
    return ParameterBias(parameter.name, parameter.unit, value, float(in_sd[most]))


def _absorbers(projection: Projection, whitened: np.ndarray, raw: float) -> tuple[Absorber, ...]:
    """Return the shares of a response that each family of parameters, and the run offsets, take up."""
    if raw <= 0:
        return ()
    model = projection.fitted.model
    fit = projection.absorb(whitened)
    taken: dict[str, float] = {"run offsets": max(0.0, 1 - float(whitened @ whitened) / raw)}
    # Shares of the regression: g·(J_k c_k)/|g|² add up to what is absorbed in all.
    shares = (projection.jacobian * fit).T @ whitened / raw
    for parameter, share in zip(model.layout.parameters, shares.tolist(), strict=True):
        family = f"{parameter.effect}.{parameter.field}"
        taken[family] = taken.get(family, 0.0) + share
    absorbed = sum(taken.values())
    positive = {name: share for name, share in taken.items() if share > 0}
    whole = sum(positive.values()) or 1.0
    found = [Absorber(name, share / whole * min(absorbed, 1.0)) for name, share in positive.items()]
    return tuple(sorted((one for one in found if one.share >= thresholds.ABSORBER_SHARE), key=lambda one: -one.share))
