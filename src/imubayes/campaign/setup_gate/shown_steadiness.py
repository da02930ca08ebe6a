"""How steady the outputs of each channel show it to be: its noise, what single rows leave out, and offsets of runs.

A small input, such as the Earth rate or what a temperature does, shows in a good unit only.  Each channel is judged by
itself, with mountings and tables as the whole campaign shows them.
"""

from collections.abc import Callable, Sequence

import numpy as np

from imubayes.campaign.setup_gate.evidence import ErrorModel, Seen
from imubayes.campaign.setup_gate.normal_terms import weighted
from imubayes.campaign.setup_gate.plausible_errors import G_SENSITIVITIES, Steadiness
from imubayes.campaign.setup_gate.run_view import RunView

FACTORS = (10.0, 3.0, 1.0, 0.3, 0.1, 0.03, 0.01, 0.003, 0.001)
"""Factors of offsets of runs, and of what a linear model leaves out, that are tried."""
LOWER_NOISE = (1.0, 0.6, 0.3)
"""Noise of a channel over what the campaign states that is tried where no rows repeat a position."""
MORE_NOISE = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0, 3000.0)
"""The same that is tried in place of a mistake in the set-up."""
_LEAST_DIFFERENCES = 8
_MEDIAN = 0.4549  # of χ² with one degree of freedom


def shown_steadiness(model: ErrorModel, views: Sequence[RunView], errors: np.ndarray) -> Steadiness:
    """Return the steadiness of most evidence for each channel.

    Parameters
    ----------
    model : of a poor unit, linear about errors near those that the campaign shows.
    errors : that the campaign shows, shape (P,).
    """
    own = errors[: model.own * len(model.channels)].reshape(-1, model.own)
    seen = [each.without_shared(errors) for each in model.seen_of(views)]
    noise, known = _noise(model, seen, views, own)
    sd = model.widths_with(G_SENSITIVITIES[-1])[: own.size].reshape(own.shape)
    one = np.ones(len(own))
    rows = _best(FACTORS, lambda factor: _evidence(model, seen, sd, Steadiness(factor * one, one, noise)))
    runs = _best(FACTORS, lambda factor: _evidence(model, seen, sd, Steadiness(rows, factor * one, noise)))
    if not known.all():
        lower = _best(LOWER_NOISE, lambda factor: _evidence(model, seen, sd, Steadiness(rows, runs, factor * one)))
        noise = np.where(known, noise, lower)
    return Steadiness(rows, runs, noise)


def noise_as_rival(model: ErrorModel, views: Sequence[RunView], errors: np.ndarray) -> Steadiness:
    """Return the noise of each channel, no less than stated, with which the outputs fit the set-up as stated best."""
    seen = [each.without_shared(errors) for each in model.seen_of(views)]
    sd = model.widths_with(G_SENSITIVITIES[-1])[: model.own * len(model.channels)].reshape(-1, model.own)
    one = np.ones(len(sd))
    noise = _best(MORE_NOISE, lambda factor: _evidence(model, seen, sd, Steadiness(one, one, factor * one)))
    return Steadiness(noise=noise)


def _best(factors: tuple[float, ...], evidence: Callable[[float], np.ndarray]) -> np.ndarray:
    return np.array(factors)[np.argmin([evidence(factor) for factor in factors], axis=0)]


def _evidence(model: ErrorModel, seen: Sequence[Seen], own: np.ndarray, steadiness: Steadiness) -> np.ndarray:
    """Return −2 log evidence of each channel by itself, up to a constant, shape (K,)."""
    noise, rows = (np.asarray(each)[:, None] for each in (steadiness.noise, steadiness.rows))
    spread = (model.run_offset * steadiness.runs)[:, None]
    count = model.own
    moments, score = np.zeros((len(own), count + 1, count + 1)), np.zeros(len(own))
    for run in seen:
        variance = noise**2 * model.white(run) + rows**2 * model.left_out(run) + run.arm
        weight = np.where(run.there, 1 / variance, 0.0)
        found = weighted(run.design[:, :, :count], run.error, weight, np.ones_like(run.along), spread)
        moments += found.moments
        score += found.volume + np.sum(np.where(run.there, np.log(variance), 0.0), axis=1)
    lower = np.linalg.cholesky(np.eye(count) + own[:, :, None] * moments[:, :-1, :-1] * own[:, None, :])
    solved = np.linalg.solve(lower, (own * moments[:, :-1, -1])[:, :, None])[:, :, 0]
    score += moments[:, -1, -1] - np.sum(solved**2, axis=1)
    return score + 2 * np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(axis=1)


def _noise(
    model: ErrorModel, seen: Sequence[Seen], views: Sequence[RunView], own: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the noise of each channel over the stated one, and whether successive rows in one position show it.

    Half the median square of the differences of their residuals over that of a normal deviate; 1 where these are few.
    """
    found: list[np.ndarray] = []
    for run, view in zip(seen, views, strict=True):
        left = run.error - (run.design[:, :, : own.shape[1]] @ own[:, :, None])[:, :, 0]
        white = model.white(run)
        left = np.where(run.there & (white > 0), left, np.nan)
        squares = np.diff(left, axis=1) ** 2 / (white[:, 1:] + white[:, :-1])
        found.append(squares[:, view.repeats()])
    squares = np.concatenate(found, axis=1)
    enough = np.isfinite(squares).sum(axis=1) >= _LEAST_DIFFERENCES
    shown = [np.nanmedian(each) if known else _MEDIAN for each, known in zip(squares, enough, strict=True)]
    return np.maximum(np.sqrt(np.array(shown) / _MEDIAN), LOWER_NOISE[-1]), enough
