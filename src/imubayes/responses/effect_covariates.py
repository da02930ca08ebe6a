"""Covariates that each coefficient of an effect goes with, found from its formula and not from the data.

On the data of a campaign many functions coincide: where the force along an axis is the same in all runs in which the
temperature changes, a scale factor over temperature is a bias over temperature.  What the effect itself says is told by
its formula at generic values: the coefficient goes with every input that changes its first-order response.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from imubayes.array_shapes import Array
from imubayes.covariates import COVARIATES, ambient_names
from imubayes.effects.base import RecordEffect, SignalEffect
from imubayes.parameters.parameter_declarations import declared_parameters
from imubayes.signal_path_state import Ambient, Sample

INPUTS: Mapping[str, str] = {"gyro": "rate_i", "accelerometer": "force_i"}
"""The covariate that the signal of a kind of channel follows."""
MEMORY = "memory"
_GENERIC = np.random.default_rng(952).uniform(0.5, 2.0, 64)
_CHANGED = 1e-9
"""Relative change by which rounding is told from a dependence."""


def covariates_of(member: type, kind: str) -> tuple[frozenset[str], ...]:
    """Return for each coefficient of an effect the columns of the covariates that it goes with; none of a motion.

    A direction of the site counts by the name of its axis, since it is no covariate, and a memory by `MEMORY`.  What
    has no derivative at its null goes with nothing here, as a dead zone.
    """
    if not issubclass(member, SignalEffect | RecordEffect):
        return ()
    declared = declared_parameters(member)
    nulls = {field: jnp.asarray(float(one.null)) for field, one in declared.items()}
    return tuple(_of_coefficient(member, nulls, field, kind) for field, one in declared.items() if not one.shape)


def _of_coefficient(
    member: type[SignalEffect | RecordEffect], nulls: Mapping[str, Array], field: str, kind: str
) -> frozenset[str]:
    @jax.jit
    def first_order(signal, sample, memory):
        def output(value):
            effect = member(**{**nulls, field: value})
            if isinstance(effect, RecordEffect):
                return effect.apply(signal, sample, memory)
            return effect.apply(signal, sample)

        return jax.jvp(output, (nulls[field],), (jnp.ones(()),))[1]

    signal, memory, sample = *jnp.asarray(_GENERIC[:2]), _generic_sample()
    at = float(first_order(signal, sample, memory))
    found = {name for name, other in _changed(sample) if _differs(float(first_order(signal, other, memory)), at)}
    if _differs(float(first_order(1.5 * signal, sample, memory)), at):
        found.add(INPUTS[kind])
    if _differs(float(first_order(signal, sample, 1.5 * memory)), at):
        found.add(MEMORY)
    return frozenset(COVARIATES[name].column if name in COVARIATES else name for name in found)


def _differs(one: float, other: float) -> bool:
    return abs(one - other) > _CHANGED * (abs(one) + abs(other))


def _generic_sample() -> Sample:
    vectors = jnp.asarray(_GENERIC[2:17].reshape(5, 3))
    values = zip(ambient_names(), jnp.asarray(10 * _GENERIC[17:]), strict=False)
    return Sample(*vectors, ambient=Ambient(**dict(values)), output_scale=jnp.asarray(1.7))


def _changed(sample: Sample) -> Iterator[tuple[str, Sample]]:
    """Yield what may change in a sample, by name, with the sample that it changes to."""
    for vector in ("rate", "force", "acceleration", "north", "up"):
        for place, letter in enumerate("ios"):
            values = getattr(sample, vector)
            yield f"{vector}_{letter}", replace(sample, **{vector: values.at[place].multiply(1.5)})
    for name, value in sample.ambient.values.items():
        yield name, replace(sample, ambient=sample.ambient.updated(**{name: 1.5 * value}))
