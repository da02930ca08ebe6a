"""Problems padded to few shapes, so that units with other missing readings share compiled code.

The readings of a unit are filled up with copies of its first one that do not count: their weight is zero.  Their number
is rounded up to the next of sixteen to thirty-two steps an octave, 6 % more at most.
"""

import math

import equinox as eqx
import jax
import numpy as np

from imubayes.model.problem import Problem
from imubayes.noise.base import EntryNoise

_STEPS_AN_OCTAVE, _LEAST_STEP = 16, 16


def padded_count(count: int) -> int:
    """Return the number of readings that so many are padded to."""
    octave = 2 ** int(math.log2(max(count, 1)))
    step = max(_LEAST_STEP, octave // _STEPS_AN_OCTAVE)
    return step * math.ceil(count / step)


def padded_entries(problem: Problem) -> Problem:
    """Return a problem with its readings padded, for models without noise that is correlated in time."""
    observations = problem.observations
    count = len(observations.value)
    more = padded_count(count) - count
    if not more or problem.transitions is not None or problem.timeline is not None:
        return problem

    def filled(leaf) -> np.ndarray:
        array = np.asarray(leaf)
        return np.concatenate([array, np.repeat(array[:1], more, axis=0)])

    def placed(leaf) -> np.ndarray:
        array = np.asarray(leaf)
        return np.where(array == count, count + more, array).astype(array.dtype)

    chosen = (observations.value, observations.entry, observations.readout, observations.group, observations.rank)
    by_entry = jax.tree.map(filled, chosen)
    weight = np.concatenate([np.asarray(observations.weight), np.zeros(more)])
    reach = np.concatenate([np.asarray(problem.sparsity.reach), np.zeros((more, len(problem.sparsity.colour)), bool)])
    noise = tuple(
        eqx.tree_at(lambda known: (known.places, known.acts), layer, jax.tree.map(filled, (layer.places, layer.acts)))
        if issubclass(layer.noise, EntryNoise)
        else layer
        for layer in problem.noise
    )
    return eqx.tree_at(
        lambda p: (
            p.observations.value, p.observations.entry, p.observations.readout, p.observations.group,
            p.observations.rank, p.observations.weight, p.observations.members, p.observations.in_time,
            p.sparsity.reach, p.noise,
        ),
        problem,
        (*by_entry, weight, placed(observations.members), placed(observations.in_time), reach, noise),
    )  # fmt: skip
