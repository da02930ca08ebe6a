"""A finding says whether the data tell the stage of the signal chain at which it acts.

What is planted, and what a converter driven alone would do, is worked out here from the outputs, without the package's
effects.
"""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from null_data import fitted_to, redrawn

from imubayes.criticism import chain_stage, stepwise_search
from imubayes.criticism.candidate_effects import candidate_responses, moved_responses
from imubayes.criticism.diagnose import judge
from imubayes.criticism.diagnosis_record import ChainStage, Diagnosis
from imubayes.display.diagnosis_report import diagnosis_lines, next_command
from imubayes.display.diagnosis_sentences import sentence
from imubayes.effects.base import Stage
from imubayes.inference.fitted_model import Fit
from imubayes.model.bound_effects import Move
from imubayes.model.problem import predict


def signal(fitted: Fit) -> np.ndarray:
    """Return the predicted outputs less their offset, (E,)."""
    offsets = np.array([channel.offset for channel in fitted.model.campaign.channels])
    predicted = np.asarray(predict(fitted.model.problem, jnp.asarray(fitted.z)))
    return predicted - offsets[fitted.model.entries.channel]


def without(monkeypatch: pytest.MonkeyPatch, fitted: Fit, effect: str) -> Diagnosis:
    """Return the diagnosis with an effect taken out of the catalogue."""

    def lacking(at: Any, *more: Any) -> Any:
        found = candidate_responses(at, *more)
        return replace(found, candidates=tuple(each for each in found.candidates if each.scan.effect != effect))

    monkeypatch.setattr(stepwise_search, "candidate_responses", lacking)
    return judge(fitted)


def test_a_dead_zone_is_of_gyro_or_converter(monkeypatch):
    fitted = fitted_to("geographic-tumble", "geographic-tumble")
    through = signal(fitted)
    width = 0.1 * np.abs(through).max()
    found = without(monkeypatch, redrawn(fitted, 3, change=-np.clip(through, -width, width)), "gyro_dead_zone")
    assert found.groups[0].effects == ("converter_dead_zone",)
    assert found.groups[0].stage == ChainStage(named="converter", sensor="gyro", determined=False)
    assert "Whether it acts in the gyro or in its converter is not determined" in sentence(found)


def test_what_the_runs_do_not_distinguish_is_suggested_together():
    fitted = fitted_to("geographic-tumble", "geographic-tumble")
    through = signal(fitted)
    width = 0.1 * np.abs(through).max()
    found = judge(redrawn(fitted, 3, change=-np.clip(through, -width, width)))
    both = {"converter_dead_zone", "gyro_dead_zone"}
    assert both <= set(found.groups[0].effects)
    assert found.suggested is not None
    assert both <= set(found.suggested.effects)
    assert next_command(found).startswith(f"imubayes add {' '.join(found.suggested.effects)} --to RESULT")
    [told] = [line for line in diagnosis_lines(found) if line.startswith("Indistinguishable in these runs: ")]
    assert "The posterior with all of them in the model holds each explanation." in told


def test_what_acts_across_the_input_axis_is_of_the_sensor():
    fitted = fitted_to("geographic-tumble", "geographic-tumble")
    [across] = [each for each in candidate_responses(fitted).candidates if each.scan.effect == "gyro_misalignment"]
    sizes = 6 * np.array([coefficient.typical[1] for coefficient in across.coefficients])
    found = judge(redrawn(fitted, 7, change=across.columns @ (sizes * np.array([0.8, -0.6]))))
    assert "gyro_misalignment" in found.groups[0].effects
    assert found.groups[0].stage == ChainStage(named="sensor", sensor="gyro", determined=True)
    assert "not determined" not in sentence(found)


def test_a_converter_that_is_driven_alone_shows_its_own():
    """Moved to the converter, K2 acts on injected inputs as well, and is told from K2 of the sensor by them."""
    fitted = fitted_to("accel-channel", "accel-channel")
    own = next(each for each in candidate_responses(fitted, only=["accel_quadratic"]).candidates)
    to = Move(Stage.CONVERTER, (("temperature", "converter_temperature"),))
    [moved] = moved_responses(fitted, ["accel_quadratic"], lambda effect: to).candidates
    entries, [channel] = fitted.model.entries, fitted.model.campaign.channels
    runs = [run.procedure == "current_injection" for run in fitted.model.campaign.runs]
    injected = np.array(runs)[entries.run]
    quadratic = signal(fitted) ** 2 / channel.scale_si
    unit = own.coefficients[0].parameter.factor
    assert np.count_nonzero(injected) > 10
    assert not np.any(own.columns[injected])
    assert moved.columns[injected, 0] / unit == pytest.approx(quadratic[injected], rel=0.02)
    assert moved.columns[~injected] == pytest.approx(own.columns[~injected], rel=0.05)


@pytest.mark.slow
def test_a_curve_about_another_zero_is_of_sensor_or_converter(monkeypatch):
    """A cube with a little square is a cube about another zero: that of the converter is not that of the sensor."""
    fitted = fitted_to("desk-imu", "desk-imu")
    entries, channels = fitted.model.entries, fitted.model.campaign.channels
    place = [channel.name for channel in channels].index("ay")
    outputs = np.asarray(predict(fitted.model.problem, jnp.asarray(fitted.z))) - channels[place].offset
    through = np.where(entries.channel == place, outputs, 0.0)
    share = through / np.abs(through).max()
    planted = redrawn(fitted, 1, change=-0.02 * share**2 - 0.156 * share**3)
    found = without(monkeypatch, planted, "converter_nonlinearity")
    assert found.groups[0].effects == ("accel_cubic",)
    assert found.groups[0].stage == ChainStage(named="sensor", sensor="accelerometer", determined=False)
    # Planted fault: the zero of the curve is held.
    monkeypatch.setattr(chain_stage, "_is_curve", lambda *_: False)
    held = judge(planted).groups[0].stage
    assert held is not None
    assert held.determined
