"""The session as one HTML file: the page with its scripts, and the readings of the models that are open, in it.

Residuals can be looked at, selected and coloured without a server, and single likely causes previewed; what
needs the linear model or a fit says so.  Modules are put one after the other, each in a function of its own.
"""

import base64
import json
import re
from collections.abc import Mapping, Sequence
from typing import get_args

import numpy as np

from imubayes.display.residual_columns import numbers
from imubayes.foundations.records import Record
from imubayes_explorer.calibration import CalibrationFacts
from imubayes_explorer.knowledge import KnownTables, known_tables
from imubayes_explorer.messages import ModelFacts, Ordinate, PreviewFacts
from imubayes_explorer.open_model import OpenModel
from imubayes_explorer.session_state import SessionState

_MODULES = (
    "dom", "offline", "net", "state", "chart", "verdict", "map", "causes", "geometry", "corner", "knowledge",
    "estimates", "below", "tasks", "formula", "keys", "tour", "picture", "points", "legend", "marks", "beside",
    "panels", "first", "main",
)  # fmt: skip
_PREVIEWED, _MOST_NUMBERS = 6, 700_000
"""Causes of each model that are previewed, and numbers of each model that a file has room for."""
_POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"


class SavedPreview(Record):
    """A previewed cause: what is said of it, and the residual over the known noise and the curve with it, in Base64."""

    facts: PreviewFacts
    after: str
    curve: str


class SavedModel(Record):
    """A model in a saved page; columns are Float32 in Base64, one number for each reading that was kept.

    Attributes
    ----------
    of : readings of the model, of which `count` evenly spaced ones were kept.
    units : output unit of each channel.
    """

    facts: ModelFacts
    known: KnownTables
    calibration: CalibrationFacts
    of: int
    count: int
    columns: dict[str, str]
    units: tuple[str, ...]
    previews: tuple[SavedPreview, ...]


class SavedSession(Record):
    """What a saved page holds."""

    state: SessionState
    models: tuple[SavedModel, ...]


def saved_model(model: OpenModel, calibration: CalibrationFacts) -> SavedModel:
    """Return what a saved page needs of a model; causes are previewed if its explanations are weighed."""
    table, view, facts = model.table, model.readings, model.facts()
    likeliest = [cause.effect for cause in facts.causes[:_PREVIEWED]] if facts.stage == "ready" else []
    names = 11 + len(table.columns) + 2 * len(likeliest)
    every = np.flatnonzero(view.entries & np.isin(table.channel, table.channels))
    kept = every[:: -(-len(every) * names // _MOST_NUMBERS)]
    run_place = {name: place for place, name in enumerate(table.run_names)}
    columns = {
        "run": np.array([run_place[str(name)] for name in table.runs])[table.run],
        "channel": np.array([table.channels.index(c) if c in table.channels else -1 for c in table.channel]),
        **table.shown,
        **{name: table.ordinate(name) for name in get_args(Ordinate)},
        "sd": numbers(table.table, "input_sd"),
        "row": table.row,
        "noise": table.known_noise,
        **{f"x:{name}": values for name, values in table.columns.items()},
    }
    previews = []
    for effect in likeliest:
        point = model.view.with_causes([effect])
        after, curve = _base64(view.whitened(point)[kept]), _base64(table.curve(point)[kept])
        found = model.preview([effect], f"{model.place}-{effect}")
        previews.append(SavedPreview(facts=found, after=after, curve=curve))
    return SavedModel(
        facts=facts, known=known_tables(model.result), calibration=calibration, of=len(every), count=len(kept),
        columns={name: _base64(np.asarray(values)[kept]) for name, values in columns.items()},
        units=tuple(table.output_unit(channel) for channel in table.channels), previews=tuple(previews),
    )  # fmt: skip


def saved_page(
    state: SessionState, models: Sequence[tuple[OpenModel, CalibrationFacts]], files: Mapping[str, tuple[bytes, str]]
) -> str:
    """Return the page of a session that needs no server.

    Parameters
    ----------
    models : each with its estimates.
    files : of the page, name → content and media type.
    """
    text = {name: content.decode() for name, (content, _) in files.items()}
    kept = SavedSession(state=state, models=tuple(saved_model(*each) for each in models))
    data = json.dumps(kept.model_dump(mode="json"), ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")
    scripts = "".join(map(_in_function, _MODULES, (text[f"{name}.js"] for name in _MODULES)))
    head = (
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n'
        f"<style>{text['uPlot.min.css']}\n{text['style.css']}</style>\n"
    )
    end = (
        f'<script type="application/json" id="kept">{data}</script>\n'
        f"<script>{text['uPlot.iife.min.js']}</script>\n<script>{scripts}</script>\n</body>"
    )
    page = re.sub(r'<link rel="stylesheet"[^>]*>\n|<script [^>]*></script>\n', "", text["index.html"])
    return page.replace("</head>", f"{head}</head>").replace("</body>", end)


def _in_function(name: str, source: str) -> str:
    """Return a module as a constant that holds what it exports."""
    exported = re.findall(r"^export (?:async )?(?:function|const|class) (\w+)", source, re.MULTILINE)
    body = re.sub(r'^import (\{[^}]*\}) from "\./(\w+)\.js";', r"const \1 = \2_js;", source, flags=re.MULTILINE)
    body = re.sub(r"^export ", "", body, flags=re.MULTILINE)
    return f"const {name}_js = (() => {{\n{body}\nreturn {{ {', '.join(exported)} }};\n}})();\n"


def _base64(values: np.ndarray) -> str:
    return base64.b64encode(np.asarray(values, dtype="<f4").tobytes()).decode("ascii")
