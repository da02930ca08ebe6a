"""Logs of a rate table used whole: the ramps between levels, if each gyro lags and the clock of the table is off.

The simulator filters the input of every gyro in steps of a millisecond and shares no code with the models.
"""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import polars as pl
import pytest
from scipy.signal import lfilter

from imubayes.campaign import load_campaign
from imubayes.criticism.diagnose import judge
from imubayes.foundations.errors import InputError
from imubayes.inference.nested_laplace import posterior_precision
from imubayes.inference.posterior_mode import find_mode
from imubayes.inference.run_fit import joint_fit
from imubayes.model.bind import Model, bind
from imubayes.model.model_file import read_model

LEVELS = (0.0, 20.0, -20.0, 60.0, -60.0, 90.0, -90.0, 0.0)  # deg/s
SECONDS, SLOPE, STEP, EVERY = 14.0, 40.0, 1e-3, 10
NORTH, UP = 15.041067 / 3600 * np.array([np.cos(np.deg2rad(48)), np.sin(np.deg2rad(48))])  # Earth rate, deg/s
TILT = np.deg2rad([0.0, 40.0, 54.7356])
LAGS = np.array([2.0, 6.0, 11.0])  # ms
SCALES = np.array([120.0, -80.0, 200.0])  # ppm
BIASES = np.array([3.0, -6.0, 9.0])  # deg/h
NOISE = 2.0  # pulse/s, of a sample
CAMPAIGN = """
format = 1
name = "whole"

[site]
latitude_deg = 48.0

[[table]]
name = "table"
elevation_deg = 90.0

[[mounting]]
name = "up"
body_to_table = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]

[[run]]
name = "rates"
procedure = "rate_table"
file = "rates.csv"
table = "table"
mounting = "up"
temperature_degC = 25.0
"""
CHANNEL = """
[[channel]]
name = "g{k}"
kind = "gyro"
input_axis = [{x}, 0.0, {z}]
output_axis = [0.0, 1.0, 0.0]
output_unit = "pulse/s"
scale = 1000.0
per = "deg/s"
"""


def table_motion(levels=LEVELS) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return commanded rate, rate and angle of the table at every step, deg/s and deg: levels joined by ramps."""
    parts, command, last = [], [], 0.0
    for level in levels:
        ramp = last + np.sign(level - last) * SLOPE * STEP * np.arange(round(abs(level - last) / SLOPE / STEP))
        parts += [ramp, np.full(round(SECONDS / STEP), level)]
        command.append(np.full(len(ramp) + round(SECONDS / STEP), level))
        last = level
    rate = np.concatenate(parts)
    return np.concatenate(command), rate, np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) / 2 * STEP)])


def write_campaign(folder: Path, seed: int, key: str = "", skew_ms: int = 0, lags=LAGS, encoder_arcsec=0.5) -> Path:
    """Write a log at 100 Hz with the angle of an encoder; the outputs are sampled `skew_ms` after the table."""
    rng = np.random.default_rng(seed)
    command, rate, angle = table_motion()
    sampled = angle[::EVERY] + encoder_arcsec / 3600 * rng.standard_normal(len(angle[::EVERY]))
    columns = {
        "time_s": STEP * np.arange(len(rate))[::EVERY],
        "table_rate_deg_s": command[::EVERY],
        "table_angle_deg": np.round(sampled % 360.0, 6),
    }
    text = CAMPAIGN + key + "\n"
    for k, (tilt, lag) in enumerate(zip(TILT, lags, strict=True)):
        input_rate = np.cos(tilt) * (rate + UP) + np.sin(tilt) * NORTH * np.sin(np.deg2rad(angle))
        # τ dy/dt + y = u by the trapezoidal rule, from steady state.
        a = 2e-3 * lag / STEP
        start = [input_rate[0] * (1 - 1 / (1 + a))]
        late = lfilter([1 / (1 + a), 1 / (1 + a)], [1.0, (1 - a) / (1 + a)], input_rate, zi=start)[0]
        seen = np.roll(late, -skew_ms)[::EVERY] + BIASES[k] / 3600
        columns[f"g{k}"] = 1000 * (1 + 1e-6 * SCALES[k]) * seen + NOISE * rng.standard_normal(len(seen))
        text += CHANNEL.format(k=k, x=float(np.sin(tilt)), z=float(np.cos(tilt)))
    folder.mkdir(parents=True)
    pl.DataFrame(columns).write_csv(folder / "rates.csv")
    (folder / "campaign.toml").write_text(text)
    return folder


def bound_to(folder: Path, *more: str, noise: tuple[str, ...] = ("encoder_noise",)) -> Model:
    """Return a model of the campaign in a folder."""
    effects = ("gyro_bias", "gyro_scale_factor", *more, "white_noise", *noise)
    file = folder / "model.toml"
    file.write_text('format = 1\nname = "whole"\n' + "".join(f'[[effect]]\nname = "{each}"\n' for each in effects))
    return bind(read_model(file), load_campaign(folder))


def estimates(folder: Path, *more: str, noise: tuple[str, ...] = ("encoder_noise",)) -> dict[str, tuple[float, float]]:
    """Return estimate and standard deviation of each parameter, in its own unit."""
    model = bound_to(folder, *more, noise=noise)
    mode = find_mode(model.problem, *(jnp.zeros(size) for size in model.problem.size))
    assert bool(mode.converged)
    sd = np.sqrt(np.diag(np.linalg.inv(np.asarray(posterior_precision(model.problem, mode)))))
    return {
        each.name: (each.value_at(float(z)), float(s) * each.prior_sd)
        for each, z, s in zip(model.layout.parameters, np.asarray(mode.z), sd, strict=True)
    }


TRUTH = {
    f"{name}[g{k}]": values[k]
    for name, values in {
        "gyro_bias.bias": BIASES, "gyro_scale_factor.scale": SCALES, "gyro_bandwidth.tau": LAGS
    }.items()
    for k in range(3)
}  # fmt: skip


def scores(found: dict[str, tuple[float, float]]) -> dict[str, float]:
    return {name: (value - TRUTH[name]) / sd for name, (value, sd) in found.items() if name in TRUTH}


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    return write_campaign(tmp_path_factory.mktemp("transitions") / "whole", 3, "transitions = true")


def test_ramps_tell_the_lag_of_every_gyro_and_scale_and_bias_are_as_from_the_levels(whole, tmp_path):
    found = estimates(whole, "gyro_bandwidth")
    folder = write_campaign(tmp_path / "levels", 3)
    levels = estimates(folder, noise=())
    pulls = scores(found)
    assert len(pulls) == 9
    assert np.abs(list(pulls.values())).max() < 3.5, pulls
    for name in TRUTH:
        if "bandwidth" in name:
            assert found[name][1] < 0.02  # ms, of lags of 2 to 11
        else:
            assert found[name][1] < 1.3 * levels[name][1], name
            assert abs(found[name][0] - levels[name][0]) < 2 * levels[name][1], name
    with pytest.raises(InputError, match="no run can show 'gyro_bandwidth'"):
        estimates(folder, "gyro_bandwidth", noise=())


@pytest.mark.slow  # a minute
def test_the_lag_is_named_where_the_model_lacks_it(whole):
    found = judge(joint_fit(bound_to(whole), None))
    assert found.groups[0].effects[0] == "gyro_bandwidth", found.verdict
    assert set(found.groups[0].channels) == {"g0", "g1", "g2"}
    # Encoder noise twenty times its prior does not pass for it.
    assert found.explanations is not None
    assert found.explanations.leading.kind == "effects"


@pytest.mark.slow  # compiles another model; the ramps determine the lags at every run
def test_a_clock_offset_is_told_from_the_lags(tmp_path):
    """One common delay is the clock's if the model has it alone; lag and offset share their sum."""
    folder = write_campaign(tmp_path / "late", 4, "transitions = true", skew_ms=-7, lags=np.zeros(3))
    skew, sd = estimates(folder, "time_skew")["time_skew.skew[table]"]
    assert abs(skew + 7.0) < 4 * sd
    assert sd < 0.02


def test_rows_between_levels_have_the_rate_of_the_encoder(whole):
    run = load_campaign(whole).runs[0]
    rate, acceleration = np.rad2deg(run.covariates["table_rate"]), np.rad2deg(run.covariates["table_acceleration"])
    passing = np.abs(acceleration) > SLOPE / 2
    assert 40 < passing.sum() < 400
    np.testing.assert_allclose(np.abs(acceleration[passing]).mean(), SLOPE, rtol=0.05)
    assert np.diff(np.sort(rate)).max() < 30  # of levels up to 90 deg/s: rows at all rates
    assert set(np.unique(run.covariates["row_seconds"] > 0)) == {False, True}
    assert "and between" in " ".join(run.notes)


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (("transitions = true", 'transitions = true\nignore = ["table_angle_deg"]'), "rate between the levels"),
        (('procedure = "rate_table"', 'procedure = "dividing_head"'), "do not follow a motion"),
    ],
)
def test_what_no_encoder_tells_is_refused(whole, tmp_path, change, what):
    folder = tmp_path / "other"
    folder.mkdir()
    for name in ("campaign.toml", "rates.csv"):
        (folder / name).write_text((whole / name).read_text().replace(*change))
    with pytest.raises(InputError, match=what):
        load_campaign(folder)
