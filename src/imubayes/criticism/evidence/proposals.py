"""Proposals of additions to a hypothesis: quick gains of every effect and of pairs of effects, its noise held.

Conditional on a hypothesis with its scales, the likelihood of further coefficients is normal: V and u past all that
takes part are the same for every candidate, so that all are scored from one matrix.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from imubayes.criticism.evidence import hypothesis_evidence as evidence
from imubayes.criticism.evidence import noise_structures as structures
from imubayes.criticism.evidence.effect_variants import gain_of_coefficients
from imubayes.criticism.evidence.linear_problem import ChannelRows
from imubayes.criticism.evidence.whitened_rows import WhitenedColumns, offsets_of_runs, with_scatter


@dataclass(frozen=True)
class Conditional:
    """The normal likelihood exp(uᵀb − bᵀVb/2) of every coefficient beside a hypothesis: V (C, C) and u (C,)."""

    own: np.ndarray
    right: np.ndarray


def base_columns(of: evidence.EvidenceOf, at: evidence.Evaluated, channel: int) -> np.ndarray:
    """Return the whitened columns of a channel that take part, the residual last, (n, k + 1)."""
    weight, form = at.weight.get(channel), at.hypothesis.form
    white = of.whitened(at.hypothesis, channel, weight)
    _, place = of.select(channel, at.columns)
    parts = [white[:, place]]
    if form is not None and channel in form.channels:
        parts.append(of.form_columns(at.hypothesis, form, channel, weight))
    return np.concatenate([*parts, white[:, -1:]], axis=1)


def conditional(of: evidence.EvidenceOf, solved: evidence.Solved) -> Conditional:
    """Return the likelihood of every coefficient beside a hypothesis."""
    problem, count, at = of.problem, len(of.problem.coefficients), solved.at
    own, right, across = np.zeros((count, count)), np.zeros(count), np.zeros((len(at.precision), count))
    every = problem.own + np.arange(count)
    for k in of.unit_of:
        gram = of.gram(at.hypothesis, k, at.weight.get(k))
        here, place = of.select(k, every)
        which, inverse = np.flatnonzero(here), 1 / solved.scale[k] ** 2
        own[np.ix_(which, which)] += inverse * gram.products[np.ix_(place, place)]
        right[which] += inverse * gram.products[place, -1]
        taking, mine = of.select(k, at.columns)
        across[np.ix_(np.flatnonzero(taking), which)] += inverse * gram.products[np.ix_(mine, place)]
        form = at.hypothesis.form
        if form is not None and k in form.channels:
            columns = of.form_columns(at.hypothesis, form, k, at.weight.get(k))
            white = of.whitened(at.hypothesis, k, at.weight.get(k))
            span = of.taking_part(k, at.columns, form)[len(mine) :]
            across[np.ix_(span, which)] += inverse * columns.T @ white[:, place]
    left = own - across.T @ solved.covariance @ across
    np.fill_diagonal(left, np.maximum(np.diag(left), 0.0))
    return Conditional(left, right - across.T @ solved.mean)


def residuals(of: evidence.EvidenceOf, at: evidence.Evaluated) -> dict[int, np.ndarray]:
    """Return the residual of each channel at the posterior mean, (n,), in units of the noise known beforehand."""
    found, form = {}, at.hypothesis.form
    for k in of.unit_of:
        taken = of.unwhitened(k, at.columns, form) @ at.mean[of.taking_part(k, at.columns, form)]
        found[k] = of.problem.rows[k].columns[:, -1] - taken
    return found


def log_likelihood(
    of: evidence.EvidenceOf, residual: dict[int, np.ndarray], channels: Sequence[int], noise: structures.NoiseOfUnit
) -> float:
    """Return the logarithm of prior and likelihood of residuals under a noise, its scale at the mode; a screen."""
    found = noise.log_prior
    for k in channels:
        white, count = of.rows[k].structured(noise, residual[k]), len(residual[k])
        sd = noise.scale_sd(of.problem.rows[k])
        if isinstance(noise.rows, structures.HeavyTails):
            found += white.log_det + _under_tails(of.rows[k].rows, white, noise.scatter, noise.rows.degrees, sd)
            continue
        gram = with_scatter(of.rows[k].rows, white, noise.scatter)
        square = max(float(gram.products[0, 0]), 1e-12)
        log_scale, term = evidence.scale_mode(square, count, sd)
        found += gram.log_det + term - count * log_scale - 0.5 * square * math.exp(-2 * log_scale)
        found -= 0.5 * count * math.log(2 * math.pi)
    return found


def _under_tails(rows: ChannelRows, white: WhitenedColumns, scatter: float, degrees: float, sd: float) -> float:
    """Return the log likelihood of a residual under Student's t beside offsets of runs at their means."""
    own, rest, term, log_scale, offsets = white.columns[:, 0], white.columns[:, 0], 0.0, 0.0, 0.0
    weight = np.ones(len(own))
    for _ in range(evidence.ROUNDS):
        before, weight = weight, structures.tail_weights((rest / math.exp(log_scale)) ** 2, degrees)
        runs = offsets_of_runs(rows, own, white.offset, weight, scatter)
        rest, offsets = own - runs.taken, runs.log_density(math.exp(log_scale))
        log_scale, term = evidence.scale_mode(max(float(weight @ rest**2), 1e-12), len(own), sd)
        if float(np.max(np.abs(np.log(weight / before)))) < evidence.SETTLED_WEIGHT:
            break
    return structures.tail_log_density(rest / math.exp(log_scale), degrees) - len(own) * log_scale + term + offsets


class Screen:
    """Quick gains of variants and pairs from one conditional likelihood."""

    def __init__(self, of: evidence.EvidenceOf):
        self.of, sizes = of, dict[int, list[int]]()
        for n, each in enumerate(of.variants):
            sizes.setdefault(len(each.places), []).append(n)
        self._sizes = sizes
        most = max((len(each.widths) for each in of.variants), default=1)
        self._widths = np.array([(*v.widths, *[v.widths[-1]] * (most - len(v.widths))) for v in of.variants])
        self._log_share = np.array(
            [[-math.log(len(v.widths))] * len(v.widths) + [-np.inf] * (most - len(v.widths)) for v in of.variants]
        )

    def singles(self, at: Conditional) -> list[tuple[float, int]]:
        """Return the gain of every variant, its prior odds included, the largest first."""
        found: list[tuple[float, int]] = []
        for size, members in self._sizes.items():
            places = np.array([self.of.variants[n].places for n in members])
            own, right = at.own[places[:, :, None], places[:, None, :]], at.right[places]
            sign = self.of.problem.sign[places]
            widths = np.repeat(self._widths[members].T[:, :, None], size, axis=2)
            gains = _at_all(own, right, widths, sign) + self._log_share[members].T
            total = np.logaddexp.reduce(gains, axis=0)
            found += [(float(g) + self.of.variants[n].log_odds, n) for g, n in zip(total, members, strict=True)]
        return sorted(found, reverse=True)

    def pairs(self, at: Conditional, pool: Sequence[int]) -> list[tuple[float, tuple[int, int]]]:
        """Return the gain of every pair of a pool, over every other width, the largest first."""
        sizes: dict[tuple[int, int], list[tuple[int, int]]] = {}
        for one, other in combinations(pool, 2):
            a, b = self.of.variants[one], self.of.variants[other]
            if not a.excludes(b):
                sizes.setdefault((len(a.places), len(b.places)), []).append((one, other))
        found: list[tuple[float, tuple[int, int]]] = []
        for size, members in sizes.items():
            total = self._of_pairs(at, size, members)
            found += [
                (float(g) + self.of.variants[a].log_odds + self.of.variants[b].log_odds, (a, b))
                for g, (a, b) in zip(total, members, strict=True)
            ]
        return sorted(found, reverse=True)

    def _of_pairs(self, at: Conditional, size: tuple[int, int], members: list[tuple[int, int]]) -> np.ndarray:
        places = np.array([self.of.variants[a].places + self.of.variants[b].places for a, b in members])
        own, right = at.own[places[:, :, None], places[:, None, :]], at.right[places]
        sign = self.of.problem.sign[places]
        one, other = np.array(members).T
        every = range(0, self._widths.shape[1], 2)
        chosen = [(i, j) for i in every for j in every]
        widths = np.array([np.stack([self._widths[one, i], self._widths[other, j]], axis=1) for i, j in chosen])
        share = np.array([self._log_share[one, i] + self._log_share[other, j] for i, j in chosen]) + 2 * math.log(2)
        gains = _at_all(own, right, np.repeat(widths, size, axis=2), sign) + share
        return np.asarray(np.logaddexp.reduce(gains, axis=0))


def _at_all(own: np.ndarray, right: np.ndarray, widths: np.ndarray, sign: np.ndarray) -> np.ndarray:
    """Return the gains (Q, m) of m sets of k coefficients at Q choices of their widths, (Q, m, k), in one batch."""
    count, sets, size = widths.shape
    each = [np.broadcast_to(x, (count, *x.shape)).reshape(count * sets, *x.shape[1:]) for x in (own, right, sign)]
    return gain_of_coefficients(each[0], each[1], widths.reshape(-1, size), each[2]).reshape(count, sets)
