"""Of equivalents, the effect that is in the unit is in the model with which the loop ends, whichever of them leads."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
from followed_loops import follow

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("seed", "procedure", "planted"),
    [(350003, "rate_table", "gyro_dead_zone"), (350005, "polar_tumble", "gyro_g_sensitivity")],
)
def test_the_planted_effect_is_in_the_model(seed, procedure, planted):
    line = follow(seed, procedure)
    assert line["planted"] == planted
    assert planted in line["suggested"]["added"][0]
    assert line["suggested"]["verdicts"][-1] == "adequate"
    assert line["suggested"]["largest"] < 5
    # Planted fault: the leader alone is added, and the model is adequate without the cause.
    assert not any(planted in effects for effects in line["alone"]["added"])
    assert line["alone"]["verdicts"][-1] == "adequate"
