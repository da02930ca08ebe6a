"""Free tumble: a unit moved by hand through static poses, with no table at all.

`static` finds the rests, `magnitude` judges them by |f| = g, `motion` condenses what lies between them, and
`reduce` puts the run together.
"""

from imubayes.campaign.tumble.recording import pose_means, record
from imubayes.campaign.tumble.reduce import ReducedTumble, detect_poses, reduce_tumble
from imubayes.campaign.tumble.static import Pose, Rest

__all__ = ["Pose", "ReducedTumble", "Rest", "detect_poses", "pose_means", "record", "reduce_tumble"]
