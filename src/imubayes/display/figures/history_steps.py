"""How the error fell from model to model, and the tree of models tried."""

from collections.abc import Mapping, Sequence

import numpy as np

from imubayes.criticism.model_history import Tree
from imubayes.display.history_table import gain_text
from imubayes.display.labels import pretty, readable, shortened
from imubayes.display.marks import line, points
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
    axes_at,
    picture,
    text_at,
    themed,
)
from imubayes.display.ticks import frame

_HUES = (BLUE, VERMILION, GREEN)


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
        "Root mean square residual over all rows, runs and channels of one unit, model by model. A good way falls at "
        "every step; a last step that is flat was not needed. It ends at the dashed line, the noise of single rows, or "
        "above it by the offsets from run to run where the model counts them as noise."
    )
    panels = list(errors)
    width = max(6.0, 4.6 * len(panels) + 0.6)
    figure = picture(width, 3.3, "Error per step", caption)
    left, bottom, right, top = figure.inside
    across = (right - left) / max(len(panels), 1) - 0.85
    for column, unit in enumerate(panels):
        sizes = np.asarray(errors[unit], dtype=float)
        factor, shown = readable(unit, float(np.nanmax(sizes)))
        axes = axes_at(figure, left + 0.75 + column * (across + 0.85), bottom + 0.55, across, top - bottom - 0.8)
        y, x = sizes * factor, np.arange(len(steps), dtype=float)
        axes.set_xlim(-0.5, len(steps) - 0.5)
        floor = floors.get(unit)
        axes.set_ylim(0, 1.18 * max(float(np.nanmax(y)), (floor or 0.0) * factor))
        if floor is not None:
            line(axes, [-0.5, len(steps) - 0.5], [floor * factor] * 2, color=QUIET, linewidth=1.0, linestyle="--")
            axes.text(-0.48, floor * factor, "noise of the rows", size=SMALL, color=QUIET, va="bottom")
        hue = _HUES[column % len(_HUES)]
        line(axes, x, y, color=hue, linewidth=1.4, zorder=3)
        points(axes, x, y, "o", 6, hue, zorder=4)
        for place, size in zip(x.tolist(), y.tolist(), strict=True):
            if np.isfinite(size):
                low = floor is not None and size < 1.05 * floor * factor
                apart = (0, -14 if low else 6)
                said = axes.annotate(significant(size), (place, size), apart, textcoords="offset points", size=SMALL)
                said.set(ha="center")
        frame(axes, 0, 5, None, f"rms residual / {pretty(shown)}")
        room = max(9, int(across / max(len(steps), 1) * 12))
        for place, step in enumerate(steps):
            words = step.replace("+ ", "+")
            label = axes.text(place, -0.04, _folded(words, room), size=SMALL, transform=axes.get_xaxis_transform())
            label.set(ha="center", va="top")
    return figure


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
    step, columns = 0.3, (0.0, 4.6, 5.7, 6.7)
    height = max(1.2, 0.45 + step * len(nodes))
    figure = picture(9.6, height, "Models tried", caption)
    left, _, right, top = figure.inside
    heads = ("model", "χ²/dof", "Δχ²", "Δ elpd")
    for place, head in zip(columns, heads, strict=True):
        text_at(figure, left + place, top - 0.2, head, size=SMALL, color=QUIET)
    base = top - 0.4 - step * len(nodes)
    axes = axes_at(figure, left, base, right - left, step * len(nodes))
    axes.set_axis_off()
    axes.set(xlim=(0, right - left), ylim=(0, step * len(nodes)))
    where: dict[str, tuple[float, float]] = {}
    for row, (depth, place) in enumerate(nodes):
        node, parent = tree.nodes[place], tree.parents[place]
        x, y = 0.12 + 0.28 * depth, step * (len(nodes) - row - 0.5)
        where[place] = (x, y)
        if parent in where:
            above = where[parent]
            line(axes, [above[0], above[0], x], [above[1], y, y], color=FAINT, linewidth=1.2, zorder=1)
        colour = INK if node.taken else RED
        fill = {"markerfacecolor": BLUE if node.selected else "white", "markeredgecolor": BLUE if node.taken else RED}
        points(axes, [x], [y], "o", 7, BLUE, markeredgewidth=1.3, zorder=3, **fill)
        ratio = node.chi2_per_dof
        fit = "–" if ratio is None else f"{ratio:.3f}"
        texts = (shortened(node.title, 46), fit, significant(node.delta_chi2.observed), gain_text(node))
        for column, (start, text) in enumerate(zip(columns, texts, strict=True)):
            weight = "bold" if node.selected and column == 0 else "normal"
            at = x + 0.16 if column == 0 else start
            shown = axes.text(at, y, text, size=SMALL + 0.5, color=colour, weight=weight)
            shown.set(va="center_baseline")
    return figure
