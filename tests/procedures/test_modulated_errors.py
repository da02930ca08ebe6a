"""Errors that a rotating unit does not average out, from outputs made here: biases, and scale and axes times the rate.

Plain NumPy: vertical axis; table axes at angle 0 are East, North, Up; the unit turns with the table by φ about z.
"""

import numpy as np
import polars as pl
import pytest

from imubayes.foundations.campaign_data import Campaign, Channel, Mounting, Run, Site, Table
from imubayes.procedures import classical
from imubayes.procedures.textbook import Estimate
from imubayes.results.result import Residuals
from imubayes.results.summary import Summary
from imubayes_qualification.onboard.carrier_motion import carrier
from imubayes_qualification.onboard.corrected_outputs import corrected_run, estimate_carrier

LATITUDE, GRAVITY, DEGREE = np.radians(34.25), 9.797, np.pi / 180
HOUR = DEGREE / 3600
EARTH = 15.041067 * HOUR * np.array([0.0, np.cos(LATITUDE), np.sin(LATITUDE)])
PYRAMID = np.array(
    [[np.sqrt(2 / 3) * np.cos(a), np.sqrt(2 / 3) * np.sin(a), np.sqrt(1 / 3)] for a in np.arange(3) * 2 * np.pi / 3]
).T
BIAS = np.array([0.9, -0.4, 0.5]) * HOUR
SCALE = np.array([150e-6, -90e-6, 210e-6])
LEAN = np.array([[0, 40, -60], [25, 0, 70], [-30, 10, 0]]) / 206264.8


def felt(rate, angle, span):
    """Rate in body axes, mean over arcs: the rotation of the table and the Earth's."""
    short = np.sinc(span / (2 * np.pi))
    c, s = short * np.cos(angle), short * np.sin(angle)
    turned = np.stack([c * EARTH[0] + s * EARTH[1], c * EARTH[1] - s * EARTH[0], EARTH[2] + rate], axis=1)
    return turned @ PYRAMID


def run_of(rate_deg_s, turns, seed=0, noise=0.0):
    count = round(abs(turns) * 24)
    rate = np.full(count, np.sign(turns) * rate_deg_s * DEGREE)
    span = np.full(count, np.sign(turns) * 15 * DEGREE)
    angle = np.cumsum(span) - span / 2
    ideal = felt(rate, angle, span)
    real = ideal @ ((1 + SCALE)[:, None] * (np.eye(3) + LEAN)).T + BIAS
    real = real + noise * HOUR * np.random.default_rng(seed).normal(size=real.shape)
    columns = {"time": np.arange(count) * 2.5, "table_rate": rate, "table_angle": angle, "table_angle_span": span}
    shape = np.full((count, 3), np.nan)
    return Run("turned", "rotation_modulation", "t", "p", columns, real * 1000, np.full(count, 100), shape), ideal


def campaign(*runs):
    axes = [np.eye(3)[[k, (k + 1) % 3, (k + 2) % 3]] for k in range(3)]
    channels = tuple(Channel(f"g{n}", "gyro", axes[k], "V", 1000.0, "rad/s", 1000.0) for k, n in enumerate("xyz"))
    site = Site(LATITUDE, 0.0, GRAVITY)
    return Campaign("m", site, channels, {"t": Table("t", 0.0, np.pi / 2)}, {"p": Mounting("p", PYRAMID)}, tuple(runs))


@pytest.mark.parametrize(("rate", "turns"), [(6.0, 2.5), (6.0, -2.5), (10.0, 1.75)])
def test_left_in_plane_is_what_is_left_in_the_plane(rate, turns):
    """The mean of the demodulated rate less the Earth's, bias and scale and axes times the rate included."""
    run, _ = run_of(rate, turns)
    made = campaign(run)
    found = {one.name: one for one in classical(made) if isinstance(one, Estimate)}
    mean = carrier(made, run).rate.mean(axis=0) - EARTH
    left = found["left_in_plane[gyro]"].value * HOUR
    # The mean over arcs of 15° shortens by 0.3 %, which the columns of the carrier undo.
    assert left == pytest.approx(np.hypot(mean[0], mean[1]), rel=4e-3)
    assert found["left_along_axis[gyro]"].value * HOUR == pytest.approx(abs(mean[2]), rel=1e-4)
    # Fault planted: the biases alone are far from it.
    alone = np.hypot(*(PYRAMID @ BIAS)[:2]) * abs(np.sinc(abs(turns)))
    assert abs(alone - left) > 0.3 * left


def test_uncertainty_of_what_is_left():
    scores = []
    names = ("left_in_plane[gyro]", "left_along_axis[gyro]")
    exact = {one.name: one.value for one in classical(campaign(run_of(6.0, 2.5)[0])) if isinstance(one, Estimate)}
    for seed in range(60):
        found = [one for one in classical(campaign(run_of(6.0, 2.5, seed, noise=0.5)[0])) if isinstance(one, Estimate)]
        scores += [(one.value - exact[one.name]) / one.sd for one in found if one.name in names]
    assert 0.8 < np.sqrt(np.mean(np.square(scores))) < 1.2


@pytest.mark.parametrize("turns", [4, -4, 2.5])
def test_a_fit_takes_scale_and_axes_out_as_well_as_bias(turns):
    """Predicted outputs as a fit gives them, off by a calibration error; Earth rate within its uncertainty."""
    scores = []
    for seed in range(40):
        run, ideal = run_of(6.0, turns, seed, noise=0.3)
        generator = np.random.default_rng(500 + seed)
        predicted = 1000 * (
            ideal @ ((1 + SCALE)[:, None] * (np.eye(3) + LEAN)).T + BIAS + 0.2 * HOUR * generator.normal(size=3)
        )
        lines = [
            {"run": "turned", "row": r, "channel": f"g{n}", "predicted": predicted[r, k], "model_sd": 1000 * 0.2 * HOUR}
            for r in range(run.rows)
            for k, n in enumerate("xyz")
        ]
        made = campaign(run)
        corrected = corrected_run(made, run, Residuals(pl.DataFrame(lines)), Summary.model_construct(parameters=()))
        found = estimate_carrier(made, run, corrected)
        scores.append((found.mean["gyro"] - EARTH) / found.mean_sd["gyro"])
        raw = estimate_carrier(made, run).mean["gyro"]
        assert abs(raw[2] - EARTH[2]) > 1.0 * HOUR, "without the fit scale times rate stands in it"
        assert abs(found.mean["gyro"][2] - EARTH[2]) < 1.0 * HOUR
    assert 0.8 < np.sqrt(np.mean(np.square(scores))) < 1.2
    row = (found.motion.rate - EARTH) / found.row_sd["gyro"]
    assert 0.6 < np.sqrt(np.mean(np.square(row))) < 1.5
