"""Derived quantities of a model: their names and units, and the function that computes them."""

from collections.abc import Container, Sequence
from dataclasses import dataclass
from itertools import combinations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from imubayes.compiled.in_numpy import in_numpy
from imubayes.effects.base import Effect, Order, RecordEffect, Stage
from imubayes.foundations.arrays import Array, Float, Int, in_batches, on_device
from imubayes.foundations.campaign_data import KINDS, Channel, component_names
from imubayes.foundations.quantity_names import AXIS_ANGLE, DELTA_K, MOUNTING_ANGLE, SCALE_FACTOR, name_of
from imubayes.foundations.units import to_si
from imubayes.model.assembly import Assembly
from imubayes.model.bound_effects import BoundEffect
from imubayes.model.grouping import RUN_AXES
from imubayes.model.problem import Problem, values_of
from imubayes.model.sensitive_axes import (
    DerivedQuantity,
    SensitivityInputs,
    angle_between,
    axes_of_rotation,
    sensitivities,
    thermal_slopes,
    unit_vectors,
)
from imubayes.model.signal_path import Layer
from imubayes.procedures.converter_temperature import NEAR_ONE_G

# A relative slope is not determined by an input below this share of g.
_LEAST_INPUT_G = 0.1
# Batch size.
_AT_ONCE = 2000
# Step of the central differences, in z.
_APART = 1e-3


class DerivedFunction(eqx.Module):
    """Derived quantities as a pure function of the values.

    Attributes
    ----------
    inputs : the nodes and layers at which the path is evaluated.
    tilting : kind → places of the channels whose input axes parameters tilt.
    pairs : kind → shape (pairs, 2), channels whose axes are compared.
    thermal_pairs : kind → shape (n, 3): channel, run, and the run with the input nearest 1 g.
    factors : shape (D,), divides the numbers found.
    """

    inputs: SensitivityInputs
    tilting: dict[str, Int[Array, " _"]]
    pairs: dict[str, Int[Array, "_ 2"]]
    thermal_pairs: dict[str, Int[Array, "_ 3"]]
    factors: Float[Array, " D"]

    def __call__(self, values: Float[Array, " V"]) -> Float[Array, " D"]:
        """Return all derived quantities in their units, in the order of the names."""
        response = sensitivities(self.inputs, values)
        axes = axes_of_rotation(self.inputs, values)
        parts = []
        for kind in KINDS:
            if kind in response:
                toward = jnp.sign(jnp.sum(response[kind] * self.inputs.channels[kind].axes[:, 0], axis=-1))
                parts.append(toward * jnp.sqrt(jnp.sum(response[kind] ** 2, axis=-1)))
                sensitive = response[kind] * toward[:, None]
                parts.append(unit_vectors(sensitive[self.tilting[kind]]).reshape(-1))
                parts.append(angle_between(sensitive[:, None, :], axes[None, :, :]).reshape(-1))
                first, second = self.pairs[kind][:, 0], self.pairs[kind][:, 1]
                parts.append(angle_between(sensitive[first], sensitive[second]))
        if self.inputs.thermal is not None:
            slopes = thermal_slopes(self.inputs, values)
            for kind in KINDS:
                if kind in slopes:
                    channel, run, base = (self.thermal_pairs[kind][:, column] for column in range(3))
                    own, reference = slopes[kind][run, channel], slopes[kind][base, channel]
                    parts.append(jnp.abs(own - reference) / jnp.abs(reference))
        return jnp.concatenate(parts) / self.factors

    def directions(self, values: Float[Array, " V"]) -> Float[Array, "A 3"]:
        """Return the unit vectors of all sensitive axes, kind by kind, then of the axes of rotation."""
        response = sensitivities(self.inputs, values)
        sensitive = [response[kind] for kind in KINDS if kind in response]
        return unit_vectors(jnp.concatenate([*sensitive, axes_of_rotation(self.inputs, values)]))


# One function for draws, derivatives and directions, which share nearly all of it; NumPy takes many draws together.
@in_numpy
def _derive_batch(
    derivation: DerivedFunction, problem: Problem, points: Float[Array, "n P"]
) -> tuple[Float[Array, "n D"], Float[Array, "n A 3"]]:
    values = jax.vmap(lambda z: values_of(problem, z))(points)
    return jax.vmap(derivation)(values), jax.vmap(derivation.directions)(values)


def evaluate_derived(derivation: DerivedFunction, problem: Problem, points: np.ndarray) -> np.ndarray:
    """Return the derived quantities, in their units, of many points in z (n, P); shape (n, D)."""
    return in_batches(lambda batch: _derive_batch(derivation, problem, batch)[0], points, _AT_ONCE)


def evaluate_directions(derivation: DerivedFunction, problem: Problem, points: np.ndarray) -> np.ndarray:
    """Return the directions, as of `DerivedFunction.directions`, at many points in z (n, P); shape (n, A, 3)."""
    return in_batches(lambda batch: _derive_batch(derivation, problem, batch)[1], points, _AT_ONCE)


def derived_jacobian(derivation: DerivedFunction, problem: Problem, z: np.ndarray) -> np.ndarray:
    """Return the derivative of every derived quantity, in its unit, by every parameter in z (P,); shape (D, P).

    By central differences: over a thousandth of a prior width derived quantities are linear to seven digits, and
    automatic differentiation would dominate their compile time.
    """
    steps = _APART * np.eye(len(z))
    above, below = np.split(evaluate_derived(derivation, problem, np.concatenate([z + steps, z - steps])), 2)
    return (above - below).T / (2 * _APART)


@dataclass(frozen=True)
class DerivedQuantities:
    """Derived quantities: names with units, and the function."""

    names: tuple[DerivedQuantity, ...]
    derivation: DerivedFunction


def derived_quantities(assembly: Assembly) -> DerivedQuantities:
    """Return the derived quantities of an assembled model."""
    campaign = assembly.grouping.campaign
    mountings, mounting_nodes = _mounting_nodes(assembly)
    thermal = _thermal_runs(assembly)
    names: list[DerivedQuantity] = []
    thermal_names: list[DerivedQuantity] = []
    tilting, pairs, thermal_pairs = {}, {}, {}
    tilted = _tilted_channels(assembly)
    for kind in assembly.channels:
        channels = campaign.of_kind(kind)
        # The angle between two axes; of a redundant unit every pair, since none is special.
        couples = list(combinations(range(len(channels)), 2))
        tilting[kind] = np.array([place for place, c in enumerate(channels) if c.name in tilted], dtype=int)
        names += _quantities_of_kind(channels, tilted, mountings, couples, campaign.site.gravity)
        pairs[kind] = np.array(couples, dtype=int).reshape(-1, 2)
        rows = _thermal_comparisons(assembly, channels, thermal) if kind == "accelerometer" else []
        for column, place, _ in rows:
            name = name_of(DELTA_K, channels[column].name, campaign.runs[thermal.runs[place]].name)
            thermal_names.append(DerivedQuantity(name, "%", to_si("%")))
        thermal_pairs[kind] = np.array(rows, dtype=int).reshape(-1, 3)
    names += thermal_names
    inputs = SensitivityInputs(
        channels=assembly.channels,
        sensor_layers=assembly.path(None, (Stage.PLACE, Stage.SENSOR, Stage.CONVERTER), keep=is_lasting),
        mountings=assembly.nodes.at(mounting_nodes),
        mounting_layers=assembly.path(mounting_nodes, (Stage.STAND, Stage.TABLE)),
        thermal=assembly.nodes.at(thermal.nodes) if thermal.runs else None,
        thermal_layers=_whole_path(assembly, thermal.nodes) if thermal.runs else (),
        thermal_input={kind: np.where(np.abs(si) < 1e-12, 1.0, si) for kind, si in thermal.inputs.items()},
    )
    factors = np.array([name.factor for name in names])
    return DerivedQuantities(tuple(names), on_device(DerivedFunction(inputs, tilting, pairs, thermal_pairs, factors)))


def _tilted_channels(assembly: Assembly) -> set[str]:
    """Return the channels whose input axes an effect tilts; the axes of the others are the nominal ones."""
    return {
        channel
        for effect in assembly.effects
        if issubclass(effect.effect_class, Effect)
        and effect.effect_class.stage == Stage.SENSOR
        and effect.effect_class.order == Order.AXIS
        for channel in effect.channels
    }


def _quantities_of_kind(
    channels: Sequence[Channel],
    tilted: Container[str],
    mountings: Sequence[str],
    couples: Sequence[tuple[int, int]],
    gravity: float,
) -> list[DerivedQuantity]:
    """Return scale factors, input axes, mounting angles and angles between the axes of the channels of one kind."""
    scales = [
        DerivedQuantity(name_of(SCALE_FACTOR, c.name), f"{c.output_unit} per {c.per}", 1 / to_si(c.per, gravity))
        for c in channels
    ]
    axes = [name for c in channels if c.name in tilted for name in component_names(c.name)]
    vectors = [DerivedQuantity(name, "1", 1.0) for name in axes]
    angles = [name_of(MOUNTING_ANGLE, channel.name, mounting) for channel in channels for mounting in mountings]
    angles += [name_of(AXIS_ANGLE, *sorted((channels[i].name, channels[j].name))) for i, j in couples]
    return scales + vectors + [DerivedQuantity(name, "deg", to_si("deg")) for name in angles]


@dataclass(frozen=True)
class _ThermalRuns:
    """Runs in which the converter temperature changes: their indices, a node of each, and kind → input in SI, (T, C).

    `drifting` are the channels whose output depends on that temperature in the model; without one there are no runs.
    """

    runs: list[int]
    nodes: np.ndarray
    inputs: dict[str, np.ndarray]
    drifting: frozenset[str]


def _thermal_runs(assembly: Assembly) -> _ThermalRuns:
    nodes = assembly.grouping.nodes
    felt = [effect for effect in assembly.effects if "converter_temperature" in effect.effect_class.needs]
    drifting = frozenset(channel for effect in felt for channel in effect.channels)
    recorded = [run.covariates.get("converter_temperature", np.zeros(1)) for run in assembly.grouping.campaign.runs]
    runs = [index for index, values in enumerate(recorded) if np.ptp(values) > 0]
    runs = runs if drifting else []
    first = np.array([int(np.argmax(nodes.run == run)) for run in runs], dtype=int)
    inputs = {kind: _nominal_inputs(assembly, kind, first) for kind in assembly.channels}
    return _ThermalRuns(runs, first, inputs, drifting)


def _thermal_comparisons(
    assembly: Assembly, channels: Sequence[Channel], thermal: _ThermalRuns
) -> list[tuple[int, int, int]]:
    """Return the runs whose thermal slope is compared with that at 1 g: (channel, run, base).

    As classically, an injected current is compared with the injected current nearest 1 g, if that is within 10 % of it.
    """
    if not thermal.runs:
        return []
    campaign, rows = assembly.grouping.campaign, []
    for column, channel in enumerate(channels):
        if channel.name not in thermal.drifting:
            continue
        in_g = np.abs(thermal.inputs[channel.kind][:, column]) / campaign.site.gravity
        injected = np.asarray(assembly.nodes.injected)[thermal.nodes] > 0
        sensed = _nearest_1_g(in_g, ~injected)
        by_current = _nearest_1_g(in_g, injected)
        close = by_current is not None and abs(in_g[by_current] - 1) <= NEAR_ONE_G
        index = campaign.channels.index(channel)
        for place, run in enumerate(thermal.runs):
            measured = np.isfinite(campaign.runs[run].observed[:, index]).any()
            base = by_current if (injected[place] and close) or sensed is None else sensed
            assert base is not None
            if place != base and in_g[place] > _LEAST_INPUT_G and measured:
                rows.append((column, place, base))
    return rows


def _nearest_1_g(inputs: np.ndarray, among: np.ndarray) -> int | None:
    """Return the place of the input nearest 1 g among some; None if there is none."""
    return int(np.argmin(np.where(among, np.abs(inputs - 1), np.inf))) if among.any() else None


def _mounting_nodes(assembly: Assembly) -> tuple[list[str], np.ndarray]:
    """Return the mountings in use and the first node of each."""
    runs = assembly.grouping.campaign.runs
    of_run = {}
    for index, run in enumerate(runs):
        if run.mounting is not None and run.tumble is None:
            of_run.setdefault(run.mounting, index)
    first = [int(np.argmax(assembly.grouping.nodes.run == index)) for index in of_run.values()]
    return list(of_run), np.array(first, dtype=int)


def _nominal_inputs(assembly: Assembly, kind: str, nodes: np.ndarray) -> np.ndarray:
    """Return the nominal input in SI of each node and channel of a kind, shape (n, C)."""
    channels, gravity = assembly.channels[kind], assembly.grouping.campaign.site.gravity
    inputs = np.zeros((len(nodes), len(channels.scale)))
    for place, node in enumerate(nodes):
        stimulus = assembly.grouping.nodes.stimulus
        body_to_local = stimulus.base[node] @ stimulus.mounting[node]
        if assembly.nodes.injected[node] > 0:
            inputs[place] = assembly.nodes.ambient.current[node] / channels.current_per_acceleration
        elif kind == "accelerometer":
            inputs[place] = channels.axes[:, 0] @ (body_to_local.T @ [0.0, 0.0, gravity])
    return inputs


def _whole_path(assembly: Assembly, nodes: np.ndarray) -> tuple[Layer, ...]:
    return assembly.path(nodes, tuple(Stage), injected=assembly.grouping.nodes.injected[nodes])


def is_lasting(effect: BoundEffect, effect_class: type[Effect]) -> bool:
    """Return whether an effect belongs to the scale factor: the small-signal response common to all runs.

    Effects of single runs and of injected currents do not, nor do dead zones and limits: a scale factor is the slope
    between them.
    """
    return (
        not issubclass(effect_class, RecordEffect)
        and effect_class.order < Order.LIMIT
        and "injection" not in effect_class.needs
        and not set(effect.sharing) & {*RUN_AXES, "pose"}
    )
