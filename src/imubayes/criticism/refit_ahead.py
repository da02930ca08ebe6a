"""The refit with causes added, at the noise known beforehand, before the fit of the changed model is made.

Residuals at the noise known beforehand depend on the parameters alone, and the program by which the diagnosis predicted
every candidate predicts any choice of them.  A few Gauss–Newton steps with it lead to the least squares of the changed
model within a second, where its own programs take a minute to compile.  Scales of the noise, uncertainties and the
verdict are those of the fit, which follows.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import jax.numpy as jnp
import numpy as np

from imubayes.adequacy.known_noise_fit import KnownNoisePoint, whitened_rows
from imubayes.criticism.diagnosis_record import ScreenedEffect
from imubayes.inference.laplace_marginal import Linearised, whitened_about
from imubayes.parameters.declarations import Parameter
from imubayes.responses.candidate_effects import CatalogueModel

_MOST_STEPS, _LENGTHS = 8, (1.0, 0.3, 0.1)
_ARRIVED = 1e-3
"""Length of a step, in standard deviations of the readings all together, that ends the search.  Numerical: no residual
moves by more."""
_WIDENED = 3.0
"""A prior that an estimate contradicts by so many of its standard deviations is widened to it, as `add` does."""


def refitted(
    model: CatalogueModel,
    point: KnownNoisePoint,
    effects: Sequence[str],
    channels: Sequence[str] | None,
    estimates: Sequence[ScreenedEffect],
) -> KnownNoisePoint | None:
    """Return the fit at the noise known beforehand with effects added; None where no minimum was reached.

    Parameters
    ----------
    model, point : the model with its candidates, and its fit at the noise known beforehand without any.
    channels : of effects that act on channels; all that lack them where None.
    estimates : of the effects, by the diagnosis: where the search begins.
    """  # fmt: skip
    free = model.free(effects, channels)
    if not free:
        return None
    own, start = len(point.z), _start(model, free, estimates)
    width = np.where(np.abs(start) > _WIDENED, np.abs(start), 1.0)
    here = _RefitAt(model, point, np.concatenate([point.z, start]), free, width)
    for _ in range(_MOST_STEPS):
        if here.size <= _ARRIVED:
            kept = len(point.left)  # without the priors of what is added
            return replace(point, misfit=here.misfit, left=here.right[:kept], z=here.z[:own])
        ahead = (here.moved(length) for length in _LENGTHS)
        here = next((each for each in ahead if each.square < here.square), None)
        if here is None:
            return None
    return None


def _start(model: CatalogueModel, free: Mapping[int, Parameter], estimates: Sequence[ScreenedEffect]) -> np.ndarray:
    """Return z of the estimates of some parameters, (F,), and of their nulls where there is none."""
    told = {each.name: each.value for line in estimates for each in line.coefficients if each.value is not None}
    shapes = ((line.effect, name.rpartition(".")[2], value) for line in estimates for name, value in line.shape.items())
    told |= {f"{effect}.{field}": value for effect, field, value in shapes}
    start = np.array([model.null(place) for place in free])
    for k, each in enumerate(free.values()):
        value = told.get(each.name, told.get(f"{each.effect}.{each.field}"))
        begun = each.z_at(value) if value is not None else None
        start[k] = start[k] if begun is None else begun
    return start


class _RefitAt:
    """The changed model linearised at z, (P + F,), with the Gauss–Newton step from there.

    Attributes
    ----------
    z, width : shapes (P + F,) and (F,), the point and the widths of the priors of what is added.
    square, size : sum of squares, and the length of the step in standard deviations of the readings.
    misfit, right : shapes (E,) and (E + P + F,), plain and whitened, priors last.
    """

    def __init__(
        self, model: CatalogueModel, point: KnownNoisePoint, z: np.ndarray, free: Collection[int], width: np.ndarray
    ):
        self._given, self.z, own, problem = (model, point), z, len(point.z), point.model.problem
        self.free, self.width = free, width
        self.misfit, jacobian = model.linearised(z, tuple(free))
        about = Linearised(jnp.asarray(z[:own]), jnp.asarray(self.misfit), jnp.asarray(jacobian[:, :own]))
        residual, white, widths = whitened_about(problem, about, point.h)
        widths = np.concatenate([widths, width])
        columns = np.concatenate([white, whitened_rows(problem, point.h, jacobian[:, own:])], axis=1)
        self.right, self._rows = np.concatenate([residual, -z / widths]), np.concatenate([columns, np.diag(1 / widths)])
        self.square = float(self.right @ self.right)

    @cached_property
    def _solved(self) -> tuple[np.ndarray, float]:
        basis, upper = np.linalg.qr(self._rows)
        along = basis.T @ self.right
        return np.linalg.solve(upper, along), float(np.linalg.norm(along))

    @property
    def size(self) -> float:
        return self._solved[1]

    def moved(self, length: float) -> "_RefitAt":
        """Return the model linearised after a part of the step."""
        return _RefitAt(*self._given, self.z + length * self._solved[0], self.free, self.width)
