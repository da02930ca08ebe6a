"""Residuals, whitened and projected on the complement of what the model can absorb.

Rows are the measured entries, then one pseudo-entry per prior.  If the offset of a run and channel is noise, a
Householder reflection makes their common direction, the offset, a row of its own.  Rows fall into *strata*, each with
its own noise scale: the scatter within runs of a channel, the scatter between its runs, the prior.  A missing effect
has inflated the noise of the strata it acts in; judging it needs their scale without it.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from imubayes.inference.fitted_model import Fit
from imubayes.inference.parameter_fit import whitened_columns
from imubayes.model.likelihood import pseudo_values
from imubayes.model.noise_covariance import noise_distribution, whitener
from imubayes.model.problem import Observations, Problem, prior_widths

_OFFSET_INFLATION = 1.2
"""A run offset is a stratum of its own if it inflates the variance of the run's mean by more than this factor.
Convention: smaller makes more between-run strata, each with few degrees of freedom and little power."""

PRIOR = -1


@dataclass(frozen=True)
class Strata:
    """Which rows share a noise scale.

    Attributes
    ----------
    of_row : shape (R,), stratum of each row; −1 for prior rows, whose scale is known.
    channel, between : shape (strata,), channel of each stratum and whether it holds run offsets.
    """

    of_row: np.ndarray
    channel: np.ndarray
    between: np.ndarray

    def sums(self, squares: np.ndarray) -> np.ndarray:
        """Return the sums over the rows of each stratum, prior rows last; shape (strata + 1, …)."""
        result = np.zeros((len(self.channel) + 1, *squares.shape[1:]))
        np.add.at(result, self._place, squares)
        return result

    @cached_property
    def _place(self) -> np.ndarray:
        return np.where(self.of_row == PRIOR, len(self.channel), self.of_row)


@dataclass(frozen=True)
class Projection:
    """Whitening, reflection and projection, for any columns over the entries.

    Attributes
    ----------
    fitted : the fit it belongs to.
    turn : from entries to rows.
    basis : shape (R, P), orthonormal columns that span what the model's parameters can absorb.
    residual : shape (R,), projected residual.
    strata : of the rows.
    freedom : shape (strata + 1,), degrees of freedom of the residual in each stratum.
    input : shape (E,), predicted output less the nominal offset, in nominal input units (SI).
    root : shape (E,), one over each entry's standard deviation, run offsets not counted.
    """

    fitted: Fit
    turn: "RowTransform"
    basis: np.ndarray
    residual: np.ndarray
    strata: Strata
    freedom: np.ndarray
    input: np.ndarray
    root: np.ndarray

    @property
    def offset_rows(self) -> np.ndarray:
        """Which rows hold run offsets that are noise, (R,) bool."""
        measured = self.strata.of_row != PRIOR
        return measured & self.strata.between[np.where(measured, self.strata.of_row, 0)]

    @cached_property
    def offsets_apart(self) -> "Projection":
        """The projection with all run offsets apart; see `with_run_offsets`."""
        return with_run_offsets(self)

    def project(self, rows: np.ndarray) -> np.ndarray:
        """Return the part of rows, (R, C), that the model's parameters cannot absorb."""
        return rows - self.basis @ (self.basis.T @ rows)


@dataclass(frozen=True)
class RowTransform:
    """From entries to rows: whiten, then reflect each group's common direction into its first row.

    `members` are the groups' entries, `series` the same in the order of time, both (G, M) and padded with E.
    """

    problem: Problem
    h: np.ndarray
    members: np.ndarray
    series: np.ndarray
    sizes: np.ndarray
    reflectors: np.ndarray
    priors: int

    def __call__(self, columns: np.ndarray) -> np.ndarray:
        flat = columns.reshape(len(columns), -1)
        turned = self.reflect(self.whiten(flat))
        rows = np.concatenate([turned, np.zeros((self.priors, turned.shape[1]))])
        return rows.reshape(len(rows), *columns.shape[1:])

    def whiten(self, columns: np.ndarray) -> np.ndarray:
        """Return columns (E, C), in output units, as entries whitened by the noise of the model."""
        return whitened_columns(self.problem, self.h, columns)

    def reflect(self, white: np.ndarray) -> np.ndarray:
        """Reflect each group so that its common direction becomes its first row; the reflection is its own inverse."""
        result = white.copy()
        # Group by group: all at once takes several times the memory of the rows, and as much longer.
        for group, reflector in zip(self.members, self.reflectors, strict=True):
            real = group < len(white)
            members, direction = group[real], reflector[real]
            if direction.any():
                own = white[members]
                result[members] = own - np.outer(2 * direction, direction @ own)
        return result


def project(fitted: Fit, misfit: np.ndarray, jacobian: np.ndarray) -> Projection:
    """Return the projection of a fit.

    Parameters
    ----------
    misfit, jacobian : shapes (E,) and (E, P), as of `imubayes.responses.candidate_effects.candidate_responses`.
    """
    problem, observations = fitted.model.problem, fitted.model.problem.observations
    members = _seen_first(observations)
    separate, reflectors = _reflectors(fitted, members, offsets=False)
    widths = np.asarray(prior_widths(problem, fitted.h))
    sizes, series = np.sum(members < len(misfit), axis=1), np.asarray(observations.in_time)
    turn = RowTransform(problem, fitted.h, members, series, sizes, reflectors, len(widths))
    rows = turn(jacobian)
    rows[len(misfit) :] = np.diag(1 / widths)
    basis, _ = np.linalg.qr(rows)
    whole = turn(pseudo_values(problem, fitted.h, misfit))
    whole[len(misfit) :] = -fitted.z / widths
    strata = _strata(fitted, members, separate, len(widths))
    return Projection(
        fitted=fitted,
        turn=turn,
        basis=basis,
        residual=whole - basis @ (basis.T @ whole),
        strata=strata,
        freedom=_freedom(problem, strata, basis),
        input=_input(fitted, misfit),
        root=np.asarray(whitener(problem, fitted.h).precision_root),
    )


def with_run_offsets(projection: Projection) -> Projection:
    """Return the projection with every run offset that the model has a noise scale for in a stratum of its own.

    A scale that these data put at zero would grow with an effect that acts between runs.
    """
    fitted, turn, problem = projection.fitted, projection.turn, projection.fitted.model.problem
    now = projection.strata.between[projection.strata.of_row[turn.members[:, 0]]]
    new = _can_scatter(problem) & ~now
    if not new.any():
        return projection
    _, reflectors = _reflectors(fitted, turn.members, offsets=True)
    added = replace(turn, reflectors=np.where(new[:, None], reflectors, 0.0))

    def turned(rows: np.ndarray) -> np.ndarray:
        entries = len(rows) - turn.priors
        flat = rows.reshape(len(rows), -1)
        return np.concatenate([added.reflect(flat[:entries]), flat[entries:]]).reshape(rows.shape)

    strata = _strata(fitted, turn.members, new | now, turn.priors)
    basis = turned(projection.basis)
    return replace(
        projection,
        turn=replace(turn, reflectors=turn.reflectors + added.reflectors),
        basis=basis,
        residual=turned(projection.residual),
        strata=strata,
        freedom=_freedom(problem, strata, basis),
    )


def _can_scatter(problem: Problem) -> np.ndarray:
    """Return which groups have an offset with a noise scale, (G,) bool."""
    return noise_distribution(problem, np.ones(problem.size[1])).shared_variance > 0


def _freedom(problem: Problem, strata: Strata, basis: np.ndarray) -> np.ndarray:
    """Return the degrees of freedom of the residual in each stratum, the rows of the priors last."""
    priors = np.ones(len(basis) - len(problem.observations.weight), dtype=bool)
    used = np.concatenate([np.asarray(problem.observations.weight) > 0, priors])
    return strata.sums(used.astype(float)) - strata.sums(np.sum(basis**2, axis=1))


def _reflectors(fitted: Fit, members: np.ndarray, offsets: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return which groups have an offset that is noise, (G,) bool, and their Householder vectors, (G, M)."""
    problem, count = fitted.model.problem, len(fitted.model.entries)
    # The whitened offset of a run is its direction in the group's rows.
    offset = whitened_columns(problem, fitted.h, np.ones((count, 1)))
    offset = np.concatenate([offset[:, 0], [0.0]])[members]
    length = np.linalg.norm(offset, axis=1)
    several = np.sum(members < count, axis=1) > 1
    separate = (1 / _noise_of_mean(fitted, members) > _OFFSET_INFLATION) | (offsets & several)
    first = offset / np.where(length > 0, length, 1.0)[:, None] - np.eye(1, members.shape[1])
    size = np.linalg.norm(first, axis=1)
    able = separate & (length > 0) & (size > 1e-12)
    return separate, np.where(able[:, None], first / np.where(able, size, 1.0)[:, None], 0.0)


def _noise_of_mean(fitted: Fit, members: np.ndarray) -> np.ndarray:
    """Return the variance of the mean of each group without its offset over that with it, (G,)."""
    by = whitener(fitted.model.problem, fitted.h)
    direction = np.concatenate([np.asarray(by.direction), [0.0]])[members]
    # It is (1 − κ)², κ = shrink · |u|².
    return (1 - np.asarray(by.shrink) * np.sum(direction**2, axis=1)) ** 2


def _seen_first(observations: Observations) -> np.ndarray:
    """Return the entries of each group, (G, M), the first of them, whose row takes the offset, not masked."""
    members = np.asarray(observations.members)
    weight = np.concatenate([np.asarray(observations.weight), [-1.0]])[members]
    return np.take_along_axis(members, np.argsort(-weight, axis=1, kind="stable"), axis=1)


def _input(fitted: Fit, misfit: np.ndarray) -> np.ndarray:
    """Return the predicted output of each entry as an input; 0 for closing rotations."""
    entries, channels = fitted.model.entries, fitted.model.campaign.channels
    scale = np.array([channel.scale_si for channel in channels] + [1.0] * 3)
    offset = np.array([channel.offset for channel in channels] + [0.0] * 3)
    return np.where(entries.closing, 0.0, (entries.value - misfit - offset[entries.channel]) / scale[entries.channel])


def _strata(fitted: Fit, members: np.ndarray, separate: np.ndarray, priors: int) -> Strata:
    entries = fitted.model.entries
    between = np.zeros(len(entries) + 1, dtype=bool)
    between[members[separate, 0]] = True
    key = 2 * entries.channel + between[:-1]
    names, of_entry = np.unique(key, return_inverse=True)
    of_row = np.concatenate([of_entry, np.full(priors, PRIOR)])
    return Strata(of_row, names // 2, names % 2 == 1)
