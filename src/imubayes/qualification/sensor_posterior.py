"""The posterior of what the outputs of a unit depend on, wherever it is mounted: its sensors and converters."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from imubayes.campaign_data import Campaign, Channel
from imubayes.errors import InputError, Issue
from imubayes.model.nodes_and_entries import KINDS
from imubayes.model.sensitive_axes import SensitivityInputs
from imubayes.results.posterior_draws import complete, draws_of, thinned
from imubayes.results.result import Result

# A covariance of so many draws is good to 2 %.
_MOST_DRAWS = 4000
TEMPERATURES = ("temperature", "converter_temperature")
"""Covariates that a correction uses beside the outputs."""


@dataclass(frozen=True)
class SensorPosterior:
    """Draws of the parameters of sensors and converters.

    Attributes
    ----------
    campaign : that was fitted.
    inputs : the signal path from the body to the outputs.
    names : of the parameters, shape (A,).
    places : shape (A,), their places in the vector of values.
    draws : shape (S, A), SI.
    values : shape (V,), all values, SI, with the parameters at their posterior means.
    """

    campaign: Campaign
    inputs: SensitivityInputs
    names: tuple[str, ...]
    places: np.ndarray
    draws: np.ndarray
    values: np.ndarray

    @cached_property
    def factor(self) -> np.ndarray:
        """L with L Lᵀ the covariance of the parameters, shape (A, A)."""
        if not len(self.names):
            return np.zeros((0, 0))
        values, vectors = np.linalg.eigh(np.atleast_2d(np.cov(self.draws, rowvar=False)))
        return vectors * np.sqrt(np.clip(values, 0.0, None))

    def at(self, draw: np.ndarray) -> np.ndarray:
        """Return all values with the parameters of one draw (A,), shape (V,)."""
        changed = self.values.copy()
        changed[self.places] = draw
        return changed


def complete_kinds(channels: Sequence[Channel], columns: Collection[str]) -> tuple[str, ...]:
    """Return the kinds of channels that are all among the columns and whose axes span three dimensions."""
    found = []
    for kind in KINDS:
        own = [channel for channel in channels if channel.kind == kind]
        if all(channel.name in columns for channel in own) and spans(own):
            found.append(kind)
    return tuple(found)


def spans(channels: Sequence[Channel]) -> bool:
    """Tell whether the input axes of channels span three dimensions, to a thousandth."""
    axes = np.array([channel.axes[0] for channel in channels]).reshape(-1, 3)
    return bool(np.linalg.matrix_rank(axes, tol=1e-3) == 3)


def temperature_ranges(campaign: Campaign) -> dict[str, tuple[float, float]]:
    """Return the lowest and highest temperature of sensor and converter in the runs that recorded them, °C."""
    found = {}
    for name in TEMPERATURES:
        known = [run.covariates[name] for run in campaign.runs if name in run.covariates]
        if known:
            joined = np.concatenate(known)
            found[name] = float(np.nanmin(joined)), float(np.nanmax(joined))
    return found


def sensor_posterior(result: Result) -> SensorPosterior:
    """Return the posterior of a unit's sensors and converters.

    Raises
    ------
    InputError
        where the fit did not converge, so that there are no draws.
    """
    if not result.converged:
        where = str(result.folder) if result.folder is not None else "this fit"
        raise InputError(Issue("there are no posterior draws", where, "a fit that converged", result.summary.message))
    model = result.fit.model
    inputs = result.fit.derived.derivation.inputs
    layout, count = model.layout, len(model.layout)
    used = [np.ravel(place) for layer in inputs.sensor_layers for place in layer.value_places().values()]
    places = np.unique(np.concatenate(used)) if used else np.zeros(0, dtype=int)
    places = places[places < count].astype(int)
    names = tuple(layout.names[place] for place in places)
    found = thinned(complete(draws_of(result.draws, names)), _MOST_DRAWS)
    factors = layout.factors()[places]
    draws = np.stack([found[name] for name in names], axis=1) * factors if names else np.zeros((1, 0))
    values = np.concatenate([np.zeros(count), np.asarray(model.problem.nulls)])
    values[places] = draws.mean(axis=0)
    return SensorPosterior(model.campaign, inputs, names, places, draws, values)


def prior_values(result: Result, posterior: SensorPosterior) -> np.ndarray | None:
    """Return all values at draws of the prior, shape (S', V); None where the result has none."""
    tree = result.posterior
    if "prior" not in tree.children or not posterior.names:
        return None
    found = complete(draws_of(tree["prior"].to_dataset(), posterior.names))
    if set(found) != set(posterior.names):
        return None
    factors = result.fit.model.layout.factors()[posterior.places]
    draws = np.stack([found[name] for name in posterior.names], axis=1) * factors
    return np.stack([posterior.at(draw) for draw in draws])
