"""The same batch on Dask workers: the same table, whatever happens to workers and scheduler."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from distributed import Client, LocalCluster
from small_units import MODEL, make_units
from test_run_batch import assert_same_tables, toy_executor

from imubayes.foundations.errors import InputError
from imubayes_archive.unit_fits.fit_chunk import fit_chunk, in_process
from imubayes_archive.unit_fits.posterior_table import read_parameters, read_units
from imubayes_archive.unit_fits.run_batch import ChunkTask, FittedChunk, run_batch
from imubayes_archive.unit_fits.workers import cluster_workers, local_workers, on_client

HERE = Path(__file__).parent


def toy_chunk(task: ChunkTask) -> FittedChunk:
    return next(toy_executor([task]))


@pytest.fixture(scope="module")
def campaigns(tmp_path_factory):
    folder = tmp_path_factory.mktemp("campaigns")
    make_units(folder, 12)
    return folder


@pytest.fixture(scope="module")
def expected(campaigns, tmp_path_factory):
    out = tmp_path_factory.mktemp("expected")
    run_batch(campaigns, MODEL, out, toy_executor)
    return out


def test_a_cluster_gives_the_same_table(campaigns, expected, tmp_path):
    with (
        LocalCluster(n_workers=2, threads_per_worker=1, processes=False, dashboard_address=":0") as cluster,
        Client(cluster) as client,
    ):
        state = run_batch(campaigns, MODEL, tmp_path, on_client(client, toy_chunk), chunk=2)
    assert state.done == 12
    assert_same_tables(tmp_path, expected)


def test_no_scheduler_at_the_address():
    with pytest.raises(InputError, match="no Dask scheduler"), cluster_workers("tcp://127.0.0.1:9", toy_chunk, 0.2):
        pass


def slow_toy_chunk(task: ChunkTask) -> FittedChunk:
    time.sleep(0.5)
    return toy_chunk(task)


def deadly_chunk(task: ChunkTask) -> FittedChunk:
    """Fit as the toy does, but die with the unit of folder unit-003."""
    if any(source.path.endswith("unit-003") for source in task.sources):
        os.kill(os.getpid(), signal.SIGKILL)
    return toy_chunk(task)


@pytest.fixture
def importable(monkeypatch):
    """Let worker processes import this module."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(HERE), os.environ.get("PYTHONPATH", "")]))


@pytest.mark.slow
def test_a_killed_worker_is_replaced(campaigns, expected, tmp_path, importable):
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as cluster, Client(cluster) as client:
        before: Any = client.run(os.getpid)
        threading.Timer(0.8, os.kill, (min(before.values()), signal.SIGKILL)).start()
        run_batch(campaigns, MODEL, tmp_path, on_client(client, slow_toy_chunk), chunk=1)
        after: Any = client.run(os.getpid)
        assert len(after) == 2
        assert after != before
    assert_same_tables(tmp_path, expected)


@pytest.mark.slow
def test_a_unit_that_kills_its_workers_is_found_and_the_others_are_fitted(campaigns, tmp_path, importable):
    with local_workers(2, deadly_chunk) as executor:
        run_batch(campaigns, MODEL, tmp_path, executor, chunk=4)
    units = read_units(tmp_path)
    assert units.height == 12
    died = units.filter(pl.col("reason").str.starts_with("the worker died"))
    assert [Path(file).name for file in died["file"]] == ["unit-003"]


def deadly_beside_slow_chunk(task: ChunkTask) -> FittedChunk:
    """Die with the unit of folder unit-000 while that of another is being fitted."""
    if any(source.path.endswith("unit-000") for source in task.sources):
        time.sleep(0.3)
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(1.0)
    return toy_chunk(task)


@pytest.mark.slow
def test_a_unit_whose_worker_is_killed_by_another_unit_is_fitted(tmp_path, importable):
    """Dask counts a death for every task of the worker, and the two threads of this one always have both units."""
    make_units(tmp_path / "campaigns", 2)
    with LocalCluster(n_workers=1, threads_per_worker=2, dashboard_address=":0") as cluster, Client(cluster) as client:
        run_batch(tmp_path / "campaigns", MODEL, tmp_path, on_client(client, deadly_beside_slow_chunk), chunk=1)
    units = read_units(tmp_path)
    died = units.filter(pl.col("reason").str.starts_with("the worker died"))
    assert [Path(file).name for file in died["file"]] == ["unit-000"]
    assert units.height == 2


def started_by_hand(*command: str) -> subprocess.Popen:
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(HERE), os.environ.get("PYTHONPATH", "")])}
    return subprocess.Popen(
        [sys.executable, "-m", "distributed.cli.dask_" + command[0], *command[1:]], env=environment,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip


@pytest.mark.slow
def test_in_process_two_workers_and_an_external_scheduler_give_the_same_numbers(campaigns, tmp_path):
    run_batch(campaigns, MODEL, tmp_path / "one", in_process)
    with local_workers(2, fit_chunk) as executor:
        run_batch(campaigns, MODEL, tmp_path / "two", executor, chunk=5)
    address = "tcp://127.0.0.1:18786"
    scheduler = started_by_hand("scheduler", "--host", "127.0.0.1", "--port", "18786", "--no-dashboard")
    worker = started_by_hand("worker", address, "--nthreads", "1", "--no-dashboard")
    try:
        with cluster_workers(address, fit_chunk, 30.0) as executor:
            run_batch(campaigns, MODEL, tmp_path / "three", executor, chunk=3)
    finally:
        for process in (worker, scheduler):
            os.killpg(process.pid, signal.SIGTERM)
            process.wait()
    one = read_parameters(tmp_path / "one")
    for name in ("two", "three"):
        other = read_parameters(tmp_path / name)
        assert other.select("unit", "parameter").equals(one.select("unit", "parameter"))
        apart = np.abs(other["mean"].to_numpy() - one["mean"].to_numpy())
        assert np.all(apart <= 1e-6 * one["sd"].to_numpy())


@pytest.mark.slow
def test_a_killed_scheduler_ends_the_batch_and_run_again_it_goes_on(campaigns, expected, tmp_path):
    address = "tcp://127.0.0.1:18787"
    scheduler = started_by_hand("scheduler", "--host", "127.0.0.1", "--port", "18787", "--no-dashboard")
    worker = started_by_hand("worker", address, "--nthreads", "1", "--no-dashboard")
    try:
        with (
            pytest.raises(InputError, match="scheduler has gone"),
            cluster_workers(address, slow_toy_chunk, 30.0) as run,
        ):
            run_batch(
                campaigns, MODEL, tmp_path, run, chunk=1,
                progress=lambda state: os.killpg(scheduler.pid, signal.SIGKILL) if state.done == 3 else None,
            )  # fmt: skip
    finally:
        for process in (worker, scheduler):
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    assert 3 <= read_units(tmp_path).height < 12
    run_batch(campaigns, MODEL, tmp_path, toy_executor)
    assert_same_tables(tmp_path, expected)
