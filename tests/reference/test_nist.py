"""The least-squares engine against the certified values of all 27 NIST StRD nonlinear problems, from both starts."""

from collections.abc import Callable
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from nist import FILE, digits, evaluate, read

from imubayes.inference.least_squares import LeastSquares, covariance
from imubayes.inference.levenberg_marquardt import minimise

here = pytest.mark.skipif(not FILE.exists(), reason="the certified problems lie beside the repository, not in it")
PROBLEMS = read() if FILE.exists() else {}
WANTED = 6.0
# From its first start this one runs down a valley without an end in double precision.
NOT_REACHED = {("MGH10", 0)}
# Its data are exact to the last digit, so the residual, and with it every standard deviation, is rounding.
WITHOUT_RESIDUAL = {"Lanczos1"}
# Of every kind of formula and level of difficulty at every run of the tests; each problem compiles a fit of its own.
AT_ONCE = ("Misra1a", "Lanczos1", "Gauss1", "ENSO", "MGH10", "MGH17", "Thurber", "Rat43", "Bennett5")


@cache
def solver(name: str) -> Callable:
    """Return the fit of a problem from any start, with the standard deviations at its end; compiled once for both."""
    residual = PROBLEMS[name].residual

    @jax.jit
    def solve(start):
        found = minimise(residual, start)
        left = residual(found.value)
        # Rat43's page counts 9 degrees of freedom and certifies with the 11 that 15 data and 4 parameters have.
        variance = left @ left / (left.shape[0] - start.shape[0])
        return found, jnp.sqrt(jnp.diag(covariance(jax.jacfwd(residual)(found.value), variance)))

    return solve


@cache
def outcome(name: str, start: int) -> tuple[LeastSquares, np.ndarray]:
    """Return where a problem ended and the standard deviations there."""
    found, deviations = solver(name)(jnp.asarray(PROBLEMS[name].starts[start]))
    return found, np.asarray(deviations)


def reached(name: str, start: int) -> float:
    """Return how many certified digits came out, of the worst parameter or standard deviation."""
    found, deviations = outcome(name, start)
    of_values = digits(np.asarray(found.value), PROBLEMS[name].values)
    return of_values if name in WITHOUT_RESIDUAL else min(of_values, digits(deviations, PROBLEMS[name].deviations))


@here
@pytest.mark.parametrize("start", [0, 1])
@pytest.mark.parametrize(
    "name", [name if name in AT_ONCE else pytest.param(name, marks=pytest.mark.slow) for name in PROBLEMS]
)
def test_certified_digits_or_a_flag(name, start):
    if (name, start) in NOT_REACHED:
        assert not bool(outcome(name, start)[0].successful)
    else:
        assert reached(name, start) >= WANTED
        assert bool(outcome(name, start)[0].successful)


@here
@pytest.mark.slow
def test_at_least_26_of_27_from_both_starts():
    assert len(PROBLEMS) == 27
    assert sum(all(reached(name, start) >= WANTED for start in (0, 1)) for name in PROBLEMS) >= 26


@here
def test_the_digits_are_counted_on_the_worst_parameter():
    problem = PROBLEMS["Misra1a"]
    spoiled = problem.values * np.array([1.0, 1 + 1e-5])
    assert digits(spoiled, problem.values) == pytest.approx(5.0, abs=0.01)


@pytest.mark.parametrize("text", ["__import__('os')", "b1.real", "[b1][0]", "open(b1)", "b1 if b1 else b1", "b2"])
def test_what_is_not_arithmetic_is_refused(text):
    with pytest.raises(ValueError, match="not arithmetic"):
        evaluate(text, {"b1": 1.0})
