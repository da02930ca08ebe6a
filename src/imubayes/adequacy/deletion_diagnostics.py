"""Deletion diagnostics of a fit at the noise known beforehand: the runs that the others do not predict.

A fit adapts its noise scales to whatever the model lacks: a run whose recorded input is wrong becomes scatter between
runs, and no residual is left to reveal it.  Every run is therefore predicted from the others at the noise known before
the fit: white noise is that of the raw samples within rows, and a scatter between runs is no larger than its prior
says.

About a point the model is linear, y = f + J t + e.  The contribution of a run to the χ² of all others is the difference
of two least-squares fits with the priors as further rows (Cook and Weisberg, Residuals and Influence in Regression,
1982). Runs and channels are independent of each other, so a run is left out by subtracting its normal equations: the
cost grows with the number of readings, whatever the number of runs.

A run is reported only if the others agree with one another.  If all runs still scatter, something is missing in
the model and no run is to blame.  A wrong record of a run is weighed by `weighed_records`, and beside
effects by `imubayes.criticism.evidence`.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg

from imubayes.adequacy.adequacy_record import DoubtedRun
from imubayes.adequacy.known_noise import known_scales, largest_scatter, scales_between_runs
from imubayes.foundations.tail_probabilities import f_log_survival
from imubayes.inference.fitted_model import Fit
from imubayes.inference.parameter_fit import linearise
from imubayes.model.bind import Model
from imubayes.model.noise_covariance import inverse_covariance, whitener
from imubayes.model.problem import Problem, prior_widths

_LEAST_FREEDOM = 5.0
"""Degrees of freedom of a channel below which it does not determine its noise."""


@dataclass(frozen=True)
class ChannelEquations:
    """Normal equations of the outputs of each channel at the noise known beforehand.

    Attributes
    ----------
    matrix, vector, square : JᵀΣ⁻¹J (K, P, P), JᵀΣ⁻¹y (K, P) and yᵀΣ⁻¹y (K,), y the misfit.
    count : shape (K,), outputs.
    """

    matrix: np.ndarray
    vector: np.ndarray
    square: np.ndarray
    count: np.ndarray

    def __sub__(self, other: "ChannelEquations") -> "ChannelEquations":
        return ChannelEquations(
            self.matrix - other.matrix, self.vector - other.vector, self.square - other.square, self.count - other.count
        )


@dataclass(frozen=True)
class WeightedFit:
    """Least squares of the channels, each with a factor on Σ⁻¹, (K,), and the priors.

    Attributes
    ----------
    precision, centre : of the priors, (P,), the centre less the point of linearisation.
    """

    equations: ChannelEquations
    precision: np.ndarray
    centre: np.ndarray
    weight: np.ndarray

    @cached_property
    def whole(self) -> np.ndarray:
        """The precision of all parameters, (P, P)."""
        found = np.tensordot(self.weight, self.equations.matrix, 1)
        return 0.5 * (found + found.T) + np.diag(self.precision)

    @cached_property
    def _lower(self) -> np.ndarray:
        return np.linalg.cholesky(self.whole)

    @cached_property
    def shift(self) -> np.ndarray:
        """The parameters of least χ² less the point of linearisation, (P,)."""
        pull = self.weight @ self.equations.vector + self.precision * self.centre
        return scipy.linalg.cho_solve((self._lower, True), pull)

    @cached_property
    def chi2_of_channels(self) -> np.ndarray:
        """The χ² of the outputs of each channel, (K,), at a factor of 1."""
        at, known = self.shift, self.equations
        return np.maximum(known.square - 2 * known.vector @ at + (known.matrix @ at) @ at, 0.0)

    @cached_property
    def chi2(self) -> float:
        """The least χ², priors included."""
        return float(self.weight @ self.chi2_of_channels + self.precision @ (self.shift - self.centre) ** 2)

    @cached_property
    def freedom(self) -> np.ndarray:
        """Degrees of freedom that the parameters leave to each channel, (K,)."""
        covariance = scipy.linalg.cho_solve((self._lower, True), np.eye(len(self.precision)))
        return self.equations.count - self.weight * np.sum(self.equations.matrix * covariance, axis=(1, 2))

    @property
    def noise_ratios(self) -> np.ndarray:
        """χ² over degrees of freedom of each channel, (K,), at least 1; of all channels if one has few."""
        whole = self.chi2_of_channels.sum() / max(self.freedom.sum(), _LEAST_FREEDOM)
        few = self.freedom < _LEAST_FREEDOM
        own = self.chi2_of_channels / np.where(few, 1.0, self.freedom)
        return np.maximum(1.0, np.where(few, whole, own))


@dataclass(frozen=True)
class LinearFit:
    """The model linearised, at given noise.

    Attributes
    ----------
    jacobian, misfit : shapes (E, P) and (E,).
    weighted, pulled : Σ⁻¹J and Σ⁻¹ misfit; entries of different runs or channels are independent.
    precision, centre : of the priors, (P,), the centre less the point of linearisation.
    run, channel : shape (E,), of each entry.
    used : shape (E,), bool, which entries count.
    """

    jacobian: np.ndarray
    misfit: np.ndarray
    weighted: np.ndarray
    pulled: np.ndarray
    precision: np.ndarray
    centre: np.ndarray
    run: np.ndarray
    channel: np.ndarray
    used: np.ndarray

    @cached_property
    def runs(self) -> dict[int, np.ndarray]:
        """The entries of each run that count."""
        return {run: np.flatnonzero(self.used & (self.run == run)) for run in np.unique(self.run[self.used]).tolist()}

    @cached_property
    def whole(self) -> ChannelEquations:
        """The normal equations of all runs."""
        return self._equations(np.flatnonzero(self.used))

    def of_run(self, run: int) -> ChannelEquations:
        """Return the normal equations of one run."""
        return self._equations(self.runs[run])

    def fit(self, equations: ChannelEquations, weight: np.ndarray | None = None) -> WeightedFit:
        """Return the fit of some outputs with factors on Σ⁻¹ of each channel, (K,), if given."""
        weight = np.ones(len(equations.count)) if weight is None else weight
        return WeightedFit(equations, self.precision, self.centre, weight)

    def _equations(self, entries: np.ndarray) -> ChannelEquations:
        parts = [entries[self.channel[entries] == k] for k in range(int(self.channel.max(initial=-1)) + 1)]
        return ChannelEquations(
            np.stack([self.jacobian[own].T @ self.weighted[own] for own in parts]),
            np.stack([self.jacobian[own].T @ self.pulled[own] for own in parts]),
            np.array([self.misfit[own] @ self.pulled[own] for own in parts]),
            np.array([len(own) for own in parts]),
        )


def linear_fit(model: Model, problem: Problem, z: np.ndarray, h: np.ndarray) -> LinearFit:
    """Return a problem of a model linearised about parameters z at noise scales h."""
    about = linearise(problem, np.asarray(z))
    jacobian, misfit = np.asarray(about.jacobian), np.asarray(about.misfit)
    divided = divide(problem, h, np.column_stack([misfit, jacobian]))
    entries = model.entries
    return LinearFit(
        jacobian=jacobian, misfit=misfit, weighted=divided[:, 1:], pulled=divided[:, 0],
        precision=np.asarray(prior_widths(problem, np.asarray(h))) ** -2.0, centre=-np.asarray(z),
        run=entries.run, channel=entries.channel, used=np.asarray(problem.observations.weight) > 0,
    )  # fmt: skip


def divide(problem: Problem, h: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return Σ(h)⁻¹ times columns (E, C)."""
    return inverse_covariance(problem, whitener(problem, np.asarray(h)), columns)[0]


_TOLD_P = 0.005
"""Chance, for all runs together, below which a run is reported to disagree (convention)."""


def known_before(fitted: Fit) -> np.ndarray:
    """Return the noise scales at which runs are judged, in z: as known beforehand, or as fitted if that is less.

    A scatter between runs that is less as fitted shows nothing: beside a gross error white noise takes it all.
    """
    known, between = known_scales(fitted, correlated=True), scales_between_runs(fitted.model)
    return np.where(between, known, np.minimum(known, np.asarray(fitted.h)))


def runs_apart(fitted: Fit, linear: LinearFit, disagreeing: Mapping[int, float]) -> tuple[DoubtedRun, ...]:
    """Return the runs that the others do not predict although they agree with one another, the least probable first.

    Parameters
    ----------
    linear : the fit linearised at the noise known before.
    disagreeing : the log p-value of each run, as `disagreeing_runs` has it.
    """
    names, found = [run.name for run in fitted.model.campaign.runs], []
    largest = largest_scatter(fitted.model)
    for run, log_p in disagreeing.items():
        if log_p < math.log(_TOLD_P) and agree(linear.fit(linear.whole - linear.of_run(run)), largest):
            found.append(DoubtedRun(run=names[run], p=math.exp(log_p)))
    return tuple(sorted(found, key=lambda each: each.p))


def disagreeing_runs(linear: LinearFit) -> dict[int, float]:
    """Return the log p-value of what each run adds to the χ² of the others, corrected for the number of runs."""
    found, runs = {}, linear.runs
    for run in runs if len(runs) > 1 else ():
        chi2, dof, freedom = _deletion(linear, run)
        f = chi2 / max(dof, 1)
        # If the others scatter more than was known their noise is an estimate.
        log_p = float(f_log_survival(f, dof, freedom)) if freedom else 0.0
        found[run] = log_p + np.log(len(runs))
    return found


def agree(others: WeightedFit, largest: np.ndarray) -> bool:
    """Return whether no channel scatters more than what is known of its noise allows, (K,), as a factor."""
    count = min(len(largest), len(others.weight))  # closing rotations come after the channels
    seen = others.equations.count[:count] > 0
    return bool(np.all(~seen | (others.noise_ratios[:count] <= largest[:count] ** 2)))


def _deletion(linear: LinearFit, run: int) -> tuple[float, int, float]:
    """Return the χ² that a run adds to the others, its number of outputs, and degrees of freedom of the others.

    Each channel has the noise that the others show if that is larger, and one that they lack that of the median output.
    """
    others = linear.whole - linear.of_run(run)
    weight = 1 / linear.fit(others).noise_ratios
    usual = np.median(np.repeat(weight, others.count)) if others.count.any() else 1.0
    weight = np.where(others.count > 0, weight, usual)
    rest, whole = linear.fit(others, weight), linear.fit(linear.whole, weight)
    freedom = max(float(others.count.sum()) - len(rest.shift), 1.0)
    return max(whole.chi2 - rest.chi2, 0.0), len(linear.runs[run]), freedom
