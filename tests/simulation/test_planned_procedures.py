"""Every procedure can be planned: what is simulated is read again, and its classical estimates find the truth."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from imubayes.campaign import load_campaign
from imubayes.procedures import PROCEDURES, classical
from imubayes.procedures.textbook import Estimate
from imubayes.simulation.simulate import simulate_plan
from imubayes.simulation.test_plan import read_plan

PLANS = Path(__file__).parents[2] / "data" / "plans"


def simulated(name, folder):
    """Return the campaign, its classical estimates by name, and the truth."""
    out = simulate_plan(PLANS / f"{name}-example.toml", folder / "out")
    campaign = load_campaign(out)
    truth = tomllib.loads((out / "truth.toml").read_text())["parameters"]
    return campaign, {one.name: one for one in classical(campaign) if isinstance(one, Estimate)}, truth


def test_every_procedure_has_a_plan():
    planned = {name for name, procedure in PROCEDURES.items() if procedure.plan is not None}
    assert set(PROCEDURES) - planned == {"free_rotation", "slow_motion"}  # a hand follows no plan
    shipped = {run.procedure for plan in PLANS.glob("*.toml") for run in read_plan(plan).file.run}
    assert shipped == planned


@pytest.fixture(scope="module")
def channel(tmp_path_factory):
    return simulated("accel-channel", tmp_path_factory.mktemp("channel"))


@pytest.mark.parametrize(("run", "input_g"), [("ramp-1g", 1.0), ("ramp-pyramid", 3**-0.5), ("inject-12g", 12.0)])
def test_ramps_of_an_accelerometer_channel(channel, run, input_g):
    """The output per degree is that of the offset and, in proportion to the input, of the gain."""
    _, found, truth = channel
    gain, offset = (truth[f"converter_{name}_drift.slope[ax]"] for name in ("gain", "offset"))
    slope = found[f"slope[ax,{run}]"]
    assert slope.value == pytest.approx(gain * 1e-6 * 20000 * input_g + offset, abs=4 * slope.sd)


@pytest.mark.parametrize("name", ["polar-tumble", pytest.param("geographic-tumble", marks=pytest.mark.slow)])
def test_tumbles_of_a_gyro(name, tmp_path):
    """Seats of half an arc minute and offsets of runs are in them: a hundredth of a degree per hour."""
    _, found, truth = simulated(name, tmp_path)
    for parameter in ("d_i", "d_o", "d_s"):
        one = found[f"gyro_g_sensitivity.{parameter}[g]"]
        assert one.value == pytest.approx(truth[one.name], abs=0.05)


@pytest.mark.slow
def test_a_servo_table(tmp_path):
    campaign, found, truth = simulated("servo-table", tmp_path)
    assert campaign.channels[-1].kind == "angle"
    assert np.ptp(campaign.runs[0].covariates["table_angle"]) > 2 * np.pi
    slope = found["gyro_bias_drift.slope[g]"]
    assert slope.value == pytest.approx(truth[slope.name], abs=5 * slope.sd + 1e-3)


@pytest.mark.slow
def test_a_rotation(tmp_path):
    campaign, found, truth = simulated("rotation-modulation", tmp_path)
    assert len(campaign.runs) == 3
    for axis in "xyz":
        one = found[f"gyro_bias.bias[g{axis}]"]
        assert one.value == pytest.approx(truth[one.name], abs=3.0)


def test_a_reference_gyro(tmp_path):
    _, found, truth = simulated("reference-gyro", tmp_path)
    for axis in "xyz":
        scale = (found[f"scale_factor[g{axis}]"].value / 1000 - 1) * 1e6
        own = truth[f"gyro_scale_factor.scale[g{axis}]"] - truth[f"reference_scale_factor.{axis}[all]"]
        assert scale == pytest.approx(own, abs=40.0)


def test_a_free_tumble(tmp_path):
    """The raw log of a unit turned by hand: all poses are found, and gravity in each is 1 g but for the errors."""
    campaign, _, _ = simulated("desk-imu", tmp_path)
    tumble = campaign.runs[0].tumble
    assert tumble is not None
    assert len(tumble.flagged) == 28
    # A rest that is found too long contains the slow start of a move, and is flagged as disturbed.
    assert tumble.flagged.sum() <= 3
    steps = np.linalg.norm(tumble.attitude[1:] - tumble.attitude[:-1], axis=(1, 2))
    assert (steps > 0.5).all()
