"""A campaign of arrays or data frames: what `campaign.toml` says as a mapping, and the columns of each run.

Keys, units and checks are those of a campaign folder, of which one can be written.
"""

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from imubayes.campaign.campaign_reader import CAMPAIGN_FILE, inspect_document, load_campaign
from imubayes.campaign.campaign_writer import write_campaign
from imubayes.campaign.file_schemas import CampaignFile, RunEntry
from imubayes.campaign.run_tables import TableFile, TableInMemory
from imubayes.campaign.toml_documents import Ledger, plain_content, validated
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.errors import InputError, closest_first, input_error

_COLUMNS = "a data frame, or a mapping of column names to one-dimensional arrays of equal length"


def build_campaign(content: Any, runs: Any, folder: str | Path | None = None) -> Campaign:
    """Return a campaign of arrays or data frames, checked as a campaign folder is.

    Parameters
    ----------
    content : keys and values of `campaign.toml` (`imubayes schema campaign`), with lists of mappings for its channels,
        tables, mountings and runs.  `format` and the `file` of a run are not needed.
    runs : name of a run → its columns, in the units of their names: a data frame of Polars, pandas or Arrow, or a
        mapping of names to arrays.  NaN and null are missing values.
    folder : where to write the campaign, as a campaign folder.  A result that is kept needs one, because it reads the
        data again.

    Raises
    ------
    InputError
        with every issue of the campaign.

    Examples
    --------
    >>> import numpy as np
    >>> import imubayes
    >>> angle = np.arange(0.0, 360.0, 45.0)
    >>> content = {
    ...     "name": "bench",
    ...     "site": {"latitude_deg": 48.1, "height_m": 520.0},
    ...     "channel": [
    ...         {"name": "ax", "kind": "accelerometer", "input_axis": [1, 0, 0], "output_unit": "V", "scale": 2.5,
    ...          "per": "g", "noise": 1e-4}
    ...     ],
    ...     "table": [{"name": "head", "elevation_deg": 0.0}],
    ...     "mounting": [{"name": "flat", "preset": "aligned", "uncertainty_arcmin": 5.0}],
    ...     "run": [{"name": "tumble", "procedure": "dividing_head", "table": "head", "mounting": "flat"}],
    ... }
    >>> outputs = -2.5 * np.sin(np.radians(angle))  # x of the table sinks from the horizontal
    >>> campaign = imubayes.build_campaign(content, {"tumble": {"table_angle_deg": angle, "ax": outputs}})
    >>> campaign.runs[0].rows
    8
    """
    if not isinstance(runs, Mapping):
        what = f"the columns of the runs are of type {type(runs).__name__}"
        raise input_error(what, "runs", f"a mapping of names of runs to {_COLUMNS}", "give such a mapping")
    document, tables = _document(content), {}
    for run in _named_runs(document):
        if (name := str(run.get("name", ""))) in runs:
            tables[name] = TableInMemory(f"columns of run '{name}'", _table(name, runs[name]))
    _refuse_unused(runs, [str(run.get("name", "")) for run in _named_runs(document)])
    inspection = inspect_document(validated(document, CampaignFile, Ledger(Path("content"))), _Tables(tables))
    if inspection.campaign is None:
        raise InputError(inspection.issues)
    if folder is None:
        return inspection.campaign
    files = {run["file"]: _columns(tables[run["name"]]) for run in document["run"]}
    write_campaign(Path(folder), document, files, check=False)
    return load_campaign(folder)


def _document(content: Any) -> dict[str, Any]:
    """Return the content as a file has it, with the keys that only a file needs."""
    if not isinstance(content, Mapping):
        what = f"the content of a campaign is of type {type(content).__name__}"
        remedy = "give a mapping; a campaign folder is read by imubayes.load_campaign"
        raise input_error(what, "content", f"a mapping with the keys of {CAMPAIGN_FILE}", remedy)
    document = {"format": 1, **plain_content(content)}
    files: set[str] = set()
    for run in _named_runs(document):
        stem = file = re.sub(r"[^A-Za-z0-9_-]+", "-", str(run.get("name", ""))) or "run"
        while file in files:
            file = f"{stem}-{len(files)}"
        files.add(file)
        run["file"] = f"runs/{file}.csv"
    return document


def _named_runs(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    runs = document.get("run", [])
    return [run for run in runs if isinstance(run, dict)] if isinstance(runs, list) else []


def _table(run: str, columns: Any) -> pa.Table:
    where = f"runs['{run}']"
    if isinstance(columns, Mapping):
        return pa.table({str(name): _array(values, f"{where}['{name}']") for name, values in _alike(columns, where)})
    if not (isinstance(columns, pa.Table) or hasattr(columns, "__arrow_c_stream__")):
        remedy = "pass a data frame or a mapping"
        raise input_error(f"the columns are of type {type(columns).__name__}", where, _COLUMNS, remedy)
    table = pa.table(columns)
    return pa.table([_array(table[name].to_numpy(), f"{where}['{name}']") for name in table.column_names],
                    names=table.column_names)  # fmt: skip


def _alike(columns: Mapping[Any, Any], where: str) -> list[tuple[Any, Any]]:
    lengths = {name: np.shape(values) for name, values in columns.items()}
    odd = [f"'{name}' {shape}" for name, shape in lengths.items() if len(shape) != 1]
    odd = odd or [f"'{name}' {shape[0]}" for name, shape in lengths.items() if shape != next(iter(lengths.values()))]
    if odd or not columns:
        what = f"columns of different shapes: {', '.join(odd)}" if odd else "there are no columns"
        raise input_error(what, where, _COLUMNS, "give one value a row")
    return list(columns.items())


def _array(values: Any, where: str) -> pa.Array:
    try:
        array = pa.array(np.asarray(values), from_pandas=True)
    except (pa.ArrowException, ValueError, TypeError) as error:
        remedy = "give numbers, with NaN for a missing value"
        raise input_error(f"values that are not columns: {error}", where, _COLUMNS, remedy) from None
    return array.cast(pa.float64()) if pa.types.is_floating(array.type) else array


def _refuse_unused(runs: Mapping[str, Any], known: Sequence[str]) -> None:
    unused = [str(name) for name in runs if name not in known]
    if unused:
        raise input_error(
            f"there is no run '{unused[0]}' in the content", f"runs['{unused[0]}']",
            closest_first(unused[0], known), "give it an entry under 'run', or leave its columns out",
        )  # fmt: skip


def _columns(table: TableInMemory) -> dict[str, np.ndarray]:
    return {name: table.columns[name].to_numpy() for name in table.columns.column_names}


@dataclass(frozen=True)
class _Tables:
    """The tables of a campaign that has no folder."""

    tables: Mapping[str, TableInMemory]

    @property
    def folder(self) -> str:
        return ""

    def of(self, run: RunEntry) -> TableFile | None:
        return self.tables.get(run.name)

    def place(self, run: RunEntry) -> str:
        return f"columns of run '{run.name}'"

    def check(self, run: RunEntry, index: int, ledger: Ledger) -> None:
        if run.name not in self.tables:
            remedy = f"give runs['{run.name}']"
            ledger.add(f"run '{run.name}' has no columns", ("run", index, "name"), _COLUMNS, remedy)

    def digest(self, entry: CampaignFile) -> str:
        digest = hashlib.sha256(entry.model_dump_json().encode())
        for run in entry.run:
            columns = self.tables[run.name].columns
            for name in columns.column_names:
                digest.update(f"{run.name}/{name}".encode())
                for chunk in columns[name].chunks:
                    digest.update(repr(chunk.to_pylist()).encode())
        return digest.hexdigest()
