"""Which of several effects that were added the data do not distinguish, by the correlation of their estimates.

Of two effects that do the same the estimates are correlated by −1; of five that do the same any two hardly are, but
each is the opposite of the sum of the others.  So it is the multiple correlation of an estimate with those of the other
effects that counts; of two it is the size of their correlation.
"""

from collections.abc import Sequence

import numpy as np

from imubayes.inference.fitted_model import Posterior
from imubayes.json_record import Record
from imubayes.model.bind import Model

LEAST_CORRELATION = 0.95
# Two effects belong together where they are correlated so much with the others held.
_LINKED = 0.3


class NotDistinguished(Record):
    """Effects that the data do not distinguish, in the order in which they were added.

    Attributes
    ----------
    correlation : of two, the one of largest size between their estimates; of more, the largest multiple correlation of
        an estimate with those of the other effects.
    """

    effects: tuple[str, ...]
    correlation: float


def not_distinguished(model: Model, posterior: Posterior, effects: Sequence[str]) -> tuple[NotDistinguished, ...]:
    """Return the sets of effects whose estimates are correlated beyond 0.95.

    Parameters
    ----------
    model : with the effects.
    posterior : of the Laplace approximation, or sampled.
    effects : those that were added.
    """
    names = tuple(dict.fromkeys(effects))
    parameters = (*model.layout.parameters, *model.hyper_layout.parameters)
    places = [
        place for place, parameter in enumerate(parameters) if parameter.effect in names and not parameter.nuisance
    ]
    owner = np.array([names.index(parameters[place].effect) for place in places], dtype=int)
    if len(set(owner.tolist())) < 2:
        return ()
    correlation = np.corrcoef(posterior.points[:, places], rowvar=False)
    return tuple(
        NotDistinguished(effects=tuple(names[each] for each in together), correlation=size)
        for together, size in correlated_owners(correlation, owner)
    )


def correlated_owners(correlation: np.ndarray, owner: np.ndarray) -> list[tuple[list[int], float]]:
    """Return the sets of owners whose parameters are correlated beyond 0.95, with the correlation.

    Parameters
    ----------
    correlation : shape (K, K), of K parameters.
    owner : shape (K,), whose each of them is, counted from 0.
    """
    correlation = np.where(np.isfinite(correlation), correlation, np.eye(len(owner)))
    multiple = np.array([_multiple(correlation, place, owner != owner[place]) for place in range(len(owner))])
    tied = multiple > LEAST_CORRELATION
    precision = np.linalg.pinv(correlation, hermitian=True)
    scale = np.sqrt(np.diag(precision))
    linked = np.abs(precision / np.outer(scale, scale)) > _LINKED
    groups: list[set[int]] = []
    for first, second in zip(*np.nonzero(linked & np.outer(tied, tied)), strict=True):
        pair = {int(owner[first]), int(owner[second])}
        joined = [group for group in groups if group & pair]
        groups = [group for group in groups if not group & pair] + [pair.union(*joined)]
    found = [sorted(group) for group in groups if len(group) > 1]
    return sorted((group, _size(correlation, multiple, owner, group)) for group in found)


def _multiple(correlation: np.ndarray, place: int, others: np.ndarray) -> float:
    """Return the multiple correlation of one parameter with others, shape (K,) bool."""
    along = correlation[others, place]
    share = float(along @ np.linalg.pinv(correlation[np.ix_(others, others)], hermitian=True) @ along)
    return float(np.sqrt(np.clip(share, 0.0, 1.0)))


def _size(correlation: np.ndarray, multiple: np.ndarray, owner: np.ndarray, group: Sequence[int]) -> float:
    if len(group) > 2:
        return float(np.max(multiple[np.isin(owner, group)]))
    between = correlation[np.ix_(owner == group[0], owner == group[1])].ravel()
    return float(between[np.argmax(np.abs(between))])
