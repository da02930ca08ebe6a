"""The list of derived quantities of a model: which there are, their names and units, and how to compute them."""

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from imubayes.effects.base import Effect, MotionEffect, Order, RecordEffect, Stage
from imubayes.gather import in_batches, on_device
from imubayes.model.assembly import Assembly
from imubayes.model.grouping import RUN_AXES
from imubayes.model.nodes import KINDS
from imubayes.model.problem import Problem, values_of
from imubayes.model.sensitivities import (
    DerivedQuantity,
    SensitivityInputs,
    angle_between,
    axes_of_rotation,
    sensitivities,
    thermal_slopes,
)
from imubayes.model.signal_path import AddOffset, Broadcast, Convert, Layer, Project, Resolve, sorted_layers
from imubayes.types import Array, Float, Int
from imubayes.units import to_si

# An input below this share of g says nothing about a relative slope.
_LEAST_INPUT_G = 0.1
# Points whose quantities are computed at once.
_AT_ONCE = 500
# Half the distance of the points whose quantities are subtracted for a slope, in z.
_APART = 1e-3


class DerivedFunction(eqx.Module):
    """Derived quantities as a pure function of the values.

    Attributes
    ----------
    probe : where the path is probed.
    pairs : kind → shape (pairs, 2), channels whose axes are compared.
    thermal_pairs : kind → shape (n, 3): channel, run, and the run with the input nearest 1 g.
    factors : shape (D,), divides the numbers found.
    """

    probe: SensitivityInputs
    pairs: dict[str, Int[Array, "_ 2"]]
    thermal_pairs: dict[str, Int[Array, "_ 3"]]
    factors: Float[Array, " D"]

    def __call__(self, values: Float[Array, " V"]) -> Float[Array, " D"]:
        """Return all derived quantities in their units, in the order of the names."""
        response = sensitivities(self.probe, values)
        axes = axes_of_rotation(self.probe, values)
        parts = []
        for kind in KINDS:
            if kind in response:
                toward = jnp.sign(jnp.sum(response[kind] * self.probe.channels[kind].axes[:, 0], axis=-1))
                parts.append(toward * jnp.sqrt(jnp.sum(response[kind] ** 2, axis=-1)))
                sensitive = response[kind] * toward[:, None]
                parts.append(angle_between(sensitive[:, None, :], axes[None, :, :]).reshape(-1))
                first, second = self.pairs[kind][:, 0], self.pairs[kind][:, 1]
                parts.append(angle_between(sensitive[first], sensitive[second]))
        if self.probe.thermal is not None:
            slopes = thermal_slopes(self.probe, values)
            for kind in KINDS:
                if kind in slopes:
                    channel, run, base = (self.thermal_pairs[kind][:, column] for column in range(3))
                    own, reference = slopes[kind][run, channel], slopes[kind][base, channel]
                    parts.append(jnp.abs(own - reference) / jnp.abs(reference))
        return jnp.concatenate(parts) / self.factors


@eqx.filter_jit
def _derive_batch(derivation: DerivedFunction, problem: Problem, points: Float[Array, "n P"]) -> Float[Array, "n D"]:
    return jax.vmap(lambda z: derivation(values_of(problem, z)))(points)


def evaluate_derived(derivation: DerivedFunction, problem: Problem, points: np.ndarray) -> np.ndarray:
    """Return the derived quantities, in their units, of many points in z (n, P); shape (n, D).

    What is compiled for the draws serves the slopes.
    """
    return in_batches(lambda batch: _derive_batch(derivation, problem, batch), points, _AT_ONCE)


def derived_jacobian(derivation: DerivedFunction, problem: Problem, z: np.ndarray) -> np.ndarray:
    """Return the derivative of every derived quantity, in its unit, by every parameter in z (P,); shape (D, P).

    By central differences: over a thousandth of a prior a derived quantity is a straight line to seven digits, and the
    derivative as a program of its own takes longer to compile than everything else of them.
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
    mountings, probe_nodes = _mounting_nodes(assembly)
    thermal_runs, thermal_nodes = _thermal_nodes(assembly)
    gravity = campaign.site.gravity
    names: list[DerivedQuantity] = []
    pairs, thermal_pairs, thermal_input = {}, {}, {}
    thermal_names: list[DerivedQuantity] = []
    for kind in KINDS:
        channels = [channel for channel in campaign.channels if channel.kind == kind]
        if not channels:
            continue
        for channel in channels:
            unit = f"{channel.output_unit} per {channel.per}"
            names.append(DerivedQuantity(f"scale_factor[{channel.name}]", unit, 1 / to_si(channel.per, gravity)))
        for channel in channels:
            names += [DerivedQuantity(f"mounting_angle[{channel.name},{m}]", "deg", to_si("deg")) for m in mountings]
        # Two axes and their angle; of a redundant unit every pair, since none is special.
        couples = [(i, j) for i in range(len(channels)) for j in range(i + 1, len(channels))]
        names += [
            DerivedQuantity(f"axis_angle[{channels[i].name},{channels[j].name}]", "deg", to_si("deg"))
            for i, j in couples
        ]
        pairs[kind] = np.array(couples, dtype=int).reshape(-1, 2)
        inputs = _nominal_inputs(assembly, kind, thermal_nodes)
        thermal_input[kind] = np.where(np.abs(inputs) < 1e-12, 1.0, inputs)
        rows = []
        for column, channel in enumerate(channels):
            if kind != "accelerometer" or not len(thermal_runs):
                continue
            in_g = np.abs(inputs[:, column]) / gravity
            base = int(np.argmin(np.abs(in_g - 1)))
            for place, run in enumerate(thermal_runs):
                measured = np.isfinite(campaign.runs[run].observed[:, campaign.channels.index(channel)]).any()
                if place != base and in_g[place] > _LEAST_INPUT_G and measured:
                    rows.append((column, place, base))
                    name = f"delta_k[{channel.name},{campaign.runs[run].name}]"
                    thermal_names.append(DerivedQuantity(name, "%", to_si("%")))
        thermal_pairs[kind] = np.array(rows, dtype=int).reshape(-1, 3)
    names += thermal_names
    probe = SensitivityInputs(
        channels=assembly.channels,
        sensor_layers=_sensor_layers(assembly),
        mountings=assembly.nodes.at(probe_nodes),
        mounting_layers=sorted_layers([Broadcast(), *_layers(assembly, probe_nodes, {Stage.STAND, Stage.TABLE})]),
        thermal=assembly.nodes.at(thermal_nodes) if len(thermal_nodes) else None,
        thermal_layers=_whole_path(assembly, thermal_nodes) if len(thermal_nodes) else (),
        thermal_input=thermal_input,
    )
    factors = np.array([name.factor for name in names])
    derivation = DerivedFunction(probe, pairs, thermal_pairs, factors)
    return DerivedQuantities(tuple(names), on_device(derivation))


def _mounting_nodes(assembly: Assembly) -> tuple[list[str], np.ndarray]:
    """Return the mountings in use and a node of each; where there is none, the first node stands in."""
    runs = assembly.grouping.campaign.runs
    of_run = {}
    for index, run in enumerate(runs):
        if run.mounting is not None and run.tumble is None:
            of_run.setdefault(run.mounting, index)
    first = [int(np.argmax(assembly.grouping.nodes.run == index)) for index in of_run.values()]
    return list(of_run), np.array(first, dtype=int)


def _thermal_nodes(assembly: Assembly) -> tuple[list[int], np.ndarray]:
    nodes = assembly.grouping.nodes
    runs = [i for i, supplied in enumerate(nodes.supplies) if "converter_temperature" in supplied]
    return runs, np.array([int(np.argmax(nodes.run == run)) for run in runs], dtype=int)


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


def _layers(assembly: Assembly, chosen: np.ndarray, stages: set[Stage]) -> list[Layer]:
    return [
        layer
        for one in assembly.effects
        if issubclass(one.effect_class, Effect) and one.effect_class.stage in stages
        for layer in assembly.effect_layers(one, chosen)
    ]


def _whole_path(assembly: Assembly, chosen: np.ndarray) -> tuple[Layer, ...]:
    channels = assembly.channels
    counts = tuple((kind, len(one.scale)) for kind, one in channels.items())
    injected = assembly.nodes.injected[chosen]
    junctions = [Broadcast(), Resolve(counts), Project(channels), Convert(channels, injected), AddOffset(channels)]
    return sorted_layers(junctions + _layers(assembly, chosen, set(Stage)))


def _sensor_layers(assembly: Assembly) -> tuple[Layer, ...]:
    """Return the path from the projection on, without what belongs to single runs and without injection.

    Dead zones and limits are left out as well: a scale factor is the slope between them.
    """
    channels = assembly.channels
    junctions = [Project(channels), Convert(channels, np.zeros(1)), AddOffset(channels)]
    lasting = [
        one
        for one in assembly.effects
        if issubclass(one.effect_class, Effect)
        and not issubclass(one.effect_class, MotionEffect | RecordEffect)
        and one.effect_class.stage >= Stage.SENSOR
        and one.effect_class.order < Order.LIMIT
        and "injection" not in one.effect_class.needs
        and not set(one.sharing) & {*RUN_AXES, "pose"}
    ]
    layers = [layer for one in lasting for layer in assembly.effect_layers(one, None)]
    return sorted_layers(junctions + layers)
