"""User effects, from a file beside the model."""

import sys

import jax.numpy as jnp
import numpy as np
import pytest

from imubayes.foundations.errors import InputError
from imubayes.model.bind import Model, bind
from imubayes.model.effect_registry import names_in
from imubayes.model.model_file import EffectSpec, ModelSpec
from imubayes.model.noise_covariance import noise_deviation, whitener
from imubayes.model.problem import predict
from small_campaign import campaign

SOURCE = '''
"""Scale factor that differs between the two directions of rotation."""

import jax.numpy as jnp

from imubayes import Order, Scalar, SignalEffect, Stage, parameter


class HouseAsymmetry(SignalEffect):
    """signal + a·|rate|."""

    name = "house_asymmetry"
    stage, order, kinds = Stage.SENSOR, Order.SCALE, ("gyro",)
    needs = ("turning",)
    asymmetry: Scalar = parameter("ppm", "normal(0, 100 ppm)", (10, 300), "half the difference of the scale factors")

    def apply(self, signal, sample):
        return signal + self.asymmetry * jnp.abs(sample.rate[0])
'''

NOISE = '''
"""Noise of the row, however many samples it has: what lasts as long as a row does not average out."""

from imubayes import Entry, EntryNoise, Scalar, parameter


class HouseNoise(EntryNoise):
    """Variance σ² of a row."""

    name, kinds = "house_noise", ("gyro",)
    sigma: Scalar = parameter("output", "lognormal(1 noise, 0.5)", (1e-9, 0.1), "the standard deviation of a row")

    def variance(self, entry: Entry):
        return self.sigma**2
'''


def model_of(*names: str, files: tuple = ()) -> ModelSpec:
    effects = tuple(EffectSpec(name, where=f"model: {name}") for name in (*names, "white_noise"))
    return ModelSpec("own", effects, tuple(map(str, files)))


def deviation(model: Model) -> np.ndarray:
    """Return the standard deviation of the noise at the median of its prior, (E,)."""
    return np.asarray(noise_deviation(model.problem, whitener(model.problem, jnp.zeros(model.problem.size[1]))))


def test_a_user_effect_is_bound_and_predicted(tmp_path):
    file = tmp_path / "house.py"
    file.write_text(SOURCE, encoding="utf-8")
    model = bind(model_of("house_asymmetry", files=(file,)), campaign())
    assert model.layout.names == tuple(f"house_asymmetry.asymmetry[g{axis}]" for axis in "xyz")
    rest, at = (predict(model.problem, jnp.asarray(z)) for z in ([0.0, 0, 0], [0.0, 0, 1]))
    change = np.asarray(at - rest)
    gz = (model.entries.channel == 2) & (model.entries.run == 0)
    # 100 ppm of |±100 °/s| at 1000 pulses per degree, in both directions
    np.testing.assert_allclose(change[gz][1:3], 10.0, rtol=1e-3)
    assert not change[model.entries.channel != 2].any()


def test_a_noise_of_the_user_is_bound_and_widens_what_it_applies_to(tmp_path):
    file = tmp_path / "house.py"
    file.write_text(NOISE, encoding="utf-8")
    model = bind(model_of("gyro_bias", "house_noise", files=(file,)), campaign())
    assert [each for each in model.hyper_layout.names if "house" in each] == [
        f"house_noise.sigma[g{axis}]" for axis in "xyz"
    ]
    own, white = (deviation(each) for each in (model, bind(model_of("gyro_bias"), campaign())))
    gyro = model.entries.channel < 3
    # The median of the prior is the noise of a raw sample, 0.5 pulses, and that of the white noise is averaged.
    np.testing.assert_allclose(own[gyro] ** 2 - white[gyro] ** 2, 0.5**2, rtol=1e-6)
    np.testing.assert_array_equal(own[~gyro], white[~gyro])


@pytest.mark.parametrize(
    ("text", "what"),
    [
        (None, "missing"),
        ("x = ", "cannot be read"),
        ("raise RuntimeError('no')", "RuntimeError: no"),
        ("x = 1", "defines no effect"),
        (SOURCE.replace('name = "house_asymmetry"', "pass"), "no name"),
        (SOURCE.replace('"house_asymmetry"', '"gyro_bias"'), "exists already"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused(tmp_path, text, what):
    file = tmp_path / "house.py"
    if text is not None:
        file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        bind(model_of("gyro_bias", files=(file,)), campaign())
    (problem,) = caught.value.issues
    assert what in problem.what
    assert str(file) in problem.where
    assert problem.remedy


def test_nothing_is_left_beside_the_file(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    (tmp_path / "house.py").write_text(SOURCE)
    assert names_in(tmp_path / "house.py") == ("house_asymmetry",)
    assert [file.name for file in tmp_path.iterdir()] == ["house.py"]


def test_a_name_without_its_file_is_unknown():
    with pytest.raises(InputError, match="no effect 'house_asymmetry'"):
        bind(model_of("house_asymmetry"), campaign())


@pytest.mark.parametrize(
    ("returned", "what"),
    [
        ("signal + self.nothing", "no attribute 'nothing'"),
        ("signal + sample.humidity", "no attribute 'humidity'"),
        ("signal if signal > 0 else -signal", "boolean"),
        ("self.apply(signal, sample)", "recursion"),
        ("signal.astype(complex)", "complex"),
        ("signal * jnp.ones(3)", "Error"),
        ("None", "None"),
        ("exit(3)", "SystemExit"),
    ],
)
def test_a_class_that_fails_is_reported_before_the_fit(tmp_path, returned, what):
    file = tmp_path / "house.py"
    file.write_text(SOURCE.replace("signal + self.asymmetry * jnp.abs(sample.rate[0])", returned), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        bind(model_of("gyro_bias", "house_asymmetry", files=(file,)), campaign())
    (problem,) = caught.value.issues
    assert what in problem.what
    assert str(file) in problem.where
    assert "HouseAsymmetry" in problem.where or ":18, in apply" in problem.where
    assert "jnp.where" in problem.remedy


def test_a_file_that_exits_is_refused(tmp_path):
    (tmp_path / "house.py").write_text("raise SystemExit(3)")
    with pytest.raises(InputError, match="SystemExit"):
        bind(model_of("gyro_bias", files=(tmp_path / "house.py",)), campaign())
