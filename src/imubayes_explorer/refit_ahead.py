"""The refit of a changed model at the noise known beforehand, before its fit is made.

Residuals at the noise known beforehand depend on the parameters alone, and the program by which the diagnosis predicted
every candidate predicts any choice of them: effects added or removed, with any priors, by any of the readings.  A few
Gauss–Newton steps with it lead to the least squares of the changed model within a second, if its own programs take a
minute to compile.  A noise component that is removed, or has another prior, changes what residuals are over, and the
prediction not at all.  A formula of the covariates, which no program predicts yet, responds linearly.  Scales of the
noise as fitted, uncertainties and the verdict are those of the fit, which follows.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from imubayes import Fit
from imubayes.adequacy.known_noise import known_scales
from imubayes.adequacy.known_noise_fit import KnownNoisePoint
from imubayes.criticism.diagnosis_record import ScreenedEffect
from imubayes.effects.base import Effect
from imubayes.inference.parameter_fit import Linearised, whitened_about, whitened_columns
from imubayes.model.bind import Model
from imubayes.model.problem import Problem, masked
from imubayes.parameters.declarations import Parameter, prior_slopes, prior_values
from imubayes.responses.candidate_effects import CatalogueModel

_MOST_STEPS, _LENGTHS = 8, (1.0, 0.3, 0.1)
_ARRIVED = 1e-3
"""Length of a step, in standard deviations of the readings all together, that ends the search.  Numerical: no residual
moves by more."""
_WIDENED = 3.0
"""A prior that an estimate contradicts by so many of its standard deviations is widened to it, as `add` does."""
_NO_PRIOR = 1e6
"""Width of the prior of a response of unit length.  Numerical: a thousand times what any residual asks for."""


@dataclass(frozen=True)
class Ahead:
    """The fit of a changed model at the noise known beforehand.

    Attributes
    ----------
    point : with the entries and parameters before: residuals that were set aside are 0, parameters that were removed at
        their nulls, and z is on the scale of the priors before; residuals are over the noise of the changed model.
    gone : shape (E,) bool, the entries that it has set aside.
    """

    point: KnownNoisePoint
    gone: np.ndarray


def refitted(
    model: CatalogueModel,
    point: KnownNoisePoint,
    changed: Model,
    estimates: Sequence[ScreenedEffect] = (),
    columns: np.ndarray | None = None,
) -> Ahead | None:
    """Return the fit of a changed model before it is made.

    Parameters
    ----------
    model, point : the model before with its candidates, and its fit at the noise known beforehand.
    changed : the model as changed, bound; its readings are some of those before.
    estimates : of effects that are added, by the diagnosis: where the search begins.
    columns : further responses (E, C), output units.

    Returns
    -------
    fit : None if the program cannot predict the model, and if no minimum was reached.
    """
    free, left_out = model.parameters_of(changed), _readings_gone(point.model, changed)
    noise = None if left_out is None else _noise(model.fitted, point, changed, left_out)
    if free is None or left_out is None or noise is None:
        return None
    (problem, h), priors = noise, point.model.problem.priors
    free, start, width = _start(model, point, free, estimates)
    given = np.zeros((len(point.misfit), 0)) if columns is None else columns
    white = _white(problem, h, given)
    length = np.linalg.norm(white, axis=0)
    used = length > 0
    further = given[:, used] / length[used], white[:, used] / length[used]
    problem_at = _Changed(model, problem, h, free, width, further)
    here = _RefitAt(problem_at, np.concatenate([start, np.zeros(int(used.sum()))]))
    for _ in range(_MOST_STEPS):
        if here.size <= _ARRIVED:
            kept = len(point.left)  # without the priors of what is added
            after = model.values(here.z[: len(free)], free)[: model.size]
            before, slopes = (np.asarray(each(priors, jnp.asarray(point.z))) for each in (prior_values, prior_slopes))
            z = point.z + (after - before) / slopes
            return Ahead(replace(point, misfit=here.misfit, left=here.right[:kept], z=z), left_out)
        ahead = (here.moved(length) for length in _LENGTHS)
        here = next((each for each in ahead if each.square < here.square), None)
        if here is None:
            return None
    return None


def _readings_gone(model: Model, changed: Model) -> np.ndarray | None:
    """Return which entries of a model, (E,) bool, a changed one lacks; None if it has others."""
    if changed.campaign.set_aside == model.campaign.set_aside:
        return np.zeros(len(model.entries), dtype=bool)
    places = {run.name: place for place, run in enumerate(model.campaign.runs)}
    own, theirs = model.entries, changed.entries
    runs = np.array([places.get(run.name, -1) for run in changed.campaign.runs])[theirs.run]
    size = 1 + max(int(own.row.max()), int(theirs.row.max())), 4 + len(model.campaign.channels)
    keys = [(run * size[0] + each.row) * size[1] + each.channel for run, each in ((own.run, own), (runs, theirs))]
    return None if not np.isin(keys[1], keys[0]).all() else ~np.isin(keys[0], keys[1])


def _noise(
    fitted: Fit, point: KnownNoisePoint, changed: Model, left_out: np.ndarray
) -> tuple[Problem, np.ndarray] | None:
    """Return the problem with the readings and the noise of a changed model, and the scales known of that, in z.

    None of a noise scale that is new, and of another noise if parameters or readings are others as well.
    """
    own = {each.name: each for each in fitted.model.hyper_layout.parameters}
    wanted = {each.name: each for each in changed.hyper_layout.parameters}
    if not set(wanted) <= set(own):
        return None
    if _alike(fitted.model, own, wanted):
        return (masked(point.model.problem, left_out) if left_out.any() else point.model.problem), point.h
    if left_out.any() or changed.layout.names != fitted.model.layout.names:
        return None
    sizes = {name: each.value_at(float(z)) for (name, each), z in zip(own.items(), fitted.h, strict=True)}
    h = np.array([each.z_at(sizes[name]) or 0.0 for name, each in wanted.items()])
    return changed.problem, known_scales(replace(fitted, model=changed, h=h))


def _alike(model: Model, own: Mapping[str, Parameter], wanted: Mapping[str, Parameter]) -> bool:
    """Return whether noise scales are those of a model, but for those of effects that are lacking."""
    lost = {each.effect for name, each in own.items() if name not in wanted}
    same = all(eqx.tree_equal(own[name].prior, each.prior) for name, each in wanted.items())
    return same and all(issubclass(model.registry.effects[name], Effect) for name in lost)


def _start(
    model: CatalogueModel, point: KnownNoisePoint, free: Mapping[int, Parameter], estimates: Sequence[ScreenedEffect]
) -> tuple[dict[int, Parameter], np.ndarray, np.ndarray]:
    """Return the parameters of a change in the order of their places, their z to begin with, and widths of new ones."""
    told, layout = told_values(estimates), point.model.layout
    values = np.asarray(prior_values(point.model.problem.priors, jnp.asarray(point.z))) / layout.factors()
    free, own = dict(sorted(free.items())), dict(zip(layout.names, values.tolist(), strict=True))
    start = np.array([
        model.start(k, each, own.get(each.name, told.get(each.name, told.get(f"{each.effect}.{each.field}"))))
        for k, each in free.items()
    ])  # fmt: skip
    fresh = start[sum(k < model.size for k in free) :]
    return free, start, np.where(np.abs(fresh) > _WIDENED, np.abs(fresh), 1.0)


def told_values(estimates: Sequence[ScreenedEffect]) -> dict[str, float]:
    """Return the values of coefficients by name, and of shapes by effect and field, in their units."""
    told = {each.name: each.value for line in estimates for each in line.coefficients if each.value is not None}
    shapes = ((line.effect, field, value) for line in estimates for field, value in line.shape.items())
    return told | {f"{effect}.{field}": value for effect, field, value in shapes}


def _white(problem: Problem, h: np.ndarray, columns: np.ndarray) -> np.ndarray:
    return whitened_columns(problem, h, columns) if columns.shape[1] else columns


@dataclass(frozen=True)
class _Changed:
    """A changed model as the program of the diagnosis predicts it.

    Attributes
    ----------
    problem, h : of the model before, readings that were set aside masked, with the noise of the changed one.
    free : its parameters by their places, in order.
    width : of the priors of those that the model before has not.
    further : responses (E, C) of unit length, plain and whitened.
    """

    model: CatalogueModel
    problem: Problem
    h: np.ndarray
    free: Mapping[int, Parameter]
    width: np.ndarray
    further: tuple[np.ndarray, np.ndarray]


class _RefitAt:
    """The changed model linearised at z, (F + C,), with the Gauss–Newton step from there.

    Attributes
    ----------
    square, size : sum of squares, and the length of the step in standard deviations of the readings.
    misfit, right : shapes (E,) and (E + P + F′ + C,), plain and whitened, priors last: those of the model before, if
        what was removed is 0, and those of what is added.
    """

    def __init__(self, given: _Changed, z: np.ndarray):
        self._given, self.z = given, z
        places, size, further = np.array(list(given.free)), given.model.size, given.further
        held, kept = len(places), places[places < size]
        own = np.arange(len(kept))
        misfit, jacobian = given.model.linearised(z[:held], given.free)
        self.misfit = misfit - further[0] @ z[held:]
        # Columns of what was removed are 0: shapes are unchanged, so nothing is recompiled.
        known, at = np.zeros((len(misfit), size)), np.zeros(size)
        known[:, kept], at[kept] = jacobian[:, own], z[own]
        about = Linearised(jnp.asarray(at), jnp.asarray(self.misfit), jnp.asarray(known))
        residual, white, widths = whitened_about(given.problem, about, given.h)
        fresh = _white(given.problem, given.h, jacobian[:, len(kept) :])
        widths = np.concatenate([widths, given.width, np.full(further[0].shape[1], _NO_PRIOR)])
        columns = np.concatenate([white, fresh, further[1]], axis=1)
        at = np.concatenate([at, z[len(kept) :]])
        self.right, self._rows = (
            np.concatenate([residual, -at / widths]),
            np.concatenate([columns, np.diag(1 / widths)]),
        )
        self._moving = np.concatenate([kept, np.arange(size, len(at))])
        self.square = float(self.right @ self.right)

    @cached_property
    def _solved(self) -> tuple[np.ndarray, float]:
        basis, upper = np.linalg.qr(self._rows)
        along = basis.T @ self.right
        return np.linalg.solve(upper, along)[self._moving], float(np.linalg.norm(along))

    @property
    def size(self) -> float:
        return self._solved[1]

    def moved(self, length: float) -> "_RefitAt":
        """Return the model linearised after a part of the step."""
        return _RefitAt(self._given, self.z + length * self._solved[0])
