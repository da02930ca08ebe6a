"""How a fitted model predicts runs that it has not seen.

The readings of the new runs are y = f(θ, ν) + noise.  Of θ, what they share with the fit, its posterior is known; the
unknowns ν of the new runs alone, such as a seat, have their priors.  About the posterior mean of θ, and about the ν
that fit best there, the model is linear, and the predictive covariance is J_θ C J_θᵀ + J_ν W² J_νᵀ + Σ, with Σ the
noise at the root mean square of its scales, offsets of runs included.  χ² of all readings, or of one run and channel,
is that of their predictive distribution; it has as many degrees of freedom as readings, less the unknowns of a
procedure itself: the attitudes of a unit turned by hand begin at what the readings say, and their priors say nothing.

The same numbers say what the new runs would make of each estimate.  The shift of an estimate by data that the model
describes has the variance by which these data reduce that of its posterior, which is what it is compared with.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imubayes.adequacy.known_noise_fit import noise_sd
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.numerics import inverse_of_precision
from imubayes.foundations.records import Record
from imubayes.foundations.tail_probabilities import normal_survival, t_survival
from imubayes.inference import laplace_marginal as laplace
from imubayes.inference.fitted_model import Fit
from imubayes.inference.parameter_fit import Linearised, linearise, whitened_about
from imubayes.loop.joined_runs import JoinedRuns, joined_runs
from imubayes.model.problem import Problem, prior_widths
from imubayes.noise.components import SharedNoise

_STEPS, _SHORTEST, _SETTLED = 30, 1e-3, 1e-3
# The new runs test a direction if they know it better than the calibration does.
_TESTED = 0.5
# Share of its deviation by which an estimate may move at most that new runs show nothing of.
_UNMOVED = 1e-6
# Share of the noise of a combination of readings that must be left beside unknowns without a prior, to be judged.
_LEFT = 0.05


class ShiftedEstimate(Record):
    """What new runs would make of an estimate, in its unit.

    Attributes
    ----------
    before, sd : of the fit.
    shift : of its mean by the new runs.
    pull : the shift over its standard deviation if the model describes the new runs.
    p : chance of so large a pull there: normal, or Student's t if the fit learnt from its few runs how they scatter.
    """

    name: str
    unit: str
    before: float
    sd: float
    shift: float
    pull: float
    p: float


@dataclass(frozen=True)
class PredictedRuns:
    """New runs against their predictive distribution; arrays have one value for each of their n readings.

    Attributes
    ----------
    joined : the model on all runs.
    predicted, model_sd, noise_sd : output units: at the fit, with the unknowns of the new runs as they fit best;
        standard deviations of the prediction, and of the noise.
    whitened, freedom : the squares over one run and channel add up to its χ², the others to its degrees of freedom.
    chi2, n : of all readings together, and its degrees of freedom.
    calibration_chi2, directions : χ² of the combinations of estimates that the new runs know better than the fit, and
        how many there are.
    shifts : of what the fit estimates and the new runs inform on, largest pull first.
    """

    joined: JoinedRuns
    predicted: np.ndarray
    model_sd: np.ndarray
    noise_sd: np.ndarray
    whitened: np.ndarray
    freedom: np.ndarray
    chi2: float
    n: int
    calibration_chi2: float
    directions: int
    shifts: tuple[ShiftedEstimate, ...]


@dataclass(frozen=True)
class _Spread:
    """Readings r in units of their noise, with what else spreads them: r = K (v − v̂) + noise, v ~ N(0, 1).

    Attributes
    ----------
    residual : shape (n,).
    columns : K, shape (n, k).
    best : v̂, shape (k,), about which the residual is.
    taken : shape (n, f), orthonormal over all readings: what unknowns without a prior take of residual and columns.
    """

    residual: np.ndarray
    columns: np.ndarray
    best: np.ndarray
    taken: np.ndarray

    def of(self, rows: np.ndarray) -> "_Spread":
        return _Spread(self.residual[rows], self.columns[rows], self.best, self.taken[rows])

    def svd(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return np.linalg.svd(self.columns, full_matrices=False)

    def whitened(self) -> tuple[np.ndarray, int]:
        """Return S^(−½) (r + K v̂), (n,), S = I − F Fᵀ + K Kᵀ, and its rank: no term grows with the width of a prior."""
        if not self.taken.shape[1]:
            return self._whitened(), len(self.residual)
        sizes, axes = np.linalg.eigh(np.eye(len(self.residual)) - self.taken @ self.taken.T)
        left = axes[:, sizes > _LEFT]
        scaled = left.T / np.sqrt(sizes[sizes > _LEFT])[:, None]
        inner = replace(self, residual=scaled @ self.residual, columns=scaled @ self.columns)
        return left @ inner._whitened(), left.shape[1]

    def _whitened(self) -> np.ndarray:
        across, sizes, along = self.svd()
        outside = self.residual - across @ (across.T @ self.residual)
        own = (across.T @ self.residual + sizes * (along @ self.best)) / np.sqrt(1 + sizes**2)
        return outside + across @ own

    def update(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the mean of v given the readings, (k,), and a root of the covariance of that mean, (k, k′)."""
        across, sizes, along = self.svd()
        shrunk = (across.T @ self.residual + sizes * (along @ self.best)) * sizes / (1 + sizes**2)
        return along.T @ shrunk, along.T * (sizes / np.sqrt(1 + sizes**2))


def root_mean_square_scales(fit: Fit, estimates: Mapping[str, tuple[float, float]]) -> np.ndarray:
    """Return the noise scales, (H,) in z, whose squares are the posterior means of their squares.

    The variance of a reading of unknown noise scale is the mean of its variances.  The mode of a scatter that few runs
    determine is far below that.

    Parameters
    ----------
    estimates : name → posterior mean and standard deviation of a scale, in its unit; the mode stands for others.
    """
    found = np.array(fit.h, dtype=float)
    for place, parameter in enumerate(fit.model.hyper_layout.parameters):
        if parameter.name in estimates:
            z = parameter.z_at(float(np.hypot(*estimates[parameter.name])))
            found[place] = found[place] if z is None else z
    return found


def predict_runs(
    fit: Fit,
    campaign: Campaign,
    scales: np.ndarray,
    changed: Sequence[str] = (),
    any_unit: bool = False,
    tell: Callable[[str], None] = lambda text: None,
) -> PredictedRuns:
    """Return the runs of a campaign against their prediction by a fit, whose Gaussian posterior about the mode is used.

    Parameters
    ----------
    scales : noise scales h at which it is predicted, (H,) in z of the fit; see `root_mean_square_scales`.
    changed, any_unit : see `joined_runs`.
    tell : called with a short text as the work goes on.

    Raises
    ------
    InputError
        as of `joined_runs`.
    """
    tell("joining the runs")
    joined = joined_runs(fit, campaign, changed, any_unit)
    model, shared, new = joined.model, joined.shared_with(fit), joined.entries
    h = model.hyper_layout.carried(fit.model.hyper_layout, scales)
    z = np.where(shared, model.layout.carried(fit.model.layout, fit.z), 0.0)
    tell("fitting the new runs")
    fitted = _with_own_unknowns(model.problem, z, h, ~shared, new)
    about, (residual, jacobian, widths) = fitted.about, fitted.white
    z, residual, jacobian = np.asarray(about.z), residual[new], jacobian[new]
    root = _posterior_root(fit, joined, shared, scales)
    own, best = jacobian[:, ~shared] * widths[~shared], z[~shared] / widths[~shared]
    procedural = np.array([parameter.nuisance for parameter in model.layout.parameters], dtype=bool)[~shared]
    spread = _spread(residual, own, best, procedural, jacobian[:, shared] @ root)
    count = spread.columns.shape[1] - root.shape[1]
    mean, change = spread.update()
    calibration_chi2, directions = _tested(mean[count:], change[count:])
    unwhitened = np.asarray(about.jacobian)[new]
    answered = np.linalg.solve(np.eye(own.shape[1]) + own.T @ own, own.T @ (jacobian[:, shared] @ root))
    felt = unwhitened[:, shared] @ root - (unwhitened[:, ~shared] * widths[~shared]) @ answered
    groups = np.asarray(model.problem.observations.group)[new]
    whitened, freedom = np.zeros(len(residual)), np.zeros(len(residual))
    for group in np.unique(groups):
        rows = groups == group
        whitened[rows], rank = spread.of(rows).whitened()
        freedom[rows] = rank / np.sum(rows)
    together, n = spread.whitened()
    return PredictedRuns(
        joined=joined,
        predicted=(np.asarray(model.entries.value) - np.asarray(about.misfit))[new],
        model_sd=np.sqrt(np.sum(felt**2, axis=1)),
        noise_sd=np.asarray(noise_sd(model.problem, np.asarray(h)))[new],
        whitened=whitened,
        freedom=freedom,
        chi2=float(np.sum(together**2)),
        n=n,
        calibration_chi2=calibration_chi2,
        directions=directions,
        shifts=_shifts(fit, joined, shared, z, root, (mean[count:], change[count:])),
    )


def _spread(
    residual: np.ndarray, own: np.ndarray, best: np.ndarray, procedural: np.ndarray, shared: np.ndarray
) -> _Spread:
    """Return what spreads the readings, (n,): own unknowns with a prior, (n, k) in units of it, and what is shared.

    Parameters
    ----------
    best : shape (k,), where the own unknowns fit best.
    procedural : which of them are unknowns of the procedure: what they change by more than the noise is taken out.
    """
    across, sizes, along = np.linalg.svd(own[:, procedural], full_matrices=False)
    free = sizes > 1.0
    taken = across[:, free]
    columns = np.hstack([own[:, ~procedural], across[:, ~free] * sizes[~free], shared])
    about = np.concatenate([best[~procedural], along[~free] @ best[procedural], np.zeros(shared.shape[1])])
    return _Spread(residual - taken @ (taken.T @ residual), columns - taken @ (taken.T @ columns), about, taken)


@dataclass(frozen=True)
class _OwnFit:
    """The model linearised, whitened residual, Jacobian and prior widths of all runs, and the step of new ones there.

    Attributes
    ----------
    left, slope : of the new entries and of the priors of what they alone know, (n + k,) and (n + k, k).
    """

    about: Linearised
    white: tuple[np.ndarray, np.ndarray, np.ndarray]
    left: np.ndarray
    slope: np.ndarray

    @property
    def cost(self) -> float:
        return float(self.left @ self.left)


def _with_own_unknowns(problem: Problem, z: np.ndarray, h: np.ndarray, own: np.ndarray, new: np.ndarray) -> _OwnFit:
    """Return the model where what new runs alone know, (P,) bool, fits them best, by Gauss–Newton steps."""

    def at(point: np.ndarray) -> _OwnFit:
        about = linearise(problem, np.asarray(point))
        residual, jacobian, widths = white = whitened_about(problem, about, h)
        left = np.concatenate([residual[new], -point[own] / widths[own]])
        return _OwnFit(about, white, left, np.concatenate([jacobian[new][:, own], np.diag(1 / widths[own])]))

    here = at(z)
    for _ in range(_STEPS if own.any() else 0):
        step = np.linalg.lstsq(here.slope, here.left, rcond=None)[0]
        length = 1.0
        while length > _SHORTEST:
            further = z.copy()
            further[own] += length * step
            ahead = at(further)
            if ahead.cost <= here.cost:
                break
            length *= 0.3
        else:
            break
        z, here = further, ahead
        if np.linalg.norm(here.slope @ step) < _SETTLED:
            break
    return here


def _posterior_root(fit: Fit, joined: JoinedRuns, shared: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """Return a root (S, S) of the posterior covariance of what is shared, by what the runs of the fit say."""
    model, old = joined.model, fit.model
    h = model.hyper_layout.carried(old.hyper_layout, scales)
    widths = np.asarray(prior_widths(model.problem, np.asarray(h)))
    about = linearise(old.problem, np.asarray(fit.z))
    told = laplace.precision_of(old.problem, about, np.asarray(scales))
    places = [model.layout.index(name) for name in old.layout.names]
    precision = np.diag(widths**-2)
    precision[np.ix_(places, places)] += told
    covariance = inverse_of_precision(precision)[np.ix_(shared, shared)]
    scale = np.sqrt(np.diag(covariance))
    sizes, axes = np.linalg.eigh(covariance / np.outer(scale, scale))
    return scale[:, None] * axes * np.sqrt(np.maximum(sizes, 0.0))


def _tested(mean: np.ndarray, change: np.ndarray) -> tuple[float, int]:
    """Return χ² and number of the directions of the posterior, in units of its widths, that new runs know better."""
    axes, sizes, _ = np.linalg.svd(change, full_matrices=False)
    known = sizes**2 > _TESTED
    return float(np.sum((axes[:, known].T @ mean / sizes[known]) ** 2)), int(known.sum())


def _shifts(
    fit: Fit,
    joined: JoinedRuns,
    shared: np.ndarray,
    z: np.ndarray,
    root: np.ndarray,
    update: tuple[np.ndarray, np.ndarray],
) -> tuple[ShiftedEstimate, ...]:
    moved, spread = root @ update[0], np.sqrt(np.sum((root @ update[1]) ** 2, axis=1))
    widths, found = np.sqrt(np.sum(root**2, axis=1)), []
    scatters = any(issubclass(layer.noise, SharedNoise) for layer in fit.model.problem.noise)
    freedom = max(len(fit.model.campaign.runs) - 1, 1)
    for place, shift, usual, sd in zip(np.flatnonzero(shared).tolist(), moved, spread, widths, strict=True):
        parameter = joined.model.layout.parameters[place]
        if parameter.nuisance or not usual > _UNMOVED * sd:
            continue
        slope = (parameter.value_at(z[place] + sd) - parameter.value_at(z[place] - sd)) / (2 * sd)
        pull = float(shift / usual)
        beyond = t_survival(abs(pull), freedom) if scatters else normal_survival(abs(pull))
        found.append(
            ShiftedEstimate(
                name=parameter.name,
                unit=parameter.shown_unit,
                before=parameter.value_at(z[place]),
                sd=float(abs(slope) * sd),
                shift=float(slope * shift),
                pull=pull,
                p=2 * float(beyond),
            )
        )
    return tuple(sorted(found, key=lambda each: -abs(each.pull)))
