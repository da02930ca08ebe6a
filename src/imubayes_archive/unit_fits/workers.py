"""Where the chunks of a batch are fitted: in this process, or on Dask workers.

Dask workers are local processes, or those of a cluster whose scheduler is running.  Workers compute, and the process
that started the batch writes: a worker that was given up and goes on cannot write a unit twice.  A few chunks for each
worker are under way at a time.  Dask gives the chunk of a lost worker to another.  A chunk whose workers die again and
again is divided, until the unit that kills them is alone.  Dask counts a death for every task that the worker held,
whichever killed it: such a unit is tried again when nothing else is under way, and has failed if its workers die
then.
"""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING, Any

from imubayes.foundations.deferred_modules import DeferredModule
from imubayes.foundations.errors import InputError, input_error
from imubayes_archive.unit_fits import batch_folder
from imubayes_archive.unit_fits.fit_chunk import fit_chunk, in_process
from imubayes_archive.unit_fits.posterior_table import Outcome, UnitPosterior
from imubayes_archive.unit_fits.run_batch import ChunkTask, Executor, FittedChunk

if TYPE_CHECKING:
    from distributed import Client, Future, KilledWorker

# Of the extra `cluster`.
dask: Any = DeferredModule("dask")
distributed: Any = DeferredModule("distributed")

# Chunks under way for each thread of the workers: one in work, one waiting.
_AHEAD = 2
_RETRIES = 2
# Workers that may die with a chunk before it is divided.
_DEATHS = 1


@contextmanager
def local_workers(count: int, fit: Callable[[ChunkTask], FittedChunk]) -> Iterator[Executor]:
    """Give an executor with local worker processes, spawned, of one thread each; one that dies is replaced."""
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": _DEATHS}),
        distributed.LocalCluster(
            n_workers=count, threads_per_worker=1, processes=True, dashboard_address=":0"
        ) as cluster,
        distributed.Client(cluster) as client,
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
        if no scheduler answers.
    """
    try:
        client = distributed.Client(address, timeout=timeout)
    except (OSError, ValueError) as error:
        raise input_error(
            f"no Dask scheduler answers: {error}",
            address,
            "the address of a running scheduler, such as tcp://127.0.0.1:8786",
            "start one with `dask scheduler`, and workers with `dask worker ADDRESS`",
        ) from error
    with client:
        yield on_client(client, fit)


def on_client(client: "Client", fit: Callable[[ChunkTask], FittedChunk]) -> Executor:
    """Return an executor on a Dask client."""

    def submitted(task: ChunkTask) -> "Future":
        return client.submit(fit, task, pure=False, retries=_RETRIES)

    def execute(tasks: Iterable[ChunkTask]) -> Iterator[FittedChunk]:
        waiting, tasks_of, suspects = iter(tasks), {}, []
        results = distributed.as_completed()

        def submit(chosen: Iterable[ChunkTask]) -> None:
            for task in chosen:
                future = submitted(task)
                tasks_of[future] = task
                results.add(future)

        submit(islice(waiting, _wanted(client)))
        for future in results:
            task = tasks_of.pop(future)
            found = _fitted(future)
            if not isinstance(found, tuple):
                if len(task.sources) == 1:
                    suspects.append(task)
                else:
                    submit(_halves(task))
            submit(islice(waiting, max(0, _wanted(client) - len(tasks_of))))
            if isinstance(found, tuple):
                yield found
        for task in suspects:
            found = _fitted(submitted(task))
            yield found if isinstance(found, tuple) else _died(task, found)

    return execute


def _wanted(client: "Client") -> int:
    workers: Any = client.nthreads()
    return _AHEAD * max(1, sum(workers.values()))


def _fitted(future: "Future") -> "FittedChunk | KilledWorker":
    """Return the result of a chunk, or what Dask says if its workers have died."""
    try:
        return future.result()
    except distributed.KilledWorker as error:
        return error
    except (distributed.comm.core.CommClosedError, CancelledError, OSError) as error:
        raise scheduler_lost(str(error)) from error


def _halves(task: ChunkTask) -> list[ChunkTask]:
    """Return the halves of a chunk of several units."""
    half = len(task.sources) // 2
    return [replace(task, sources=part) for part in (task.sources[:half], task.sources[half:])]


def _died(task: ChunkTask, error: "KilledWorker") -> FittedChunk:
    """Return the single unit of a chunk as failed."""
    (source,) = task.sources
    outcome = Outcome("failed", f"the worker died: {error}", source.path, source.fingerprint())
    return (UnitPosterior(batch_folder.unread(source), outcome),)


def scheduler_lost(what: str) -> InputError:
    """Return the error of a batch whose scheduler has gone."""
    return input_error(
        f"the Dask scheduler no longer answers: {what}",
        "the cluster of the batch",
        "a scheduler that runs as long as the batch",
        "start it, and run the same command again: the batch continues with the missing units",
    )


@contextmanager
def executor_of(workers: int | None, scheduler: str | None) -> Iterator[Executor]:
    """Give an executor on so many local workers or on those of a scheduler; in this process if neither is named.

    Raises
    ------
    InputError
        if both are named, the number of workers is not positive, or Dask is not installed.
    """
    if workers is None and scheduler is None:
        yield in_process
        return
    if (workers is not None and scheduler is not None) or (workers is not None and workers < 1):
        raise input_error(
            "workers cannot be started", "--workers, --scheduler", "--workers N with N ≥ 1, or --scheduler ADDRESS",
            "give one of the two",
        )  # fmt: skip
    try:
        distributed.Client  # noqa: B018
    except ModuleNotFoundError as error:
        raise input_error(
            f"the package '{error.name}' is not installed",
            "--workers, --scheduler",
            "",
            "pip install 'imubayes[cluster]', or leave the option out: all units are then fitted in this process",
        ) from error
    given = local_workers(workers or 1, fit_chunk) if scheduler is None else cluster_workers(scheduler, fit_chunk)
    with given as execute:
        yield execute
