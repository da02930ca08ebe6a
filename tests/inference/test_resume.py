"""Kill −9 while sampling, then resume: the same chain, bit for bit; and what is of another fit is refused."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

from imubayes.api import Settings, fit
from imubayes.foundations.errors import InputError
from imubayes.inference.checkpoint import Checkpoint

ROOT = Path(__file__).parents[2]
STEPS = 60  # those of the whole chain
SCRIPT = """
import sys
import jax
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_compilation_cache_dir", sys.argv[3])
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
import imubayes
imubayes.fit(
    "data/accel-channel", "models/accel-channel.toml", sys.argv[1], seed=3,
    settings=imubayes.Settings(least_steps=int(sys.argv[2]), most_steps=int(sys.argv[2])),
)
"""


def resumed(out: Path) -> None:
    """The same fit as that of the script, in this process."""
    settings = Settings(least_steps=STEPS, most_steps=STEPS)
    paths = ROOT / "data" / "accel-channel", ROOT / "models" / "accel-channel.toml", out
    fit(*paths, seed=3, resume=True, settings=settings)


def chain(folder: Path) -> np.ndarray:
    with h5py.File(folder / "checkpoint.h5", "r") as file:
        return np.stack([file[f"ensemble_{number}"]["chain"][...] for number in range(4)])


def steps_done(folder: Path) -> int:
    try:
        with h5py.File(folder / "checkpoint.h5", "r") as file:
            return int(file["ensemble_3"].attrs["iteration"])
    except OSError:
        return 0


def test_killed_and_resumed_is_the_same_chain(sampled_channel, tmp_path, command_environment):
    whole, killed = sampled_channel, tmp_path / "killed"
    cache = Path(command_environment["XDG_CACHE_HOME"]) / "imubayes" / "compiled"
    words = [sys.executable, "-c", SCRIPT, str(killed), str(STEPS), str(cache)]
    process = subprocess.Popen(words, cwd=ROOT, env=command_environment)
    while not 0 < steps_done(killed) < STEPS and process.poll() is None:
        time.sleep(0.002)
    process.send_signal(signal.SIGKILL)
    process.wait()
    done = steps_done(killed)
    assert 0 < done < STEPS, "the kill came too late to mean anything"
    resumed(killed)
    np.testing.assert_array_equal(chain(killed), chain(whole))
    assert len(np.unique(chain(whole)[:, -1])) > 1000


@pytest.fixture
def checkpoint(tmp_path) -> Checkpoint:
    prints = {"data": "d", "model": "m", "parameters": "p", "sampler": "s"}
    made = Checkpoint(tmp_path / "checkpoint.h5", 2, 8, 3, prints)
    made.create()
    return made


@pytest.mark.parametrize("key", ["data", "model", "parameters", "sampler"])
def test_checkpoint_of_another_fit_is_refused(checkpoint, key):
    checkpoint.check()
    other = Checkpoint(checkpoint.path, 2, 8, 3, checkpoint.fingerprints | {key: "other"})
    with pytest.raises(InputError, match="of another fit"):
        other.check()


def test_missing_and_damaged_checkpoints_are_refused(checkpoint, tmp_path):
    with pytest.raises(InputError, match="nothing to resume"):
        Checkpoint(tmp_path / "none.h5", 2, 8, 3, {}).check()
    checkpoint.path.write_bytes(checkpoint.path.read_bytes()[:100])
    with pytest.raises(InputError, match="cannot be read"):
        checkpoint.check()
