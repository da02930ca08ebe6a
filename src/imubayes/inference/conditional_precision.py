"""Precision of θ at any noise scales, and coordinates of the scales for correlated noise.

If rows are independent but for the offset of their run, and normal, statistics of the linearisation give it
(`imubayes.inference.scale_statistics`).  If few rows are correlated, or their noise is slow, it is computed anew for
each h, by a compiled program; if they are many or have heavy tails, from blocks stored once.

The offset that all rows of a run share moves their mean alone, so knowledge falls into two parts.  Differences within a
run do not feel the scatter between runs: with scales d_j = log s_j(h)/s_j(ĥ) their precision and gradient are Σ_j
exp(−2 d_j) of one block a scale, exact for independent noise.  A correlation φ of rows multiplies the blocks of its
rows as it does their information on the mean of a run.  The mean of run and channel g has variance T_g(h) + 1/n_g(h),
T_g the shared variance and n_g the information of its rows on the mean, whatever the ratio of the two; run means of the
same variance at every h are one block together.

Correlated noise makes a ridge in the posterior of its scales.  Of AR(1) noise r_k = φ r_(k−1) + √(1 − φ²) ε_k a series
determines the standard deviation of the innovations, σ √(1 − φ²), at once, and σ and φ only after many correlation
times: as φ nears 1 both grow together, along a curve (Box and Jenkins).  With the scale of the innovations in place of
that of the noise there is no ridge: in the logarithm of σ √(1 − φ²) the curve is straight.  The shear that leads there
does not change φ, so its determinant is 1.
"""

from collections.abc import Callable
from dataclasses import dataclass

import equinox as eqx
import jax
import numpy as np

from imubayes.compiled.kept_programs import kept
from imubayes.foundations.arrays import Array, Float, Int
from imubayes.inference.laplace_marginal import ScaleMarginal, knowledge
from imubayes.inference.parameter_fit import Linearised
from imubayes.inference.posterior_mode import Mode
from imubayes.inference.scale_statistics import ScaleStatistics
from imubayes.model.likelihood import has_heavy_tails, pseudo_values
from imubayes.model.noise_covariance import (
    group_sum,
    noise_distribution,
    row_correlations,
    rows_correlate,
    whitener,
)
from imubayes.model.problem import Problem, prior_widths
from imubayes.noise.components import EntryNoise, SeriesNoise, SharedNoise, TailNoise

# Run means are of one class if their variances agree to this, relative, at the mode and at a few points besides.
_DIGITS, _PROBES = 9, 3
# Products up to which the precision of correlated rows is computed anew for each draw: half a millisecond.
_MOST_WORK = 5e6
# Half the distance of central differences by the logarithm of a scale.
_APART = 1e-4
# Noise scales for which it is computed in one call.
_AT_ONCE = 16


class PrecisionBlocks(eqx.Module):
    """Precision and gradient of θ about the mode, in parts that scale each by its own number.

    Attributes
    ----------
    h : shape (H,), hyperparameters of the mode.
    z : shape (P,), parameters of the mode.
    within, within_gradient : shapes (H, P, P) and (H, P), what shrinks with each scale.
    fixed, fixed_gradient : shapes (P, P) and (P,), what no scale changes.
    between, between_gradient : shapes (K, P, P) and (K, P), what run means of each class know at variance 1.
    member : shape (K,), a run and channel of each class.
    rows : shape (H, G), share of the rows on which each scale acts in every run and channel; 0 for what is no scale.
    """

    h: Float[Array, " H"]
    z: Float[Array, " P"]
    within: Float[Array, "H P P"]
    within_gradient: Float[Array, "H P"]
    fixed: Float[Array, "P P"]
    fixed_gradient: Float[Array, " P"]
    between: Float[Array, "K P P"]
    between_gradient: Float[Array, "K P"]
    member: Int[Array, " K"]
    rows: Float[Array, "H G"]


class Parts(eqx.Module):
    """Knowledge within runs, (P, P) and (P,), and the mean of each: Jacobian (G, P) and misfit (G,)."""

    precision: Float[Array, "P P"]
    gradient: Float[Array, " P"]
    mean: Float[Array, "G P"]
    mean_misfit: Float[Array, " G"]


class ExactPrecision(eqx.Module):
    """Precision of θ computed anew at every h, for noise whose parameters are no scales of independent parts.

    Attributes
    ----------
    about : the model linearised about the mode.
    """

    about: Linearised


Conditional = ScaleStatistics | PrecisionBlocks | ExactPrecision
"""Source of precision and gradient of θ at any h."""


def conditional(of: Conditional, problem: Problem, h: Float[Array, "n H"]) -> tuple[np.ndarray, np.ndarray]:
    """Return precision (n, P, P) and gradient (n, P) of the log density of θ given each h, about the mode."""
    if isinstance(of, ScaleStatistics):
        given = of.normal(h)
        return given.precision, given.gradient
    prior = prior_widths(problem, h) ** -2
    if isinstance(of, ExactPrecision):
        precision, gradient = _computed_anew(problem, of.about, h)
        z = of.about.z
    else:
        values = problem.hyper_priors.values
        shrink = (values(of.h) / values(h)) ** 2
        if rows_correlate(problem):
            means = np.stack([_of_means(problem, each) for each in h]) / _of_means(problem, of.h) - 1
            shrink = shrink * (1 + means @ of.rows.T)
        weight = 1 / np.stack([mean_variances(problem, each)[of.member] for each in h])
        precision = np.tensordot(shrink, of.within, 1) + np.tensordot(weight, of.between, 1) + of.fixed
        gradient = shrink @ of.within_gradient + weight @ of.between_gradient + of.fixed_gradient
        z = of.z
    place = np.arange(prior.shape[-1])
    precision[:, place, place] += prior
    return precision, gradient - prior * z


def _computed_anew(problem: Problem, about: Linearised, h: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    parts = []
    for start in range(0, len(h), _AT_ONCE):
        some = h[start : start + _AT_ONCE]
        padded = np.concatenate([some, np.repeat(some[-1:], _AT_ONCE - len(some), axis=0)])  # compiled for one size
        parts.append([np.array(part)[: len(some)] for part in _knowledge_at(problem, about, padded)])
    precision, gradient = (np.concatenate(each) for each in zip(*parts, strict=True))
    return precision, gradient


@kept
def _knowledge_at(problem: Problem, about: Linearised, h: Float[Array, "n H"]):
    def at(scales):
        known = knowledge(problem, about, scales)
        return known.precision, known.gradient

    return jax.lax.map(at, h)


def _of_means(problem: Problem, h: Float[Array, " H"]) -> Float[Array, " G"]:
    """Return what correlation leaves of the information of a run on its mean, 1ᵀR⁻¹1/n of AR(1), rows not masked."""
    correlation = row_correlations(problem, problem.hyper_priors.values(h))
    count = np.maximum(group_sum(np.where(problem.observations.weight > 0, 1.0, 0.0), problem.observations), 1.0)
    return (1 - (1 - 2 / np.maximum(count, 2.0)) * correlation) / (1 + correlation)


def conditional_precision(problem: Problem, mode: Mode) -> Conditional:
    """Return what gives the precision of θ at any noise scales about a mode."""
    if problem.timeline is not None or _small_and_correlated(problem):
        return ExactPrecision(mode.about)
    if rows_correlate(problem) or has_heavy_tails(problem):
        return precision_blocks(problem, mode)
    statistics = ScaleMarginal(problem, mode.about).statistics
    assert statistics is not None
    return statistics


def _small_and_correlated(problem: Problem) -> bool:
    """Whether rows are correlated and the exact precision is cheap.

    In the blocks the rows of a run weigh alike; as φ nears 1 its ends weigh more than all between.
    """
    work = len(problem.observations.value) * problem.size[0] ** 2
    return work <= _MOST_WORK and rows_correlate(problem)


def run_means(problem: Problem, h: Float[Array, " H"]) -> tuple[np.ndarray, np.ndarray]:
    """Return of the mean of each run and channel the precision within the run, and the variance its rows share."""
    precision = group_sum(whitener(problem, h).direction ** 2, problem.observations)
    return precision, noise_distribution(problem, h).shared_variance


@np.errstate(divide="ignore")
def mean_variances(problem: Problem, h: Float[Array, " H"]) -> np.ndarray:
    """Return the variance of the mean of each run and channel, shared variance included; ∞ if all is masked."""
    precision, shared = run_means(problem, h)
    return shared + 1 / precision


def _classes(problem: Problem, h: Float[Array, " H"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a member of each class of run means, (K,), the class of each, (G,), and whether it shares noise, (G,)."""
    acts = [layer.acts for layer in problem.noise if issubclass(layer.noise, SharedNoise)]
    shared = np.sum(acts, axis=0) > 0 if acts else np.zeros(problem.observations.members.shape[0], bool)
    away = np.random.default_rng(0).normal(size=(_PROBES, len(h)))
    variances = np.stack([mean_variances(problem, h + step) for step in (np.zeros(len(h)), *away)], axis=-1)
    shared &= np.isfinite(variances).all(axis=-1)
    class_of = np.full(len(shared), -1)
    if not shared.any():
        return np.zeros(0, int), class_of, shared
    signature = np.round(np.log(variances[shared]), _DIGITS)
    _, first, class_of[shared] = np.unique(signature, axis=0, return_index=True, return_inverse=True)
    return np.flatnonzero(shared)[first], class_of, shared


def _parts(problem: Problem, about: Linearised, shared: np.ndarray, h: np.ndarray) -> Parts:
    """Return knowledge within runs, and run means; a run without shared noise has all its knowledge within."""
    by, observations = whitener(problem, h), problem.observations
    jacobian, misfit = by.scale(about.jacobian), by.scale(pseudo_values(problem, h, about.misfit))
    direction = by.direction
    information = group_sum(direction**2, observations)
    safe = np.where(information > 0, information, 1.0)
    mean = group_sum(direction[:, None] * jacobian, observations) / safe[:, None]
    mean_misfit = group_sum(direction * misfit, observations) / safe
    taken = np.where(shared, information, 0.0)
    precision = jacobian.T @ jacobian - mean.T @ (taken[:, None] * mean)
    return Parts(precision, jacobian.T @ misfit - mean.T @ (taken * mean_misfit), mean, mean_misfit)


def precision_blocks(problem: Problem, mode: Mode) -> PrecisionBlocks:
    """Return the blocks about a mode."""
    member, class_of, shared = _classes(problem, mode.h)
    count, size = len(mode.h), len(mode.z)
    blocks, gradients = np.zeros((count, size, size)), np.zeros((count, size))
    values = problem.hyper_priors.values(mode.h)
    steps = _APART * values / problem.hyper_priors.slopes(mode.h)
    # Tails and correlations shape the distribution of the noise and are no scales.
    for place in np.flatnonzero(_is_scale(problem)):
        step = np.where(np.arange(count) == place, steps, 0.0)
        up, down = (_parts(problem, mode.about, shared, mode.h + side * step) for side in (1, -1))
        blocks[place] = -0.25 / _APART * (up.precision - down.precision)
        gradients[place] = -0.25 / _APART * (up.gradient - down.gradient)
    parts = _parts(problem, mode.about, shared, mode.h)
    means = [parts.mean[class_of == number] for number in range(len(member))]
    misfits = [parts.mean_misfit[class_of == number] for number in range(len(member))]
    between = np.array([mean.T @ mean for mean in means]).reshape(-1, size, size)
    pairs = zip(means, misfits, strict=True)
    between_gradients = np.array([mean.T @ misfit for mean, misfit in pairs]).reshape(-1, size)
    fixed, fixed_gradient = parts.precision - blocks.sum(0), parts.gradient - gradients.sum(0)
    return PrecisionBlocks(
        mode.h, mode.z, blocks, gradients, fixed, fixed_gradient, between, between_gradients, member, _rows(problem)
    )


def _rows(problem: Problem) -> np.ndarray:
    """Return the share of the rows on which each scale acts in every run and channel, (H, G)."""
    observations = problem.observations
    found = np.zeros((len(problem.hyper_priors.order), observations.members.shape[0]))
    for layer in problem.noise:
        if issubclass(layer.noise, EntryNoise):
            for place in layer.places.values():
                np.add.at(found, (place, observations.group), layer.acts)
    total = found.sum(axis=1, keepdims=True)
    return np.where(total > 0, found / np.where(total > 0, total, 1.0), 0.0)


def _is_scale(problem: Problem) -> np.ndarray:
    """Return 1 for a hyperparameter that scales the noise, 0 for one that shapes its distribution, (H,)."""
    found = np.ones(len(problem.hyper_priors.order))
    for layer in problem.noise:
        if issubclass(layer.noise, TailNoise | SeriesNoise):
            for place in layer.places.values():
                np.minimum.at(found, place, 1 - layer.acts)
    return found


# Least singular value, relative to the largest, that counts for how scales move the variance of a run.
_LEAST = 1e-6


@dataclass(frozen=True)
class InnovationScale:
    """The shear h = u + S (λ(u) − λ(ĥ)) with λ = ½ log(1 − φ²) of each run and channel.

    Attributes
    ----------
    slope : S, shape (H, G); its rows are 0 for the correlations themselves.
    at_mode : λ(ĥ), shape (G,).
    """

    slope: np.ndarray
    at_mode: np.ndarray

    def straightened(self, problem: Problem, h: Float[Array, "*batch H"]) -> np.ndarray:
        """Return u of noise scales h."""
        return h - self._along_ridge(problem, h)

    def scales(self, problem: Problem, straight: Float[Array, "*batch H"]) -> np.ndarray:
        """Return the noise scales h of u."""
        return straight + self._along_ridge(problem, straight)

    def straightened_information(self, problem: Problem, h: np.ndarray, information: np.ndarray) -> np.ndarray:
        """Return the negative Hessian (H, H) in u of a density of h at its mode, from that in h."""
        slope = _by_differences(lambda straight: self.scales(problem, straight), h)
        return slope.T @ information @ slope

    def _along_ridge(self, problem: Problem, h: Float[Array, "*batch H"]) -> np.ndarray:
        return (_log_innovation(problem, h) - self.at_mode) @ self.slope.T


def innovation_scale(problem: Problem, h: Float[Array, " H"]) -> InnovationScale | None:
    """Return the shear about the mode h; None if no rows are correlated."""
    if problem.timeline is not None or not rows_correlate(problem):
        return None
    sensitivity = _by_differences(lambda point: _mean_log_scale(problem, point), h)
    return InnovationScale(-np.linalg.pinv(sensitivity, rcond=_LEAST), _log_innovation(problem, h))


def _by_differences(function: Callable[[np.ndarray], np.ndarray], h: np.ndarray) -> np.ndarray:
    """Return the Jacobian of a function of h by central differences."""
    steps = _APART * np.eye(len(h))
    return np.stack([(function(h + step) - function(h - step)) / (2 * _APART) for step in steps], axis=-1)


def _mean_log_scale(problem: Problem, h: np.ndarray) -> np.ndarray:
    """Return the mean logarithm of the noise of each run and channel, (G,)."""
    own, observations = noise_distribution(problem, h).squared_scale, problem.observations
    there = np.where(observations.weight > 0, 1.0, 0.0)
    logarithm = np.log(np.where(there > 0, own, 1.0))
    return 0.5 * group_sum(logarithm, observations) / np.maximum(group_sum(there, observations), 1.0)


def _log_innovation(problem: Problem, h: Float[Array, "*batch H"]) -> np.ndarray:
    return 0.5 * np.log1p(-(row_correlations(problem, problem.hyper_priors.values(h)) ** 2))
