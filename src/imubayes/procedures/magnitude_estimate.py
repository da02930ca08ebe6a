"""The textbook estimate of accelerometers by |f| = g, of poses and of windows in motion.

Least squares of |u| − g, u = L⁻¹((r − K0)/(1 + ε)) the force along the nominal input axes, which are taken as
orthogonal.  L is lower triangular with rows of length 1; the identity if the poses do not determine it.
"""

from collections.abc import Sequence

import numpy as np
import scipy  # loads its parts when they are first used

from imubayes.foundations.campaign_data import Campaign, Channel, Run
from imubayes.foundations.units import to_si
from imubayes.procedures.textbook import Evaluation, TextbookResult, Undetermined, measured

METHOD = "multi-position test, |f| = g"
_DIAGONAL, _ALL = 6, 9  # parameters without and with misalignments
_LEAST_TOLD = 1e-3  # of the best determined combination


def of_accelerometers(run: Run, campaign: Campaign) -> list[TextbookResult]:
    """Return scale factor and bias of each accelerometer of a run, or why it does not determine them."""
    channels = measured(run, campaign, "accelerometer")
    if not channels:
        return []
    names, poses, gravity = ", ".join(c.name for c, _ in channels), run.rows, campaign.site.gravity
    axes = np.array([channel.axes[0] for channel, _ in channels])
    if axes.shape != (3, 3) or np.abs(axes @ axes.T - np.eye(3)).max() > 0.01:
        return [Undetermined(run.name, f"{names}: three accelerometers along orthogonal axes would be evaluated")]
    solved = _solved(np.stack([output / channel.scale_si for channel, output in channels], axis=1), gravity)
    if solved is None:
        what = f"{poses} poses do not determine {_DIAGONAL} parameters; six faces determine scale factor and bias"
        return [Undetermined(run.name, f"{names}: {what}")]
    values, covariance, residual = solved
    count, freedom = len(values), poses - len(values)
    known = _within_poses(run, campaign, [channel for channel, _ in channels])
    variance = max(float(residual @ residual) / freedom, known) if freedom else known or float("nan")
    sd = np.sqrt(variance * np.diag(covariance))
    how = f"{poses} poses, {count} parameters" + ("" if count == _ALL else ", misalignments taken as zero")
    estimates = zip((channel for channel, _ in channels), values[:3], sd[:3], values[3:6], sd[3:6], strict=True)
    return [result for each in estimates for result in _of_channel(run, gravity, how, *each)]


def _solved(reading: np.ndarray, gravity: float) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Return the parameters that the poses determine, nine or six, their covariance for unit variance, and |u| − g."""
    for count in (_ALL, _DIAGONAL):
        found = scipy.optimize.least_squares(
            lambda x: _misfit(x, reading, gravity), np.zeros(count), xtol=1e-13, ftol=1e-15, gtol=1e-15
        )
        squares = np.linalg.svd(found.jac / np.maximum(np.linalg.norm(found.jac, axis=0), 1e-300), compute_uv=False)
        enough = len(reading) > count or len(reading) == count == _DIAGONAL
        if enough and squares[-1] > _LEAST_TOLD * squares[0]:
            return found.x, np.linalg.inv(found.jac.T @ found.jac), found.fun
    return None


def _within_poses(run: Run, campaign: Campaign, channels: Sequence[Channel]) -> float:
    """Return the variance of a pose mean by the scatter within poses, in g²: few residuals may vanish by chance."""
    places = [campaign.channels.index(channel) for channel in channels]
    sd = run.sample_sd[:, places] / [channel.scale_si * campaign.site.gravity for channel in channels]
    return float(np.nanmean(sd**2 / run.samples[:, None])) if np.isfinite(sd).any() else 0.0


def _of_channel(
    run: Run, gravity: float, how: str, channel: Channel, error: float, error_sd: float, bias: float, bias_sd: float
) -> list[TextbookResult]:
    per, unit = channel.scale_si * to_si(channel.per, gravity), f"{channel.output_unit} per {channel.per}"
    of = Evaluation(channel.name, run.name, METHOD, f"type A: residuals of |f| or scatter within poses, {how}")
    return [
        of.estimate("scale_factor", (1 + error) * per, error_sd * abs(per), unit, how),
        of.estimate("accel_bias.bias", 1e6 * bias, 1e6 * bias_sd, "ug", how),
    ]


def _misfit(values: np.ndarray, reading: np.ndarray, gravity: float) -> np.ndarray:
    """Return |u| − g of each pose, in g, for ε, K0/(1 + ε) in g, and the tilts of the second and third axis."""
    along = reading / (1 + values[:3]) - gravity * values[3:6]
    if len(values) == _ALL:
        tilt = np.zeros((3, 3))
        tilt[[1, 2, 2], [0, 0, 1]] = values[6:]
        lower = tilt + np.diag(np.sqrt(1 - np.sum(tilt**2, axis=1)))
        along = np.linalg.solve(lower, along.T).T
    return np.linalg.norm(along, axis=1) / gravity - 1
