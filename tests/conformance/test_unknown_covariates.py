"""A covariate that an effect needs and a run lacks is refused by name, or provably irrelevant: over the registry.

The effects are bound, not fitted.  A run lacks a covariate that has some value there, recorded or not: a temperature, a
time.  One that is absent if nobody records it, such as an injected current, is none of these.
"""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import laws
import numpy as np
import pytest

from imubayes.effects.base import AmbientEffect, Effect, MotionEffect, RecordEffect
from imubayes.effects.thermometer import SharedThermometer
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.covariates import COVARIATES, HIGHER_DERIVATIVES, ROW_SLOPES, ambient_names
from imubayes.foundations.errors import InputError
from imubayes.model.bind import bind
from imubayes.model.bound_effects import UnknownCovariateError, bind_effect
from imubayes.model.effect_registry import Registry
from imubayes.model.grouping import Grouping
from imubayes.model.model_file import EffectSpec, ModelSpec
from imubayes.model.nodes_and_entries import join_entries, join_nodes
from small_campaign import spec, wide_campaign

EFFECTS = {name: each for name, each in Registry().effects.items() if issubclass(each, Effect)}
DEPENDENT = [
    name
    for name, each in EFFECTS.items()
    if any(not COVARIATES[n].absent for n in each.needs if n in COVARIATES) and not issubclass(each, AmbientEffect)
]
"""Effects of a covariate that every run has; an error of the covariate itself is none if it is not recorded."""
RECORDED = {
    "temperature_rate": "temperature",
    "converter_temperature_rate": "converter_temperature",
    "campaign_time": "time",
}
"""Columns from which a covariate is derived."""


@cache
def grouping(lacking: str = "", run: str = "") -> Grouping:
    """Return the wide campaign, without a covariate in one run."""
    campaign = without(wide_campaign(), lacking, run)
    return Grouping(campaign, join_nodes(campaign), join_entries(campaign))


def without(campaign: Campaign, lacking: str, run: str) -> Campaign:
    runs = [
        replace(each, covariates={k: v for k, v in each.covariates.items() if k != lacking})
        if each.name == run
        else each
        for each in campaign.runs
    ]
    return replace(campaign, runs=tuple(runs))


def test_there_are_dependent_effects_of_every_kind():
    assert {"accel_bias_temperature", "gyro_thermal_lag", "converter_gain_drift", "gyro_bias_drift"} <= set(DEPENDENT)


@pytest.mark.parametrize("name", DEPENDENT)
def test_what_a_run_lacks_is_refused_by_name(name):
    """Whichever run of the campaign lacks it, as long as the effect acts on what that run measures."""
    bind_effect(EffectSpec(name), grouping(), Registry())
    lacking = {RECORDED.get(need, need) for need in EFFECTS[name].needs}
    for covariate in lacking:
        for run in ("head-flat-45", "rate-pyramid", "cycle-slow"):
            with pytest.raises(UnknownCovariateError) as refused:
                bind_effect(EffectSpec(name), grouping(covariate, run), Registry())
            (issue,) = refused.value.issues
            needed = [COVARIATES[need].column for need in EFFECTS[name].needs]
            assert f"run '{run}' has no " in issue.what
            assert f"'{name}'" in issue.what
            assert any(column in issue.what for column in needed)
            assert f"'{name}' out of the model" in issue.remedy
            assert f"'{run}' out of the campaign" in issue.remedy


OF_ROWS_IN_MOTION = (
    "row_seconds",
    *(f"table_angle_d{order}" for order in HIGHER_DERIVATIVES),
    *(f"row_slope_{order}" for order in ROW_SLOPES),
)
"""Made by the reduction of a log that follows the angle of its table; 0 is their value in all other rows."""


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_reads_no_covariate_that_it_does_not_declare(name):
    """So that a run which lacks one that is not declared provably does not matter."""
    member, rng = EFFECTS[name], np.random.default_rng(5)
    undeclared = {
        other: float(rng.uniform(1, 60))
        for other in ambient_names()
        if other not in (*member.needs, *OF_ROWS_IN_MOTION)
    }
    for seed in range(1, 4):
        acting = laws.instance(member, laws.drawn_values(member, seed))
        apply = acting.carry if issubclass(member, RecordEffect) else laws.act_of(acting)
        plain, moved = ((laws.ambient(seed, **fixed), laws.states(member, seed, **fixed)) for fixed in ({}, undeclared))
        if issubclass(member, RecordEffect):
            found = [apply(ambient, ambient, jnp.asarray(1.0)) for ambient, _ in (plain, moved)]
        else:
            found = [apply(*state) for _, state in (plain, moved)]
        if issubclass(member, AmbientEffect):
            # It hands on all circumstances, and has to change its own alike.  A gain multiplies the rate of change of
            # its own as well, which 0 stands for if there is none.
            rate = f"{member.covariate}_rate"
            if issubclass(member, SharedThermometer):
                found = [
                    each.updated(**{rate: state[0].values[rate]})
                    for each, (_, state) in zip(found, (plain, moved), strict=True)
                ]
            found = [
                jax.tree.map(lambda after, before: jnp.round(after - before, 9), each, state[0])
                for each, (_, state) in zip(found, (plain, moved), strict=True)
            ]
        if issubclass(member, MotionEffect) or issubclass(member, RecordEffect):
            same = jax.tree.map(lambda a, b: np.array_equal(a, b), *found)
            assert all(jax.tree.leaves(same))
        else:
            # What is felt holds the circumstances themselves; the effect has to change the rest alike.
            rest = [jax.tree.leaves(each.rate if hasattr(each, "rate") else each) for each in found]
            assert all(np.array_equal(a, b) for a, b in zip(*rest, strict=True))


def test_a_reader_of_what_it_does_not_declare_is_found():
    class Undeclared(EFFECTS["gyro_bias_temperature"]):
        needs = ()

    EFFECTS["undeclared"] = Undeclared
    try:
        with pytest.raises(AssertionError):
            test_an_effect_reads_no_covariate_that_it_does_not_declare("undeclared")
    finally:
        del EFFECTS["undeclared"]


def test_a_run_that_the_effect_does_not_change_may_lack_it():
    """A current stands for the sensor, and a run without gyros shows nothing of their biases."""
    bind_effect(EffectSpec("accel_bias_temperature"), grouping("temperature", "inject"), Registry())
    campaign = without(wide_campaign(), "temperature", "head-x-up-45")
    observed = [run.observed.copy() for run in campaign.runs]
    for run, values in zip(campaign.runs, observed, strict=True):
        if run.name == "head-x-up-45":
            values[:, :3] = np.nan
    runs = tuple(replace(run, observed=values) for run, values in zip(campaign.runs, observed, strict=True))
    campaign = replace(campaign, runs=runs)
    around = Grouping(campaign, join_nodes(campaign), join_entries(campaign))
    bind_effect(EffectSpec("gyro_bias_temperature"), around, Registry())
    with pytest.raises(UnknownCovariateError):
        bind_effect(EffectSpec("accel_bias_temperature"), around, Registry())


def test_effects_of_one_covariate_are_one_issue_and_optional_ones_are_named_too():
    campaign = without(wide_campaign(), "temperature", "head-flat-45")
    entries = tuple(
        replace(entry, optional=entry.name != "white_noise")
        for entry in spec("accel_bias", "accel_bias_temperature", "gyro_scale_temperature").effects
    )
    with pytest.raises(InputError) as refused:
        bind(ModelSpec("thermal", entries), campaign)
    (issue,) = refused.value.issues
    assert "'accel_bias_temperature', 'gyro_scale_temperature' depend" in issue.what
    assert "with temperature_uncertainty_degC unless it is known well" in issue.remedy
