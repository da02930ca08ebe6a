"""`diagnosis.json` and `change.json` of a result folder, and the steps that they document."""

from collections.abc import Collection
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import polars as pl

from imubayes.criticism.diagnosis_record import Diagnosis, EffectGroup
from imubayes.errors import InputError
from imubayes.json_record import Record
from imubayes.loop.model_history import Node, Tree
from imubayes.loop.removal_odds import removal_log_odds
from imubayes.results.history_tree import read_tree
from imubayes.results.manifest import add_to, added, checked
from imubayes.results.model_change import ModelChange
from imubayes.results.record_names import ADDED_VARIABLE, CHANGE, DIAGNOSIS, RESIDUALS


def write_diagnosis(folder: Path, diagnosis: Diagnosis, identity: str = "") -> None:
    """Keep a diagnosis in the folder of the result that was diagnosed; `identity` is that of its fit."""
    add_to(folder, DIAGNOSIS, diagnosis.json_text(), identity)


def read_diagnosis(folder: Path) -> Diagnosis | None:
    """Return the diagnosis that a result folder holds; None where there is none of this version.

    Raises
    ------
    InputError
        where the result is not whole, or the diagnosis is altered or of another fit.
    """
    file = added(folder, DIAGNOSIS)
    return _read(file, Diagnosis) if file is not None else None


def read_change(folder: Path) -> ModelChange | None:
    """Return the change that made a result; None for a folder that holds none of this version."""
    return _read(folder / CHANGE, ModelChange) if checked(folder).holds(CHANGE) else None


def log_odds_of_removal(folder: Path, removed: Collection[str], kept: Collection[str]) -> float | None:
    """Return the log odds of effects by the latest diagnosis on the way to a result that names them; else None.

    Parameters
    ----------
    folder : of the result that the effects are removed from.
    removed, kept : effects that go, and that its model keeps.
    """
    try:
        tree = read_tree([folder])
    except InputError:
        return None
    for place in reversed(tree.path_to(str(folder.resolve()))):
        diagnosis = read_diagnosis(Path(place))
        found = diagnosis.explanations if diagnosis is not None else None
        odds = removal_log_odds(found, removed, kept) if found is not None else None
        if odds is not None:
            return odds
    return None


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
    change : what the step brought.
    group : the effects that the diagnosis before found first.
    before, after : residuals of both fits.
    added_variable : the added-variable plot as a table.
    """

    node: Node
    change: ModelChange | None
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
                change=read_change(after),
                group=diagnosis.groups[0] if diagnosis is not None and diagnosis.groups else None,
                before=_table(before / RESIDUALS),
                after=_table(after / RESIDUALS),
                added_variable=_table(after / ADDED_VARIABLE) if checked(after).holds(ADDED_VARIABLE) else None,
            )
        )
    return tuple(steps)
