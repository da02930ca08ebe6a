"""Runs that were not fitted against their prediction: honest over simulations, failing where it should."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import imubayes
from imubayes.api import Result
from imubayes.cli.main import run
from imubayes.foundations.campaign_data import Campaign
from imubayes.inference.fitted_model import Fit
from imubayes.inference.run_fit import joint_fit
from imubayes.loop import predicted_runs
from imubayes.loop.predicted_runs import predict_runs, root_mean_square_scales
from imubayes.results.posterior_groups import in_units

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "data" / "generators"))
POLAR = ROOT / "models" / "polar-tumble.toml"
DRAWS, STUDIED = 8, 20


def halves(folder: Path, seed: int) -> tuple[Campaign, Fit]:
    """Return a simulated campaign, and the fit to all of its runs but one."""
    generator = __import__("polar_tumble")
    generator.generate(folder / f"tumble-{seed}", seed)
    campaign = imubayes.load_campaign(folder / f"tumble-{seed}")
    known = campaign.only("tumble-O-north", "tumble-I-north")
    return campaign, joint_fit(imubayes.bind(imubayes.load_model(POLAR), known), None)


def scales(fit: Fit) -> np.ndarray:
    """Return the root mean square of the noise scales, as a result gives them."""
    assert fit.posterior is not None
    draws = in_units(fit.model, fit.posterior.points)
    moments = zip(fit.model.parameter_names, draws.mean(axis=0).tolist(), draws.std(axis=0).tolist(), strict=True)
    return root_mean_square_scales(fit, {name: (mean, sd) for name, mean, sd in moments})


def scores(drawn) -> tuple[float, float, float]:
    """Return the rms of the readings, of the tested combinations, and of the shifts, in their predictive deviations."""
    found = [predict_runs(fit, campaign, scales(fit)) for campaign, fit in drawn]
    readings = np.sqrt(sum(each.chi2 for each in found) / sum(each.n for each in found))
    tested = np.sqrt(sum(each.calibration_chi2 for each in found) / sum(each.directions for each in found))
    pulls = np.sqrt(np.mean([shift.pull**2 for each in found for shift in each.shifts]))
    return float(readings), float(tested), float(pulls)


def hold_out(folder: Path, monkeypatch, seeds: range) -> None:
    """Check that held-out runs spread as predicted, and that without most of the uncertainty of the fit they do not."""
    drawn = [halves(folder, seed) for seed in seeds]
    readings, tested, pulls = scores(drawn)
    print(f"\nz rms {readings:.3f}, of tested combinations {tested:.3f}, of shifts {pulls:.3f}")
    assert readings == pytest.approx(1.0, abs=0.1)
    # There are two in each draw: the standard deviation of their rms is one over the root of four times the draws.
    assert tested == pytest.approx(1.0, abs=2.5 / np.sqrt(4 * len(seeds)))
    posterior = predicted_runs._posterior_root
    monkeypatch.setattr(predicted_runs, "_posterior_root", lambda *given: 0.3 * posterior(*given))
    readings, tested, _ = scores(drawn)
    assert readings > 1.1
    assert tested > 1.5


@pytest.mark.slow
def test_held_out_runs_spread_as_predicted(tmp_path, monkeypatch):
    hold_out(tmp_path, monkeypatch, range(101, 101 + DRAWS))


@pytest.mark.slow
def test_held_out_runs_spread_as_predicted_over_many_draws(tmp_path, monkeypatch):
    hold_out(tmp_path, monkeypatch, range(1, 1 + STUDIED))


def moved(campaign: Campaign, by: float) -> Campaign:
    """Return the campaign with the bias of the new run moved."""
    runs = [
        replace(each, observed=each.observed + by) if each.name == "tumble-O-south" else each for each in campaign.runs
    ]
    return replace(campaign, runs=tuple(runs))


def result_of(fit: Fit) -> Result:
    from imubayes.results.result import result_of as made

    return made(fit)


@pytest.fixture(scope="module")
def first(tmp_path_factory) -> tuple[Campaign, Result]:
    """Return a campaign, and the result of all of its runs but one: three, as in other tests."""
    generator, folder = __import__("polar_tumble"), tmp_path_factory.mktemp("first") / "tumble"
    seats = (generator.NORTH, generator.SOUTH, generator.ALONG, replace(generator.ALONG, name="I-again"))
    __import__("simulate").write_simulated(folder, generator.plan(1, seats), 1)
    campaign = imubayes.load_campaign(folder)
    known = campaign.only(*(f"tumble-{seat.name}" for seat in seats if seat is not generator.SOUTH))
    return campaign, result_of(joint_fit(imubayes.bind(imubayes.load_model(POLAR), known), None))


@pytest.mark.slow
def test_a_bias_that_moved_is_found(first):
    campaign, result = first
    assert imubayes.predict(result, campaign).holds
    found = imubayes.predict(result, moved(campaign, 1e-3))
    assert not found.holds
    # With its turn table the other way round, the run shows it where an inclined axis would: north against south.
    worst = found.summary.shifts[0]
    assert abs(worst.pull) > 5
    assert "table_axis_tilt.x[polar]" in {each.name for each in found.summary.shifts[:3]}
    assert "NOT as predicted" in str(found)
    assert f"They would move {worst.name}" in str(found)


@pytest.mark.slow
def test_what_the_new_runs_have_alone_is_fitted(first):
    campaign, result = first
    seat = campaign.runs[1].mounting
    assert seat is not None
    own = imubayes.predict(result, campaign).summary.unknowns
    assert own == tuple(name for name in own if f"[{seat}]" in name)
    # The seats of the fit serve again, unless they were changed.
    again = replace(campaign, runs=tuple(replace(each, mounting=campaign.runs[0].mounting) for each in campaign.runs))
    shared = imubayes.predict(result, again).summary
    assert shared.unknowns == ()
    changed = imubayes.predict(result, again, changed=[campaign.runs[0].mounting]).summary
    assert changed.changed == (campaign.runs[0].mounting,)
    assert len(changed.unknowns) == 3
    assert changed.chi2 is not None
    assert shared.chi2 is not None
    assert changed.chi2 < shared.chi2  # the seat is another one indeed


def refused(result: Result, campaign: Campaign, **options) -> str:
    with pytest.raises(imubayes.InputError) as raised:
        imubayes.predict(result, campaign, **options)
    return str(raised.value)


def test_what_cannot_be_predicted_is_refused(first):
    campaign, result = first
    other = replace(campaign, serial="another")
    assert "is of unit 'another'" in refused(result, other)
    assert imubayes.predict(result, other, any_unit=True).summary.n == 24
    assert "all runs" in refused(result, campaign.only("tumble-O-north"))
    doubled = replace(campaign.channels[0], scale_si=2 * campaign.channels[0].scale_si)
    assert "another axis, scale or offset" in refused(result, replace(campaign, channels=(doubled,)))
    assert "not a table, mounting or thermometer" in refused(result, campaign, changed=["plinth"])


def test_the_command_writes_what_it_says(first, tmp_path, capsys, monkeypatch):
    campaign, result = first
    monkeypatch.setattr("imubayes.api.comparisons.opened", lambda folder: result)
    out = tmp_path / "predicted"
    assert run(["predict", "RESULT", campaign.folder, "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "1 run of" in said
    assert "is as predicted" in said
    assert {"prediction.json", "prediction.html", "residuals.parquet", "figures"} == {p.name for p in out.iterdir()}
    assert (out / "figures" / "run-tumble-O-south.png").stat().st_size > 10_000
    assert run(["predict", "RESULT", campaign.folder, "--out", str(tmp_path)]) == 2


@pytest.mark.parametrize("free", [0, 3])
def test_chi2_is_that_of_the_predictive_distribution(free):
    rng = np.random.default_rng(1)
    count, known, own = 12, 4, 5
    noise = rng.normal(size=count)
    shared, wide = 3 * rng.normal(size=(count, known)), rng.normal(size=(count, own)) * np.array([1e6, 2, 1e5, 1, 3e6])
    procedural = np.arange(own) % 2 == 0 if free else np.zeros(own, dtype=bool)
    values = rng.normal(size=own)
    readings = noise + shared @ rng.normal(size=known) + wide @ values
    best = np.linalg.lstsq(np.vstack([wide, np.eye(own)]), np.append(readings, np.zeros(own)), rcond=None)[0]
    spread = predicted_runs._spread(readings - wide @ best, wide, best, procedural, shared)
    whitened, freedom = spread.whitened()
    # The density of what no unknown without a prior changes, in closed form.
    across = np.linalg.svd(wide[:, procedural])[0][:, procedural.sum() :] if free else np.eye(count)
    columns = across.T @ np.hstack([wide[:, ~procedural], shared])
    left = across.T @ readings
    covariance = np.eye(len(left)) + columns @ columns.T
    assert freedom == len(left) == count - free
    assert np.sum(whitened**2) == pytest.approx(left @ np.linalg.solve(covariance, left), rel=1e-5)
