"""The motion of the carrier from a real fit: Earth rate and gravity along and across the axis, within uncertainty.

Readings are made by `data/generators`, which shares no code with the package; the carrier is at rest.
"""

from pathlib import Path

import numpy as np
import pytest
import rotation_modulation
from simulate import write_simulated

import imubayes.api
from imubayes.campaign import load_campaign
from imubayes_qualification.onboard.corrected_outputs import KINDS, corrected_run, estimate_carrier

ROOT = Path(__file__).parents[2]
MODEL = ROOT / "models" / "rotation-modulation.toml"
HOUR = np.pi / 180 / 3600
EARTH_RATE = 15.041067 * HOUR


def scores(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return the deviations of the mean motion from that of the Earth in sd, and raw ones along the axis in °/h."""
    campaign = load_campaign(folder)
    result = imubayes.api.fit(folder, MODEL, sample=False)
    latitude = campaign.site.latitude
    at_rest = {
        "gyro": EARTH_RATE * np.array([np.cos(latitude), np.sin(latitude)]),
        "accelerometer": np.array([0.0, campaign.site.gravity]),
    }
    found, raw = [], []
    for run in campaign.runs:
        corrected = corrected_run(campaign, run, result.residuals, result.summary)
        estimate = estimate_carrier(campaign, run, corrected)
        for kind in KINDS:
            # North across the axis is along a direction of the table that no run states: the length is compared.
            across, along = np.hypot(*estimate.mean[kind][:2]), estimate.mean[kind][2]
            sd = estimate.mean_sd[kind]
            across_sd = float(np.hypot(*sd[:2]))
            if kind == "gyro":
                found.append((across - at_rest[kind][0]) / across_sd)
            found.append((along - at_rest[kind][1]) / sd[2])
        raw.append((estimate_carrier(campaign, run).mean["gyro"][2] - at_rest["gyro"][1]) / HOUR)
    return np.array(found), np.array(raw)


@pytest.mark.slow
def test_of_the_shipped_runs():
    found, raw = scores(ROOT / "data" / "rotation-modulation")
    assert np.abs(found).max() < 4
    # Without the fit scale factor and axis errors times the rate stand in it.
    assert np.abs(raw).max() > 1.0


@pytest.mark.slow
def test_uncertainty_over_units(tmp_path):
    of_all = []
    for seed in range(300, 312):
        folder = tmp_path / str(seed)
        folder.mkdir()
        write_simulated(folder, rotation_modulation.plan(seed, model=MODEL), seed)
        of_all.append(scores(folder)[0])
        print(seed, np.round(of_all[-1], 1), flush=True)
    rms = float(np.sqrt(np.mean(np.square(of_all))))
    print(f"rms score {rms:.2f}, largest {np.abs(of_all).max():.1f}")
    # The runs are part of the fit, which takes the carrier to be at rest: deviations are smaller than uncertainties.
    assert rms < 1.1
    assert np.abs(of_all).max() < 4.5
