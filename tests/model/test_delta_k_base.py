"""In the joint fit, as classically, Δk of an injected current is relative to the injected current of 1 g."""

from dataclasses import replace

import numpy as np

from imubayes.foundations.campaign_data import Campaign
from imubayes.model.bind import bind
from imubayes.model.derived_quantities import derived_quantities
from imubayes.model.model_file import EffectSpec, ModelSpec
from small_campaign import campaign


def with_outputs(injected_g: tuple[float, ...]) -> Campaign:
    """The ramp in gravity, and currents that stand for these inputs; every output is there."""
    base = campaign()
    ramp, pattern = (next(run for run in base.runs if run.name == name) for name in ("ramp", "inject"))
    current = float(pattern.covariates["current"][0]) / 12.0
    runs = [replace(ramp, covariates=dict(ramp.covariates) | {"table_angle": np.full(ramp.rows, np.pi)})]
    for level in injected_g:
        columns = dict(pattern.covariates) | {"current": np.full(pattern.rows, current * level)}
        runs.append(replace(pattern, name=f"inject-{level:g}", covariates=columns))
    return replace(base, runs=tuple(replace(run, observed=np.ones_like(run.observed)) for run in runs))


def bases(injected_g: tuple[float, ...]) -> set[tuple[int, int]]:
    """Return the runs compared: (run, base), over all accelerometers."""
    effects = ("accel_bias", "converter_gain_drift", "white_noise")
    model = bind(ModelSpec("m", tuple(EffectSpec(name) for name in effects)), with_outputs(injected_g))
    pairs = np.asarray(derived_quantities(model.assembly).derivation.thermal_pairs["accelerometer"])
    return {(int(run), int(base)) for _, run, base in pairs}


def test_injected_inputs_are_compared_with_the_injected_1_g():
    assert (1, 2) in bases((12.0, 1.0))
    assert (1, 0) not in bases((12.0, 1.0))


def test_without_an_injected_1_g_the_ramp_is_the_base():
    assert (1, 0) in bases((12.0, 3.0))
    assert (2, 0) in bases((12.0, 3.0))
