"""Two calibrations of one unit compared: whether they agree within their uncertainties, what moved, and both as one.

Both posteriors are Gaussian about their modes, in z, if every prior is N(0, W²).  What both have in common (the
unit, and equipment that stayed) has one true value and one prior, and so the errors are correlated: with the posterior
covariances C_A and C_B the error of an estimate has the part −C W⁻² (θ − prior mean), and

    Cov(A − B) = C_A + C_B − X − Xᵀ,    X = C_A W⁻² C_B over the columns of what is common.

Quantities known from the prior alone are not compared that way: its X is C_A + C_B.  Nor does an uncertainty of the
equipment count that both share; √(U_A² + U_B²), which takes the two as independent, contains it twice.  E_n is the
difference over its expanded uncertainty, k = 2 (ISO/IEC 17043).  Both as one have the precision Λ_A + Λ_B + W⁻², the
prior counted once.

By the drift between both a quantity may leave its limits: then the next calibration is due.  Two calibrations fix a
straight line and cannot test it: the interval is stated with that reservation, and for ten times the time between them
at most.  A drift of several calibrations is one of `batch drift`.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from imubayes.foundations.errors import input_error
from imubayes.foundations.numerics import inverse_of_precision
from imubayes.foundations.quantity_names import INPUT_AXIS, QuantityName, family_of
from imubayes.foundations.records import Presented, Record
from imubayes.foundations.tail_probabilities import chi2_survival, normal_survival
from imubayes.inference.fitted_model import Fit
from imubayes.inference.laplace_marginal import precision_of
from imubayes.inference.parameter_fit import linearise
from imubayes.loop.joined_runs import JoinedCampaign, joined_campaign
from imubayes.model.derived_quantities import derived_jacobian, evaluate_derived
from imubayes.model.problem import prior_widths
from imubayes.parameters.declarations import Parameter, prior_slopes
from imubayes.procedures.ambient import instant, starts_of
from imubayes.results.posterior_groups import in_units
from imubayes.results.prediction import LEAST_CHANCE

# Share of the information from the data below which a calibration has nothing to be compared.  Convention.
_LEAST_FROM_DATA = 0.1
# Correlations of differences below which an eigenvalue is rounding.
_ROUNDING = 1e-7
_DAYS = 86400.0
MOST_INTERVALS = 10.0
"""Of those between two calibrations, for which a drift is continued."""
_EXPANDED = 2.0  # coverage factor


class ComparedQuantity(Record):
    """A quantity by two calibrations, in its unit.

    Attributes
    ----------
    first, first_sd, second, second_sd : estimates with their standard uncertainties.
    difference, difference_sd : second less first, and its standard uncertainty.
    common : share of the sum of both variances that is common to both, and does not count in the difference.
    e_n : normalised error, k = 2.
    p : chance of so large a difference.
    moved : whether it is beyond chance, for all quantities that are compared together.
    pooled, pooled_sd : by both calibrations as one; None if they may not be pooled.
    """

    name: str
    unit: str
    first: float
    first_sd: float
    second: float
    second_sd: float
    difference: float
    difference_sd: float
    common: float
    e_n: float
    p: float
    moved: bool
    pooled: float | None = None
    pooled_sd: float | None = None


class NextDue(Record):
    """Drift of a quantity with limits, in its unit.

    Attributes
    ----------
    rate, rate_sd : drift per year, and its standard uncertainty.
    lower, upper : limits; None if there is none.
    days : after the second calibration, until the value with its expanded uncertainty (k = 2) reaches a limit; None
        if it does not within ten times the days between both.
    """

    name: str
    unit: str
    rate: float
    rate_sd: float
    lower: float | None
    upper: float | None
    days: float | None


class Repeatability(Presented, Record):
    """Two calibrations compared, as `imubayes compare A B --json` prints it (format 1).

    Attributes
    ----------
    serial, campaigns, models, dates : of the unit, and of both calibrations; the first run, None if not stated.
    days : from the first run of one to that of the other.
    verdict : whether the two agree.
    chi2, freedom, p : of the differences of the parameters that both determine, together.
    quantities : quantities that both determine, largest |E_n| first.
    not_determined : quantities that at least one of the two did not determine.
    other_priors : quantities with different priors in the two; they are compared as if nothing were common to them.
    pooled : whether both may be taken as one: they agree, and have the same priors.
    changed, elsewhere : equipment and site that differ between the two.
    due : if limits were stated, the date at which each quantity may reach them; soonest first.

    Examples
    --------
    >>> import imubayes
    >>> found = imubayes.repeatability("results/accel-channel", "results/later")
    >>> found.freedom, found.pooled
    (5, True)
    """

    format: Literal[1] = 1
    serial: str
    campaigns: tuple[str, str]
    models: tuple[str, str]
    dates: tuple[str | None, str | None]
    days: float | None
    verdict: Literal["agree", "differ"]
    chi2: float
    freedom: int
    p: float
    quantities: tuple[ComparedQuantity, ...]
    not_determined: tuple[str, ...]
    other_priors: tuple[str, ...]
    pooled: bool
    changed: tuple[str, ...]
    elsewhere: bool
    due: tuple[NextDue, ...] = ()

    @property
    def agree(self) -> bool:
        """Whether the two agree."""
        return self.verdict == "agree"


@dataclass(frozen=True)
class _Normal:
    """A posterior about its mode in z: precision (P, P), covariance and widths of the priors; quantities by name."""

    z: np.ndarray
    names: tuple[str, ...]
    precision: np.ndarray
    covariance: np.ndarray
    widths: np.ndarray
    priors: Mapping[str, Parameter]
    quantities: Mapping[str, "_Quantity"]

    def places(self, names: Sequence[str]) -> np.ndarray:
        where = {name: place for place, name in enumerate(self.names)}
        return np.array([where[name] for name in names], dtype=int)


@dataclass(frozen=True)
class _Quantity:
    """A quantity at the mode: value, unit, gradient by z (P,), and whether it is a parameter."""

    value: float
    unit: str
    gradient: np.ndarray
    is_parameter: bool


def _normal(fit: Fit, scales: np.ndarray) -> _Normal:
    model, problem = fit.model, fit.model.problem
    h, layout = np.asarray(scales), model.layout
    widths = np.asarray(prior_widths(problem, h))
    told = precision_of(problem, linearise(problem, np.asarray(fit.z)), h)
    precision = told + np.diag(widths**-2)
    values = in_units(model, np.concatenate([fit.z, fit.h])[None])[0]
    slopes = np.asarray(prior_slopes(problem.priors, np.asarray(fit.z))) / layout.factors()
    found: dict[str, _Quantity] = {}
    for place, parameter in enumerate(layout.parameters):
        if not parameter.nuisance:
            gradient = slopes[place] * np.eye(len(layout))[place]
            found[parameter.name] = _Quantity(float(values[place]), parameter.shown_unit, gradient, True)
    if fit.derived.names:
        derived = evaluate_derived(fit.derived.derivation, problem, fit.z[None])[0]
        gradients = derived_jacobian(fit.derived.derivation, problem, fit.z)
        for name, value, gradient in zip(fit.derived.names, derived.tolist(), gradients, strict=True):
            if family_of(name.name) != INPUT_AXIS:
                found[name.name] = _Quantity(value, name.unit, gradient, False)
    own = {parameter.name: parameter for parameter in layout.parameters}
    return _Normal(fit.z, layout.names, precision, inverse_of_precision(precision), widths, own, found)


def repeatability_of(
    first: Fit,
    second: Fit,
    scales: tuple[np.ndarray, np.ndarray],
    changed: Sequence[str] = (),
    any_unit: bool = False,
    tell: Callable[[str], None] = lambda text: None,
) -> Repeatability:
    """Return how two calibrations of one unit compare; see `imubayes.repeatability`.

    Parameters
    ----------
    scales : noise scales of each, (H,) in z, by which uncertainties are computed; see `root_mean_square_scales`.

    Raises
    ------
    InputError
        as of `joined_campaign`, and for fits of the same runs or that did not converge.
    """
    campaigns = first.model.campaign, second.model.campaign
    together = joined_campaign(*campaigns, changed, any_unit)
    _refuse_unfit(first, second, together)
    tell("comparing")
    one, other = _normal(first, scales[0]), _normal(second, scales[1])
    lasting = together.lasting(first.model) & together.lasting(second.model)
    alike, unlike = _by_prior(one, other, lasting)
    cross = _cross(one, other, alike)
    determined, left = _by_data(one, other, lasting, together)
    lines = [_compared(name, one, other, cross, len(determined)) for name in determined]
    chi2, freedom = _together([name for name in determined if one.quantities[name].is_parameter], one, other, cross)
    p = float(chi2_survival(chi2, freedom)) if freedom else 1.0
    agree = 2 * min([p, *(len(lines) * line.p for line in lines)]) >= LEAST_CHANCE
    may_pool = agree and not unlike and bool(lines)
    begun = [next(iter(starts_of(campaign.runs)), None) for campaign in campaigns]
    dates = begun[0], begun[1]
    return Repeatability(
        serial=campaigns[1].serial,
        campaigns=(campaigns[0].name, campaigns[1].name),
        models=(first.model.spec.name, second.model.spec.name),
        dates=dates,
        days=_days(*dates),
        verdict="agree" if agree else "differ",
        chi2=chi2,
        freedom=freedom,
        p=p,
        quantities=_worst_first(list(_pooled(lines, one, other, alike)) if may_pool else lines),
        not_determined=left,
        other_priors=unlike,
        pooled=may_pool,
        changed=together.changed,
        elsewhere=together.elsewhere,
    )


def _by_prior(one: _Normal, other: _Normal, lasting: set[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return what both have with the same prior, and with another one."""
    shared = [name for name in one.names if name in lasting]
    alike = {name for name in shared if _same_prior(one.priors[name], other.priors[name])}
    return tuple(name for name in shared if name in alike), tuple(name for name in shared if name not in alike)


def _by_data(
    one: _Normal, other: _Normal, lasting: set[str], together: JoinedCampaign
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the quantities of what lasts that both determine, and those that one of them leaves to its prior."""
    names = [name for name in one.quantities if name in other.quantities and _is_lasting(name, one, lasting, together)]
    known = {name for name in names if min(_from_data(one, name), _from_data(other, name)) >= _LEAST_FROM_DATA}
    return tuple(name for name in names if name in known), tuple(name for name in names if name not in known)


def _worst_first(lines: Sequence[ComparedQuantity]) -> tuple[ComparedQuantity, ...]:
    return tuple(sorted(lines, key=lambda line: -abs(line.e_n)))


def _refuse_unfit(first: Fit, second: Fit, together: JoinedCampaign) -> None:
    for fit in (first, second):
        if not fit.converged:
            raise input_error("the fit did not converge", fit.model.campaign.name, "two fits that did", fit.message)
    if together.fitted:
        raise input_error(
            f"both calibrations have the run{'s' if len(together.fitted) > 1 else ''} {', '.join(together.fitted)}",
            " and ".join(fit.model.campaign.folder or fit.model.campaign.name for fit in (first, second)),
            "two calibrations from different runs: shared runs make them agree",
            "fit the runs separately; to compare models of the same runs, use `imubayes history`",
        )


def _days(first: str | None, second: str | None) -> float | None:
    return None if first is None or second is None else (instant(second) - instant(first)).total_seconds() / _DAYS


def _is_lasting(name: str, one: _Normal, lasting: set[str], together: JoinedCampaign) -> bool:
    """Return whether a quantity is of the same thing in both: a parameter, or what is derived for what stayed."""
    if one.quantities[name].is_parameter:
        return name in lasting
    label = QuantityName.of(name).labels
    runs = {run.name for run in together.campaign.runs}
    return not any(part in together.changed or part in runs for part in label)


def _same_prior(one: Parameter, other: Parameter) -> bool:
    return np.allclose(
        [one.value_at(z) for z in (-1.0, 0.0, 1.0)], [other.value_at(z) for z in (-1.0, 0.0, 1.0)], rtol=1e-9, atol=0
    )


def _cross(one: _Normal, other: _Normal, alike: Sequence[str]) -> np.ndarray:
    """Return the covariance X (P_A, P_B) of the errors of two posteriors, by the priors that they have in common."""
    a, b = one.places(alike), other.places(alike)
    return (one.covariance[:, a] / (one.widths[a] * other.widths[b])) @ other.covariance[b]


def _from_data(of: _Normal, name: str) -> float:
    gradient = of.quantities[name].gradient
    prior = float(np.sum((gradient * of.widths) ** 2))
    return 1 - float(gradient @ of.covariance @ gradient) / prior if prior > 0 else 0.0


def _difference(
    names: Sequence[str], one: _Normal, other: _Normal, cross: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return second less first, (Q,), and the covariances (Q, Q) of first, second and cross."""
    first, second = (np.array([each.quantities[name].gradient for name in names]) for each in (one, other))
    apart = [other.quantities[name].value - one.quantities[name].value for name in names]
    return (
        np.array(apart), first @ one.covariance @ first.T, second @ other.covariance @ second.T,
        first @ cross @ second.T,
    )  # fmt: skip


def _compared(name: str, one: _Normal, other: _Normal, cross: np.ndarray, count: int) -> ComparedQuantity:
    apart, first, second, common = (float(each.item()) for each in _difference([name], one, other, cross))
    sd = float(np.sqrt(max(first + second - 2 * common, 0.0)))
    z = abs(apart) / sd if sd > 0 else 0.0
    p = 2 * float(normal_survival(z))
    return ComparedQuantity(
        name=name,
        unit=one.quantities[name].unit,
        first=one.quantities[name].value,
        first_sd=first**0.5,
        second=other.quantities[name].value,
        second_sd=second**0.5,
        difference=apart,
        difference_sd=sd,
        common=2 * common / (first + second),
        e_n=apart / (_EXPANDED * sd) if sd > 0 else 0.0,
        p=p,
        moved=count * p < LEAST_CHANCE,
    )


def _together(names: Sequence[str], one: _Normal, other: _Normal, cross: np.ndarray) -> tuple[float, int]:
    """Return χ² of the differences of some parameters, and its degrees of freedom: directions beyond rounding."""
    if not names:
        return 0.0, 0
    apart, first, second, common = _difference(names, one, other, cross)
    covariance = first + second - common - common.T
    scale = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    sizes, axes = np.linalg.eigh(covariance / np.outer(scale, scale))
    known = sizes > _ROUNDING
    return float(np.sum((axes.T @ (apart / scale))[known] ** 2 / sizes[known])), int(known.sum())


def _pooled(
    lines: Sequence[ComparedQuantity], one: _Normal, other: _Normal, alike: Sequence[str]
) -> Iterator[ComparedQuantity]:
    """Yield the quantities with their values by both as one: the sum of what the data of each say, and one prior."""
    a, count = np.arange(len(one.names)), len(one.names)
    of_first = dict(zip(alike, one.places(alike).tolist(), strict=True))
    own = iter(range(count, count + len(other.names)))
    b = np.array([of_first[name] if name in of_first else next(own) for name in other.names])
    total = count + len(other.names) - len(alike)
    precision, told = np.zeros((total, total)), np.zeros(total)
    for places, each in ((a, one), (b, other)):
        precision[np.ix_(places, places)] += each.precision
        told[places] += each.precision @ each.z
    common = one.places(alike)
    precision[common, common] -= 1 / (one.widths[common] * other.widths[other.places(alike)])
    covariance = inverse_of_precision(precision)
    moved = covariance @ told - np.concatenate([one.z, np.zeros(total - count)])
    for line in lines:
        gradient = one.quantities[line.name].gradient
        value = line.first + float(gradient @ moved[:count])
        sd = float(np.sqrt(gradient @ covariance[:count, :count] @ gradient))
        yield line.model_copy(update={"pooled": value, "pooled_sd": sd})
