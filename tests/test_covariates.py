"""The registry of covariates and conditions: what effects need has words, and an angle is known by its entry."""

import numpy as np
import pytest

from imubayes.covariates import CONDITIONS, COVARIATES, remedy
from imubayes.criticism import free_form_dependence
from imubayes.model.effect_registry import Registry
from imubayes.responses.residual_covariates import ResidualCovariate

# Axes of labels that every campaign has, and kinds of channels that only noise acts on.
ALWAYS_THERE = {"channel", "run", "angle", "closure"}


@pytest.mark.parametrize("member", Registry().effects.values(), ids=lambda member: member.name)
def test_what_an_effect_needs_has_words(member):
    for need in {*member.needs, *member.per, *getattr(member, "kinds", ())} - ALWAYS_THERE:
        assert need in COVARIATES or need in CONDITIONS
        assert remedy(need)


def test_a_name_is_a_covariate_or_a_condition():
    assert not COVARIATES.keys() & CONDITIONS.keys()


@pytest.mark.parametrize(("periodic", "form"), [(True, "harmonics"), (False, "spline")])
def test_an_angle_of_any_name_is_tested_by_harmonics(periodic, form):
    values = np.random.default_rng(0).uniform(0.0, 700.0, 100)
    heading = ResidualCovariate("heading_deg", "deg", values, "heading", periodic)
    test, basis = free_form_dependence._form(heading, np.ones(100, dtype=bool))
    assert test.startswith(form)
    if periodic:
        angle = np.radians(heading.values)
        assert np.allclose(basis[:, :2], np.stack([np.sin(angle), np.cos(angle)], axis=1))
