"""Estimable functions of a linear model: the combinations of coefficients that a design determines.

With y = X β + ν a combination wᵀβ has an unbiased linear estimate exactly where w lies in the row space of X.  Single
coefficients come first, then the combinations that textbooks quote, and last the rows of the reduced row echelon form
of X, which complete a basis of the row space.

Source: Searle, Linear Models (1971), § 5.4.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

# Singular values below this fraction of the largest are zero; nominal geometry is exact to rounding.
_RANK = 1e-7


@dataclass(frozen=True)
class Combination:
    """A linear combination of coefficients, wᵀβ.

    Attributes
    ----------
    symbol : `D_I`, or the sum as it is written: `D_II-D_SS`.
    weights : shape (p,).
    """

    symbol: str
    weights: np.ndarray

    @property
    def single(self) -> bool:
        """Whether this is one coefficient by itself."""
        return int(np.count_nonzero(self.weights)) == 1


def estimable(
    design: np.ndarray, names: Sequence[str], standard: Mapping[str, np.ndarray] | None = None
) -> list[Combination]:
    """Return independent combinations that span the row space of a design.

    Parameters
    ----------
    design : shape (n, p).
    names : of the p coefficients.
    standard : symbol → weights, shape (p,), of the combinations to prefer, in order.
    """
    basis = _row_space(design)
    singles = dict(zip(names, np.eye(len(names)), strict=True))
    # The echelon form is complete only for itself: singles and standard combinations take the place of its rows.
    wanted = [Combination(symbol, weights) for symbol, weights in (singles | dict(standard or {})).items()]
    wanted += [Combination(written(row, names), row) for row in echelon(basis)]
    found: list[Combination] = []
    for candidate in wanted:
        if len(found) == len(basis):
            break
        unit = candidate.weights / np.linalg.norm(candidate.weights)
        if np.linalg.norm(unit - basis.T @ (basis @ unit)) > 1e-6:
            continue
        weights = np.array([each.weights / np.linalg.norm(each.weights) for each in (*found, candidate)])
        if np.linalg.matrix_rank(weights, tol=1e-6) == len(weights):
            found.append(candidate)
    return found


def rank(design: np.ndarray) -> int:
    """Return the number of independent combinations that a design determines."""
    return len(_row_space(design))


def _row_space(design: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis of the row space, shape (rank, p)."""
    _, values, rows = np.linalg.svd(design, full_matrices=False)
    return rows[values > _RANK * max(values.max(initial=0.0), np.finfo(float).tiny)]


def echelon(rows: np.ndarray) -> np.ndarray:
    """Return the reduced row echelon form of independent rows, shape (r, p), with 1 at every pivot."""
    reduced = rows.copy()
    place = 0
    for column in range(reduced.shape[1]):
        if place == len(reduced):
            break
        pivot = place + int(np.argmax(np.abs(reduced[place:, column])))
        if abs(reduced[pivot, column]) < 1e-6:
            continue
        reduced[[place, pivot]] = reduced[[pivot, place]]
        reduced[place] /= reduced[place, column]
        others = np.arange(len(reduced)) != place
        reduced[others] -= np.outer(reduced[others, column], reduced[place])
        place += 1
    return np.where(np.abs(reduced) < 1e-6, 0.0, reduced)


def written(weights: Sequence[float] | np.ndarray, names: Sequence[str]) -> str:
    """Return a combination as it is written: `D_F+0.683·D_SS`."""
    text = ""
    for weight, name in zip(weights, names, strict=True):
        if weight:
            factor = "" if abs(abs(weight) - 1) < 1e-6 else f"{abs(weight):.3g}·"
            text += f"{'-' if weight < 0 else '+' if text else ''}{factor}{name}"
    return text
