"""The tables of a result as a small, self-contained piece of HTML: what a notebook shows.

No scripts, no links, no outside style; every text from the result is escaped: names of runs and channels are free.
Colours are set with their background left alone, and are readable on light and dark pages.
"""

from collections.abc import Iterable
from html import escape

from imubayes.display.fit_tables import (
    Sheet,
    Summary,
    alarm_of,
    contribution_sheet,
    next_run_sheet,
    run_sheet,
    weak_sheet,
)
from imubayes.display.quantity_tables import derived_sheet, parameter_sheet

_COLOURS = {"bad": "color:#d33;font-weight:600", "weak": "color:#b26a00", "dim": "opacity:.65"}
_CELL = "padding:1px 10px 1px 0;font-variant-numeric:tabular-nums;white-space:nowrap"
_RULE = "border-top:1px solid rgba(128,128,128,.35);"


def sheet_html(sheet: Sheet, folded: bool = False, alarm: bool = True) -> str:
    """Return a sheet as an HTML table, inside a fold where wanted."""
    parts = [_paragraph(sheet.alarm, _COLOURS["bad"])] if alarm and sheet.alarm else []
    parts.append('<table style="border-collapse:collapse;font-size:90%"><thead><tr>')
    parts += [_cell("th", name, _side(sheet, place)) for place, name in enumerate(sheet.head)]
    parts.append("</tr></thead><tbody>")
    for place, row in enumerate(sheet.rows):
        rule = _RULE if place == 0 or place in sheet.dividers else ""
        cells = (_cell("td", c.text, rule + _side(sheet, i) + _COLOURS.get(c.mood, "")) for i, c in enumerate(row))
        parts.append(f"<tr>{''.join(cells)}</tr>")
    parts.append("</tbody></table>")
    if sheet.note:
        parts.append(_paragraph(sheet.note, "opacity:.75;font-size:85%"))
    title = f"{escape(sheet.title)} ({len(sheet.rows)})"
    body = "".join(parts)
    if folded:
        return f'<details><summary style="cursor:pointer"><b>{title}</b></summary>{body}</details>'
    return f"<div><b>{title}</b>{body}</div>"


def summary_html(summary: Summary) -> str:
    """Return the whole result as HTML: verdict, then parameters, derived quantities, runs and what is weak."""
    alarm = alarm_of(summary)
    head = f"<b>{escape(str(summary['campaign']))}</b>, model {escape(str(summary['model']))}"
    parts = [_paragraph(alarm, _COLOURS["bad"])] if alarm else []
    parts.append(f'<p style="margin:.3em 0">{head}: {escape(_fit_line(summary))}</p>')
    parts += _notes(summary.get("notes") or ())
    parts.append(sheet_html(parameter_sheet(summary), alarm=False))
    optional = [
        (summary["derived"], derived_sheet),
        (summary["runs"], run_sheet),
        (summary.get("weak_directions"), weak_sheet),
        (summary.get("next_runs"), next_run_sheet),
        (summary.get("contributions"), contribution_sheet),
    ]
    parts += [sheet_html(make(summary), folded=True, alarm=False) for content, make in optional if content]
    return f'<div class="imubayes">{"".join(parts)}</div>'


def _fit_line(summary: Summary) -> str:
    state = "converged" if summary.get("converged") else "did not converge"
    how = "" if summary.get("sampled", True) else " (fit only, not sampled)"
    chi2, freedom = summary.get("chi2"), summary.get("dof")
    fit = f", chi2 {chi2:.1f} for {freedom:.0f} degrees of freedom" if chi2 is not None and freedom else ""
    return f"{state}{how}{fit}"


def _notes(notes: Iterable[object]) -> list[str]:
    return [_paragraph(str(note), "opacity:.75") for note in notes]


def _paragraph(text: str, style: str) -> str:
    return f'<p style="margin:.3em 0;{style}">{escape(text)}</p>'


def _side(sheet: Sheet, place: int) -> str:
    return f"text-align:{'left' if place in sheet.left else 'right'};"


def _cell(tag: str, text: str, style: str) -> str:
    return f'<{tag} style="{_CELL};{style}">{escape(text)}</{tag}>'
