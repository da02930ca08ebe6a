"""Angles near zero: the two components of the direction, which have a gradient where the angle has none.

The angle between two axes is the length of the component of one across the other.  At 0° and 180° a length has no
derivative, and near them its distribution is that of a two-dimensional vector (Rice), so a budget is drawn up of the
components; E[angle²] is the sum of their mean squares, and each input contributes to it through both.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.inference.fitted_model import Fit
from imubayes.model.derived_quantities import evaluate_derived, evaluate_directions
from imubayes.model.nodes_and_entries import KINDS

# An angle closer to 0° or 180° than this many standard deviations of its components is near it: at four the standard
# deviation by its gradient is that of the angle to 3 %.
NEAR = 4.0
# Angles beyond are not looked at, deg: no posterior of a component is as wide.
_CLOSE = 20.0
_APART = 1e-3


@dataclass(frozen=True)
class Components:
    """The components of which a quantity is the length, in its unit.

    Attributes
    ----------
    at_mode : shape (m,).
    gradient : shape (m, P), with respect to z.
    """

    at_mode: np.ndarray
    gradient: np.ndarray


def components_near_zero(fit: Fit, names: Sequence[str], covariance: np.ndarray) -> dict[str, Components]:
    """Return the two components of every angle near 0° or 180°, in deg, by name.

    Parameters
    ----------
    fit : of the quantities.
    names : quantities asked for; other angles are left out.
    covariance : shape (P, P), of the parameters at the mode, in z.
    """
    derivation, problem = fit.derived.derivation, fit.model.problem
    at_mode = evaluate_derived(derivation, problem, fit.z[None])[0].tolist()
    angles = {quantity.name: angle for quantity, angle in zip(fit.derived.names, at_mode, strict=True)}
    pairs = {name: pair for name, pair in _pairs(fit).items() if name in names and _distance(angles[name]) < _CLOSE}
    if not pairs:
        return {}
    steps = _APART * np.eye(len(fit.z))
    points = np.concatenate([fit.z[None], fit.z + steps, fit.z - steps])
    middle, *rest = evaluate_directions(derivation, problem, points)
    above, below = np.split(np.stack(rest), 2)
    slopes = (above - below) / (2 * _APART)  # (P, A, 3)
    found = {}
    for name, (first, second) in pairs.items():
        sign = np.sign(middle[first] @ middle[second])
        across = np.degrees(_across(middle[first]))
        change = ((slopes[:, first] - sign * slopes[:, second]) @ across).T
        widest = np.sqrt(np.linalg.eigvalsh(change @ covariance @ change.T)[-1])
        if _distance(angles[name]) < NEAR * widest:
            found[name] = Components((middle[first] - sign * middle[second]) @ across, change)
    return found


def _distance(angle: float) -> float:
    """Return the distance of an angle, deg, from 0° or 180°."""
    return min(angle, 180.0 - angle)


def _across(axis: np.ndarray) -> np.ndarray:
    """Return two unit vectors across an axis and each other, as columns (3, 2)."""
    return np.linalg.svd(axis[None, :])[2][1:].T


def _pairs(fit: Fit) -> dict[str, tuple[int, int]]:
    """Return, for each mounting and axis angle, the places of its two axes among the directions."""
    campaign = fit.model.campaign
    kinds = [kind for kind in KINDS if kind in fit.derived.derivation.inputs.channels]
    channels = [channel.name for kind in kinds for channel in campaign.of_kind(kind)]
    place = {name: index for index, name in enumerate(channels)}
    mountings: dict[str, int] = {}
    found = {}
    for quantity in fit.derived.names:
        family, _, label = quantity.name.removesuffix("]").partition("[")
        # Mountings stand in the order in which the angles of the first channel name them.
        if family == "mounting_angle":
            channel, mounting = label.split(",", 1)
            found[quantity.name] = place[channel], len(channels) + mountings.setdefault(mounting, len(mountings))
        elif family == "axis_angle":
            first, second = label.split(",", 1)
            found[quantity.name] = place[first], place[second]
    return found
