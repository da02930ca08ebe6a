"""A result whose model lacks an effect, and the one with it: for the tests of additions and of removals."""

import pytest
from loop_results import CAMPAIGN, LACKING, lacking_model

from imubayes.api import ModelChange, Result, add, fit


@pytest.fixture(scope="session")
def lacking(tmp_path_factory) -> tuple[Result, ModelChange]:
    """The results `first` and `second` of one folder."""
    place = tmp_path_factory.mktemp("loop")
    first = fit(CAMPAIGN, lacking_model(), place / "first", sample=False)
    return first, add(place / "first", [LACKING], place / "second")
