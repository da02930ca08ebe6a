"""Recordings corrected by a calibration: on the shipped tumble and on outputs written down from formulas in NumPy."""

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from imubayes.api import fit
from imubayes.campaign import load_campaign
from imubayes.campaign.run_tables import RowBatch
from imubayes.foundations.errors import InputError
from imubayes.inference.fitted_model import Fit
from imubayes.model.bind import bind
from imubayes_qualification.api.calibrated_unit import correct, onboard_constants
from imubayes_qualification.display.corrected_readings import correction_lines
from imubayes_qualification.display.onboard.formats import heading
from imubayes_qualification.onboard.correct_recording import Correction, ReadingNoise, RowTally, correction_of
from imubayes_qualification.onboard.recording_files import open_recording
from imubayes_qualification.onboard.response import (
    SensorPosterior,
    complete_kinds,
    linear_response,
    sufficient_grid,
)
from planted_result import planted
from small_campaign import GRAVITY, campaign, spec

ROOT = Path(__file__).parents[2]
DESK = ROOT / "data" / "desk-imu"
TRUTH = tomllib.loads((DESK / "truth.toml").read_text())
ARCSEC, DEG_H = np.pi / 648000, np.pi / 648000
G = 9.807983  # m/s² at 48° and 520 m, WGS 84 normal gravity


@pytest.fixture(scope="module")
def result():
    return fit(DESK, ROOT / "models" / "desk-imu.toml", sample=False)


def true_outputs(rate, force):
    """Outputs of the true unit in rad/s and m/s², shape (R, 6): bias and scale factor on misaligned axes."""
    values, columns = TRUTH["parameters"], {}
    for channel, vector, family, third, bias_si in (
        *((f"a{axis}", force, "accel", "p", 1e-6 * G) for axis in "xyz"),
        *((f"g{axis}", rate, "gyro", "s", DEG_H) for axis in "xyz"),
    ):
        first = "xyz".index(channel[1])
        axis = np.zeros(3)
        axis[first] = 1.0
        axis[(first + 1) % 3] = ARCSEC * values[f"{family}_misalignment.toward_o[{channel}]"]
        axis[(first + 2) % 3] = ARCSEC * values[f"{family}_misalignment.toward_{third}[{channel}]"]
        along = vector @ (axis / np.linalg.norm(axis)) + bias_si * values[f"{family}_bias.bias[{channel}]"]
        columns[channel] = (1 + 1e-6 * values[f"{family}_scale_factor.scale[{channel}]"]) * along
    return columns


def attitudes(count: int, seed: int = 5):
    directions = np.random.default_rng(seed).normal(size=(count, 3))
    return G * directions / np.linalg.norm(directions, axis=1)[:, None]


@pytest.mark.slow  # a minute for the fit of a whole IMU; every run solves planted parameters below
def test_at_rest_the_length_is_g_within_the_uncertainty_in_every_pose(result, tmp_path):
    out = tmp_path / "corrected.parquet"
    found = correct(result, DESK, out)
    assert found.kinds == ("accelerometer", "gyro")
    table = pl.read_parquet(out)
    starts = [0.0, *TRUTH["nuisance"]["move_end_s"]]
    ends = [*TRUTH["nuisance"]["move_start_s"], table["time_s"].max()]
    scores, ratios = [], []
    for start, end in zip(starts, ends, strict=True):
        rest = table.filter(pl.col("time_s").is_between(start + 0.1, end - 0.1))
        length = rest["force_norm_m_s2"].to_numpy()
        random = rest["force_norm_random_sd_m_s2"].to_numpy()
        systematic = rest["force_norm_systematic_sd_m_s2"].to_numpy()[0]
        scores.append((length.mean() - G) / np.hypot(systematic, random[0] / np.sqrt(len(rest))))
        ratios.append(length.std() / random.mean())
        # Fault planted: the outputs as they are.
        raw = np.linalg.norm(rest.select("ax", "ay", "az").to_numpy(), axis=1).mean()
        assert abs(raw - G) > 10 * systematic
    assert np.abs(scores).max() < 4
    assert 0.5 < np.mean(np.square(scores)) < 1.6
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.02)


@pytest.mark.slow  # a minute for the fit of a whole IMU; every run solves planted parameters below
def test_a_recording_that_was_left_out_is_right_within_the_systematic_uncertainty(result, tmp_path):
    """New attitudes, each a mean of so many samples that only the calibration is uncertain."""
    force, rate = attitudes(300), 0.7 * attitudes(300, 6) / G
    columns = true_outputs(rate, force)
    samples = np.full(300, 10**8)
    pl.DataFrame({"pose": [f"p{k}" for k in range(300)], **columns, "samples": samples}).write_csv(tmp_path / "new.csv")
    correct(result, tmp_path / "new.csv", tmp_path / "out.csv")
    found = pl.read_csv(tmp_path / "out.csv")
    assert found["pose"].to_list() == [f"p{k}" for k in range(300)]
    truth = {"force_norm": np.full(300, G)}
    truth |= {f"force_{axis}": force[:, k] for k, axis in enumerate("xyz")}
    truth |= {f"rate_{axis}": rate[:, k] for k, axis in enumerate("xyz")}
    for name, true in truth.items():
        unit = "m_s2" if name.startswith("force") else "rad_s"
        error = found[f"{name}_{unit}"].to_numpy() - true
        score = error / found[f"{name}_systematic_sd_{unit}"].to_numpy()
        assert np.abs(score).max() < 4, name
        # Fault planted: a tenth of the uncertainty would not cover the errors.
        assert np.abs(10 * score).max() > 4, name


@pytest.mark.slow  # a minute for the fit of a whole IMU; every run solves planted parameters below
def test_gravity_that_nobody_measured_is_in_what_is_stated(result, tmp_path, monkeypatch):
    """The campaign has normal gravity, u = 50 µg, taken as exact by the model: at rest all poses share its error."""
    pl.DataFrame({**true_outputs(np.zeros((9, 3)), attitudes(9)), "samples": np.full(9, 10**8)}).write_csv(
        tmp_path / "new.csv"
    )
    rests = {}
    for name in ("with", "without"):
        told = correction_lines(correct(result, tmp_path / "new.csv", tmp_path / "out.csv"))
        constants = onboard_constants(result)
        spread = pl.read_csv(tmp_path / "out.csv")["force_norm_systematic_sd_m_s2"].to_numpy()
        rests[name] = spread, constants.sd("M[z,az]"), constants.sd("M[z,gz]"), told, heading(constants, ())
        monkeypatch.setattr("imubayes_qualification.onboard.response.included_shifts", lambda fit: ())
    (sd, scale, gyro, told, head), (own, own_scale, own_gyro, silent, bare) = rests.values()
    assert np.sqrt(sd**2 - own**2) == pytest.approx(50e-6 * G, rel=0.05)
    assert np.sqrt(scale**2 - own_scale**2) == pytest.approx(50e-6, rel=0.05)
    assert gyro == pytest.approx(own_gyro, rel=1e-3)
    named = "gravity anomaly (u = 50 µg, assumed for normal gravity), taken as exact by the model"
    assert named in told[-1]
    assert named in " ".join(head)
    assert named not in " ".join((*silent, *bare))
    assert result.summary.exact[0].size == 50


@pytest.fixture(scope="module")
def unfitted():
    """A unit of six channels as its priors say."""
    model = bind(spec("gyro_bias", "gyro_scale_factor", "accel_bias", "accel_scale_factor"), campaign())
    return planted(model, np.zeros(len(model.layout)))


def test_missing_cells_and_other_columns_are_kept(unfitted, tmp_path):
    columns = true_outputs(np.zeros((4, 3)), attitudes(4))
    frame = pl.DataFrame({"note": ["a", "b, c", "d", "e"], **columns})
    frame = frame.with_columns(ax=pl.Series([None, *columns["ax"][1:]]), gy=pl.Series([*columns["gy"][:3], None]))
    frame.write_csv(tmp_path / "gaps.csv")
    summary = correct(unfitted, tmp_path / "gaps.csv", tmp_path / "out.csv")
    found = pl.read_csv(tmp_path / "out.csv")
    assert found["note"].to_list() == ["a", "b, c", "d", "e"]
    assert found["force_x_m_s2"].is_null().to_list() == [True, False, False, False]
    assert found["rate_x_rad_s"].is_null().to_list() == [True, False, False, True]
    assert (summary.tally.rows, summary.tally.incomplete) == (4, 2)


def test_what_cannot_be_corrected_is_refused(unfitted, tmp_path):
    frame = pl.DataFrame(true_outputs(np.zeros((2, 3)), attitudes(2)))
    frame.drop("ay", "gz").write_csv(tmp_path / "two.csv")
    with pytest.raises(InputError, match="no complete set"):
        correct(unfitted, tmp_path / "two.csv", tmp_path / "out.csv")
    with pytest.raises(InputError, match="no such file"):
        correct(unfitted, tmp_path / "none.csv", tmp_path / "out.csv")
    with pytest.raises(InputError, match="no run 'swing'"):
        correct(unfitted, DESK, tmp_path / "out.csv", run="swing")
    other = [replace(channel, offset=1.0) for channel in unfitted.fit.model.campaign.channels]
    with pytest.raises(InputError, match="not the one that was fitted"):
        open_recording(DESK, other)
    assert not (tmp_path / "out.csv").exists()


def test_channels_that_do_not_span_three_axes_are_read_along_their_own():
    six = campaign().channels
    names = [channel.name for channel in six]
    assert complete_kinds(six, names) == ("accelerometer", "gyro")
    assert complete_kinds(six, names[:3]) == ("gyro",)
    assert complete_kinds(six, [*names[:2], *names[4:]]) == ()
    assert complete_kinds([replace(channel, axes=six[0].axes) for channel in six], names) == ()


EFFECTS = (
    "gyro_bias", "gyro_scale_factor", "gyro_misalignment", "gyro_g_sensitivity", "gyro_scale_g_dependence",
    "gyro_scale_temperature", "accel_bias", "accel_scale_factor", "accel_quadratic", "accel_cross_coupling",
    "accel_bias_temperature", "converter_gain_drift",
)  # fmt: skip


@pytest.fixture(scope="module")
def nonlinear() -> tuple[SensorPosterior, dict[str, float]]:
    """A unit with nonlinear terms, nothing fitted: its parameters are drawn from their priors, small campaign.

    Scale factor errors are of a few per cent: what a bias is referred to is seen.
    """
    model = bind(spec(*EFFECTS), campaign())
    derived = Fit(model, np.zeros(len(model.layout)), np.zeros(0), True).derived
    rng = np.random.default_rng(3)
    truth = np.array([p.prior_sd * rng.normal() * p.factor for p in model.layout.parameters])
    of_scale = ["_scale_factor.scale[" in name for name in model.layout.names]
    truth[of_scale] = rng.uniform(0.02, 0.05, sum(of_scale)) * rng.choice([-1, 1], sum(of_scale))
    values = np.concatenate([truth, np.asarray(model.problem.nulls)])
    places = np.arange(len(truth))
    scatter = truth + 1e-6 * np.abs(truth) * rng.normal(size=(200, len(truth)))
    inputs = derived.derivation.inputs
    posterior = SensorPosterior(campaign(), inputs, model.layout.names, places, scatter, values)
    return posterior, dict(zip(model.layout.names, truth, strict=True))


@pytest.mark.slow
def test_all_axes_are_solved_jointly_with_the_nonlinear_terms(nonlinear):
    posterior, p = nonlinear
    rng = np.random.default_rng(8)
    rows = 40
    force, rate = 3 * GRAVITY * rng.uniform(-1, 1, (rows, 3)), 2 * rng.uniform(-1, 1, (rows, 3))
    warm, converter = rng.uniform(10, 45, rows), rng.uniform(15, 50, rows)
    numbers = {"temperature_degC": warm, "converter_temperature_degC": converter}
    for k, channel in enumerate(posterior.campaign.channels):
        a = channel.name
        order = [(k % 3 + i) % 3 for i in range(3)]
        w, f = rate[:, order].T, force[:, order].T
        if channel.kind == "gyro":
            toward = np.array([1, p[f"gyro_misalignment.toward_o[{a}]"], p[f"gyro_misalignment.toward_s[{a}]"]])
            signal = toward @ w / np.linalg.norm(toward) + p[f"gyro_bias.bias[{a}]"]
            signal += sum(p[f"gyro_g_sensitivity.d_{i}[{a}]"] * f[j] for j, i in enumerate("ios"))
            signal += p[f"gyro_scale_g_dependence.dependence[{a}]"] * f[0] * w[0]
            signal *= 1 + p[f"gyro_scale_factor.scale[{a}]"]
            signal *= 1 + p[f"gyro_scale_temperature.slope[{a}]"] * (warm - 25)
        else:
            signal = f[0] + p[f"accel_bias.bias[{a}]"] + p[f"accel_bias_temperature.slope[{a}]"] * (warm - 25)
            signal += p[f"accel_quadratic.quadratic[{a}]"] * f[0] ** 2
            signal += (p[f"accel_cross_coupling.k_ip[{a}]"] * f[2] + p[f"accel_cross_coupling.k_io[{a}]"] * f[1]) * f[0]
            signal *= 1 + p[f"accel_scale_factor.scale[{a}]"]
        gain = p.get(f"converter_gain_drift.slope[{a}]", 0.0)
        numbers[a] = channel.offset + channel.scale_si * signal * (1 + gain * (converter - 25))
    names = [channel.name for channel in posterior.campaign.channels]
    noise = ReadingNoise(dict.fromkeys(names, ()), {}, dict.fromkeys(names, 0.0), ())
    needs = ("temperature", "converter_temperature")
    correction = Correction(posterior, noise, ("accelerometer", "gyro"), needs, {"temperature": (15.0, 40.0)})
    tally = RowTally()
    found = correction.columns(RowBatch(0, rows, numbers, {}, {}), {}, tally)
    for k, axis in enumerate("xyz"):
        np.testing.assert_allclose(found[f"force_{axis}_m_s2"], force[:, k], rtol=0, atol=1e-8)
        np.testing.assert_allclose(found[f"rate_{axis}_rad_s"], rate[:, k], rtol=0, atol=1e-9)
    assert tally.beyond == {"temperature": int(np.sum((warm < 15) | (warm > 40)))}
    # The systematic uncertainty is that of repeated solutions at draws of the parameters.
    repeated = [
        replace(correction, posterior=replace(posterior, values=posterior.at(draw))).columns(
            RowBatch(0, rows, numbers, {}, {}), {}, RowTally()
        )
        for draw in posterior.draws[:25]
    ]
    for column, unit in (("force_y", "m_s2"), ("rate_x", "rad_s"), ("force_norm", "m_s2")):
        spread = np.std([each[f"{column}_{unit}"] for each in repeated], axis=0)
        stated = found[f"{column}_systematic_sd_{unit}"]
        assert np.median(spread / stated) == pytest.approx(1.0, abs=0.3)


@pytest.mark.slow
def test_gyros_alone_are_right_within_an_uncertainty_that_has_their_g_sensitivity():
    """Turned by hand, at rest in between: the specific force is g in directions that the recording leaves open."""
    model = bind(spec("gyro_bias", "gyro_g_sensitivity", "accel_bias"), campaign())
    z = np.array([2.0 if p.name.startswith("gyro_g_sens") else 0.3 for p in model.layout.parameters])
    result = planted(model, z, sd=1e-4)
    p = {
        each.name: float(value)
        for each, value in zip(model.layout.parameters, model.problem.priors.values(z), strict=True)
    }
    rng = np.random.default_rng(4)
    force = GRAVITY * rng.normal(size=(200, 3))
    force *= GRAVITY / np.linalg.norm(force, axis=1, keepdims=True)
    rate, numbers = rng.uniform(-1, 1, (200, 3)), {"samples": np.full(200, 1e12)}
    drift = np.zeros((200, 3))
    for k, channel in enumerate(model.campaign.of_kind("gyro")):
        order = [(k + i) % 3 for i in range(3)]
        drift[:, k] = sum(
            p[f"gyro_g_sensitivity.d_{i}[{channel.name}]"] * force[:, j] for i, j in zip("ios", order, strict=True)
        )
        signal = rate[:, k] + drift[:, k] + p[f"gyro_bias.bias[{channel.name}]"]
        numbers[channel.name] = channel.offset + channel.scale_si * signal
    correction = correction_of(result, ("gx", "gy", "gz"), "recording")
    found = correction.columns(RowBatch(0, 200, numbers, {}, {}), {}, RowTally())
    assert [(each.effect, each.channels) for each in correction.left_in] == [("gyro_g_sensitivity", ("gx", "gy", "gz"))]
    for k, axis in enumerate("xyz"):
        wrong = found[f"rate_{axis}_rad_s"] - rate[:, k]
        np.testing.assert_allclose(wrong, drift[:, k], atol=1e-3 * np.abs(drift).max())
        stated = found[f"rate_{axis}_systematic_sd_rad_s"]
        assert np.abs(wrong / stated).max() < 2
        # Neither is it wide beyond reason: the force is g at most.
        assert np.sqrt(np.mean((wrong / stated) ** 2)) > 0.4
    # What both kinds determine is corrected.
    assert correction_of(result, tuple(c.name for c in model.campaign.channels), "recording").left_in == ()


@pytest.mark.slow
def test_the_constants_give_the_truth_within_their_joint_covariance(result, tmp_path):
    """M (r − b) in NumPy on outputs of the true unit, with the covariance of the constants propagated to each row."""
    constants = onboard_constants(result)
    force, rate = attitudes(60), 0.7 * attitudes(60, 6) / G
    columns = true_outputs(rate, force)
    pl.DataFrame({**columns, "samples": np.full(60, 10**8)}).write_csv(tmp_path / "new.csv")
    correct(result, tmp_path / "new.csv", tmp_path / "out.csv")
    solved = pl.read_csv(tmp_path / "out.csv")
    names = [constant.name for constant in constants.constants]
    covariance = np.array(constants.covariance)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), [c.sd for c in constants.constants], rtol=1e-6)
    for kind, true, name, unit in (("accelerometer", force, "force", "m_s2"), ("gyro", rate, "rate", "rad_s")):
        triad = constants.triad(kind)
        assert triad is not None
        assert triad.error_left < 1e-6
        r = np.stack([columns[channel] for channel in triad.channels], axis=1)
        bias = np.array(triad.bias.coefficients)[:, 0]
        found = (r - bias) @ np.array(triad.matrix).T
        for k, axis in enumerate("xyz"):
            gradient = np.zeros((60, len(names)))
            for i, channel in enumerate(triad.channels):
                gradient[:, names.index(f"M[{axis},{channel}]")] = r[:, i] - bias[i]
                gradient[:, names.index(f"bias[{channel}]")] = -triad.matrix[k][i]
            sd = np.sqrt(np.einsum("rn,nm,rm->r", gradient, covariance, gradient))
            assert np.abs((found[:, k] - true[:, k]) / sd).max() < 4
            np.testing.assert_allclose(sd, solved[f"{name}_{axis}_systematic_sd_{unit}"], rtol=0.05)
    # One hash of the data stands in every file that is made of the fit: that of the campaign's files.
    assert constants.data_sha256 == load_campaign(DESK).digest
    assert result.summary.provenance is None or result.summary.provenance.data_sha256 == constants.data_sha256
    # The angles that define the body axes are held by their priors, and known to be.
    assert not constants.unexpressed
    sample = constants.worked_sample
    assert sample.force_m_s2 is not None
    np.testing.assert_allclose(sample.force_m_s2, [1.5, -2.5, 9.0], atol=2e-6)


def test_bias_and_gain_are_polynomials_of_both_temperatures(nonlinear):
    posterior, p = nonlinear
    needs = ("temperature", "converter_temperature")
    ranges = {"temperature": (0.0, 50.0), "converter_temperature": (10.0, 60.0)}
    grid = sufficient_grid(posterior, ranges, needs, ("accelerometer", "gyro"))
    found = linear_response(posterior, posterior.values[None], grid, ("accelerometer", "gyro"))
    for warm, converter in ((3.0, 55.0), (48.0, 12.0), (25.0, 25.0)):
        powers = (warm - 25) ** grid.powers[:, 0] * (converter - 25) ** grid.powers[:, 1]
        for k, axis in enumerate("xyz"):
            a, g = f"a{axis}", f"g{axis}"
            gain = 1 + p.get(f"converter_gain_drift.slope[{a}]", 0.0) * (converter - 25)
            scale = (1 + p[f"accel_scale_factor.scale[{a}]"]) * gain
            bias = p[f"accel_bias.bias[{a}]"] + p[f"accel_bias_temperature.slope[{a}]"] * (warm - 25)
            assert found["accelerometer"].gain[0, k] @ powers == pytest.approx(scale, abs=1e-9)
            assert found["accelerometer"].zero[0, k] @ powers == pytest.approx(scale * bias, abs=1e-9)
            gain = 1 + p.get(f"converter_gain_drift.slope[{g}]", 0.0) * (converter - 25)
            thermal = 1 + p[f"gyro_scale_temperature.slope[{g}]"] * (warm - 25)
            scale = (1 + p[f"gyro_scale_factor.scale[{g}]"]) * thermal * gain
            assert found["gyro"].gain[0, k] @ powers == pytest.approx(scale, abs=1e-9)
            assert found["gyro"].zero[0, k] @ powers == pytest.approx(scale * p[f"gyro_bias.bias[{g}]"], abs=1e-10)
        sensitivity = p["gyro_g_sensitivity.d_o[gx]"] * (1 + p["gyro_scale_factor.scale[gx]"])
        assert found["gyro"].by_force[0, 0, 1] == pytest.approx(sensitivity, rel=1e-9)
