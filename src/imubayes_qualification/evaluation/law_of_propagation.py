"""The equation of a measurement of the user's own, and its uncertainty budget by the law of propagation of uncertainty.

Of first order it has the sensitivities ∂f/∂xᵢ (GUM 5.1.2, and 5.2.2 for correlated inputs); of second order the terms

    Σᵢⱼ (½ fᵢⱼ² + fᵢ fᵢⱼⱼ),    y₂ = f(x) + ½ Σᵢ fᵢᵢ,

of normal inputs, with derivatives along independent scores zᵢ: x + L z, L Lᵀ the covariance, where zᵢ = xᵢ/u(xᵢ) for
independent inputs (GUM 5.1.2, note).  They are withheld if they would take half the variance or more.  Effective
degrees of freedom are those of Welch–Satterthwaite (G.4.1) with the whole variance: inputs that are correlated have
infinitely many.  Derivatives are central differences over a part of each standard uncertainty, of fourth order.
"""

import inspect
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from imubayes.foundations.errors import InputError, Issue, input_error, refuse
from imubayes.foundations.records import Presented
from imubayes_qualification.evaluation.coverage import effective_degrees
from imubayes_qualification.evaluation.input_quantities import DistributionName, EvaluationType, InputQuantity

Equation = Callable[..., object]
Correlations = Mapping[tuple[str, str], float]
# Step of the differences in standard uncertainties, at which errors of rounding and of the order are both below 1e-8.
_STEP = 0.1

# Every element is an equation of its own: what goes over all of them is a statistic of the draws.
_ELEMENTWISE = "operations element by element: (a + b)/2 for np.mean([a, b]), np.hypot for norm, np.full_like for 0.1"


@dataclass(frozen=True)
class GumLine:
    """What one input contributes to the standard uncertainty of an output.

    Attributes
    ----------
    input, value, uncertainty, distribution, type, degrees_of_freedom : of the input.
    sensitivity : ∂f/∂x at the estimates.
    contribution : |∂f/∂x| u(x).
    share : of the variance of first order; of correlated inputs the sum of shares is not 1.
    """

    input: str
    value: float
    uncertainty: float
    distribution: DistributionName
    type: EvaluationType
    degrees_of_freedom: float
    sensitivity: float
    contribution: float
    share: float


@dataclass(frozen=True, repr=False)
class GumBudget(Presented):
    """An output by the law of propagation of uncertainty.

    Attributes
    ----------
    name : of the output.
    value, uncertainty : estimate f(x), and standard uncertainty of first order, correlations included.
    second_order_value, second_order_uncertainty : with the terms of second order; None if they are no
        correction, because their series does not converge.
    degrees_of_freedom : ν_eff.
    probability, coverage_factor, expanded_uncertainty : p, k from ν_eff, and U = k u of first order.
    lines : contributions, in the order of the inputs.

    Examples
    --------
    >>> import imubayes
    >>> inputs = [imubayes.InputQuantity.normal(name, 1.0, 0.01) for name in ("a", "b")]
    >>> (found,) = imubayes.budget(lambda a, b: a + b, inputs)
    >>> len(found.lines), round(found.expanded_uncertainty, 4)
    (2, 0.0277)
    """

    name: str
    value: float
    uncertainty: float
    second_order_value: float | None
    second_order_uncertainty: float | None
    degrees_of_freedom: float
    probability: float
    coverage_factor: float
    expanded_uncertainty: float
    lines: tuple[GumLine, ...]


def budget(
    function: Equation,
    inputs: Sequence[InputQuantity],
    *,
    names: Sequence[str] = ("y",),
    correlation: Correlations | None = None,
    probability: float = 0.95,
) -> tuple[GumBudget, ...]:
    """Return the uncertainty budget of each output of an equation, by the law of propagation alone.

    Parameters
    ----------
    function, inputs, names, correlation, probability : as of `propagate`.

    Raises
    ------
    InputError
        as `propagate` does.

    Examples
    --------
    >>> import imubayes
    >>> mass, density = imubayes.InputQuantity.normal("m", 0.1, 2e-5), imubayes.InputQuantity.between("rho", 7900, 8100)
    >>> (volume,) = imubayes.budget(lambda m, rho: m / rho, [mass, density])
    >>> f"{volume.value:.4g} ± {volume.uncertainty:.2g}"
    '1.25e-05 ± 9e-08'
    """
    return tuple(budgets_of_outputs(bound_equation(function, inputs, names, correlation, probability), probability))


def bound_equation(
    function: Equation,
    inputs: Sequence[InputQuantity],
    names: Sequence[str],
    correlation: Correlations | None,
    probability: float,
) -> "BoundEquation":
    """Return an equation with its inputs; parameters and errors as of `propagate`."""
    equation = BoundEquation(function, tuple(inputs), tuple(names), _correlation_matrix(inputs, correlation or {}))
    _check(equation, probability)
    _check_elements(equation)
    return equation


@dataclass(frozen=True)
class BoundEquation:
    """An equation with its inputs, names of outputs, and correlation of the inputs, (N, N)."""

    function: Equation
    inputs: tuple[InputQuantity, ...]
    names: tuple[str, ...]
    correlation: np.ndarray

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Return the outputs (n, K) for values of the inputs (n, N)."""
        count, taken = len(values), {each.name: values[:, k] for k, each in enumerate(self.inputs)}
        try:
            found = self.function(**taken)
        except (TypeError, ValueError) as error:
            raise _wrong(f"does not take arrays: {error}", f"{_ELEMENTWISE}; np.where instead of if") from error
        outputs = found if isinstance(found, list | tuple) else (found,)
        if len(outputs) != len(self.names):
            raise _wrong(f"returns {len(outputs)} outputs", f"{len(self.names)}: {', '.join(self.names)}")
        columns = []
        for one in outputs:
            column = np.asarray(one)
            if column.dtype.kind not in "biuf":
                raise _wrong(f"returns no real numbers but {column.dtype}", f"({count},) real numbers for each output")
            if column.shape != (count,):
                shape = " × ".join(map(str, column.shape)) or "one number"
                raise _wrong(
                    f"returns {shape} for {count} values of each input", f"({count},) for each; {_ELEMENTWISE}"
                )
            columns.append(column.astype(float))
        return np.stack(columns, axis=1)

    def sampled(self, count: int, random: np.random.Generator) -> np.ndarray:
        """Return draws of the outputs, (count, K)."""
        scores = random.standard_normal((count, len(self.inputs)))
        if not np.array_equal(self.correlation, np.eye(len(self.inputs))):
            values, vectors = np.linalg.eigh(self.correlation)
            scores = scores @ (vectors * np.sqrt(np.clip(values, 0, None))).T
        chosen: dict[int, np.ndarray] = {}
        columns = []
        for k, each in enumerate(self.inputs):
            if each.draws is None:
                columns.append(each.sampled(scores[:, k], random))
                continue
            size = len(each.draws)
            chosen.setdefault(size, random.integers(size, size=count))
            columns.append(each.draws[chosen[size]])
        found = self(np.stack(columns, axis=1))
        if not np.isfinite(found).all():
            raise _wrong(
                "is not finite for some values of its inputs", "a number for every possible value of the inputs"
            )
        return found


def _wrong(what: str, allowed: str) -> InputError:
    return input_error(f"the equation {what}", "function", allowed, "correct the function")


def _correlation_matrix(inputs: Sequence[InputQuantity], correlation: Correlations) -> np.ndarray:
    """Return the correlation of the scores of the inputs, shape (N, N)."""
    places = {each.name: k for k, each in enumerate(inputs)}
    found, issues = np.eye(len(inputs)), []
    for (first, second), value in correlation.items():
        where = f"correlation ('{first}', '{second}')"
        if not {first, second} <= places.keys() or first == second:
            issues.append(Issue("it is not of two inputs", where, ", ".join(places), "name two inputs"))
        elif correlation.get((second, first), value) != value:
            issues.append(Issue("it is given twice with other values", where, "one value", "leave one out"))
        elif not -1 <= value <= 1:
            issues.append(Issue(f"it is {value:g}", where, "-1 … 1", "correct it"))
        elif any(inputs[places[name]].distribution != "normal" for name in (first, second)):
            issues.append(
                Issue(
                    "one of the two is not normal", where, "two normal inputs of infinite degrees of freedom",
                    "give the joint draws of both with InputQuantity.from_draws",
                )
            )  # fmt: skip
        else:
            found[places[first], places[second]] = found[places[second], places[first]] = value
    if not issues and len(found) and np.linalg.eigvalsh(found).min() < -1e-12:
        issues.append(
            Issue("no quantities can have these correlations", "correlation", "a positive matrix", "correct it")
        )
    refuse(issues)
    return found


def _check(equation: BoundEquation, probability: float) -> None:
    names = [each.name for each in equation.inputs]
    if not 0 < probability < 1:
        raise input_error(f"the probability {probability:g}", "probability", "between 0 and 1", "correct it")
    for where, of, given in (("inputs", "inputs", names), ("names", "outputs", equation.names)):
        repeated = sorted({name for name in given if given.count(name) > 1})
        if repeated or not given:
            what = f"the name '{repeated[0]}' is repeated" if repeated else f"there are no {of}"
            raise input_error(what, where, "one or more, each with its own name", "correct them")
    try:
        inspect.signature(equation.function).bind(**dict.fromkeys(names))
    except TypeError as error:
        raise _wrong(f"does not take the inputs {', '.join(names)}: {error}", "a parameter for each input") from error
    except ValueError:  # a function of C, which has no signature
        pass


def _check_elements(equation: BoundEquation) -> None:
    """Raise InputError if an output depends on the other values that are evaluated with it."""
    x, u = (np.array([getattr(each, part) for each in equation.inputs]) for part in ("value", "uncertainty"))
    points = x + np.outer([0.0, _STEP, -2 * _STEP, 3 * _STEP], u)
    with np.errstate(all="ignore"):
        together, alone = equation(points), np.concatenate([equation(point[None]) for point in points])
        known = np.isfinite(together) & np.isfinite(alone)
        together, alone = np.where(known, together, 0.0), np.where(known, alone, 0.0)
        # A sum in another order, or an iteration that ends elsewhere, is the same value.
        allowed = 1e-9 * np.abs(alone).max(axis=0) + 1e-6 * np.ptp(alone, axis=0)
    if (np.abs(together - alone) > allowed).any():
        raise _wrong("gives another output for a value when it is evaluated with others", _ELEMENTWISE)


def budgets_of_outputs(equation: BoundEquation, probability: float) -> Iterator[GumBudget]:
    """Yield the budget of each output."""
    inputs = equation.inputs
    x, u = (np.array([getattr(each, part) for each in inputs]) for part in ("value", "uncertainty"))
    covariance = _covariance(equation, u)
    degrees = np.array([each.degrees_of_freedom for each in inputs])
    values, jacobian = equation(x[None])[0], _sensitivities(equation, x, u)
    if not (np.isfinite(values).all() and np.isfinite(jacobian).all()):
        allowed = "an equation with a value and a slope there"
        raise _wrong("or its slope is not finite at the estimates of its inputs", allowed)
    second = _second_order(equation, x, _directions(covariance), jacobian)
    for k, name in enumerate(equation.names):
        c = jacobian[:, k]
        first = max(float(c @ covariance @ c), 0.0)
        curved, beyond = (float(part[k]) for part in second)
        # Terms that take most of the variance, or are not finite, are followed by others that matter as much.
        converges = math.isfinite(curved) and first + beyond >= first / 2
        nu = effective_degrees((c * u) ** 2, degrees, first)
        factor = _coverage_factor(nu, probability)
        uncertainty = math.sqrt(first)
        lines = tuple(
            GumLine(
                each.name, each.value, each.uncertainty, each.distribution, each.type, each.degrees_of_freedom,
                float(slope), float(abs(slope) * each.uncertainty),
                float((slope * each.uncertainty) ** 2 / first) if first > 0 else 0.0,
            )
            for each, slope in zip(inputs, c, strict=True)
        )  # fmt: skip
        yield GumBudget(
            name, float(values[k]), uncertainty, float(values[k]) + curved if converges else None,
            math.sqrt(first + beyond) if converges else None, nu, probability, factor, factor * uncertainty, lines,
        )  # fmt: skip


def _covariance(equation: BoundEquation, u: np.ndarray) -> np.ndarray:
    """Return the covariance of the inputs, (N, N), that of paired draws included."""
    found = equation.correlation * np.outer(u, u)
    for j, one in enumerate(equation.inputs):
        for k, other in enumerate(equation.inputs[:j]):
            if one.draws is not None and other.draws is not None and len(one.draws) == len(other.draws):
                found[j, k] = found[k, j] = float(np.cov(one.draws, other.draws, ddof=0)[0, 1])
    return found


def _coverage_factor(nu: float, probability: float) -> float:
    """Return k of the next lower whole number of degrees of freedom (GUM G.4.1, note)."""
    one_sided = (1 + probability) / 2
    if math.isinf(nu):
        return float(special.ndtri(one_sided))
    return float(special.stdtrit(max(math.floor(nu + 1e-9), 1.0), one_sided))


def _directions(covariance: np.ndarray) -> np.ndarray:
    """Return what a unit of each of M independent scores changes in the inputs, (M, N): Lᵀ with L Lᵀ = covariance."""
    u = np.sqrt(np.diag(covariance))
    if np.array_equal(covariance, np.diag(u**2)):
        return np.diag(u)[u > 0]
    scale = np.where(u > 0, u, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    kept = values > 1e-12 * values.max()
    return (vectors[:, kept] * np.sqrt(values[kept])).T * u


def _steps(about: np.ndarray, changes: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the steps of the differences in units of the changes (M, N), shape (M,).

    They are wider if rounding of the inputs, as the weights (N,) take it into the output, would be seen in them: in
    third derivatives below 1e-5, in slopes below 1e-3.
    """
    rounding = np.max(np.where(changes != 0, np.finfo(float).eps * np.abs(about * weights), 0.0), axis=1)
    moved = np.linalg.norm(changes * weights, axis=1)
    ratio = np.divide(rounding, moved, out=np.zeros_like(moved), where=moved > 0)
    return np.maximum(_STEP, np.maximum(np.cbrt(1e6 * ratio), 1e3 * ratio))


_STENCIL = np.array([[1, -8, 8, -1], [-2, -1, 1, 2]])


def _slope(equation: BoundEquation, about: np.ndarray, change: np.ndarray, step: float) -> np.ndarray:
    """Return the derivative along a change (N,) of the inputs at points (n, N), shape (n, K)."""
    points = about[:, None] + _STENCIL[1][None, :, None] * (step * change)
    values = equation(points.reshape(-1, about.shape[1])).reshape(len(about), 4, -1)
    return np.einsum("s,nsk->nk", _STENCIL[0] / (12 * step), values)


def _sensitivities(equation: BoundEquation, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return ∂f/∂xᵢ at x, shape (N, K); 0 for inputs without uncertainty."""
    found, changes = np.zeros((len(x), len(equation.names))), np.diag(u)
    for i, step in enumerate(_steps(x, changes, np.ones(len(x)))):
        if u[i] > 0:
            found[i] = _slope(equation, x[None], changes[i], float(step))[0] / u[i]
    return found


def _second_order(
    equation: BoundEquation, x: np.ndarray, changes: np.ndarray, jacobian: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return what the second order adds to value and variance, each (K,), by derivatives along independent scores."""
    size, count = len(changes), len(equation.names)
    slopes, second, third = np.zeros((size, count)), *np.zeros((2, size, size, count))
    steps = _steps(x, changes, np.abs(jacobian).max(axis=1))
    for i, step in enumerate(steps):
        slopes[i] = _slope(equation, x[None], changes[i], step)[0]
        for j, other in enumerate(steps):
            near = _slope(equation, x + np.outer([-2, -1, 0, 1, 2], other * changes[j]), changes[i], step)
            second[i, j] = np.array([1, -8, 0, 8, -1]) @ near / (12 * other)
            third[i, j] = np.array([-1, 16, -30, 16, -1]) @ near / (12 * other**2)
    return (
        0.5 * np.einsum("iik->k", second),
        0.5 * np.einsum("ijk,ijk->k", second, second) + np.einsum("ik,ijk->k", slopes, third),
    )
