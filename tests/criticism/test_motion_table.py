"""A table that never rests: its encoder is followed through ramps, sinusoids and a sweep to 8 Hz.

Logs are simulated by `motion_table`, which shares no code with the models.
"""

from collections.abc import Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from imubayes.campaign import inspect_campaign, load_campaign
from imubayes.criticism.diagnose import judge
from imubayes.criticism.diagnosis_record import Diagnosis
from imubayes.foundations.errors import InputError
from imubayes.inference.nested_laplace import posterior_precision
from imubayes.inference.posterior_mode import find_mode
from imubayes.inference.run_fit import joint_fit
from imubayes.model.bind import Model, bind
from imubayes.model.model_file import read_model
from imubayes.procedures import PROCEDURES
from motion_table import DEGREE, GRAVITY, STEP, Unit, write_campaign

SENSORS = ("gyro_bias", "gyro_scale_factor", "accel_bias", "accel_scale_factor", "lever_arm")
LAGS, NOISE = ("gyro_bandwidth", "accel_bandwidth"), ("white_noise", "encoder_noise")
QUIET = 3e-4 * GRAVITY  # m/s², vibration that the noise of the accelerometers hides
POSITIVE = 'prior = { tau = "lognormal(1.5 ms, 0.7)" }\n'


def both(seconds: float) -> dict[str, tuple[str, float, float, str]]:
    """Return a run about a vertical and one about a level axis."""
    return {"upright": ("trihedral", 90.0, seconds, "mixed"), "level": ("trihedral", 0.0, seconds, "mixed")}


def bound_to(folder: Path, effects: Sequence[str]) -> Model:
    """Return a model of the campaign in a folder; lags beside a clock offset have positive priors."""
    text = 'format = 1\nname = "motion"\n'
    for name in (*effects, *NOISE):
        text += f'[[effect]]\nname = "{name}"\n' + (POSITIVE if name in LAGS and "time_skew" in effects else "")
    (folder / "model.toml").write_text(text)
    return bind(read_model(folder / "model.toml"), load_campaign(folder, judge_setup=False))


def truth(unit: Unit) -> dict[str, float]:
    """Return what the parameters should be, each in its own unit."""
    found = {f"time_skew.skew[table-{elevation}]": 1e3 * unit.skew for elevation in (0, 90)}
    for k, axis in enumerate("xyz"):
        found |= {
            f"gyro_bias.bias[g{axis}]": 3600 * unit.gyro_bias[k] / DEGREE,
            f"gyro_scale_factor.scale[g{axis}]": 1e6 * unit.gyro_scale[k],
            f"gyro_bandwidth.tau[g{axis}]": 1e3 * unit.gyro_lag[k],
            f"accel_bias.bias[a{axis}]": 1e6 * unit.accel_bias[k] / GRAVITY,
            f"accel_scale_factor.scale[a{axis}]": 1e6 * unit.accel_scale[k],
            f"accel_bandwidth.tau[a{axis}]": 1e3 * unit.accel_lag[k],
        }
        found |= {f"lever_arm.{letter}[a{axis}]": 1e3 * unit.arm[k, place] for place, letter in enumerate("xyz")}
    return found


def pulls(folder: Path, unit: Unit, effects: Sequence[str]) -> dict[str, float]:
    """Return for each parameter its error over its standard deviation."""
    model = bound_to(folder, effects)
    mode = find_mode(model.problem, *(jnp.zeros(size) for size in model.problem.size))
    assert bool(mode.converged)
    sd = np.sqrt(np.diag(np.linalg.inv(np.asarray(posterior_precision(model.problem, mode)))))
    known = truth(unit)
    return {
        each.name: (each.value_at(float(z)) - known[each.name]) / (float(s) * each.prior_sd)
        for each, z, s in zip(model.layout.parameters, np.asarray(mode.z), sd, strict=True)
    }


def drawn(seed: int) -> Unit:
    """Return a unit of the priors, with lags of some milliseconds and a clock of its own."""
    normal = np.random.default_rng(100 + seed).normal

    def lags() -> np.ndarray:
        return np.minimum(1.5e-3 * np.exp(0.7 * normal(0, 1, 3)), 4e-3)

    return Unit(
        gyro_bias=normal(0, 0.1, 3) * DEGREE, accel_bias=normal(0, 5e-3, 3) * GRAVITY, gyro_scale=normal(0, 1e-3, 3),
        accel_scale=normal(0, 1e-3, 3), gyro_lag=lags(), accel_lag=lags(), arm=normal(0, 0.02, (3, 3)),
        skew=round(normal(0, 3e-3) / STEP) * STEP,
    )  # fmt: skip


def test_a_log_of_motion_alone_is_rows_that_follow_the_angle(tmp_path):
    unit = drawn(1)
    write_campaign(tmp_path, unit, np.random.default_rng(1), {"only": ("trihedral", 90.0, 15.0, "swept")})
    inspection = inspect_campaign(tmp_path)
    assert not [finding for finding in inspection.findings if finding.severity == "error"]
    campaign = inspection.campaign
    assert campaign is not None
    run = campaign.runs[0]
    seconds = run.covariates["row_seconds"]
    assert (seconds > 0).mean() > 0.9
    assert seconds[seconds > 0].min() < 0.07  # at 8 Hz, half a period is 62 ms
    assert seconds.max() > 0.2
    assert np.sum(run.samples) > 0.95 * 200 * 14.8
    # Successive windows share an angle: their rates add up to the angle that the table turned.
    known = run.covariates
    turned = np.sum(known["table_rate"] * seconds)
    begin, end = known["table_angle"][[0, -1]]
    assert abs((turned - (end - begin) + np.pi) % (2 * np.pi) - np.pi) < np.deg2rad(2.0)
    stimulus = PROCEDURES["rate_table"].stimulus(run, campaign)
    found = np.bincount(stimulus.row, stimulus.weight * stimulus.table_rate)
    np.testing.assert_allclose(found[seconds > 0], known["table_rate"][seconds > 0], atol=2e-3)


def test_a_log_of_angles_alone_needs_the_key(tmp_path):
    write_campaign(tmp_path, drawn(1), np.random.default_rng(1), {"only": ("trihedral", 90.0, 15.0, "swept")}, "")
    with pytest.raises(InputError, match=r"needs the column 'table_rate_deg_s'(.|\n)*transitions = true"):
        load_campaign(tmp_path)


def test_biases_scales_lags_and_clock_agree_with_the_truth(tmp_path):
    unit = drawn(3)
    write_campaign(tmp_path, unit, np.random.default_rng(3), both(20.0))
    found = pulls(tmp_path, unit, (*SENSORS, *LAGS, "time_skew"))
    assert np.abs(list(found.values())).max() < 4.0, found


@pytest.mark.slow  # half a minute
def test_lags_that_a_model_lacks_show_in_its_scale_factors(tmp_path):
    """The pulls are red if a lag of 4 ms is left out: at 8 Hz it takes 2 % of the amplitude.

    The clock takes up the delay. Without it the delay is a residual that raises the noise, and hides the scale factor.
    """
    unit = drawn(3)
    unit.gyro_lag = np.full(3, 4e-3)
    write_campaign(tmp_path, unit, np.random.default_rng(3), both(20.0))
    found = pulls(tmp_path, unit, (*SENSORS, "time_skew"))
    assert min(abs(pull) for name, pull in found.items() if "gyro_scale" in name) > 4.0


UNITS = range(20)
PARTS = ("gyro_bias", "gyro_scale", "gyro_bandwidth", "accel_bias", "accel_scale", "accel_bandwidth", "lever_arm")


@pytest.mark.slow  # two minutes
def test_pulls_over_units(tmp_path):
    """Lags of a unit and the clock share an error: their pulls are not independent, and the bound is that of units."""
    found: dict[str, list[float]] = {}
    for seed in UNITS:
        unit, folder = drawn(seed), tmp_path / str(seed)
        write_campaign(folder, unit, np.random.default_rng(seed), both(40.0))
        for name, pull in pulls(folder, unit, (*SENSORS, *LAGS, "time_skew")).items():
            found.setdefault(name.partition(".")[0], []).append(pull)
    rms = {name: float(np.sqrt(np.mean(np.square(each)))) for name, each in found.items()}
    print({name: round(value, 2) for name, value in rms.items()})
    everything = np.concatenate([np.array(each) for each in found.values()])
    assert 0.9 < np.sqrt(np.mean(everything**2)) < 1.1, rms
    for name, value in rms.items():
        assert 0.75 < value < 1.35, (name, rms)  # χ² of 20 independent units: 0.69 … 1.31


def judged(folder: Path, unit: Unit, vibration: float = QUIET) -> Diagnosis:
    """Return what is found in a campaign by a model without lags, clock offset, asymmetry and g-sensitivity."""
    unit.vibration = vibration
    write_campaign(folder, unit, np.random.default_rng(5), both(30.0))
    return judge(joint_fit(bound_to(folder, SENSORS), None))


def still() -> Unit:
    """Return a unit without lags."""
    unit = drawn(7)
    unit.skew, unit.gyro_lag, unit.accel_lag = 0.0, np.zeros(3), np.zeros(3)
    return unit


@pytest.mark.slow  # a minute for all
@pytest.mark.parametrize(
    ("hidden", "effect", "channels"),
    [
        ({"gyro_lag": np.array([5e-3, 0.0, 0.0])}, "gyro_bandwidth", {"gx"}),
        ({"accel_lag": np.array([0.0, 5e-3, 0.0])}, "accel_bandwidth", {"ay"}),
        ({"skew": 5e-3}, "time_skew", {"table-0", "table-90"}),
        ({"asymmetry": np.array([0.0, 3e-3, 0.0])}, "gyro_scale_asymmetry", {"gy"}),
        ({"sensitivity": np.array([0.0, 0.0, 0.05]) * DEGREE / GRAVITY}, "gyro_g_sensitivity", {"gz"}),
    ],
    ids=lambda each: each if isinstance(each, str) else "",
)
def test_hidden_effects_are_named_in_motion(tmp_path, hidden, effect, channels):
    unit = still()
    for name, value in hidden.items():
        setattr(unit, name, value)
    found = judged(tmp_path, unit)
    assert found.verdict == "missing_effect"
    assert effect in found.groups[0].effects
    assert set(found.groups[0].channels) == channels


@pytest.mark.slow
@pytest.mark.parametrize("vibration", [QUIET, 2e-3 * GRAVITY])
def test_nothing_is_named_where_nothing_is_hidden(tmp_path, vibration):
    """A vibration of 2 mg at 70 Hz is in the scatter of the samples, and averages out within the rows."""
    found = judged(tmp_path, still(), vibration)
    assert found.verdict == "adequate"
    assert bool(found.disagreeing_noise) == (vibration > QUIET)
