"""Free tumble: a unit moved by hand through static poses, with no table at all.

`static` finds the rests, `magnitude` judges them by |f| = g, `motion` condenses what lies between them, and
`reduce` puts the run together.
"""

from imubayes.campaign.free_tumble.body_vectors import pose_means, record
from imubayes.campaign.free_tumble.static_detection import Pose, Rest
from imubayes.campaign.free_tumble.tumble_reduction import ReducedTumble, detect_poses, reduce_tumble

__all__ = ["Pose", "ReducedTumble", "Rest", "detect_poses", "pose_means", "record", "reduce_tumble"]
