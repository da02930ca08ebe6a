"""The uncertain zero of every kind of table: the effect of its angle is that of reading the angle from another zero."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest

from imubayes.foundations.campaign_data import Campaign
from imubayes.model.bind import Model, bind
from imubayes.model.problem import predict
from small_campaign import ARCSEC, campaign, serial_campaign, spec

SERIAL = ("inner_axis_zero", "middle_axis_zero", "outer_axis_zero")
KINDS: dict[str, tuple[Callable[[], Campaign], tuple[str, ...], str, str, str]] = {
    "dividing head": (campaign, SERIAL[:1], "head", "inner_axis_zero", "table_angle"),
    "inner axis of three": (serial_campaign, SERIAL, "gimbals", "inner_axis_zero", "table_angle"),
    "middle axis of three": (serial_campaign, SERIAL, "gimbals", "middle_axis_zero", "middle_angle"),
    "outer axis of three": (serial_campaign, SERIAL, "gimbals", "outer_axis_zero", "outer_angle"),
    "platform of a centrifuge": (serial_campaign, SERIAL, "arm", "inner_axis_zero", "table_angle"),
}
ZERO = 40.0  # arcsec


def read_from(whole: Campaign, table: str, column: str, zero: float) -> Campaign:
    """Return the campaign with an angle of a table read from another zero, rad."""
    runs = [
        replace(run, covariates={**run.covariates, column: run.covariates[column] + zero})
        if run.table == table else run
        for run in whole.runs
    ]  # fmt: skip
    return replace(whole, runs=tuple(runs))


@cache
def bound(make: Callable[[], Campaign], effects: tuple[str, ...]) -> Model:
    return bind(spec(*effects), make())


def outputs(model: Model, name: str, zero: float) -> np.ndarray:
    z = [parameter.prior.z(zero * parameter.factor * (parameter.name == name)) for parameter in model.layout.parameters]
    return np.asarray(predict(model.problem, jnp.asarray(np.array(z))))


@pytest.mark.parametrize("kind", KINDS)
def test_the_effect_is_another_zero(kind: str) -> None:
    make, effects, table, effect, column = KINDS[kind]
    model, name = bound(make, effects), f"{effect}.zero[{table}]"
    assert name in model.layout.names
    found = outputs(model, name, ZERO)
    moved = bind(spec(*effects), read_from(make(), table, column, ZERO * ARCSEC))
    np.testing.assert_allclose(found, outputs(moved, name, 0.0), rtol=1e-9, atol=1e-9)
    assert np.abs(found - outputs(model, name, 0.0)).max() > 1e-4  # pulse/s: without the effect the test fails
