"""Free tumble: a unit moved by hand through static poses, without a table.

`static_detection` finds the rests, `magnitude_calibration` checks them by |f| = g, `pose_transitions` condenses the
motion between them, and `tumble_reduction` builds the rows of the run.
"""

from imubayes.campaign.free_tumble.calibrated_recording import pose_means, record
from imubayes.campaign.free_tumble.static_detection import Pose, Rest
from imubayes.campaign.free_tumble.tumble_reduction import ReducedTumble, detect_poses, reduce_tumble

__all__ = ["Pose", "ReducedTumble", "Rest", "detect_poses", "pose_means", "record", "reduce_tumble"]
