"""A scatter between runs cannot be determined from one run: it is left out of the bound model, and reported."""

from dataclasses import replace

import numpy as np
import pytest

from imubayes.display.fit_cautions import left_out_lines
from imubayes.model.bind import Model, bind
from imubayes.model.model_file import EffectSpec, ModelSpec, SingleRunEffect
from small_campaign import campaign

GYROS, ACCELS = ("gx", "gy", "gz"), ("ax", "ay", "az")


def bound(runs: slice, effect: EffectSpec, without: str = "", *, single_runs: bool = False) -> Model:
    """Return a model with an effect between runs, bound to some runs, the last of them without a channel."""
    whole = campaign()
    chosen = list(whole.runs[runs])
    if without:
        observed = chosen[-1].observed.copy()
        observed[:, [channel.name for channel in whole.channels].index(without)] = np.nan
        chosen[-1] = replace(chosen[-1], observed=observed)
    names = ("gyro_bias", "accel_bias", "white_noise")
    spec = ModelSpec("m", (*(EffectSpec(name) for name in names), effect))
    return bind(spec, replace(whole, runs=tuple(chosen)), single_runs=single_runs)


ONE, TWO = slice(3, 4), slice(3, 5)
"""Runs on the dividing head."""


@pytest.mark.parametrize("optional", [True, False])
@pytest.mark.parametrize(
    ("name", "channels"), [("run_scatter", GYROS + ACCELS), ("gyro_run_bias", GYROS), ("accel_run_bias", ACCELS)]
)
def test_one_run_tells_nothing_of_what_differs_between_runs(name, channels, optional):
    model = bound(ONE, EffectSpec(name, optional=optional))
    assert not [each for each in model.parameter_names if each.startswith(name)]
    assert model.left_out == (SingleRunEffect(effect=name, channels=channels),)
    twice = bound(TWO, EffectSpec(name, optional=optional))
    assert [each for each in twice.parameter_names if each.startswith(name)]
    assert twice.left_out == ()


@pytest.mark.parametrize("name", ["run_scatter", "accel_run_bias"])
def test_runs_are_counted_for_each_channel(name):
    model = bound(TWO, EffectSpec(name), without="ay")
    assert model.left_out == (SingleRunEffect(effect=name, channels=("ay",)),)
    labelled = {each.partition("[")[2].rstrip("]").split(",")[0] for each in model.parameter_names if name in each}
    assert labelled == ({*GYROS, *ACCELS} if name == "run_scatter" else {*ACCELS}) - {"ay"}
    # If a run is added in thought, what was left out does not come in.
    again = bind(model.spec_of_known, campaign())
    assert {each for each in again.parameter_names if name in each and "ay" in each} == set()


def test_a_stated_prior_and_a_simulation_know_it():
    stated = bound(ONE, EffectSpec("run_scatter", prior={"tau": "lognormal(0.1 output, 0.3)"}))
    assert "run_scatter.tau[ax]" in stated.parameter_names
    assert stated.left_out == ()
    assert "run_scatter.tau[ax]" in bound(ONE, EffectSpec("run_scatter"), single_runs=True).parameter_names


def test_one_line_says_what_the_uncertainty_lacks():
    (line,) = left_out_lines(bound(ONE, EffectSpec("run_scatter")).left_out)
    assert line.startswith("run_scatter is left out, because fewer than two runs contain gx, gy, gz, ax and 2 more")
    assert "Repeatability from run to run requires more runs" in line
    assert "\n" not in line
