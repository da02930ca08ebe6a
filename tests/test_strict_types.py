"""The tests run under type checks: a wrong type or shape raises where it is handed over."""

import inspect

import jax.numpy as jnp
import pytest
from beartype.roar import BeartypeCallHintParamViolation
from jaxtyping import Float, TypeCheckError

from imubayes.foundations.arrays import Array, exponential
from imubayes.foundations.tail_probabilities import _log_beta_tail
from imubayes.foundations.units import to_si
from strict_types import EVERY, FIRST_CALLS, checked, shaped


def first_element(values: Float[Array, "n 3"]) -> float:
    return values[0, 0]


def test_a_wrong_type_raises():
    with pytest.raises(BeartypeCallHintParamViolation):
        to_si(3)  # pyright: ignore[reportArgumentType]


def test_a_wrong_shape_raises():
    with pytest.raises(TypeCheckError):
        exponential(jnp.zeros(2))


def test_the_first_calls_are_checked_and_a_sample_of_those_that_follow():
    first, refused = shaped(first_element, typechecker=checked), []
    for call in range(1, 4 * EVERY + 1):
        try:
            first(jnp.zeros((2, 2)))
        except TypeCheckError:
            refused.append(call)
    assert refused == [*range(1, FIRST_CALLS + 1), *range(EVERY, 4 * EVERY + 1, EVERY)]


def test_nested_functions_are_left_as_they_are():
    def nested(value: int) -> int:
        return value

    assert shaped(nested, typechecker=checked) is nested
    outer = inspect.unwrap(_log_beta_tail)
    assert outer is not _log_beta_tail
    assert not [name for name in outer.__code__.co_names if "beartype" in name]
