"""Several effects that are missing at once: each is named, and none that they imitate together is named for sure.

The planted effect is worked out here, or made by generators that share no code with the package.
"""

from dataclasses import replace
from pathlib import Path

import geographic_tumble
import numpy as np
import pytest
from null_data import fitted_to
from planted_data import member, names, of_typical, planted, probability, random_fit, signal, surely_wrong, told
from simulate import write_simulated

import imubayes.api
from imubayes.criticism.diagnose import judge
from imubayes.display.loop.diagnosis_report import next_command
from imubayes.inference.fitted_model import Fit
from imubayes.model.model_file import read_model
from imubayes.results.result import Result

# Sizes over the noise of a row of the curve that each channel gets, at the largest input: one effect each.
CURVES = {"gx": 3e4, "gy": 1e4, "gz": 3e3, "ax": 1e3, "ay": 3e2, "az": 1e2}
PLANTED = {
    "gyro_scale_asymmetry", "gyro_scale_quadratic", "gyro_scale_cubic", "accel_quadratic", "accel_cubic",
    "accel_scale_asymmetry", "converter_nonlinearity",
}  # fmt: skip
"""The last one is a square and a cube, on all channels of a kind."""
MODEL = Path(__file__).parents[2] / "models" / "geographic-tumble.toml"
LACKING = ("station_heading", "station_level", "gyro_scale_factor")
CAUSES = {"station_heading", "gyro_scale_factor"}
DRIFT = ("gyro_bias.", "gyro_g_sensitivity.", "gyro_g2_sensitivity.")


def curved(fitted: Fit, times: float = 1.0) -> Fit:
    """Return a fit to fresh data, every channel with another curve of its input."""
    entries, channels, x = fitted.model.entries, fitted.model.campaign.channels, signal(fitted)
    change = np.zeros(len(entries))
    shapes = (np.abs, np.square, lambda u: u**3, np.square, lambda u: u**3, np.abs)
    for place, (channel, shape) in enumerate(zip(channels, shapes, strict=True)):
        here = (entries.channel == place) & ~entries.closing
        u = x[here] / np.abs(x[here]).max()
        change[here] = times * CURVES[channel.name] * channel.noise / 10 * shape(u)
    return planted(fitted, 3, change)


@pytest.mark.slow
@pytest.mark.xfail(
    strict=True,
    reason="a function of a rate and a force on gz leads with 0.76, an effect missing has 0.22, and "
    "converter_saturation on gx is named beside them with 0.985: the linear model stands too far off",
)
def test_where_a_great_deal_is_missing_its_effects_are_named() -> None:
    found = judge(curved(fitted_to("hidden-none")))
    assert probability(found, "effects") > 0.9, told(found)
    named = [group.effects for group in found.groups]
    assert len(named) >= 2, told(found)
    assert all(set(effects) & PLANTED for effects in named), told(found)
    assert not surely_wrong(found, *PLANTED), told(found)
    assert found.suggested is not None
    assert next_command(found).startswith(f"imubayes add {found.suggested.effects[0]} ")


@pytest.mark.slow
def test_three_of_very_different_size_are_named_together() -> None:
    """An asymmetry, a cube and a square on three gyros, ten to a thousand times the noise."""
    fitted = fitted_to("hidden-none")
    entries, x = fitted.model.entries, signal(fitted)
    change = np.zeros(len(entries))
    for place, (size, shape) in enumerate([(300.0, np.abs), (30.0, lambda u: u**3), (100.0, np.square)]):
        here = (entries.channel == place) & ~entries.closing
        u = x[here] / np.abs(x[here]).max()
        channel = fitted.model.campaign.channels[place]
        assert channel.noise is not None
        change[here] = size * channel.noise / 10 * shape(u)
    found = judge(planted(fitted, 6, change))
    assert probability(found, "effects") > 0.9, told(found)
    by_channel = {group.channels: set(group.effects) for group in found.groups}
    for channel, effect in (("gx", "gyro_scale_asymmetry"), ("gy", "gyro_scale_cubic"), ("gz", "gyro_scale_quadratic")):
        assert effect in by_channel.get((channel,), set()), told(found)
    assert not surely_wrong(found, *PLANTED), told(found)


@pytest.mark.slow  # compiles a campaign of its own
def test_one_between_runs_and_one_within_are_both_named() -> None:
    polar = fitted_to("polar-tumble", "polar-tumble")
    change = of_typical(polar, "gyro_magnetic_sensitivity", 0.3) + of_typical(polar, "table_wobble", 10.0)
    found = judge(planted(polar, 5, change))
    assert names(found, "gyro_magnetic_sensitivity", "table_wobble"), told(found)
    assert not surely_wrong(found, "gyro_magnetic_sensitivity", "table_wobble"), told(found)


def fitted(folder: Path, seed: int) -> tuple[Result, dict[str, float]]:
    """Return the fit of a model of positions that lacks both causes, and the truth.

    On a station whose north is off by 8 arcmin, with a scale factor in error, an error of the level explains the
    outputs nearly as well.
    """
    plan = geographic_tumble.plan(seed, model=MODEL)
    random = np.random.default_rng([77, seed])
    scale = float(random.uniform(1500, 3500) * random.choice([-1, 1]))
    truth = plan.draw(seed) | {
        "station_heading.heading[all]": 480.0 * (-1) ** seed,
        "station_level.east[all]": 0.0,
        "station_level.north[all]": 0.0,
        "gyro_scale_factor.scale[g]": scale,
    }
    folder.mkdir(parents=True)
    write_simulated(folder, plan, seed, values=truth)
    spec = read_model(MODEL)
    spec = replace(spec, effects=tuple(one for one in spec.effects if one.name not in LACKING))
    return imubayes.api.fit(folder, spec, sample=False), truth


def scores(result: Result, truth: dict[str, float]) -> np.ndarray:
    """Return (mean − truth)/sd of the drift terms."""
    own = [one for one in result.summary.parameters if one.name.startswith(DRIFT)]
    return np.array([(one.mean - truth[one.name]) / one.sd for one in own])


@pytest.mark.slow  # compiles a campaign of its own
@pytest.mark.parametrize("seed", [1, 4])
def test_what_two_causes_imitate_together_is_not_named_for_sure(tmp_path: Path, seed: int) -> None:
    result, _ = fitted(tmp_path / "campaign", seed)
    found = imubayes.api.diagnose(result)
    assert found.verdict in ("missing_effect", "equivalent_effects"), told(found)
    assert not surely_wrong(found, *CAUSES), told(found)
    sure = [group.effects for group in found.groups if group.probability >= 0.9 and len(group.effects) == 1]
    assert ("station_level",) not in sure, told(found)


@pytest.mark.slow
@pytest.mark.xfail(reason="one cause that fits as well as two is thirty times as likely beforehand: 2 of 20 confirmed")
def test_no_imitation_is_confirmed(tmp_path: Path) -> None:
    """What the loop ends with is right, or was said to be one of several explanations."""
    wrong = confirmed = right = 0
    for seed in range(100, 120):
        result, truth = fitted(tmp_path / str(seed), seed)
        verdicts: list[str] = []
        while len(verdicts) < 4 and (found := imubayes.api.diagnose(result)).suggested is not None:
            verdicts.append(found.verdict)
            wrong += found.verdict == "missing_effect" and found.groups[0].effects == ("station_level",)
            result = imubayes.api.add(result, diagnosis=found).result
        far = np.abs(scores(result, truth)).max()
        right += far < 4
        confirmed += far >= 4 and "equivalent_effects" not in verdicts
        print(seed, verdicts, f"{far:.1f}", flush=True)
    print(f"of 20: right {right}, level named alone {wrong}, wrong and confirmed {confirmed}")
    assert (wrong, confirmed) == (0, 0)


@pytest.mark.slow
@pytest.mark.xfail(reason="a bias drift of all axes fits as well, within a nat, and is simpler: it is named alone")
def test_a_bias_drift_of_one_axis_beside_a_scale_drift_of_all(tmp_path: Path) -> None:
    """If both have to act on all axes, the bias drift is named alone, on axes that have none."""
    own, truth = random_fit(tmp_path / "campaign", 310018, "two")
    assert {(one.effect, one.channels) for one in truth} == {
        ("accel_bias_temperature", ("ax",)),
        ("accel_scale_temperature", ("ax", "ay", "az")),
    }
    found = judge(own)
    assert names(found, *(one.effect for one in truth)), told(found)
    bias = member(found, "accel_bias_temperature")
    assert bias is not None
    assert bias.channels == ("ax",), told(found)
    assert not surely_wrong(found, *(one.effect for one in truth)), told(found)
