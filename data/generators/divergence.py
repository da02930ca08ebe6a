"""How plainly a hidden effect shows where nobody knows how large the noise is: twice the divergence from the baseline.

The baseline takes what it can of an effect for noise: for scatter between few runs above all, and whatever it had to
absorb against the priors of its parameters is then free again.  With K(h) = Σ(h) + J P Jᵀ the covariance of the
readings at noise scales h, in standard deviations of their priors, and d their shift by the effect, the expected
−2 log likelihood lies above that of the truth by twice the Kullback–Leibler divergence,

    D(h, d) = log det K(h) − log det K(h₀) + tr K(h)⁻¹K(h₀) − n + dᵀK(h)⁻¹d.

What is seen of the effect is the rise that no noise scales avoid,

    seen = min over h of [D(h, d) + |h|²] − min over h of [D(h, 0) + |h|²],

which at known scales is S of `detectability`.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import optimize

import truth
from detectability import Sight
from plan import rate_noise
from sensor import Values

REACH = 8.0
"""Bound of a noise scale, in standard deviations of its prior."""
RAISED = (0.0, 2.0, 4.0)
"""By how much scatter between runs is raised where a search for the likeliest scales begins."""


@dataclass(frozen=True)
class Readings:
    """What the covariance of the readings of a plan is made of.

    Attributes
    ----------
    run_of_row : shape (rows,).
    recorded : shape (rows, channels), 1 where there is a reading, else 0.
    samples : shape (rows, 1), raw samples in each mean.
    by_rate : shape (rows, channels), variance that grows with the rate.
    slopes : shape (rows, channels, parameters), by the baseline's parameters, per prior width.
    """

    run_of_row: np.ndarray
    recorded: np.ndarray
    samples: np.ndarray
    by_rate: np.ndarray
    slopes: np.ndarray

    def by_run(self, values: np.ndarray) -> np.ndarray:
        """Sums over the rows of each run."""
        return np.add.reduceat(values, np.searchsorted(self.run_of_row, np.arange(self.run_of_row[-1] + 1)))


@dataclass(frozen=True)
class Covariance:
    """K = Σ + J P Jᵀ, with Σ of white noise and of the scatter between runs, standard deviations (channels,)."""

    readings: Readings
    white: np.ndarray
    scatter: np.ndarray

    @cached_property
    def own(self) -> np.ndarray:
        """Variance of each reading by itself, (rows, channels)."""
        return self.white**2 / self.readings.samples + self.readings.by_rate

    @cached_property
    def weight(self) -> np.ndarray:
        return self.readings.recorded / self.own

    @cached_property
    def of_runs(self) -> np.ndarray:
        """Sums of the weights of each run, (runs, channels)."""
        return self.readings.by_run(self.weight)

    @cached_property
    def shared(self) -> np.ndarray:
        """What Σ⁻¹ lacks to the weights, per product of two of them (Sherman–Morrison), (runs, channels)."""
        return self.scatter**2 / (1 + self.scatter**2 * self.of_runs)

    @cached_property
    def solved(self) -> np.ndarray:
        """Σ⁻¹J, as the slopes."""
        return self._solve(self.readings.slopes)

    @cached_property
    def gain(self) -> np.ndarray:
        """JᵀΣ⁻¹J, (parameters, parameters)."""
        return np.einsum("rcp,rcq->pq", self.readings.slopes, self.solved, optimize=True)

    @cached_property
    def precision(self) -> np.ndarray:
        """Of the parameters, given the readings."""
        return np.eye(len(self.gain)) + self.gain

    @cached_property
    def log_determinant(self) -> float:
        there = self.readings.recorded > 0
        of_noise = np.sum(np.log(self.own[there])) + np.sum(np.log1p(self.scatter**2 * self.of_runs))
        return float(of_noise + np.linalg.slogdet(self.precision)[1])

    def _solve(self, values: np.ndarray) -> np.ndarray:
        """Σ⁻¹ times values (rows, channels, k)."""
        weighted = self.weight[..., None] * values
        common = self.shared[..., None] * self.readings.by_run(weighted)
        return weighted - self.weight[..., None] * common[self.readings.run_of_row]

    def divergence(self, true: "Covariance", shift: np.ndarray) -> float:
        """D from the true covariance, with all readings shifted by (rows, channels)."""
        apart = (self.weight - self.weight**2 * self.shared[self.readings.run_of_row]) * true.own
        between = true.scatter**2 * (self.of_runs - self.shared * self.of_runs**2)
        summed = self.readings.by_run(self.solved)
        inner = np.einsum("rcp,rc,rcq->pq", self.solved, true.own * self.readings.recorded, self.solved, optimize=True)
        inner += np.einsum("rcp,c,rcq->pq", summed, true.scatter**2, summed, optimize=True)
        moved = np.einsum("rcp,rc->p", self.solved, shift)
        square = np.sum(shift * self._solve(shift[..., None])[..., 0])
        # tr K⁻¹K₀ by K⁻¹ = Σ⁻¹ − Σ⁻¹J A⁻¹JᵀΣ⁻¹, A = 1 + G, and tr G − tr A⁻¹G² = tr A⁻¹G, which loses no digits.
        of_noise = np.sum(apart) + np.sum(between) + square
        of_slopes = np.trace(np.linalg.solve(self.precision, self.gain - inner - np.outer(moved, moved)))
        levels = self.log_determinant - true.log_determinant - np.sum(self.readings.recorded)
        return float(levels + of_noise + of_slopes)


def seen_past_noise(sight: Sight, effect: Values) -> float:
    """What is seen of an effect when white noise and scatter between runs may be of any size that their priors allow.

    Correlated noise is none of this covariance, and keeps to what `detectability` says of it.
    """
    shift = sight.moments.means(sight.moments.outputs({**sight.values, **effect})) - sight.exact
    baseline = Baseline.of(sight)
    return baseline.least_rise(shift) - baseline.least_rise(np.zeros_like(shift))


@dataclass(frozen=True)
class Baseline:
    """The readings of a plan with noise scales of any size.

    Attributes
    ----------
    priors : of white noise and, where the model has one, of the scatter between runs, for each channel, output units.
    true : their true values, (1 or 2, channels).
    """

    readings: Readings
    priors: tuple[tuple[str, ...], ...]
    true: np.ndarray

    @classmethod
    def of(cls, sight: Sight) -> "Baseline":
        """The readings of a plan past what its baseline absorbs."""
        plan, values = sight.moments.plan, sight.values
        channels, stated = plan.channels, truth.priors(plan.effects, plan.channels)
        kinds = ["white_noise.sigma", "run_scatter.tau"]
        kinds = [kind for kind in kinds if f"{kind}[{channels[0].name}]" in stated]
        return cls(
            _readings(sight),
            tuple(tuple(stated[f"{kind}[{channel.name}]"] for channel in channels) for kind in kinds),
            np.array([[values[f"{kind}[{channel.name}]"] for channel in channels] for kind in kinds]),
        )

    def covariance(self, scales: np.ndarray) -> Covariance:
        """K with standard deviations (1 or 2, channels)."""
        return Covariance(self.readings, scales[0], scales[1] if len(scales) > 1 else np.zeros_like(scales[0]))

    def least_rise(self, shift: np.ndarray) -> float:
        """The least D + |h|² over all noise scales, with all readings shifted by (rows, channels)."""
        true, start = self.covariance(self.true), _by_prior(truth.normal_score, self.priors, self.true)

        def rise(h: np.ndarray) -> float:
            there = self.covariance(_by_prior(truth.at_score, self.priors, h.reshape(start.shape)))
            return there.divergence(true, shift) + float(h @ h)

        found = []
        for by in RAISED if len(start) > 1 else RAISED[:1]:
            raised = np.clip(start + by * np.arange(len(start))[:, None], -REACH, REACH)
            found.append(
                optimize.minimize(rise, raised.ravel(), method="L-BFGS-B", bounds=[(-REACH, REACH)] * start.size)
            )
        return min(float(each.fun) for each in found)


def _by_prior(function: Callable[[str, float], float], priors: Iterable[Iterable[str]], of: np.ndarray) -> np.ndarray:
    """A function of a prior and a number, for each scale (1 or 2, channels)."""
    return np.array([[function(*each) for each in zip(*pair, strict=True)] for pair in zip(priors, of, strict=True)])


def _readings(sight: Sight) -> Readings:
    plan, values = sight.moments.plan, sight.values
    by_rate = [np.stack([rate_noise(plan, run, each, values) ** 2 for each in plan.channels], -1) for run in plan.runs]
    recorded = [np.tile([run.records(each) for each in plan.channels], (len(run.rows), 1)) for run in plan.runs]
    samples = np.array([[row.samples] for run in plan.runs for row in run.rows], dtype=float)
    return Readings(
        sight.moments.run_of_row, np.concatenate(recorded).astype(float), samples, np.concatenate(by_rate), sight.slopes
    )
