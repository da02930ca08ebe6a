"""A public recording of a unit turned by hand, as slow motion: its estimates against those that were published.

The recording has rests, which slow motion does not use as such: all windows are weak poses.
"""

from pathlib import Path

import numpy as np
import pytest

import imubayes
from imubayes.inference.laplace_marginal import inverse_of_precision
from imubayes.inference.linear_information import linear_information
from imubayes.model.model_file import ModelSpec
from imubayes_recordings.convert import convert
from imubayes_recordings.convert.proposed_effects import propose_effects

LOG = Path(__file__).parents[3] / "shared" / "data" / "mpu9150" / "imu0.log"
NAMES = ("ax", "ay", "az", "gx", "gy", "gz")
PUBLISHED = {"accel_scale_factor": (0.363, 0.315, 0.647), "gyro_scale_factor": (0.041, 0.457, 0.826)}  # %
ROUNDED = 5e-6
"""Of published values, which have three decimals of a per cent."""


def estimates(folder: Path, values: np.ndarray) -> dict[str, np.ndarray]:
    """Return effect → deviation from the published value over its standard uncertainty, by the linear model."""
    log = np.column_stack([np.arange(len(values)) / 100.0, values])
    np.savetxt(folder / "log.csv", log, fmt="%.7g", delimiter=",", header=",".join(["time_s", *NAMES]), comments="")
    campaign = imubayes.load_campaign(
        convert([folder / "log.csv"], folder / "c", procedure="slow_motion", gravity_m_s2=9.81)
    )
    proposal = propose_effects(campaign)
    model = imubayes.bind(ModelSpec("motion", tuple(each.spec for each in proposal.effects)), campaign)
    known = linear_information(model)
    value = np.asarray(model.problem.priors.values(inverse_of_precision(known.precision) @ known.pull))
    sd = {(each.effect, each.channel): each.sd for each in proposal.expected}
    return {
        effect: np.array([
            (value[model.layout.index(f"{effect}.scale[{effect[0]}{axis}]")] - 0.01 * percent)
            / np.hypot(sd[effect, f"{effect[0]}{axis}"], ROUNDED)
            for axis, percent in zip("xyz", published, strict=True)
        ])
        for effect, published in PUBLISHED.items()
    }  # fmt: skip


@pytest.mark.slow
@pytest.mark.skipif(not LOG.exists(), reason="the public recording of two MPU-9150 is not there")
def test_slow_motion_gives_the_published_scale_factors(tmp_path) -> None:
    values = np.loadtxt(LOG)
    found = estimates(tmp_path, values)
    assert all(np.abs(pulls).max() < 3.0 for pulls in found.values()), found
    planted = tmp_path / "planted"
    planted.mkdir()
    wrong = estimates(planted, values * np.repeat([1.02, 1.02], 3))
    assert all(np.abs(pulls).min() > 3.0 for pulls in wrong.values()), wrong
