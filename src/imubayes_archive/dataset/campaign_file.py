"""One campaign as one Parquet file: rows of all runs as a table, everything else as JSON in its metadata.

A row of the table is a row of a run.  The columns are the run, the covariates in SI, `samples`, and for each channel
`observed_<channel>` and `sd_<channel>` in output units.  A covariate that a run lacks is null there; a missing value is
NaN.  Other arrays of a run, such as the transitions of a free tumble, stand as lists in its first row.  The checksum is
that of the campaign's content, not of the file: it is computed anew from what was read.  Fields that records were given
after a file was written have their defaults in it, and no part in its checksum.
"""

import dataclasses
import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from imubayes.foundations.campaign_data import (
    Campaign,
    Channel,
    Instruments,
    Mounting,
    Run,
    Site,
    Table,
    Thermometer,
    Tumble,
)
from imubayes.foundations.errors import InputError, input_error

SCHEMA_VERSION = 1
_KEY = b"imubayes"
_EQUIPMENT = ((Table, "tables"), (Mounting, "mountings"), (Thermometer, "thermometers"))
_TUMBLE = "tumble_"
_OF_ROWS = ("covariates", "observed", "samples", "sample_sd")

StoredFields = Mapping[type, frozenset[str]]
"""The fields of each class of records that a file holds; of a class that it does not name, all."""


@dataclass(frozen=True)
class ArchivedCampaign:
    """What the metadata of a file say of its campaign.

    Attributes
    ----------
    file : the file.
    unit, name : serial number of the unit, the name of the campaign if it has none; the name of the campaign.
    date : ISO date of the first run; empty if no run is dated.
    digest : SHA-256 of the files that it was packed from.
    source : the folder that it was packed from.
    runs, rows, channels : their numbers.
    checksum : SHA-256 of the content.
    """

    file: Path
    unit: str
    name: str
    date: str
    digest: str
    source: str
    runs: int
    rows: int
    channels: int
    checksum: str


def unit_of(campaign: Campaign) -> str:
    """Return the serial number of the unit; the name of the campaign if it has none."""
    return campaign.serial or campaign.name


def date_of(campaign: Campaign) -> str:
    """Return the ISO date of the first run that is dated; empty if none is."""
    return min((run.start[:10] for run in campaign.runs if run.start), default="")


def content_checksum(campaign: Campaign, stored: StoredFields = MappingProxyType({})) -> str:
    """Return the SHA-256 of everything that a campaign record holds, or of the fields that a file holds of it."""
    digest = hashlib.sha256()
    for part in _parts(campaign, stored):
        digest.update(part)
    return digest.hexdigest()


def _parts(value: Any, stored: StoredFields) -> Iterator[bytes]:
    if isinstance(value, np.ndarray):
        yield f"{value.dtype.str}{value.shape}".encode()
        # All values that are not a number are one.
        plain = np.where(np.isnan(value), np.nan, value) if value.dtype.kind == "f" else value
        yield np.ascontiguousarray(plain).tobytes()
    elif dataclasses.is_dataclass(value):
        for name in _held_fields(value, stored):
            yield name.encode()
            yield from _parts(getattr(value, name), stored)
    elif isinstance(value, Mapping):
        for key, part in value.items():
            yield str(key).encode()
            yield from _parts(part, stored)
    elif isinstance(value, tuple | list):
        yield str(len(value)).encode()
        for part in value:
            yield from _parts(part, stored)
    else:
        yield repr(value).encode()


def _held_fields(record: Any, stored: StoredFields) -> list[str]:
    names = [each.name for each in dataclasses.fields(record)]
    return [name for name in names if name in stored.get(type(record), names)]


def write_campaign(campaign: Campaign, file: Path) -> None:
    """Write a campaign to a Parquet file."""
    head = {"format": SCHEMA_VERSION, **_stated(campaign), "campaign": _encoded(campaign)}
    table = _rows(campaign).replace_schema_metadata({_KEY: json.dumps(head).encode()})
    pq.write_table(
        table, file, compression="zstd", write_statistics=False,
        write_page_checksum=True,
    )  # fmt: skip


def _stated(campaign: Campaign, stored: StoredFields = MappingProxyType({})) -> dict[str, Any]:
    return {
        "unit": unit_of(campaign),
        "date": date_of(campaign),
        "rows": sum(run.rows for run in campaign.runs),
        "checksum": content_checksum(campaign, stored),
    }


def _stored_fields(campaign: Mapping[str, Any]) -> StoredFields:
    """Return the fields that a campaign holds as it is encoded; those of later versions are not among them."""
    runs = [(Run, {**run, **dict.fromkeys(_OF_ROWS)}) for run in campaign["runs"]]
    equipment = [(kind, each) for kind, name in _EQUIPMENT for each in campaign.get(name, {}).values()]
    equipment += [(Instruments, campaign["instruments"])] if "instruments" in campaign else []
    channels = [(Channel, each) for each in campaign["channels"]]
    tumbles = [(Tumble, each) for run in campaign["runs"] if (each := _of_tumble(run["arrays"]))]
    records = [(Campaign, campaign), (Site, campaign["site"]), *channels, *equipment, *runs, *tumbles]
    return {kind: frozenset(each) for kind, each in records}


def _of_tumble(arrays: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arrays of a tumble by the names of its fields."""
    return {name.removeprefix(_TUMBLE): array for name, array in arrays.items() if name.startswith(_TUMBLE)}


def read_head(file: Path) -> ArchivedCampaign:
    """Return what the metadata of a file say; raises InputError if it is no file of an archive."""
    head = _head(file, pq.read_metadata, lambda metadata: metadata.metadata)
    try:
        campaign = head["campaign"]
        return ArchivedCampaign(
            file, head["unit"], campaign["name"], head["date"], campaign["digest"], campaign["folder"],
            len(campaign["runs"]), head["rows"], len(campaign["channels"]), head["checksum"],
        )  # fmt: skip
    except (KeyError, TypeError) as error:
        raise _damaged(file, f"its metadata lack {error}") from error


def read_campaign(file: Path) -> Campaign:
    """Return the campaign of a file.

    Raises
    ------
    InputError
        if the file is damaged: it cannot be read, or its content does not have the checksum it was written with.
    """
    found: list[pa.Table] = []

    def read(path: Path) -> pa.Table:
        found.append(pq.ParquetFile(path, page_checksum_verification=True).read(use_threads=False))
        return found[0]

    head = _head(file, read, lambda table: table.schema.metadata)
    try:
        campaign = _campaign(head["campaign"], found[0])
        stated = _stated(campaign, _stored_fields(head["campaign"]))
        damaged = any(head[key] != value for key, value in stated.items())
    except (KeyError, ValueError, TypeError, pa.ArrowException):
        campaign, damaged = None, True
    if damaged or campaign is None:
        raise _damaged(file, "its content does not have the checksum that it was written with")
    return campaign


def _head(file: Path, read: Any, metadata: Any) -> Any:
    try:
        text = (metadata(read(file)) or {}).get(_KEY)
    except (OSError, pa.ArrowException) as error:
        raise _damaged(file, f"it cannot be read: {str(error).splitlines()[0]}") from error
    if text is None:
        raise _damaged(file, "it is not a campaign of an archive")
    try:
        head = json.loads(text)
    except ValueError as error:
        raise _damaged(file, "its metadata are not JSON") from error
    if head.get("format") != SCHEMA_VERSION:
        raise input_error(
            f"the file has schema version {head.get('format')}",
            str(file),
            f"version {SCHEMA_VERSION}",
            "read it with the version of imubayes that wrote it, or pack the campaign again",
        )
    return head


def _damaged(file: Path, why: str) -> InputError:
    return input_error(
        f"the archived campaign is damaged: {why}",
        str(file),
        "a file as `imubayes archive pack` wrote it",
        "remove the file and pack the campaign again from its folder",
    )


def _rows(campaign: Campaign) -> pa.Table:
    """Return the rows of all runs as one table."""
    runs, counts = campaign.runs, [run.rows for run in campaign.runs]
    columns: dict[str, Any] = {"run": pa.array(np.repeat([run.name for run in runs], counts).tolist(), pa.string())}
    columns |= _covariates(runs, counts)
    columns["samples"] = np.concatenate([run.samples for run in runs])
    observed, deviation = (np.concatenate([getattr(run, name) for run in runs]) for name in ("observed", "sample_sd"))
    for place, channel in enumerate(campaign.channels):
        columns |= {f"observed_{channel.name}": observed[:, place], f"sd_{channel.name}": deviation[:, place]}
    first = np.cumsum([0, *counts[:-1]])
    for place, run in zip(first.tolist(), runs, strict=True):
        for name, array in _arrays(run):
            column = columns.setdefault(f"array_{name}", [None] * sum(counts))
            column[place] = array.reshape(-1).tolist()
    return pa.table({name: pa.array(column, from_pandas=False) for name, column in columns.items()})


def _covariates(runs: Sequence[Run], counts: Sequence[int]) -> dict[str, pa.Array]:
    """Return the covariates of all runs, null where a run lacks one."""
    columns = {}
    for name in dict.fromkeys(name for run in runs for name in run.covariates):
        known = np.repeat([name in run.covariates for run in runs], counts)
        values = np.concatenate([run.covariates.get(name, np.zeros(run.rows)) for run in runs])
        columns[name] = pa.array(values, mask=~known, from_pandas=False)
    return columns


def _arrays(run: Run) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the arrays of a run that are no columns of rows, by name."""
    if run.attitude is not None:
        yield "attitude", run.attitude
    if run.tumble is not None:
        for each in dataclasses.fields(run.tumble):
            yield f"{_TUMBLE}{each.name}", getattr(run.tumble, each.name)


def _encoded(value: Any) -> Any:
    """Return a record as JSON, the columns and lists of its runs left out."""
    if isinstance(value, Run):
        plain = {f.name: _encoded(getattr(value, f.name)) for f in dataclasses.fields(value) if f.name not in _OF_ROWS}
        shapes = {name: [array.dtype.str, list(array.shape)] for name, array in _arrays(value)}
        plain |= {"attitude": None, "tumble": None, "covariates": list(value.covariates), "arrays": shapes}
        return plain | {"rows": value.rows, "types": [value.samples.dtype.str, value.observed.dtype.str]}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {each.name: _encoded(getattr(value, each.name)) for each in dataclasses.fields(value)}
    if isinstance(value, np.ndarray):
        return {"array": value.tolist()}
    if isinstance(value, Mapping):
        return {key: _encoded(part) for key, part in value.items()}
    if isinstance(value, tuple | list):
        return [_encoded(part) for part in value]
    return value.item() if isinstance(value, np.generic) else value


def _decoded(value: Any) -> Any:
    if isinstance(value, dict):
        if set(value) == {"array"}:
            return np.array(value["array"], dtype=float)
        return {key: _decoded(part) for key, part in value.items()}
    return tuple(_decoded(part) for part in value) if isinstance(value, list) else value


def _campaign(head: dict[str, Any], table: pa.Table) -> Campaign:
    plain = {key: _decoded(value) for key, value in head.items() if key != "runs"}
    plain["site"] = Site(**plain["site"])
    plain["channels"] = tuple(Channel(**each) for each in plain["channels"])
    for kind, section in _EQUIPMENT:
        plain[section] = {name: kind(**each) for name, each in plain.get(section, {}).items()}
    if "instruments" in plain:
        plain["instruments"] = Instruments(**plain["instruments"])
    columns = _numbers(table)
    names, start, runs = [channel.name for channel in plain["channels"]], 0, []
    for each in head["runs"]:
        rows = slice(start, start + each["rows"])
        runs.append(_run(dict(each), columns, names, rows, table))
        start = rows.stop
    return Campaign(**plain, runs=tuple(runs))


def _numbers(table: pa.Table) -> dict[str, np.ndarray]:
    """Return the numeric columns; null becomes NaN."""
    chosen = [name for name in table.column_names if name != "run" and not name.startswith("array_")]
    return {name: table.column(name).to_numpy() for name in chosen}


def _run(entry: dict[str, Any], columns: dict[str, np.ndarray], names: list[str], rows: slice, table: pa.Table) -> Run:
    shapes, types = entry.pop("arrays"), entry.pop("types")
    entry.pop("rows")

    def of_channels(prefix: str) -> np.ndarray:
        return np.stack([columns[f"{prefix}_{name}"][rows] for name in names], axis=1).astype(types[1])

    arrays = {
        name: np.array(table.column(f"array_{name}")[rows.start].as_py(), dtype=np.dtype(kind)).reshape(shape)
        for name, (kind, shape) in shapes.items()
    }
    tumble = _of_tumble(arrays)
    covariates = {name: columns[name][rows] for name in entry.pop("covariates")}
    entry |= {"attitude": arrays.get("attitude"), "tumble": Tumble(**tumble) if tumble else None}
    return Run(
        **{key: _decoded(value) for key, value in entry.items() if key not in ("attitude", "tumble")},
        attitude=entry["attitude"],
        tumble=entry["tumble"],
        covariates=covariates,
        observed=of_channels("observed"),
        samples=columns["samples"][rows].astype(types[0]),
        sample_sd=of_channels("sd"),
    )
