"""Angles near 0° and 180° as the length of a vector, and the standard deviation of such a length.

The angle between two axes is the length of the component of one across the other.  At 0° and 180° a length has no
derivative, and near them its distribution is that of a two-dimensional vector (Rice), so a budget is drawn up of the
two components of the direction, which have a gradient; E[angle²] is the sum of their mean squares, and each input
contributes to it through both.  The standard deviation of such an angle after a further run follows from the covariance
of its components: the length of N(0, σ²I) in two dimensions has 0.66 σ (Rayleigh).  For any normal x with Q = |x|²,
E√Q = π^(−½) ∫ (1 − φ(s²)) / s² ds over s > 0, where φ(t) = E exp(−tQ) is elementary (Mathai and Provost, Quadratic
Forms in Random Variables, § 3.2a).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.foundations.campaign_data import KINDS
from imubayes.foundations.quantity_names import AXIS_ANGLE, MOUNTING_ANGLE, QuantityName
from imubayes.inference.fitted_model import Fit
from imubayes.model.derived_quantities import evaluate_derived, evaluate_directions

NEAR = 4.0
"""An angle closer to 0° or 180° than this many standard deviations of its components is near it: at four the standard
deviation by its gradient is that of the angle to 3 %."""
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
        name = QuantityName.of(quantity.name)
        # Mountings stand in the order in which the angles of the first channel name them.
        if name.family == MOUNTING_ANGLE:
            channel, mounting = name.labels
            found[quantity.name] = place[channel], len(channels) + mountings.setdefault(mounting, len(mountings))
        elif name.family == AXIS_ANGLE:
            first, second = name.labels
            found[quantity.name] = place[first], place[second]
    return found


# Nodes in log s: the integrand falls like exp(−|v|) on both sides, so that the ends leave out 1e-11 of it.
_LOGARITHM = np.linspace(-25.0, 25.0, 501)
# Length in standard deviations from which the gradient serves: its error there is below 1e-6 of the variance, and the
# difference of two large squares is lost to rounding.
_FAR = 1e3
# Nodes per dimension over the estimates that a further run may leave.
_ESTIMATES = 16


def length_deviation(mean: np.ndarray, covariance: np.ndarray) -> float:
    """Return the standard deviation of |x|, x normal with mean (m,) and covariance (m, m)."""
    return float(np.sqrt(_variance(mean[None], covariance)[0]))


def expected_length_deviation(mean: np.ndarray, before: np.ndarray, after: np.ndarray) -> float:
    """Return the standard deviation of |x| that is expected of data that narrow x from covariance `before` to `after`.

    The root of the mean variance over the estimates of x that the data may give: normal about `mean` (m,), with
    covariance `before` − `after`, (m, m).
    """
    nodes, weights = np.polynomial.hermite_e.hermegauss(_ESTIMATES)
    grid = np.stack(np.meshgrid(*[nodes] * len(mean), indexing="ij"), axis=-1).reshape(-1, len(mean))
    product = np.prod(np.stack(np.meshgrid(*[weights] * len(mean), indexing="ij"), axis=-1), axis=-1).reshape(-1)
    gained, axes = np.linalg.eigh(before - after)
    estimates = mean + (grid * np.sqrt(np.maximum(gained, 0.0))) @ axes.T
    return float(np.sqrt(product @ _variance(estimates, after) / product.sum()))


def _variance(means: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the variance of |x| for each of several means, (n, m) → (n,)."""
    spread, axes = np.linalg.eigh(covariance)
    spread, squares = np.maximum(spread, 0.0), (means @ axes) ** 2
    size = squares.sum(axis=1) + spread.sum()
    root = np.sqrt(np.where(size > 0, size, 1.0))
    # s in units of 1/√E Q, so that one set of nodes serves all.
    t = np.exp(2 * _LOGARITHM)[None, :, None] / root[:, None, None] ** 2
    widened = 1 + 2 * t * spread
    exponent = -(t * squares[:, None, :] / widened).sum(axis=2) - 0.5 * np.log(widened).sum(axis=2)
    integrand = -np.expm1(exponent) * np.exp(-_LOGARITHM)
    mean_length = root * np.trapezoid(integrand, _LOGARITHM, axis=1) / np.sqrt(np.pi)
    square = squares.sum(axis=1)
    along = squares @ spread / np.where(square > 0, square, 1.0)
    return np.where(square > _FAR**2 * spread.sum(), along, np.maximum(size - mean_length**2, 0.0))
