"""The common style of all figures: frame, panels, legends, and the signs of the runs.

The title stands above a figure, the caption below.  Panels are placed in inches: constrained layout would draw every
figure twice.

Runs are distinguished by the hue, which stands for the mounting, and by the marker, which stands for the temperature.
The hues are distinguished by readers with normal vision, protanopia, deuteranopia and tritanopia: CIE 1976 colour
difference of at least 22 in each simulation of Machado, Oliveira and Fernandes (2009).
"""

import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import wraps
from importlib.resources import files
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from imubayes.display.numbers_and_labels import shortened
from imubayes.display.residual_columns import temperature_levels
from imubayes.foundations.files import replacing

HUES = ("#0072b2", "#d55e00", "#56b4e9", "#7a3b00", "#8c8c8c", "#332288")
"""Hues of runs, in order: told apart by readers with colour-blindness."""
MARKERS = ("o", "^", "s", "D", "v", "P", "X")
"""Markers of the runs of one hue, in order."""
_STYLES = 2 * len(HUES)
"""Filled and open markers of each hue."""


@dataclass(frozen=True)
class Sign:
    """How points of a run are drawn: hue, marker, and whether the marker is filled."""

    hue: str
    marker: str = "o"
    filled: bool = True


@dataclass(frozen=True)
class LegendEntry:
    """A line of a legend; a heading if it has no sign."""

    label: str
    sign: Sign | None = None


class RunSigns:
    """The sign of every run, the same in all figures of a result.

    Runs of one mounting share a hue, runs at one temperature a marker.  If all runs have one mounting, or there are
    too many, the hue is that of the run itself or, for more than 12 runs, of the procedure.
    """

    def __init__(
        self,
        runs: Sequence[str],
        mounting: Mapping[str, str] | None = None,
        temperature: Mapping[str, str] | None = None,
        procedure: Mapping[str, str] | None = None,
    ):
        self.runs = list(dict.fromkeys(runs))
        self._heading, self._hue_of = self._by_hue(mounting or {}, procedure or {})
        levels = {run: (temperature or {}).get(run, "") for run in self.runs}
        self._levels = sorted({*levels.values()}, key=_level_order)
        self._level_of = levels if len(self._levels) <= len(MARKERS) else dict.fromkeys(self.runs, "")
        self._classes = list(dict.fromkeys(self._hue_of.values()))

    def _by_hue(self, mounting: Mapping[str, str], procedure: Mapping[str, str]) -> tuple[str, dict[str, str]]:
        """Return what the hues mean, and the class of every run."""
        mounted = {run: mounting.get(run) or "no mounting" for run in self.runs}
        if 1 < len({*mounted.values()}) <= _STYLES:
            return "mounting", mounted
        kinds = {run: procedure.get(run, "").replace("_", " ") for run in self.runs}
        if len(self.runs) > _STYLES and 1 < len({*kinds.values()}) <= _STYLES:
            return "procedure", kinds
        return "run", {run: run for run in self.runs}

    def sign(self, run: str) -> Sign:
        """Return the sign of a run."""
        turn, place = divmod(self._classes.index(self._hue_of[run]), len(HUES))
        marker = MARKERS[self._levels.index(self._level_of[run])] if len(self._levels) > 1 else MARKERS[0]
        return Sign(HUES[place], marker, turn % 2 == 0)

    def legend(self, shown: Sequence[str] | None = None) -> list[LegendEntry]:
        """Return the entries of a legend of the runs that are shown: hues first, then markers."""
        runs = [run for run in self.runs if shown is None or run in shown]
        levels = sorted({self._level_of[run] for run in runs}, key=_level_order)
        first = {self._hue_of[run]: self.sign(run) for run in reversed(runs)}
        classes = list(dict.fromkeys(self._hue_of[run] for run in runs))
        if len(levels) < 2:
            heading = [] if self._heading == "run" else [LegendEntry(self._heading)]
            return heading + [LegendEntry(shortened(name, 25), first[name]) for name in classes]
        hues = [Sign(first[name].hue, MARKERS[0], first[name].filled) for name in classes]
        found = [LegendEntry(self._heading)]
        found += [LegendEntry(shortened(name, 25), sign) for name, sign in zip(classes, hues, strict=True)]
        found.append(LegendEntry("temperature"))
        for level in levels:
            sign = Sign("#222222", MARKERS[self._levels.index(level)])
            found.append(LegendEntry(level or "not recorded", sign))
        return found


def run_signs(residuals: pl.DataFrame, runs: Sequence[str] | None = None) -> RunSigns:
    """Return the signs of the runs of a residuals table, in its order or in that of `runs`.

    Results of earlier versions have no mountings in their table; their hues are those of the runs.
    """
    names = list(runs) if runs is not None else residuals["run"].unique(maintain_order=True).to_list()
    return RunSigns(names, _text(residuals, "mounting"), temperature_levels(residuals), _text(residuals, "procedure"))


def _text(residuals: pl.DataFrame, column: str) -> dict[str, str]:
    """Return the text that each run has in a column; nothing if the table has no such column."""
    if column not in residuals.columns:
        return {}
    found = residuals.group_by("run").agg(pl.col(column).first())
    return {run: text for run, text in found.iter_rows() if text is not None}


def _level_order(level: str) -> tuple[bool, float, str]:
    """Return the key that puts temperatures in ascending order, and ramps and unknown ones last."""
    number = level.removesuffix(" °C").replace("−", "-")
    try:
        return False, float(number), level
    except ValueError:
        return True, 0.0, level


INK, QUIET, FAINT, RED = "#222222", "#666666", "#dddddd", "#b91c1c"
"""Colours of text and lines, of what is secondary, of grids, and of what is wrong."""
BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY = "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"
"""Colours of quantities: the palette of Okabe and Ito."""
BAND, BAND_WIDE = "#cfd8e3", "#e9eef4"
"""Colours of a coverage interval, and of a wider one."""
MOST_PANELS = 6
"""Panels of a picture at most."""
TEXT, SMALL, _TITLE = 9.0, 8.0, 13.0
"""Sizes of text, pt."""
STYLE = mpl.rc_params_from_file(str(files("imubayes.display") / "imubayes.mplstyle"), use_default_template=False)
"""The settings of Matplotlib under which all pictures are drawn."""
_EDGE = 0.3


class Picture(Figure):
    """A figure with its caption, which shows itself in a notebook.

    Attributes
    ----------
    caption : what is drawn and what a good model would look like.
    inside : left, bottom, right and top of the area between title and caption, inches.
    """

    caption: str = ""
    inside: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 1.0)

    def _repr_png_(self) -> bytes:
        return self.png()

    def png(self) -> bytes:
        """Return the figure as PNG."""
        buffer = BytesIO()
        with mpl.rc_context(STYLE):
            # Fast compression: a fifth larger, in a third of the time.
            self.savefig(buffer, format="png", pil_kwargs={"compress_level": 1})
        return buffer.getvalue()

    def svg(self) -> str:
        """Return the figure as an SVG element, its text as text, artists with an address as links."""
        buffer = StringIO()
        with mpl.rc_context(STYLE), mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": self.caption}):
            self.savefig(buffer, format="svg", metadata={"Date": None})
        return buffer.getvalue()[buffer.getvalue().index("<svg") :]

    def save(self, file: str | Path) -> Path:
        """Write the figure as PNG, replacing the file atomically."""
        file = Path(file)
        with replacing(file) as scratch:
            scratch.write_bytes(self.png())
        return file


def themed[**P](draw: Callable[P, Picture]) -> Callable[P, Picture]:
    """Draw in the common style, whatever style is set around it."""

    @wraps(draw)
    def wrapper(*args: P.args, **kwargs: P.kwargs) -> Picture:
        with mpl.rc_context(STYLE):
            return draw(*args, **kwargs)

    return wrapper


def picture(width: float, height: float, title: str, caption: str, subtitle: str = "", alarm: str = "") -> Picture:
    """Return an empty figure with its title above and its caption below.

    Parameters
    ----------
    width : of the figure, inches.
    height : of the area between title and caption, inches.
    title, caption : what is drawn; what a good model would look like.
    subtitle : below the title.
    alarm : a warning that takes the place of the subtitle, in red.
    """
    inner = width - 2 * _EDGE
    # Wrapped, and the figure as much higher: nothing of a title or a warning is left out.
    heading = textwrap.wrap(title, int(inner * 72 / (_TITLE * 0.6)))
    said = textwrap.wrap(alarm or subtitle, int(inner * 72 / (TEXT * (0.58 if alarm else 0.545))))
    lines = textwrap.wrap(caption, int(inner * 72 / (TEXT * 0.545)))
    below, lower = 0.32 + 0.165 * len(lines), 0.24 * (len(heading) - 1)
    whole = height + below + 0.42 + lower + (0.035 + 0.165 * len(said) if said else 0.0)
    figure = Picture(figsize=(width, whole))
    FigureCanvasAgg(figure)
    figure.caption = caption
    figure.inside = (_EDGE, below, width - _EDGE, below + height)
    left = _EDGE / width
    figure.text(left, 1 - 0.13 / whole, "\n".join(heading), size=_TITLE, weight="bold", va="top")
    figure.text(
        left, 1 - (0.42 + lower) / whole, "\n".join(said), color=RED if alarm else QUIET, va="top", linespacing=1.3
    )
    figure.text(left, 0.17 / whole, "\n".join(lines), va="bottom", linespacing=1.3)
    return figure


def panels(
    figure: Picture,
    rows: int = 1,
    columns: int = 1,
    margins: tuple[float, float, float, float] = (0.7, 0.5, 0.1, 0.3),
    gaps: tuple[float, float] = (0.85, 0.36),
    share_x: bool = False,
    widths: Sequence[float] | None = None,
) -> np.ndarray:
    """Return a grid of panels that fills the area between title and caption.

    Parameters
    ----------
    rows, columns : of the grid.
    margins : left, bottom, right and top of the grid, inches.
    gaps : between columns and between rows, inches.
    share_x : whether the panels of a column have one abscissa, drawn below the last.
    widths : of the columns, relative.

    Returns
    -------
    np.ndarray
        shape (rows, columns), of Axes.
    """
    width, height = figure.get_size_inches()
    left, bottom, right, top = (
        edge + sign * margin for edge, sign, margin in zip(figure.inside, (1, 1, -1, -1), margins, strict=True)
    )
    across = (right - left - (columns - 1) * gaps[0]) / columns
    up = (top - bottom - (rows - 1) * gaps[1]) / rows
    grid = GridSpec(
        rows, columns, figure,
        left=left / width, right=right / width, bottom=bottom / height, top=top / height,
        wspace=gaps[0] / across, hspace=gaps[1] / up, width_ratios=widths,
    )  # fmt: skip
    found = grid.subplots(sharex="col" if share_x else False, squeeze=False)
    for axes in found.flat:
        axes.yaxis.set_major_locator(FewTicks())
    for axes in found[:-1].flat if share_x else ():
        axes.xaxis.set_visible(False)
    return found


def name_rows(axes: Axes, names: Sequence[str], most: int = 34, **style: Any) -> None:
    """Write names beside rows, the first at 0, shortened to so many characters and without ticks."""
    axes.set_yticks(range(len(names)), [shortened(name, most) for name in names], **style)
    axes.tick_params(axis="y", length=0)


def legend_at(figure: Picture, left: float, top: float, handles: Sequence, **style: Any) -> None:
    """Put a legend with its upper left corner at a place in inches."""
    width, height = figure.get_size_inches()
    figure.legend(handles=handles, loc="upper left", bbox_to_anchor=(left / width, top / height), **style)


def legend_above(figure: Picture, handles: Sequence) -> None:
    """Put a legend in one line beside the title."""
    width, height = figure.get_size_inches()
    corner = (1 - _EDGE / width, 1 - 0.11 / height)
    figure.legend(handles=handles, loc="upper right", bbox_to_anchor=corner, ncols=len(handles), columnspacing=1.2)


def dot(colour: str, label: str, **style: Any) -> Line2D:
    """Return the legend entry of points."""
    return Line2D([], [], linestyle="", **{"marker": "o", "color": colour, "markersize": 5, "label": label, **style})


def at_runs(axes: Axes, x: np.ndarray, y: np.ndarray, runs: np.ndarray, signs: RunSigns, **style: Any) -> None:
    """Draw points in the hue and marker of their run; `runs` holds a name per point."""
    for run in dict.fromkeys(runs.tolist()):
        mask = runs == run
        axes.plot(x[mask], y[mask], linestyle="", zorder=3, **_style(signs.sign(run)), **style)


class FewTicks(MaxNLocator):
    """At most four intervals; no ticks outside the limits, which would be made but not drawn."""

    def __init__(self) -> None:
        super().__init__(4, steps=[1, 2, 2.5, 5, 10])

    def tick_values(self, vmin: float, vmax: float) -> Sequence[float]:
        """Return round values within the limits."""
        return [value for value in super().tick_values(vmin, vmax) if vmin <= value <= vmax]


def runs_legend(figure: Picture, left: float, signs: RunSigns, shown: Sequence[str] | None = None) -> None:
    """List what hues and markers of the runs mean from `left` inches on, as many as there is room for."""
    _, bottom, _, top = figure.inside
    room = int((top - bottom) / 0.185)
    entries = signs.legend(shown)
    listed = entries if len(entries) <= room else entries[: room - 1]
    handles = [dot("none", each.label) if each.sign is None else _entry(each.label, each.sign) for each in listed]
    if len(listed) < len(entries):
        handles.append(dot("none", f"… {len(entries) - len(listed)} more"))
    legend_at(figure, left, top, handles, handlelength=0.8, labelspacing=0.55)


def _entry(label: str, sign: Sign) -> Line2D:
    return Line2D([], [], linestyle="", markersize=5, label=label, **_style(sign))


def _style(sign: Sign) -> dict[str, Any]:
    """Return the style of a sign for matplotlib; open markers have a white face."""
    face = {} if sign.filled else {"markerfacecolor": "white"}
    return {"color": sign.hue, "marker": sign.marker, **face}
