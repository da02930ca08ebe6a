"""The evidence of one hypothesis: effects that are missing, the noise of each unit, and at most one free form.

Past what the noise scales are, everything is one Gaussian linear model, and the evidence is in closed form.  Scales are
integrated about their mode (Laplace), widths of effects are summed over their grid, coefficients of one sign count
half their normal distribution.  Gram matrices are kept for each channel and structure of the noise, so that a
hypothesis costs one Cholesky factorisation of the coefficients that take part.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from typing import Any

import numpy as np
import scipy.linalg
from scipy.linalg import lapack

from imubayes.criticism.evidence import noise_structures as structures
from imubayes.criticism.evidence.effect_variants import EffectVariant, effect_variants, summed_over_widths
from imubayes.criticism.evidence.free_forms import ChosenForm
from imubayes.criticism.evidence.linear_problem import UNEXPECTED, ChannelRows, LinearProblem
from imubayes.criticism.evidence.whitened_rows import GramMatrix, WhitenedRows, offsets_of_runs

ROUNDS = 30
"""Steps to a mode of scales and weights at most.  Numerical."""
_SETTLED, SETTLED_WEIGHT = 1e-3, 0.03
"""Change of the logarithm of a scale and of a weight within which they have settled.  Derived: errors of the evidence
are of second order in it."""


@dataclass(frozen=True)
class Hypothesis:
    """What is missing: places of variants in order, the noise of each unit, and a form."""

    variants: tuple[int, ...]
    noise: tuple[structures.NoiseOfUnit, ...]
    form: ChosenForm | None = None

    def without(self, variant: int) -> "Hypothesis":
        """Return the hypothesis with a variant taken out."""
        return replace(self, variants=tuple(each for each in self.variants if each != variant))

    def including(self, *variants: int) -> "Hypothesis":
        """Return the hypothesis with further variants."""
        return replace(self, variants=tuple(sorted((*self.variants, *variants))))

    def with_noise(self, unit: int, noise: structures.NoiseOfUnit) -> "Hypothesis":
        """Return the hypothesis with other noise in a unit."""
        return replace(self, noise=(*self.noise[:unit], noise, *self.noise[unit + 1 :]))


@dataclass(frozen=True)
class Evaluated:
    """A hypothesis with its evidence.

    Attributes
    ----------
    log_evidence, log_posterior : natural logarithms, up to a common constant.
    scale : shape (K,), noise scale of each channel.
    widths : prior width of each variant that is most probable.
    columns : shape (n,), own parameters and coefficients that take part, as places among [J X]; the form follows.
    precision, pull : of their priors.
    mean : of the posterior, in prior units: z, largest typical sizes, units of noise.
    weight : channel → (n,) weights of heavy tails.
    """

    hypothesis: Hypothesis
    log_evidence: float
    log_posterior: float
    scale: np.ndarray
    widths: tuple[float, ...]
    columns: np.ndarray
    precision: np.ndarray
    pull: np.ndarray
    mean: np.ndarray
    weight: Mapping[int, np.ndarray]


@dataclass(frozen=True)
class Solved:
    """The posterior of the coefficients of a hypothesis at noise scales (K,): mean (n,) and covariance (n, n)."""

    at: Evaluated
    scale: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray


@dataclass(frozen=True)
class Products:
    """Inner products of what a channel responds to, whitened by the whole noise but for its scale.

    V (m, m) and u (m,), at places `where` (m,) of a hypothesis; the squared residual, and log det of the whitening.
    """

    where: np.ndarray
    own: np.ndarray
    right: np.ndarray
    square: float
    log_det: float


class EvidenceOf:
    """Evaluates hypotheses about a linear problem."""

    def __init__(self, problem: LinearProblem):
        self.problem = problem
        self.variants: tuple[EffectVariant, ...] = effect_variants(problem)
        self.units: tuple[structures.NoiseUnit, ...] = structures.noise_units(problem)
        self.unit_of = {k: place for place, unit in enumerate(self.units) for k in unit.channels}
        self._place = [_places_of(rows, problem.own + len(problem.coefficients)) for rows in problem.rows]
        self.rows = [WhitenedRows(rows) for rows in problem.rows]
        self._of_sisters = cache(partial(structures.log_prior_of_sisters, problem, self.units))
        self.known: dict[Hypothesis, Evaluated] = {}

    @cached_property
    def stated(self) -> tuple[structures.NoiseOfUnit, ...]:
        """The noise as stated, of each unit; the most probable before the data."""
        return tuple(max(unit.stated, key=lambda each: each.log_prior) for unit in self.units)

    @cached_property
    def as_fitted(self) -> tuple[structures.NoiseOfUnit, ...]:
        """The same with correlations in time as fitted."""
        return tuple(unit.as_fitted for unit in self.units)

    def log_prior(self, hypothesis: Hypothesis) -> float:
        """Return the logarithm of the prior probability."""
        found = sum(self.variants[each].log_odds for each in hypothesis.variants)
        found += sum(each.log_prior for each in hypothesis.noise)
        found += self._of_sisters(hypothesis.noise)
        form = hypothesis.form
        return found + (form.log_prior if form is not None else math.log(1 - UNEXPECTED))

    # ---- Gram matrices ----

    def noise(self, at: Hypothesis, channel: int) -> structures.NoiseOfUnit:
        """Return the noise of a channel."""
        return at.noise[self.unit_of[channel]]

    def gram(self, at: Hypothesis, channel: int, weight: np.ndarray | None = None) -> GramMatrix:
        """Return the Gram matrix of all columns that a channel responds to."""
        return self.rows[channel].gram(self.noise(at, channel), weight)

    def whiten(self, at: Hypothesis, columns: np.ndarray, channel: int, weight: np.ndarray | None) -> np.ndarray:
        """Return further columns of a channel, (n, C), whitened by the whole noise of a hypothesis."""
        return self.rows[channel].whiten(self.noise(at, channel), columns, weight)

    def form_columns(self, at: Hypothesis, form: ChosenForm, channel: int, weight: np.ndarray | None) -> np.ndarray:
        """Return the columns of a form on a channel, whitened, (n, k)."""
        return self.whiten(at, form.form.columns[channel].make(), channel, weight)

    def whitened(self, at: Hypothesis, channel: int, weight: np.ndarray | None = None) -> np.ndarray:
        """Return all columns of a channel, the residual last, whitened by the whole noise, (n, L + 1)."""
        return self.rows[channel].whitened(self.noise(at, channel), weight)

    def products(self, at: Hypothesis, columns: np.ndarray, channel: int, weight: np.ndarray | None) -> Products:
        """Return the inner products of the columns of a hypothesis on a channel, those of its form after them."""
        form, (here, place) = at.form, self.select(channel, columns)
        gram = self.rows[channel].gram_of(self.noise(at, channel), place, weight)
        own, right = gram.products[:-1, :-1], gram.products[:-1, -1]
        square, where = float(gram.products[-1, -1]), np.flatnonzero(here)
        if form is None or channel not in form.channels:
            return Products(where, own, right, square, gram.log_det)
        added = self.form_columns(at, form, channel, weight)
        across = added.T @ self.whitened(at, channel, weight)[:, [*place, -1]]
        own = np.block([[own, across[:, :-1].T], [across[:, :-1], added.T @ added]])
        where = self.taking_part(channel, columns, form)
        return Products(where, own, np.append(right, across[:, -1]), square, gram.log_det)

    def solved(self, at: Evaluated, scale: np.ndarray | None = None) -> Solved:
        """Return the posterior of a hypothesis, at other noise scales (K,) if given: larger ones hide effects."""
        scale = at.scale if scale is None else scale
        products = {k: self.products(at.hypothesis, at.columns, k, at.weight.get(k)) for k in self.unit_of}
        whole, right = _Stacked.of(products, len(at.precision)).system(at.precision, at.pull, scale)
        covariance = inverse(whole)
        return Solved(at, scale, covariance @ right, covariance)

    # ---- one hypothesis ----

    def evaluate(self, hypothesis: Hypothesis, start: Evaluated | None = None) -> Evaluated:
        """Return a hypothesis with its evidence, from the scales of one that is near."""
        if hypothesis not in self.known:
            self.known[hypothesis] = _Evaluation(self, hypothesis, start).found()
        return self.known[hypothesis]

    def select(self, channel: int, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return which columns a channel responds to, (n,) bool, and their places in its Gram matrix."""
        place = self._place[channel][columns]
        return place >= 0, place[place >= 0]

    def among(self, found: Evaluated, places: Sequence[int]) -> list[int]:
        """Return where coefficients stand among the columns of a hypothesis."""
        at = {int(column) - self.problem.own: n for n, column in enumerate(found.columns)}
        return [at[k] for k in places]

    def taking_part(self, channel: int, columns: np.ndarray, form: ChosenForm | None) -> np.ndarray:
        """Return the places of what a channel responds to among the columns of a hypothesis, its form after them."""
        here, _ = self.select(channel, columns)
        found = np.flatnonzero(here)
        if form is not None and channel in form.channels:
            span = form.span(channel)
            found = np.concatenate([found, len(columns) + np.arange(span.start, span.stop)])
        return found

    def unwhitened(self, channel: int, columns: np.ndarray, form: ChosenForm | None) -> np.ndarray:
        """Return those columns in units of the noise known beforehand, (n, k)."""
        _, place = self.select(channel, columns)
        found = self.problem.rows[channel].columns[:, place]
        if form is not None and channel in form.channels:
            found = np.concatenate([found, form.form.columns[channel].make()], axis=1)
        return found

    def squares(
        self, at: Hypothesis, channel: int, columns: np.ndarray, mean: np.ndarray, covariance: np.ndarray,
        scale: float, weight: np.ndarray,
    ) -> np.ndarray:  # fmt: skip
        """Return the expected squared residual of each row less offsets of runs, in units of its noise, (n,)."""
        form, noise, rows = at.form, self.noise(at, channel), self.rows[channel]
        where, (_, place) = self.taking_part(channel, columns, form), self.select(channel, columns)
        independent, offset = rows.independent(noise)
        own = independent[:, place]
        if form is not None and channel in form.channels:
            own = np.concatenate([own, rows.in_time(noise, form.form.columns[channel].make())[0]], axis=1)
        residual = independent[:, -1] - own @ mean[where]
        spread = np.sum((own @ covariance[np.ix_(where, where)]) * own, axis=1) / scale**2
        offsets = offsets_of_runs(rows.rows, residual, offset, weight, noise.scatter)
        return ((residual - offsets.taken) / scale) ** 2 + spread + offsets.variance


class _Evaluation:
    """The work of one evaluation."""

    def __init__(self, of: EvidenceOf, hypothesis: Hypothesis, start: Evaluated | None):
        self.of, self.hypothesis, problem = of, hypothesis, of.problem
        self.channels = sorted(of.unit_of)
        places = [k for each in hypothesis.variants for k in of.variants[each].places]
        self.owner = np.array([n for n, each in enumerate(hypothesis.variants) for _ in of.variants[each].places], int)
        self.coefficients = np.array(places, dtype=int)
        self.columns = np.concatenate([np.arange(problem.own), problem.own + self.coefficients]).astype(int)
        form = hypothesis.form
        self.form_columns = form.width if form is not None else 0
        self.scale = np.ones(len(problem.rows)) if start is None else start.scale.copy()
        rows = {k: of.noise(hypothesis, k).rows for k in self.channels}
        self.degrees = {k: each.degrees for k, each in rows.items() if isinstance(each, structures.HeavyTails)}
        self.weight: dict[int, np.ndarray] = {}
        for k, degrees in self.degrees.items():
            known = start.weight.get(k) if start is not None else None
            self.weight[k] = self._first_weights(k, degrees) if known is None else known
        before = {} if start is None else dict(zip(start.hypothesis.variants, start.widths, strict=True))
        self.widths = [before.get(each, _middle(of.variants[each].widths)) for each in hypothesis.variants]

    def _first_weights(self, channel: int, degrees: float) -> np.ndarray:
        """Return the weights at the fit if its model has heavy tails; else 1, since outliers have moved the fit."""
        rows = self.of.problem.rows[channel]
        return structures.tail_weights(rows.columns[:, -1] ** 2, degrees) if rows.tails else np.ones(len(rows.entry))

    def found(self) -> Evaluated:
        self._gather()
        widths, found = self._at_widths()
        if widths != self.widths:
            self.widths = widths
            _, found = self._at_widths()
        return found

    def _at_widths(self) -> tuple[list[float], Evaluated]:
        """Return the most probable widths, and the evidence with scales found at the present ones."""
        precision, pull = self._priors()
        self._settle(precision, pull)
        widths, gain, rest = self._evidence(precision, pull)
        total = rest + gain
        return widths, Evaluated(
            self.hypothesis, total, total + self.of.log_prior(self.hypothesis), self.scale, tuple(widths),
            self.columns, precision, pull, self.mean, dict(self.weight),
        )  # fmt: skip

    def _gather(self) -> None:
        """Collect the inner products of the columns that take part."""
        of, at = self.of, self.hypothesis
        self.products = {k: of.products(at, self.columns, k, self.weight.get(k)) for k in self.channels}
        self.stacked = _Stacked.of(self.products, len(self.columns) + self.form_columns)
        self.log_det = sum(each.log_det for each in self.products.values())

    def _priors(self) -> tuple[np.ndarray, np.ndarray]:
        problem, form = self.of.problem, self.hypothesis.form
        width = np.array([self.widths[n] for n in self.owner]) if len(self.owner) else np.zeros(0)
        amplitude = form.amplitude if form is not None else 1.0
        precision = np.concatenate([problem.precision, width**-2.0, np.full(self.form_columns, amplitude**-2.0)])
        return precision, np.concatenate([problem.pull, np.zeros(len(precision) - problem.own)])

    def _solve(self, precision: np.ndarray, pull: np.ndarray) -> None:
        self.whole, self.right = self.stacked.system(precision, pull, self.scale)
        self.covariance = inverse(self.whole)
        self.mean = self.covariance @ self.right

    def _settle(self, precision: np.ndarray, pull: np.ndarray) -> None:
        """Find the mode of the noise scales, σ² = RSS/(n − γ) drawn towards what is known (MacKay 1992)."""
        moved = math.inf if self.weight else 0.0
        for _ in range(ROUNDS):
            self._solve(precision, pull)
            before = self.scale
            self._rescale()
            settled = float(np.max(np.abs(np.log(self.scale / before)))) < _SETTLED
            if settled and moved < SETTLED_WEIGHT:
                break
            if self.weight:
                moved = self._reweigh()
        self._solve(precision, pull)

    def _rescale(self) -> None:
        before, self.laplace = self.scale, 0.0
        self.scale = before.copy()
        rest, taken = self.stacked.rest(self.mean), self.stacked.taken(self.covariance)
        for n, k in enumerate(self.channels):
            rows = self.of.problem.rows[k]
            sd = self.of.noise(self.hypothesis, k).scale_sd(rows)
            freedom = len(rows.entry) - float(taken[n]) / before[k] ** 2
            log_scale, term = scale_mode(max(float(rest[n]), 1e-12), max(freedom, 2.0), sd)
            self.scale[k], self.laplace = math.exp(log_scale), self.laplace + term

    def _reweigh(self) -> float:
        """Weigh the rows of heavy tails anew, and return by how much a logarithm of a weight changes at most."""
        moved = 0.0
        for k, before in self.weight.items():
            self.weight[k] = structures.tail_weights(self._squares(k), self.degrees[k])
            moved = max(moved, float(np.max(np.abs(np.log(self.weight[k] / before)))))
        self._gather()
        return moved

    def _squares(self, channel: int) -> np.ndarray:
        return self.of.squares(
            self.hypothesis, channel, self.columns, self.mean, self.covariance, float(self.scale[channel]),
            self.weight[channel],
        )  # fmt: skip

    def _evidence(self, precision: np.ndarray, pull: np.ndarray) -> tuple[list[float], float, float]:
        """Return the most probable widths, the gain by the coefficients of effects, and the rest of the evidence."""
        problem = self.of.problem
        found = self.log_det + self.laplace
        for k in self.channels:
            square = self.products[k].square / self.scale[k] ** 2
            found -= len(problem.rows[k].entry) * math.log(self.scale[k]) + 0.5 * square
            if k in self.weight:
                found += structures.tail_bound(self._squares(k), self.weight[k], self.degrees[k])
        of_effects = np.arange(problem.own, problem.own + len(self.coefficients))
        after = problem.own + len(self.coefficients)
        rest = np.concatenate([np.arange(problem.own), np.arange(after, len(self.whole))])
        # Coefficients of unit information: what a prior alone determines is beside what a million rows determine.
        unit = 1 / np.sqrt(np.diag(self.whole)[rest])
        lower = np.linalg.cholesky(unit[:, None] * self.whole[rest[:, None], rest] * unit)
        columns = np.concatenate([self.right[rest, None], self.whole[rest[:, None], of_effects]], axis=1)
        both = scipy.linalg.solve_triangular(lower, unit[:, None] * columns, lower=True)
        along, shared = both[:, 0], both[:, 1:]
        found += 0.5 * along @ along - np.log(np.diag(lower)).sum()
        found += np.log(unit).sum() + 0.5 * np.log(precision[rest]).sum()
        if not len(of_effects):
            return [], 0.0, float(found)
        own = self.whole[of_effects[:, None], of_effects] - shared.T @ shared - np.diag(precision[of_effects])
        grids = [self.of.variants[each].widths for each in self.hypothesis.variants]
        right, sign = self.right[of_effects] - shared.T @ along, problem.sign[self.coefficients]
        widths, gain = summed_over_widths(own, right, self.owner, grids, sign, self.widths)
        return widths, gain, float(found)


@dataclass(frozen=True)
class _Stacked:
    """Inner products of the n columns of a hypothesis on K channels, zero if a channel does not respond.

    One product of matrices serves all channels: scales are found anew some thousand times.

    Attributes
    ----------
    channels : places of the channels, in order.
    own, right, square : shapes (K, n²), (K, n) and (K,).
    """

    channels: list[int]
    own: np.ndarray
    right: np.ndarray
    square: np.ndarray

    @staticmethod
    def of(products: Mapping[int, Products], size: int) -> "_Stacked":
        """Return products stacked."""
        own, right = np.zeros((len(products), size, size)), np.zeros((len(products), size))
        for n, each in enumerate(products.values()):
            own[n, each.where[:, None], each.where] = each.own
            right[n, each.where] = each.right
        square = np.array([each.square for each in products.values()])
        return _Stacked(list(products), own.reshape(len(products), -1), right, square)

    def system(self, precision: np.ndarray, pull: np.ndarray, scale: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the normal equations at noise scales, (n, n) and (n,)."""
        inverse_square, size = scale[self.channels] ** -2.0, len(precision)
        whole = (inverse_square @ self.own).reshape(size, size)
        whole[np.arange(size), np.arange(size)] += precision
        return whole, pull + inverse_square @ self.right

    def rest(self, mean: np.ndarray) -> np.ndarray:
        """Return the square that coefficients leave of each residual, (K,)."""
        taken = self.own.reshape(-1, len(mean)) @ mean
        return self.square + (taken.reshape(len(self.square), -1) - 2 * self.right) @ mean

    def taken(self, covariance: np.ndarray) -> np.ndarray:
        """Return what coefficients of a covariance take of the rows of each channel, at noise 1, (K,)."""
        return self.own @ covariance.reshape(-1)


_LAPACK: Any = lapack  # its routines are not typed


def inverse(whole: np.ndarray) -> np.ndarray:
    """Return the inverse of a positive definite matrix, (n, n), at unit diagonal."""
    unit = 1 / np.sqrt(np.diag(whole))
    scaled = unit[:, None] * whole * unit
    factor, failed = _LAPACK.dpotrf(scaled, lower=1)
    found, failed = _LAPACK.dpotri(factor, lower=1) if not failed else (factor, failed)
    if failed:  # by rounding
        found = np.linalg.inv(scaled)
        return 0.5 * (found + found.T) * np.outer(unit, unit)
    below = np.tril(found, -1)
    return (below + below.T + np.diag(np.diag(found))) * np.outer(unit, unit)


def _places_of(rows: ChannelRows, count: int) -> np.ndarray:
    found = np.full(count, -1)
    found[rows.live] = np.arange(len(rows.live))
    return found


def _middle(widths: Sequence[float]) -> float:
    return min(widths, key=lambda each: abs(math.log(each)))


def scale_mode(rest: float, freedom: float, sd: float) -> tuple[float, float]:
    """Return the mode of −ν x − RSS e^(−2x)/2 − x²/2s² in x = log σ, and its prior with the Laplace term."""
    x, curvature = 0.5 * math.log(rest / freedom), 1.0
    for _ in range(ROUNDS):
        gradient = -freedom + rest * math.exp(-2 * x) - x / sd**2
        curvature = 2 * rest * math.exp(-2 * x) + 1 / sd**2
        step = max(-1.0, min(1.0, gradient / curvature))
        x += step
        if abs(step) < 0.01 * _SETTLED:
            break
    return x, -0.5 * (x / sd) ** 2 - math.log(sd) - 0.5 * math.log(curvature)
