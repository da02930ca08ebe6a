"""One calm look for all pictures: paper, ink, colours of runs, captions that say what a good model looks like.

Hues are those of Okabe and Ito (2008), which the colour-blind can tell apart; where there are more runs than hues the
marker tells them apart as well, so that a run keeps its sign in every picture.  Positions are computed in inches: a
layout engine that draws everything twice would take longer than the pictures themselves.
"""

import textwrap
from collections.abc import Callable, Sequence
from functools import wraps
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from imubayes.atomic_files import replacing
from imubayes.display.labels import shortened

INK, QUIET, FAINT, PAPER, RED = "#222222", "#666666", "#dddddd", "#ffffff", "#b91c1c"
BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY = "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"
HUES = (BLUE, VERMILION, GREEN, PURPLE, SKY, ORANGE, "#555555")
MARKERS = ("o", "^", "s", "D", "v", "P", "X")
BAND, BAND_WIDE = "#cfd8e3", "#e9eef4"
MOST_PANELS = 6
DPI = 100
TEXT, SMALL = 9.0, 8.0
_STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans", "font.size": TEXT, "text.color": INK, "axes.labelcolor": INK,
    "axes.edgecolor": QUIET, "axes.linewidth": 0.7, "axes.labelsize": TEXT, "axes.titlesize": TEXT,
    "axes.titleweight": "bold", "axes.titlelocation": "left", "axes.titlepad": 4.0, "axes.spines.top": False,
    "axes.spines.right": False, "axes.labelpad": 3.0, "xtick.labelsize": SMALL, "ytick.labelsize": SMALL,
    "xtick.color": QUIET, "ytick.color": QUIET, "xtick.labelcolor": INK, "ytick.labelcolor": INK,
    "xtick.major.size": 3.0, "ytick.major.size": 3.0, "xtick.major.pad": 2.5, "ytick.major.pad": 2.5,
    "legend.frameon": False, "legend.fontsize": SMALL, "lines.linewidth": 1.2, "figure.facecolor": PAPER,
    "axes.facecolor": PAPER, "axes.unicode_minus": True, "axes.formatter.useoffset": False,
    "axes.formatter.limits": (-5, 7), "path.simplify": True, "figure.dpi": DPI, "savefig.dpi": DPI,
}  # fmt: skip


class Picture(Figure):
    """A figure that knows its caption, shows itself in a notebook, and is saved whole or not at all.

    Attributes
    ----------
    caption : what is drawn and what a good model would look like.
    inside : left, bottom, right and top of the free area, inches.
    """

    caption: str = ""
    inside: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 1.0)

    def _repr_png_(self) -> bytes:
        return self.png()

    def png(self) -> bytes:
        """Return the picture as PNG."""
        buffer = BytesIO()
        with mpl.rc_context(_STYLE):
            # Fast compression: a fifth larger, in a third of the time.
            self.savefig(buffer, format="png", pil_kwargs={"compress_level": 1})
        return buffer.getvalue()

    def save(self, file: str | Path) -> Path:
        """Write the picture as PNG."""
        file = Path(file)
        with replacing(file) as scratch:
            scratch.write_bytes(self.png())
        return file


def themed[**P](draw: Callable[P, Picture]) -> Callable[P, Picture]:
    """Draw in the common style, whatever style is set around it."""

    @wraps(draw)
    def wrapper(*args: P.args, **kwargs: P.kwargs) -> Picture:
        with mpl.rc_context(_STYLE):
            return draw(*args, **kwargs)

    return wrapper


def picture(width: float, height: float, title: str, caption: str, subtitle: str = "", alarm: str = "") -> Picture:
    """Return an empty picture with its title above and its caption below.

    Parameters
    ----------
    width : of the picture, inches.
    height : of the space between title and caption, inches.
    title, caption : what is drawn; what a good model would look like.
    subtitle : a quiet line below the title.
    alarm : what has to be said before anything else, in red, in the place of the subtitle.
    """
    subtitle = textwrap.shorten(alarm, int((width - 0.6) * 72 / (TEXT * 0.62)), placeholder=" …") or subtitle
    lines = textwrap.wrap(caption, int((width - 0.6) * 72 / (TEXT * 0.545)))
    below = 0.22 + 0.165 * len(lines) + 0.1
    above = 0.42 + (0.2 if subtitle else 0.0)
    whole = height + below + above
    figure = Picture(figsize=(width, whole))
    FigureCanvasAgg(figure)
    figure.caption = caption
    figure.inside = (0.3, below, width - 0.3, below + height)
    figure.text(0.3 / width, 1 - 0.13 / whole, title, size=13, weight="bold", va="top", ha="left")
    if subtitle:
        figure.text(
            0.3 / width, 1 - 0.42 / whole, subtitle, size=TEXT, color=RED if alarm else QUIET, va="top", ha="left"
        )
    figure.text(
        0.3 / width, 0.17 / whole, "\n".join(lines), size=TEXT, color=INK, va="bottom", ha="left", linespacing=1.3
    )
    return figure


def axes_at(figure: Picture, left: float, bottom: float, width: float, height: float) -> Axes:
    """Return axes whose frame has this place and size, inches."""
    whole_width, whole_height = figure.get_size_inches()
    return figure.add_axes((left / whole_width, bottom / whole_height, width / whole_width, height / whole_height))


def text_at(figure: Picture, left: float, bottom: float, text: str, **style) -> None:
    """Write text at a place in inches."""
    whole_width, whole_height = figure.get_size_inches()
    figure.text(left / whole_width, bottom / whole_height, text, **style)


class RunSigns:
    """The hue and marker of every run, the same in all pictures of a result."""

    def __init__(self, runs: Sequence[str]):
        self.runs = list(runs)
        self._place = {name: place for place, name in enumerate(runs)}

    def hue(self, run: str) -> str:
        """Return the colour of a run."""
        return HUES[self._place[run] % len(HUES)]

    def marker(self, run: str) -> str:
        """Return the marker of a run."""
        return MARKERS[self._place[run] // len(HUES) % len(MARKERS)]

    def legend(self, figure: Picture, left: float, top: float, bottom: float, shown: Sequence[str]) -> None:
        """List the runs in a column of small lines; as many as there is room for."""
        step = 0.185
        room = int((top - bottom) / step)
        names = [run for run in self.runs if run in set(shown)]
        listed = names if len(names) <= room else names[: room - 1]
        axes = axes_at(figure, left, bottom, 0.16, top - bottom)
        axes.set_axis_off()
        axes.set(xlim=(0, 1), ylim=(0, top - bottom))
        for place, run in enumerate(listed):
            height = top - bottom - (place + 0.5) * step
            axes.plot([0.5], [height], self.marker(run), color=self.hue(run), markersize=5, markeredgewidth=0)
            text_at(figure, left + 0.2, bottom + height, shortened(run, 25), size=SMALL, va="center", ha="left")
        if len(listed) < len(names):
            height = bottom + (top - bottom) - (len(listed) + 0.5) * step
            text_at(figure, left + 0.2, height, f"… {len(names) - len(listed)} more", size=SMALL, va="center")
