"""An effect that cannot be absent by its prior: what is expected of it is what a refit finds."""

import jax.numpy as jnp
import numpy as np
import pytest
from null_data import fitted_to, refitted, with_values

import imubayes.loop.warm_start as extend_module
from imubayes.loop.cross_validation import observed_delta_chi2
from imubayes.loop.warm_start import extend
from imubayes.model.problem import predict

HALF_WIDTH = 60.0  # ug, three times the standard deviation of its prior
GRAVITY = 9.80665


@pytest.fixture(scope="module")
def lacking():
    """The fit of readings of ay that miss what a play of 60 ug takes up."""
    whole = fitted_to("hidden-none")
    model = whole.model
    names = [channel.name for channel in model.campaign.channels]
    channel = model.campaign.channels[names.index("ay")]
    here = np.asarray(model.entries.channel) == names.index("ay")
    output = np.asarray(predict(model.problem, jnp.asarray(whole.z)))
    force = (output - channel.offset) / channel.scale_si
    missed = np.clip(force, -HALF_WIDTH * 1e-6 * GRAVITY, HALF_WIDTH * 1e-6 * GRAVITY) * channel.scale_si
    assert np.any(here & (np.abs(missed) < 0.9 * np.abs(missed).max()))
    return with_values(whole, np.asarray(model.problem.observations.value) - here * missed)


def falls(lacking) -> tuple[float, float, float]:
    """Return by how much chi squared is expected to fall, by how much it falls, and the half width found."""
    extension = extend(lacking, ["accel_dead_zone"], ["ay"])
    after = refitted(extension.model, extension.z, extension.h)
    (coefficient,) = extension.coefficients
    assert extension.delta_chi2 is not None
    return extension.delta_chi2, observed_delta_chi2(lacking, after), coefficient.value


@pytest.mark.slow
def test_what_is_expected_is_found(lacking):
    expected, found, half_width = falls(lacking)
    assert found > 36
    assert expected == pytest.approx(found, rel=0.05)
    assert half_width == pytest.approx(HALF_WIDTH, abs=20)


@pytest.mark.slow
def test_with_what_acts_at_the_start_left_out_it_is_not(lacking, monkeypatch):
    """The planted fault: the check goes red if the half width is taken to be zero where its expansion begins."""
    monkeypatch.setattr(extend_module, "_without_new", lambda *_: None)
    expected, found, _ = falls(lacking)
    assert abs(expected / found - 1) > 0.2
