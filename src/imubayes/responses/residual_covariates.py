"""Covariates of every entry, against which residuals are tested, and those that an effect's coefficients go with.

Which covariates a coefficient goes with is found from the formula of the effect and not from the data.  On the data of
a campaign many functions coincide: if the force along an axis is the same in all runs in which the temperature
changes, a scale factor over temperature is a bias over temperature.  What the effect itself says is given by its
formula at generic values: the coefficient goes with every input that changes its first-order response.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from imubayes.compiled.in_numpy import in_numpy
from imubayes.effects.base import RecordEffect, SignalEffect
from imubayes.foundations.arrays import Array
from imubayes.foundations.covariates import COVARIATES, INPUTS, Covariate, ambient_names, regressors
from imubayes.foundations.signal_path_state import Ambient, Sample
from imubayes.inference.fitted_model import Fit
from imubayes.model.problem import Problem, row_means, signal_path, values_of
from imubayes.parameters.declarations import declared_parameters


@dataclass(frozen=True)
class ResidualCovariate:
    """One covariate of every entry.

    Attributes
    ----------
    name : as in run tables, or `rate_i`, `force_i`, … along the channel's own axes.
    unit : of the values.
    values : shape (E,), NaN where the run does not say.
    phrase : for a sentence: "… changes with <phrase>".
    periodic : whether it is an angle.
    relative : whether it acts by its change, not by its distance from zero.
    """

    name: str
    unit: str
    values: np.ndarray
    phrase: str
    periodic: bool = False
    relative: bool = False


def covariates(fitted: Fit) -> list[ResidualCovariate]:
    """Return every covariate that some run has and that takes more than one value."""
    values = {"sample": _at_samples(fitted), "recorded": _recorded(fitted), "derived": _derived(fitted)}
    gravity = fitted.model.campaign.site.gravity
    found = []
    for entry in regressors():
        known = values[entry.origin](entry) / entry.factor(gravity)
        if _varies(known):
            facts = entry.column, entry.unit, known, entry.phrase, entry.periodic, entry.relative
            found.append(ResidualCovariate(*facts))
    return found


def as_read(fitted: Fit, covariate: ResidualCovariate) -> np.ndarray:
    """Return the values of a covariate as they were read, (E,): effects count the angle of a table from its zero."""
    if covariate.name != COVARIATES["table_angle"].column:
        return covariate.values
    model = fitted.model
    tables = [model.campaign.tables.get(run.table or "") for run in model.campaign.runs]
    zeros = np.array([0.0 if table is None else table.zero_angle for table in tables])
    return covariate.values + np.degrees(zeros)[model.entries.run]


def _varies(values: np.ndarray) -> bool:
    known = values[np.isfinite(values)]
    return known.size > 2 and float(np.ptp(known)) > 1e-9 * (1 + float(np.abs(known).max()))


def _at_samples(fitted: Fit) -> Callable[[Covariate], np.ndarray]:
    """Return rate or specific force along each channel's own axes, as the fitted model has them, (E,) in SI."""
    means = _row_means(fitted.model.problem, fitted.z)
    readout = np.asarray(fitted.model.problem.observations.readout)

    def values(covariate: Covariate) -> np.ndarray:
        found = np.full(len(fitted.model.entries), np.nan)
        mean = np.asarray(means[covariate.name])
        # The angles of a servo table follow the outputs of the channels and have no input axis.
        of_channel = np.flatnonzero(readout < len(mean))
        found[of_channel] = mean[readout[of_channel]]
        return found

    return values


@in_numpy
def _row_means(problem: Problem, z):
    """Return rate and specific force along each axis, covariate → flattened outputs, as `readout` counts them."""
    path = signal_path(problem, values_of(problem, z))
    return {
        f"{kind}_{letter}": jnp.concatenate(
            [
                row_means(problem, getattr(path.sample[name], kind)[..., axis]).reshape(-1)
                for name in sorted(problem.channels)
            ]
        )
        for kind in ("rate", "force")
        for axis, letter in enumerate("ios")
    }


def _recorded(fitted: Fit) -> Callable[[Covariate], np.ndarray]:
    """Return what the runs recorded, (E,) in SI."""
    entries, runs = fitted.model.entries, fitted.model.campaign.runs

    def values(covariate: Covariate) -> np.ndarray:
        found = np.full(len(entries), np.nan)
        for index, run in enumerate(runs):
            here = (entries.run == index) & ~entries.closing
            if covariate.name in run.covariates:
                found[here] = run.covariates[covariate.name][entries.row[here]]
        return found

    return values


def _derived(fitted: Fit) -> Callable[[Covariate], np.ndarray]:
    """Return what the procedures derive from recorded columns, (E,) in SI."""
    nodes, entries = fitted.model.nodes, fitted.model.entries
    first_row = np.cumsum([0, *(run.rows for run in fitted.model.campaign.runs)])
    row_of_entry = first_row[entries.run] + np.where(entries.closing, 0, entries.row)
    node_row = _node_rows(fitted)

    def values(covariate: Covariate) -> np.ndarray:
        per_row = np.full(first_row[-1], np.nan)
        per_row[node_row] = getattr(fitted.model.problem.nodes.ambient, covariate.name)
        known = np.array([covariate.name in supplied for supplied in nodes.supplies])[entries.run] & ~entries.closing
        return np.where(known, per_row[row_of_entry], np.nan)

    return values


def _node_rows(fitted: Fit) -> np.ndarray:
    """Return the row, counted over all runs, of each node."""
    nodes = fitted.model.nodes
    sizes = np.concatenate([np.full(count, size) for count, size in nodes.turns])
    return nodes.row_of[np.repeat(np.arange(len(sizes)), sizes)]


MEMORY = "memory"
_GENERIC = np.random.default_rng(952).uniform(0.5, 2.0, 64)
_CHANGED = 1e-9
"""Relative change by which rounding is distinguished from a dependence."""


def covariates_of(member: type, kind: str) -> tuple[frozenset[str], ...]:
    """Return for each coefficient of an effect the columns of the covariates that it goes with; none of a motion.

    A direction of the site counts by the name of its axis, since it is no covariate, and a memory by `MEMORY`.  What
    has no derivative at its null goes with nothing here, as a dead zone.
    """
    if not issubclass(member, SignalEffect | RecordEffect):
        return ()
    declared = declared_parameters(member)
    nulls = {field: np.asarray(float(one.null)) for field, one in declared.items()}
    return tuple(_of_coefficient(member, nulls, field, kind) for field, one in declared.items() if not one.shape)


def _of_coefficient(
    member: type[SignalEffect | RecordEffect], nulls: Mapping[str, Array], field: str, kind: str
) -> frozenset[str]:
    at_null = member(**nulls)
    along = member(**{name: np.asarray(float(name == field)) for name in nulls})

    def first_order(signal: np.ndarray, sample: Sample, memory: np.ndarray) -> float:
        return float(_first_order(at_null, along, signal, sample, memory))

    signal, memory, sample = *map(np.asarray, _GENERIC[:2]), _generic_sample()
    at = first_order(signal, sample, memory)
    found = {name for name, other in _changed(sample) if _differs(first_order(signal, other, memory), at)}
    if _differs(first_order(np.asarray(1.5 * signal), sample, memory), at):
        found.add(INPUTS[kind])
    if _differs(first_order(signal, sample, np.asarray(1.5 * memory)), at):
        found.add(MEMORY)
    return frozenset(COVARIATES[name].column if name in COVARIATES else name for name in found)


@in_numpy
def _first_order(
    effect: SignalEffect | RecordEffect,
    along: SignalEffect | RecordEffect,
    signal: Array,
    sample: Sample,
    memory: Array,
) -> Array:
    """Return the derivative of the signal after an effect by its parameters, in a direction."""

    def output(effect: SignalEffect | RecordEffect) -> Array:
        if isinstance(effect, RecordEffect):
            return effect.apply(signal, sample, memory)
        return effect.apply(signal, sample)

    return jax.jvp(output, (effect,), (along,))[1]


def _differs(one: float, other: float) -> bool:
    return abs(one - other) > _CHANGED * (abs(one) + abs(other))


def _generic_sample() -> Sample:
    vectors = _GENERIC[2:17].reshape(5, 3)
    values = zip(ambient_names(), map(np.asarray, 10 * _GENERIC[17:]), strict=False)
    return Sample(*vectors, ambient=Ambient(**dict(values)), output_scale=np.asarray(1.7))


def _changed(sample: Sample) -> Iterator[tuple[str, Sample]]:
    """Yield what may change in a sample, by name, with the sample that it changes to."""
    for vector in ("rate", "force", "acceleration", "north", "up"):
        for place, letter in enumerate("ios"):
            larger = np.where(np.arange(3) == place, 1.5, 1.0)
            yield f"{vector}_{letter}", replace(sample, **{vector: larger * getattr(sample, vector)})
    for name, value in sample.ambient.values.items():
        yield name, replace(sample, ambient=sample.ambient.updated(**{name: np.asarray(1.5 * value)}))
