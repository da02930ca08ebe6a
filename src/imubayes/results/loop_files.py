"""`diagnosis.json`, `addition.json` and `added_variable.parquet` of a result folder, and the steps they document."""

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import polars as pl

from imubayes.atomic_files import write_text
from imubayes.criticism.diagnosis_record import Diagnosis, EffectGroup
from imubayes.criticism.model_history import Node, Tree
from imubayes.json_record import Record
from imubayes.results.addition import Addition
from imubayes.results.record_names import RESIDUALS

DIAGNOSIS, ADDITION, ADDED_VARIABLE = "diagnosis.json", "addition.json", "added_variable.parquet"


def write_diagnosis(folder: Path, diagnosis: Diagnosis) -> None:
    """Keep a diagnosis in the folder of the result that was diagnosed."""
    write_text(folder / DIAGNOSIS, diagnosis.json_text())


def read_diagnosis(folder: Path) -> Diagnosis | None:
    """Return the diagnosis that a result folder holds; None where there is none that can be read."""
    return _read(folder / DIAGNOSIS, Diagnosis)


def write_addition(folder: Path, addition: Addition, added_variable: pl.DataFrame) -> None:
    """Keep the record of an addition and its added-variable plot in the folder of the refit."""
    added_variable.write_parquet(folder / ADDED_VARIABLE)
    write_text(folder / ADDITION, addition.json_text())


def read_addition(folder: Path) -> Addition | None:
    """Return the addition that made a result; None for a folder that holds none that can be read."""
    return _read(folder / ADDITION, Addition)


def _table(file: Path) -> pl.DataFrame | None:
    return pl.read_parquet(file) if file.is_file() else None


def _read[Kept: Record](file: Path, record: type[Kept]) -> Kept | None:
    try:
        return record.model_validate_json(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


@dataclass(frozen=True)
class HistoryStep:
    """A step from one model to the next, as the result folders on both sides of it hold it; None for what is gone.

    Attributes
    ----------
    node : of the model after the step.
    addition : what the step brought.
    group : the effects that the diagnosis before found first.
    before, after : residuals of both fits.
    added_variable : the added-variable plot as a table.
    """

    node: Node
    addition: Addition | None
    group: EffectGroup | None
    before: pl.DataFrame | None
    after: pl.DataFrame | None
    added_variable: pl.DataFrame | None


def read_steps(tree: Tree, place: str) -> tuple[HistoryStep, ...]:
    """Return the steps from the first model to the one at a place."""
    steps = []
    for before, after in pairwise(map(Path, tree.path_to(place))):
        diagnosis = read_diagnosis(before)
        steps.append(
            HistoryStep(
                node=tree.nodes[str(after)],
                addition=read_addition(after),
                group=diagnosis.groups[0] if diagnosis is not None and diagnosis.groups else None,
                before=_table(before / RESIDUALS),
                after=_table(after / RESIDUALS),
                added_variable=_table(after / ADDED_VARIABLE),
            )
        )
    return tuple(steps)
