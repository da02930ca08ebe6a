"""Fits to look at: of shipped campaigns, of other readings, and of a model's own prediction with fresh noise."""

from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from imubayes.campaign import load_campaign
from imubayes.criticism.diagnose import judge
from imubayes.criticism.diagnosis_record import Diagnosis
from imubayes.inference.fitted_model import Fit
from imubayes.inference.posterior_mode import find_mode
from imubayes.model.bind import Model, bind
from imubayes.model.model_file import read_model
from imubayes.model.problem import predict
from imubayes.noise.components import EntryNoise

ROOT = Path(__file__).parents[2]


def fitted_to(campaign: str, model: str = "hidden-effects") -> Fit:
    """Return the fit of a shipped campaign, without what else is reported of one."""
    return _fitted(campaign, model)


def judged(campaign: str, model: str = "hidden-effects") -> Diagnosis:
    """Return the diagnosis of that fit."""
    return _judged(campaign, model)


@cache
def _fitted(campaign: str, model: str) -> Fit:
    declared = bind(read_model(ROOT / "models" / f"{model}.toml"), load_campaign(ROOT / "data" / campaign))
    found = refitted(declared, *(np.zeros(size) for size in declared.problem.size))
    assert found.converged
    return found


@cache
def _judged(campaign: str, model: str) -> Diagnosis:
    return judge(_fitted(campaign, model))


def redrawn(fitted: Fit, seed: int, correlation: float = 0.0, change: np.ndarray | None = None) -> Fit:
    """Return the fit of fresh data: white noise, or AR(1) from row to row, with a change of the readings on top."""
    problem = fitted.model.problem
    random = np.random.default_rng(seed)
    members, group = np.asarray(problem.observations.members), np.asarray(problem.observations.group)
    values = problem.hyper_priors.values(jnp.asarray(fitted.h))
    variance, shared = np.zeros(len(group)), np.zeros(len(members))
    for layer in problem.noise:
        if issubclass(layer.noise, EntryNoise):
            variance += np.asarray(layer.entry_variances(values, problem.observations.entry))
        else:
            shared += np.asarray(layer.shared_variances(values))
    noise = random.normal(size=len(group))
    for row in members:
        inside = row[row < len(group)]
        for before, after in pairwise(inside.tolist()):
            noise[after] = correlation * noise[before] + np.sqrt(1 - correlation**2) * noise[after]
    readings = np.asarray(predict(problem, jnp.asarray(fitted.z))) + np.sqrt(variance) * noise
    readings = readings + (np.sqrt(shared) * random.normal(size=len(shared)))[group]
    readings = readings if change is None else readings + change
    fresh = eqx.tree_at(lambda p: p.observations.value, problem, np.asarray(readings))
    mode = find_mode(fresh, jnp.asarray(fitted.z), jnp.asarray(fitted.h))
    model = replace(fitted.model, problem=fresh, entries=replace(fitted.model.entries, value=readings))
    return Fit(model, np.asarray(mode.z), np.asarray(mode.h), bool(mode.converged))


def with_values(fitted: Fit, value: np.ndarray) -> Fit:
    """Return the fit to other readings."""
    entries = fitted.model.entries
    runs = [replace(run, observed=run.observed.copy()) for run in fitted.model.campaign.runs]
    for k, one in enumerate(value):
        runs[entries.run[k]].observed[entries.row[k], entries.channel[k]] = one
    model = bind(fitted.model.spec, replace(fitted.model.campaign, runs=tuple(runs)))
    return refitted(model, np.zeros(len(fitted.z)), np.zeros(len(fitted.h)))


def refitted(model: Model, z: np.ndarray, h: np.ndarray) -> Fit:
    """Return the fit of a model, begun at z and h."""
    mode = find_mode(model.problem, jnp.asarray(z), jnp.asarray(h))
    return Fit(model, np.asarray(mode.z), np.asarray(mode.h), bool(mode.converged))
