"""A run of a batch: missing campaigns are fitted in chunks, and each chunk is kept.

Each chunk is kept before the next one counts as done.  Chunks are consecutive campaigns; which ones stand together has
no influence on any number.  The memory needed is that of the chunks in work, whatever the size of the archive.  Nothing
here computes: chunks are fitted by an executor.
"""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from imubayes.model.model_file import ModelSpec, read_model
from imubayes_archive.unit_fits import batch_folder
from imubayes_archive.unit_fits.posterior_table import UnitPosterior

CHUNK = 32
"""Units of a chunk: what is lost by a kill, at most, for each worker."""


@dataclass(frozen=True)
class ChunkTask:
    """A chunk to fit, as it is sent to a worker.

    Attributes
    ----------
    spec : the model of all units.
    of_unit : models of units that have priors of their own, by digest.
    """

    spec: ModelSpec
    settings: batch_folder.BatchSettings
    sources: tuple[batch_folder.UnitSource, ...]
    of_unit: Mapping[str, ModelSpec] = field(default_factory=dict)

    def spec_of(self, source: batch_folder.UnitSource) -> ModelSpec:
        """Return the model of a unit."""
        return self.of_unit.get(source.digest, self.spec)


@dataclass(frozen=True)
class BatchProgress:
    """How far a batch is.

    Attributes
    ----------
    key : of model, settings and code.
    units, before, done, failed : units in all, done before, done now, and of these without estimates.
    seconds : since the start.
    """

    key: str
    units: int
    before: int
    done: int
    failed: int
    seconds: float

    @property
    def rate(self) -> float:
        """Units per second of this run."""
        return self.done / self.seconds if self.seconds > 0 else 0.0

    @property
    def seconds_left(self) -> float | None:
        """Seconds that the rest takes at this rate; None if nothing is done yet."""
        return (self.units - self.before - self.done) / self.rate if self.rate > 0 else None


FittedChunk = tuple[UnitPosterior, ...]
"""The units of a chunk."""
Executor = Callable[[Iterable[ChunkTask]], Iterator[FittedChunk]]
"""Fits chunks, and yields them in any order."""


def run_batch(
    place: str | Path,
    model: str | Path,
    out: str | Path,
    executor: Executor,
    settings: batch_folder.BatchSettings | None = None,
    *,
    retry: bool = False,
    chunk: int = CHUNK,
    progress: Callable[[BatchProgress], None] | None = None,
) -> BatchProgress:
    """Fit every campaign that has no result yet, and return how far the batch is at the end.

    Parameters
    ----------
    place : archive, or folder of campaign folders.
    model : model file, or name of a shipped model.
    out : results folder; what it holds is kept.
    executor : fits the chunks.
    retry : whether campaigns without estimates are tried again; without, only those whose files have changed.
    chunk : units of a chunk.
    progress : called before the first chunk, and after each.

    Raises
    ------
    InputError
        for a place without campaigns, a model that cannot be read, or a results folder that is in use.
    """
    settings, spec, sources = (
        settings or batch_folder.BatchSettings(),
        read_model(model),
        batch_folder.sources_of(place),
    )
    parts = batch_folder.PartFiles(Path(out), batch_folder.batch_key(spec, settings), batch_folder.code_version())
    with parts.writing():
        parts.keep_model(Path(spec.where), spec)
        missing = batch_folder.still_to_do(parts, sources, retry)
        clock, before, done, failed = time.perf_counter(), len(sources) - len(missing), 0, 0
        state = BatchProgress(parts.key, len(sources), before, 0, 0, 0.0)
        if progress is not None:
            progress(state)
        tasks = (ChunkTask(spec, settings, group) for group in chunks_of(missing, chunk))
        for fitted in executor(tasks):
            parts.write(fitted)
            done += len(fitted)
            failed += sum(unit.outcome.status != "fitted" for unit in fitted)
            state = BatchProgress(parts.key, len(sources), before, done, failed, time.perf_counter() - clock)
            if progress is not None:
                progress(state)
    return state


def chunks_of(
    sources: Sequence[batch_folder.UnitSource], size: int = CHUNK
) -> Iterator[tuple[batch_folder.UnitSource, ...]]:
    """Return consecutive sources in groups of at most `size`."""
    return (tuple(sources[start : start + size]) for start in range(0, len(sources), size))
