"""An effect of one coefficient that is the larger part of the cause, and as significant at few degrees of freedom."""

from pathlib import Path

import hidden
import numpy as np
import pytest
from null_data import refitted

from imubayes.campaign import load_campaign
from imubayes.criticism import effect_selection
from imubayes.criticism.diagnose import judge
from imubayes.model.bind import bind
from imubayes.model.model_file import read_model


@pytest.mark.parametrize("alone", [True, False])
def test_what_is_selected_again_beside_its_larger_part_is_the_cause(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, alone: bool
) -> None:
    """Three series of positions, whose generator shares no code with the package, of a gyro with drift quadratic in g.

    Planted fault: without a look at the quadratic drift alone, the residual is called unexplained structure.
    """
    drawn = hidden.random_campaign(tmp_path / "campaign", 300007, "hidden", "geographic_tumble")
    assert drawn.planted[0].effect == "gyro_g2_sensitivity"
    if not alone:
        monkeypatch.setattr(effect_selection, "_by_another_name", lambda at, forward, *_: forward)
    model = bind(read_model(drawn.model), load_campaign(drawn.folder))
    found = judge(refitted(model, *(np.zeros(size) for size in model.problem.size)))
    assert (found.verdict == "unexplained_structure") != alone
    assert (len(found.groups) == 1) == alone
    if alone:
        assert found.groups[0].effects[0] == "gyro_g2_sensitivity"
