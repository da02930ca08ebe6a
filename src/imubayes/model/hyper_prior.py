"""Correlated priors of noise parameters: a Gaussian copula in z, where every prior is standard normal by itself.

The noise terms of a static record come with a covariance: what flicker noise does not explain is random walk.  As
a prior of other campaigns the terms keep it.  Each parameter keeps its own prior; h as a whole is normal(0, C), with
C the correlation matrix.
"""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import solve_triangular

from imubayes.array_shapes import Array, Float, Scalar
from imubayes.errors import InputError, Issue, closest_first
from imubayes.model.model_spec import PriorCorrelation
from imubayes.parameters.vector import Layout

# Least eigenvalue of a correlation matrix: below, rounding of the printed digits may have made it singular.
_LEAST_EIGENVALUE = 1e-6


class HyperCorrelation(eqx.Module):
    """The prior normal(0, C) of h: `root` is the Cholesky factor of C, shape (H, H)."""

    root: Float[Array, "H H"]

    def square(self, h: Float[Array, " H"]) -> Scalar:
        """Return hᵀC⁻¹h + log det C: twice the negative logarithm of the density, up to a constant."""
        independent = solve_triangular(self.root, h, lower=True)
        return jnp.sum(independent**2) + 2 * jnp.sum(jnp.log(jnp.diagonal(self.root)))

    def coloured(self, independent: np.ndarray) -> np.ndarray:
        """Return draws (…, H) of the prior from independent standard normal ones."""
        return independent @ np.asarray(self.root).T


def hyper_correlation(listed: Sequence[PriorCorrelation], layout: Layout) -> HyperCorrelation | None:
    """Return the correlation of the priors of noise parameters in the order of a layout; None where there is none.

    Raises
    ------
    InputError
        for a name that is not in the layout or stands in two blocks, and for what is no correlation matrix.
    """
    if not listed:
        return None
    whole, taken, issues = np.eye(len(layout)), set[str](), []
    for block in listed:
        found = _faults(block, layout, taken)
        issues += found
        taken |= set(block.parameters)
        if not found:
            known = [place for place, name in enumerate(block.parameters) if name in layout.names]
            places = [layout.index(block.parameters[place]) for place in known]
            whole[np.ix_(places, places)] = np.array(block.matrix)[np.ix_(known, known)]
    if issues:
        raise InputError(issues)
    return HyperCorrelation(jnp.asarray(np.linalg.cholesky(whole)))


def _faults(block: PriorCorrelation, layout: Layout, taken: set[str]) -> list[Issue]:
    faults = []
    for place, name in enumerate(block.parameters):
        if name not in layout.names and not block.optional:
            near = closest_first(name, layout.names)
            faults.append(
                Issue(
                    f"the model has no noise parameter '{name}'", block.where, near, "correct the name, or take it out"
                )
            )
        elif name in taken or name in block.parameters[:place]:
            allowed = "every parameter once, in one block"
            faults.append(Issue(f"'{name}' is listed twice", block.where, allowed, "join the blocks"))
    count = len(block.parameters)
    if any(len(row) != count for row in block.matrix) or len(block.matrix) != count:
        allowed = f"{count} rows of {count} numbers"
        return [*faults, Issue("the matrix does not suit its parameters", block.where, allowed, "correct the matrix")]
    matrix = np.array(block.matrix, dtype=float)
    plain = np.allclose(matrix, matrix.T) and np.allclose(np.diag(matrix), 1.0)
    if not plain or np.linalg.eigvalsh(matrix)[0] < _LEAST_EIGENVALUE:
        allowed = "a symmetric, positive definite matrix with ones on the diagonal"
        faults.append(Issue("the matrix is no correlation matrix", block.where, allowed, "correct the matrix"))
    return faults
