"""The queries of `data/archives.md` run as written on the results of a batch."""

import datetime
import re
from pathlib import Path

import duckdb
import numpy as np
import polars as pl
import pytest

from imubayes_archive.unit_fits.posterior_table import (
    Outcome,
    Quantities,
    UnitIdentity,
    UnitPosterior,
    model_folder,
    parameter_table,
    part_folder,
    unit_table,
)

GUIDE = (Path(__file__).parents[2] / "data" / "archives.md").read_text(encoding="utf-8")
MODEL = "abc"


def campaigns() -> list[UnitPosterior]:
    """Return six units on two tables, and one that could not be read."""
    value = np.array([1.0])
    part = Quantities("parameter", ("a",), ("ug",), value, value, np.ones((5, 1)), 0 * value, 100 * value, 0.99 * value)
    fitted = [
        UnitPosterior(
            UnitIdentity(f"U{place}", "c", f"d{place}", "f", datetime.date(2024, 1, 1), tables=(f"t{place % 2}",)),
            Outcome("fitted"),
            (part,),
            np.eye(1),
        )
        for place in range(6)
    ]
    return [*fitted, UnitPosterior(UnitIdentity("X", "c", "x", "x.parquet"), Outcome("refused", "no rows"))]


@pytest.fixture
def results(tmp_path, monkeypatch) -> None:
    """Write the results of a batch if the guide has them."""
    monkeypatch.chdir(tmp_path)
    folder = part_folder("results/batch", MODEL, "1")
    folder.mkdir(parents=True)
    (model_folder("results/batch", MODEL) / "model.toml").write_text("")
    units = campaigns()
    parameter_table(MODEL, units).write_parquet(folder / "parameters.parquet")
    unit_table(MODEL, "code", units).write_parquet(folder / "units.parquet")


@pytest.mark.usefixtures("results")
def test_the_duckdb_queries_run_as_written():
    block = re.search(r"```sql\n(.*?)```", GUIDE, re.DOTALL)
    assert block is not None
    first, second = (text for text in block[1].split(";") if text.strip())
    database = duckdb.connect()
    assert [row[1] for row in database.execute(first).fetchall()] == [6]
    assert [row[-1] for row in database.execute(second).fetchall()] == [3, 3]


@pytest.mark.usefixtures("results")
def test_the_polars_queries_run_as_written():
    (block,) = (each for each in re.findall(r"```py\n(.*?)```", GUIDE, re.DOTALL) if "scan_parquet" in each)
    names: dict[str, pl.DataFrame] = {}
    exec(block, names)
    assert names["worst"]["sd"].list.len().to_list() == [3]
    assert names["failed"].rows() == [(None, "no rows", 1)]
