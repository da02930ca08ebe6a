"""How the error fell from model to model, and the tree of models tried."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

from imubayes.criticism.model_history import Node, Tree
from imubayes.display.history_table import gain_text
from imubayes.display.labels import pretty, readable, shortened
from imubayes.display.rounding import significant
from imubayes.display.theme import (
    BLUE,
    FAINT,
    GREEN,
    INK,
    QUIET,
    RED,
    SMALL,
    VERMILION,
    Picture,
    panels,
    picture,
    themed,
)

_HUES = (BLUE, VERMILION, GREEN)
_STEP, _COLUMNS = 0.3, (0.0, 4.6, 5.7, 6.7)


@themed
def error_per_step_figure(
    steps: Sequence[str], errors: Mapping[str, Sequence[float]], floors: Mapping[str, float]
) -> Picture:
    """Return the residual error of each step of a way through models, down to the noise floor.

    Parameters
    ----------
    steps : what each step added; the first is the model it began with.
    errors : unit (deg/s, g) → error of each step, NaN where unknown.
    floors : unit → noise of one row, where it is known.
    """
    caption = (
        "Root-mean-square residual over all rows, runs and channels of one unit, model by model. A good history falls "
        "at every step; a flat last step was unnecessary. It ends at the dashed line, the noise of single rows, or "
        "above it by the run-to-run offsets where the model counts them as noise."
    )
    figure = picture(max(6.0, 4.6 * len(errors) + 0.6), 3.3, "Residual error by step", caption)
    grid = panels(figure, 1, max(len(errors), 1), (0.75, 0.55, 0.1, 0.25))[0]
    for axes, (unit, sizes), hue in zip(grid, errors.items(), _HUES, strict=False):
        factor, shown = readable(unit, float(np.nanmax(sizes)))
        floor = floors[unit] * factor if unit in floors else None
        _steps(axes, np.asarray(sizes, dtype=float) * factor, floor, hue)
        room = max(9, int(figure.get_figwidth() / len(errors) / len(steps) * 10))
        axes.set_xticks(range(len(steps)), [_folded(step.replace("+ ", "+"), room) for step in steps])
        axes.tick_params(axis="x", length=0)
        axes.set_ylabel(f"rms residual / {pretty(shown)}")
    return figure


def _steps(axes: Axes, sizes: np.ndarray, floor: float | None, hue: str) -> None:
    axes.set(xlim=(-0.5, len(sizes) - 0.5), ylim=(0, 1.18 * max(float(np.nanmax(sizes)), floor or 0.0)))
    if floor is not None:
        axes.axhline(floor, color=QUIET, linewidth=1.0, linestyle="--")
        axes.text(-0.48, floor, "noise of the rows", size=SMALL, color=QUIET, va="bottom")
    axes.plot(sizes, "o-", color=hue, linewidth=1.4, markersize=6, zorder=3)
    for place, size in enumerate(sizes.tolist()):
        if np.isfinite(size):
            offset = (0, -14 if floor is not None and size < 1.05 * floor else 6)
            axes.annotate(significant(size), (place, size), offset, textcoords="offset points", size=SMALL, ha="center")


def _folded(name: str, room: int) -> str:
    """Return a name on several lines, broken at its underscores."""
    lines = [""]
    for part in name.replace(" ", " \0").replace("_", "_\0").split("\0"):
        if lines[-1] and len(lines[-1]) + len(part) > room:
            lines.append("")
        lines[-1] += part
    return "\n".join(lines[:4])


@themed
def history_figure(tree: Tree) -> Picture:
    """Return the tree of models tried, a line for each."""
    caption = (
        "Each line is a model, below the one it was made from: what was added, its goodness of fit, and the outcome of "
        "cross-validation. Filled: the selected model, which is exported. Red: not taken. A good history ends at "
        "χ²/dof near 1, each step with a Δ elpd of many standard errors."
    )
    nodes = tree.in_order()
    figure = picture(9.6, max(1.2, 0.45 + _STEP * len(nodes)), "Models tried", caption)
    axes = panels(figure, margins=(0, 0, 0, 0))[0, 0]
    axes.set_axis_off()
    left, bottom, right, top = figure.inside
    axes.set(xlim=(0, right - left), ylim=(bottom - top, 0))
    for place, head in zip(_COLUMNS, ("model", "χ²/dof", "Δχ²", "Δ elpd"), strict=True):
        axes.text(place, -0.12, head, size=SMALL, color=QUIET, va="center")
    where: dict[str, tuple[float, float]] = {}
    for row, (depth, place) in enumerate(nodes):
        x, y = 0.12 + 0.28 * depth, -0.4 - _STEP * (row + 0.5)
        where[place] = (x, y)
        parent = tree.parents[place]
        if parent in where:
            above = where[parent]
            axes.plot([above[0], above[0], x], [above[1], y, y], color=FAINT, zorder=1)
        _model(axes, tree.nodes[place], x, y)
    return figure


def _model(axes: Axes, node: Node, x: float, y: float) -> None:
    fill, edge = BLUE if node.selected else "white", BLUE if node.taken else RED
    axes.plot([x], [y], "o", color=fill, markersize=7, markeredgecolor=edge, markeredgewidth=1.3, zorder=3)
    fit = "–" if node.chi2_per_dof is None else f"{node.chi2_per_dof:.3f}"
    texts = (shortened(node.title, 46), fit, significant(node.delta_chi2.observed), gain_text(node))
    for place, (start, text) in enumerate(zip(_COLUMNS, texts, strict=True)):
        weight = "bold" if node.selected and place == 0 else "normal"
        style = {"size": SMALL + 0.5, "color": INK if node.taken else RED, "va": "center_baseline"}
        axes.text(x + 0.16 if place == 0 else start, y, text, weight=weight, **style)
