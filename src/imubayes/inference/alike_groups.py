"""What the rows of runs and channels share, summed once over all groups of one kind.

With the variance T that its rows share, and sums m_i of the Jacobian over its n_i rows of class i, a group takes
ω m mᵀ from the precision of independent rows: m = Σ p_i m_i, ω = T/(1 + T Σ p_i n_i), p_i = 1/v_i
(`imubayes.inference.scale_statistics`).  Groups of one kind have the same T and n_i at every h, and with them ω:

    Σ_g ω m_g m_gᵀ = Σ_ij ω p_i p_j Σ_g m_gi m_gjᵀ,

whose inner sums do not depend on h.  A campaign repeats its runs on several channels, so that its kinds are few.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.foundations.arrays import Scalars

# Groups are of one kind where the variances that their rows share agree to so many digits at several noise scales.
_DIGITS = 10
# Pairs of classes for each group above which summing group by group takes no longer, and numbers in the sums of all.
_MOST_PAIRS, _MOST_NUMBERS = 2, 4_000_000


@dataclass(frozen=True)
class AlikeGroups:
    """Sums over the groups of D kinds, for Q pairs of classes of a kind.

    Attributes
    ----------
    member, count : shape (D,), place of one group of each kind, and number of them.
    rows : shape (D, K), rows of each class in a group.
    kind, first, second : shape (Q,), kind and classes of each pair.
    gram, pulled, square : shapes (Q, P²), (Q, P) and (Q,), sums of products of the Jacobian with itself and with the
        misfit, and of the misfit with itself.
    """

    member: np.ndarray
    count: np.ndarray
    rows: np.ndarray
    kind: np.ndarray
    first: np.ndarray
    second: np.ndarray
    gram: np.ndarray
    pulled: np.ndarray
    square: np.ndarray

    def weights(self, weight: np.ndarray, shared: np.ndarray) -> tuple[np.ndarray, Scalars]:
        """Return what each pair counts, (…, Q), and Σ log (1 + T Σ p n) of all groups, (…).

        Parameters
        ----------
        weight : 1/v of each class, (…, K).
        shared : variance that the rows of each group share, (…, S).
        """
        own = shared[..., self.member]
        gain = 1 + own * (weight @ self.rows.T)
        of_pairs = (own / gain)[..., self.kind] * weight[..., self.first] * weight[..., self.second]
        return of_pairs, np.log(gain) @ self.count

    def slopes(self, weight: np.ndarray, shared: np.ndarray, of_pairs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivatives by 1/v of each class, (n, K), and by the shared variance of each group, (n, S).

        Parameters
        ----------
        weight, shared : as for `weights`, shapes (n, K) and (n, S).
        of_pairs : derivative by what each pair counts, (n, Q); that by Σ log (1 + T Σ p n) is −½.
        """
        own, information = shared[:, self.member], weight @ self.rows.T
        gain = 1 + own * information
        drawn = own / gain
        one, other = weight[:, self.first], weight[:, self.second]
        of_drawn = (of_pairs * one * other) @ one_hot(self.kind, len(self.member))
        along = of_pairs * drawn[:, self.kind]
        found = (along * other) @ one_hot(self.first, weight.shape[1])
        found += (along * one) @ one_hot(self.second, weight.shape[1])
        found -= (of_drawn * drawn**2 + 0.5 * self.count * drawn) @ self.rows
        of_shared = np.zeros(shared.shape)
        of_shared[:, self.member] = of_drawn / gain**2 - 0.5 * self.count * information / gain
        return found, of_shared


def one_hot(places: np.ndarray, count: int) -> np.ndarray:
    """Return the matrix (n, count) that sums what belongs to n places."""
    return (np.asarray(places)[:, None] == np.arange(count)).astype(float)


def alike_groups(
    cell_class: np.ndarray, cell_group: np.ndarray, shared: np.ndarray, classes: int, sums: Sequence[np.ndarray]
) -> AlikeGroups | None:
    """Return the sums over groups of one kind; None if the kinds have too many pairs of classes to gain from it.

    Parameters
    ----------
    cell_class, cell_group : shape (C,), class and group of each cell; sorted by group.
    shared : shape (n, S), variance that the rows of each group share, at several noise scales.
    classes : number K of classes.
    sums : shapes (C, P), (C,), (C,), of each cell over the Jacobian, the misfit and the rows.
    """
    along, misfit, size = sums
    nth = np.arange(len(cell_group)) - np.searchsorted(cell_group, cell_group)
    cells = np.full((shared.shape[1], nth.max(initial=0) + 1), -1)
    cells[cell_group, nth] = np.arange(len(cell_group))
    there = cells >= 0
    made_up = np.where(there, cell_class[cells], -1), np.where(there, size[cells], 0.0)
    signature = np.concatenate([*made_up, np.round(np.log(shared.T), _DIGITS)], axis=1)
    _, member, kind = np.unique(signature, axis=0, return_index=True, return_inverse=True)
    own = there[member].sum(axis=1)
    count = int((own * (own + 1) // 2).sum())
    if not 0 < count <= min(_MOST_PAIRS * len(cells), _MOST_NUMBERS // along.shape[1] ** 2):
        return None
    pairs = [
        (number, one, other)
        for number, most in enumerate(own.tolist())
        for one in range(most)
        for other in range(one, most)
    ]
    rows, typical = np.zeros((len(member), classes)), cells[member][there[member]]
    np.add.at(rows, (np.nonzero(there[member])[0], cell_class[typical]), size[typical])
    grams, pulled, squares = [], [], []
    for number, one, other in pairs:
        left, right = (cells[kind.reshape(-1) == number, place] for place in (one, other))
        twice = 1.0 if one == other else 2.0
        product = along[left].T @ along[right]
        grams.append(0.5 * twice * (product + product.T).reshape(-1))
        pulled.append(0.5 * twice * (misfit[left] @ along[right] + misfit[right] @ along[left]))
        squares.append(twice * misfit[left] @ misfit[right])
    of, one, other = np.array(pairs).T
    first, second = cell_class[cells[member[of], one]], cell_class[cells[member[of], other]]
    groups = np.bincount(kind.reshape(-1)).astype(float)
    return AlikeGroups(member, groups, rows, of, first, second, np.stack(grams), np.stack(pulled), np.array(squares))
