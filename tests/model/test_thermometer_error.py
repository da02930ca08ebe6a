"""A temperature that is stated with an uncertainty is estimated from the runs; one without is exact.

The outputs are computed here, by NumPy alone: a horizontal axis that points east, at whose zero table y points down.
"""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from imubayes.foundations.campaign_data import Campaign, Channel, Mounting, Run, Site, Table
from imubayes.foundations.errors import InputError
from imubayes.inference.nested_laplace import posterior_precision
from imubayes.inference.plausibility import prior_conflicts
from imubayes.inference.posterior_mode import find_mode
from imubayes.model.bind import Model, bind
from imubayes.model.bound_effects import observability
from imubayes.model.derived_quantities import derived_quantities
from imubayes.model.model_file import EffectSpec, ModelSpec
from imubayes.model.problem import predict
from small_campaign import driven_campaign, spec, tumble_campaign, wide_campaign

GRAVITY, SCALE, SAMPLES, NOISE = 9.81, 16384.0, 100, 4.0
SLOPES = {"ax": -25.0, "ay": 10.0, "az": 40.0}  # µg/°C about 25 °C
BIASES, PPM = {"ax": 3100.0, "ay": -1700.0, "az": 5200.0}, {"ax": 1200.0, "ay": -800.0, "az": 2100.0}
SEATS = {"A": np.eye(3), "B": np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])}
# name → seat, true and stated temperature, °C
RUNS = {
    "A-cold": ("A", 5.0, 5.0), "A-mild": ("A", 20.0, 20.0), "B-cold": ("B", 5.0, 5.0), "B-mild": ("B", 20.0, 20.0),
    "A-unknown": ("A", 46.0, 25.0),
}  # fmt: skip
THERMAL = ("accel_bias", "accel_scale_factor", "accel_bias_temperature")


def rows(seat: str, temperature: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return angles, rad, and outputs of the three channels, LSB."""
    angle = np.arange(24) * np.pi / 12
    in_table = np.stack([-np.sin(angle), -np.cos(angle), np.zeros(24)], axis=1)  # specific force at rest, g
    felt = in_table @ SEATS[seat]
    outputs = [
        SCALE * (1 + 1e-6 * PPM[name]) * (felt[:, k] + 1e-6 * (BIASES[name] + SLOPES[name] * (temperature - 25)))
        for k, name in enumerate(SLOPES)
    ]
    return angle, np.stack(outputs, axis=1) + NOISE / np.sqrt(SAMPLES) * rng.standard_normal((24, 3))


def measured(uncertainty: float | None, seed: int = 4) -> Campaign:
    """Return the campaign, the temperature of one run stated with an uncertainty, °C."""
    rng, runs = np.random.default_rng(seed), []
    for name, (seat, true, stated) in RUNS.items():
        angle, outputs = rows(seat, true, rng)
        covariates = {"table_rate": 0 * angle, "table_angle": angle, "table_angle_span": 0 * angle}
        runs.append(
            Run(
                name, "dividing_head", "head", seat, {**covariates, "temperature": np.full(24, stated)}, outputs,
                np.full(24, SAMPLES), np.full((24, 3), np.nan),
                temperature_uncertainty=uncertainty if name == "A-unknown" else None,
            )
        )  # fmt: skip
    channels = tuple(
        Channel(
            name, "accelerometer", np.roll(np.eye(3), -k, axis=0), "LSB", SCALE, "g", SCALE / GRAVITY, noise=NOISE,
        )
        for k, name in enumerate(SLOPES)
    )  # fmt: skip
    table = Table("head", np.pi / 2, 0.0, 0.0, 0.0, 0.0)
    seats = {name: Mounting(name, matrix, 0.0) for name, matrix in SEATS.items()}
    return Campaign("thermal", Site(0.9, 60.0, GRAVITY), channels, {"head": table}, seats, tuple(runs))


def thermal(*more: str) -> ModelSpec:
    return ModelSpec("thermal", tuple(EffectSpec(name) for name in (*THERMAL, *more, "white_noise")))


def fitted(model: Model) -> tuple[dict[str, tuple[float, float]], np.ndarray, np.ndarray]:
    """Return estimate and standard deviation by parameter, the mode and the precision."""
    mode = find_mode(model.problem, *(jnp.zeros(size) for size in model.problem.size))
    assert mode.converged
    precision = np.asarray(posterior_precision(model.problem, mode))
    deviation = np.sqrt(np.diag(np.linalg.inv(precision)))
    pairs = zip(model.layout.parameters, np.asarray(mode.z), deviation, strict=True)
    width = {p.name: float(p.prior.sd()) / p.factor for p in model.layout.parameters}
    found = {p.name: (width[p.name] * float(z), width[p.name] * float(sd)) for p, z, sd in pairs}
    return found, np.asarray(mode.z), precision


def slope_errors(found: dict[str, tuple[float, float]]) -> dict[str, float]:
    """Return how far off the slopes are, in their standard deviations."""
    stated = {name: found[f"accel_bias_temperature.slope[{name}]"] for name in SLOPES}
    return {name: (value - SLOPES[name]) / sd for name, (value, sd) in stated.items()}


@pytest.mark.slow
def test_an_uncertain_temperature_is_estimated_and_the_slopes_are_right():
    found, *_ = fitted(bind(thermal("thermometer_error"), measured(15.0)))
    assert max(map(abs, slope_errors(found).values())) < 2.5
    offset, sd = found["thermometer_error.offset[A-unknown]"]
    assert 25 + offset == pytest.approx(46.0, abs=2.5 * sd)
    assert 0.05 < sd < 1.0
    exact, *_ = fitted(bind(thermal(), measured(None)))
    assert all(abs(error) > 3 for error in slope_errors(exact).values())


def test_an_uncertainty_enters_a_model_that_does_not_list_it():
    names = bind(thermal(), measured(15.0)).layout.names
    assert names == bind(thermal("thermometer_error"), measured(15.0)).layout.names
    assert [name for name in names if name.startswith("thermometer")] == ["thermometer_error.offset[A-unknown]"]


def test_a_model_without_effects_of_temperature_needs_none():
    plain = ModelSpec("plain", tuple(EffectSpec(name) for name in ("accel_bias", "accel_scale_factor", "white_noise")))
    assert not any("thermometer" in name for name in bind(plain, measured(15.0)).layout.names)


@pytest.mark.parametrize("uncertainty", [None, 0.0])
def test_without_an_uncertainty_nothing_changes(uncertainty):
    with_it, without = (bind(thermal(*more), measured(uncertainty)) for more in (("thermometer_error",), ()))
    assert with_it.layout.names == without.layout.names
    z = np.linspace(-1, 1, len(without.layout))
    np.testing.assert_allclose(predict(with_it.problem, z), predict(without.problem, z), rtol=1e-12)


def test_one_uncertain_run_leaves_the_others_exact():
    known, uncertain = bind(thermal(), measured(None)), bind(thermal(), measured(15.0))
    z = np.linspace(-1, 1, len(known.layout))
    at = uncertain.layout.carried(known.layout, z, np.zeros(len(uncertain.layout)))
    np.testing.assert_allclose(predict(uncertain.problem, at), predict(known.problem, z), rtol=1e-9)


@pytest.mark.slow
def test_a_temperature_far_from_what_was_stated_is_told():
    model = bind(thermal(), measured(1.0))
    _, z, precision = fitted(model)
    (conflict,) = prior_conflicts(model, z, precision)
    assert conflict.name == "thermometer_error.offset[A-unknown]"
    assert conflict.stated_in == "campaign"
    assert conflict.distance > 15


@pytest.mark.slow
def test_it_is_of_the_run_and_no_part_of_the_calibration():
    model = bind(thermal(), measured(15.0))
    derived = derived_quantities(model.assembly).derivation
    own = np.array(["thermometer" in name for name in model.layout.names])
    values = (np.concatenate([0.3 * ~own + size * own, model.assembly.nulls]) * 1e-3 for size in (0.0, 5000.0))
    without, with_it = map(derived, values)
    np.testing.assert_array_equal(with_it, without)


def test_a_value_for_several_runs_is_refused():
    entry = EffectSpec("thermometer_error", per="all")
    with pytest.raises(InputError, match="cannot have one value per all"):
        bind(replace(thermal(), effects=(*thermal().effects, entry)), measured(15.0))


def test_what_a_campaign_can_show():
    for uncertainty, runs, missing in ((15.0, ("A-unknown",), ()), (None, (), ("temperature uncertainty",))):
        by_name = {each.effect_class.name: each for each in observability(measured(uncertainty))}
        found = by_name["thermometer_error"]
        assert (found.runs, found.missing) == (runs, missing)
        assert by_name["pose_attitude"].missing == ("free tumble",)


def with_temperatures(campaign: Campaign) -> Campaign:
    least = dict.fromkeys(("temperature", "converter_temperature"), 25.0)
    runs = [
        replace(run, covariates={name: np.full(run.rows, at) for name, at in least.items()} | dict(run.covariates))
        for run in campaign.runs
    ]
    return replace(campaign, runs=tuple(runs))


WARM = (
    "gyro_bias", "accel_bias", "gyro_bias_temperature", "gyro_scale_temperature", "accel_scale_temperature",
    "gyro_thermal_lag", "accel_thermal_hysteresis", "gyro_bias_temperature_rate",
)  # fmt: skip
CONVERTERS = ("gyro_bias", "accel_bias", "converter_gain_drift", "converter_offset_drift")


@pytest.mark.parametrize(
    ("campaign", "run", "covariate", "effects"),
    [
        (wide_campaign, "cycle-fast", "temperature", WARM),
        (wide_campaign, "cycle-fast", "converter_temperature", CONVERTERS),
        pytest.param(
            tumble_campaign, "tumble", "temperature", ("gyro_bias", "accel_bias", "gyro_bias_temperature"),
            marks=pytest.mark.slow,
        ),
        pytest.param(
            driven_campaign, "day", "temperature", ("gyro_bias", "gyro_bias_temperature", "gyro_scale_temperature"),
            marks=pytest.mark.slow,
        ),
    ],
)  # fmt: skip
def test_an_offset_is_another_temperature_in_the_whole_run(campaign, run, covariate, effects):
    """In rows, in the turns between poses and on a table that the gyro drives alike."""
    off, known = 7.0, with_temperatures(campaign())
    noise = ("white_noise", "rotation_closure") if run == "tumble" else ("white_noise",)

    def changed(**how) -> Campaign:
        return replace(known, runs=tuple(replace(each, **how) if each.name == run else each for each in known.runs))

    (own,) = (each for each in known.runs if each.name == run)
    shifted = changed(covariates={**own.covariates, covariate: own.covariates[covariate] + off})
    plain, warm, uncertain = (
        bind(spec(*effects, noise=noise), each)
        for each in (known, shifted, changed(**{f"{covariate}_uncertainty": 2.0}))
    )
    z = 0.5 * np.cos(np.arange(len(plain.layout)))
    name = {"temperature": "thermometer_error", "converter_temperature": "converter_thermometer_error"}[covariate]
    start = np.where(np.array(uncertain.layout.names) == f"{name}.offset[{run}]", off / 2.0, 0.0)
    assert np.count_nonzero(start) == 1
    at = uncertain.layout.carried(plain.layout, z, start)
    expected, found = predict(warm.problem, z), predict(uncertain.problem, at)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)
    moved = np.asarray(expected) != np.asarray(predict(plain.problem, z))
    assert set(plain.entries.run[moved]) == {[each.name for each in known.runs].index(run)}
    if run == "tumble":
        assert moved[plain.entries.closing].any()
