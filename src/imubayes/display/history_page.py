"""The whole story on one HTML page: models tried, error falling, what gave it away, evidence, next command.

One file without scripts, links or outside style; pictures are inside, on white, so that the page reads in light and
dark.
"""

import base64
import os
from collections.abc import Iterable, Mapping
from html import escape
from itertools import pairwise
from pathlib import Path

import polars as pl

from imubayes.criticism.model_history import Tree, error_by_kind
from imubayes.display.addition_report import (
    ADDED_VARIABLE,
    addition_text,
    coefficient_sheet,
    error_sheet,
    read_addition,
)
from imubayes.display.diagnosis_report import read_diagnosis
from imubayes.display.figures.history_steps import error_per_step_figure, history_figure
from imubayes.display.figures.save import added_variable, before_after
from imubayes.display.history_table import history_json, history_sheet
from imubayes.display.html import sheet_html
from imubayes.display.theme import Picture
from imubayes.results.history_file import shown_place

_STYLE = """
:root { color-scheme: light dark; }
body { font: 15px/1.5 system-ui, sans-serif; max-width: 64rem; margin: 2rem auto; padding: 0 1rem;
       background: Canvas; color: CanvasText; }
h1 { font-size: 1.5rem; }
h2 { font-size: 1.15rem; margin-top: 2.2rem; border-top: 1px solid #8886; padding-top: .8rem; }
figure { margin: 1rem 0; background: #fff; color: #222; padding: .4rem; border-radius: 6px; overflow-x: auto; }
figure img { max-width: 100%; height: auto; display: block; }
code { background: #8882; padding: .15rem .4rem; border-radius: 4px; }
.scroll { overflow-x: auto; } .quiet { opacity: .75; }
"""


def history_page(tree: Tree) -> str:
    """Return the page of the trees of models tried, along the way to each selected model."""
    parts = [
        "<!doctype html>", '<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>Models tried</title><style>{_STYLE}</style></head><body>",
        "<h1>Models tried, and how the error fell</h1>",
        f'<div class="scroll">{sheet_html(history_sheet(tree))}</div>',
        _figure(history_figure(history_json(tree)["nodes"])),
    ]  # fmt: skip
    for place in tree.selected:
        parts += _way(tree, place)
    parts.append("</body></html>")
    return "\n".join(parts) + "\n"


def _way(tree: Tree, place: str) -> Iterable[str]:
    way = tree.way_to(place)
    nodes = [tree.nodes[one] for one in way]
    errors = [error_by_kind(node.rms) for node in nodes]
    units = list(dict.fromkeys(unit for one in errors for unit in one))
    yield f"<h2>The way to {escape(shown_place(place))}</h2>"
    if units:
        series = {unit: [one.get(unit, float("nan")) for one in errors] for unit in units}
        yield _figure(error_per_step_figure([node.title for node in nodes], series, kind_floors(nodes[-1].floor)))
    for before, after in pairwise(way):
        yield from _step(Path(before), Path(after), tree)
    command = read_addition(Path(place)).get("next") or f"imubayes diagnose {shown_place(place)}"
    yield f"<h2>Next</h2><p><code>{escape(str(command))}</code></p>"


def kind_floors(floor: Mapping[str, tuple[float, str]]) -> dict[str, float]:
    """Return the noise floor by unit, out of that by channel."""
    return error_by_kind(floor)


def _step(before: Path, after: Path, tree: Tree) -> Iterable[str]:
    node = tree.nodes[str(after)]
    facts = read_addition(after)
    yield f"<h2>{escape(node.title)}</h2>"
    if node.verdict:
        yield f'<p class="quiet">The diagnosis before said: {escape(node.verdict.replace("_", " "))}.</p>'
    if not facts:
        yield '<p class="quiet">The facts of this step are no longer in its folder.</p>'
        return
    yield from (f"<p>{escape(one)}</p>" for one in addition_text(facts))
    names = ", ".join(one["effect"] for one in node.added)
    tables = [_table(folder / "residuals.parquet") for folder in (before, after)]
    if tables[0] is not None and tables[1] is not None:
        floors = {name: size for name, (size, _) in node.floor.items()}
        telling = read_diagnosis(before).get("telling")
        yield _figure(before_after(tables[0], tables[1], names, floors, telling))
    points = _table(after / ADDED_VARIABLE)
    yield _figure(added_variable(points, names) if points is not None else None)
    for sheet in (coefficient_sheet(facts), error_sheet(facts)):
        yield f'<div class="scroll">{sheet_html(sheet)}</div>'
    yield f'<div class="scroll">{sheet_html(error_sheet(facts, by_run=True), folded=True)}</div>'


def _table(file: Path) -> pl.DataFrame | None:
    return pl.read_parquet(file) if os.path.isfile(file) else None


def _figure(drawn: Picture | None) -> str:
    """Return a picture with its caption as the text for those who cannot see it."""
    if drawn is None:
        return ""
    data = base64.b64encode(drawn.png()).decode("ascii")
    return f'<figure><img alt="{escape(drawn.caption, quote=True)}" src="data:image/png;base64,{data}"></figure>'
