"""χ² at the noise known beforehand falls by what a true effect brings, whatever the noise of the fit took up."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from null_data import fitted_to, redrawn

from imubayes.adequacy.known_noise import known_scales, sample_noise
from imubayes.adequacy.known_noise_fit import KnownNoisePoint, fit_at_known_noise, known_noise_point
from imubayes.foundations.units import to_si
from imubayes.inference.fitted_model import Fit
from imubayes.inference.parameter_fit import linearise


def point(fitted: Fit, h: np.ndarray | None = None) -> KnownNoisePoint:
    about = linearise(fitted.model.problem, jnp.asarray(fitted.z))
    return known_noise_point(fitted.model, about, known_scales(fitted) if h is None else h)


def asymmetry(fitted: Fit) -> np.ndarray:
    """Return the response of gx to a scale asymmetry of 1, |input| in output units, (E, 1): this test's own physics."""
    entries, gx = fitted.model.entries, fitted.model.campaign.channels[0]
    rates = np.array(
        [run.covariates["table_rate"][row] for run, row in zip(
            [fitted.model.campaign.runs[k] for k in entries.run], entries.row, strict=True
        )]
    )  # fmt: skip
    return np.where(entries.channel == 0, np.abs(gx.scale_si * rates), 0.0)[:, None]


def planted(seed: int, ppm: float, scatter: float) -> Fit:
    """Return a fit to fresh data with an asymmetry of gx, and offsets of runs in standard deviations of a sample."""
    fitted = fitted_to("hidden-none")
    entries, channels = fitted.model.entries, fitted.model.campaign.channels
    noise = np.array([channel.noise for channel in channels], dtype=float)
    offsets = scatter * noise * np.random.default_rng(seed).normal(size=(len(fitted.model.campaign.runs), len(noise)))
    change = offsets[entries.run, entries.channel] + ppm * 1e-6 * asymmetry(fitted)[:, 0]
    return redrawn(fitted, seed, change=change)


def dense(fitted: Fit, columns: np.ndarray) -> float:
    """Return the least sum of squares of outputs and priors, by a Cholesky factor of the whole covariance."""
    entries, campaign = fitted.model.entries, fitted.model.campaign
    known = sample_noise(fitted.model)
    sigma = np.array([
        known[place].sd if place in known else channel.noise for place, channel in enumerate(campaign.channels)
    ])  # fmt: skip
    scatter = np.array([0.1 * channel.noise for channel in campaign.channels])
    same = (entries.run[:, None] == entries.run) & (entries.channel[:, None] == entries.channel)
    covariance = np.diag(sigma[entries.channel] ** 2 / entries.samples) + same * scatter[entries.channel] ** 2
    root = np.linalg.cholesky(covariance)
    about = linearise(fitted.model.problem, jnp.asarray(fitted.z))
    design = np.linalg.solve(root, np.concatenate([np.asarray(about.jacobian), columns], axis=1))
    priors = np.eye(len(fitted.z), design.shape[1])
    rows = np.concatenate([design, priors])
    right = np.concatenate([np.linalg.solve(root, np.asarray(about.misfit)), -fitted.z])
    length = np.linalg.norm(rows, axis=0)
    left = right - rows @ (np.linalg.lstsq(rows / length, right, rcond=None)[0] / length)
    return float(left @ left)


def test_it_is_the_least_sum_of_squares_at_what_is_stated():
    fit = planted(3, 60.0, 0.1)
    before, column = point(fit), asymmetry(fit)
    assert before.record().chi2 == pytest.approx(dense(fit, column[:, :0]), rel=1e-6)
    assert before.with_columns(column).record().chi2 == pytest.approx(dense(fit, column), rel=1e-6)
    # Parameters fitted at that noise, and one linear step from where the fit stands, agree.
    assert fit_at_known_noise(fit).chi2 == pytest.approx(before.record().chi2, rel=1e-4)
    assert before.record().dof == len(fit.model.entries)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_true_effect_lowers_chi2_and_residual_whatever_the_scatter_took_up(seed):
    fit = planted(seed, 15.0, 0.4)
    column = asymmetry(fit)
    before, after = point(fit), point(fit).with_columns(column)
    then, now = (next(each for each in at.record().channels if each.channel == "gx") for at in (before, after))
    drop = before.record().chi2 - after.record().chi2
    assert drop > 100
    assert now.rms < then.rms
    # Never a rise, whatever is added.
    chance = np.random.default_rng(seed).normal(size=(len(column), 3))
    assert 0 <= before.record().chi2 - before.with_columns(chance).record().chi2 < 0.1 * drop
    # Planted fault: at the noise as fitted, which took the effect up, most of the drop is gone.
    absorbed = point(fit, fit.h)
    assert absorbed.record().chi2 - absorbed.with_columns(column).record().chi2 < 0.5 * drop


def test_the_residual_is_in_input_units_with_the_offsets_of_runs():
    fit = planted(5, 0.0, 0.3)
    at = point(fit)
    gx, entries = fit.model.campaign.channels[0], fit.model.entries
    own = at.misfit[entries.channel == 0] / gx.scale_si / to_si("deg")
    found = at.record().channels[0]
    assert (found.channel, found.unit) == ("gx", "deg/s")
    assert found.rms == pytest.approx(np.sqrt(np.mean(own**2)))
    assert found.within is not None
    assert found.within < found.rms


def test_scales_that_raw_samples_tell_are_theirs():
    fitted = fitted_to("hidden-none")
    runs = tuple(
        replace(run, sample_sd=np.full_like(run.sample_sd, 3.0 * fitted.model.campaign.channels[0].noise))
        for run in fitted.model.campaign.runs
    )  # fmt: skip
    told = replace(fitted, model=replace(fitted.model, campaign=replace(fitted.model.campaign, runs=runs)))
    names = fitted.model.hyper_layout.names
    place = names.index("white_noise.sigma[gx]")
    # lognormal(1 noise, 0.5)
    assert known_scales(told)[place] == pytest.approx(np.log(3.0) / 0.5)
