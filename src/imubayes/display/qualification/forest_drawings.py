"""Forest plot of the parameters: estimate and coverage interval on the scale of the prior."""

from collections.abc import Sequence

from matplotlib.figure import Figure

from imubayes.display.labels import shortened
from imubayes.display.qualification.document import Drawing, Drawings
from imubayes.display.qualification.svg_drawing import WIDTH, drawn, place, title
from imubayes.display.theme import BAND, BAND_WIDE, BLUE, QUIET, VERMILION
from imubayes.qualification.report_record import ResultLine

_MOST_ROWS, _ROW, _NAMES = 30, 0.155, 2.0
# Posterior over prior standard deviation above which the data did not determine a parameter.
_UNDETERMINED = 0.95
_CAPTION = (
    "Parameters with a normal prior: posterior mean and 95 % coverage interval in prior standard deviations about the "
    "prior mean. Dark band: ± 1 prior standard deviation; light band: ± 2. With a good set of runs every interval is "
    "short and most points lie within the bands. An interval as wide as the light band (vermilion, triangle) was not "
    "determined by the data; a point far outside means that unit or equipment is worse than its prior says."
)


def forest_drawings(results: Sequence[ResultLine]) -> Drawings | None:
    """Return the forest plot in drawings of at most 30 rows; None where no parameter has a normal prior."""
    lines = [line for line in results if line.prior_mean is not None and line.prior_sd and line.estimate is not None]
    if not lines:
        return None
    count = -(-len(lines) // _MOST_ROWS)
    size = -(-len(lines) // count)
    parts = [lines[start : start + size] for start in range(0, len(lines), size)]
    return Drawings([_forest(part, k, len(parts)) for k, part in enumerate(parts, 1)], _CAPTION)


def _forest(lines: Sequence[ResultLine], number: int, of: int) -> Drawing:
    name = "Parameters on the scale of their priors" + (f", {number} of {of}" if of > 1 else "")
    height = _ROW * len(lines)

    def draw(figure: Figure) -> None:
        title(figure, name)
        axes = place(figure, _NAMES, 0.42, WIDTH - _NAMES - 0.1, height)
        axes.axvspan(-2, 2, color=BAND_WIDE, zorder=0)
        axes.axvspan(-1, 1, color=BAND, zorder=0)
        axes.axvline(0, color=QUIET, linewidth=0.5)
        for row, each in enumerate(lines):
            assert each.prior_mean is not None and each.prior_sd is not None  # noqa: PT018
            assert each.estimate is not None and each.low is not None and each.high is not None  # noqa: PT018
            at, low, high = (
                (value - each.prior_mean) / each.prior_sd for value in (each.estimate, each.low, each.high)
            )
            weak = (each.standard_uncertainty or 0.0) > _UNDETERMINED * each.prior_sd
            colour = VERMILION if weak else BLUE
            axes.plot([low, high], [row, row], color=colour, linewidth=1.4)
            axes.plot([at], [row], "^" if weak else "o", color=colour, markersize=3)
        axes.set(ylim=(len(lines) - 0.4, -0.6))
        axes.set_yticks(range(len(lines)), [shortened(each.name, 34) for each in lines], fontsize=7)
        axes.tick_params(axis="y", length=0)
        axes.spines["left"].set_visible(False)
        axes.set_xlabel("(estimate − prior mean) / prior sd")

    return drawn(f"forest-{number}", name, height + 0.75, draw)
