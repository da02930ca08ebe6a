"""Planting: the size is the size asked for, and the tally is that of the screen's answers."""

from dataclasses import replace

import numpy as np
import pytest
from loop_results import CAMPAIGN, lacking_model

from imubayes.campaign import load_campaign
from imubayes.criticism.diagnosis_record import Diagnosis, EffectGroup, ScreenedEffect
from imubayes.criticism.explanation_records import RmsChange, Verdict
from imubayes.display.loop.change_report import injection_json
from imubayes.foundations.errors import InputError
from imubayes.inference.fitted_model import Fit
from imubayes.inference.run_fit import joint_fit
from imubayes.loop.injection_recovery import Size, plant_effects, refitted
from imubayes.loop.warm_start import extend
from imubayes.model.bind import bind


@pytest.fixture(scope="module")
def fitted() -> Fit:
    model = bind(lacking_model(), load_campaign(CAMPAIGN))
    return joint_fit(model, None)


def answer(verdict: Verdict, *effects: str) -> Diagnosis:
    rms = RmsChange(channel="ax", before=2.0, after=1.0, unit="ug")
    share = 1 / max(len(effects), 1)
    candidates = tuple(
        ScreenedEffect(effect=name, channels=("ax",), probability=share, delta_chi2=50.0, shape={}, coefficients=())
        for name in effects
    )
    group = EffectGroup(
        channels=("ax",), probability=0.99, log_odds=20.0, delta_chi2=50.0, candidates=candidates, residual=rms,
        covariate=None,
    )  # fmt: skip
    return Diagnosis(verdict=verdict, groups=(group,) if effects else ())


def test_the_planted_size_is_the_size_asked_for(fitted):
    """The screen sees data in which a refit would find it: chi² falls by 400, give or take the noise (sd 40)."""
    drops = []

    def screen(one: Fit) -> Diagnosis:
        # A fit without the effect takes it for noise; what was asked for counts in the noise of the simulation.
        drops.append(extend(replace(one, h=fitted.h), ["converter_offset_drift"]).delta_chi2)
        return answer("missing_effect", "converter_offset_drift")

    found = plant_effects(fitted, ["converter_offset_drift"], Size(400.0), 1, 5, screen=screen)
    (trial,) = found.trials
    assert trial.delta_chi2 == pytest.approx(400, rel=0.03)
    null, planted = drops
    truth = trial.planted[0].value
    assert truth != 0
    assert null < 30
    assert abs(planted - 400) < 5 * np.sqrt(2 + 4 * 400)


def test_the_typical_size(fitted):
    found = plant_effects(fitted, ["accel_quadratic"], Size(typical=2.0), 0, 0, screen=lambda _: answer("adequate"))
    assert abs(found.trials[0].planted[0].value) == pytest.approx(100)
    assert injection_json(found)["size"] == {"typical": 2.0}


@pytest.mark.parametrize(
    ("said", "detected", "first"),
    [
        (answer("adequate"), False, False),
        (answer("missing_effect", "accel_cubic"), True, False),
        (answer("equivalent_effects", "accel_cubic", "accel_quadratic"), True, True),
        (answer("not_converged"), False, False),
    ],
)
def test_the_tally(fitted, said, detected, first):
    found = injection_json(plant_effects(fitted, ["accel_quadratic"], Size(), 2, 0, screen=lambda _: said))
    assert (found["effects"][0]["detected"], found["effects"][0]["group_first"]) == (detected, first)
    assert found["null"]["false_alarms"] == (0 if said.verdict == "adequate" else 2)
    low, high = found["null"]["interval_95"]
    assert 0 <= low <= found["null"]["rate"] <= high <= 1


def test_what_no_run_shows_is_skipped_or_refused_when_asked_for(fitted):
    with pytest.raises(InputError, match="no run can show"):
        plant_effects(fitted, ["accel_bias_temperature_rate"], Size(), 0, 0, screen=lambda _: answer("adequate"))


def test_a_refit_ends_where_a_fit_ends(fitted):
    again = refitted(fitted, fitted.model.campaign)
    assert again.converged
    assert np.allclose(again.z, fitted.z, atol=1e-2)
