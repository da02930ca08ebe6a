"""The results folder of a batch: parts that appear as a whole, and what is done already, read from them alone.

Nothing else says what is done.  One process writes at a time; a part that was being written when that process died is
a hidden folder, which the next one removes.  A unit without estimates has a part of its own, which is removed when the
unit is to be tried again: its file has changed, or all failures are to be retried.
"""

import hashlib
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import polars as pl

from imubayes.atomic_files import new_folder, replacing
from imubayes.batch.posterior_table import (
    MODEL_FILE,
    PARAMETER_FILE,
    UNIT_FILE,
    UnitPosterior,
    model_folder,
    parameter_table,
    part_folder,
    unit_table,
)
from imubayes.batch.unit_sources import DIGITS, UnitSource
from imubayes.process_lock import only_writer


@dataclass(frozen=True)
class DoneUnit:
    """A unit that a part holds: its digest, file, status, the part, and what its file was when the unit failed."""

    digest: str
    file: str
    status: str
    part: Path
    fingerprint: str


@dataclass(frozen=True)
class PartFiles:
    """The parts of one model in a results folder; `key` is that of model, settings and code."""

    results: Path
    key: str
    code: str

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Hold the folder for writing; raises InputError where another process holds it."""
        self.results.mkdir(parents=True, exist_ok=True)
        with only_writer(self.results):
            for scratch in model_folder(self.results, self.key).glob(".part-*"):
                shutil.rmtree(scratch)
            yield

    def keep_model(self, text: bytes) -> None:
        """Keep the model file beside the parts."""
        file = model_folder(self.results, self.key) / MODEL_FILE
        if not file.exists():
            with replacing(file, durable=True) as scratch:
                scratch.write_bytes(text)

    def done(self) -> list[DoneUnit]:
        """Return the units that the parts hold, in the order of the parts."""
        found: list[DoneUnit] = []
        for file in sorted(model_folder(self.results, self.key).glob(f"part-*/{UNIT_FILE}")):
            columns = pl.read_parquet(file, columns=["digest", "file", "status", "fingerprint"])
            found.extend(
                DoneUnit(digest, at, status, file.parent, was) for digest, at, status, was in columns.iter_rows()
            )
        return found

    def write(self, units: Sequence[UnitPosterior]) -> None:
        """Write units as a part, those without estimates as a part each."""
        fitted = [unit for unit in units if unit.outcome.status == "fitted"]
        others = [[unit] for unit in units if unit.outcome.status != "fitted"]
        for chosen in ([fitted] if fitted else []) + others:
            digests = [unit.identity.digest for unit in chosen]
            with new_folder(part_folder(self.results, self.key, _part_key(self.key, digests)), durable=True) as scratch:
                parameter_table(self.key, chosen).write_parquet(scratch / PARAMETER_FILE)
                unit_table(self.key, self.code, chosen).write_parquet(scratch / UNIT_FILE)

    def remove(self, part: Path) -> None:
        """Remove a part as a whole."""
        hidden = part.with_name(f".{part.name}-removed")
        part.rename(hidden)
        shutil.rmtree(hidden)


def _part_key(key: str, digests: Sequence[str]) -> str:
    return hashlib.sha256("\0".join([key, *sorted(digests)]).encode()).hexdigest()[:DIGITS]


def still_to_do(parts: PartFiles, sources: Sequence[UnitSource], retry: bool) -> list[UnitSource]:
    """Return the campaigns without a result; results of failures that are out of date are removed.

    Parameters
    ----------
    retry : whether all failures are tried again.
    """
    by_path = {source.path: source for source in sources}
    kept = set()
    for unit in parts.done():
        source = by_path.get(unit.file)
        changed = source is None or source.digest != unit.digest or source.fingerprint() != unit.fingerprint
        if unit.status != "fitted" and (retry or changed):
            parts.remove(unit.part)
        else:
            kept.add(unit.digest)
    return [source for source in sources if source.digest not in kept]
