"""Propagation of uncertainty through an equation of the user's own, by Monte Carlo and by the GUM's formulas.

The Monte Carlo method of JCGM 101 draws blocks of M = max(10⁴, 100/(1 − p)) values of the inputs and applies the
equation, until twice the standard deviation of the averages over the blocks of estimate, standard uncertainty and both
ends of the interval is below the numerical tolerance of the digits asked for (7.9.4).  The same is asked of the draws
that inputs are given by, of which there are no more.  Several outputs are drawn
together (JCGM 102, 7); their covariance is that of the draws, and a region of probability p is the ellipsoid of the
factor k_p about the mean, or the box of the half-widths k_q u (7.7).

Beside it stands the law of propagation (`evaluation.law_of_propagation`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from imubayes.foundations.errors import Issue, closest_first, input_error, refuse
from imubayes.foundations.records import Presented
from imubayes.results.marginal import Digits, numerical_tolerance
from imubayes_qualification.evaluation import law_of_propagation as law
from imubayes_qualification.evaluation.coverage import shortest_interval
from imubayes_qualification.evaluation.input_quantities import InputQuantity

Interval = tuple[float, float]
_BLOCK, _FEWEST_BLOCKS, _FEWEST_DRAWS = 10_000, 10, 1000


@dataclass(frozen=True)
class OutputQuantity:
    """An output by the Monte Carlo method, with its budget beside it.

    Attributes
    ----------
    name : of the output.
    value, uncertainty : mean and standard deviation of the draws.
    interval, shortest : coverage intervals of the probability: of equal tails, and the shortest.
    tolerance : numerical tolerance δ of the digits asked for.
    gum : by the law of propagation.
    gum_agrees : whether both ends of its interval y ± U agree with those of the draws within δ (JCGM 101, 8).
    """

    name: str
    value: float
    uncertainty: float
    interval: Interval
    shortest: Interval
    tolerance: float
    gum: law.GumBudget
    gum_agrees: bool


@dataclass(frozen=True, repr=False)
class Propagated(Presented):
    """Result of `propagate`.

    Attributes
    ----------
    outputs : of the equation, in its order.
    draws : shape (S, K), of the K outputs.
    probability : of the coverage intervals.
    stable : whether the number of draws suffices for the digits; False if the largest number was reached, or if an
        input is given by too few draws.
    effective : number of draws, or of those of the input that is given by the fewest.

    Examples
    --------
    >>> import imubayes
    >>> angle = imubayes.InputQuantity.between("angle", 0.0, 0.1)
    >>> found = imubayes.propagate(lambda angle: angle**2, [angle], digits=1)
    >>> found.draws.shape[1], [output.name for output in found.outputs]
    (1, ['y'])
    """

    outputs: tuple[OutputQuantity, ...]
    draws: np.ndarray
    probability: float
    stable: bool
    effective: int

    def __getitem__(self, name: str) -> OutputQuantity:
        """Return an output by name; raises InputError if there is none of it."""
        found = next((each for each in self.outputs if each.name == name), None)
        if found is None:
            allowed = closest_first(name, [each.name for each in self.outputs])
            raise input_error(f"there is no output '{name}'", "output", allowed, "name one of them")
        return found

    @property
    def value(self) -> float:
        """Estimate of the first output."""
        return self.outputs[0].value

    @property
    def uncertainty(self) -> float:
        """Standard uncertainty of the first output."""
        return self.outputs[0].uncertainty

    @property
    def interval(self) -> Interval:
        """Coverage interval of the first output, of equal tails."""
        return self.outputs[0].interval

    @property
    def shortest(self) -> Interval:
        """Shortest coverage interval of the first output."""
        return self.outputs[0].shortest

    @property
    def gum(self) -> law.GumBudget:
        """The first output by the law of propagation."""
        return self.outputs[0].gum

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance of the outputs, shape (K, K)."""
        return np.atleast_2d(np.cov(self.draws, rowvar=False))

    @cached_property
    def correlation(self) -> np.ndarray:
        """Correlation of the outputs, shape (K, K)."""
        return np.atleast_2d(np.corrcoef(self.draws, rowvar=False))

    @cached_property
    def ellipsoid_factor(self) -> float:
        """k_p: the ellipsoid (y − ȳ)ᵀ V⁻¹ (y − ȳ) ≤ k_p² holds the probability (JCGM 102, 7.7.2)."""
        about = self._scaled
        # Outputs that hang together lie in a space of fewer dimensions.
        inverse = np.linalg.pinv(about.T @ about / (len(about) - 1), rcond=1e-12, hermitian=True)
        lengths = np.sum(about @ inverse * about, axis=1)
        return float(np.sqrt(np.quantile(lengths, self.probability)))

    @cached_property
    def box_factor(self) -> float:
        """k_q: the box ȳ ± k_q u holds the probability (JCGM 102, 7.7.3)."""
        return float(np.quantile(np.abs(self._scaled).max(axis=1), self.probability))

    @cached_property
    def _scaled(self) -> np.ndarray:
        """Draws about their mean in standard uncertainties, (S, K); 0 for an output that does not vary."""
        u = _deviation(self.draws)
        return np.where(u > 0, (self.draws - self.draws.mean(axis=0)) / np.where(u > 0, u, 1.0), 0.0)


def propagate(
    function: law.Equation,
    inputs: Sequence[InputQuantity],
    *,
    names: Sequence[str] = ("y",),
    correlation: law.Correlations | None = None,
    probability: float = 0.95,
    digits: Digits = 2,
    most_draws: int = 4_000_000,
    seed: int = 0,
) -> Propagated:
    """Return the outputs of an equation from its input quantities, by Monte Carlo and by the law of propagation.

    Parameters
    ----------
    function : the equation: takes the inputs by name, as arrays of one shape, and returns an array of that shape, or a
        sequence of such arrays, one for each output, computed element by element.
    inputs : independent, but for `correlation` and for inputs of as many draws as each other.
    names : of the outputs.
    correlation : pair of names → correlation of two normal inputs.
    probability : of the coverage intervals.
    digits : significant digits of the standard uncertainty that are to be stable, 1 or 2.
    most_draws : after which it ends at the latest, 1000 or more.
    seed : of the draws.

    Raises
    ------
    InputError
        for inputs that the equation does not take, repeated names, invalid correlations, and an equation that returns
        something else; and for an input of two degrees of freedom or fewer, whose distribution has no standard
        deviation (JCGM 101, 6.4.9.4): `budget` takes it.

    Examples
    --------
    >>> import imubayes
    >>> inputs = [imubayes.InputQuantity.normal("m", 0.1, 2e-5), imubayes.InputQuantity.between("rho", 7900, 8100)]
    >>> volume = imubayes.propagate(lambda m, rho: m / rho, inputs)
    >>> volume.stable, f"{volume['y'].value:.4g} ± {volume['y'].uncertainty:.1g}"
    (True, '1.25e-05 ± 9e-08')
    """
    equation = law.bound_equation(function, inputs, names, correlation, probability)
    _check(equation.inputs, digits, most_draws)
    random = np.random.default_rng(seed)
    needed = max(_BLOCK, math.ceil(100 / (1 - probability)))
    size = min(needed, most_draws // _FEWEST_BLOCKS)
    blocks: list[np.ndarray] = []
    sums: list[np.ndarray] = []
    stable, tails = False, np.array([(1 - probability) / 2, (1 + probability) / 2])
    while not stable and (len(blocks) < _FEWEST_BLOCKS or (len(blocks) + 1) * size <= most_draws):
        blocks.append(equation.sampled(size, random))
        sums.append(_statistics(blocks[-1], tails))
        stable = size == needed and len(blocks) >= _FEWEST_BLOCKS and _is_stable(np.array(sums), digits)
    draws = np.concatenate(blocks)
    given = [len(each.draws) for each in equation.inputs if each.draws is not None and each.uncertainty > 0]
    if stable and given:
        stable = _is_stable(_by_parts_of_draws(equation, min(given), size, tails, seed), digits)
    budgets = tuple(law.budgets_of_outputs(equation, probability))
    outputs = zip(names, draws.T, budgets, strict=True)
    found = tuple(_output(name, own, gum, probability, digits) for name, own, gum in outputs)
    return Propagated(found, draws, probability, stable, min([len(draws), *given]))


def _check(inputs: Sequence[InputQuantity], digits: int, most_draws: int) -> None:
    _check_deviations(inputs)
    if digits not in (1, 2):
        raise input_error(f"digits = {digits}", "digits", "1 or 2", "correct it")
    if most_draws < _FEWEST_DRAWS:
        raise input_error(f"most_draws = {most_draws}", "most_draws", f"{_FEWEST_DRAWS} or more", "correct it")


def _check_deviations(inputs: Sequence[InputQuantity]) -> None:
    refuse(
        Issue(
            f"the distribution of {each.degrees_of_freedom:g} degrees of freedom has no standard deviation",
            f"input quantity '{each.name}'",
            "more than 2 degrees of freedom: four readings or more",
            "add readings, state a pooled standard uncertainty with its degrees of freedom, or use budget",
        )
        for each in inputs
        if each.distribution == "t" and each.uncertainty > 0 and each.degrees_of_freedom <= 2
    )


def _statistics(draws: np.ndarray, tails: np.ndarray) -> np.ndarray:
    """Return mean, standard deviation and both ends of the interval of draws (M, K), shape (4, K)."""
    return np.concatenate([draws.mean(axis=0)[None], _deviation(draws)[None], np.quantile(draws, tails, axis=0)])


def _deviation(draws: np.ndarray) -> np.ndarray:
    """Return the standard deviation of draws (M, …) of each output; 0 if they are the same, without rounding."""
    return np.asarray((draws - draws[0]).std(axis=0, ddof=1))


def _by_parts_of_draws(equation: law.BoundEquation, fewest: int, size: int, tails: np.ndarray, seed: int) -> np.ndarray:
    """Return the statistics (h, 4, K) from h parts of the draws that inputs are given by, one after the other.

    All else is drawn as for the other parts: what differs is due to these draws.  Neighbours stay together, because
    those of a chain are correlated.
    """
    parts = min(_FEWEST_BLOCKS, max(fewest // 2, 2))
    found = []
    for part in range(parts):
        inputs = tuple(
            each if each.draws is None else replace(each, draws=each.draws[part * many : (part + 1) * many])
            for each in equation.inputs
            for many in (0 if each.draws is None else len(each.draws) // parts,)
        )
        most = max(len(each.draws) for each in inputs if each.draws is not None)
        drawn = replace(equation, inputs=inputs).sampled(max(size, 4 * most), np.random.default_rng(seed))
        found.append(_statistics(drawn, tails))
    return np.array(found)


def _is_stable(blocks: np.ndarray, digits: Digits) -> bool:
    """Return whether twice the errors of averages over blocks, (h, 4, K), are below the tolerance of each output."""
    error = 2 * blocks.std(axis=0, ddof=1) / math.sqrt(len(blocks))
    return all(
        not u > 0 or bool((own <= numerical_tolerance(float(u), digits)).all())
        for u, own in zip(blocks[:, 1].mean(axis=0), error.T, strict=True)
    )


def _output(name: str, draws: np.ndarray, gum: law.GumBudget, probability: float, digits: Digits) -> OutputQuantity:
    ordered = np.sort(draws)
    low, high = (float(end) for end in np.quantile(ordered, [(1 - probability) / 2, (1 + probability) / 2]))
    u = float(_deviation(draws))
    tolerance = numerical_tolerance(u, digits) if u > 0 else 0.0
    apart = max(abs(gum.value - gum.expanded_uncertainty - low), abs(gum.value + gum.expanded_uncertainty - high))
    return OutputQuantity(
        name, float(draws.mean()), u, (low, high), shortest_interval(ordered, probability), tolerance, gum,
        apart <= tolerance,
    )  # fmt: skip
