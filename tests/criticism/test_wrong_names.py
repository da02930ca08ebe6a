"""If the catalogue lacks the cause, no other effect is named beyond reasonable doubt.

The planted effect is worked out here, from a response that is then taken out of the catalogue, or by generators that
share no code with the package.
"""

from collections.abc import Sequence

import numpy as np
import pytest
from null_data import fitted_to
from planted_data import names, of_typical, planted, probability, signal, standing, surely_wrong, told, without

from imubayes.criticism.diagnose import judge
from imubayes.criticism.diagnosis_record import Diagnosis
from imubayes.display.loop.diagnosis_report import diagnosis_json, effect_source
from imubayes.foundations.errors import InputError
from imubayes.inference.fitted_model import Fit
from imubayes.responses.candidate_effects import candidate_responses


def converter() -> Fit:
    return fitted_to("accel-channel", "accel-channel")


def positions() -> Fit:
    return fitted_to("geographic-tumble", "geographic-tumble")


def doubted(found: Diagnosis, *alike: str) -> None:
    """Fail if something is named for sure, but for effects that do the same, or nothing is said to be missing."""
    assert found.verdict != "adequate", told(found)
    assert probability(found, "nothing") < 0.5, told(found)
    assert not surely_wrong(found, *alike), told(found)


@pytest.mark.slow  # compiles a campaign of its own
def test_a_misalignment_is_no_magnetic_sensitivity(monkeypatch: pytest.MonkeyPatch) -> None:
    """In positions of one gyro the one looks like the other."""
    fitted = planted(positions(), 7, of_typical(positions(), "gyro_misalignment", 6.0))
    without(monkeypatch, "gyro_misalignment")
    doubted(judge(fitted))


@pytest.mark.slow
@pytest.mark.parametrize(
    "share",
    [
        0.003,
        pytest.param(
            0.1,
            marks=pytest.mark.xfail(
                strict=True,
                reason="what a large dead zone leaves by its curvature is a cause outside the catalogue with 0.88",
            ),
        ),
    ],
)
def test_a_dead_zone_of_the_gyro_is_one_of_its_converter(monkeypatch: pytest.MonkeyPatch, share: float) -> None:
    """Only the stage differs: if one is lacking the other is its name."""
    through = signal(positions())
    width = share * np.abs(through).max()
    without(monkeypatch, "gyro_dead_zone")
    found = judge(planted(positions(), 3, -np.clip(through, -width, width)))
    assert names(found, "converter_dead_zone"), told(found)
    assert found.groups[0].effects[0] == "converter_dead_zone"
    assert not surely_wrong(found, "converter_dead_zone"), told(found)


@pytest.mark.slow
def test_a_cube_is_no_saturation_where_three_levels_of_the_input_do_not_tell(monkeypatch: pytest.MonkeyPatch) -> None:
    """A converter loses gain by the square of its input: a saturation or a cube is alike at 0.6, 1 and 12 g."""
    change, _ = standing(converter(), "converter_nonlinearity", -20.0, place=1)
    fitted = planted(converter(), 21, change)
    without(monkeypatch, "converter_nonlinearity", "converter_gain_temperature_rate")
    doubted(judge(fitted))


@pytest.mark.slow
@pytest.mark.parametrize(
    "absent",
    [
        pytest.param(
            "converter_gain_lag",
            marks=pytest.mark.xfail(reason="play fits a lag of twenty times the noise within the noise: 0.96"),
        ),
        "converter_gain_hysteresis",
    ],
)
def test_another_kind_of_memory_is_not_sure(monkeypatch: pytest.MonkeyPatch, absent: str) -> None:
    """Twenty times the noise of a lag on the ramps of a converter is play as well if the catalogue lacks the lag."""
    fitted = planted(converter(), 77, standing(converter(), absent, 20.0)[0])
    without(monkeypatch, absent)
    doubted(judge(fitted))


@pytest.mark.slow
@pytest.mark.xfail(
    reason="what does the same and is not in the catalogue is no rival: only the size, said to be atypical"
)
@pytest.mark.parametrize("absent", ["accel_bias_temperature", "accel_scale_temperature"])
def test_an_effect_over_temperature_is_not_sure_at_one_force(monkeypatch: pytest.MonkeyPatch, absent: str) -> None:
    """The unit warms in runs of one force along ay: a bias and a scale factor over temperature look the same there."""
    rotation = fitted_to("rotation-modulation", "rotation-modulation")
    place = [each.name for each in rotation.model.campaign.channels if each.kind == "accelerometer"].index("ay")
    fitted = planted(rotation, 5, standing(rotation, absent, 40.0, place)[0])
    without(monkeypatch, absent)
    doubted(judge(fitted))


@pytest.mark.slow
def test_a_curve_about_another_zero_is_a_curve(monkeypatch: pytest.MonkeyPatch) -> None:
    """A cube with a little square is a cube about another zero: that of the converter is not that of the sensor."""
    desk = fitted_to("desk-imu", "desk-imu")
    entries, channels = desk.model.entries, desk.model.campaign.channels
    place = [channel.name for channel in channels].index("ay")
    through = np.where(entries.channel == place, signal(desk), 0.0)
    share = through / np.abs(through).max()
    fitted = planted(desk, 1, -0.02 * share**2 - 0.156 * share**3)
    without(monkeypatch, "converter_nonlinearity")
    doubted(judge(fitted), "accel_cubic")


def cubic_drift(fitted: Fit) -> np.ndarray:
    """Return a drift of the gyro as the third power of the rate of the arm, if the unit turns back, (E,).

    A scale factor linear in the force gives it: the force grows with the square of the rate, and the unit turns as fast
    as the arm.
    """
    entries, campaign = fitted.model.entries, fitted.model.campaign
    gyro = [channel.kind for channel in campaign.channels].index("gyro")
    drift = np.zeros(len(entries))
    for place, run in enumerate(campaign.runs):
        rate = run.covariates["outer_rate"]
        here = (entries.run == place) & (entries.channel == gyro) & ~entries.closing
        if run.name in ("counter-z-up", "counter-y-up"):
            drift[here] = -1.87e-3 * (rate / rate.max())[entries.row[here]] ** 3
    return drift


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_a_wobble_that_takes_most_of_a_drift_is_not_sure(monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    """The unit that turns back has next to no input rate: an asymmetry, which is of the input alone, explains none."""
    fitted = fitted_to("centrifuge", "centrifuge")
    drifting = planted(fitted, seed, cubic_drift(fitted))
    found = judge(drifting)
    assert names(found, "gyro_scale_g_dependence"), told(found)
    without(monkeypatch, "gyro_scale_g_dependence")
    doubted(judge(drifting))


def step(fitted: Fit, deviations: float) -> tuple[str, int, np.ndarray]:
    """Return a step in the middle of the longest run: the run, the last row before it, and the readings, (E,)."""
    entries, campaign = fitted.model.entries, fitted.model.campaign
    index, run = max(enumerate(campaign.runs), key=lambda pair: pair[1].rows)
    after = (entries.run == index) & (entries.channel == 0) & ~entries.closing & (entries.row >= run.rows // 2)
    noise = np.median(np.abs(np.diff(entries.value[after], 2))) / (0.6745 * np.sqrt(6))
    # Half of the rows lie to either side of it.
    return run.name, run.rows // 2, deviations * noise * after * 2 / np.sqrt(run.rows)


@pytest.mark.slow
def test_a_step_in_one_run_gets_no_name() -> None:
    run, row, change = step(converter(), 12.0)
    found = judge(planted(converter(), 4, change))
    assert found.verdict == "unexplained_structure", told(found)
    assert probability(found, "outside") > 0.9
    assert found.explanations is not None
    form = found.explanations.form
    assert form is not None
    assert form.name.startswith("step"), told(found)
    assert form.run == run
    assert form.row is not None
    assert abs(form.row - row) <= 4, (form.row, row)
    assert not found.groups, told(found)
    # What happens once has no formula: none is offered, and what comes next can be done.
    document = diagnosis_json(found)
    assert document["formulas"] == []
    assert document["next"].startswith("imubayes compare")
    with pytest.raises(InputError, match="no effect class"):
        effect_source(found)


@pytest.mark.slow
def test_a_narrow_bump_over_temperature_gets_no_name() -> None:
    """A feature of a twentieth of the range, for which a smooth curve is too stiff."""
    entries, campaign = converter().model.entries, converter().model.campaign
    warmth = np.full(len(entries), np.nan)
    for place, run in enumerate(campaign.runs):
        here = (entries.run == place) & ~entries.closing
        warmth[here] = run.covariates["converter_temperature"][entries.row[here]]
    low, high = np.nanmin(warmth), np.nanmax(warmth)
    bump = np.exp(-(((np.nan_to_num(warmth, nan=1e6) - low - 0.42 * (high - low)) / (0.04 * (high - low))) ** 2))
    sd = noise_of(converter(), ~entries.closing)
    found = judge(planted(converter(), 2, 20 * sd * bump / np.linalg.norm(bump)))
    doubted(found)
    assert probability(found, "outside") > 0.9, told(found)
    assert found.explanations is not None
    form = found.explanations.form
    assert form is not None
    assert "converter_temperature_degC" in form.covariates, told(found)


@pytest.mark.slow
@pytest.mark.parametrize(
    "shape",
    [
        pytest.param(
            np.sin,
            marks=pytest.mark.xfail(
                strict=True,
                reason="a saturation leads with more than 0.999, and what it leaves of the wave is named beside it: "
                "gyro_scale_cubic or converter_nonlinearity, with 1.0",
            ),
        ),
        np.cos,
    ],
    ids=["odd", "even"],
)
def test_a_wave_of_the_input_is_outside_of_the_catalogue(shape: np.ufunc) -> None:
    """Several periods over the range of the rate of gx."""
    fitted = fitted_to("hidden-none")
    entries = fitted.model.entries
    here = (entries.channel == 0) & ~entries.closing
    through = np.where(here, signal(fitted), 0.0)
    sd = noise_of(fitted, here)
    found = judge(planted(fitted, 9, 6.0 * sd * here * shape(9.0 * through / np.abs(through).max())))
    doubted(found)
    assert probability(found, "outside") > 0.9, told(found)
    assert found.formulas, told(found)
    assert {each.channel for each in found.formulas} == {"gx"}
    compile(diagnosis_json(found)["formulas"][0]["python"], "found_shape.py", "exec")


def noise_of(fitted: Fit, here: Sequence[bool] | np.ndarray) -> float:
    """Return the standard deviation of rows, as the residuals show it."""
    effect = "gyro_scale_asymmetry" if fitted.model.campaign.channels[0].kind == "gyro" else "accel_quadratic"
    return float(np.std(candidate_responses(fitted, [effect]).misfit[np.asarray(here)]))
