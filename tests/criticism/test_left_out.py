"""What is left out of a fit at a time, to see whether the rest predicts it."""

import numpy as np

from imubayes.criticism.cross_validation import groups
from imubayes.model.bind import bind
from small_campaign import spec, tumble_campaign, wide_campaign


def test_runs_are_left_out_in_turns():
    by, names, masks = groups(bind(spec("gyro_bias"), wide_campaign()))
    assert by == "run"
    assert names == tuple(run.name for run in wide_campaign().runs)
    assert np.all(np.sum(masks, axis=0) == 1)


def test_a_tumble_is_left_out_pose_by_pose_and_keeps_its_rotations():
    model = bind(spec("gyro_bias"), tumble_campaign())
    by, _, masks = groups(model)
    assert by == "pose"
    assert np.all(np.sum(masks, axis=0) == ~model.entries.closing)


def test_one_run_alone_is_left_out_in_blocks_of_its_time():
    model = bind(spec("gyro_bias"), wide_campaign().only("cycle-slow"))
    by, names, masks = groups(model)
    assert by == "block"
    assert names == ("rows 1 to 4", "rows 5 to 8", "rows 9 to 12", "rows 13 to 16")
    assert np.all(np.sum(masks, axis=0) == 1)
    assert set(model.entries.row[masks[1]]) == {4, 5, 6, 7}
