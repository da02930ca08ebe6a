"""The law of failed fits over everything that is shipped: no fit of a working unit is refused."""

from pathlib import Path

import jax.numpy as jnp
import pytest

from imubayes.campaign import load_campaign
from imubayes.inference.posterior_mode import find_mode
from imubayes.inference.run_fit import judged_fit
from imubayes.model.bind import bind
from imubayes.model.model_file import read_model

ROOT = Path(__file__).parents[2]
SHIPPED = sorted(file.parent.name for file in (ROOT / "data").glob("*/campaign.toml"))


def model_of(campaign: str) -> Path:
    shared = {"hidden-thermal": "hidden-effects-thermal"}
    name = shared.get(campaign, "hidden-effects" if campaign.startswith("hidden-") else campaign)
    return ROOT / "models" / f"{name}.toml"


@pytest.mark.slow
@pytest.mark.parametrize("name", SHIPPED)
def test_no_fit_of_a_shipped_campaign_is_refused(name: str) -> None:
    model = bind(read_model(model_of(name)), load_campaign(ROOT / "data" / name))
    size, hyper_size = model.problem.size
    fit = judged_fit(model, find_mode(model.problem, jnp.zeros(size), jnp.zeros(hyper_size)))
    assert fit.converged, fit.message
    assert not fit.implausible
    assert not fit.unexplained
