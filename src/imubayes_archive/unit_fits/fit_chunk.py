"""A chunk of a batch: its units are read, bound, padded to few shapes, and fitted in lanes or alone.

Units of the same structure are fitted together in lanes.  A unit that lanes do not serve is fitted by itself: one whose
noise is correlated or has heavy tails, a free tumble, one that did not converge in its lane, or one whose noise scales
have several modes.  Which of the two it is depends on the unit alone.  Whatever goes wrong with a unit is its outcome
and stops nothing.

Padding lets units with different missing readings share compiled code.  The readings of a unit are filled up with
copies of its first one that have zero weight.  Their number is rounded up to the next of sixteen to thirty-two steps an
octave, which adds 6 % at most.
"""

import math
import time
import warnings
from collections import OrderedDict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import numpy as np

from imubayes import Fit
from imubayes.model.bind import Model
from imubayes.model.problem import Problem
from imubayes.noise.components import EntryNoise
from imubayes_archive.unit_fits.batch_folder import UnitSource, identity_of, unread
from imubayes_archive.unit_fits.fit_unit import bound_to, failure, fit_alone, posteriors, sampled_where_in_doubt
from imubayes_archive.unit_fits.lanes import LANES, LaneStructure, find_modes, structure_key
from imubayes_archive.unit_fits.posterior_table import UnitIdentity, UnitPosterior
from imubayes_archive.unit_fits.run_batch import ChunkTask, FittedChunk

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


# Structures of which a process keeps the places; the compiled code is JAX's.
_MOST_STRUCTURES = 64
_structures: OrderedDict[str, LaneStructure | None] = OrderedDict()


@dataclass(frozen=True)
class BoundUnit:
    """A unit that was read and bound, and the seconds that took."""

    source: UnitSource
    identity: UnitIdentity
    model: Model
    seconds: float


def fit_chunk(task: ChunkTask) -> FittedChunk:
    """Return the units of a chunk, in its order."""
    done: dict[str, UnitPosterior] = {}
    bound: list[BoundUnit] = []
    for source in task.sources:
        found = _bound(task, source)
        if isinstance(found, BoundUnit):
            bound.append(found)
        else:
            done[source.digest] = found
    for group in _groups(bound):
        done |= _fitted(task, group)
    return tuple(done[source.digest] for source in task.sources)


def in_process(tasks: Iterable[ChunkTask]) -> Iterator[FittedChunk]:
    """Fit chunks one after the other in this process."""
    return map(fit_chunk, tasks)


def _bound(task: ChunkTask, source: UnitSource) -> BoundUnit | UnitPosterior:
    clock, identity = time.perf_counter(), unread(source)
    try:
        campaign = source.read()
        identity = identity_of(campaign, source)
        model = bound_to(task.spec_of(source), campaign)
        identity = replace(identity, structure=structure_key(model.problem))
    except Exception as error:
        return _timed(UnitPosterior(identity, failure(error, source)), source, time.perf_counter() - clock)
    return BoundUnit(source, identity, model, time.perf_counter() - clock)


def _groups(bound: Sequence[BoundUnit]) -> Iterator[list[BoundUnit]]:
    """Yield units of the same structure, as many as there are lanes at most."""
    by_structure: dict[str, list[BoundUnit]] = {}
    for unit in bound:
        by_structure.setdefault(unit.identity.structure, []).append(unit)
    for units in by_structure.values():
        for start in range(0, len(units), LANES):
            yield units[start : start + LANES]


def _fitted(task: ChunkTask, group: Sequence[BoundUnit]) -> dict[str, UnitPosterior]:
    clock = time.perf_counter()
    # A diagnosis takes the readings as they were recorded, without padding.
    fits = (
        [None] * len(group)
        if task.settings.sample == "all"
        else _in_lanes_if_possible(group, not task.settings.diagnose)
    )
    shared, done = (time.perf_counter() - clock) / len(group), {}
    for unit, fit in zip(group, fits, strict=True):
        clock = time.perf_counter()
        try:
            if fit is None:
                found = fit_alone(unit.model, task.settings, unit.identity)
            else:
                found = sampled_where_in_doubt(fit, task.settings, unit.identity, unit.model)
        except Exception as error:
            found = UnitPosterior(unit.identity, failure(error, unit.source))
        seconds = unit.seconds + shared + time.perf_counter() - clock
        done[unit.source.digest] = _timed(found, unit.source, seconds)
    return done


def _in_lanes_if_possible(group: Sequence[BoundUnit], padded: bool) -> list[Fit | None]:
    """Return what `_in_lanes` does; None for all if it fails, so that an error is that of one unit.

    A matrix without inverse is the fault of a unit.  Any other error is one of this package: it must not go unseen.
    """
    try:
        return _in_lanes(group, padded)
    except np.linalg.LinAlgError:
        return [None] * len(group)
    except Exception as error:
        warnings.warn(
            f"units are fitted one by one, because their joint computation failed: {type(error).__name__}: {error}",
            stacklevel=2,
        )
        return [None] * len(group)


def _in_lanes(group: Sequence[BoundUnit], padded: bool) -> list[Fit | None]:
    """Return the fits of units of one structure; None for those that have to be fitted alone."""
    models = [unit.model for unit in group]
    if padded:
        models = [replace(model, problem=padded_entries(model.problem)) for model in models]
    structure = _structure(f"{group[0].identity.structure}-{padded}", models[0])
    if structure is None:
        return [None] * len(group)
    varying = structure.stacked(models)
    return posteriors(structure, varying, find_modes(structure, varying), models)


def _structure(key: str, model: Model) -> LaneStructure | None:
    if key not in _structures:
        _structures[key] = LaneStructure.of(model.problem)
        if len(_structures) > _MOST_STRUCTURES:
            _structures.popitem(last=False)
    _structures.move_to_end(key)
    return _structures[key]


def _timed(unit: UnitPosterior, source: UnitSource, seconds: float) -> UnitPosterior:
    fingerprint = "" if unit.outcome.status == "fitted" else source.fingerprint()
    return replace(unit, outcome=replace(unit.outcome, fingerprint=fingerprint, seconds=seconds))
