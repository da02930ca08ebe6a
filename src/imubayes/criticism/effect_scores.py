"""Scores of all candidate effects in a fit, in a form that adds over units.

With r the residual and g⊥ the response to the coefficients of a candidate, both divided by the noise and less what the
parameters of the model absorb, the score U = g⊥ᵀr and the information V = g⊥ᵀg⊥ are all that is needed of a unit: the
likelihood of its coefficients is exp(Uᵀb − bᵀVb/2), and logarithms add up over units.  All coefficients of all
candidates stand in one U and one V, so that candidates can be compared with and cleared of each other.

Priors give no evidence here.  A population that its prior does not expect would count as evidence for an effect in
every unit, and over a hundred units as strong evidence: what the parameters absorb is projected out as if their priors
were flat.

The noise of a channel is that known beforehand, drawn towards the scatter of its rows as far as it is not known well.
If the rows scatter more than that, it is what they say: a unit with a gross error must not outvote all others.  The
scatter is what the most probable effect leaves over, if one explains the rows of the unit: it would hide itself
otherwise.
"""

import math
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from imubayes.criticism.evidence.effect_variants import SEEN, SHOWN, EffectVariant, gain_of_coefficients
from imubayes.criticism.evidence.hypothesis_evidence import EvidenceOf, Hypothesis, scale_mode
from imubayes.criticism.evidence.linear_problem import LinearProblem, linear_problem
from imubayes.inference.fitted_model import Fit
from imubayes.responses.candidate_effects import Response, candidate_responses

_RANK = 1e-10
"""Singular values of the model's Jacobian, relative to the largest, below which a direction is rounding."""
_RETAINED = 1e-6
"""Share of a response, squared, that the model must leave over: less is rounding."""
_ROUNDS, _SETTLED, _LEAST_FREEDOM = 10, 1e-3, 2.0


@dataclass(frozen=True)
class CandidateKey:
    """A candidate over units.

    Attributes
    ----------
    effect, shape : its name, and the values of its shape parameters as text; empty if it has none.
    scope : the kind of channel, or the channel, mounting or table that it acts on alone.
    part : the only parameter that it has; empty for all of them.
    """

    effect: str
    shape: str
    scope: str
    part: str = ""


@dataclass(frozen=True)
class ScoredEffect:
    """A candidate in one form.

    Attributes
    ----------
    owners : channels, mountings or tables.
    places : places of its coefficients.
    log_odds : logarithm of the prior odds that it is missing.
    widths : standard deviations of the prior of its coefficients, in their largest typical sizes; equally likely.
    """

    key: CandidateKey
    owners: tuple[str, ...]
    places: tuple[int, ...]
    log_odds: float
    widths: tuple[float, ...]


@dataclass(frozen=True)
class EffectScores:
    """The scores of a fit.

    Attributes
    ----------
    names, measures : of the C coefficients, and their units.
    sizes : shape (C,), largest typical sizes, in their units: what scores count in.
    signs : shape (C,), the only sign allowed, 0 for either.
    score, information : shapes (C,) and (C, C); 0 where the model absorbs a coefficient.
    candidates : of which something is left.
    """

    names: tuple[str, ...]
    measures: tuple[str, ...]
    sizes: np.ndarray
    signs: np.ndarray
    score: np.ndarray
    information: np.ndarray
    candidates: tuple[ScoredEffect, ...]


@dataclass(frozen=True)
class CoefficientScores:
    """The likelihoods exp(uᵀb − bᵀVb/2) of the same K coefficients in n cases: units, or groups of them.

    Attributes
    ----------
    score, information : shapes (n, K) and (n, K, K).
    sign : shape (K,), the only sign allowed, 0 for either.
    """

    score: np.ndarray
    information: np.ndarray
    sign: np.ndarray

    def log_gain(self, width: float) -> np.ndarray:
        """Return the log evidence, (n,), of coefficients whose prior is normal about zero, over that of zero."""
        return gain_of_coefficients(self.information, self.score, np.full(self.score.shape, width), self.sign)

    def of_mean(self, spread: float) -> "CoefficientScores":
        """Return the scores of the mean of coefficients that are normal about it with a spread."""
        shrink = np.linalg.inv(np.eye(len(self.sign)) + spread**2 * self.information)
        score = np.einsum("nkl,nl->nk", shrink, self.score)
        return CoefficientScores(score, shrink @ self.information, self.sign)

    def summed(self, weight: np.ndarray) -> "CoefficientScores":
        """Return the scores of sums over cases of the same coefficients, with weights (G, n)."""
        return CoefficientScores(weight @ self.score, np.tensordot(weight, self.information, 1), self.sign)

    @property
    def reach(self) -> np.ndarray:
        """Standard deviations, (n,), at which coefficients of size 1 stand where they are determined best."""
        return np.sqrt(np.linalg.eigvalsh(self.information)[:, -1].clip(0.0))


def shown_widths(widths: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Return which widths, (Q,), are hypotheses at a reach, (n,): others the data would not show; (n, Q) bool."""
    return (widths * reach[:, None] >= SEEN) & (reach[:, None] >= SHOWN)


def effect_scores(fit: Fit) -> EffectScores:
    """Return the scores of every candidate effect of a converged fit."""
    return scores_of(linear_problem(fit, candidate_responses(fit)))


def scores_of(problem: LinearProblem) -> EffectScores:
    """Return the scores of the candidates of a linearised fit."""
    of = EvidenceOf(problem)
    score, information = _past_own(of, _likeliest_noise(of))
    shapes = [_shape(each) for each in problem.candidates for _ in each.coefficients]
    names = (
        f"{each.parameter.name}{f' at {shape}' if shape else ''}"
        for each, shape in zip(problem.coefficients, shapes, strict=True)
    )
    measures = tuple(each.parameter.shown_unit for each in problem.coefficients)
    candidates = tuple(_candidates(of, np.diag(information) > 0))
    return EffectScores(tuple(names), measures, problem.sizes, problem.sign, score, information, candidates)


def _likeliest_noise(of: EvidenceOf) -> Hypothesis:
    """Return the hypothesis that nothing is missing, at the most probable scatter between runs of the model."""
    found = Hypothesis((), of.stated)
    for place, unit in enumerate(of.units):
        if len(unit.stated) > 1:
            tried = [of.evaluate(found.with_noise(place, each)) for each in unit.stated]
            found = max(tried, key=lambda each: each.log_posterior).hypothesis
    return found


def _past_own(of: EvidenceOf, noise: Hypothesis) -> tuple[np.ndarray, np.ndarray]:
    """Return score (C,) and information (C, C) of all coefficients past the model's own parameters, no prior on these.

    Coefficients of which nothing is left are 0 in both.
    """
    columns, channel = _whitened_rows(of, noise)
    own, problem = of.problem.own, of.problem
    scale = _scatter(problem, columns[:, :own], columns[:, -1], channel)
    left = _left_over(columns, own, scale[channel])
    explaining = _explaining(of, left, channel)
    if explaining:
        jacobian = columns[:, [*range(own), *(own + place for place in explaining)]]
        scale = _scatter(problem, jacobian, columns[:, -1], channel)
        left = _left_over(columns, own, scale[channel])
    products = left.T @ left
    return products[:-1, -1], products[:-1, :-1]


def _left_over(columns: np.ndarray, own: int, scale: np.ndarray) -> np.ndarray:
    """Return the columns [X r] over the scale (n,) of each row, past the own parameters of the model; rounding is 0."""
    basis, free = _span(columns[:, :own] / scale[:, None]), columns[:, own:] / scale[:, None]
    left = free - basis @ (basis.T @ free)
    kept = np.sum(left**2, axis=0) > _RETAINED * np.sum(free**2, axis=0)
    kept[-1] = True
    return left * kept


def _explaining(of: EvidenceOf, left: np.ndarray, channel: np.ndarray) -> tuple[int, ...]:
    """Return the coefficients of the effect that explains the scatter of a unit best; empty if none does.

    Noise scales are taken as unknown: the evidence is that of the sums of squares before and after (Schwarz 1978).

    Parameters
    ----------
    left : shape (n, C + 1), what the model's own parameters leave of [X r].
    """
    groups = [np.flatnonzero(channel == k) for k in np.unique(channel)]

    def logarithms(rest: np.ndarray) -> float:
        return sum(0.5 * len(rows) * math.log(max(float(rest[rows] @ rest[rows]), 1e-12)) for rows in groups)

    best, found, before = 0.0, tuple[int, ...](), logarithms(left[:, -1])
    for each in of.variants:
        places = list(each.places)
        basis = _span(left[:, places])
        rest = left[:, -1] - basis @ (basis.T @ left[:, -1])
        gain = before - logarithms(rest) - 0.5 * len(places) * math.log(len(rest)) + each.log_odds
        if gain > best:
            best, found = gain, each.places
    return found


def _whitened_rows(of: EvidenceOf, noise: Hypothesis) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of all channels with the columns [J X r], (n, P + C + 1), and the channel of each, (n,)."""
    count = of.problem.own + len(of.problem.coefficients)
    channels = sorted(of.unit_of)
    columns = np.zeros((of.problem.outputs, count + 1))
    channel = np.repeat(channels, [len(of.problem.rows[k].entry) for k in channels]).astype(int)
    for k in channels:
        columns[np.ix_(channel == k, [*of.problem.rows[k].live, count])] = of.whitened(noise, k)
    return columns, channel


def _scatter(problem: LinearProblem, jacobian: np.ndarray, residual: np.ndarray, channel: np.ndarray) -> np.ndarray:
    """Return the noise scale of each channel, (K,), of a residual (n,) past the columns of a Jacobian (n, P)."""
    scale = np.ones(len(problem.rows))
    for _ in range(_ROUNDS):
        basis = _span(jacobian / scale[channel, None])
        misfit = residual / scale[channel]
        rest, left = misfit - basis @ (basis.T @ misfit), 1 - np.sum(basis**2, axis=1)
        before = scale.copy()
        for k in np.unique(channel):
            freedom = max(float(left[channel == k].sum()), _LEAST_FREEDOM)
            square = max(float(np.sum(rest[channel == k] ** 2) * before[k] ** 2), 1e-12)
            mode, _ = scale_mode(square, freedom, problem.rows[k].scale_sd)
            scale[k] = max(math.exp(mode), math.sqrt(square / freedom))
        if np.max(np.abs(np.log(scale / before)), initial=0.0) < _SETTLED:
            break
    return scale


def _span(jacobian: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis of the columns of a Jacobian, (n, rank)."""
    size = np.linalg.norm(jacobian, axis=0)
    left, singular, _ = np.linalg.svd(jacobian / np.where(size > 0, size, 1.0), full_matrices=False)
    return left[:, singular > _RANK * singular.max(initial=0.0)]


def _shape(response: Response) -> str:
    return ", ".join(f"{name}={value:g}" for name, value in response.scan.shape.items())


def _candidates(of: EvidenceOf, left: np.ndarray) -> Iterator[ScoredEffect]:
    """Yield the variants of which something is left, left (C,) bool, as they are called in every unit."""
    problem = of.problem
    kinds = {rows.name: rows.kind for rows in problem.of_channels}
    owners, fields = defaultdict[tuple[int, str], set[str]](set), defaultdict[tuple[int, str], set[str]](set)

    def about(each: EffectVariant) -> tuple[tuple[int, str], set[str]]:
        cause = each.response, kinds.get(each.owners[0], "")
        return cause, {problem.coefficients[k].parameter.field for k in each.places}

    for each in of.variants:
        cause, own = about(each)
        owners[cause].update(each.owners)
        fields[cause].update(own)
    for each in of.variants:
        cause, own = about(each)
        places = tuple(k for k in each.places if left[k])
        if places:
            scope = each.owners[0] if len(each.owners) < len(owners[cause]) else cause[1] or "equipment"
            part = next(iter(own)) if len(own) < len(fields[cause]) else ""
            owned = tuple(dict.fromkeys(problem.coefficients[k].owner for k in places))
            shape = _shape(problem.candidates[each.response])
            key = CandidateKey(each.effect, shape, scope, part)
            yield ScoredEffect(key, owned, places, each.log_odds, each.widths)
