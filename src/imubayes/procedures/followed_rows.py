"""Nodes of rows in which the table moves: the angle of its encoder is known throughout the row.

Within a row of T s the angle is a polynomial of the eighth degree in the time t since the middle of the row, given by
its derivatives there; the rate of the row is the mean, (φ(T/2) − φ(−T/2))/T.  The outputs are N samples, one interval
apart.  The nodes are those of the Gauss quadrature of the N samples: the mean over a row is then the mean of the
samples, not an integral, to the 15th degree.  They are the abscissae of the discrete Chebyshev polynomials (Golub and
Welsch, Math. Comp. 23 (1969), 221; recurrence: Abramowitz and Stegun 22.17).

A lag acts on how a signal changes within the row.  The mean of dⁿx/dtⁿ over the row is a linear combination of the
values of x at the nodes; the ratio of its weights to those of the mean is the covariate `row_slope_n` of each node.
"""

import math
from dataclasses import dataclass

import numpy as np

from imubayes.foundations.campaign_data import Run
from imubayes.foundations.covariates import HIGHER_DERIVATIVES, ROW_SLOPES

NODES = 8
"""Nodes of a row, and the least number of its samples: derivatives of the rate are exact."""


@dataclass(frozen=True)
class FollowedNodes:
    """The nodes of rows in motion (n of them), in SI.

    Attributes
    ----------
    row : shape (n,), the row that each belongs to.
    weight : shape (n,), sums to 1 over the nodes of a row.
    angle, rate, acceleration : shape (n,), of the table.
    ambient : covariate name → shape (n,), the higher derivatives of the angle and `row_slope_n`.
    """

    row: np.ndarray
    weight: np.ndarray
    angle: np.ndarray
    rate: np.ndarray
    acceleration: np.ndarray
    ambient: dict[str, np.ndarray]


def followed(run: Run) -> np.ndarray:
    """Return which rows of a run follow the angle of the table, shape (R,) bool."""
    return run.covariates.get("row_seconds", np.zeros(run.rows)) > 0


def followed_nodes(run: Run) -> FollowedNodes:
    """Return the nodes of the rows of a run that follow the angle of the table, row after row."""
    rows = np.flatnonzero(followed(run))
    known = run.covariates
    seconds, counts = known["row_seconds"][rows], np.maximum(np.round(run.samples[rows]).astype(int), NODES)
    quadratures = {count: quadrature(count) for count in np.unique(counts).tolist()}
    place, weight, slopes = (
        np.stack([quadratures[count][part] for count in counts.tolist()]) if len(rows) else np.zeros((0, NODES))
        for part in range(3)
    )
    interval = seconds / counts
    time = place * interval[:, None]
    derivative = derivatives_at(time, angle_derivatives(run, rows))
    ambient = {f"table_angle_d{order}": derivative[order] for order in HIGHER_DERIVATIVES}
    ambient |= {
        f"row_slope_{order}": slopes[:, :, order - 1] / interval[:, None] ** order if len(rows) else time
        for order in ROW_SLOPES
    }
    return FollowedNodes(
        np.repeat(rows, NODES),
        weight.reshape(-1),
        derivative[0].reshape(-1),
        derivative[1].reshape(-1),
        derivative[2].reshape(-1),
        {name: values.reshape(-1) for name, values in ambient.items()},
    )


def arc_slopes(run: Run, row: np.ndarray, points: np.ndarray, weights: np.ndarray) -> dict[str, np.ndarray]:
    """Return `row_seconds` and `row_slope_n` of the nodes of a run in arcs at constant rate, 0 of others, (n,) each.

    Parameters
    ----------
    row : shape (n,), of each node.
    points, weights : shape (K,), places of the nodes of an arc, of its length, and their weights.
    """
    rate, span = run.covariates["table_rate"], np.abs(run.covariates["table_angle_span"])
    arc = np.isfinite(run.covariates["table_angle"]) & (rate != 0) & (span > 0) & ~followed(run)
    inside = arc[row]
    per_second = rate[row] / np.where(inside, span[row], 1.0)  # nodes are in the order of angle, not of time
    slope = _slope_ratios(points, weights)
    arcs = np.count_nonzero(inside) // len(points)
    found = {"row_seconds": np.where(inside, 1 / np.where(inside, np.abs(per_second), 1.0), 0.0)}
    for place, order in enumerate(ROW_SLOPES):
        found[f"row_slope_{order}"] = np.zeros(len(row))
        found[f"row_slope_{order}"][inside] = np.tile(slope[:, place], arcs) * per_second[inside] ** order
    return found


def angle_derivatives(run: Run, rows: np.ndarray) -> np.ndarray:
    """Return the angle and its eight derivatives in the middle of rows, (9, n), SI.

    The rate of a row is its mean: φ' = mean − φ'''·(T/2)²/3! − φ⁽⁵⁾·(T/2)⁴/5! − …
    """
    known = run.covariates
    seconds = known["row_seconds"][rows]
    none = np.zeros(run.rows)
    higher = [known.get(f"table_angle_d{order}", none)[rows] for order in HIGHER_DERIVATIVES]
    odd = zip(HIGHER_DERIVATIVES[::2], higher[::2], strict=True)
    rate = known["table_rate"][rows] - sum(
        each * (seconds / 2) ** (order - 1) / math.factorial(order) for order, each in odd
    )
    return np.stack([known["table_angle"][rows], rate, known.get("table_acceleration", none)[rows], *higher])


def derivatives_at(time: np.ndarray, derivatives: np.ndarray) -> np.ndarray:
    """Return a polynomial and its derivatives at times since the middle, (D, n, K).

    Parameters
    ----------
    time : shape (n, K), s.
    derivatives : shape (D, n), in the middle.
    """
    powers = np.stack([time**order / math.factorial(order) for order in range(len(derivatives))])
    return np.stack(
        [
            np.einsum("dn,dnk->nk", derivatives[order:], powers[: len(derivatives) - order])
            for order in range(len(derivatives))
        ]
    )


def quadrature(samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the nodes of the mean of samples one apart, about their middle; their weights, and those of slopes.

    Parameters
    ----------
    samples : their number N, at least `NODES`.

    Returns
    -------
    Places (K,) and weights (K,) of the nodes; ratios (K, 6) of their weights in mean derivatives to those in the mean.
    """
    order = np.arange(1, NODES)
    beside = np.sqrt(order**2 * (samples**2 - order**2) / (4.0 * (4 * order**2 - 1)))
    place, vectors = np.linalg.eigh(np.diag(beside, 1) + np.diag(beside, -1))
    weight = vectors[0] ** 2
    return place, weight, _slope_ratios(place, weight)


def _slope_ratios(place: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the ratios (K, 6) of the weights in mean derivatives to those in the mean, of nodes with weights (K,)."""
    slope, ratios, through = _differentiation(place), [], weight
    for _ in ROW_SLOPES:
        through = through @ slope
        ratios.append(through / weight)
    return np.stack(ratios, axis=1)


def _differentiation(place: np.ndarray) -> np.ndarray:
    """Return the matrix from values at places to the slopes there of the polynomial through them, (K, K)."""
    apart = place[:, None] - place[None, :] + np.eye(len(place))
    product = apart.prod(axis=1)
    matrix = product[:, None] / product[None, :] / apart
    np.fill_diagonal(matrix, 0.0)
    # A constant has no slope.
    return matrix - np.diag(matrix.sum(axis=1))
