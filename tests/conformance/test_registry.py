"""All laws over all registered members."""

import tomllib
from functools import cache
from types import ModuleType

import jax.numpy as jnp
import laws
import numpy as np
import pytest
import recover
import tomlkit

from imubayes.effects.base import AmbientEffect, Effect
from imubayes.foundations.covariates import ambient_names
from imubayes.model.bind import Model, bind
from imubayes.model.effect_registry import Registry
from imubayes.model.model_file import read_model
from imubayes.model.problem import predict
from imubayes.noise.components import Noise
from imubayes.parameters.declarations import declared_options, declared_parameters, named_in
from small_campaign import spec, whole_catalogue, wide_campaign

MEMBERS = Registry().effects
EFFECTS = {name: member for name, member in MEMBERS.items() if issubclass(member, Effect)}
NOISES = {name: member for name, member in MEMBERS.items() if issubclass(member, Noise)}

# One of every base, stage and kind at every run of the tests; each effect by `make laws`.
RECOVERED = (
    "table_axis_tilt", "table_wobble", "lever_arm", "gyro_scale_asymmetry", "gyro_thermal_lag", "accel_misalignment",
    "accel_warm_up", "converter_gain_drift",
)  # fmt: skip
# What compiles derivatives of every effect.
DERIVATIVES = (laws.gradients_are_finite, laws.linear_coefficients_show_at_null)


def called(law) -> str:
    return law.__name__


@pytest.mark.parametrize("law", laws.OF_ALL, ids=called)
@pytest.mark.parametrize("name", MEMBERS)
def test_law_of_all(name, law):
    law(MEMBERS[name])


@pytest.mark.parametrize("law", [law for law in laws.OF_EFFECTS if law not in DERIVATIVES], ids=called)
@pytest.mark.parametrize("name", EFFECTS)
def test_law_of_effects(name, law):
    law(EFFECTS[name])


@pytest.mark.parametrize("law", DERIVATIVES, ids=called)
@pytest.mark.parametrize(
    "name", [name if name in RECOVERED else pytest.param(name, marks=pytest.mark.slow) for name in EFFECTS]
)
def test_law_of_derivatives(name, law):
    law(EFFECTS[name])


@pytest.mark.parametrize("law", laws.OF_NOISE, ids=called)
@pytest.mark.parametrize("name", NOISES)
def test_law_of_noise(name, law):
    law(NOISES[name])


@pytest.fixture(scope="module")
def together_recovered() -> recover.Recovered:
    return recover.recovered(bind(spec(*RECOVERED), wide_campaign()))


@pytest.mark.slow  # test_faults.py recovers one at every run
@pytest.mark.parametrize("name", RECOVERED)
def test_simulate_recover(together_recovered, name):
    recover.is_recovered(together_recovered.of(name))


@pytest.mark.slow
@pytest.mark.parametrize("name", EFFECTS)
def test_simulate_recover_alone(name):
    recover.is_recovered(recover.recover(EFFECTS[name]))


def test_the_recovered_exist():
    assert set(EFFECTS) >= set(RECOVERED)


GATED = [n for n, m in EFFECTS.items() if {*ambient_names(), *laws.GATES} & set(m.needs)]


@cache
def elsewhere() -> dict[str, Model]:
    """Return the gated effects that the wide campaign cannot show, by campaign: one model for all that one shows."""
    present = {effect.name for effect in whole_catalogue().assembly.effects}
    absent = [n for n in GATED if n not in present and not issubclass(EFFECTS[n], AmbientEffect)]
    shown = {name: recover.shown_by(EFFECTS[name]) for name in absent}
    alike = {shown[name].name: [other for other in shown if shown[other].name == shown[name].name] for name in shown}
    return {which: bind(spec(*names), shown[names[0]]) for which, names in alike.items()}


def beside_its_like(name: str) -> Model:
    """Return a model of an effect and of the others that the same campaign shows."""
    if issubclass(EFFECTS[name], AmbientEffect):
        return recover.declared_alone(EFFECTS[name])
    return elsewhere()[recover.shown_by(EFFECTS[name]).name]


@pytest.mark.parametrize("name", GATED)
def test_nothing_reaches_a_run_that_lacks_what_is_needed(name):
    model = whole_catalogue()
    if name not in {effect.name for effect in model.assembly.effects}:
        model = beside_its_like(name)
    own = np.array([parameter.name.startswith(f"{name}.") for parameter in model.layout.parameters])
    # What is in error shows through what depends on it.
    others = 0.3 * issubclass(EFFECTS[name], AmbientEffect) * ~own
    here, there = (np.asarray(predict(model.problem, jnp.asarray(z * own + others))) for z in (0.3, -0.5))
    change = there - here
    needed = set(EFFECTS[name].needs) & {*ambient_names(), *laws.GATES}
    lacking = [i for i, supplied in enumerate(model.nodes.supplies) if not needed <= supplied]
    assert np.any(change != 0)
    assert not np.any(change[np.isin(model.entries.run, lacking)])


@pytest.mark.parametrize("name", MEMBERS)
def test_an_entry_of_a_model_file_survives_the_round_trip(name, tmp_path):
    member = MEMBERS[name]
    entry = tomlkit.table()
    entry["name"] = name
    entry["prior"] = tomlkit.inline_table()
    for field, parameter in declared_parameters(member).items():
        entry["prior"][field] = parameter.prior
    for option, value in declared_options(member).items():
        entry[option] = value
    # A model needs a parameter and a noise; a second effect would stand in the way of one that acts on the same.
    others = [] if name == "white_noise" else [{"name": "white_noise"}]
    others += [] if issubclass(member, Effect) else [{"name": "gyro_bias"}]
    file = tmp_path / "model.toml"
    file.write_text(tomlkit.dumps({"format": 1, "name": "round", "effect": [entry, *others]}), encoding="utf-8")
    assert tomllib.loads(file.read_text(encoding="utf-8"))["effect"][0]["name"] == name
    spec = read_model(file)
    assert spec.effects[0].name == name
    assert dict(spec.effects[0].prior) == {
        field: parameter.prior for field, parameter in declared_parameters(member).items()
    }
    assert dict(spec.effects[0].options) == declared_options(member)
    model = bind(spec, recover.shown_by(member))
    bound = {each.partition("[")[0] for each in (*model.layout.names, *model.hyper_layout.names)}
    assert bound >= {f"{name}.{field}" for field in declared_parameters(member)}


def test_a_class_with_a_name_is_all_that_a_new_effect_takes():
    family = ModuleType("imubayes.effects.toy")
    source = """
from imubayes import Scalar, parameter
from imubayes.effects.shared_formulas import ConstantBias, Gyro

class SharedByNone(ConstantBias):
    pass

class GyroToyBias(Gyro, ConstantBias):
    name, reference = "gyro_toy_bias", "for this test"
    bias: Scalar = parameter("deg/h", "normal(0, 1 deg/h)", (0.1, 2), "the bias")
"""
    exec(source, vars(family))
    (member,) = named_in(family, Effect)
    assert member.name == "gyro_toy_bias"
    for law in (*laws.OF_ALL, *laws.OF_EFFECTS):
        law(member)
