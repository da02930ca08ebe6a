"""Drawings of quantities: forest plot, uncertainty budgets as bars, and correlations as a matrix of squares.

The forest plot has estimate and coverage interval of each parameter on the scale of its prior.
"""

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch, PathPatch
from matplotlib.path import Path

from imubayes.display import figure_style as style
from imubayes_qualification.budgets.budget_parts import BudgetLine, CorrelationMatrix, QuantityBudget
from imubayes_qualification.certificate.report_record import ResultLine
from imubayes_qualification.display.report.document import WIDTH, Drawing, Drawings, drawn, place, title

_MOST_ROWS, _ROW, _NAMES = 30, 0.155, 2.0
_LEGEND = 0.62
# Width of a drawing that stands alone, inches.
_WHOLE_PAGE = 7.6
# Part of a bar → colour, in the order in which the parts follow each other.
_PARTS = {
    "noise of runs": style.BLUE, "noise scales": style.SKY, "fixture": style.VERMILION, "table": style.ORANGE,
    "site": style.GREEN, "reference": style.PURPLE, "unit": style.QUIET, "second order": style.INK, "small": "#c9ced6",
    "cmc": "#8a6d3b",
}  # fmt: skip
_WORDS = {"noise of runs": "A: noise of runs", "noise scales": "A: noise scales", "unit": "B: unit under test",
          "second order": "second order", "small": "smaller", "cmc": "B: up to the CMC"}  # fmt: skip
_BARS = (
    "Shares of the posterior variance of each quantity: noise of the runs and of its scales (type A), then priors by "
    "their subject (type B), in the order of the legend. A good test leaves no bar that is mostly “unit under "
    "test”, the part that the data did not determine, and a bar of one colour shows where to improve: longer runs for "
    "noise, a better certificate for fixture, table, site or reference."
)
_MATRIX = (
    "Correlations of the posterior: blue positive, red negative, area by size; none below 0.05 is drawn. A good set of "
    "runs separates its quantities, so that squares are small. A large square says that only a combination of the two "
    "is well known, which a further run can separate."
)
_LEAST = 0.05


def bar_drawings(budgets: Sequence[QuantityBudget]) -> Drawings:
    """Return the bars of budgets in drawings of at most 30 rows."""
    return Drawings(_in_parts(_bars, budgets), _BARS)


def _in_parts[T: (QuantityBudget, ResultLine)](
    draw: Callable[[Sequence[T], int, int], Drawing], rows: Sequence[T]
) -> list[Drawing]:
    """Return drawings of at most 30 rows each, about the same number; `draw` receives which of how many it makes."""
    count = -(-len(rows) // _MOST_ROWS)
    size = -(-len(rows) // count)
    parts = [rows[start : start + size] for start in range(0, len(rows), size)]
    return [draw(part, number, len(parts)) for number, part in enumerate(parts, 1)]


def _name_rows(axes: Axes, names: Sequence[str], size: float = 7) -> None:
    """Write names beside rows, without ticks and without a line at the left."""
    style.name_rows(axes, names, fontsize=size)
    axes.spines["left"].set_visible(False)


def part_of(line: BudgetLine) -> str:
    """Return the part of a bar that a contribution belongs to."""
    if line.kind == "run":
        return "noise of runs"
    if line.source is not None:
        return line.source
    return line.kind.replace("_", " ")


def _bars(budgets: Sequence[QuantityBudget], number: int, of: int) -> Drawing:
    name = "Shares of the posterior variance" + (f", {number} of {of}" if of > 1 else "")
    height = _ROW * len(budgets)
    shares = np.zeros((len(budgets), len(_PARTS)))
    for row, budget in enumerate(budgets):
        for line in budget.lines:
            shares[row, list(_PARTS).index(part_of(line))] += line.share
    ends = np.cumsum(shares, axis=1)

    def draw(figure: Figure) -> None:
        title(figure, name)
        axes = place(figure, _NAMES, 0.42, WIDTH - _NAMES - 0.15, height)
        for column, colour in enumerate(_PARTS.values()):
            rectangles = [
                (ends[row, column] - shares[row, column], row - 0.36, shares[row, column], 0.72)
                for row in range(len(budgets))
                if shares[row, column] > 1e-3
            ]
            _fill(axes, rectangles, colour)
        axes.set(xlim=(0, max(1.0, float(ends.max()))), ylim=(len(budgets) - 0.4, -0.6))
        _name_rows(axes, [each.name for each in budgets])
        axes.set_xticks([0, 0.25, 0.5, 0.75, 1.0], ["0", "25", "50", "75", "100"])
        axes.set_xlabel("share of the posterior variance / %")
        used = [part for part, share in zip(_PARTS, shares.sum(axis=0), strict=True) if share > 0]
        handles = [Patch(color=_PARTS[part], label=_WORDS.get(part, f"B: {part}")) for part in used]
        width, whole = figure.get_size_inches()
        figure.legend(
            handles=handles, loc="upper left", bbox_to_anchor=(0.06 / width, 1 - 0.22 / whole), ncols=3,
            columnspacing=1.0, handlelength=1.2, handletextpad=0.4, fontsize=7,
        )  # fmt: skip

    return drawn(f"budget-{number}", name, height + 0.42 + _LEGEND + 0.1, draw)


def _fill(axes: Axes, rectangles: Iterable[tuple[float, float, float, float]], colour: str, alpha: float = 1.0) -> None:
    """Fill rectangles (left, bottom, width, height) with one path: an SVG of one element."""
    outlines = [
        Path([(x, y), (x + width, y), (x + width, y + height), (x, y + height), (x, y)], closed=True)
        for x, y, width, height in rectangles
    ]
    if outlines:
        axes.add_patch(PathPatch(Path.make_compound_path(*outlines), facecolor=colour, alpha=alpha, linewidth=0))


def correlation_drawing(matrix: CorrelationMatrix, names: Sequence[str]) -> Drawings:
    """Return the correlations of some quantities as a lower triangle of squares."""
    places = [matrix.names.index(name) for name in names]
    name, cell = "Correlations of the posterior", min(0.155, (_WHOLE_PAGE - _NAMES - 0.15) / max(len(names), 1))
    size = cell * len(names)

    def draw(figure: Figure) -> None:
        title(figure, name)
        axes = place(figure, _NAMES, 0.15, size, size)
        for sign, colour in ((1, style.BLUE), (-1, style.VERMILION)):
            squares = [
                (column - side / 2, row - side / 2, side, side)
                for row in range(len(names))
                for column in range(row)
                for value in (_value(matrix, places[row], places[column]),)
                if sign * value >= _LEAST
                for side in (0.9 * abs(value) ** 0.5,)
            ]
            _fill(axes, squares, colour)
        axes.plot([-0.5, len(names) - 0.5], [-0.5, len(names) - 0.5], color=style.QUIET, linewidth=0.5)
        axes.set(xlim=(-0.5, len(names) - 0.5), ylim=(len(names) - 0.5, -0.5))
        _name_rows(axes, names, min(7.0, cell * 72 * 0.8))
        axes.set_xticks([])
        axes.spines["bottom"].set_visible(False)

    width = max(WIDTH, _NAMES + size + 0.15)
    return Drawings([drawn("correlations", name, size + 0.5, draw, width)], _MATRIX)


def _value(matrix: CorrelationMatrix, first: int, second: int) -> float:
    return matrix.rows[max(first, second)][min(first, second)]


# Posterior over prior standard deviation above which the data did not determine a parameter.
_UNDETERMINED = 0.95
_CAPTION = (
    "Parameters with a normal prior: posterior mean and 95 % coverage interval in prior standard deviations about the "
    "prior mean. Dark band: ± 1 prior standard deviation; light band: ± 2. With a good set of runs every interval is "
    "short and most points lie within the bands. An interval as wide as the light band (vermilion, triangle) was not "
    "determined by the data; a point far outside means that unit or equipment is worse than its prior says."
)


def forest_drawings(results: Sequence[ResultLine]) -> Drawings | None:
    """Return the forest plot in drawings of at most 30 rows; None if no parameter has a normal prior."""
    lines = [line for line in results if line.prior_mean is not None and line.prior_sd and line.estimate is not None]
    if not lines:
        return None
    return Drawings(_in_parts(_forest, lines), _CAPTION)


def _forest(lines: Sequence[ResultLine], number: int, of: int) -> Drawing:
    name = "Parameters on the scale of their priors" + (f", {number} of {of}" if of > 1 else "")
    height = _ROW * len(lines)

    def draw(figure: Figure) -> None:
        title(figure, name)
        axes = place(figure, _NAMES, 0.42, WIDTH - _NAMES - 0.1, height)
        axes.axvspan(-2, 2, color=style.BAND_WIDE, zorder=0)
        axes.axvspan(-1, 1, color=style.BAND, zorder=0)
        axes.axvline(0, color=style.QUIET, linewidth=0.5)
        for row, each in enumerate(lines):
            assert each.prior_mean is not None and each.prior_sd is not None  # noqa: PT018
            assert each.estimate is not None and each.low is not None and each.high is not None  # noqa: PT018
            at, low, high = (
                (value - each.prior_mean) / each.prior_sd for value in (each.estimate, each.low, each.high)
            )
            weak = (each.standard_uncertainty or 0.0) > _UNDETERMINED * each.prior_sd
            colour = style.VERMILION if weak else style.BLUE
            axes.plot([low, high], [row, row], color=colour, linewidth=1.4)
            axes.plot([at], [row], "^" if weak else "o", color=colour, markersize=3)
        axes.set(ylim=(len(lines) - 0.4, -0.6))
        _name_rows(axes, [each.name for each in lines])
        axes.set_xlabel("(estimate − prior mean) / prior sd")

    return drawn(f"forest-{number}", name, height + 0.75, draw)
