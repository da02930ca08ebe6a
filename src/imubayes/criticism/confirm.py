"""Whether an addition holds: what was found against what was expected, and how well runs are predicted unseen.

A run that is left out is predicted from the others: p(y_k | y_−k) is the ratio of two Laplace marginals at the mode
without it, one with the run and one without, so that its offset and the parameters that it alone determines are
integrated out (leave-one-group-out predictive density; Vehtari, Gelman & Gabry, Statistics and Computing 2017).
"""

from collections.abc import Callable
from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from imubayes.criticism.extend import Extension
from imubayes.inference.fit import find_mode, fit_at
from imubayes.inference.fitted import Fitted
from imubayes.inference.precision import linearise, log_marginal
from imubayes.model.declaration import Model
from imubayes.model.likelihood import Problem, residuals
from imubayes.parameters.vector import Layout

# A refit of a model that contains the old one cannot be worse but for the priors of what is new.
_WORSE = -0.5
# Twice its standard error: a gain less than this may be chance.
_SURE = 2.0
# A parameter that is not needed costs half a unit of log density on unseen data; a gain below that is none.
_LEAST_GAIN = 0.5

_log_marginal = eqx.filter_jit(log_marginal)
_linearise = eqx.filter_jit(linearise)
_residuals = eqx.filter_jit(residuals)


@dataclass(frozen=True)
class HeldOut:
    """What an addition does to the prediction of data that were left out.

    Attributes
    ----------
    by : what was left out at a time, ``run`` or ``pose``.
    names : of what was left out.
    gains : shape (K,), rise of the log predictive density of each.
    """

    by: str
    names: tuple[str, ...]
    gains: np.ndarray

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
        if not self.gain > _LEAST_GAIN:
            return "not"
        return "helps" if self.gain > _SURE * self.se else "unclear"


def held_out(before: Fitted, after: Fitted, progress: Callable[[str], None] | None = None) -> HeldOut:
    """Return how much better what is left out is predicted by the second of two fits of one campaign.

    Runs are left out in turns; of a campaign of one free tumble its poses, whose rotations stay.
    """
    tell = progress or (lambda text: None)
    by, names, masks = groups(before.model)
    gains = []
    for place, mask in enumerate(masks):
        tell(f"predicting {by} {place + 1} of {len(masks)} from the others")
        gains.append(predictive_density(after, mask) - predictive_density(before, mask))
    finite = np.isfinite(gains)
    kept = tuple(name for name, good in zip(names, finite.tolist(), strict=True) if good)
    return HeldOut(by, kept, np.array(gains, dtype=float)[finite])


def groups(model: Model) -> tuple[str, tuple[str, ...], tuple[np.ndarray, ...]]:
    """Return what is left out at a time: run or pose, its names, and which entries belong to each, shape (E,)."""
    entries, runs = model.entries, model.campaign.runs
    tumble = runs[0].tumble if len(runs) == 1 else None
    if tumble is None:
        return "run", tuple(run.name for run in runs), tuple(entries.run == place for place in range(len(runs)))
    pose = tumble.pose[np.where(entries.closing, 0, entries.row)]
    there = np.unique(pose[~entries.closing])
    masks = tuple((pose == one) & ~entries.closing for one in there)
    return "pose", tuple(str(one) for one in there.tolist()), masks


def predictive_density(fitted: Fitted, left_out: np.ndarray) -> float:
    """Return log p(left out | rest) with everything refitted to the rest, from where all together fit.

    Parameters
    ----------
    fitted : the fit to all.
    left_out : shape (E,), True for the entries to predict.
    """
    problem = fitted.model.problem
    rest = without(problem, left_out)
    mode = find_mode(rest, jnp.asarray(fitted.z), jnp.asarray(fitted.h))
    return float(_log_marginal(problem, mode.about, mode.h) - _log_marginal(rest, mode.about, mode.h))


def without(problem: Problem, left_out: np.ndarray) -> Problem:
    """Return the problem with entries masked out; its shapes stay, so that nothing is compiled again."""
    weight = problem.observations.weight * jnp.asarray(~left_out, dtype=float)
    return eqx.tree_at(lambda one: one.observations.weight, problem, weight)


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
    about = _linearise(problem, jnp.asarray(fitted.z))
    prior = 0.5 * float(h @ h) + 0.5 * len(fitted.h) * np.log(2 * np.pi)
    return float(_log_marginal(problem, about, h)) + prior


def objection(after: Fitted, delta_chi2: float) -> str:
    """Return the sentence that says why a refit is not taken; empty where nothing speaks against it."""
    if not after.converged:
        return f"The refit is not taken. {after.message}"
    if not delta_chi2 > _WORSE:
        return (
            f"The refit is not taken: it fits worse than the model without the addition (chi2 rose by "
            f"{-delta_chi2:.1f} at the same noise)."
        )
    return ""
