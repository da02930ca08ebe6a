"""The response of a unit about zero input over temperature: what constants for use on board are made of.

With r = (y − offset)/scale the output on the nominal scale, the model is, about zero input and for the effects that
constants can express, r = z(T) + k(T) (a·u + d·f): z the output at zero input, k the gain and a the unit vector along
the sensitive axis of a channel, u the rate or specific force, d the g-sensitivity of a gyro.  z and k are polynomials
in the temperatures, found by interpolation at Chebyshev nodes; all effects of the catalogue but leakage are of that
form.

The response has draws of the posterior of what the outputs of a unit depend on, wherever it is mounted: its sensors and
converters.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np

from imubayes.compiled.kept_programs import kept
from imubayes.foundations.arrays import Array, Float
from imubayes.foundations.campaign_data import KINDS, Campaign, Channel
from imubayes.foundations.covariates import REFERENCE_TEMPERATURE
from imubayes.foundations.errors import input_error
from imubayes.model.model_file import UncertainEquipment
from imubayes.model.sensitive_axes import SensitivityInputs, outputs_in_body
from imubayes.parameters.declarations import prior_slopes
from imubayes.results.result import Result
from imubayes.results.stored_tables import complete, draws_of, thinned
from imubayes_qualification.budgets.taken_as_exact import included_shifts, with_included

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
    exact : what the model takes as exact of site and equipment and the draws contain nevertheless.
    """

    campaign: Campaign
    inputs: SensitivityInputs
    names: tuple[str, ...]
    places: np.ndarray
    draws: np.ndarray
    values: np.ndarray
    exact: tuple[UncertainEquipment, ...] = ()

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
    """Return whether the input axes of channels span three dimensions, to a thousandth."""
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
    """Return the posterior of a unit's sensors and converters, with what a report includes of site and equipment.

    Raises
    ------
    InputError
        if the fit did not converge, so that there are no draws.
    """
    if not result.converged:
        where = str(result.folder) if result.folder is not None else "this fit"
        raise input_error("there are no posterior draws", where, "a fit that converged", result.summary.message)
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
    slopes = np.asarray(prior_slopes(model.problem.priors, np.asarray(result.fit.z)))[places]
    shifts = [(each, shift[places] * slopes) for each, shift in included_shifts(result.fit)]
    draws, exact = with_included(draws, shifts)
    return SensorPosterior(model.campaign, inputs, names, places, draws, values, exact)


def prior_values(result: Result, posterior: SensorPosterior) -> np.ndarray | None:
    """Return all values at draws of the prior, shape (S', V); None if the result has none."""
    tree = result.posterior
    if "prior" not in tree.children or not posterior.names:
        return None
    found = complete(draws_of(tree["prior"].to_dataset(), posterior.names))
    if set(found) != set(posterior.names):
        return None
    factors = result.fit.model.layout.factors()[posterior.places]
    draws = np.stack([found[name] for name in posterior.names], axis=1) * factors
    return np.stack([posterior.at(draw) for draw in draws])


# Bias quadratic times scale factor cubic in temperature has degree five.
_MOST_DEGREE = 5
NEGLIGIBLE = 1e-10
"""Of 1 m/s² or rad/s, or of a gain, over the calibrated range: rounding, below which nothing is a term or a loss."""
# Half the width of the range if all data are of one temperature, °C.
_NARROW = 10.0
_DRAWS_AT_ONCE = 500


@dataclass(frozen=True)
class ThermalGrid:
    """Temperatures of sensor and converter, and the polynomials that are interpolated there.

    Attributes
    ----------
    powers : shape (K, 2), powers of T − T_ref and T_c − T_ref of each term, (0, 0) first.
    nodes : shape (K, 2), °C.
    inverse : shape (K, K), from values at the nodes to coefficients.
    reach : shape (K,), largest magnitude of each term's power product over the range.
    """

    powers: np.ndarray
    nodes: np.ndarray
    inverse: np.ndarray
    reach: np.ndarray


@dataclass(frozen=True)
class LinearResponse:
    """The response of the channels of one kind, for S draws.

    Attributes
    ----------
    zero : shape (S, C, K), coefficients of z, rad/s or m/s² on the nominal scale.
    gain : shape (S, C, K), coefficients of k.
    axes : shape (S, C, 3), unit vectors, body axes.
    by_force : shape (S, C, 3), k d at the reference temperatures, rad/s per m/s²; zero for accelerometers.
    """

    zero: np.ndarray
    gain: np.ndarray
    axes: np.ndarray
    by_force: np.ndarray


@kept
def _about_zero(
    inputs: SensitivityInputs, values: Float[Array, "S V"], temperatures: Float[Array, "K 2"]
) -> dict[str, tuple[Array, Array]]:
    """Return outputs (S, K, C) and their derivatives by rate and force (S, K, C, 6) at zero input, per kind."""

    def at(value, temperature):
        def outputs(u):
            found = outputs_in_body(
                inputs, value, u, {"temperature": temperature[0], "converter_temperature": temperature[1]}
            )
            return found, found

        slopes, found = jax.jacfwd(outputs, has_aux=True)(jnp.zeros(6))
        return {kind: (found[kind], slopes[kind]) for kind in found}

    return jax.vmap(lambda value: jax.vmap(partial(at, value))(temperatures))(values)


def thermal_grid(ranges: dict[str, tuple[float, float]], degrees: dict[str, int]) -> ThermalGrid:
    """Return the grid of polynomials of given degrees over the calibrated ranges of the two temperatures."""
    axes, limits = [], []
    for name in ("temperature", "converter_temperature"):
        low, high = ranges.get(name, (REFERENCE_TEMPERATURE, REFERENCE_TEMPERATURE))
        if high - low < _NARROW:
            low, high = (low + high) / 2 - _NARROW, (low + high) / 2 + _NARROW
        count = degrees.get(name, 0) + 1
        chebyshev = np.cos(np.pi * (np.arange(count) + 0.5) / count)
        nodes = (low + high) / 2 + (high - low) / 2 * chebyshev if count > 1 else np.array([REFERENCE_TEMPERATURE])
        axes.append(nodes)
        limits.append(max(abs(low - REFERENCE_TEMPERATURE), abs(high - REFERENCE_TEMPERATURE)))
    powers = np.array(list(product(range(len(axes[0])), range(len(axes[1])))))
    nodes = np.array(list(product(*axes)))
    design = np.prod((nodes - REFERENCE_TEMPERATURE)[:, None, :] ** powers[None], axis=2)
    reach = np.prod(np.array(limits) ** powers, axis=1)
    return ThermalGrid(powers, nodes, np.linalg.inv(design / reach) / reach[:, None], reach)


def linear_response(
    posterior: SensorPosterior, values: np.ndarray, grid: ThermalGrid, kinds: tuple[str, ...]
) -> dict[str, LinearResponse]:
    """Return the response of the channels of some kinds for values (S, V)."""
    at_reference = np.full((1, 2), REFERENCE_TEMPERATURE)
    nodes = np.concatenate([grid.nodes, at_reference])
    batches = [
        _about_zero(posterior.inputs, np.asarray(_padded(values[first : first + _DRAWS_AT_ONCE])), np.asarray(nodes))
        for first in range(0, len(values), _DRAWS_AT_ONCE)
    ]
    found = {}
    for kind in kinds:
        zero, slope = (np.concatenate([np.asarray(b[kind][k]) for b in batches])[: len(values)] for k in (0, 1))
        found[kind] = _response(posterior, kind, zero, slope, grid)
    return found


def _padded(values: np.ndarray) -> np.ndarray:
    """Return values repeated to a full batch, so that one program serves all; a single point stays alone."""
    if len(values) in (1, _DRAWS_AT_ONCE):
        return values
    return values[np.minimum(np.arange(_DRAWS_AT_ONCE), len(values) - 1)]


def _response(
    posterior: SensorPosterior, kind: str, zero: np.ndarray, slope: np.ndarray, grid: ThermalGrid
) -> LinearResponse:
    channels = posterior.campaign.of_kind(kind)
    scale = np.array([channel.scale_si for channel in channels])
    offset = np.array([channel.offset for channel in channels])
    own = slope[..., :3] if kind == "gyro" else slope[..., 3:]
    reference = own[:, -1] / scale[:, None]
    nominal = np.array([channel.axes[0] for channel in channels])
    toward = np.sign(np.sum(reference * nominal, axis=2))
    axes = reference / (toward * np.linalg.norm(reference, axis=2))[..., None]
    gains = np.sum(own / scale[:, None] * axes[:, None], axis=3)
    zeros = (zero - offset) / scale
    by_force = slope[:, -1, :, 3:] / scale[:, None] if kind == "gyro" else np.zeros_like(reference)
    interpolated = [np.einsum("mk,skc->scm", grid.inverse, each[:, :-1]) for each in (zeros, gains)]
    return LinearResponse(interpolated[0], interpolated[1], axes, by_force)


def sufficient_grid(
    posterior: SensorPosterior, ranges: dict[str, tuple[float, float]], needs: tuple[str, ...], kinds: tuple[str, ...]
) -> ThermalGrid:
    """Return the grid of the lowest degree at which one degree more changes nothing."""
    values = posterior.values[None]
    grid = thermal_grid(ranges, {})
    for degree in range(1, _MOST_DEGREE + 1) if needs else ():
        grid = thermal_grid(ranges, dict.fromkeys(needs, degree))
        next_grid = thermal_grid(ranges, dict.fromkeys(needs, degree + 1))
        found = linear_response(posterior, values, next_grid, kinds)
        beyond = (next_grid.powers > degree).any(axis=1)
        if all(negligible(each, next_grid)[beyond].all() for each in found.values()):
            break
    return grid


def negligible(response: LinearResponse, grid: ThermalGrid) -> np.ndarray:
    """Return which terms contribute less than a share of 1e-10, shape (K,): of 1 for k, of 1 m/s² or rad/s for z."""
    sizes = [np.abs(each).max(axis=(0, 1)) * grid.reach for each in (response.zero, response.gain)]
    return np.max(sizes, axis=0) < NEGLIGIBLE
