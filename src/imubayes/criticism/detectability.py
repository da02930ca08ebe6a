"""Detectability: what absorbs an effect that the model lacks, and how small an effect these runs could still show."""

from dataclasses import dataclass

import numpy as np
from scipy import special

from imubayes.criticism import thresholds
from imubayes.criticism.candidate_effects import Response, stated_size
from imubayes.criticism.projection import Projection
from imubayes.criticism.score_test import KNOWN_FREEDOM, LEAST_FREEDOM, ProjectedResponse
from imubayes.tail_probabilities import normal_survival

_QUANTILES = 64
RUN_OFFSETS = "run offsets"


@dataclass(frozen=True)
class Absorber:
    """What hides an effect: parameter family (`effect.parameter`, or `RUN_OFFSETS`) and its share of the response."""

    parameter: str
    share: float


@dataclass(frozen=True)
class ParameterBias:
    """The parameter that an effect of the largest typical size biases most while undetected.

    None of that size is assumed where the campaign states the uncertainty of the equipment.

    Attributes
    ----------
    parameter, unit : name and unit.
    value, in_sd : the bias, in that unit and in posterior standard deviations.
    coefficient, size, size_unit : of the coefficients of the effect the one that biases most, with its largest typical
        size; empty in records of earlier versions.
    """

    parameter: str
    unit: str
    value: float
    in_sd: float
    coefficient: str = ""
    size: float = 0.0
    size_unit: str = ""


@dataclass(frozen=True)
class Detectability:
    """How well the runs can show one effect, by the coefficient that they show best relative to its typical size.

    Attributes
    ----------
    effect, name, unit : effect, and name and unit of the coefficient.
    retained : fraction of its squared response that the model does not absorb.
    smallest_detectable : size detected with a power of 80 %, in its unit; infinite where none is.
    typical : smallest and largest magnitude met in practice.
    absorbed_by : what absorbs the rest, largest share first.
    bias : of the reported parameters where the effect is present and not modelled; None without parameters.
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


def detectability(projection: Projection, response: ProjectedResponse, threshold: float, looks: float) -> Detectability:
    """Return how well the runs can show a candidate.

    Parameters
    ----------
    threshold : probability of a false alarm over all looks.
    looks : effective number of independent looks.
    """
    coefficients = response.response.coefficients
    length = np.linalg.norm(response.projected, axis=0)
    raw = np.sum((projection.root[:, None] * response.response.columns) ** 2, axis=0)
    sides = np.array([1 if coefficient.sign else 2 for coefficient in coefficients])
    needed = noncentrality_needed(threshold / max(looks, 1.0) / sides, freedom_of(projection, response.projected))
    with np.errstate(divide="ignore"):
        smallest = needed * np.where(length**2 > thresholds.RETAINED_MIN * raw, 1 / length, np.inf)
    best = int(np.argmin(smallest / [each.typical[1] for each in coefficients]))
    coefficient, shift = coefficients[best], projection.absorb(response.whitened)
    return Detectability(
        effect=response.response.scan.effect,
        name=coefficient.parameter.name,
        unit=coefficient.parameter.shown_unit,
        retained=float(length[best] ** 2 / raw[best]) if raw[best] > 0 else 0.0,
        smallest_detectable=float(smallest[best]),
        typical=coefficient.typical,
        absorbed_by=_absorbers(projection, response.whitened[:, best], shift[:, best], float(raw[best])),
        bias=_bias(projection, response.response, shift),
    )


def freedom_of(projection: Projection, columns: np.ndarray) -> np.ndarray:
    """Return the degrees of freedom of the noise scale that each projected column, (R, C), is judged by, (C,).

    Satterthwaite's, of the strata in which its length lies: an effect that acts between few runs alone is judged by
    their scatter, whatever the number of rows.
    """
    projection, turned = projection.offsets_apart
    squares = projection.strata.sums(turned(columns) ** 2)
    total = np.maximum(squares.sum(axis=0), np.finfo(float).tiny)
    left = projection.freedom[:, None] - squares / total
    judged = left > LEAST_FREEDOM
    # The scale of the prior is known.
    judged[-1] = False
    share = squares / total
    return 1 / np.maximum(np.sum(share**2 / np.where(judged, left, KNOWN_FREEDOM), axis=0), 1 / KNOWN_FREEDOM)


def noncentrality_needed(p: np.ndarray, freedom: np.ndarray) -> np.ndarray:
    """Return the noncentrality at which Student's t, one-sided at p, detects with the power asked for.

    Parameters
    ----------
    p, freedom : shape (C,).
    """
    critical = -special.stdtrit(freedom, p)
    # Student's t is normal over √(χ²/ν): the power is a mean over quantiles of the latter.
    quantiles = (np.arange(_QUANTILES) + 0.5) / _QUANTILES
    scale = np.sqrt(2 * special.gammaincinv(freedom / 2, quantiles[:, None]) / freedom)
    low, high = np.zeros_like(critical), critical * scale.max(axis=0) + 10
    for _ in range(60):
        middle = (low + high) / 2
        enough = normal_survival(critical * scale - middle).mean(axis=0) > thresholds.DETECTION_POWER
        low, high = np.where(enough, low, middle), np.where(enough, middle, high)
    return high


def _bias(projection: Projection, response: Response, shift: np.ndarray) -> ParameterBias | None:
    """Return the worst bias by one of C coefficients that shift the parameters by so much in z per unit, (P, C).

    Uncertainties that the campaign states of the equipment are told by themselves (`neglected_uncertainty`).
    """
    fitted, coefficients = projection.fitted, response.coefficients
    stated = [stated_size(fitted.model, response.scan.effect, each) for each in coefficients]
    sizes = [each.typical[1] if own is None else 0.0 for each, own in zip(coefficients, stated, strict=True)]
    if not len(shift):
        return None
    in_sd = shift * sizes / projection.posterior_sd[:, None]
    most, worst = divmod(int(np.argmax(np.abs(in_sd))), len(coefficients))
    parameter, cause = fitted.model.layout.parameters[most], coefficients[worst].parameter
    return ParameterBias(
        parameter=parameter.name,
        unit=parameter.shown_unit,
        value=float(shift[most, worst] * sizes[worst] * projection.slopes[most] / parameter.factor),
        in_sd=float(in_sd[most, worst]),
        coefficient=cause.name,
        size=sizes[worst],
        size_unit=cause.shown_unit,
    )


def _absorbers(projection: Projection, whitened: np.ndarray, shift: np.ndarray, raw: float) -> tuple[Absorber, ...]:
    """Return the shares of a response of squared length `raw` that parameter families and run offsets absorb.

    Parameters
    ----------
    whitened, shift : the response, (R,), and the parameters that fit it best, (P,) in z.
    """
    if raw <= 0:
        return ()
    shares = {RUN_OFFSETS: max(0.0, 1 - float(whitened @ whitened) / raw)}
    # Shares of the regression: g·(J_k c_k)/|g|² add up to what is absorbed in all.
    each = shift * (projection.jacobian.T @ whitened) / raw
    for parameter, share in zip(projection.fitted.model.layout.parameters, each.tolist(), strict=True):
        family = f"{parameter.effect}.{parameter.field}"
        shares[family] = shares.get(family, 0.0) + share
    absorbed = min(sum(shares.values()), 1.0)
    positive = {name: share for name, share in shares.items() if share > 0}
    whole = sum(positive.values()) or 1.0
    found = [Absorber(name, share / whole * absorbed) for name, share in positive.items()]
    listed = [absorber for absorber in found if absorber.share >= thresholds.ABSORBER_SHARE]
    return tuple(sorted(listed, key=lambda absorber: -absorber.share))
