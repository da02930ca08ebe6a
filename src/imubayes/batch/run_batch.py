"""A run of a batch: missing campaigns are fitted in chunks, here or on Dask workers, and each chunk is kept.

Each chunk is kept before the next one counts as done.  Chunks are consecutive campaigns; which ones stand together has
no influence on any number.  The memory needed is that of the chunks in work, whatever the size of the archive.  Nothing
here computes: chunks are fitted by an executor.

Dask workers are local processes, or those of a cluster whose scheduler is running.  Workers compute, and the process
that started the batch writes: a worker that was given up and goes on cannot write a unit twice.  A few chunks for each
worker are under way at a time.  Dask gives the chunk of a lost worker to another.  A chunk whose workers die again and
again is divided, until the unit that kills them is alone.  Dask counts a death for every task that the worker held,
whichever killed it: such a unit is tried again when nothing else is under way, and has failed where its workers die
then.
"""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

from dask import config as dask_config
from distributed import Client, Future, KilledWorker, LocalCluster, as_completed
from distributed.comm.core import CommClosedError

from imubayes.batch import batch_folder
from imubayes.batch.posterior_table import Outcome, UnitPosterior
from imubayes.foundations.errors import InputError, input_error
from imubayes.model.model_file import ModelSpec, read_model

CHUNK = 32
"""Units of a chunk: what is lost by a kill, at most, for each worker."""


@dataclass(frozen=True)
class ChunkTask:
    """A chunk to fit, as it is sent to a worker."""

    spec: ModelSpec
    settings: batch_folder.BatchSettings
    sources: tuple[batch_folder.UnitSource, ...]


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
        """Seconds that the rest takes at this rate; None where nothing is done yet."""
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
    progress : called after each chunk.

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
        tasks = (ChunkTask(spec, settings, group) for group in _chunks(missing, chunk))
        for fitted in executor(tasks):
            parts.write(fitted)
            done += len(fitted)
            failed += sum(unit.outcome.status != "fitted" for unit in fitted)
            state = BatchProgress(parts.key, len(sources), before, done, failed, time.perf_counter() - clock)
            if progress is not None:
                progress(state)
    return state


def _chunks(sources: Sequence[batch_folder.UnitSource], size: int) -> Iterator[tuple[batch_folder.UnitSource, ...]]:
    return (tuple(sources[start : start + size]) for start in range(0, len(sources), size))


# Chunks under way for each thread of the workers: one in work, one waiting.
_AHEAD = 2
_RETRIES = 2
# Workers that may die with a chunk before it is divided.
_DEATHS = 1


@contextmanager
def local_workers(count: int, fit: Callable[[ChunkTask], FittedChunk]) -> Iterator[Executor]:
    """Give an executor with local worker processes, spawned, of one thread each; one that dies is replaced."""
    with (
        dask_config.set({"distributed.scheduler.allowed-failures": _DEATHS}),
        LocalCluster(n_workers=count, threads_per_worker=1, processes=True, dashboard_address=":0") as cluster,
        Client(cluster) as client,
    ):
        yield on_client(client, fit)


@contextmanager
def cluster_workers(address: str, fit: Callable[[ChunkTask], FittedChunk], timeout: float = 10.0) -> Iterator[Executor]:
    """Give an executor on the workers of a Dask scheduler.

    Parameters
    ----------
    address : such as ``tcp://node:8786``.
    timeout : of the connection, s.

    Raises
    ------
    InputError
        where no scheduler answers.
    """
    try:
        client = Client(address, timeout=timeout)
    except (OSError, ValueError) as error:
        raise input_error(
            f"no Dask scheduler answers: {error}",
            address,
            "the address of a running scheduler, such as tcp://127.0.0.1:8786",
            "start one with `dask scheduler`, and workers with `dask worker ADDRESS`",
        ) from error
    with client:
        yield on_client(client, fit)


def on_client(client: Client, fit: Callable[[ChunkTask], FittedChunk]) -> Executor:
    """Return an executor on a Dask client."""

    def submitted(task: ChunkTask) -> Future:
        return client.submit(fit, task, pure=False, retries=_RETRIES)

    def execute(tasks: Iterable[ChunkTask]) -> Iterator[FittedChunk]:
        waiting, tasks_of, suspects = iter(tasks), {}, []
        results = as_completed()

        def submit(chosen: Iterable[ChunkTask]) -> None:
            for task in chosen:
                future = submitted(task)
                tasks_of[future] = task
                results.add(future)

        submit(islice(waiting, _wanted(client)))
        for future in results:
            task = tasks_of.pop(future)
            found = _fitted(future)
            killed = isinstance(found, KilledWorker)
            if killed and len(task.sources) == 1:
                suspects.append(task)
            elif killed:
                submit(_halves(task))
            submit(islice(waiting, max(0, _wanted(client) - len(tasks_of))))
            if not killed:
                yield found
        for task in suspects:
            found = _fitted(submitted(task))
            yield _died(task, found) if isinstance(found, KilledWorker) else found

    return execute


def _wanted(client: Client) -> int:
    workers: Any = client.nthreads()
    return _AHEAD * max(1, sum(workers.values()))


def _fitted(future: Future) -> FittedChunk | KilledWorker:
    """Return the result of a chunk, or what Dask says where its workers have died."""
    try:
        return future.result()
    except KilledWorker as error:
        return error
    except (CommClosedError, CancelledError, OSError) as error:
        raise scheduler_lost(str(error)) from error


def _halves(task: ChunkTask) -> list[ChunkTask]:
    """Return the halves of a chunk of several units."""
    half = len(task.sources) // 2
    return [replace(task, sources=part) for part in (task.sources[:half], task.sources[half:])]


def _died(task: ChunkTask, error: KilledWorker) -> FittedChunk:
    """Return the single unit of a chunk as failed."""
    (source,) = task.sources
    outcome = Outcome("failed", f"the worker died: {error}", source.path, source.fingerprint())
    return (UnitPosterior(batch_folder.unread(source), outcome),)


def scheduler_lost(what: str) -> InputError:
    """Return the error of a batch whose scheduler has gone."""
    return input_error(
        f"the Dask scheduler has gone: {what}",
        "the cluster of the batch",
        "a scheduler that runs as long as the batch",
        "start it, and run the same command again: the batch goes on with what is missing",
    )
