"""Whether a change of a model holds: what was found against what was expected, and how runs are predicted unseen.

A run that is left out is predicted from the others: p(y_k | y_−k) is the ratio of two Laplace marginals at the mode
without it, one with the run and one without, so that its offset and the parameters that it alone determines are
integrated out (leave-one-group-out predictive density; Vehtari, Gelman & Gabry, Statistics and Computing 2017).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from imubayes.criticism.explanation_records import RmsChange
from imubayes.foundations.arrays import Array, Float
from imubayes.foundations.progress import counted
from imubayes.foundations.records import finite
from imubayes.foundations.units import to_si
from imubayes.inference.fitted_model import Fit
from imubayes.inference.laplace_marginal import ScaleMarginal, curvature
from imubayes.inference.parameter_fit import Linearised, fit_at, linearise
from imubayes.inference.posterior_mode import find_mode, mode_near
from imubayes.loop.model_history import CrossValidation, GroupGain, HeldOutVerdict
from imubayes.loop.warm_start import REFIT_LOSS
from imubayes.model.bind import Model
from imubayes.model.likelihood import has_heavy_tails, residuals_of
from imubayes.model.problem import Problem, hyper_prior_square, masked, predict_many
from imubayes.parameters.declarations import Layout

_GAIN_STANDARD_ERRORS, _GAIN_CHANCE, _GAIN_MIN = 2.0, 0.0228, 0.5
"""A gain in log predictive density helps if it exceeds GAIN_MIN, and so many standard errors or, by flips of signs, the
one-sided chance of that many (convention).  GAIN_MIN is derived: a superfluous parameter costs half a unit on unseen
data (Akaike)."""
_MAX_BLOCKS, _BLOCK_ROWS = 8, 4
"""A single run is left out in so many blocks at most, of so many rows at least.  Convention."""

_EXACT_FLIPS, _ROUNDING = 13, 1e-12
_OF_A_REMOVAL: dict[str, HeldOutVerdict] = {"helps": "costs", "unclear": "unclear", "not": "spares"}
"""Contribution of the removed effects → consequence of their removal."""


def summarise_gains(
    by: Literal["run", "pose", "block"],
    names: Sequence[str],
    gains: np.ndarray,
    rates: Sequence[RmsChange] = (),
    removal: bool = False,
) -> CrossValidation:
    """Return the cross-validation from the gains of all groups, shape (K,); of a removal it judges the loss."""
    count, delta = len(gains), float(gains.sum())
    se = float(np.sqrt(count) * gains.std(ddof=1)) if count > 1 else float("inf")
    judged = _judged(-gains if removal else gains, se)
    verdict = _OF_A_REMOVAL[judged] if removal else judged
    return CrossValidation(
        by=by,
        delta=delta,
        se=finite(se),
        helped=int(np.sum(gains > 0)),
        of=count,
        verdict=verdict,
        each=tuple(GroupGain(name=name, delta=gain) for name, gain in zip(names, gains.tolist(), strict=True)),
        rates=tuple(rates),
    )


def _judged(gains: np.ndarray, se: float) -> Literal["helps", "unclear", "not"]:
    """Return whether the sum of gains, shape (K,), with its standard error, is beyond chance."""
    delta = float(gains.sum())
    if not delta > _GAIN_MIN:
        return "not"
    clear = delta > _GAIN_STANDARD_ERRORS * se or sign_flip_chance(gains) < _GAIN_CHANCE
    return "helps" if clear else "unclear"


def sign_flip_chance(gains: np.ndarray) -> float:
    """Return the chance of so large a sum if each of the gains, shape (K,), were as often a loss (Fisher's sign flips).

    An effect that acts in some groups alone gains much there and nothing elsewhere.  That scatter raises the standard
    error of the sum, but not this chance.  Exact for few groups, by random signs for many.
    """
    count = len(gains)
    if count <= _EXACT_FLIPS:
        signs = 1.0 - 2.0 * (np.arange(2**count)[:, None] >> np.arange(count) & 1)
    else:
        signs = np.random.default_rng(0).choice([-1.0, 1.0], (2**_EXACT_FLIPS, count))
        signs[0] = 1.0  # the signs observed: no chance is zero
    sums = signs @ gains
    return float(np.mean(sums >= gains.sum() - _ROUNDING * np.abs(gains).sum()))


@dataclass(frozen=True)
class WholeFit:
    """A fit to all data: the model linearised there, and the negative Hessian (H, H) of the marginal of h."""

    fitted: Fit
    about: Linearised
    information: Float[Array, "H H"]


@dataclass(frozen=True)
class LeftOut:
    """What the rest says of entries that are left out: log p(left out | rest), and misfit about the prediction (n,)."""

    density: float
    misfit: np.ndarray


def cross_validate(
    before: Fit, after: Fit, progress: Callable[[str], None] | None = None, removal: bool = False
) -> CrossValidation | None:
    """Return how much better the second of two fits of one campaign predicts what is left out.

    Leave-one-run-out; of a campaign of one run leave-one-pose-out, the attitudes known, or leave-one-block-out.  None
    if no group has a finite density.
    """
    tell = progress or (lambda text: None)
    by, names, masks = groups(before.model)
    known = [whole_fit(fit) for fit in (before, after)]
    seen = [[predict_left_out(whole, mask) for whole in known] for mask in counted(tell, f"leave-one-{by}-out", masks)]
    gains = np.array([now.density - was.density for was, now in seen])
    finite_gains = np.isfinite(gains)
    if not finite_gains.any():
        return None
    kept = [name for name, good in zip(names, finite_gains.tolist(), strict=True) if good]
    rates = _rate_errors(before.model, masks, seen) if by == "pose" else ()
    return summarise_gains(by, kept, gains[finite_gains], rates, removal)


def _rate_errors(model: Model, masks: Sequence[np.ndarray], seen: Sequence[Sequence[LeftOut]]) -> tuple[RmsChange, ...]:
    """Return the gyros' rate errors at rest; the attitude, and so the specific force, is known through gyros alone."""
    channel = np.concatenate([model.entries.channel[mask] for mask in masks])
    was, now = (np.concatenate([each[which].misfit for each in seen]) for which in range(2))

    def rms(misfit: np.ndarray, place: int) -> float:
        own = misfit[channel == place]
        return float(np.sqrt(np.mean(own**2)) / model.campaign.channels[place].scale_si / to_si("deg"))

    return tuple(
        RmsChange(channel=each.name, before=rms(was, place), after=rms(now, place), unit="deg/s")
        for place, each in enumerate(model.campaign.channels)
        if each.kind == "gyro"
    )


def groups(model: Model) -> tuple[Literal["run", "pose", "block"], tuple[str, ...], tuple[np.ndarray, ...]]:
    """Return what is left out at a time: run, pose or block, its names, and which entries belong to each, shape (E,).

    A campaign of one run is predicted pose by pose, or if it has none in blocks of neighbouring rows: a row alone
    would be determined by its neighbours.
    """
    entries, runs = model.entries, model.campaign.runs
    run = runs[0] if len(runs) == 1 else None
    if run is None:
        return "run", tuple(run.name for run in runs), tuple(entries.run == place for place in range(len(runs)))
    if run.tumble is not None:
        pose = run.tumble.pose[np.where(entries.closing, 0, entries.row)]
        there = np.unique(pose[~entries.closing])
        masks = tuple((pose == number) & ~entries.closing for number in there)
        return "pose", tuple(map(str, there.tolist())), masks
    in_time = np.argsort(run.covariates["time"], kind="stable") if "time" in run.covariates else np.arange(run.rows)
    blocks = np.array_split(in_time, max(min(_MAX_BLOCKS, run.rows // _BLOCK_ROWS), 1))
    names = tuple(f"rows {block.min() + 1} to {block.max() + 1}" for block in blocks)
    return "block", names, tuple(np.isin(entries.row, block) for block in blocks)


def whole_fit(fitted: Fit) -> WholeFit:
    """Return what the fits without a part start from."""
    about = linearise(fitted.model.problem, np.asarray(fitted.z))
    return WholeFit(fitted, about, curvature(fitted.model.problem, about, np.asarray(fitted.h)).information)


def predict_left_out(whole: WholeFit, left_out: np.ndarray) -> LeftOut:
    """Return how the rest predicts what is left out, everything refitted to it, from where all together fit.

    Parameters
    ----------
    whole : the fit to all.
    left_out : shape (E,), True for the entries to predict.
    """
    fitted, problem = whole.fitted, whole.fitted.model.problem
    rest, h = masked(problem, left_out), np.asarray(fitted.h)
    mode = mode_near(rest, whole.about, h, whole.information)
    if not bool(mode.converged):
        mode = find_mode(rest, np.asarray(fitted.z), h)
    # Under a normal law the density of all may be taken about the fit to the rest; a heavy tail is no parabola.
    all_data = (
        linearise(problem, fit_at(problem, np.asarray(fitted.z), mode.h)) if has_heavy_tails(problem) else mode.about
    )
    density = _marginal(problem, all_data, mode.h) - _marginal(rest, mode.about, mode.h)
    return LeftOut(density, np.asarray(mode.about.misfit)[left_out])


def _marginal(problem: Problem, about: Linearised, h: np.ndarray) -> float:
    """Return log p(y, h) with θ integrated out."""
    return float(ScaleMarginal(problem, about).values(h[None])[0])


def observed_delta_chi2(before: Fit, after: Fit) -> float:
    """Return the drop of chi² that the refit of a changed model brought.

    At the noise scales of the old fit, and without the priors of what one of the models lacks; if noise scales
    differ, twice the rise of the log likelihood with the parameters integrated out.
    """
    if after.model.hyper_layout.names != before.model.hyper_layout.names:
        return 2 * (_log_likelihood(after) - _log_likelihood(before))
    return float(np.sum(_drops(before, after)))


def _drops(before: Fit, after: Fit) -> np.ndarray:
    """Return the drop of chi² of each row, priors of shared parameters last, at the noise scales of the old fit."""
    old, new = before.model, after.model
    h = np.asarray(_in_order(old.hyper_layout, before.h, new.hyper_layout))
    z = fit_at(new.problem, np.asarray(after.z), h)
    was, now = _residuals(old.problem, before.z, before.h), _residuals(new.problem, z, h)
    return _without_priors(was, old.layout, new.layout) ** 2 - _without_priors(now, new.layout, old.layout) ** 2


def _residuals(problem: Problem, z: np.ndarray, h: np.ndarray) -> np.ndarray:
    misfit = problem.observations.value - predict_many(problem, z[None])[0]
    return residuals_of(problem, misfit, z, h)


def _without_priors(rows: np.ndarray, layout: Layout, other: Layout) -> np.ndarray:
    """Return rows, priors of a layout last, less the priors of what another layout lacks, in the order of names."""
    count = len(rows) - len(layout)
    priors = dict(zip(layout.names, rows[count:].tolist(), strict=True))
    return np.concatenate([rows[:count], [priors[name] for name in sorted(priors.keys() & set(other.names))]])


def _in_order(old: Layout, point: np.ndarray, new: Layout) -> np.ndarray:
    return np.array([point[old.index(name)] for name in new.names], dtype=float)


def _log_likelihood(fitted: Fit) -> float:
    """Return log p(y | h) with θ integrated out about the mode."""
    problem, h = fitted.model.problem, np.asarray(fitted.h)
    about = linearise(problem, np.asarray(fitted.z))
    prior = 0.5 * float(hyper_prior_square(problem, h)) + 0.5 * len(fitted.h) * np.log(2 * np.pi)
    return _marginal(problem, about, h) + prior


def objection(after: Fit, delta_chi2: float, may_rise: bool = False) -> str:
    """Return the sentence that says why a refit is not taken; empty if nothing speaks against it.

    Parameters
    ----------
    after : the refit.
    delta_chi2 : drop of χ².
    may_rise : whether χ² may rise, as if effects are removed.
    """
    if not after.converged:
        return f"The refit is not taken. {after.message}"
    if not (may_rise or delta_chi2 > REFIT_LOSS):
        return (
            "The refit is not taken: it fits worse than the model without the addition (χ² rose by "
            f"{-delta_chi2:.1f} at the same noise scales)."
        )
    return ""
