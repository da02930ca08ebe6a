"""A run or a row whose recorded input is wrong is named, with what would make it agree; sound campaigns agree.

The recordings are those of the simulators in `data/generators`, which share no code with the package.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from null_data import ROOT, fitted_to, refitted
from random_plans import random_plan
from simulate import write_simulated

from imubayes.campaign import load_campaign
from imubayes.campaign_data import Campaign
from imubayes.criticism import thresholds, wrong_runs
from imubayes.responses.candidate_effects import Responses
from imubayes.adequacy.deletion_diagnostics import linear_fit
from imubayes.criticism.disagreement_record import Disagreement
from imubayes.adequacy.run_agreement import agreement_of_runs, doubted_runs, known_before
from imubayes.inference.fitted_model import Fit
from imubayes.model.bind import bind
from imubayes.model.model_file import read_model


def recorded_as(fitted: Fit, run: str, column: str, change) -> Fit:
    """Return the fit where a column of one run was recorded otherwise."""
    campaign = fitted.model.campaign
    place = next(k for k, one in enumerate(campaign.runs) if one.name == run)
    values = change(np.array(campaign.runs[place].covariates[column]))
    return of_other(fitted, campaign, place, covariates={**campaign.runs[place].covariates, column: values})


def of_other(fitted: Fit, campaign: Campaign, place: int, **changed) -> Fit:
    runs = tuple(replace(one, **changed) if k == place else one for k, one in enumerate(campaign.runs))
    model = bind(fitted.model.spec, replace(campaign, runs=runs))
    return refitted(model, fitted.z, fitted.h)


def told(fitted: Fit) -> tuple[Disagreement, ...]:
    """Return what disagrees, beside no effect of the catalogue."""
    return wrong_runs.disagreements(fitted, Responses(np.zeros(0), np.zeros((0, 0)), (), {}), ())


def test_the_runs_of_a_sound_campaign_agree() -> None:
    fitted = fitted_to("hidden-none")
    assert not told(fitted)
    assert not doubted_runs(fitted)


def test_a_rate_that_is_wrong_in_one_run_is_named_with_its_factor() -> None:
    fitted = recorded_as(fitted_to("hidden-none"), "rate-y-up", "table_rate", lambda rate: 1.002 * rate)
    (found,) = told(fitted)
    assert (found.run, found.row) == ("rate-y-up", None)
    cause = next(each for each in found.causes if each.quantity == "table_rate_deg_s")
    # What would agree is the true rate, over that recorded.
    assert cause.agreeing[0] == pytest.approx(1 / 1.002, abs=5 * cause.sd[0])
    assert cause.sd[0] < 2e-4
    # Without any one of the four runs the scale factors of the others agree.
    assert "rate-y-up" in {each.run for each in doubted_runs(fitted)}


@pytest.mark.slow
def test_an_angle_mistyped_in_one_row_is_named_with_the_true_one() -> None:
    sound = fitted_to("hidden-none")
    true = next(run for run in sound.model.campaign.runs if run.name == "head-x-up").covariates["table_angle"][4]

    def typed(angle: np.ndarray) -> np.ndarray:
        angle[4] += np.radians(0.3)
        return angle

    (found,) = told(recorded_as(sound, "head-x-up", "table_angle", typed))
    assert (found.run, found.row) == ("head-x-up", 5)
    cause = found.causes[0]
    assert cause.quantity == "table_angle_deg"
    assert cause.agreeing[0] == pytest.approx(np.degrees(true), abs=5 * cause.sd[0])
    assert cause.sd[0] < 0.02


@pytest.mark.slow
def test_a_unit_that_sat_askew_in_one_run_is_named_with_its_rotation() -> None:
    """The record says that the seat of one run was turned by half a degree about body y, and it was not."""
    sound = fitted_to("hidden-none")
    campaign, turn = sound.model.campaign, np.radians(0.5)
    about = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    place = next(k for k, one in enumerate(campaign.runs) if one.name == "head-x-up")
    seat = campaign.mountings[campaign.runs[place].mounting or ""]
    seats = {**campaign.mountings, "askew": replace(seat, name="askew", body_to_table=seat.body_to_table @ about)}
    runs = tuple(replace(one, mounting="askew") if k == place else one for k, one in enumerate(campaign.runs))
    # A mounting of its own has an error of its own, which would have to be half a degree; without one it stays exact.
    seats["askew"] = replace(seats["askew"], uncertainty=0.0)
    model = bind(sound.model.spec, replace(campaign, mountings=seats, runs=runs))
    (found,) = told(refitted(model, *(np.zeros(size) for size in model.problem.size)))
    assert (found.run, found.row) == ("head-x-up", None)
    cause = next(each for each in found.causes if each.quantity == "mounting")
    # The exact seat lacks what is left over of the true one: 240.6 arcsec about y in truth.toml.
    assert cause.agreeing[1] == pytest.approx(-30.0 + 240.6 / 60, abs=5 * cause.sd[1])
    assert cause.sd[1] < 2.0


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["head", "table"])
def test_sound_campaigns_agree_and_a_wrong_input_does_not(kind: str, tmp_path: Path) -> None:
    """Of twenty campaigns drawn at random none has a finding; with a rate or an angle changed nearly each has."""
    named = 0
    for seed in range(20):
        plan = random_plan(kind, np.random.default_rng(seed), "hidden-effects")
        write_simulated(tmp_path / str(seed), plan, seed)
        campaign = load_campaign(tmp_path / str(seed))
        model = bind(read_model(ROOT / "models" / "hidden-effects.toml"), campaign)
        fitted = refitted(model, *(np.zeros(size) for size in model.problem.size))
        assert not told(fitted), seed
        run = campaign.runs[seed % len(campaign.runs)]
        column = "table_rate" if np.any(run.covariates["table_rate"]) else "table_angle"
        by = 0.05 * float(np.abs(run.covariates[column]).max())
        wrong = recorded_as(fitted, run.name, column, lambda values, by=by: values + by * (np.arange(len(values)) == 3))
        named += any((each.run, each.row) == (run.name, 4) for each in told(wrong))
    assert named >= 17


@pytest.mark.slow
def test_a_thermometer_that_is_wrong_in_one_run_is_named(tmp_path: Path) -> None:
    plan = random_plan("temperatures", np.random.default_rng(3), "hidden-effects-thermal")
    write_simulated(tmp_path / "campaign", plan, 3)
    campaign = load_campaign(tmp_path / "campaign")
    model = bind(read_model(ROOT / "models" / "hidden-effects-thermal.toml"), campaign)
    fitted = refitted(model, *(np.zeros(size) for size in model.problem.size))
    assert not told(fitted)
    run = campaign.runs[-1]
    (found,) = told(recorded_as(fitted, run.name, "temperature", lambda degrees: degrees + 12.0))
    assert found.run == run.name
    cause = next(each for each in found.causes if each.quantity == "temperature_degC")
    true = float(np.mean(run.covariates["temperature"]))
    assert cause.agreeing[0] == pytest.approx(true, abs=5 * cause.sd[0])


@pytest.mark.slow
def test_without_the_look_at_each_run_none_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """The planted fault of these tests."""
    monkeypatch.setattr(thresholds, "DISAGREEMENT_P", 0.0)
    fitted = recorded_as(fitted_to("hidden-none"), "rate-y-up", "table_rate", lambda rate: 1.002 * rate)
    h = known_before(fitted)
    linear = linear_fit(fitted.model, fitted.model.problem, fitted.z, h)
    assert not agreement_of_runs(fitted, linear, h).found
