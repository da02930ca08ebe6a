"""Quantities over a temperature range: bias and scale factor with the thermal terms that the model has.

A limit that holds from T₁ to T₂ is met by a draw if the quantity is within it at every temperature between.  Bias
has polynomial terms in T − T_ref that add, scale factor such that multiply; other quantities do not depend on the
temperature of the sensor in the model.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from imubayes.foundations.covariates import REFERENCE_TEMPERATURE
from imubayes.foundations.quantity_names import QuantityName, family_of, name_of
from imubayes.foundations.units import STANDARD_GRAVITY, to_si
from imubayes.model.model_file import ModelSpec

TEMPERATURES_OF_RANGE = 11
"""Temperatures at which a range is looked at: a quadratic between them deviates by 1/400 of its sag."""


@dataclass(frozen=True)
class ThermalTerms:
    """How a family of quantities depends on temperature.

    Attributes
    ----------
    kind : whether its terms add to the value, multiply 1 + value, or multiply the value.
    terms : effect and parameter, with the power of T − T_ref.
    """

    kind: Literal["bias", "relative", "scale"]
    terms: tuple[tuple[str, str, int], ...]


def _terms(sensor: str, what: str) -> tuple[tuple[str, str, int], ...]:
    return (f"{sensor}_{what}_temperature", "slope", 1), (f"{sensor}_{what}_temperature_quadratic", "curvature", 2)


def _terms_of_bias(sensor: str) -> tuple[tuple[str, str, int], ...]:
    return (*_terms(sensor, "bias"), (f"{sensor}_bias_temperature_cubic", "coefficient", 3))


FAMILIES = {
    "gyro_bias.bias": ThermalTerms("bias", _terms_of_bias("gyro")),
    "accel_bias.bias": ThermalTerms("bias", _terms_of_bias("accel")),
    "gyro_scale_factor.scale": ThermalTerms("relative", _terms("gyro", "scale")),
    "accel_scale_factor.scale": ThermalTerms("relative", _terms("accel", "scale")),
    "scale_factor": ThermalTerms("scale", (*_terms("gyro", "scale"), *_terms("accel", "scale"))),
}
"""Family of quantities → its dependence on temperature; a family that is not listed has none."""


@dataclass(frozen=True)
class ThermalModel:
    """What of a model's thermal terms is not in the draws.

    Attributes
    ----------
    reference : effect → T_ref, °C.
    units : parameter name → unit.
    default : temperature at which scale factors are stated, °C.
    fastest : largest |dT/dt| of the runs, K/s.
    scale : channel → nominal output units per rad/s or m/s², in which the scatter between runs is counted.
    """

    reference: Mapping[str, float]
    units: Mapping[str, str]
    default: float
    fastest: float = 0.0
    scale: Mapping[str, float] = field(default_factory=dict)


def thermal_model(
    spec: ModelSpec, units: Mapping[str, str], fastest: float = 0.0, scale: Mapping[str, float] | None = None
) -> ThermalModel:
    """Return the reference temperatures of a model; `units` are those of its parameters, by name."""
    stated = [effect for effect in spec.effects if "reference_degC" in effect.options]
    reference = {effect.name: float(effect.options["reference_degC"]) for effect in stated}
    return ThermalModel(reference, units, REFERENCE_TEMPERATURE, fastest, scale or {})


def depends_on_temperature(name: str, draws: Mapping[str, np.ndarray]) -> bool:
    """Return whether a quantity has thermal terms among the draws."""
    parts = QuantityName.of(name)
    found = FAMILIES.get(parts.family)
    return found is not None and any(
        name_of(f"{effect}.{parameter}", *parts.labels) in draws for effect, parameter, _ in found.terms
    )


def thermal_quantities(names: Iterable[str]) -> tuple[str, ...]:
    """Return the quantities that depend on temperature, and the coefficients by which they do."""
    terms = {f"{effect}.{parameter}" for each in FAMILIES.values() for effect, parameter, _ in each.terms}
    return tuple(name for name in names if family_of(name) in terms or family_of(name) in FAMILIES)


def course_over_range(
    name: str, unit: str, draws: Mapping[str, np.ndarray], model: ThermalModel, span: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Return temperatures (T,) over a range, and the draws of a quantity there as `over_range` does, (S, T), T > 1."""
    values = over_range(name, unit, draws, model, span)
    values = np.broadcast_to(values, (len(values), max(2, values.shape[1])))
    return np.linspace(*span, values.shape[1]), values


def over_range(
    name: str, unit: str, draws: Mapping[str, np.ndarray], model: ThermalModel, span: tuple[float, float]
) -> np.ndarray:
    """Return the draws of a quantity at temperatures over a range, shape (S, T); (S, 1) if it depends on none.

    Parameters
    ----------
    name, unit : of the quantity.
    draws : name → shape (S,), of all parameters and derived quantities.
    model : of the thermal terms.
    span : lowest and highest temperature, °C.
    """
    parts = QuantityName.of(name)
    found = FAMILIES.get(parts.family)
    own = draws[name][:, None]
    terms = [] if found is None else [(e, name_of(f"{e}.{p}", *parts.labels), power) for e, p, power in found.terms]
    terms = [(effect, term, power) for effect, term, power in terms if term in draws]
    if found is None or not terms:
        return own
    temperature = np.linspace(*span, TEMPERATURES_OF_RANGE)
    added, factor, at_default = (
        np.zeros((1, TEMPERATURES_OF_RANGE)),
        np.ones((1, TEMPERATURES_OF_RANGE)),
        np.ones((1, 1)),
    )
    for effect, term, power in terms:
        reference = model.reference.get(effect, model.default)
        coefficient = draws[term][:, None] * to_si(model.units[term], STANDARD_GRAVITY)
        change = coefficient * (temperature - reference)[None, :] ** power
        added, factor = added + change, factor * (1 + change)
        at_default = at_default * (1 + coefficient * (model.default - reference) ** power)
    if found.kind == "bias":
        return own + added / to_si(unit, STANDARD_GRAVITY)
    if found.kind == "scale":
        return own * factor / at_default
    ratio = to_si(unit, STANDARD_GRAVITY)
    return ((1 + own * ratio) * factor - 1) / ratio
