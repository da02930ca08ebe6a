"""Quantities over a temperature range as limits see them: branches of warming and cooling, the next run, other causes.

A bias at a temperature is not one number, if the model has more than polynomials.  Hysteresis h puts it anywhere
between the branches of warming and cooling, ± h; a lag of the time constant τ adds up to c·τ·|dT/dt|, no more than c
times the range, and a term in dT/dt as much as that, at the fastest change of the runs.  Both branches have to be
within a limit.  The next time that the unit is switched on it has another offset: normal with the scatter between runs,
the same at all temperatures.
"""

from collections.abc import Iterator, Mapping

import numpy as np

from imubayes.foundations.quantity_names import QuantityName, family_of, name_of
from imubayes.foundations.units import STANDARD_GRAVITY, to_si
from imubayes.results.temperature_range import FAMILIES, ThermalModel, over_range, thermal_quantities

_SCATTER = "run_scatter"


def branches_over_range(
    name: str, unit: str, draws: Mapping[str, np.ndarray], model: ThermalModel, span: tuple[float, float]
) -> np.ndarray:
    """Return what `over_range` does with hysteresis and lag, shape (S, B·T): B branches of T temperatures.

    There is one branch if nothing depends on what was before; else that of cooling follows that of warming.
    """
    values = over_range(name, unit, draws, model, span)
    if not _is_bias(name):
        return values
    width = sum(_half_widths(name, draws, model, span), np.zeros(len(values))) / to_si(unit, STANDARD_GRAVITY)
    return np.concatenate([values + width[:, None], values - width[:, None]], axis=1) if width.any() else values


def scatter_of_next_run(name: str, unit: str, draws: Mapping[str, np.ndarray], model: ThermalModel) -> np.ndarray:
    """Return the standard deviation of the offset that a bias has in the next run, (S,); 0 for other quantities."""
    count = len(draws[name])
    if not _is_bias(name):
        return np.zeros(count)
    variance = sum((each**2 for each in _repeatability(name, draws, model)), np.zeros(count))
    return np.sqrt(variance) / to_si(unit, STANDARD_GRAVITY)


def shifts_over_range(
    name: str,
    unit: str,
    draws: Mapping[str, np.ndarray],
    model: ThermalModel,
    span: tuple[float, float],
    shifts: Mapping[str, np.ndarray],
) -> np.ndarray:
    """Return what r causes do to a quantity at the temperatures of `over_range`, (r, T), linear about the means.

    Parameters
    ----------
    shifts : what each cause does to a quantity, (r,); 0 for one that is not named.
    """
    count = max((len(each) for each in shifts.values()), default=0)
    at = {each: np.nanmean(draws[each]) + np.zeros(count + 1) for each in thermal_quantities(draws)}
    at[name] = np.nanmean(draws[name]) + np.zeros(count + 1)
    for each, values in shifts.items():
        if each in at:
            at[each][1:] += values
    found = over_range(name, unit, at, model, span)
    return found[1:] - found[:1]


def _is_bias(name: str) -> bool:
    found = FAMILIES.get(family_of(name))
    return found is not None and found.kind == "bias"


def _parameter(name: str, effect: str, parameter: str, draws: Mapping[str, np.ndarray]) -> str | None:
    """Return the name of an effect's parameter of the sensor and channel of a quantity, if the model has it."""
    parts = QuantityName.of(name)
    sensor = parts.family.partition("_")[0]
    effect = effect if effect == _SCATTER else f"{sensor}_{effect}"
    shared = (parts.labels, ("all",))
    return next((each for end in shared if (each := name_of(f"{effect}.{parameter}", *end)) in draws), None)


def _half_widths(
    name: str, draws: Mapping[str, np.ndarray], model: ThermalModel, span: tuple[float, float]
) -> Iterator[np.ndarray]:
    """Yield what each effect of the past of a temperature adds to a bias at most, SI, (S,)."""

    def own(effect: str, parameter: str) -> np.ndarray | None:
        found = _parameter(name, effect, parameter, draws)
        return None if found is None else np.abs(draws[found]) * to_si(model.units[found], STANDARD_GRAVITY)

    half_width, lag = own("thermal_hysteresis", "half_width"), own("thermal_lag", "coefficient")
    tau, slope = own("thermal_lag", "tau"), own("bias_temperature_rate", "slope")
    if half_width is not None:
        yield half_width
    if lag is not None and tau is not None:
        yield lag * np.minimum(tau * model.fastest, span[1] - span[0])
    if slope is not None:
        yield slope * model.fastest


def _repeatability(name: str, draws: Mapping[str, np.ndarray], model: ThermalModel) -> Iterator[np.ndarray]:
    """Yield the standard deviation of the offset that a run has of its own, SI, (S,)."""
    spread, scatter = _parameter(name, "run_bias", "spread", draws), _parameter(name, _SCATTER, "tau", draws)
    if spread is not None:
        yield draws[spread] * to_si(model.units[spread], STANDARD_GRAVITY)
    scale = model.scale.get(QuantityName.of(name).label)
    if scatter is not None and scale is not None:
        yield draws[scatter] / abs(scale)
