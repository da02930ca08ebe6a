"""Checkpoints of the ensembles: emcee's HDF backend, replaced as a whole.

A kill at any instant leaves the last complete one.  A checkpoint carries fingerprints of the data, the model, the order
of the parameters and the settings of the sampler.  One that differs in any of them is refused: a chain continued on
other data would look like an answer.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

from imubayes.foundations.deferred_modules import DeferredModule
from imubayes.foundations.errors import input_error
from imubayes.foundations.files import replacing

if TYPE_CHECKING:
    import emcee
else:
    emcee = DeferredModule("emcee")  # takes long to import, and only sampling needs it

_WORDS = {
    "data": "the data have changed",
    "model": "the model has changed",
    "parameters": "the parameters or their order have changed",
    "sampler": "the seed or the size of the ensembles has changed",
}


class Checkpoint:
    """A file that holds the chains of several ensembles.

    Parameters
    ----------
    path : of the file.
    ensembles, walkers, dimensions : sizes.
    fingerprints : of data, model, parameters and sampler.
    """

    def __init__(self, path: Path, ensembles: int, walkers: int, dimensions: int, fingerprints: Mapping[str, str]):
        self.path = path
        self.ensembles, self.walkers, self.dimensions = ensembles, walkers, dimensions
        self.fingerprints = dict(fingerprints)

    def _names(self) -> list[str]:
        return [f"ensemble_{number}" for number in range(self.ensembles)]

    def create(self) -> None:
        """Begin anew."""
        with self._replaced() as file:
            for name in self._names():
                self._backend(file, name).reset(self.walkers, self.dimensions)
            file.attrs.update(self.fingerprints)

    def check(self) -> None:
        """Raise InputError unless the file belongs to this fit."""
        if not self.path.is_file():
            raise input_error("there is nothing to resume", str(self.path), "a checkpoint", "leave --resume out")
        try:
            with h5py.File(self.path, "r") as file:
                found = {key: str(file.attrs.get(key, "")) for key in self.fingerprints}
        except OSError as error:
            raise input_error(
                f"the checkpoint cannot be read ({error})",
                str(self.path),
                "a checkpoint written by this command",
                "remove the file and start again",
            ) from None
        changed = [key for key, value in self.fingerprints.items() if found[key] != value]
        if changed:
            raise input_error(
                "the checkpoint is of another fit: " + "; ".join(_WORDS.get(key, key) for key in changed),
                str(self.path),
                "the same data, model, parameter order, seed and ensemble size",
                "restore them, or choose another --out and start again",
            )

    @contextmanager
    def block(self) -> "Iterator[list[emcee.backends.HDFBackend]]":
        """Give backends to sample a block into; their content becomes the checkpoint when the block is complete."""
        with self._replaced(self.path.read_bytes()) as file:
            yield [self._backend(file, name) for name in self._names()]

    @contextmanager
    def _replaced(self, content: bytes | None = None) -> Iterator[h5py.File]:
        """Give a file in memory that becomes the checkpoint: HDF5 crashes the process if the disk is full."""
        with h5py.File.in_memory(content) as file:
            yield file
            file.flush()
            made = file.id.get_file_image()
        with replacing(self.path, durable=True) as scratch:
            scratch.write_bytes(made)

    def _backend(self, file: h5py.File, name: str) -> "emcee.backends.HDFBackend":
        """Return a backend on a file that is open, and stays so."""
        found = emcee.backends.HDFBackend(str(self.path), name=name)
        vars(found)["open"] = lambda mode="r": nullcontext(file)
        return found

    def read(self) -> "list[emcee.backends.HDFBackend]":
        """Return read-only backends on what is there."""
        return [emcee.backends.HDFBackend(str(self.path), name=name, read_only=True) for name in self._names()]

    def chains(self) -> tuple[np.ndarray, np.ndarray]:
        """Return points (ensembles, steps, walkers, dimensions) and log densities without the last axis."""
        if self.steps == 0:
            empty = np.zeros((self.ensembles, 0, self.walkers))
            return np.zeros((*empty.shape, self.dimensions)), empty
        backends = self.read()
        return (
            np.stack([np.asarray(backend.get_chain()) for backend in backends]),
            np.stack([np.asarray(backend.get_log_prob()) for backend in backends]),
        )

    @property
    def steps(self) -> int:
        """Number of whole steps of all ensembles."""
        return steps_in(self.path)


def append(backend: "emcee.backends.HDFBackend", block: "emcee.backends.Backend") -> None:
    """Append the steps of a block in memory to a backend, at once: one by one they take longer than sampling does."""
    steps = block.iteration
    backend.grow(steps, None)
    with backend.open("a") as file:
        group: Any = file[backend.name]
        taken = int(group.attrs["iteration"])
        group["chain"][taken : taken + steps] = block.get_chain()
        group["log_prob"][taken : taken + steps] = block.get_log_prob()
        group["accepted"][:] += block.accepted
        for place, value in enumerate(block.random_state or ()):
            group.attrs[f"random_state_{place}"] = value
        group.attrs["iteration"] = taken + steps


def steps_in(path: Path) -> int:
    """Return how many whole steps a checkpoint holds; 0 if there is none or it cannot be read."""
    try:
        with h5py.File(path, "r") as file:
            return min((int(ensemble.attrs["iteration"]) for ensemble in file.values()), default=0)  # pyright: ignore
    except (OSError, KeyError):
        return 0
