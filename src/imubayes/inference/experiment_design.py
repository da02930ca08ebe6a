"""Experiment design: candidate runs ranked by how much they would narrow a quantity; contributions of procedures.

The ranking follows from the Jacobian alone, without simulation: a candidate that the equipment allows adds JᵀΣ⁻¹J to
the precision, and the variance of a quantity with gradient c is cᵀH⁻¹c.  All candidates are bound together, as runs
whose observations do not count, so that one Jacobian serves all.

The angle between two axes is the length of the component of one across the other.  At 0° and 180° a length has no
derivative, and near them its distribution is that of a two-dimensional vector (Rice), so a budget is drawn up of the
two components of the direction, which have a gradient; E[angle²] is the sum of their mean squares, and each input
contributes to it through both.  What a run leaves of the standard deviation of such an angle follows from the
covariance of its components: the length of N(0, σ²I) in two dimensions has 0.66 σ (Rayleigh).  For any normal x with Q
= |x|², E√Q = π^(−½) ∫ (1 − φ(s²)) / s² ds over s > 0, where φ(t) = E exp(−tQ) is elementary (Mathai and Provost,
Quadratic Forms in Random Variables, § 3.2a).

The contribution of a test procedure is the uncertainty of a quantity from that procedure alone, and without it.  Given
the noise scales h the precision of the parameters is the prior's plus a sum over runs, JᵀΣ(h)⁻¹J of each.  With the
gradient c of a quantity its variance is cᵀΛ(h)⁻¹c for any sum that leaves something out, and its mean over draws of h
the variance that is reported: at the mode of h alone, the scatter between few runs is understated.  The standard
deviation from all runs is that of the posterior itself.  That holds for quantities that are linear in the parameters
over the posterior.  Angles near zero are left out: a linear variance would contradict their posterior.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from imubayes.effects.base import Effect, Stage
from imubayes.foundations.arrays import cholesky, solve_lower
from imubayes.foundations.quantity_names import AXIS_ANGLE, MOUNTING_ANGLE, QuantityName
from imubayes.inference.candidate_runs import CandidateRun, NextRun, RunDesign, candidate_runs
from imubayes.inference.fitted_model import Fit, evenly_spaced
from imubayes.inference.identifiability import Contribution, ProcedureShare, WeakDirection
from imubayes.inference.laplace_marginal import inverse_of_precision, precision_of, whitened_jacobian
from imubayes.inference.parameter_fit import Linearised, linearise
from imubayes.model.bind import Model, bind
from imubayes.model.derived_quantities import derived_jacobian, evaluate_derived, evaluate_directions
from imubayes.model.nodes_and_entries import KINDS
from imubayes.model.problem import Problem, prior_widths
from imubayes.parameters.declarations import prior_slopes

# An angle closer to 0° or 180° than this many standard deviations of its components is near it: at four the standard
# deviation by its gradient is that of the angle to 3 %.
NEAR = 4.0
# Angles beyond are not looked at, deg: no posterior of a component is as wide.
_CLOSE = 20.0
_APART = 1e-3


@dataclass(frozen=True)
class Components:
    """The components of which a quantity is the length, in its unit.

    Attributes
    ----------
    at_mode : shape (m,).
    gradient : shape (m, P), with respect to z.
    """

    at_mode: np.ndarray
    gradient: np.ndarray


def components_near_zero(fit: Fit, names: Sequence[str], covariance: np.ndarray) -> dict[str, Components]:
    """Return the two components of every angle near 0° or 180°, in deg, by name.

    Parameters
    ----------
    fit : of the quantities.
    names : quantities asked for; other angles are left out.
    covariance : shape (P, P), of the parameters at the mode, in z.
    """
    derivation, problem = fit.derived.derivation, fit.model.problem
    at_mode = evaluate_derived(derivation, problem, fit.z[None])[0].tolist()
    angles = {quantity.name: angle for quantity, angle in zip(fit.derived.names, at_mode, strict=True)}
    pairs = {name: pair for name, pair in _pairs(fit).items() if name in names and _distance(angles[name]) < _CLOSE}
    if not pairs:
        return {}
    steps = _APART * np.eye(len(fit.z))
    points = np.concatenate([fit.z[None], fit.z + steps, fit.z - steps])
    middle, *rest = evaluate_directions(derivation, problem, points)
    above, below = np.split(np.stack(rest), 2)
    slopes = (above - below) / (2 * _APART)  # (P, A, 3)
    found = {}
    for name, (first, second) in pairs.items():
        sign = np.sign(middle[first] @ middle[second])
        across = np.degrees(_across(middle[first]))
        change = ((slopes[:, first] - sign * slopes[:, second]) @ across).T
        widest = np.sqrt(np.linalg.eigvalsh(change @ covariance @ change.T)[-1])
        if _distance(angles[name]) < NEAR * widest:
            found[name] = Components((middle[first] - sign * middle[second]) @ across, change)
    return found


def _distance(angle: float) -> float:
    """Return the distance of an angle, deg, from 0° or 180°."""
    return min(angle, 180.0 - angle)


def _across(axis: np.ndarray) -> np.ndarray:
    """Return two unit vectors across an axis and each other, as columns (3, 2)."""
    return np.linalg.svd(axis[None, :])[2][1:].T


def _pairs(fit: Fit) -> dict[str, tuple[int, int]]:
    """Return, for each mounting and axis angle, the places of its two axes among the directions."""
    campaign = fit.model.campaign
    kinds = [kind for kind in KINDS if kind in fit.derived.derivation.inputs.channels]
    channels = [channel.name for kind in kinds for channel in campaign.of_kind(kind)]
    place = {name: index for index, name in enumerate(channels)}
    mountings: dict[str, int] = {}
    found = {}
    for quantity in fit.derived.names:
        name = QuantityName.of(quantity.name)
        # Mountings stand in the order in which the angles of the first channel name them.
        if name.family == MOUNTING_ANGLE:
            channel, mounting = name.labels
            found[quantity.name] = place[channel], len(channels) + mountings.setdefault(mounting, len(mountings))
        elif name.family == AXIS_ANGLE:
            first, second = name.labels
            found[quantity.name] = place[first], place[second]
    return found


# Nodes in log s: the integrand falls like exp(−|v|) on both sides, so that the ends leave out 1e-11 of it.
_LOGARITHM = np.linspace(-25.0, 25.0, 501)
# Length in standard deviations from which the gradient serves: its error there is below 1e-6 of the variance, and the
# difference of two large squares is lost to rounding.
_FAR = 1e3
# Nodes per dimension over the estimates that a further run may leave.
_ESTIMATES = 16


def length_deviation(mean: np.ndarray, covariance: np.ndarray) -> float:
    """Return the standard deviation of |x|, x normal with mean (m,) and covariance (m, m)."""
    return float(np.sqrt(_variance(mean[None], covariance)[0]))


def expected_length_deviation(mean: np.ndarray, before: np.ndarray, after: np.ndarray) -> float:
    """Return the standard deviation of |x| that is expected of data that narrow x from covariance `before` to `after`.

    The root of the mean variance over the estimates of x that the data may give: normal about `mean` (m,), with
    covariance `before` − `after`, (m, m).
    """
    nodes, weights = np.polynomial.hermite_e.hermegauss(_ESTIMATES)
    grid = np.stack(np.meshgrid(*[nodes] * len(mean), indexing="ij"), axis=-1).reshape(-1, len(mean))
    product = np.prod(np.stack(np.meshgrid(*[weights] * len(mean), indexing="ij"), axis=-1), axis=-1).reshape(-1)
    gained, axes = np.linalg.eigh(before - after)
    estimates = mean + (grid * np.sqrt(np.maximum(gained, 0.0))) @ axes.T
    return float(np.sqrt(product @ _variance(estimates, after) / product.sum()))


def _variance(means: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the variance of |x| for each of several means, (n, m) → (n,)."""
    spread, axes = np.linalg.eigh(covariance)
    spread, squares = np.maximum(spread, 0.0), (means @ axes) ** 2
    size = squares.sum(axis=1) + spread.sum()
    root = np.sqrt(np.where(size > 0, size, 1.0))
    # s in units of 1/√E Q, so that one set of nodes serves all.
    t = np.exp(2 * _LOGARITHM)[None, :, None] / root[:, None, None] ** 2
    widened = 1 + 2 * t * spread
    exponent = -(t * squares[:, None, :] / widened).sum(axis=2) - 0.5 * np.log(widened).sum(axis=2)
    integrand = -np.expm1(exponent) * np.exp(-_LOGARITHM)
    mean_length = root * np.trapezoid(integrand, _LOGARITHM, axis=1) / np.sqrt(np.pi)
    square = squares.sum(axis=1)
    along = squares @ spread / np.where(square > 0, square, 1.0)
    return np.where(square > _FAR**2 * spread.sum(), along, np.maximum(size - mean_length**2, 0.0))


# A further run is proposed for quantities with less than this share from the data.
_WANTED_SHARE = 0.5
_MOST_LISTED = 6
# A run that leaves more than this share of a standard deviation is not proposed.
_USEFUL = 0.9


def with_planned(fit: Fit, elsewhere: bool = False) -> tuple[Fit, list[CandidateRun]]:
    """Return a fit bound anew to its campaign with every candidate run appended, and these runs.

    Parameters
    ----------
    elsewhere : whether runs on another table of the same kind count.
    """
    extended, candidates = candidate_runs(fit.model.campaign, elsewhere)
    campaign = replace(extended, runs=(*extended.runs, *(candidate.run for candidate in candidates)))
    model = bind(fit.model.spec_of_known, campaign, fit.model.registry.without_files())
    z = model.layout.carried(fit.model.layout, fit.z)
    h = model.hyper_layout.carried(fit.model.hyper_layout, fit.h)
    return Fit(model, z, h, fit.optimised, fit.message, sampled=fit.sampled), candidates


def next_runs(fit: Fit, weak: Sequence[WeakDirection], from_data: Mapping[str, float | None]) -> tuple[NextRun, ...]:
    """Return, for each quantity the data left open, the run that would narrow it most; empty where none would.

    Quantities are the members of confusions first, then scale factors and mounting angles, then parameters of sensor
    and converter.  A run counts only where it narrows a quantity by at least a tenth.

    Parameters
    ----------
    fit : a converged fit.
    weak : its weak directions.
    from_data : share of the information contributed by the data, by name of parameter and derived quantity.
    """
    asked = [name for direction in weak if direction.kind == "confusion" for name in direction.quantities]
    undetermined = [name for name, share in from_data.items() if share is not None and share < _WANTED_SHARE]
    asked += [name for name in undetermined if name.startswith(("scale_factor[", "mounting_angle["))]
    sensor = _sensor_parameters(fit.model)
    asked += [name for name in undetermined if name in sensor]
    return best_runs(fit, list(dict.fromkeys(asked)))[:_MOST_LISTED]


def best_runs(fit: Fit, quantities: Sequence[str]) -> tuple[NextRun, ...]:
    """Return, for each quantity that a candidate run narrows by at least a tenth, the run that narrows it most.

    Parameters
    ----------
    fit : a converged fit.
    quantities : names of parameters or derived quantities.
    """
    best = (lines[0] for lines in rank(fit, quantities) if lines)
    return tuple(line for line in best if 0 < line.sd_after < _USEFUL * line.sd_before)


def _sensor_parameters(model: Model) -> set[str]:
    """Return the names of the parameters of sensor and converter effects."""
    return {
        parameter.name
        for effect in model.assembly.effects
        if issubclass(effect.effect_class, Effect)
        and effect.effect_class.stage >= Stage.SENSOR
        and not effect.effect_class.nuisance
        for parameter in effect.parameters
    }


def rank(fit: Fit, quantities: Sequence[str]) -> list[list[NextRun]]:
    """Return, for each quantity, the candidate runs in order of its standard deviation after them.

    Parameters
    ----------
    fit : a converged fit.
    quantities : names of parameters or derived quantities, such as ``scale_factor[gx]``.
    """
    if not quantities:
        return []
    near_zero = _near_zero(fit, quantities)
    parts = [near_zero.get(name) or Components(np.zeros(1), gradient) for name, gradient in _gradients(fit, quantities)]
    expected = expected_deviations(fit, parts)
    units = {name.name: name.unit for name in fit.derived.names} | {
        p.name: p.shown_unit for p in fit.model.layout.parameters
    }
    found = []
    for row, quantity in enumerate(quantities):
        lines = [
            NextRun(
                run=design,
                quantity=quantity,
                sd_before=float(expected.before[row]),
                sd_after=float(after[row]),
                unit=units[quantity],
            )
            for design, after in zip(expected.designs, expected.after, strict=True)
        ]
        found.append(sorted(lines, key=lambda line: line.sd_after))
    return found


class ExpectedDeviations(NamedTuple):
    """Standard deviations of n quantities now, (n,), and expected after each candidate run, (C, n)."""

    designs: list[RunDesign]
    before: np.ndarray
    after: np.ndarray


def expected_deviations(fit: Fit, quantities: Sequence[Components]) -> ExpectedDeviations:
    """Return the candidate runs and the standard deviations of quantities before and after each of them.

    What came with the candidate runs, such as their tables and mountings, changes no quantity of the fit.

    Parameters
    ----------
    fit : a converged fit.
    quantities : with one component each, or with those of which they are the length.
    """
    wide, candidates = with_planned(fit)
    model = wide.model
    about = linearise(model.problem, np.asarray(wide.z))
    gradients = np.concatenate([each.gradient for each in quantities])
    rows = np.stack([model.layout.carried(fit.model.layout, gradient) for gradient in gradients])
    known_runs = len(fit.model.campaign.runs)

    def precision(included: Iterable[int]) -> np.ndarray:
        return precision_of(model.problem, about, np.asarray(wide.h), np.isin(model.entries.run, list(included)))

    now = precision(range(known_runs)) + np.eye(len(wide.z))
    totals = (now, *(now + precision([known_runs + place]) for place in range(len(candidates))))
    covariances = [rows @ np.linalg.solve(total, rows.T) for total in totals]
    ends = np.cumsum([len(each.gradient) for each in quantities])
    parts = [slice(end - len(each.gradient), end) for end, each in zip(ends, quantities, strict=True)]
    places = list(zip(quantities, parts, strict=True))
    found = np.array(
        [
            [_deviation(each, covariances[0][part, part], after[part, part]) for each, part in places]
            for after in covariances
        ]
    )
    return ExpectedDeviations([candidate.design for candidate in candidates], found[0], found[1:])


def _deviation(quantity: Components, before: np.ndarray, after: np.ndarray) -> float:
    """Return the standard deviation of a quantity that is expected where its components narrow to `after`."""
    if len(quantity.at_mode) == 1:
        return float(np.sqrt(after[0, 0]))
    return expected_length_deviation(quantity.at_mode, before, after)


def _near_zero(fit: Fit, quantities: Sequence[str]) -> dict[str, Components]:
    """Return the components of those quantities that are angles near zero."""
    problem = fit.model.problem
    about = linearise(problem, np.asarray(fit.z))
    precision = precision_of(problem, about, np.asarray(fit.h))
    covariance = inverse_of_precision(precision + np.eye(len(fit.z)))
    return components_near_zero(fit, quantities, covariance)


def _gradients(fit: Fit, quantities: Sequence[str]) -> Iterator[tuple[str, np.ndarray]]:
    """Yield derived quantities and parameters with their gradients, in their units, with respect to z, (1, P)."""
    layout, problem = fit.model.layout, fit.model.problem
    names = [name.name for name in fit.derived.names]
    of_derived = derived_jacobian(fit.derived.derivation, problem, fit.z)
    slopes = np.asarray(prior_slopes(problem.priors, np.asarray(fit.z))) / layout.factors()
    for quantity in quantities:
        if quantity in names:
            yield quantity, of_derived[[names.index(quantity)]]
        else:
            place = layout.index(quantity)
            yield quantity, np.eye(len(layout))[[place]] * slopes[place]


_QUANTITIES = ("mounting_angle[", "scale_factor[")
# Draws of the noise scales over which variances are averaged: standard deviations are known to 2 %, as from 200.
_SCALES = 30
# Least share of the posterior variance that a linear function of the parameters explains.
_LINEAR = 0.9


class QuantityDraws(NamedTuple):
    """A quantity with draws of its posterior, (S,) or the first of them, and of its prior, in its unit."""

    name: str
    unit: str
    posterior: np.ndarray
    prior: np.ndarray


def contributions(
    fit: Fit, further: Sequence[QuantityDraws] = (), stated: Mapping[str, float] | None = None
) -> tuple[Contribution, ...]:
    """Return for each quantity that is linear in the parameters its uncertainty by procedure.

    Quantities are mounting angles, scale factors, and further ones, such as determined combinations.  Empty where the
    fit did not converge or there is one procedure alone.  `alone` is the standard deviation from the prior and the runs
    of one procedure, `without` that from all others; both in the unit of the quantity, with the gradient from the
    posterior draws.

    Parameters
    ----------
    further : quantities beside those of the fit.
    stated : standard uncertainties by name; of a quantity without one it is that of its draws.
    """
    procedures = list(dict.fromkeys(run.procedure for run in fit.model.campaign.runs))
    posterior = fit.posterior
    if len(procedures) < 2 or posterior is None or fit.mode is None:
        return ()
    asked = [
        QuantityDraws(name.name, name.unit, posterior.derived[:, place], posterior.prior_derived[:, place])
        for place, name in enumerate(fit.derived.names)
        if name.name.startswith(_QUANTITIES)
    ]
    asked += further
    if not asked:
        return ()
    draws, count = posterior.points[:, : len(fit.z)], len(posterior.derived)
    gradients, linear = _gradients_of_draws(draws[:count], np.stack([each.posterior[:count] for each in asked], axis=1))
    chosen = [each for each, is_linear in zip(asked, linear, strict=True) if is_linear]
    if not chosen:
        return ()
    alone, without = _deviations_by_procedure(fit, procedures, gradients[linear])
    by_procedure = zip(np.moveaxis(alone, 1, 0), np.moveaxis(without, 1, 0), strict=True)
    return tuple(
        _contribution(each, (stated or {}).get(each.name), procedures, *parts)
        for each, parts in zip(chosen, by_procedure, strict=True)
    )


def _contribution(
    of: QuantityDraws, stated: float | None, procedures: Sequence[str], alone: np.ndarray, without: np.ndarray
) -> Contribution:
    """Return a quantity with its standard uncertainty by procedure, (L,) each, and from all data."""
    sd = float(np.std(of.posterior)) if stated is None else stated
    # No part of the data tells more than all of them, and none less than the prior, whose angles may be lengths.
    most = max(sd, float(np.std(of.prior)))
    by = zip(procedures, np.clip(alone, sd, most).tolist(), np.clip(without, sd, most).tolist(), strict=True)
    shares = tuple(ProcedureShare(procedure=name, alone=one, without=others) for name, one, others in by)
    return Contribution(quantity=of.name, unit=of.unit, sd=sd, by=shares)


def _deviations_by_procedure(
    fit: Fit, procedures: Sequence[str], gradients: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the deviations of quantities with gradients (n, P) from each procedure alone and without it, (L, n)."""
    model, problem = fit.model, fit.model.problem
    assert fit.mode is not None
    assert fit.posterior is not None
    of_run = np.array([procedures.index(run.procedure) for run in model.campaign.runs])
    of_entry = of_run[np.asarray(model.entries.run)]
    ends = tuple(np.cumsum(np.bincount(of_entry, minlength=len(procedures))).tolist())
    places = np.asarray(np.argsort(of_entry, kind="stable"))
    draws = evenly_spaced(len(fit.posterior.points), _SCALES)
    scales = np.asarray(fit.posterior.points[draws, len(fit.z) :])
    alone, without = _variances(problem, fit.mode.about, scales, places, ends, np.asarray(gradients))
    return np.sqrt(alone), np.sqrt(without)


def _variances(
    problem: Problem,
    about: Linearised,
    scales: np.ndarray,
    places: np.ndarray,
    ends: tuple[int, ...],
    gradients: np.ndarray,
) -> np.ndarray:
    """Return mean variances over noise scales (S, H), from each procedure alone and without it, (2, L, n).

    Parameters
    ----------
    places : entries in order of procedures.
    ends : of the procedures in this order.
    gradients : of the quantities, (n, P).
    """
    others = 1 - np.eye(len(ends))

    def at(h: np.ndarray) -> np.ndarray:
        # Entries of different runs share no noise: each part of the whitened Jacobian stands for itself.
        jacobian = whitened_jacobian(problem, about, h)[places]
        parts = [jacobian[first:end] for first, end in pairwise((0, *ends))]
        alone = np.stack([part.T @ part for part in parts])
        # Summed, not taken from the whole: the difference would lose the digits of a small part.
        both = np.stack([alone, np.tensordot(others, alone, 1)]) + np.diag(prior_widths(problem, h) ** -2)
        halves = [[solve_lower(cholesky(precision), gradients.T) for precision in each] for each in both]
        return np.sum(np.stack(halves) ** 2, axis=2)

    return np.mean([at(h) for h in scales], axis=0)


def _gradients_of_draws(z: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return slopes of quantities on z, (n, P), by regression over draws (D, P), and which they explain, (n,) bool."""
    centred, about = z - z.mean(axis=0), values - values.mean(axis=0)
    slopes, *_ = np.linalg.lstsq(centred, about)
    explained = 1 - np.var(about - centred @ slopes, axis=0) / np.maximum(np.var(about, axis=0), np.finfo(float).tiny)
    return slopes.T, explained > _LINEAR
