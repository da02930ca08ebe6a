"""The tests run under type checks: a wrong type or shape raises where it is handed over."""

import jax.numpy as jnp
import pytest
from beartype.roar import BeartypeCallHintParamViolation
from jaxtyping import TypeCheckError

from imubayes.foundations.arrays import exponential
from imubayes.foundations.units import to_si


def test_a_wrong_type_raises():
    with pytest.raises(BeartypeCallHintParamViolation):
        to_si(3)  # pyright: ignore[reportArgumentType]


def test_a_wrong_shape_raises():
    with pytest.raises(TypeCheckError):
        exponential(jnp.zeros(2))
