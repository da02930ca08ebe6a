"""The registry of covariates and conditions: what effects need has words, and an angle is known by its entry."""

import pytest

from imubayes.foundations.covariates import CONDITIONS, COVARIATES, regressors, remedy
from imubayes.model.effect_registry import Registry

# Axes of labels that every campaign has, and kinds of channels that only noise acts on.
ALWAYS_THERE = {"channel", "run", "angle", "closure"}


@pytest.mark.parametrize("member", Registry().effects.values(), ids=lambda member: member.name)
def test_what_an_effect_needs_has_words(member):
    for need in {*member.needs, *member.per, *getattr(member, "kinds", ())} - ALWAYS_THERE:
        assert need in COVARIATES or need in CONDITIONS
        assert remedy(need)


def test_a_name_is_a_covariate_or_a_condition():
    assert not COVARIATES.keys() & CONDITIONS.keys()


def test_temperatures_and_times_act_by_their_change():
    """Their zeros are conventions; those of rates, forces and currents are not."""
    assert {each.name for each in regressors() if each.relative} == {
        "time", "campaign_time", "power_on", "temperature", "converter_temperature",
    }  # fmt: skip
    assert not any(each.relative for each in COVARIATES.values() if each.name.endswith("_rate"))
