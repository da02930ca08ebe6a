"""Lines, points and bands put into a panel whose limits are set by hand.

matplotlib's `plot` and `fill_between` also keep book for automatic limits and units, which takes longer than the marks
themselves; a page has a hundred of them.
"""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.lines import Line2D


def line(axes: Axes, x: Any, y: Any, **style: Any) -> None:
    """Draw a line, or with `linestyle=""` and a marker, points."""
    axes.add_artist(Line2D(x, y, **style))


def points(axes: Axes, x: Any, y: Any, marker: Any, size: float, colour: str, **style: Any) -> None:
    """Draw points of one colour; `size` in points of type."""
    line(axes, x, y, linestyle="", marker=marker, markersize=size, color=colour, **{"markeredgewidth": 0, **style})


def level(axes: Axes, y: float, colour: str, width: float = 0.7) -> None:
    """Draw a horizontal line through the whole panel."""
    line(axes, [0, 1], [y, y], color=colour, linewidth=width, transform=axes.get_yaxis_transform(), zorder=1.5)


def uprights(axes: Axes, x: np.ndarray, low: Any, high: Any, colour: str, width: float, zorder: float = 2) -> None:
    """Draw vertical lines."""
    low, high = np.broadcast_to(low, x.shape), np.broadcast_to(high, x.shape)
    segments = np.stack([np.stack([x, low], axis=-1), np.stack([x, high], axis=-1)], axis=1)
    axes.add_collection(LineCollection(list(segments), colors=colour, linewidths=width, zorder=zorder), autolim=False)


def band(axes: Axes, x: np.ndarray, low: np.ndarray, high: np.ndarray, colour: str) -> None:
    """Fill between two curves over x."""
    outline = np.concatenate([np.stack([x, low], axis=-1), np.stack([x, high], axis=-1)[::-1]])
    axes.add_collection(PolyCollection([outline], facecolors=colour, linewidths=0, zorder=1), autolim=False)


def strip(axes: Axes, half: float, colour: str) -> None:
    """Fill a horizontal strip about zero through the whole panel."""
    limits = np.array(axes.get_xlim())
    band(axes, limits, np.full(2, -half), np.full(2, half), colour)
