"""Runs that name one thermometer share its error: by outputs that NumPy alone computes, and by hand.

With one temperature error δ in all runs, a bias at 25 °C is off by −c δ, c its temperature coefficient, and c is not.
"""

from dataclasses import replace

import numpy as np
import pytest
from test_thermometer_error import RUNS, SLOPES, measured, rows, thermal

from imubayes.foundations.campaign_data import Campaign, Thermometer
from imubayes.foundations.errors import InputError
from imubayes.model.bind import Model, bind
from imubayes.model.bound_effects import observability
from imubayes.model.model_file import EffectSpec
from imubayes.model.problem import predict
from small_campaign import spec, wide_campaign

NOISE_OF_MEAN = 0.4  # LSB, of the channels of `measured`
OFFSET, GAIN = "thermometer_calibration.offset[Pt]", "thermometer_calibration.gain[Pt]"


def read_by(thermometer: Thermometer, *names: str, off: float = 0.0) -> Campaign:
    """Return the campaign with runs read by a thermometer that reads less than the truth by `off`, °C."""
    rng, campaign, runs = np.random.default_rng(5), measured(None), []
    for run in campaign.runs:
        seat, true, _ = RUNS[run.name]
        own = run.name in names
        read = run.covariates | {"temperature": np.full(run.rows, true - off * own)}
        thermal = replace(run, observed=rows(seat, true, rng)[1], covariates=read, thermometer="Pt" if own else None)
        runs.append(thermal)
    return replace(campaign, runs=tuple(runs), thermometers={"Pt": thermometer})


def posterior(model: Model) -> tuple[dict[str, float], np.ndarray, list[str]]:
    """Return estimates by name, their covariance, and the names: Gauss–Newton with differences, noise known."""
    layout, size = model.layout, len(model.layout)
    width = np.array([p.prior_sd for p in layout.parameters])
    z = np.zeros(size)
    observed = np.asarray(model.entries.value)
    for _ in range(4):
        at = np.asarray(predict(model.problem, z))
        columns = [
            (np.asarray(predict(model.problem, z + 1e-3 * step)) - np.asarray(predict(model.problem, z - 1e-3 * step)))
            / 2e-3
            for step in np.eye(size)
        ]
        jacobian = np.stack(columns, axis=1) / NOISE_OF_MEAN
        covariance = np.linalg.inv(jacobian.T @ jacobian + np.eye(size))
        z = z + covariance @ (jacobian.T @ ((observed - at) / NOISE_OF_MEAN) - z)
    return dict(zip(layout.names, width * z, strict=True)), covariance * np.outer(width, width), list(layout.names)


def test_a_common_offset_of_two_runs_is_recovered():
    """The other runs are exact, and the two that name the thermometer have one parameter."""
    found, covariance, names = posterior(
        bind(thermal(), read_by(Thermometer("Pt", 5.0, 0.0), "A-mild", "B-mild", off=3.0))
    )
    assert [name for name in names if "thermometer" in name] == [OFFSET]
    sd = np.sqrt(covariance[names.index(OFFSET), names.index(OFFSET)])
    assert sd < 0.5
    assert found[OFFSET] == pytest.approx(3.0, abs=3 * sd)


def test_an_uncertainty_of_all_runs_is_fully_correlated():
    """By hand: Cov = Cov of exact temperatures + c cᵀ u² of the biases at 25 °C, and nothing for their slopes."""
    u, names = 0.8, [run.name for run in measured(None).runs]
    _, exact, of_exact = posterior(bind(thermal(), read_by(Thermometer("Pt", 0.0, 0.0), *names)))
    found, wide, of_wide = posterior(bind(thermal(), read_by(Thermometer("Pt", u, 0.0), *names)))
    biases, slopes = (
        [f"{effect}[{name}]" for name in SLOPES] for effect in ("accel_bias.bias", "accel_bias_temperature.slope")
    )
    block = [of_wide.index(name) for name in biases]
    before = exact[np.ix_(*[[of_exact.index(name) for name in biases]] * 2)]
    c = np.array([found[name] for name in slopes])
    np.testing.assert_allclose(c, list(SLOPES.values()), atol=2.0)
    added = wide[np.ix_(block, block)] - before
    np.testing.assert_allclose(added, np.outer(c, c) * u**2, rtol=0.02, atol=0.01 * np.max(np.abs(c)) ** 2 * u**2)
    for name in slopes:
        own, plain = wide[(of_wide.index(name),) * 2], exact[(of_exact.index(name),) * 2]
        assert own == pytest.approx(plain, rel=1e-3), name
    # Errors of each run for itself are another model: they widen the slopes.
    alone = replace(read_by(Thermometer("Pt")), thermometers={})
    alone = replace(alone, runs=tuple(replace(run, temperature_uncertainty=u) for run in alone.runs))
    _, apart, of_apart = posterior(bind(thermal(), alone))
    assert all(apart[(of_apart.index(name),) * 2] > 1.5 * exact[(of_exact.index(name),) * 2] for name in slopes)


def test_a_gain_is_another_temperature_and_another_rate_of_it():
    off, gain, known = 1.5, 0.02, wide_campaign()
    effects = (
        "gyro_bias",
        "accel_bias",
        "gyro_bias_temperature",
        "accel_bias_temperature",
        "gyro_bias_temperature_rate",
    )
    run = next(
        run for run in known.runs if "temperature" in run.covariates and np.ptp(run.covariates["temperature"]) > 5
    )

    def changed(**how) -> Campaign:
        return replace(
            known, runs=tuple(replace(each, **how) if each.name == run.name else each for each in known.runs)
        )

    read = run.covariates["temperature"]
    true = bind(spec(*effects), changed(covariates={**run.covariates, "temperature": read + off + gain * (read - 25)}))
    shared = replace(changed(thermometer="Pt"), thermometers={"Pt": Thermometer("Pt", 2.0, 0.03)})
    model = bind(spec(*effects), shared)
    z = 0.5 * np.cos(np.arange(len(true.layout)))
    start = np.zeros(len(model.layout))
    start[model.layout.index(OFFSET)], start[model.layout.index(GAIN)] = off / 2.0, gain / 0.03
    at = model.layout.carried(true.layout, z, start)
    np.testing.assert_allclose(predict(model.problem, at), predict(true.problem, z), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("stated", "names"), [((None, None), []), ((0.0, 0.0), []), ((1.0, None), [OFFSET]), ((0.0, 0.01), [GAIN])]
)
def test_what_is_not_stated_or_exact_is_no_parameter(stated, names):
    model = bind(thermal(), read_by(Thermometer("Pt", *stated), "A-cold"))
    assert [name for name in model.layout.names if "thermometer" in name] == names


def test_a_run_has_the_error_of_its_thermometer_and_its_own():
    campaign = read_by(Thermometer("Pt", 1.0), "A-cold", "A-mild")
    runs = tuple(replace(run, temperature_uncertainty=0.3) if run.name == "A-mild" else run for run in campaign.runs)
    names = bind(thermal(), replace(campaign, runs=runs)).layout.names
    assert [name for name in names if "thermometer" in name] == ["thermometer_error.offset[A-mild]", OFFSET]


def test_the_error_of_a_thermometer_is_of_no_run():
    entry = EffectSpec("thermometer_calibration", per="run")
    with pytest.raises(InputError, match="cannot have one value per run"):
        bind(replace(thermal(), effects=(*thermal().effects, entry)), read_by(Thermometer("Pt", 1.0), "A-cold"))


def test_what_a_campaign_can_show_of_a_thermometer():
    cases = (
        (Thermometer("Pt", 1.0), ("A-cold",), ("A-cold",), ()),
        (Thermometer("Pt"), ("A-cold",), (), ("thermometer uncertainty",)),
        (Thermometer("Pt", 1.0), (), (), ("thermometer",)),
    )
    for thermometer, readers, runs, missing in cases:
        by_name = {each.effect_class.name: each for each in observability(read_by(thermometer, *readers))}
        found = by_name["thermometer_calibration"]
        assert (found.runs, found.missing) == (runs, missing)
