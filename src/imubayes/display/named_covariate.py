"""The covariate that the diagnosis of a result names, without what the whole diagnosis needs to be read.

A diagnosis as a record loads JAX; a comparison takes one name from its file.
"""

from dataclasses import replace
from pathlib import Path

import polars as pl

from imubayes.display.residual_columns import covariates_of
from imubayes.foundations.covariates import COVARIATES, INPUTS, Covariate
from imubayes.foundations.errors import InputError
from imubayes.foundations.records import Record
from imubayes.results.folder_files import DIAGNOSIS, added

OBSERVED = "input_observed"
"""The column of residual tables that holds the input of the channel of a row."""


class _NamedLabel(Record):
    name: str


class _NamedGroup(Record):
    covariate: _NamedLabel | None = None


class _NamedByDiagnosis(Record):
    """What is read of `diagnosis.json`; its other contents are left alone."""

    groups: tuple[_NamedGroup, ...] = ()


def named_covariate(folder: Path, residuals: pl.DataFrame) -> Covariate | None:
    """Return what the residual depends on that the diagnosis in a result folder names first.

    None if there is no diagnosis of this fit, if it names nothing, and if the residuals lack the column.
    """
    try:
        file = added(folder, DIAGNOSIS)
        said = _NamedByDiagnosis.model_validate_json(file.read_bytes()) if file is not None else _NamedByDiagnosis()
    except (InputError, OSError, ValueError):
        return None
    name = next((group.covariate.name for group in said.groups if group.covariate is not None), "")
    if name in INPUTS.values() and {OBSERVED, "kind"} <= set(residuals.columns):
        return replace(COVARIATES[name], column=OBSERVED)
    return next((each for each in covariates_of(residuals) if each.column == name), None)
