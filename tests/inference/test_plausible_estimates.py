"""A fit that ends where no working unit can be has failed, and says so; estimates of working units pass."""

import math

import numpy as np
import pytest

from imubayes.foundations.units import same_dimension, to_si
from imubayes.inference.plausibility import FAR_SD, implausible_estimates, unexplained_outputs
from imubayes.model.bind import Model
from imubayes.model.effect_registry import Registry
from imubayes.parameters.declarations import declared_parameters
from small_campaign import full_model

SCALE = "gyro_scale_factor.scale[gx]"  # prior 0 ± 2000 ppm


@pytest.fixture(scope="module")
def model() -> Model:
    return full_model()


def test_the_middle_and_the_wings_of_the_priors_are_plausible(model: Model) -> None:
    for z in (0.0, 5.0, -5.0):
        found = implausible_estimates(model, np.full(len(model.layout), z), np.full(len(model.hyper_layout), z))
        assert found == ()


def test_a_reversed_scale_factor_is_impossible(model: Model) -> None:
    z = np.zeros(len(model.layout))
    z[model.layout.index(SCALE)] = -1000.044
    (found,) = implausible_estimates(model, z, np.zeros(len(model.hyper_layout)))
    assert (found.reason, found.name) == ("outside_domain", SCALE)
    assert found.value == pytest.approx(-2_000_088, rel=1e-9)
    assert (found.lowest, found.highest) == (pytest.approx(-1e6), pytest.approx(1e6))


def test_an_estimate_far_from_its_prior_is_another_thing(model: Model) -> None:
    z = np.zeros(len(model.layout))
    for distance, failed in ((FAR_SD - 0.1, False), (FAR_SD + 0.1, True)):
        z[model.layout.index("gyro_bias.bias[gy]")] = distance
        found = implausible_estimates(model, z, np.zeros(len(model.hyper_layout)))
        assert [each.reason for each in found] == ["far_from_prior"] * failed
    assert found[0].distance == pytest.approx(FAR_SD + 0.1)


def misfit_of(model: Model, channel: str, sd: float) -> np.ndarray:
    """Return a misfit of a standard deviation, output units, in every row of a channel and the noise elsewhere."""
    place = [each.name for each in model.campaign.channels].index(channel)
    misfit = np.random.default_rng(3).standard_normal(len(model.entries)) * 0.01
    return np.where(model.entries.channel == place, misfit * 100 * sd, misfit)


def test_outputs_that_the_model_does_not_describe(model: Model) -> None:
    # 2000 pulse/s per g, recorded noise 0.005 in a mean of 100 samples.
    assert unexplained_outputs(model, misfit_of(model, "ax", 20.0)) == ()  # 10 mg: an effect may be missing
    (found,) = unexplained_outputs(model, misfit_of(model, "ax", 1500.0))
    assert (found.channel, found.unit) == ("ax", "g")
    assert found.residual == pytest.approx(0.75, rel=0.3)
    assert found.noise == pytest.approx(0.05 / 10 / 2000, rel=0.2)


def test_an_offset_of_a_run_is_no_contradiction(model: Model) -> None:
    place = [each.name for each in model.campaign.channels].index("ax")
    run = np.asarray(model.entries.run)
    for size, named in ((300.0, ()), (4000.0, ("ax",))):  # 0.15 g, and 2 g: the sign is wrong
        shifted = np.where(model.entries.channel == place, size * (-1.0) ** run, 0.0)
        assert tuple(each.channel for each in unexplained_outputs(model, shifted)) == named


def test_every_declared_domain_has_room_for_its_prior() -> None:
    """The law of domains: dimension of the parameter, and ten times the largest typical size inside."""
    judged = 0
    for effect in Registry().effects.values():
        for name, declared in declared_parameters(effect).items():
            if declared.domain is None:
                continue
            judged += 1
            assert same_dimension(declared.domain.unit, declared.unit, name), (effect.name, name)
            share = to_si(declared.domain.unit) / to_si(declared.unit)
            room = min(-declared.domain.low, declared.domain.high) * share
            assert math.isfinite(room)
            assert room > 4 * declared.typical[1], (effect.name, name)
    assert judged > 40
