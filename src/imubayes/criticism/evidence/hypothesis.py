"""The evidence of one hypothesis: effects that are missing, the noise of each unit, and at most one free form.

Past what the noise scales are, everything is one Gaussian linear model, and the evidence is in closed form.  Scales are
integrated about their mode (Laplace), widths of effects are summed over their grid, coefficients of one sign count
half their normal distribution.  Gram matrices are kept for each channel and structure of the noise, so that a
hypothesis costs one Cholesky factorisation of the coefficients that take part.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.linalg
from scipy import special

from imubayes.criticism.evidence.effect_variants import EffectVariant, effect_variants
from imubayes.criticism.evidence.free_forms import FREE_FORM, WRONG_INPUT, ChosenForm
from imubayes.criticism.evidence.linear_problem import ChannelRows, LinearProblem
from imubayes.criticism.evidence.noise_structures import (
    HeavyTails,
    NoiseOfUnit,
    NoiseStructure,
    NoiseUnit,
    log_prior_of_sisters,
    noise_units,
)
from imubayes.tail_probabilities import normal_log_survival

_WIDTH_SWEEPS = 3
_ROUNDS, _TAIL_ROUNDS, _SETTLED = 6, 4, 1e-3
_LOG_SCALES = (-6.0, 12.0)


@dataclass(frozen=True)
class Hypothesis:
    """What is missing: places of variants in order, the noise of each unit, and a form."""

    variants: tuple[int, ...]
    noise: tuple[NoiseOfUnit, ...]
    form: ChosenForm | None = None

    def without(self, variant: int) -> "Hypothesis":
        """Return the hypothesis with a variant taken out."""
        return replace(self, variants=tuple(each for each in self.variants if each != variant))

    def including(self, *variants: int) -> "Hypothesis":
        """Return the hypothesis with further variants."""
        return replace(self, variants=tuple(sorted((*self.variants, *variants))))

    def with_noise(self, unit: int, noise: NoiseOfUnit) -> "Hypothesis":
        """Return the hypothesis with other noise in a unit."""
        return replace(self, noise=(*self.noise[:unit], noise, *self.noise[unit + 1 :]))


@dataclass(frozen=True)
class GramMatrix:
    """Inner products of the whitened columns of a channel, the residual last, and the log determinant of whitening."""

    products: np.ndarray
    log_det: float


@dataclass(frozen=True)
class Evaluated:
    """A hypothesis with its evidence.

    Attributes
    ----------
    log_evidence, log_posterior : natural logarithms, up to a common constant.
    scale : shape (K,), noise scale of each channel.
    widths : prior width of each variant that is likeliest.
    columns : shape (n,), own parameters and coefficients that take part, as places among [J X]; the form follows.
    precision, pull : of their priors.
    mean, covariance : posterior, in prior units: z, largest typical sizes, units of noise.
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
    covariance: np.ndarray
    weight: Mapping[int, np.ndarray]


class EvidenceOf:
    """Evaluates hypotheses about a linear problem."""

    def __init__(self, problem: LinearProblem):
        self.problem = problem
        self.variants: tuple[EffectVariant, ...] = effect_variants(problem)
        self.units: tuple[NoiseUnit, ...] = noise_units(problem)
        self.unit_of = {k: place for place, unit in enumerate(self.units) for k in unit.channels}
        self._place = [_places_of(rows, problem.own + len(problem.coefficients)) for rows in problem.rows]
        self._white: dict[tuple[NoiseStructure, int], tuple[np.ndarray, np.ndarray, float]] = {}
        self._gram: dict[tuple[NoiseStructure, float, int], GramMatrix] = {}
        self.known: dict[Hypothesis, Evaluated] = {}

    @cached_property
    def stated(self) -> tuple[NoiseOfUnit, ...]:
        """The noise as stated, of each unit; the likeliest before the data."""
        return tuple(max(unit.stated, key=lambda each: each.log_prior) for unit in self.units)

    def log_prior(self, hypothesis: Hypothesis) -> float:
        """Return the logarithm of the prior probability."""
        found = sum(self.variants[each].log_odds for each in hypothesis.variants)
        found += sum(each.log_prior for each in hypothesis.noise)
        found += log_prior_of_sisters(self.problem, self.units, hypothesis.noise)
        form = hypothesis.form
        return found + (form.log_prior if form is not None else math.log(1 - FREE_FORM - WRONG_INPUT))

    # ---- Gram matrices ----

    def _structure(self, hypothesis: Hypothesis, channel: int) -> tuple[NoiseStructure, float]:
        noise = hypothesis.noise[self.unit_of[channel]]
        return noise.rows, noise.scatter

    def gram(self, hypothesis: Hypothesis, channel: int, weight: np.ndarray | None = None) -> GramMatrix:
        """Return the Gram matrix of all columns that a channel responds to."""
        structure, scatter = self._structure(hypothesis, channel)
        key = structure, scatter, channel
        if weight is None and key in self._gram:
            return self._gram[key]
        white, offset, log_det = self._whitened(structure, channel, weight)
        products = white.T @ white
        found = with_scatter(products, self.problem.rows[channel], white, offset, scatter, log_det)
        if weight is None:
            self._gram[key] = found
        return found

    def _whitened(
        self, structure: NoiseStructure, channel: int, weight: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """Return columns with the residual, (n, L + 1), and the response to an offset, (n,), whitened."""
        rows = self.problem.rows[channel]
        if weight is not None:
            root = np.sqrt(weight)
            return rows.columns * root[:, None], rows.offset * root, 0.0
        key = structure, channel
        if key not in self._white:
            both, log_det = structure.whiten(rows, np.column_stack([rows.columns, rows.offset]))
            self._white[key] = both[:, :-1], both[:, -1], log_det
        return self._white[key]

    def whiten(self, at: Hypothesis, columns: np.ndarray, channel: int, weight: np.ndarray | None) -> np.ndarray:
        """Return further columns of a channel, (n, C), whitened by the whole noise of a hypothesis."""
        structure, scatter = self._structure(at, channel)
        rows = self.problem.rows[channel]
        white = columns * np.sqrt(weight)[:, None] if weight is not None else structure.whiten(rows, columns)[0]
        return _less_offsets(white, rows, self._whitened(structure, channel, weight)[1], scatter)

    def form_columns(self, at: Hypothesis, form: ChosenForm, channel: int, weight: np.ndarray | None) -> np.ndarray:
        """Return the columns of a form on a channel, whitened, (n, k)."""
        return self.whiten(at, form.form.columns[channel], channel, weight)

    def whitened(self, at: Hypothesis, channel: int, weight: np.ndarray | None = None) -> np.ndarray:
        """Return all columns of a channel, the residual last, whitened by the whole noise, (n, L + 1)."""
        structure, scatter = self._structure(at, channel)
        white, offset, _ = self._whitened(structure, channel, weight)
        return _less_offsets(white, self.problem.rows[channel], offset, scatter)

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
            found = np.concatenate([found, form.form.columns[channel]], axis=1)
        return found


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
        self.weight: dict[int, np.ndarray] = {}
        tails = {k: each for k in self.channels if isinstance(each := self._rows_noise(k), HeavyTails)}
        for k in tails:
            known = start.weight.get(k) if start is not None else None
            self.weight[k] = np.ones(len(problem.rows[k].entry)) if known is None else known
        before = _widths_before(start)
        self.widths = [before.get(each, _middle(of.variants[each].widths)) for each in hypothesis.variants]

    def _rows_noise(self, channel: int) -> NoiseStructure:
        return self.hypothesis.noise[self.of.unit_of[channel]].rows

    def found(self) -> Evaluated:
        self._gather()
        widths, found = self._at_widths()
        if widths != self.widths:
            self.widths = widths
            _, found = self._at_widths()
        return found

    def _at_widths(self) -> tuple[list[float], Evaluated]:
        """Return the likeliest widths, and the evidence with scales found at the present ones."""
        precision, pull = self._priors()
        self._settle(precision, pull)
        widths, gain, rest = self._evidence(precision, pull)
        total = rest + gain
        return widths, Evaluated(
            self.hypothesis, total, total + self.of.log_prior(self.hypothesis), self.scale, tuple(widths),
            self.columns, precision, pull, self.mean, self.covariance, dict(self.weight),
        )  # fmt: skip

    def _gather(self) -> None:
        """Collect the Gram matrices of the columns that take part."""
        of, form, count = self.of, self.hypothesis.form, len(self.columns) + self.form_columns
        self.products, self.across, self.square, self.log_det = {}, {}, {}, 0.0
        for k in self.channels:
            weight = self.weight.get(k)
            gram = of.gram(self.hypothesis, k, weight)
            here, place = of.select(k, self.columns)
            where = np.flatnonzero(here)
            whole, right = np.zeros((count, count)), np.zeros(count)
            whole[np.ix_(where, where)] = gram.products[np.ix_(place, place)]
            right[where] = gram.products[place, -1]
            if form is not None and k in form.channels:
                columns = of.form_columns(self.hypothesis, form, k, weight)
                span = of.taking_part(k, self.columns, form)[len(where) :]
                across = columns.T @ of.whitened(self.hypothesis, k, weight)[:, [*place, -1]]
                whole[np.ix_(span, where)], whole[np.ix_(where, span)] = across[:, :-1], across[:, :-1].T
                whole[np.ix_(span, span)], right[span] = columns.T @ columns, across[:, -1]
            self.products[k], self.across[k], self.square[k] = whole, right, float(gram.products[-1, -1])
            self.log_det += gram.log_det

    def _priors(self) -> tuple[np.ndarray, np.ndarray]:
        problem, form = self.of.problem, self.hypothesis.form
        width = np.array([self.widths[n] for n in self.owner]) if len(self.owner) else np.zeros(0)
        amplitude = form.amplitude if form is not None else 1.0
        precision = np.concatenate([problem.precision, width**-2.0, np.full(self.form_columns, amplitude**-2.0)])
        return precision, np.concatenate([problem.pull, np.zeros(len(precision) - problem.own)])

    def _system(self, precision: np.ndarray, pull: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        whole, right = np.diag(precision), pull.copy()
        for k in self.channels:
            whole += self.products[k] / self.scale[k] ** 2
            right += self.across[k] / self.scale[k] ** 2
        return whole, right

    def _solve(self, precision: np.ndarray, pull: np.ndarray) -> None:
        self.whole, self.right = self._system(precision, pull)
        self.covariance = inverse(self.whole)
        self.mean = self.covariance @ self.right

    def _settle(self, precision: np.ndarray, pull: np.ndarray) -> None:
        """Find the mode of the noise scales, σ² = RSS/(n − γ) drawn towards what is known (MacKay 1992)."""
        rounds = _ROUNDS + (_TAIL_ROUNDS if self.weight else 0)
        for turn in range(rounds):
            self._solve(precision, pull)
            before, self.laplace = self.scale, 0.0
            self.scale = before.copy()
            for k in self.channels:
                product = self.products[k]
                rest = self.square[k] - 2 * self.mean @ self.across[k] + self.mean @ product @ self.mean
                taken = float(np.sum(self.covariance * product)) / before[k] ** 2
                freedom = max(len(self.of.problem.rows[k].entry) - taken, 2.0)
                noise = self.hypothesis.noise[self.of.unit_of[k]]
                log_scale, term = scale_mode(max(rest, 1e-12), freedom, noise.scale_sd(self.of.problem.rows[k]))
                self.scale[k], self.laplace = math.exp(log_scale), self.laplace + term
            settled = float(np.max(np.abs(np.log(self.scale / before)))) < _SETTLED
            if self.weight and turn < rounds - 1:
                self._reweigh()
            elif settled:
                break
        self._solve(precision, pull)

    def _reweigh(self) -> None:
        for k in self.weight:
            structure = self._rows_noise(k)
            assert isinstance(structure, HeavyTails)
            squares = self._squares(k)
            self.weight[k] = (structure.degrees + 1) / (structure.degrees + squares)
        self._gather()

    def _squares(self, channel: int) -> np.ndarray:
        """Return the expected squared residual of each row, in units of its noise, (n,)."""
        where = self.of.taking_part(channel, self.columns, self.hypothesis.form)
        columns = self.of.unwhitened(channel, self.columns, self.hypothesis.form)
        residual = self.of.problem.rows[channel].columns[:, -1] - columns @ self.mean[where]
        spread = np.sum((columns @ self.covariance[np.ix_(where, where)]) * columns, axis=1)
        return (residual**2 + spread) / self.scale[channel] ** 2

    def _evidence(self, precision: np.ndarray, pull: np.ndarray) -> tuple[list[float], float, float]:
        """Return the likeliest widths, the gain by the coefficients of effects, and the rest of the evidence."""
        problem = self.of.problem
        found = self.log_det + self.laplace
        for k in self.channels:
            found -= len(problem.rows[k].entry) * math.log(self.scale[k]) + 0.5 * self.square[k] / self.scale[k] ** 2
            if k in self.weight:
                structure = self._rows_noise(k)
                assert isinstance(structure, HeavyTails)
                found += _tail_bound(self._squares(k), self.weight[k], structure.degrees)
        of_effects = np.arange(problem.own, problem.own + len(self.coefficients))
        rest = np.setdiff1d(np.arange(len(self.whole)), of_effects)
        # Coefficients of unit information: what a prior alone tells stands beside what a million rows tell.
        unit = 1 / np.sqrt(np.diag(self.whole)[rest])
        lower = np.linalg.cholesky(unit[:, None] * self.whole[np.ix_(rest, rest)] * unit)
        along = scipy.linalg.solve_triangular(lower, unit * self.right[rest], lower=True)
        found += 0.5 * along @ along - np.log(np.diag(lower)).sum()
        found += np.log(unit).sum() + 0.5 * np.log(precision[rest]).sum()
        if not len(of_effects):
            return [], 0.0, float(found)
        shared = scipy.linalg.solve_triangular(lower, unit[:, None] * self.whole[np.ix_(rest, of_effects)], lower=True)
        own = self.whole[np.ix_(of_effects, of_effects)] - shared.T @ shared - np.diag(precision[of_effects])
        grids = [self.of.variants[each].widths for each in self.hypothesis.variants]
        right, sign = self.right[of_effects] - shared.T @ along, problem.sign[self.coefficients]
        widths, gain = summed_over_widths(own, right, self.owner, grids, sign, self.widths)
        return widths, gain, float(found)


def inverse(whole: np.ndarray) -> np.ndarray:
    """Return the inverse of a positive definite matrix, (n, n), at unit diagonal."""
    unit = 1 / np.sqrt(np.diag(whole))
    found = np.linalg.inv(unit[:, None] * whole * unit)
    return 0.5 * (found + found.T) * np.outer(unit, unit)


def _places_of(rows: ChannelRows, count: int) -> np.ndarray:
    found = np.full(count, -1)
    found[rows.live] = np.arange(len(rows.live))
    return found


def _middle(widths: Sequence[float]) -> float:
    return min(widths, key=lambda each: abs(math.log(each)))


def _widths_before(start: Evaluated | None) -> dict[int, float]:
    return {} if start is None else dict(zip(start.hypothesis.variants, start.widths, strict=True))


def _sums_of_runs(rows: ChannelRows, white: np.ndarray, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the projections of columns on the offset of each run, (runs, C), and its squared lengths, (runs,)."""
    starts = [start for start, _ in rows.series]
    along = np.add.reduceat(offset[:, None] * white, starts, axis=0)
    return along, np.add.reduceat(offset**2, starts)


def with_scatter(
    products: np.ndarray, rows: ChannelRows, white: np.ndarray, offset: np.ndarray, scatter: float, log_det: float
) -> GramMatrix:
    """Return the Gram matrix beside offsets of runs of a standard deviation (Woodbury)."""
    if scatter == 0:
        return GramMatrix(products, log_det)
    along, squared = _sums_of_runs(rows, white, offset)
    share = scatter**2 / (1 + scatter**2 * squared)
    log_det -= 0.5 * float(np.log1p(scatter**2 * squared).sum())
    return GramMatrix(products - along.T @ (share[:, None] * along), log_det)


def _less_offsets(white: np.ndarray, rows: ChannelRows, offset: np.ndarray, scatter: float) -> np.ndarray:
    """Return columns whitened by offsets of runs as well: shrunk along the offset of each."""
    if scatter == 0:
        return white
    along, squared = _sums_of_runs(rows, white, offset)
    shrink = (1 - 1 / np.sqrt(1 + scatter**2 * squared)) / np.where(squared > 0, squared, 1.0)
    sizes = [length for _, length in rows.series]
    return white - offset[:, None] * np.repeat(shrink[:, None] * along, sizes, axis=0)


def scale_mode(rest: float, freedom: float, sd: float) -> tuple[float, float]:
    """Return the mode of −ν x − RSS e^(−2x)/2 − x²/2s² in x = log σ, and its prior with the Laplace term."""
    x, curvature = 0.5 * math.log(rest / freedom), 1.0
    for _ in range(12):
        gradient = -freedom + rest * math.exp(-2 * x) - x / sd**2
        curvature = 2 * rest * math.exp(-2 * x) + 1 / sd**2
        step = max(-1.0, min(1.0, gradient / curvature))
        x += step
        if abs(step) < 1e-6:
            break
    x = max(min(x, _LOG_SCALES[1]), _LOG_SCALES[0])
    return x, -0.5 * (x / sd) ** 2 - math.log(sd) - 0.5 * math.log(curvature)


def _tail_bound(squares: np.ndarray, weight: np.ndarray, degrees: float) -> float:
    """Return what Student's t adds to the normal of weights w: a lower bound of its logarithm (variational)."""
    t = _log_t(squares, degrees)
    normal = -0.5 * math.log(2 * math.pi) + 0.5 * np.log(weight) - 0.5 * weight * squares
    return float(np.sum(t - normal + 0.5 * np.log(weight)))


def _log_t(squares: np.ndarray, degrees: float) -> np.ndarray:
    constant = special.gammaln((degrees + 1) / 2) - special.gammaln(degrees / 2) - 0.5 * math.log(degrees * math.pi)
    return constant - (degrees + 1) / 2 * np.log1p(squares / degrees)


def tail_log_density(residual: np.ndarray, degrees: float) -> float:
    """Return the logarithm of the density of residuals (n,) under Student's t of scale 1."""
    return float(_log_t(residual**2, degrees).sum())


def gain_of_coefficients(own: np.ndarray, right: np.ndarray, widths: np.ndarray, sign: np.ndarray) -> np.ndarray:
    """Return the log evidence of coefficients b, exp(uᵀb − bᵀVb/2), under normal priors of given widths.

    Parameters
    ----------
    own, right : V (k, k) or (n, k, k), and u (k,) or (n, k).
    widths : shape (n, k).
    sign : shape (k,) or (n, k): −1 or 1 where only one sign is allowed.
    """
    scaled = widths[:, :, None] * own * widths[:, None, :] + np.eye(widths.shape[1])
    pull = widths * right
    if widths.shape[1] == 1:
        variance = 1 / scaled[:, 0, 0]
        mean, diagonal = pull * variance[:, None], variance[:, None]
        found = 0.5 * pull[:, 0] * mean[:, 0] + 0.5 * np.log(variance)
    else:
        mean = np.linalg.solve(scaled, pull[..., None])[..., 0]
        found = 0.5 * np.sum(pull * mean, axis=-1) - 0.5 * np.linalg.slogdet(scaled)[1]
        diagonal = np.diagonal(np.linalg.inv(scaled), axis1=-2, axis2=-1) if np.any(sign) else np.ones_like(mean)
    if np.any(sign):
        z = sign * mean / np.sqrt(np.maximum(diagonal, 1e-300))
        found = found + np.sum(np.where(sign != 0, normal_log_survival(-z) + math.log(2), 0.0), axis=-1)
    return found


def summed_over_widths(
    own: np.ndarray,
    right: np.ndarray,
    owner: np.ndarray,
    grids: Sequence[tuple[float, ...]],
    sign: np.ndarray,
    start: Sequence[float],
) -> tuple[list[float], float]:
    """Return the likeliest width of each variant and the log evidence summed over all, one variant after the other."""
    best, each = list(start), [np.zeros(1)] * len(grids)
    for _ in range(_WIDTH_SWEEPS):
        before = list(best)
        for n, grid in enumerate(grids):
            tried = np.array([[width if j == n else best[j] for j in owner] for width in grid])
            each[n] = gain_of_coefficients(own, right, tried, sign)
            best[n] = grid[int(np.argmax(each[n]))]
        if best == before:
            break
    means = [float(np.logaddexp.reduce(one)) - math.log(len(one)) for one in each]
    return best, sum(means) - sum(float(one.max()) for one in each[1:])
