"""A disk that fills up while HDF5 files are written: an error of the system, and what was there before."""

import errno
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from imubayes.inference.checkpoint import Checkpoint
from imubayes.results.posterior_groups import Group, Groups, Labelled
from imubayes.results.result_folder import write_posterior


@contextmanager
def room_for(most: int) -> Iterator[None]:
    """Let no file of this process grow beyond a size, as on a disk that is nearly full."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def write_draws(file: Path) -> None:
    draws = Labelled(("chain", "draw"), np.random.default_rng(0).normal(size=(4, 5000)))
    places = {name: Labelled((name,), np.arange(size)) for name, size in (("chain", 4), ("draw", 5000))}
    write_posterior(Groups({"posterior": Group({"scale": draws}, places)}, {"creation_library": "imubayes"}), file)


def test_draws_that_find_no_room(tmp_path):
    with room_for(20_000), pytest.raises(OSError, match="too large") as caught:
        write_draws(tmp_path / "posterior.nc")
    assert caught.value.errno == errno.EFBIG
    write_draws(tmp_path / "posterior.nc")


@pytest.mark.slow
def test_a_block_of_sampling_that_finds_no_room_leaves_the_checkpoint(tmp_path):
    checkpoint = Checkpoint(tmp_path / "checkpoint.h5", 2, 8, 3, {"data": "d"})
    checkpoint.create()
    before = checkpoint.path.read_bytes()

    def sample() -> None:
        with checkpoint.block() as backends:
            for backend in backends:
                backend.grow(5000, None)
                with backend.open("a") as file:
                    file[backend.name]["chain"][...] = 1.0

    with room_for(len(before) + 10_000), pytest.raises(OSError, match="too large") as caught:
        sample()
    assert caught.value.errno == errno.EFBIG
    assert checkpoint.path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["checkpoint.h5"]
    sample()
    assert len(checkpoint.path.read_bytes()) > 10 * len(before)
