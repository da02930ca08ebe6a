"""One reading in words: its run and row, when and at which settings it was taken, and its value with its noise."""

import numpy as np

from imubayes.display.numbers_and_labels import pretty, rounded, significant, value_and_sd, with_minus
from imubayes.display.residual_columns import numbers
from imubayes.foundations.errors import input_error
from imubayes.foundations.records import Record
from imubayes_explorer.point_table import PointTable


class PointFacts(Record):
    """A reading.

    Attributes
    ----------
    entry : its place among the readings of the model.
    row : counted from 1, as in a model file.
    values : what is known of it, each a label and a text: output ± noise known beforehand, which has the offset of the
        run in it; prediction; residual; the same as it is drawn, whitened; and every setting that the run recorded.
    """

    entry: int
    run: str
    row: int
    channel: str
    values: tuple[tuple[str, str], ...]


def point_facts(table: PointTable, entry: int) -> PointFacts:
    """Return a reading in words; raises InputError for an entry that the model does not have."""
    if not 0 <= entry < len(table.table) or not table.view.entries[entry]:
        raise input_error(f"no reading {entry}", "entry", f"a reading of the model, below {len(table.table)}",
                          "point at one that is drawn")  # fmt: skip
    row = table.table.row(entry, named=True)
    unit, sd = pretty(str(row["output_unit"])), table.noise(entry)
    # The model as fitted at the known noise: value, model and residual belong together.
    misfit = table.misfit(entry)
    found = [
        (row["channel"], f"{' ± '.join(value_and_sd(row['observed'], sd))} {unit}"),
        ("model", f"{value_and_sd(row['observed'] - misfit, sd)[0]} {unit}"),
        ("residual", with_minus(f"{rounded((misfit,), sd)[0]} {unit}")),
        ("over known noise", with_minus(significant(float(table.view.whitened()[entry]), 3))),
    ]
    for axis in table.abscissae:
        value = float(table.column(axis.name)[entry])
        if axis.name != "reading" and np.isfinite(value):
            found.append((axis.phrase, with_minus(f"{significant(value, 5)} {axis.unit}".strip())))
    return PointFacts(
        entry=entry, run=str(row["run"]), row=int(numbers(table.table, "row")[entry]) + 1, channel=str(row["channel"]),
        values=tuple(found),
    )  # fmt: skip
