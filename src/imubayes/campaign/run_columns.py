"""The columns of run tables.

The suffix of a column is its unit.  A column that is neither known nor a channel is an error, reported with the closest
known names, so that a misspelt `table_angle_degs` is not silently ignored; columns to be ignored are listed under
`ignore` in the run's entry.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from imubayes.covariates import recorded_columns
from imubayes.errors import Issue, closest_first
from imubayes.procedures import Procedure

TEXT_COLUMNS = ("segment", "i_axis", "o_axis")


def known_columns() -> tuple[str, ...]:
    """Return the names of all columns with a fixed meaning."""
    return (*recorded_columns(), *TEXT_COLUMNS, "samples")


@dataclass(frozen=True)
class ColumnLayout:
    """The columns of one run table, by role.

    Attributes
    ----------
    header : all columns, in the order of the file.
    numbers : columns read as numbers.
    texts : columns read as text.
    channels : the channels that have a column.
    deviations : the channels that have a `<channel>_sd` column.
    """

    header: tuple[str, ...]
    numbers: tuple[str, ...]
    texts: tuple[str, ...]
    channels: tuple[str, ...]
    deviations: tuple[str, ...]

    def has(self, column: str) -> bool:
        """Return whether a column is read."""
        return column in self.numbers or column in self.texts

    @property
    def reduced(self) -> bool:
        """Whether the rows are means of samples."""
        return "samples" in self.numbers


def lay_out(
    header: Sequence[str], channels: Sequence[str], ignore: Sequence[str], procedure: Procedure, where: str
) -> tuple[ColumnLayout, list[Issue]]:
    """Return the column layout of a table, and the issues of its header."""
    deviation_names = {f"{channel}_sd": channel for channel in channels}
    known = (*known_columns(), *channels, *deviation_names)
    issues = _repeated(header, where)
    numbers, texts = [], []
    for column in dict.fromkeys(header):
        if column in ignore:
            continue
        if column in TEXT_COLUMNS:
            texts.append(column)
        elif column in known:
            numbers.append(column)
        else:
            issues.append(
                Issue(
                    f"column '{column}' is neither known nor a channel",
                    f"{where}, column '{column}'",
                    closest_first(column, known),
                    "correct the name, or list the column under 'ignore' in the run's entry",
                )
            )
    layout = ColumnLayout(
        tuple(header),
        tuple(numbers),
        tuple(texts),
        tuple(channel for channel in channels if channel in numbers),
        tuple(channel for name, channel in deviation_names.items() if name in numbers),
    )
    return layout, issues + _missing(layout, channels, procedure, where)


def _repeated(header: Sequence[str], where: str) -> list[Issue]:
    repeats = {column for column in header if list(header).count(column) > 1}
    return [
        Issue(
            f"column '{column}' is repeated" if column else "a column has no name",
            f"{where}, header",
            "one name per column, each used once",
            "rename or remove the column",
        )
        for column in sorted(repeats | ({""} & set(header)))
    ]


def _missing(layout: ColumnLayout, channels: Sequence[str], procedure: Procedure, where: str) -> list[Issue]:
    issues = []
    if not layout.channels and not procedure.driven:
        issues.append(
            Issue(
                "no channel of the campaign has a column in this table",
                f"{where}, header",
                ", ".join(channels),
                "name the output columns after the channels of campaign.toml",
            )
        )
    issues += [
        Issue(
            f"a run of procedure '{procedure.name}' needs the column '{group[0]}'",
            f"{where}, header",
            ", or ".join(group),
            "add the column, or correct 'procedure' of the run",
        )
        for group in procedure.columns
        if not any(layout.has(column) for column in group)
    ]
    return issues
