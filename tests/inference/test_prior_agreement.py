"""Prior–data conflict against the two distributions that it compares."""

import numpy as np
import pytest

from imubayes.display.fit_cautions import conflict_line, conflict_sheet
from imubayes.inference.plausibility import prior_conflicts
from small_campaign import full_model

NAME = "gyro_scale_factor.scale[gx]"  # prior 0 ± 2000 ppm


def judged(alone: float, sd: float):
    """Return the conflicts of a model of which the data say that one parameter is `alone` ± `sd`, in prior sd."""
    model = full_model()
    place, size = model.layout.index(NAME), len(model.layout)
    precision, z = np.eye(size), np.zeros(size)
    precision[place, place] += sd**-2
    z[place] = alone * sd**-2 / precision[place, place]
    return prior_conflicts(model, z, precision)


@pytest.mark.parametrize("sd", [0.01, 1.0, 50.0])
def test_the_distance_is_that_of_prior_and_likelihood(sd):
    beyond = 5 * np.hypot(1, sd)
    (found,) = judged(beyond, sd)
    assert found.name == NAME
    assert found.distance == pytest.approx(5, rel=1e-6)
    assert found.data_value == pytest.approx(2000 * beyond, rel=1e-5)
    assert found.data_sd == pytest.approx(2000 * sd, rel=1e-5)
    assert found.decided_by == ("data" if sd < 1 else "prior")
    assert judged(2.9 * np.hypot(1, sd), sd) == ()


def test_a_prior_that_pins_is_named_with_the_line_to_change():
    (found,) = judged(-250.0, 50.0)
    assert abs(found.value) < found.prior_sd  # the estimate itself looks like any other
    assert found.wider == "normal(0, 500000 ppm)"
    line = conflict_line(found)
    assert "The prior decides gyro_scale_factor.scale[gx]" in line
    assert 'model file: [[effect]] name = "gyro_scale_factor", prior = { scale = "normal(0, 500000 ppm)" }' in line
    sheet = conflict_sheet((found,))
    assert len(sheet.rows) == 1
    assert "[[effect]]" in sheet.note


def test_a_statement_of_the_campaign_is_changed_there():
    model = full_model()
    place = model.layout.index("mounting_error.x[flat]")
    z, precision = np.zeros(len(model.layout)), np.eye(len(model.layout))
    precision[place, place], z[place] = 1e4, 8.0
    (found,) = prior_conflicts(model, z, precision)
    assert (found.stated_in, found.decided_by) == ("campaign", "data")
    assert "state a larger uncertainty of 'flat' in campaign.toml" in conflict_line(found)


def test_the_echo_of_another_parameter_is_no_conflict():
    # The mode is off by a thousandth of the prior, on data of a width of 2800 times that of the prior.
    assert judged(5 * 2800.0, 2800.0) == ()
    assert judged(5 * 200.0, 200.0)  # planted fault: what the data do know is named


def test_no_conflict_without_data():
    model = full_model()
    z = np.full(len(model.layout), 1e-3)
    assert prior_conflicts(model, z, np.eye(len(model.layout))) == ()
