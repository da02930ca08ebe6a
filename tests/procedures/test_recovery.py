"""Textbook estimates on campaigns of the independent simulator: right if the assumptions hold, wrong by the amount
that theory says if they do not."""

import tomllib
from pathlib import Path

import numpy as np
import polar_tumble
import pytest
import simulate

from imubayes.campaign import load_campaign
from imubayes.procedures import classical
from imubayes.procedures.textbook import Estimate, Undetermined

ROOT = Path(__file__).parents[2]


def evaluated(folder):
    return classical(load_campaign(folder))


def truth_of(folder):
    document = tomllib.loads((folder / "truth.toml").read_text())
    return document["parameters"] | document["derived"]


@pytest.fixture(scope="module")
def trihedral():
    folder = ROOT / "data" / "trihedral-imu"
    return evaluated(folder), truth_of(folder)


def of(found, start, run=""):
    return [one for one in found if isinstance(one, Estimate) and one.name.startswith(start) and run in one.run]


@pytest.mark.slow
def test_scale_factor_with_the_axis_along_the_table(trihedral):
    """cos θ is flat if θ is small: a seat that errs by arc minutes does not matter, the table's rate does."""
    found, truth = trihedral
    rate_error = truth["table_rate_error.rate_error[rate]"]
    for channel, seat in (("gx", "x-up"), ("gy", "y-up"), ("gz", "z-up")):
        (one,) = of(found, f"scale_factor[{channel}]", f"rate-{seat}-25C")
        off = (one.value / truth[f"scale_factor[{channel}]"] - 1) * 1e6
        assert off == pytest.approx(rate_error, abs=4.0), channel


def test_scale_factor_in_the_pyramid_errs_as_the_fixture_does(trihedral):
    """1 arcsec is 6.86 ppm at the trihedral angle."""
    found, truth = trihedral
    for channel in ("gx", "gy", "gz"):
        (one,) = of(found, f"scale_factor[{channel}]", "rate-pyramid-25C")
        arcsec = (truth[f"mounting_angle[{channel},pyramid]"] - one.nominal) * 3600
        off = (one.value / truth[f"scale_factor[{channel}]"] - 1) * 1e6
        assert abs(arcsec) > 30, "the seat has to err for this to say anything"
        expected = (np.cos(np.radians(one.nominal + arcsec / 3600)) / np.cos(np.radians(one.nominal)) - 1) * 1e6
        assert expected == pytest.approx(-6.86 * arcsec, rel=0.01)
        assert off == pytest.approx(expected + truth["table_rate_error.rate_error[rate]"], abs=6.0), channel


def test_tumble_coefficients(trihedral):
    """Bias and second order, each within what seats and the tilt of the head (some 20 arcsec) make of them."""
    found, truth = trihedral
    seen = set()
    for one in of(found, "accel_", "25C"):
        if one.name not in truth:
            continue
        lean = one.name.startswith("accel_misalignment")
        room = 400.0 if lean else 150.0 if one.name.startswith("accel_bias") else 15.0
        assert one.value == pytest.approx(truth[one.name], abs=room), one
        seen.add(one.name.split(".")[0])
    assert {"accel_bias", "accel_quadratic", "accel_misalignment"} <= seen
    scales = of(found, "scale_factor[a", "25C")
    assert len(scales) == 6
    for one in scales:
        assert one.value == pytest.approx(truth[one.name], rel=5e-5)


def test_what_the_textbook_leaves_open_is_said(trihedral):
    found, _ = trihedral
    sentences = [one.sentence for one in found if isinstance(one, Undetermined)]
    assert any("K_oo" in one or "K_pp" in one for one in sentences)


@pytest.fixture
def quiet(tmp_path):
    """Polar tumbles with true seats and axes and no offset from run to run: what the textbook assumes."""

    def made(seed):
        plan = polar_tumble.plan(seed, model=ROOT / "models" / "polar-tumble.toml")
        drawn = plan.draw(seed)
        still = ("mounting_error", "table_axis_tilt", "run_scatter")
        values = {name: 0.0 if name.startswith(still) else value for name, value in drawn.items()}
        folder = tmp_path / str(seed)
        folder.mkdir()
        simulate.write_simulated(folder, plan, seed, values=values)
        return evaluated(folder), values

    return made


@pytest.mark.slow
def test_polar_tumble_over_replicates(quiet):
    scores = []
    for seed in range(20):
        found, truth = quiet(seed)
        scores += [(one.value - truth[one.name]) / one.sd for one in of(found, "gyro_g")]
        d = {name: truth[f"gyro_g2_sensitivity.d_{name}[g]"] for name in ("ii", "oo", "ss")}
        wanted = {"D_II-D_SS[g]": d["ii"] - d["ss"], "D_II-D_OO[g]": d["ii"] - d["oo"]}
        wanted["D_F+D_II[g]"] = truth["gyro_bias.bias[g]"] + d["ii"]
        for one in of(found, "D_"):
            scores.append((one.value - wanted.pop(one.name)) / one.sd)
        assert not wanted
    assert len(scores) == 180
    assert 0.85 < np.sqrt(np.mean(np.square(scores))) < 1.15
    assert np.mean(np.abs(scores) < 1.96) > 0.9


def test_one_sweep_alone_determines_combinations_and_asks_for_another(tmp_path):
    plan = polar_tumble.plan(1, seats=(polar_tumble.NORTH,), model=ROOT / "models" / "polar-tumble.toml")
    simulate.write_simulated(tmp_path, plan, 1)
    found = evaluated(tmp_path)
    assert [one.name for one in of(found, "gyro_g")] == ["gyro_g2_sensitivity.d_si[g]"]
    names = {one.name for one in of(found, "D_")}
    assert {"D_I+D_IO·sinL[g]", "D_S+D_OS·sinL[g]", "D_II-D_SS[g]"} <= names
    assert any("would determine" in one.sentence for one in found if isinstance(one, Undetermined))
