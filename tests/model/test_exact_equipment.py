"""An uncertainty of 0 means exact: the parameter does not exist, unless the model gives it a prior."""

from dataclasses import replace

import pytest

from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.errors import InputError
from imubayes.model.bind import bind
from imubayes.model.model_file import EffectSpec, ModelSpec
from small_campaign import campaign

LISTED = ("gyro_bias", "gyro_scale_factor", "mounting_error", "table_rate_error", "table_axis_tilt", "white_noise")


def stated(**changed) -> Campaign:
    base = campaign()
    tables = {name: replace(table, **changed) for name, table in base.tables.items()}
    return replace(base, tables=tables)


def names(among: Campaign, **priors) -> set[str]:
    effects = tuple(EffectSpec(name, prior=priors.get(name, {})) for name in LISTED)
    return set(bind(ModelSpec("m", effects), among).layout.names)


def test_an_exact_table_has_no_rate_error_and_no_tilt():
    before = names(campaign())
    assert "table_rate_error.rate_error[rate]" in before
    exact = names(stated(rate_uncertainty=0.0, axis_uncertainty=0.0))
    assert before - exact == {name for name in before if name.startswith("table_")}


def test_one_exact_mounting_keeps_the_errors_of_the_others():
    base = campaign()
    mountings = dict(base.mountings) | {"flat": replace(base.mountings["flat"], uncertainty=0.0)}
    found = names(replace(base, mountings=mountings))
    assert not any("[flat]" in name for name in found)
    assert "mounting_error.x[pyramid]" in found


def test_a_prior_in_the_model_comes_first():
    found = names(stated(rate_uncertainty=0.0), table_rate_error={"rate_error": "normal(0, 5 ppm)"})
    assert "table_rate_error.rate_error[rate]" in found


def test_nothing_left_is_said():
    effects = (EffectSpec("table_rate_error"), EffectSpec("white_noise"))
    with pytest.raises(InputError, match="no parameter to fit"):
        bind(ModelSpec("m", effects), stated(rate_uncertainty=0.0))
