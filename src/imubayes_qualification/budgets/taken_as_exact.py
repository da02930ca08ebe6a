"""Properties of site and equipment that a model takes as exact, and their effect on every quantity.

The model lacks a parameter c of the equipment, such as the error of gravity: it takes it as zero.  It was not shown to
be zero.  Its plausible size s is the standard uncertainty that the campaign states of it, else that of the catalogue's
prior.  Information in the data on c bounds it further.  With J the whitened Jacobian of the model's own parameters in
z, k the whitened response to c, C = (JᵀJ + diag w⁻²)⁻¹ and g the gradient of a quantity q, all linear about the mode,

    Var(c) = (s⁻² + kᵀk − kᵀJ C Jᵀk)⁻¹,    ∂q/∂c = gᵀ C Jᵀk,

jointly for several such parameters: the change of the estimate that is due to c.  An estimate that is corrected for c
changes by as much the other way, which is the sensitivity coefficient of a budget.  The variance (∂q/∂c)² Var(c) is
what the estimate of q has beside its own.  It is *included* in every uncertainty of a report if the campaign itself
says that the parameter is not exact: by a stated uncertainty, that of a clock or meter included, and by normal gravity,
which nobody measured.  The others
are listed with what they would do, and no unit passes on a quantity that all of them together could put beyond its
limit.  Errors of thermometers, clock and meters, of which the campaign states no uncertainty, are among them
(`imubayes.responses.instrument_errors`).
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imubayes import Fit
from imubayes.foundations.numerics import inverse_of_precision
from imubayes.foundations.records import Record
from imubayes.inference.parameter_fit import whitened_columns
from imubayes.model.model_file import UncertainEquipment
from imubayes.model.problem import prior_widths
from imubayes.responses.candidate_effects import Response, candidate_responses
from imubayes.responses.instrument_errors import instrument_errors
from imubayes.responses.uncertain_equipment import stated_size, uncertain_equipment
from imubayes_qualification.budgets.budget_parts import Source, posterior_covariance
from imubayes_qualification.budgets.uncertainty_budget import SOURCES

LEAST_SHIFT = 0.015
"""Share of a standard uncertainty below which a shift is not kept: it would widen it by a hundredth of a per cent."""


OMITTED = 1.05
"""Ratio of uncertainties from which on U omits what matters: rounding may change it by less (EA-4/02, 6.3)."""


class QuantityShift(Record):
    """What one standard deviation of a parameter that is taken as exact does to a quantity, in its unit, with sign."""

    name: str
    value: float


class ExactInput(UncertainEquipment):
    """A parameter of site or equipment that the model takes as exact, whether or not the campaign says that it is not.

    Attributes
    ----------
    source : what it is about.
    left : standard deviation that the data leave of it, in its unit.
    included : whether it is in the uncertainties of the report.
    shifts : of the quantities that it matters to.
    """

    source: Source
    left: float
    included: bool
    shifts: tuple[QuantityShift, ...]

    def shift(self, name: str) -> float:
        """Return what one standard deviation does to a quantity, in its unit; 0 if that does not matter."""
        return next((each.value for each in self.shifts if each.name == name), 0.0)

    def sensitivity(self, name: str) -> float:
        """Return what an error of one unit does to a quantity, in its unit per `unit`; 0 if that does not matter."""
        return self.shift(name) / self.left


class JointShift(Record):
    """What independent standard normal causes do to one of several quantities, in its unit, with sign."""

    name: str
    values: tuple[float, ...]


@dataclass(frozen=True)
class ExactParameter:
    """A parameter that the model lacks: cause, name, unit, and its plausible size in that, stated or not."""

    effect: str
    name: str
    unit: str
    size: float
    stated: bool


class TakenAsExact(Record):
    """What a model takes as exact.

    Attributes
    ----------
    inputs : the parameters that matter to some quantity.
    unstated : of the quantities that it matters to, the standard deviation by all parameters together that are not
        included; two of the same response, of which the data determine the sum, do less together than each by itself.
    jointly : the same with its correlation, of the quantities that a value at another temperature is made of.
    """

    inputs: tuple[ExactInput, ...] = ()
    unstated: tuple[QuantityShift, ...] = ()
    jointly: tuple[JointShift, ...] = ()

    def omitted_ratio(self, name: str, own: float) -> float:
        """Return the factor on the uncertainty of a quantity, `own`, by what is included in none; 1 for nothing."""
        omitted = next((each.value for each in self.unstated if each.name == name), 0.0)
        return float(np.hypot(1.0, omitted / own)) if own > 0 else 1.0

    @property
    def included(self) -> tuple[ExactInput, ...]:
        """The parameters that are in the uncertainties of the report."""
        return tuple(each for each in self.inputs if each.included)


@dataclass(frozen=True)
class ExactEquipment:
    """The parameters of a fit's site and equipment that the model takes as exact, C of them, included ones first.

    Attributes
    ----------
    parameters : which, with sizes.
    included : shape (C,), bool.
    response : shape (P, C), shift of the model's parameters in z for a unit of each.
    told : shape (C, C), precision of the parameters from the data.
    covariance : shape (P, P), of the model's own parameters in z.
    """

    parameters: tuple[ExactParameter, ...]
    included: np.ndarray
    response: np.ndarray
    told: np.ndarray
    covariance: np.ndarray

    def found(self, gradients: Mapping[str, np.ndarray], jointly: Collection[str] = ()) -> TakenAsExact:
        """Return the parameters with what each does to quantities; those that matter to none are left out.

        An included parameter has what it does beside those before it, any other one what it does alone.

        Parameters
        ----------
        gradients : quantity → shape (R, P), its gradient, or those of the components that it is the length of.
        jointly : quantities with one gradient of which the correlation is kept.
        """
        if not self.parameters:
            return TakenAsExact()
        sizes = np.array([each.size for each in self.parameters])
        precision = self.told + np.diag(sizes**-2.0)
        inside, whole = self._factor(precision[np.ix_(self.included, self.included)]), self._factor(precision)
        factor = np.diag(np.diag(precision) ** -0.5)
        factor[np.ix_(self.included, self.included)] = inside
        columns = self.response @ factor
        own, shifts, unstated = {}, {}, []
        for name, rows in gradients.items():
            along = rows @ columns
            own[name] = float(np.sqrt(np.sum((rows @ self.covariance) * rows)))
            shifts[name] = along[0] if len(rows) == 1 else np.linalg.norm(along, axis=0)
            rest = np.sum((rows @ self.response @ whole) ** 2) - np.sum(shifts[name][self.included] ** 2)
            if rest > (LEAST_SHIFT * own[name]) ** 2:
                unstated.append(QuantityShift(name=name, value=float(np.sqrt(rest))))
        inputs = (self._input(k, float(np.linalg.norm(factor[k])), shifts, own) for k in range(len(sizes)))
        matters = {each.name for each in unstated}.intersection(jointly)
        chosen = {name: gradients[name][0] / own[name] for name in gradients if name in matters}
        together = self._jointly(np.reshape(list(chosen.values()), (len(chosen), len(self.response))), inside, whole)
        joint = (
            JointShift(name=name, values=tuple((own[name] * row).tolist()))
            for name, row in zip(chosen, together, strict=True)
        )
        return TakenAsExact(
            inputs=tuple(each for each in inputs if each.shifts), unstated=tuple(unstated), jointly=tuple(joint)
        )

    def _jointly(self, rows: np.ndarray, inside: np.ndarray, whole: np.ndarray) -> np.ndarray:
        """Return F, (Q, r), with F Fᵀ the covariance by what is not included, of Q quantities in units of their sd."""
        along = rows @ self.response
        covariance = along @ whole @ (along @ whole).T
        known = along[:, self.included] @ inside
        values, vectors = np.linalg.eigh(covariance - known @ known.T)
        kept = values > LEAST_SHIFT**2
        return vectors[:, kept] * np.sqrt(values[kept])

    @property
    def included_shifts(self) -> np.ndarray:
        """What one standard deviation of each included parameter, beside those before it, does to z, (K, P)."""
        precision = self.told + np.diag(np.array([each.size for each in self.parameters]) ** -2.0)
        inside = self._factor(precision[np.ix_(self.included, self.included)])
        return (self.response[:, self.included] @ inside).T

    @staticmethod
    def _factor(precision: np.ndarray) -> np.ndarray:
        """Return L with L Lᵀ the covariance."""
        return np.linalg.cholesky(inverse_of_precision(precision)) if len(precision) else precision

    def _input(self, place: int, left: float, shifts: Mapping[str, np.ndarray], own: Mapping[str, float]) -> ExactInput:
        each = self.parameters[place]
        return ExactInput(
            effect=each.effect,
            parameter=each.name,
            source=SOURCES[each.effect],
            unit=each.unit,
            size=each.size,
            left=left,
            stated=each.stated,
            included=bool(self.included[place]),
            shifts=tuple(
                QuantityShift(name=name, value=float(values[place]))
                for name, values in shifts.items()
                if abs(values[place]) > LEAST_SHIFT * own[name]
            ),
        )


def exact_equipment(fit: Fit, effects: Sequence[str] = tuple(SOURCES)) -> ExactEquipment:
    """Return what the model of a fit takes as exact, linearised about its mode.

    Parameters
    ----------
    effects : that are looked at.
    """
    problem, size = fit.model.problem, len(fit.z)
    responses = candidate_responses(fit, only=tuple(effects))
    listed = [each for response in _first_shapes(responses.candidates) for each in _parameters(fit, response)]
    listed += [
        (ExactParameter(each.effect, each.name, each.unit, each.size, each.stated), each.column)
        for each in instrument_errors(fit, effects)
    ]
    columns = [column for _, column in listed]
    joined = np.concatenate([responses.jacobian, np.reshape(columns, (len(columns), -1)).T], axis=1) if columns else (
        responses.jacobian
    )  # fmt: skip
    rows = whitened_columns(problem, fit.h, joined)
    own, others = rows[:, :size], rows[:, size:]
    widths = np.asarray(prior_widths(problem, np.asarray(fit.h)))
    # By orthogonal projection: some parameters are known to 1e-8 of their prior, and differences of squares are not.
    basis, upper = np.linalg.qr(np.concatenate([own, np.diag(1 / widths)]))
    whole = np.concatenate([others, np.zeros((size, others.shape[1]))])
    along = basis.T @ whole
    rest = whole - basis @ along
    covariance = posterior_covariance(own, widths) if size else np.zeros((0, 0))
    parameters = tuple(each for each, _ in listed)
    uncertain = {each.parameter for each in uncertain_equipment(fit)}
    included = np.array([each.name in uncertain for each in parameters], dtype=bool)
    return ExactEquipment(parameters, included, np.linalg.solve(upper, along), rest.T @ rest, covariance)


def included_shifts(fit: Fit) -> tuple[tuple[UncertainEquipment, np.ndarray], ...]:
    """Return what is in uncertainties although a model takes it as exact, each with what one sd does to z, (P,)."""
    listed = uncertain_equipment(fit)
    if not listed or not len(fit.z):
        return ()
    exact = exact_equipment(fit, tuple({each.effect for each in listed}))
    known = {each.parameter: each for each in listed}
    names = [each.name for each, ours in zip(exact.parameters, exact.included, strict=True) if ours]
    return tuple((known[name], shift) for name, shift in zip(names, exact.included_shifts, strict=True))


def with_included(
    draws: np.ndarray, shifts: Iterable[tuple[UncertainEquipment, np.ndarray]], told: np.ndarray | None = None
) -> tuple[np.ndarray, tuple[UncertainEquipment, ...]]:
    """Return draws (S, A) that contain what shifts them, each by its vector (A,) for one sd, and what of it matters.

    Parameters
    ----------
    told : shape (A,), bool, of the parameters that it may matter to; all if None.
    """
    own, matters = draws.std(axis=0), []
    for place, (each, shift) in enumerate(shifts):
        moved = np.abs(shift) > LEAST_SHIFT * own
        draws = draws + np.outer(standard_draws(place, len(draws)), shift)
        if np.any(moved if told is None else moved & told):
            matters.append(each)
    return draws, tuple(matters)


def standard_draws(place: int, count: int) -> np.ndarray:
    """Return draws with the mean 0 and the standard deviation 1, the same for the same input by its place; (count,)."""
    normal = np.random.default_rng([20260501, place]).standard_normal(count)
    return (normal - normal.mean()) / (normal.std() or 1.0)


def _first_shapes(candidates: Sequence[Response]) -> Iterator[Response]:
    """Yield one response for each effect."""
    seen: set[str] = set()
    for response in candidates:
        if response.scan.effect not in seen:
            seen.add(response.scan.effect)
            yield response


def _parameters(fit: Fit, response: Response) -> Iterator[tuple[ExactParameter, np.ndarray]]:
    """Yield the coefficients of an effect that may have either sign, each with the response of the entries (E,)."""
    for coefficient, column in zip(response.coefficients, response.columns.T, strict=True):
        stated = stated_size(fit.model, response.scan.effect, coefficient)
        own = coefficient.parameter
        size = own.prior_sd if stated is None else stated
        if not coefficient.even and 0 < size < np.inf:
            yield ExactParameter(response.scan.effect, own.name, own.shown_unit, size, stated is not None), column
