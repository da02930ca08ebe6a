"""The textbook of every further procedure: right if its assumptions hold, off by what theory says if not.

Campaigns come from the independent simulator.
"""

from dataclasses import replace
from pathlib import Path

import geographic_tumble
import numpy as np
import pytest
import reference_gyro
import rotation_modulation
import servo_table
from simulate import write_simulated

from imubayes.campaign import load_campaign
from imubayes.procedures import classical
from imubayes.procedures.rotation_modulation import left_after
from imubayes.procedures.textbook import Estimate, Undetermined
from imubayes_qualification.onboard.carrier_motion import carrier

ROOT = Path(__file__).parents[2]
EARTH = 15.041067  # deg/h
STILL = ("mounting_error", "table_axis_tilt", "table_rate_error", "station_", "run_scatter", "time_skew", "reference_")


def model_of(name):
    return ROOT / "models" / f"{name}.toml"


def loaded(folder):
    return load_campaign(folder)


def ideal(drawn, keep=()):
    """True values with everything at nothing that the textbook takes as exact."""
    still = [name for name in STILL if name not in keep]
    quiet = {name: 0.0 if name.startswith(tuple(still)) else value for name, value in drawn.items()}
    return quiet | {name: 1e-12 for name in quiet if name.startswith("reference_noise")}


def directed(plan, seed):
    """True values of a geographic test whose station and scale factor are exact."""
    return ideal(plan.draw(seed)) | {"gyro_scale_factor.scale[g]": 0.0}


def made(folder, plan, seed, values):
    folder.mkdir(exist_ok=True, parents=True)
    write_simulated(folder, plan, seed, values=values)
    return loaded(folder)


def estimates(campaign, start=""):
    return [one for one in classical(campaign) if isinstance(one, Estimate) and one.name.startswith(start)]


def spread(scores):
    scores = np.array(scores)
    assert len(scores) >= 40
    assert 0.8 < np.sqrt(np.mean(scores**2)) < 1.2
    return scores


# directions


@pytest.mark.slow
def test_geographic_positions_over_replicates(tmp_path):
    scores = []
    for seed in range(12):
        plan = geographic_tumble.plan(seed, model=model_of("geographic-tumble"))
        truth = directed(plan, seed)
        campaign = made(tmp_path / str(seed), plan, seed, truth)
        scores += [(one.value - truth[one.name]) / one.sd for one in estimates(campaign, "gyro_g_sensitivity")]
        for letter in "ios":
            (one,) = estimates(campaign, f"D_F+D_{letter.upper() * 2}")
            whole = truth["gyro_bias.bias[g]"] + truth[f"gyro_g2_sensitivity.d_{letter * 2}[g]"]
            scores.append((one.value - whole) / one.sd)
    spread(scores)


def test_the_earth_left_out_is_what_the_drift_is_off_by(tmp_path):
    """With the Earth's rate ignored D_I is off by Ω sin L: up and down differ by twice that."""
    plan = geographic_tumble.plan(1, model=model_of("geographic-tumble"))
    truth = directed(plan, 1)
    campaign = made(tmp_path / "there", plan, 1, truth)
    at_equator_axis = replace(campaign, site=replace(campaign.site, latitude=0.0))
    right = estimates(campaign, "gyro_g_sensitivity.d_i")[0].value
    wrong = estimates(at_equator_axis, "gyro_g_sensitivity.d_i")[0].value
    assert wrong - right == pytest.approx(EARTH * np.sin(campaign.site.latitude), rel=1e-6)


def test_positions_that_are_missing_are_said(tmp_path):
    positions = [one for one in geographic_tumble.POSITIONS if "D" not in one]
    plan = geographic_tumble.plan(1, positions, model=model_of("geographic-tumble"))
    campaign = made(tmp_path / "few", plan, 1, directed(plan, 1))
    said = [one.sentence for one in classical(campaign) if isinstance(one, Undetermined)]
    assert any("D_I needs positions" in one for one in said)
    assert not estimates(campaign, "gyro_g_sensitivity.d_i")


# rotation


@pytest.mark.slow
def test_modulated_bias_over_replicates(tmp_path):
    scores = []
    for seed in range(8):
        plan = rotation_modulation.plan(seed, model=model_of("rotation-modulation"))
        quiet = ("gyro_misalignment", "gyro_scale", "accel_misalignment", "accel_scale")
        truth = {k: 0.0 if k.startswith(quiet) else v for k, v in ideal(plan.draw(seed)).items()}
        campaign = made(tmp_path / str(seed), plan, seed, truth)
        found = estimates(campaign, "gyro_bias") + estimates(campaign, "accel_bias")
        scores += [(one.value - truth[one.name]) / one.sd for one in found]
    spread(scores)


@pytest.mark.slow
def test_a_fixture_that_errs_passes_for_accelerometer_bias(tmp_path):
    """3 arcmin at the pyramid: g sin θ dθ, and the gyros' biases, from both ways, hardly notice."""
    plan = rotation_modulation.plan(3, model=model_of("rotation-modulation"))
    truth = ideal(plan.draw(3))
    truth |= {name: 0.0 for name in truth if name.startswith(("accel_m", "accel_s", "gyro_m", "gyro_s"))}
    tilted = truth | {"mounting_error.x[pyramid]": 180.0}
    campaign = made(tmp_path / "tilted", plan, 3, tilted)
    seat = np.array(campaign.mountings["pyramid"].body_to_table)
    # The seat turns the body about x: the axis of the table moves in the body by −x × z.
    moved = np.cross(seat[2], [180.0 / 206264.806, 0.0, 0.0])
    for place, axis in enumerate("xyz"):
        (one,) = estimates(campaign, f"accel_bias.bias[a{axis}]")
        assert one.value - truth[one.name] == pytest.approx(1e6 * moved[place], abs=1.0)
        (gyro,) = estimates(campaign, f"gyro_bias.bias[g{axis}]")
        assert gyro.value == pytest.approx(truth[gyro.name], abs=0.1)


@pytest.mark.slow
def test_what_is_left_of_an_unfinished_turn(tmp_path):
    """After 2½ turns 2/Φ of the turning part is left, after whole turns nothing; along the axis all of it."""
    plan = rotation_modulation.plan(3, model=model_of("rotation-modulation"))
    campaign = made(tmp_path / "turns", plan, 3, ideal(plan.draw(3)))
    left = {(one.name, one.run): one.value for one in estimates(campaign, "left")}
    unfinished = left["left_in_plane[gyro]", "pyramid-unfinished"]
    assert left["left_in_plane_whole[gyro]", "pyramid-unfinished"] == 0.0
    assert left["left_in_plane[gyro]", "pyramid-forward"] == 0.0
    run = next(run for run in campaign.runs if run.name == "pyramid-unfinished")
    earth = EARTH / 3600 * np.array([0.0, np.cos(campaign.site.latitude), np.sin(campaign.site.latitude)])
    mean = (np.degrees(carrier(campaign, run).rate).mean(axis=0) - earth) * 3600
    # Noise of the mean and the 0.3 % by which an arc of 15° shortens a rotating vector.
    assert unfinished == pytest.approx(np.hypot(mean[0], mean[1]), abs=0.4)
    assert left["left_along_axis[gyro]", "pyramid-unfinished"] == pytest.approx(abs(mean[2]), rel=1e-3)
    assert left_after(3 * np.pi) == pytest.approx(2 / (3 * np.pi))


def test_the_carrier_stands_still(tmp_path):
    """A perfect unit on a table at rest sees the Earth and gravity in the axes of the table, whatever it turns by."""
    plan = rotation_modulation.plan(3, model=model_of("rotation-modulation"))
    # No noise at all would be the same data in several runs.
    truth = dict.fromkeys(plan.draw(3), 0.0) | {f"white_noise.sigma[{c.name}]": 1e-3 for c in plan.channels}
    campaign = made(tmp_path / "still", plan, 3, truth)
    latitude = campaign.site.latitude
    for run in campaign.runs:
        motion = carrier(campaign, run)
        earth = np.degrees(motion.rate) * 3600
        assert earth == pytest.approx(
            np.tile([0, EARTH * np.cos(latitude), EARTH * np.sin(latitude)], (run.rows, 1)), abs=2e-3
        )
        assert motion.force == pytest.approx(np.tile([0, 0, campaign.site.gravity], (run.rows, 1)), abs=1e-4)


# matched speeds


@pytest.mark.slow
def test_matched_speeds_over_replicates(tmp_path):
    scores = []
    for seed in range(10):
        plan = reference_gyro.plan(seed, model=model_of("reference-gyro"))
        truth = ideal(plan.draw(seed)) | {f"gyro_misalignment.toward_{k}[g{a}]": 0.0 for k in "os" for a in "xyz"}
        campaign = made(tmp_path / str(seed), plan, seed, truth)
        scale = {
            f"scale_factor[g{axis}]": 1000 * (1 + 1e-6 * truth[f"gyro_scale_factor.scale[g{axis}]"]) for axis in "xyz"
        }
        for one in estimates(campaign):
            # From few instants the scatter says little of itself: Student's t, brought to a normal score.
            count = int(one.method.split(": ")[1].split()[0]) if ": " in one.method else 0
            true = (scale | truth).get(one.name)
            if true is not None and count >= 5:
                scores.append((one.value - true) / one.sd / np.sqrt((count - 1) / (count - 3)))
    spread(scores)


def test_an_error_of_the_reference_goes_straight_into_the_scale(tmp_path):
    plan = reference_gyro.plan(2, model=model_of("reference-gyro"))
    truth = ideal(plan.draw(2))
    scale = [
        estimates(made(tmp_path / name, plan, 2, truth | more), "scale_factor[gx]")[0].value
        for name, more in (("true", {}), ("scaled", {"reference_scale_factor.x[all]": 100.0}))
    ]
    assert (scale[1] / scale[0] - 1) * 1e6 == pytest.approx(-100.0, abs=0.1)


def test_a_late_clock_scatters_matched_speeds(tmp_path):
    """If speeds cross they change in opposite senses: what a delay makes of one does not cancel in the other."""
    plan = reference_gyro.plan(2, model=model_of("reference-gyro"))
    truth = ideal(plan.draw(2))
    true, late = (
        estimates(made(tmp_path / name, plan, 2, truth | more), "scale_factor[gx]")[0]
        for name, more in (("true", {}), ("late", {"time_skew.skew[ordinary]": 200.0}))
    )
    assert late.sd > 3 * true.sd


# servo table


def servo(folder, seed, hours, **more):
    values = servo_table.values_of(seed, model_of("servo-table"))
    values |= {name: 0.0 for name in values if name.startswith(("mounting_error", "table_axis_tilt"))} | more
    servo_table.write_records(folder, servo_table.plan(seed, hours, model_of("servo-table")), seed, hours, values)
    return loaded(folder), values


@pytest.mark.slow
def test_the_servo_table_over_replicates(tmp_path):
    """Blocks of an angle with white noise are not independent: errors alternate, and the textbook's sd is safe."""
    for seed in range(4):
        campaign, truth = servo(tmp_path / str(seed), seed, {"day": 26.0})
        inclined = np.sin(campaign.site.latitude)
        found = {one.name: one for one in estimates(campaign)}
        g2 = {name: truth[f"gyro_g2_sensitivity.d_{name}[g]"] for name in ("io", "si", "os", "oo", "ss")}
        wanted = {
            "D_O+D_IO·f_I[g]": truth["gyro_g_sensitivity.d_o[g]"] + g2["io"] * inclined,
            "D_S+D_SI·f_I[g]": truth["gyro_g_sensitivity.d_s[g]"] + g2["si"] * inclined,
            "D_OO-D_SS[g]": g2["oo"] - g2["ss"],
            "gyro_g2_sensitivity.d_os[g]": g2["os"],
            "gyro_bias_drift.slope[g]": truth["gyro_bias_drift.slope[g]"],
        }
        for name, true in wanted.items():
            # Arcs of a ninety-sixth of a turn shorten harmonics by a part in five thousand.
            room = 4 * found[name].sd + 5e-4 * abs(true)
            assert abs(found[name].value - true) < room, (name, found[name], true)


def test_less_than_a_turn_does_not_separate_constant_from_rotating_terms(tmp_path):
    campaign, _ = servo(tmp_path / "part", 1, {"part": 6.0})
    assert any("not separable" in one.sentence for one in classical(campaign) if isinstance(one, Undetermined))
    assert not estimates(campaign, "D_O")


def test_a_table_that_stands_askew_is_drift(tmp_path):
    """An axis 3 arcmin off the pole: the Earth's rate along it is the same to first order, gravity along it is not.

    With f_I = sin(L + δ) in the place of sin L the drift that does not turn is off by D_I cos L · δ.
    """
    sloped = {"table_axis_tilt.x[polar]": 180.0, "gyro_g_sensitivity.d_i[g]": 2.0}
    straight, _ = servo(tmp_path / "straight", 5, {"day": 26.0}, **{"gyro_g_sensitivity.d_i[g]": 2.0})
    askew, _ = servo(tmp_path / "askew", 5, {"day": 26.0}, **sloped)
    d = [estimates(one, "D[g]")[0].value for one in (straight, askew)]
    expected = 2.0 * np.cos(straight.site.latitude) * np.radians(180 / 3600)
    assert abs(abs(d[1] - d[0]) - expected) < 3e-4
