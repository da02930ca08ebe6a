"""The picture of the zero of a table in the data dictionary: python data/generators/table_zero.py [FILE].

For a rate table and a dividing head: the axis z, the axes x and y at angle 0, and the sense in which the angle grows,
all worked out from azimuth and elevation by the simulator's own rotations.
"""

import sys
from pathlib import Path

import numpy as np

from kinematics import Table, about

EXAMPLES = (
    (Table("rate table", 0.0, 90.0), "azimuth_deg = 0, elevation_deg = 90"),
    (Table("dividing head", 90.0, 0.0), "azimuth_deg = 90, elevation_deg = 0"),
    (Table("polar axis", 0.0, 34.25), "azimuth_deg = 0, elevation_deg = latitude"),
)
COLOURS = {"x": "#0072b2", "y": "#009e73", "z": "#d55e00"}
VIEW = np.array([[0.93, 0.36, 0.0], [-0.16, 0.42, 0.89]])
"""East, North and up as they are seen from the south and above."""
COMPASS = np.array([-1.6, -1.15])


def draw(file: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(1, len(EXAMPLES), figsize=(9, 3.4))
    for axes, (table, said) in zip(panels, EXAMPLES, strict=True):
        _panel(axes, table, said)
    figure.subplots_adjust(left=0.01, right=0.99, top=0.84, bottom=0.02, wspace=0.02)
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=110)
    plt.close(figure)


def _panel(axes, table: Table, said: str) -> None:
    stand = table.stand([0.0, 0.0])
    for name, way in (("East", (1, 0, 0)), ("North", (0, 1, 0)), ("up", (0, 0, 1))):
        _arrow(axes, np.array(way) * 0.45, name, "0.45", 0.9, COMPASS)
    disc = stand @ about(2, np.linspace(0, 2 * np.pi, 73))[..., 0].T
    axes.fill(*(VIEW @ disc), facecolor="0.93", edgecolor="0.6", linewidth=0.8)
    for column, name in enumerate("xyz"):
        label = f"{name} at angle 0" if name != "z" else "z, the axis"
        _arrow(axes, stand[:, column] * (1.3 if name == "z" else 1.0), label, COLOURS[name], 2.0)
    turned = VIEW @ (stand @ about(2, np.radians(np.linspace(6, 62, 30)))[..., 0].T) * 0.62
    axes.plot(*turned[:, :-1], color="black", linewidth=1.2)
    axes.annotate("", turned[:, -1], turned[:, -3], arrowprops={"arrowstyle": "-|>", "color": "black"})
    axes.text(*(turned[:, 15] * 1.3), "+", ha="center", va="center", fontsize=11)
    axes.set(xlim=(-1.7, 2.0), ylim=(-1.35, 1.5), aspect="equal")
    axes.set_title(f"{table.name}\n{said}", fontsize=9)
    axes.axis("off")


def _arrow(axes, way: np.ndarray, label: str, colour: str, width: float, start=(0.0, 0.0)) -> None:
    end = np.asarray(start) + VIEW @ way
    style = {"arrowstyle": "-|>", "color": colour, "linewidth": width, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", end, start, arrowprops=style)
    beyond = end + 0.16 * (end - start) / np.linalg.norm(end - start)
    aside = beyond[0] - start[0]
    side = "left" if aside > 0.3 else "right" if aside < -0.2 else "center"
    axes.text(*beyond, label, color=colour, ha=side, va="center", fontsize=8)


if __name__ == "__main__":
    draw(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parents[1] / "table-zero.png")
