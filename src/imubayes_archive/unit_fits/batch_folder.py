"""The results folder of a batch: its key, the campaigns to fit, and the parts that say which of them are done.

The model, the settings and the code determine the numbers of a batch; together they name its results.  The campaigns
are the files of an archive, or campaign folders.  A campaign is identified by the first digits of the SHA-256 of the
files it was recorded in.  An archive has these digits in the names of its files, so what is done already is known
without opening one.

Parts appear as a whole, and nothing else says what is done.  One process writes at a time.  A part that was being
written when that process died is a hidden folder, which the next process removes.  A unit without estimates has a part
of its own, which is removed when the unit is to be tried again: its file has changed, or all failures are to be
retried.
"""

import datetime
import hashlib
import math
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal
from urllib.parse import unquote

import polars as pl
import tomlkit

from imubayes import load_campaign
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.errors import input_error
from imubayes.foundations.files import new_folder, only_writer, replacing
from imubayes.model.model_file import ModelSpec
from imubayes.results.folder_files import seal
from imubayes_archive.dataset.campaign_file import date_of, read_campaign, unit_of
from imubayes_archive.dataset.store import Archive, campaign_folders, folder_digest
from imubayes_archive.unit_fits import posterior_table as tables

Sampling = Literal["all", "flagged", "none"]
"""Which units are sampled by emcee: all, those whose Laplace approximation is in doubt, or none."""
_DIGITS, _NOISE_FILE = 12, "noise-priors.toml"
# Packages that show results or read commands decide no number.
_SOURCES = ("imubayes", "imubayes_archive")
_SHOWN = tuple(f"{package}/{part}" for package in _SOURCES for part in ("display", "cli", "api/"))


@dataclass(frozen=True)
class BatchSettings:
    """How each unit is treated.

    Attributes
    ----------
    sample : which units are sampled.
    diagnose : whether each fit is diagnosed.
    seed : of the sampler.
    """

    sample: Sampling = "none"
    diagnose: bool = False
    seed: int = 0


def batch_key(spec: ModelSpec, settings: BatchSettings) -> str:
    """Return the hash of model, settings and code, under which results are kept."""
    sources = [Path(file).read_text(encoding="utf-8") for file in spec.files]
    noise = () if spec.noise_priors is None else _stated(spec.noise_priors)
    stated = (*_stated(spec), *sources, repr(spec.delta_k_threshold), *noise)
    return _digest(spec.name, *stated, repr(settings), code_version())


def _stated(spec: ModelSpec) -> list[str]:
    """Return what a model says of effects and correlations, wherever it says so."""
    return sorted(repr(replace(each, where="")) for each in (*spec.effects, *spec.correlations))


@cache
def code_version() -> str:
    """Return the version of the package and the hash of those of its sources that decide numbers."""
    root = Path(__file__).parents[2]
    files = sorted(file.relative_to(root).as_posix() for name in _SOURCES for file in (root / name).rglob("*.py"))
    chosen = [name for name in files if not name.startswith(_SHOWN)]
    content = [(root / name).read_text(encoding="utf-8") for name in chosen]
    return f"{version('imubayes')}+{_digest(*chosen, *content)}"


def _digest(*texts: str) -> str:
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()[:_DIGITS]


DIGITS = 16
"""Digits of a digest that identify a campaign."""


@dataclass(frozen=True)
class UnitSource:
    """Where a campaign is: a file of an archive or a folder; `digest` has `DIGITS` digits."""

    digest: str
    unit: str
    name: str
    path: str
    archived: bool

    @staticmethod
    def of_row(row: Mapping[str, Any]) -> "UnitSource":
        """Return the source of a row of the table of units."""
        return UnitSource(row["digest"], row["unit"], row["campaign"], row["file"], row["file"].endswith(".parquet"))

    def read(self) -> Campaign:
        """Return the campaign; raises InputError if it cannot be used."""
        return read_campaign(Path(self.path)) if self.archived else load_campaign(self.path)

    def fingerprint(self) -> str:
        """Return a digest of what stands there now, whatever it is; empty if it is gone."""
        path = Path(self.path)
        try:
            return hashlib.sha256(path.read_bytes()).hexdigest()[:DIGITS] if self.archived else folder_digest(path)
        except OSError:
            return ""


def sources_of(place: str | Path) -> list[UnitSource]:
    """Return the campaigns of an archive, or in and below a folder, each once, ordered by unit.

    Raises
    ------
    InputError
        if there is none.
    """
    files = Archive(Path(place)).files()
    found = _archived(files) if files else _folders(place)
    return sorted({source.digest: source for source in reversed(list(found))}.values(), key=_order)


def _order(source: UnitSource) -> tuple[str, str]:
    return source.unit, source.path


def _archived(files: Sequence[Path]) -> Iterator[UnitSource]:
    for file in files:
        name, digest = file.stem[: -DIGITS - 1], file.stem[-DIGITS:]
        yield UnitSource(digest, unquote(file.parent.name.removeprefix("unit=")), name, str(file), True)


def _folders(place: str | Path) -> Iterator[UnitSource]:
    try:
        folders = campaign_folders([place])
    except OSError as error:
        raise input_error(
            f"the folder cannot be read: {error.strerror}", str(place), "a readable folder", "correct its permissions"
        ) from error
    for folder in folders:
        yield UnitSource(folder_digest(folder)[:DIGITS], folder.name, folder.name, str(folder), False)


def identity_of(campaign: Campaign, source: UnitSource, structure: str = "") -> tables.UnitIdentity:
    """Return which campaign it is, on which equipment and where."""
    return tables.UnitIdentity(
        unit=unit_of(campaign),
        campaign=campaign.name,
        digest=source.digest,
        file=source.path,
        date=_date(date_of(campaign)),
        structure=structure,
        tables=tuple(sorted({run.table for run in campaign.runs if run.table})),
        mountings=tuple(sorted({run.mounting for run in campaign.runs if run.mounting})),
        procedures=tuple(sorted({run.procedure for run in campaign.runs})),
        labels=tuple(f"{name}={value}" for name, value in sorted(campaign.labels.items())),
        latitude=math.degrees(campaign.site.latitude),
        height=campaign.site.height,
        gravity=campaign.site.gravity,
    )


def unread(source: UnitSource) -> tables.UnitIdentity:
    """Return what is known of a campaign that cannot be read."""
    return tables.UnitIdentity(source.unit, source.name, source.digest, source.path)


def _date(text: str) -> datetime.date | None:
    try:
        return datetime.date.fromisoformat(text)
    except ValueError:
        return None


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
        """Hold the folder for writing; raises InputError if another process holds it."""
        self.results.mkdir(parents=True, exist_ok=True)
        with only_writer(self.results):
            for scratch in tables.model_folder(self.results, self.key).glob(".part-*"):
                shutil.rmtree(scratch)
            yield

    def keep_model(self, model: Path, spec: ModelSpec) -> None:
        """Keep the model file beside the parts, with the files that it names."""
        folder = tables.model_folder(self.results, self.key)
        if (folder / tables.MODEL_FILE).exists():
            return
        document = tomlkit.parse(model.read_text(encoding="utf-8"))
        named = {folder / Path(file).relative_to(model.parent): Path(file) for file in spec.files}
        if spec.noise_priors is not None:
            document["noise_priors"] = _NOISE_FILE
            named[folder / _NOISE_FILE] = Path(spec.noise_priors.where)
        kept = {place: file.read_bytes() for place, file in named.items()}
        for place, content in (*kept.items(), (folder / tables.MODEL_FILE, tomlkit.dumps(document).encode())):
            with replacing(place, durable=True) as scratch:
                scratch.write_bytes(content)
        seal(folder, tables.MODEL_FILE, *(place.name for place in kept if place.parent == folder))

    def done(self) -> list[DoneUnit]:
        """Return the units that the parts hold, in the order of the parts."""
        found: list[DoneUnit] = []
        for part in tables.whole_parts(tables.model_folder(self.results, self.key)):
            columns = pl.read_parquet(part / tables.UNIT_FILE, columns=["digest", "file", "status", "fingerprint"])
            found.extend(DoneUnit(digest, at, status, part, was) for digest, at, status, was in columns.iter_rows())
        return found

    def write(self, units: Sequence[tables.UnitPosterior]) -> None:
        """Write units as a part, those without estimates as a part each."""
        fitted = [unit for unit in units if unit.outcome.status == "fitted"]
        others = [[unit] for unit in units if unit.outcome.status != "fitted"]
        for chosen in ([fitted] if fitted else []) + others:
            digests = [unit.identity.digest for unit in chosen]
            with new_folder(
                tables.part_folder(self.results, self.key, _part_key(self.key, digests)), durable=True
            ) as scratch:
                tables.parameter_table(self.key, chosen).write_parquet(scratch / tables.PARAMETER_FILE)
                tables.unit_table(self.key, self.code, chosen).write_parquet(scratch / tables.UNIT_FILE)
                seal(scratch)

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
