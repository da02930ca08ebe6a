"""Simulate–recover: what a model predicts at known values, with noise, is found again."""

import sys
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import imubayes
from imubayes.effects.base import AmbientEffect
from imubayes.effects.thermometer import SharedThermometer
from imubayes.foundations.campaign_data import Campaign, Thermometer
from imubayes.inference.posterior_mode import find_mode
from imubayes.model.bind import Model, bind
from imubayes.model.bound_effects import Observability, observability
from imubayes.model.effect_registry import Registry
from imubayes.model.nodes_and_entries import join_nodes
from imubayes.model.problem import predict
from small_campaign import (
    anyhow_campaign,
    campaign,
    directed_campaign,
    driven_campaign,
    referenced_campaign,
    serial_campaign,
    simulated,
    spec,
    tumble_campaign,
    wide_campaign,
)

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))
from motion_recordings import NAMES, random_unit, waved

# Where a limit lies among the inputs of a few rows decides which of them feel it at all: that is scanned, not fitted.
HELD = {"converter_saturation": {"limit": "lognormal(30 scale, 0.01)"}}

THROUGH = (
    "accel_bias_temperature", "gyro_bias_temperature", "converter_gain_drift", "converter_offset_drift",
)  # fmt: skip
"""Effects of the temperatures, without which an error of these changes nothing."""


@dataclass(frozen=True)
class Recovered:
    """How far off the fit was, in posterior standard deviations, and these in units of the prior's."""

    converged: bool
    names: tuple[str, ...]
    scores: np.ndarray
    deviations: np.ndarray

    def of(self, effect: str) -> "Recovered":
        """Return what was found of one effect."""
        own = [place for place, name in enumerate(self.names) if name.startswith(f"{effect}.")]
        names = tuple(self.names[place] for place in own)
        return Recovered(self.converged, names, self.scores[own], self.deviations[own])


def declared_alone(member: type, registry: Registry | None = None) -> Model:
    """Return a model of one effect and white noise on the campaign that can show it, with what it acts through."""
    model = spec(member.name, *(THROUGH if issubclass(member, AmbientEffect) else ()))
    held = replace(model.effects[0], prior=HELD.get(member.name, {}))
    return bind(replace(model, effects=(held, *model.effects[1:])), shown_by(member), registry)


def campaign_in_motion() -> Campaign:
    """Return a unit that is waved, from the simulator of the tests of motion."""
    errors = random_unit(np.random.default_rng(1))
    kinds = [("accelerometer" if name[0] == "a" else "gyro", name) for name in NAMES]
    channels = [
        {"name": name, "kind": kind, "input_axis": [float(name[1] == axis) for axis in "xyz"], "scale": 1.0,
         "output_unit": "SI", "per": "rad/s" if kind == "gyro" else "m/s^2"} for kind, name in kinds
    ]  # fmt: skip
    content = {"format": 1, "name": "in-motion", "site": {"latitude_deg": 48.0, "height_m": 0.0}, "channel": channels,
               "unit": {"serial": "1"}, "run": [{"name": "waved", "procedure": "slow_motion"}]}  # fmt: skip
    return imubayes.build_campaign(content, {"waved": waved(errors, 1, seconds=20.0)})


def shown_by(member: type) -> Campaign:
    """Return the small campaign whose runs supply what a member needs."""
    special = {"reference": referenced_campaign, "driven": driven_campaign, "directions": directed_campaign,
               "hand": campaign_in_motion, "carried": campaign_in_motion,
               "unknown_heading": anyhow_campaign, "unknown_level": anyhow_campaign}  # fmt: skip
    special |= {"outer_angle": serial_campaign, "middle_angle": serial_campaign}
    for need, among in special.items():
        if need in member.needs:
            return among()
    if issubclass(member, AmbientEffect):
        return read_campaign() if issubclass(member, SharedThermometer) else uncertain_campaign()
    if member.nuisance:
        return tumble_campaign()
    # A skew shows in rows of known angle that turn, and there are none but in the wide campaign.
    recorded = any(set(member.needs) <= names for names in join_nodes(campaign()).supplies)
    plain = member.name != "time_skew" and recorded and not _missing(member.name)
    return campaign() if plain else wide_campaign()


def uncertain_campaign() -> Campaign:
    """Return the campaign with temperatures of the converter in all runs on tables, stated with uncertainties."""
    known = campaign()
    stated = {"temperature_uncertainty": 2.0, "converter_temperature_uncertainty": 3.0}
    return replace(known, runs=tuple(replace(run, **stated) for run in known.runs))


def read_campaign() -> Campaign:
    """Return the campaign with temperatures read by one thermometer for the sensors, and one for the converter."""
    known = uncertain_campaign()
    read = {"thermometer": "Pt", "converter_thermometer": "Pc", "temperature_uncertainty": None}
    runs = tuple(replace(run, **read, converter_temperature_uncertainty=None) for run in known.runs)
    return replace(known, runs=runs, thermometers={name: Thermometer(name, 2.0, 0.03) for name in ("Pt", "Pc")})


def _missing(name: str) -> bool:
    """Return whether no run of the small campaign shows a registered member."""
    return any(each.effect_class.name == name and each.missing for each in _shown_by_small())


@cache
def _shown_by_small() -> tuple[Observability, ...]:
    return observability(campaign())


def recover(member: type, registry: Registry | None = None) -> Recovered:
    return recovered(declared_alone(member, registry), registry)


def recovered(model: Model, registry: Registry | None = None, seed: int = 5) -> Recovered:
    size, hypers = model.problem.size
    truth = np.clip(np.random.default_rng(seed).normal(size=size), -2, 2)
    again = bind(model.spec, simulated(model, truth, seed), registry)
    mode = find_mode(again.problem, jnp.zeros(size), jnp.zeros(hypers))
    deviations = standard_deviations(again, mode)
    scores = (np.asarray(mode.z) - truth) / deviations
    return Recovered(bool(mode.converged), again.layout.names, scores, deviations)


def standard_deviations(model: Model, mode) -> np.ndarray:
    """Return posterior standard deviations in z, by dense algebra of our own."""
    values = np.asarray(model.problem.hyper_priors.values(mode.h))
    jacobian = np.asarray(jax.jit(jax.jacfwd(lambda z: predict(model.problem, z)))(mode.z))
    widths = np.ones(jacobian.shape[1])
    for place, (hyper, unit) in enumerate(zip(model.problem.spread_of, model.problem.spread_unit, strict=True)):
        if hyper < len(values):
            widths[place] = values[hyper] / unit
    root = jacobian / np.sqrt(variances(model, values))[:, None]
    return np.sqrt(np.diag(np.linalg.inv(root.T @ root + np.diag(widths**-2))))


def variances(model: Model, values: np.ndarray) -> np.ndarray:
    """Return the variance of each entry under white noise and closing noise."""
    entries, found = model.entries, np.empty(len(model.entries))
    by_name = dict(zip(model.hyper_layout.names, values, strict=True))
    for place in range(len(entries)):
        if entries.closing[place]:
            run = model.campaign.runs[entries.run[place]].name
            found[place] = by_name[f"rotation_closure.sigma[{run}]"] ** 2
        else:
            channel = model.campaign.channels[entries.channel[place]].name
            found[place] = by_name[f"white_noise.sigma[{channel}]"] ** 2 / entries.samples[place]
    return found


def is_recovered(found: Recovered) -> None:
    """The law: converged, within five standard deviations, and something was learnt."""
    assert found.converged
    assert np.max(np.abs(found.scores)) < 5
    assert np.min(found.deviations) < 0.5, "the campaign does not show this effect"
