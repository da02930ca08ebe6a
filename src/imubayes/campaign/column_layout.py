"""The columns of a table by role.

The suffix of a column is its unit.  A column that is neither known nor a channel is an error, reported with the closest
known names, so that a misspelt `table_angle_degs` is not silently ignored; columns to be ignored are listed under
`ignore` in the run's entry.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from imubayes.foundations.covariates import recorded_columns
from imubayes.foundations.errors import Issue, closest_first, refuse
from imubayes.procedures import Procedure, Reduction

TEXT_COLUMNS = ("segment", "i_axis", "o_axis")
"""Columns with a fixed meaning that hold text."""


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


def layout_of_outputs(header: Sequence[str], channels: Sequence[str], where: str) -> ColumnLayout:
    """Return the columns of a table of outputs that is no run; what has no fixed meaning is kept as text.

    Raises
    ------
    InputError
        if a column has no name, or one that another has.
    """
    refuse(_repeated(header, where))
    known = {*known_columns(), *channels, *(f"{name}_sd" for name in channels)} - set(TEXT_COLUMNS)
    return ColumnLayout(
        tuple(header),
        numbers=tuple(name for name in header if name in known),
        texts=tuple(name for name in header if name not in known),
        channels=tuple(name for name in channels if name in header),
        deviations=tuple(name for name in channels if f"{name}_sd" in header),
    )


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
        for group in (() if procedure.reduction is Reduction.POSES and layout.reduced else procedure.columns)
        if not any(layout.has(column) for column in group)
    ]
    return issues
