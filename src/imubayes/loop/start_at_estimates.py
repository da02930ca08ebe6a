"""The start of a refit at the coefficients that a diagnosis estimated, where that is the better one.

The one-step estimate is linear about the null values.  Of effects with a gradient there it agrees with the diagnosis,
and takes account of several effects at once.  Of others the diagnosis knows more: it scanned the shape and the sign.
"""

from collections.abc import Mapping
from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from imubayes.inference.posterior_mode import heights
from imubayes.loop.changed_model import ChangedModel
from imubayes.loop.warm_start import whitened


def start_at_estimates(change: ChangedModel, estimates: Mapping[str, float]) -> ChangedModel:
    """Return a changed model that starts at estimates of its new parameters, where the posterior is higher there.

    Estimates outside the support of their priors are left out.

    Parameters
    ----------
    change : with the one-step estimate as its start.
    estimates : parameter name → value in its unit.
    """
    told = {
        place: z
        for place in np.flatnonzero(change.new).tolist()
        if (parameter := change.model.layout.parameters[place]).name in estimates
        and (z := parameter.z_at(estimates[parameter.name])) is not None
    }
    if not told:
        return change
    # At the mode before, and with the one-step estimates of all others.
    starts = [change.z.copy(), np.where(change.new, change.z, change.null)]
    for start in starts:
        start[list(told)] = list(told.values())
    starts = [change.z, *(_others_fitted(change, start) for start in starts)]
    best = int(np.argmax(heights(change.model.problem, starts, jnp.asarray(change.h))))
    return replace(change, z=starts[best])


def _others_fitted(change: ChangedModel, start: np.ndarray) -> np.ndarray:
    """Return a start, shape (P,), after a Gauss–Newton step of the parameters that the model had before."""
    parts = whitened(change.model.problem, jnp.asarray(start), jnp.asarray(change.h))
    residual, jacobian, widths = (np.asarray(part) for part in parts)
    old = ~change.new
    columns, precision = jacobian[:, old], np.diag(widths[old] ** -2)
    moved = start.copy()
    gradient = columns.T @ residual - start[old] * np.diag(precision)
    moved[old] += np.linalg.solve(columns.T @ columns + precision, gradient)
    return moved if np.isfinite(moved).all() else start
