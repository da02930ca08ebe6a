"""Details: what is narrow or sudden is found where broad forms see nothing, and every look at one is counted."""

from dataclasses import replace

import numpy as np
import pytest
from null_data import fitted_to, redrawn
from scipy import stats

from imubayes.responses.candidate_effects import candidate_responses
from imubayes.criticism.diagnose import judge
from imubayes.criticism.free_form_dependence import free_forms, project_forms, screen_structure
from imubayes.criticism.localised_structure import STEP, features, scan_features
from imubayes.criticism.multiple_testing import look_elsewhere
from imubayes.adequacy.projection import project
from imubayes.responses.residual_covariates import covariates
from imubayes.criticism.score_test import score_test
from imubayes.display.diagnosis_report import diagnosis_json


@pytest.fixture(scope="module")
def projection():
    fitted = fitted_to("accel-channel", "accel-channel")
    responses = candidate_responses(fitted)
    return project(fitted, responses.misfit, responses.jacobian)


@pytest.fixture(scope="module")
def known(projection):
    return covariates(projection.fitted)


@pytest.fixture(scope="module")
def scans(projection, known):
    return [scan_features(projection, each) for each in features(projection, known)]


def _under(projection, seed, change=None):
    """Return the projection with a residual of white noise, and a change of the readings on top."""
    rows = np.random.default_rng(seed).normal(size=len(projection.residual))
    if change is not None:
        rows = rows + projection.whitened(change[:, None])[:, 0]
    return replace(projection, residual=projection.project(rows))


def _first(projection, known, scans):
    """Return the likeliest broad form and the likeliest detail."""
    found = screen_structure(projection, project_forms(projection, free_forms(projection, known)), scans)
    is_broad = [one.test in ("levels", "spline", "course of one run") for one in found]
    return found[is_broad.index(True)], found[is_broad.index(False)]


def test_scores_of_the_scan_are_drops_of_chi_squared(projection, scans):
    residual = projection.residual
    seen = set()
    for one in scans:
        for batch, scores in one.scores(residual[None, :]):
            for place, score, freedom in zip(batch.members[::7], scores[0][::7], batch.freedom[::7], strict=True):
                detail = one.features.found[place]
                whole = one.features.whole(detail, len(residual))
                found = score_test(projection, projection.project(whole), np.linalg.norm(whole, axis=0), 1e-6)
                assert found.span.shape[1] == freedom
                assert score == pytest.approx(found.delta_chi2_at_fit, rel=1e-5, abs=1e-7)
                seen.add(detail.test)
    assert {"power", "bump", "wave", "product", STEP} <= seen


def test_every_detail_counts_as_a_look(projection, scans):
    """With details left out of the count, white noise would be called structured most of the time."""
    counted = look_elsewhere([], scans)
    # What is called chance if only one detail had been looked at.
    single = look_elsewhere([score_test(projection, np.eye(len(projection.residual))[:, :1], np.ones(1))])
    smallest = []
    for seed in range(60):
        residual = np.random.default_rng([seed, 5]).normal(size=(1, len(projection.residual)))
        smallest.append(_smallest(scans, residual))
    judged = np.array([counted(p) for p in smallest])
    assert np.mean(judged < 0.1) < 0.25
    assert 0.35 < judged.mean() < 0.65
    assert np.mean(np.array([single(p) for p in smallest]) < 0.02) > 0.5


def _smallest(scans, residual):
    return min(
        float(stats.chi2.sf(scores[0], np.maximum(batch.freedom, 1))[batch.freedom > 0].min())
        for one in scans
        for batch, scores in one.scores(residual)
    )


def _step(projection, size):
    """A step of so many standard deviations in the middle of the longest run: readings after it, time and height."""
    model = projection.fitted.model
    index, run = max(enumerate(model.campaign.runs), key=lambda pair: pair[1].rows)
    here = (model.entries.run == index) & (model.entries.channel == 0) & ~model.entries.closing
    time = np.full(len(here), np.nan)
    time[here] = run.covariates["time"][model.entries.row[here]]
    after = here & (time > np.nanmedian(time))
    height = size / np.linalg.norm(projection.project(projection.whitened(after[:, None].astype(float))))
    return run, after, time, float(height)


def test_a_step_in_one_run_is_found_with_its_place_and_height(projection, known, scans):
    run, after, time, height = _step(projection, 8)
    broad, detail = _first(_under(projection, 1, height * after), known, scans)
    assert (detail.test, detail.channel) == (STEP, projection.fitted.model.campaign.channels[0].name)
    assert detail.score.p < broad.score.p
    assert detail.step is not None
    assert detail.step.run == run.name
    assert detail.height is not None
    value, sd = detail.height
    assert abs(value - height) < 3.5 * sd
    at = detail.step.at
    assert abs(at - np.nanmedian(time)) < 0.1 * np.ptp(time[np.isfinite(time)])


def test_a_step_is_told_with_place_and_height_and_gets_no_name(projection):
    run, after, _, height = _step(projection, 12)
    document = diagnosis_json(judge(redrawn(projection.fitted, 4, change=height * after)))
    assert document["verdict"] == "unexplained_structure", document["sentence"]
    best = next(one for one in document["structure"] if one["test"] == STEP)
    assert best["shape"].startswith("step at ")
    assert run.name in best["shape"]
    campaign = projection.fitted.model.campaign
    true = height / (campaign.channels[0].scale_si * 1e-6 * campaign.site.gravity)
    assert best["coefficient"]["unit"] == "ug"
    assert abs(best["coefficient"]["value"] - true) < 4 * best["coefficient"]["sd"] + 0.2 * true


def test_a_narrow_bump_is_found_where_a_smooth_curve_is_too_stiff(projection, known, scans):
    temperature = next(one for one in known if one.name == "converter_temperature_degC")
    low, high = np.nanmin(temperature.values), np.nanmax(temperature.values)
    off = (np.nan_to_num(temperature.values, nan=high + 1e6) - low - 0.42 * (high - low)) / (0.04 * (high - low))
    bump = np.exp(-(off**2))
    change = 9 / np.linalg.norm(projection.project(projection.whitened(bump[:, None]))) * bump
    broad, detail = _first(_under(projection, 2, change), known, scans)
    counted = look_elsewhere([], scans)
    assert "converter_temperature_degC" in [one.name for one in detail.covariates]
    assert counted(detail.score.p) < 1e-3
    assert detail.score.p < 1e-2 * broad.score.p
