"""Faults of a CSV table that the fast parser refused: line, cell and reason."""

import csv
from pathlib import Path

from imubayes.campaign.run_columns import ColumnLayout
from imubayes.errors import Issue

MOST = 10  # faults of one file that are listed; the rest is counted
_MOST_SHOWN = 60  # characters of a cell that are repeated


def csv_faults(file: Path, layout: ColumnLayout) -> list[Issue]:
    """Return an issue per line of wrong length and per cell that is not a number, at most `MOST` and their count."""
    issues: list[Issue] = []
    more = 0  # faults beyond the first MOST
    wanted = [(index, name) for index, name in enumerate(layout.header) if name in layout.numbers]
    with file.open(encoding="utf-8-sig", newline="", errors="replace") as stream:
        reader = csv.reader(stream)
        try:
            next(reader, None)
            for cells in reader:
                found = _line_faults(cells, wanted, layout, f"{file}:{reader.line_num}")
                room = MOST - len(issues)
                issues += found[:room]
                more += len(found[room:])
        except csv.Error:
            issues.append(_oversized(f"{file}:{reader.line_num}"))
    if more:
        issues.append(
            Issue(
                f"{more} more cells or lines cannot be read",
                str(file),
                "numbers with a decimal point, empty where missing",
                "correct the ones above first",
            )
        )
    return issues


def _oversized(where: str) -> Issue:
    return Issue(
        f"a cell has more than {csv.field_size_limit()} characters",
        where,
        "a number with a decimal point, or an empty cell where the value is missing",
        "correct the cell; a quotation mark that is not closed makes one cell of many lines",
    )


def _line_faults(cells: list[str], wanted: list[tuple[int, str]], layout: ColumnLayout, where: str) -> list[Issue]:
    if not cells:
        return []
    if len(cells) != len(layout.header):
        return [
            Issue(
                f"the line has {len(cells)} cells where the header has {len(layout.header)}",
                where,
                f"{len(layout.header)} cells: {','.join(layout.header)}",
                "complete or remove the line; write decimals with a point",
            )
        ]
    return [
        Issue(
            f"'{_shown(cells[index])}' is not a number",
            f"{where}, column '{name}'",
            "a number with a decimal point, or an empty cell where the value is missing",
            "correct the cell",
        )
        for index, name in wanted
        if not _is_number(cells[index])
    ]


def _shown(cell: str) -> str:
    return cell if len(cell) <= _MOST_SHOWN else f"{cell[:_MOST_SHOWN]}…"


def _is_number(cell: str) -> bool:
    try:
        return not cell or (float(cell) is not None and "_" not in cell)
    except ValueError:
        return False
