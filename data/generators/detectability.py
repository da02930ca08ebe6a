"""How plainly a hidden effect shows in a plan: S, the noncentrality that is left after the baseline has done its best.

With d the shift of all readings by the effect, Σ the true covariance of the noise (run offsets included), J the
derivative of the readings by the baseline's parameters and P their prior covariance,

    S = min over δ of |L⁻¹(d − Jδ)|² + δᵀP⁻¹δ,    Σ = L Lᵀ.

A baseline also absorbs by taking the noise for larger than it is, and the offsets of few runs above all: nobody knows
their spread beforehand.  What is then left to be seen is, with S split by channel into what happens between runs (ν
degrees of freedom) and within them, the drop of −2 log likelihood

    seen = Σ ν log(1 + S_part / ν).

That is quick and rough: what the priors of the parameters resist is counted as if it were seen at any noise.
`divergence` has the exact figure.

Everything comes from the simulator by finite differences: no line here is shared with what is to be tested.
"""

from collections import defaultdict
from dataclasses import dataclass
from functools import cached_property

import numpy as np

import truth
from plan import NoiseFree, Plan, rate_noise
from sensor import Values

STEP = 0.05
"""Finite step in units of the prior's standard deviation."""


def beside_reference(plan: Plan) -> tuple[str, ...]:
    """Tables that a reference gyro tells the rate of."""
    return tuple(dict.fromkeys(str(run.table) for run in plan.runs if run.procedure == "reference_gyro"))


def baseline_widths(plan: Plan) -> dict[str, float]:
    """One sigma of the prior of every parameter of the plan's model that moves the readings."""
    widths = dict(plan.equipment) | plan.nuisances
    for name, prior in truth.priors(plan.effects, plan.channels).items():
        if not name.startswith(("white_noise", "run_scatter")):
            widths[name] = truth.width(prior, truth.UNITS[name.split("[")[0]])
    return widths | truth.widths_of_station(plan.effects, beside_reference(plan))


@dataclass(frozen=True)
class Sight:
    """A plan with true values, seen through its noise and past what its baseline absorbs.

    Attributes
    ----------
    moments, values : the plan and the truth without the hidden effect.
    exact : noise-free readings (rows, channels).
    slopes : derivatives of the readings by the baseline's parameters, per prior width, (rows, channels, parameters).
    basis : orthonormal columns of everything that the baseline absorbs: whitened readings, then prior rows.
    """

    moments: NoiseFree
    values: Values
    exact: np.ndarray
    slopes: np.ndarray
    whiteners: tuple[tuple[np.ndarray, ...], ...]
    basis: np.ndarray

    def shift(self, effect: Values) -> np.ndarray:
        """Whitened shift of all readings by an effect, without any projection."""
        moved = self.moments.means(self.moments.outputs({**self.values, **effect}))
        return self._whiten(moved - self.exact)

    def _whiten(self, readings: np.ndarray) -> np.ndarray:
        return whitened(self.moments, self.whiteners, readings)

    def left(self, shift: np.ndarray, also: np.ndarray | None = None) -> np.ndarray:
        """What is left of whitened shifts (readings, …) when the baseline, and `also`, have taken their part.

        `also` : further whitened shifts (readings, k) of free size.
        """
        extended = np.concatenate([shift, np.zeros((len(self.basis) - len(shift), *shift.shape[1:]))])
        rest = extended - self.basis @ (self.basis.T @ extended)
        if also is not None and also.size:
            columns = self.left(also)
            scale = np.linalg.norm(columns, axis=0)
            columns = columns[:, scale > 1e-6 * np.linalg.norm(also, axis=0)]
            if columns.size:
                left, size, _ = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), full_matrices=False)
                left = left[:, size > 1e-6]
                rest = rest - left @ (left.T @ rest)
        return rest

    def detectability(self, effect: Values, also: np.ndarray | None = None) -> float:
        """S of an effect."""
        return float(np.sum(self.left(self.shift(effect), also) ** 2))

    @cached_property
    def offsets(self) -> np.ndarray:
        """Whitened unit directions of the offset of each run and channel, (readings, runs · channels)."""
        columns = []
        for run in range(len(self.moments.plan.runs)):
            for column in range(self.exact.shape[1]):
                one = np.zeros_like(self.exact)
                one[self.moments.run_of_row == run, column] = 1.0
                white = self._whiten(one)
                columns.append(white / (np.linalg.norm(white) or 1.0))
        return np.array(columns).T

    def seen(self, effect: Values, also: np.ndarray | None = None) -> float:
        """What is left to be seen of an effect when the noise may be taken for larger than it is."""
        rest, count, channels = self.left(self.shift(effect), also), self.exact.size, self.exact.shape[1]
        channel_of = np.arange(count) % channels
        between = (self.offsets.T @ rest[:count]) ** 2
        recorded = np.abs(self._whiten(np.ones_like(self.exact))) > 0
        free_between = np.sum(self.offsets**2, axis=0) - np.sum((self.basis[:count].T @ self.offsets) ** 2, axis=0)
        free = recorded - np.sum(self.basis[:count] ** 2, axis=1)
        total = float(np.sum(rest[count:] ** 2))
        for channel in range(channels):
            own = np.arange(len(between)) % channels == channel
            s_between, freedom_between = between[own].sum(), max(free_between[own].sum(), 0.5)
            s_within = np.sum(rest[:count][channel_of == channel] ** 2) - s_between
            freedom_within = free[channel_of == channel].sum() - freedom_between
            total += freedom_between * np.log1p(s_between / freedom_between)
            total += freedom_within * np.log1p(max(s_within, 0.0) / freedom_within)
        if any(listed["name"] == "correlated_noise" for listed in self.moments.plan.effects):
            shift = self.shift(effect).reshape(self.exact.shape)
            ends = np.flatnonzero(np.diff(self.moments.run_of_row)) + 1
            total = min(total, sum(seen_past_correlation(each) for run in np.split(shift, ends) for each in run.T))
        return total


def seen_past_correlation(shift: np.ndarray) -> float:
    """What is left to be seen of a shift (rows,) in units of white noise, if that may be taken for an AR(1) process.

    The least expected rise of −2 log likelihood, n log((tr R⁻¹ + q)/n) + log det R, over the correlation φ of
    neighbouring rows, q = shiftᵀR⁻¹shift past a constant; the best variance is put in.
    """
    n, phi = len(shift), np.linspace(-0.9, 0.995, 380)
    own, next_to = float(shift @ shift), float(shift[1:] @ shift[:-1])
    inner = float(shift[1:-1] @ shift[1:-1])
    square = own + phi**2 * inner - 2 * phi * next_to
    with_one = shift.sum() - phi * (shift[1:].sum() + shift[:-1].sum()) + phi**2 * shift[1:-1].sum()
    ones = n - 2 * phi * (n - 1) + phi**2 * (n - 2)
    rest = (square - with_one**2 / ones + 2 + (n - 2) * (1 + phi**2)) / (1 - phi**2)
    return float(np.min(n * np.log(rest / n) + (n - 1) * np.log(1 - phi**2)))


def whitened(moments: NoiseFree, whiteners, readings: np.ndarray) -> np.ndarray:
    """Readings (rows, channels) times L⁻¹, flattened."""
    white = np.empty_like(readings)
    for run, of_channel in enumerate(whiteners):
        at = moments.run_of_row == run
        for column, whitener in enumerate(of_channel):
            white[at, column] = whitener @ readings[at, column]
    return white.reshape(-1)


def covariance_whiteners(plan: Plan, values: Values) -> tuple[tuple[np.ndarray, ...], ...]:
    """L⁻¹ of every run and channel: white noise, run offsets, what grows with the rate, autoregression."""
    whiteners = []
    for run in plan.runs:
        samples = np.array([row.samples for row in run.rows])
        apart = np.abs(np.subtract.outer(np.arange(len(samples)), np.arange(len(samples))))
        of_channel = []
        for channel in plan.channels:
            own = values[f"white_noise.sigma[{channel.name}]"] ** 2 / samples
            own = own + rate_noise(plan, run, channel, values) ** 2
            covariance = np.diag(own) + values.get(f"run_scatter.tau[{channel.name}]", 0.0) ** 2
            if slow := values.get(f"correlated_noise.sigma[{channel.name}]", 0.0):
                covariance += slow**2 * values[f"correlated_noise.correlation[{channel.name}]"] ** apart
            white = np.linalg.inv(np.linalg.cholesky(covariance))
            of_channel.append(white if run.records(channel) else np.zeros_like(white))
        whiteners.append(tuple(of_channel))
    return tuple(whiteners)


def _together(names: list[str], channels: set[str]) -> list[list[str]]:
    """Names that can be changed at once because each moves its own channel alone."""
    groups = defaultdict(list)
    for name in names:
        parameter, label = name.rstrip("]").split("[")
        groups[parameter if label in channels else name].append(name)
    return list(groups.values())


def look(plan: Plan, values: Values) -> Sight:
    """Set up S for a plan and the truth of its baseline."""
    moments, whiteners = plan.moments(), covariance_whiteners(plan, values)
    exact = moments.means(moments.outputs(values))
    slopes = _slopes(moments, values, exact)
    absorbing = np.moveaxis(slopes, -1, 0)
    columns = np.array([whitened(moments, whiteners, each) for each in absorbing]).T
    # In units of its prior width every parameter adds a prior row of one.
    basis, _ = np.linalg.qr(np.concatenate([columns, np.eye(columns.shape[1])]))
    return Sight(moments, values, exact, slopes, whiteners, basis)


def _slopes(moments: NoiseFree, values: Values, exact: np.ndarray) -> np.ndarray:
    """Derivatives of the readings by the baseline's parameters, per prior width, (rows, channels, parameters)."""
    plan, slopes = moments.plan, []
    widths = baseline_widths(plan)
    column = {channel.name: index for index, channel in enumerate(plan.channels)}
    for together in _together(list(widths), set(column)):
        moved = {name: values.get(name, 0.0) + STEP * widths[name] for name in together}
        change = (moments.means(moments.outputs({**values, **moved})) - exact) / STEP
        for name in together:
            own = change
            label = name.rstrip("]").split("[")[1]
            if label in column:
                own = np.zeros_like(change)
                own[:, column[label]] = change[:, column[label]]
            slopes.append(own)
    return np.stack(slopes, axis=-1)
