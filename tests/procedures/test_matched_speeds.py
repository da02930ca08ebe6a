"""Matched speeds beside a reference gyro: by value, each run with instants of its own, and every run used.

Plain NumPy, about a vertical axis that is body z: gyro z along it, gyro x across it, the reference exact.
"""

import numpy as np
import pytest

from imubayes.foundations.campaign_data import Campaign, Channel, Mounting, Run, Site, Table
from imubayes.procedures import classical
from imubayes.procedures.reference_gyro import matched
from imubayes.procedures.textbook import Estimate, Undetermined

LATITUDE = np.radians(48.0)
EARTH = 15.041067 * np.pi / 180 / 3600
DEGREE = np.pi / 180
SCALE, BIAS, LEAN = 1000.4, 12.0, 80.0  # pulse/s per deg/s, deg/h, arcsec towards z
AXES = {"gz": np.eye(3)[[2, 0, 1]], "gx": np.eye(3)}


def run_of(name, speeds, seed, noise=0.02, missing=()):
    """One row each 2 s at speeds in deg/s, negative in reverse; outputs in pulse/s."""
    generator = np.random.default_rng(seed)
    rate = speeds * DEGREE
    angle = np.cumsum(rate * 2.0) - rate
    # Earth rate in body axes at a table angle from East-North, then the rotation of the table.
    north, up = EARTH * np.cos(LATITUDE), EARTH * np.sin(LATITUDE)
    felt = np.stack([north * np.sin(angle), north * np.cos(angle), up + rate], axis=1)
    lean = LEAN / 206264.806
    inputs = {"gz": felt[:, 2], "gx": felt[:, 0] + lean * felt[:, 2]}
    output = np.stack(
        [
            (SCALE if g == "gz" else 1000.0) / DEGREE * (inputs[g] + BIAS * DEGREE / 3600)
            + noise * generator.normal(size=len(rate))
            for g in AXES
        ],
        axis=1,
    )
    output[list(missing), 0] = np.nan
    columns = {"time": 2.0 * np.arange(len(rate)), "table_angle": angle, "table_angle_span": rate * 2.0}
    columns |= {"table_rate": np.zeros(len(rate))}
    columns |= {f"reference_{axis}": felt[:, place] for place, axis in enumerate("xyz")}
    shape = np.full(output.shape, np.nan)
    return Run(name, "reference_gyro", "table", "flat", columns, output, np.full(len(rate), 200), shape)


def campaign(*runs):
    channels = tuple(
        Channel(name, "gyro", axes, "pulse/s", 1000.0, "deg/s", 1000.0 / DEGREE) for name, axes in AXES.items()
    )
    table = {"table": Table("table", 0.0, np.pi / 2)}
    return Campaign("matched", Site(LATITUDE, 0.0, 9.8), channels, table, {"flat": Mounting("flat", np.eye(3))}, runs)


def estimates(*runs):
    return {one.name: one for one in classical(campaign(*runs)) if isinstance(one, Estimate)}


TRUTH = {"scale_factor[gz]": SCALE, "gyro_bias.bias[gz]": BIAS, "gyro_misalignment.toward_s[gx]": LEAN}


def test_different_ranges_of_speed_match_by_value():
    """20 → 60 °/s forward and 25 → 65 °/s in reverse never agree row by row."""
    scores = {name: [] for name in TRUTH}
    for seed in range(40):
        found = estimates(
            run_of("forward", np.linspace(20, 60, 80), seed), run_of("reverse", -np.linspace(25, 65, 80), 1000 + seed)
        )
        assert found.keys() == TRUTH.keys()
        for name, one in found.items():
            scores[name].append((one.value - TRUTH[name]) / one.sd)
    for name, values in scores.items():
        assert 0.75 < np.sqrt(np.mean(np.square(values))) < 1.35, name


def test_every_run_is_used_and_the_uncertainty_shrinks():
    runs = [run_of(f"f{k}", np.linspace(20, 60, 60), k) for k in range(3)]
    reverse = [run_of("r", -np.linspace(58, 22, 60), 10)]
    few, all_of_them = estimates(runs[0], *reverse), estimates(*runs, *reverse)
    assert all_of_them["scale_factor[gz]"].run == "f0, f1, f2, r"
    more = [run_of(f"r{k}", -np.linspace(58, 22, 60), 20 + k) for k in range(3)]
    most = estimates(*runs, *more)

    def instants(found):
        return int(found["scale_factor[gz]"].method.split(": ")[1].split()[0])

    assert instants(few) >= 20
    assert instants(most) > 2.5 * instants(few)


def test_one_run_that_turns_both_ways_is_enough():
    speeds = np.concatenate([np.linspace(5, 60, 40), np.linspace(60, -60, 60), np.linspace(-60, -5, 40)])
    found = estimates(run_of("both", speeds, 1))
    assert abs(found["scale_factor[gz]"].value - SCALE) < 4 * found["scale_factor[gz]"].sd


def test_constant_speeds_match_and_missing_outputs_are_left_out():
    found = estimates(run_of("forward", np.full(40, 30.0), 1, missing=[3, 4]), run_of("reverse", np.full(40, -30.0), 2))
    assert found["scale_factor[gz]"].method.endswith("18 instants")
    assert abs(found["scale_factor[gz]"].value - SCALE) < 4 * found["scale_factor[gz]"].sd


def test_no_common_speed_is_said_with_the_speeds():
    findings = classical(
        campaign(run_of("forward", np.linspace(20, 40, 20), 1), run_of("reverse", -np.linspace(50, 70, 20), 2))
    )
    (said,) = findings
    assert isinstance(said, Undetermined)
    assert "forward 20 … 40 °/s, reverse 50 … 70 °/s" in said.sentence


def test_steps_match_where_they_share_a_speed():
    forward, reverse = np.array([[1.0, 2.0], [3.0, 2.5]]), np.array([[5.0, 4.0], [2.6, 2.2], [0.5, 1.5]])
    ahead, back, speed = matched(forward, reverse)
    assert ahead.tolist() == [0, 1]
    assert back.tolist() == [2, 1]
    assert speed == pytest.approx([1.25, 2.55])
