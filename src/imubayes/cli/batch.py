"""`imubayes batch`: every campaign of an archive fitted with one model."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import cyclopts

from imubayes.cli.options import Flag, Json, print_json
from imubayes.errors import input_error

if TYPE_CHECKING:
    from imubayes.batch.batch_settings import BatchSettings
    from imubayes.batch.run_batch import BatchProgress, Executor

batch = cyclopts.App(name="batch", help="Fit every campaign of an archive with one model, and compare the units.")


@batch.default
def fit_all(
    archive: Path,
    *,
    model: Path,
    out: Path,
    sample: Literal["all", "flagged", "none"] = "none",
    diagnose: Flag = False,
    seed: int = 0,
    retry: Flag = False,
    workers: int | None = None,
    scheduler: str | None = None,
    as_json: Json = False,
) -> int:
    """Fit every campaign of an archive, or of a folder of campaigns, that has no result yet.

    An interrupted batch goes on when it is run again; what is done is kept.  A campaign that cannot be fitted is listed
    with its reason and stops nothing.

    Example: imubayes batch archive --model models/trihedral-imu.toml --out results/archive

    Parameters
    ----------
    archive
        Archive, or folder with campaign folders.
    model
        Model file.
    out
        Results folder.
    sample
        Units whose posterior is sampled; the others have the Laplace approximation. Flagged are those whose
        importance weights (Pareto k, skewness) put it in doubt.
    diagnose
        Diagnose each fit; the verdict is in the table.
    seed
        Seed of the sampler.
    retry
        Try campaigns without estimates again, not only those whose files have changed.
    workers
        Fit in so many local processes; in this one where neither this nor a scheduler is given.
    scheduler
        Fit on the workers of this Dask scheduler, such as tcp://node:8786.
    as_json
        Print one JSON object on standard output.
    """
    from imubayes.cli.session import start_jax

    start_jax()
    from imubayes.batch.batch_settings import BatchSettings

    state = _run(archive, model, out, BatchSettings(sample, diagnose, seed), retry, executor(workers, scheduler))
    return _report(state, out, as_json)


def _run(
    archive: Path, model: Path, out: Path, settings: "BatchSettings", retry: bool,
    executor: AbstractContextManager["Executor"],
) -> "BatchProgress":  # fmt: skip
    from imubayes.batch.run_batch import run_batch
    from imubayes.cli.session import progress
    from imubayes.display.batch_report import progress_text

    with progress() as tell, executor as execute:
        tell("listing the campaigns")
        return run_batch(
            archive, model, out, execute, settings, retry=retry, progress=lambda state: tell(progress_text(state))
        )


def _report(state: "BatchProgress", out: Path, as_json: bool) -> int:
    from imubayes.batch.posterior_table import read_outcomes
    from imubayes.display.batch_report import batch_json, batch_report
    from imubayes.display.report_layout import print_report

    units = read_outcomes(out, state.key)
    if as_json:
        print_json(batch_json(state, units, state.key))
    else:
        print_report(batch_report(state, units, out))
    return 1 if (units["status"] != "fitted").any() else 0


@contextmanager
def executor(workers: int | None, scheduler: str | None) -> Iterator["Executor"]:
    """Give what fits the chunks: this process, local workers, or those of a scheduler.

    Raises
    ------
    InputError
        where both are asked for, the number of workers is not positive, or Dask is not installed.
    """
    from imubayes.batch.fit_chunk import fit_chunk, in_process

    if workers is None and scheduler is None:
        yield in_process
        return
    if (workers is not None and scheduler is not None) or (workers is not None and workers < 1):
        raise input_error(
            "workers cannot be started", "--workers, --scheduler", "--workers N with N ≥ 1, or --scheduler ADDRESS",
            "give one of the two",
        )  # fmt: skip
    try:
        from imubayes.batch.dask_workers import cluster_workers, local_workers
    except ModuleNotFoundError as error:
        raise input_error(
            f"the package '{error.name}' is not installed",
            "--workers, --scheduler",
            "",
            "pip install imubayes[cluster]",
        ) from error
    if scheduler is not None:
        with cluster_workers(scheduler, fit_chunk) as execute:
            yield execute
    else:
        with local_workers(workers or 1, fit_chunk) as execute:
            yield execute
