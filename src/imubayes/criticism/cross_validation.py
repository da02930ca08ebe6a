"""Whether an addition holds: what was found against what was expected, and how well runs are predicted unseen.

A run that is left out is predicted from the others: p(y_k | y_−k) is the ratio of two Laplace marginals at the mode
without it, one with the run and one without, so that its offset and the parameters that it alone determines are
integrated out (leave-one-group-out predictive density; Vehtari, Gelman & Gabry, Statistics and Computing 2017).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from imubayes.criticism import thresholds
from imubayes.criticism.warm_start import Extension
from imubayes.inference.fitted import Fitted
from imubayes.inference.noise_marginal import slope
from imubayes.inference.posterior_mode import find_mode, fit_at, mode_near
from imubayes.inference.posterior_precision import Linearised, linearise
from imubayes.model.bind import Model
from imubayes.model.likelihood import residuals
from imubayes.model.problem import masked
from imubayes.model.robust_likelihood import has_heavy_tails
from imubayes.parameters.vector import Layout

_residuals = eqx.filter_jit(residuals)


@dataclass(frozen=True)
class HeldOut:
    """What an addition does to the prediction of data that were left out.

    Attributes
    ----------
    by : what was left out at a time, ``run``, ``pose`` or ``block``.
    names : of what was left out.
    gains : shape (K,), rise of the log predictive density of each.
    rate_errors : of poses, for each gyro: its name and the rms of what it read at rest about its prediction, before and
        after, rad/s.
    """

    by: str
    names: tuple[str, ...]
    gains: np.ndarray
    rate_errors: tuple[tuple[str, float, float], ...] = ()

    @property
    def gain(self) -> float:
        """Rise of the log predictive density, all together."""
        return float(self.gains.sum())

    @property
    def se(self) -> float:
        """Standard error of the rise, from its scatter among what was left out; infinite for one alone."""
        count = len(self.gains)
        return float(np.sqrt(count) * self.gains.std(ddof=1)) if count > 1 else float("inf")

    @property
    def helped(self) -> int:
        """How many are predicted better."""
        return int(np.sum(self.gains > 0))

    @property
    def verdict(self) -> str:
        """Say whether the addition ``helps``, that it is ``unclear``, or that it does ``not`` help."""
        if not self.gain > thresholds.GAIN_MIN:
            return "not"
        return "helps" if self.gain > thresholds.GAIN_STANDARD_ERRORS * self.se else "unclear"


@dataclass(frozen=True)
class LeftOut:
    """What the rest says of entries that are left out: log p(left out | rest), and misfit about the prediction (n,)."""

    density: float
    misfit: np.ndarray


def held_out(before: Fitted, after: Fitted, progress: Callable[[str], None] | None = None) -> HeldOut:
    """Return how much better what is left out is predicted by the second of two fits of one campaign.

    Runs are left out in turns; of a campaign of one run its poses, whose rotations stay, or its blocks of rows.
    """
    tell = progress or (lambda text: None)
    by, names, masks = groups(before.model)
    about = [linearise(one.model.problem, jnp.asarray(one.z)) for one in (before, after)]
    seen = []
    for place, mask in enumerate(masks):
        tell(f"predicting {by} {place + 1} of {len(masks)} from the others")
        seen.append([predict_left_out(one, at, mask) for one, at in zip((before, after), about, strict=True)])
    gains = np.array([now.density - was.density for was, now in seen])
    finite = np.isfinite(gains)
    kept = tuple(name for name, good in zip(names, finite.tolist(), strict=True) if good)
    errors = _rate_errors(before.model, masks, seen) if by == "pose" else ()
    return HeldOut(by, kept, gains[finite], errors)


def _rate_errors(
    model: Model, masks: Sequence[np.ndarray], seen: Sequence[Sequence[LeftOut]]
) -> tuple[tuple[str, float, float], ...]:
    """Return the errors of the gyros' rates in poses; the attitude, and so the force, is known through gyros alone."""
    channel = np.concatenate([model.entries.channel[mask] for mask in masks])
    misfits = [np.concatenate([one[which].misfit for one in seen]) for which in range(2)]
    gyros = [(place, one) for place, one in enumerate(model.campaign.channels) if one.kind == "gyro"]

    def rms(misfit: np.ndarray, place: int) -> float:
        return float(np.sqrt(np.mean(misfit[channel == place] ** 2)))

    was, now = misfits
    return tuple((one.name, rms(was, place) / one.scale_si, rms(now, place) / one.scale_si) for place, one in gyros)


def groups(model: Model) -> tuple[str, tuple[str, ...], tuple[np.ndarray, ...]]:
    """Return what is left out at a time: run, pose or block, its names, and which entries belong to each, shape (E,).

    A campaign of one run is predicted pose by pose, or where it has none in blocks of neighbouring rows: a row alone
    would be told by its neighbours.
    """
    entries, runs = model.entries, model.campaign.runs
    run = runs[0] if len(runs) == 1 else None
    if run is None:
        return "run", tuple(run.name for run in runs), tuple(entries.run == place for place in range(len(runs)))
    if run.tumble is not None:
        pose = run.tumble.pose[np.where(entries.closing, 0, entries.row)]
        there = np.unique(pose[~entries.closing])
        masks = tuple((pose == one) & ~entries.closing for one in there)
        return "pose", tuple(str(one) for one in there.tolist()), masks
    in_time = np.argsort(run.covariates["time"], kind="stable") if "time" in run.covariates else np.arange(run.rows)
    blocks = np.array_split(in_time, max(min(thresholds.MAX_BLOCKS, run.rows // thresholds.BLOCK_ROWS), 1))
    names = tuple(f"rows {one.min() + 1} to {one.max() + 1}" for one in blocks)
    return "block", names, tuple(np.isin(entries.row, one) for one in blocks)


def predict_left_out(fitted: Fitted, about: Linearised, left_out: np.ndarray) -> LeftOut:
    """Return how the rest predicts what is left out, everything refitted to it, from where all together fit.

    Parameters
    ----------
    fitted : the fit to all.
    about : the model linearised there; what is left out does not change it.
    left_out : shape (E,), True for the entries to predict.
    """
    problem = fitted.model.problem
    rest, h = masked(problem, left_out), jnp.asarray(fitted.h)
    mode = mode_near(rest, about, h)
    if not bool(mode.converged):
        mode = find_mode(rest, jnp.asarray(fitted.z), h)
    # Under a normal law the density of all may be taken about the fit to the rest; a heavy tail is no parabola.
    whole = (
        linearise(problem, fit_at(problem, jnp.asarray(fitted.z), mode.h)) if has_heavy_tails(problem) else mode.about
    )
    density = float(slope(problem, whole, mode.h).value - slope(rest, mode.about, mode.h).value)
    return LeftOut(density, np.asarray(mode.about.misfit)[left_out])


def found_delta_chi2(before: Fitted, extension: Extension, after: Fitted) -> float:
    """Return the drop of chi² that the refit brought.

    At the noise scales of the old fit, and without the priors of what is new; where a noise scale is new itself, twice
    the rise of the log likelihood with the parameters integrated out.
    """
    old, new = before.model, after.model
    if new.hyper_layout.names != old.hyper_layout.names:
        return 2 * (_log_likelihood(after) - _log_likelihood(before))
    h = jnp.asarray(_in_order(old.hyper_layout, before.h, new.hyper_layout))
    z = fit_at(new.problem, jnp.asarray(after.z), h)
    was = np.asarray(_residuals(old.problem, jnp.asarray(before.z), jnp.asarray(before.h)))
    now = np.asarray(_residuals(new.problem, z, h))
    priors = now[-len(extension.new) :][extension.new]
    return float(was @ was - now @ now + priors @ priors)


def _in_order(old: Layout, point: np.ndarray, new: Layout) -> np.ndarray:
    return np.array([point[old.index(name)] for name in new.names], dtype=float)


def _log_likelihood(fitted: Fitted) -> float:
    """Return log p(y | h) with θ integrated out about the mode."""
    problem, h = fitted.model.problem, jnp.asarray(fitted.h)
    about = linearise(problem, jnp.asarray(fitted.z))
    prior = 0.5 * float(h @ h) + 0.5 * len(fitted.h) * np.log(2 * np.pi)
    return float(slope(problem, about, h).value) + prior


def objection(after: Fitted, delta_chi2: float) -> str:
    """Return the sentence that says why a refit is not taken; empty where nothing speaks against it."""
    if not after.converged:
        return f"The refit is not taken. {after.message}"
    if not delta_chi2 > thresholds.REFIT_LOSS:
        return (
            f"The refit is not taken: it fits worse than the model without the addition (chi2 rose by "
            f"{-delta_chi2:.1f} at the same noise)."
        )
    return ""
