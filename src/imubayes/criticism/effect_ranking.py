"""Every effect that the runs can show, ranked by how probable it is that it is missing."""

import math

import numpy as np

from imubayes.criticism.diagnosis_record import RankedEffect
from imubayes.criticism.evidence.hypothesis import Evaluated, inverse
from imubayes.criticism.evidence.model_search import states_noise
from imubayes.criticism.evidence.posterior_summary import ExplanationPosterior
from imubayes.criticism.evidence.proposals import Conditional, Screen, conditional
from imubayes.criticism.verdict import CoefficientEstimate


def ranking(posterior: ExplanationPosterior) -> tuple[RankedEffect, ...]:
    """Return one line per effect, by its inclusion probability, then by its log odds alone."""
    of = posterior.of
    nothing = posterior.search.best(states_noise)
    alone = conditional(of, of.solved(nothing))
    as_known = conditional(of, of.solved(nothing, np.ones(len(nothing.scale))))
    best: dict[str, RankedEffect] = {}
    for gain, n in Screen(of).singles(alone):
        if of.variants[n].effect not in best:
            best[of.variants[n].effect] = _line(posterior, nothing, alone, as_known, n, gain)
    return tuple(sorted(best.values(), key=lambda each: (-each.probability, -each.log_odds)))


def _line(
    posterior: ExplanationPosterior, nothing: Evaluated, alone: Conditional, as_known: Conditional, n: int, gain: float
) -> RankedEffect:
    of, variant = posterior.of, posterior.of.variants[n]
    places = np.array(variant.places)
    covariance = inverse(_positive(alone.own[np.ix_(places, places)]) + np.eye(len(places)) / max(variant.widths) ** 2)
    mean, sizes = covariance @ alone.right[places], of.problem.sizes[places]
    own, right = as_known.own[np.ix_(places, places)], as_known.right[places]
    return RankedEffect(
        effect=variant.effect,
        channels=variant.owners,
        probability=posterior.including([variant.effect]),
        delta_chi2=float(right @ np.linalg.lstsq(own, right, rcond=1e-9)[0]),
        shape=dict(of.problem.candidates[variant.response].scan.shape),
        coefficients=tuple(
            CoefficientEstimate(
                name=of.problem.coefficients[k].parameter.name,
                value=float(value * size),
                sd=float(math.sqrt(variance) * size),
                unit=of.problem.coefficients[k].parameter.shown_unit,
            )
            for k, value, variance, size in zip(places, mean, np.diag(covariance), sizes, strict=True)
        ),
        log_odds=gain,
    )


def _positive(own: np.ndarray) -> np.ndarray:
    """Return a symmetric matrix without the negative eigenvalues that rounding gives it."""
    squares, axes = np.linalg.eigh(0.5 * (own + own.T))
    return (axes * np.maximum(squares, 0.0)) @ axes.T
