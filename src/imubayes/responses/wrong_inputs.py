"""Wrong inputs: what may be wrong in the record of a run, and how the predicted outputs respond to it.

The response to a wrong input is the derivative of the model to that column of the record: an offset or a factor of a
column in a run, or one row of it.  Beside them a run may have been made in another attitude of the seat, and its
outputs may be off.  Every hypothesis is the campaign as it would be if the input were right, so that physics stands in
one place: the prediction of the model for that campaign.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from imubayes.compiled.in_numpy import in_numpy
from imubayes.foundations.arrays import Array, exponential
from imubayes.foundations.campaign_data import Campaign, Run
from imubayes.foundations.covariates import COVARIATES, Covariate, recorded
from imubayes.foundations.wrong_records import Form
from imubayes.model.assembly import nodes_of
from imubayes.model.bind import Model
from imubayes.model.nodes_and_entries import join_entries, rejoin_nodes
from imubayes.model.problem import Problem, predict
from imubayes.procedures import PROCEDURES

_STEP = 1e-3
"""Step of derivatives, over the largest value of a column, or in rad and as a ratio: the error of a central difference
is a millionth."""

_LARGEST = {"rad": math.pi, "degC": 150.0}
"""Largest errors of a column by its SI unit: half a turn, and the range of a climatic chamber."""
_LARGEST_FACTOR = 10.0
NO_RUN = -1
_NEARLY_EXCHANGED = 0.2
"""How far the size of an exchange may be from 1: what is estimated beside it moves with the column."""
_NEARLY_REVERSED = 0.1
"""The same of a factor from −1: of the negative ones a reversed sign alone is a mistake of a record."""
_LEAST_EXCHANGED = 2.0  # °C, root mean square; columns that are nearer to each other are the same exchanged


@dataclass(frozen=True)
class WrongInput:
    """One thing that may be wrong in the record of a run.

    A size is what has to be added to the record: to the column; to a factor on it, 1; to the attitude of the seat, a
    rotation vector in body axes, rad; to the outputs of each channel, output units; to a factor on all of them; or, of
    columns that two runs exchanged, 1.  A run of another unit has parameters of its own: sizes are their z less those
    of the other runs, and the record stays as it is; so it does if the stated prior of parameters is too narrow, by
    which sizes are what their z is beyond it.  Of a count of samples the size is a ratio, true over stated.

    Attributes
    ----------
    run : place of the run; `NO_RUN` of a prior.
    covariate : the column; empty for seat and outputs.
    row : the only row concerned, from 0; None for all of the run.
    channel : place of the only channel whose outputs are off; None for all.
    other, apart : place of the run with which this one exchanged the column, and what the column of that run has more,
        of each row.
    parameters : of a prior, the places of its parameters.
    """

    run: int
    form: Form
    covariate: str = ""
    row: int | None = None
    channel: int | None = None
    other: int | None = None
    apart: tuple[float, ...] = ()
    parameters: tuple[int, ...] = ()

    def corrected(self, campaign: Campaign, size: np.ndarray) -> Campaign:
        """Return the campaign with a size, (d,), added to the record."""
        if self.form in ("unit", "prior", "samples"):
            return campaign
        run = campaign.runs[self.run]
        if self.form == "exchange":
            return self._exchanged(campaign, float(size[0]))
        if self.form == "seat":
            assert run.mounting is not None
            seat = campaign.mountings[run.mounting]
            turned = replace(seat, body_to_table=seat.body_to_table @ np.asarray(_turn(size)))
            name = f"{run.mounting} of {run.name}"
            campaign = replace(campaign, mountings={**campaign.mountings, name: replace(turned, name=name)})
            found = replace(run, mounting=name)
        elif self.covariate:
            values = np.array(run.covariates[self.covariate], dtype=float)
            here = slice(None) if self.row is None else self.row
            values[here] += size[0] * (values[here] if self.form == "factor" else 1.0)
            found = replace(run, covariates={**run.covariates, self.covariate: values})
        else:
            found = replace(run, observed=self._outputs(campaign, run, size))
        return replace(campaign, runs=tuple(found if k == self.run else one for k, one in enumerate(campaign.runs)))

    def _exchanged(self, campaign: Campaign, size: float) -> Campaign:
        runs = list(campaign.runs)
        for place, sign in ((self.run, 1), (self.other or 0, -1)):
            values = runs[place].covariates[self.covariate] + sign * size * np.array(self.apart)
            runs[place] = replace(runs[place], covariates={**runs[place].covariates, self.covariate: values})
        return replace(campaign, runs=tuple(runs))

    def _outputs(self, campaign: Campaign, run: Run, size: np.ndarray) -> np.ndarray:
        observed = run.observed.copy()
        here = slice(None) if self.row is None else slice(self.row, self.row + 1)
        there = slice(None) if self.channel is None else slice(self.channel, self.channel + 1)
        offsets = np.array([channel.offset for channel in campaign.channels])[there]
        change = size if self.form == "output_offset" else size[0] * (observed[here, there] - offsets)
        observed[here, there] = observed[here, there] + change
        return observed

    def freedom(self, campaign: Campaign) -> int:
        """Return the number of components of a size."""
        if self.channel is not None:
            return 1
        return {"seat": 3, "output_offset": len(campaign.channels)}.get(self.form, 1)

    def possible(self, size: np.ndarray) -> bool:
        """Whether a record can be wrong by a size: what lies beyond is the work of something else."""
        if self.form == "seat":
            return float(np.linalg.norm(size)) < math.pi / 2
        if self.form == "exchange":
            return abs(float(size[0]) - 1) < _NEARLY_EXCHANGED
        if self.form.endswith("factor"):
            factor = 1 + float(size[0])
            return _LARGEST_FACTOR > factor > 1 / _LARGEST_FACTOR or abs(factor + 1) < _NEARLY_REVERSED
        if not self.covariate:
            return True
        largest = _LARGEST.get(COVARIATES[self.covariate].si, np.inf)
        return abs(float(size[0])) < largest

    def step(self, campaign: Campaign) -> float:
        """Return the step of the derivative by a component of its size."""
        if self.form != "offset":
            return _STEP  # of an exchange as well, whose size is a ratio
        return _STEP * (float(np.nanmax(np.abs(campaign.runs[self.run].covariates[self.covariate]))) or 1.0)


def suspected(campaign: Campaign, run: int) -> Iterator[WrongInput]:
    """Yield what may be wrong in all rows of a run; the natural form of a column first."""
    one = campaign.runs[run]
    for column in suspected_columns(one):
        values = one.covariates[column.name]
        rate = column.si == "rad/s"
        if not rate:
            yield WrongInput(run, "offset", column.name)
        # A thermometer is off by degrees; its unit is judged by the reader.
        if not column.periodic and column.si != "degC" and np.any(values != 0):
            yield WrongInput(run, "factor", column.name)
    if one.mounting is not None and one.table is not None:
        yield WrongInput(run, "seat")
    yield WrongInput(run, "output_factor")
    yield WrongInput(run, "output_offset")
    seen = np.flatnonzero(np.isfinite(one.observed).any(axis=0)).tolist()
    for channel in seen if len(seen) > 1 else ():
        yield WrongInput(run, "output_factor", channel=channel)
        yield WrongInput(run, "output_offset", channel=channel)


def exchanged(campaign: Campaign) -> Iterator[WrongInput]:
    """Yield the pairs of runs that may have exchanged their temperatures."""
    for column in ("temperature", "converter_temperature"):
        known = [k for k, run in enumerate(campaign.runs) if column in {each.name for each in suspected_columns(run)}]
        for one, other in combinations(known, 2):
            own, others = (campaign.runs[k].covariates[column] for k in (one, other))
            apart = others - own if len(own) == len(others) else np.array([others.mean() - own.mean()])
            if np.isfinite(apart).all() and float(np.sqrt(np.mean(apart**2))) > _LEAST_EXCHANGED:
                yield WrongInput(one, "exchange", column, other=other, apart=tuple(apart.tolist()))


def acts_through_the_model(wrong: WrongInput) -> bool:
    """Return whether a wrong input changes the prediction: outputs, and parameters beyond their prior, are linear."""
    return wrong.form not in ("unit", "prior", "samples") and not wrong.form.startswith("output")


def of_sensors(model: Model) -> np.ndarray:
    """Return the places of the parameters that another unit has of its own, (n,): those of channels."""
    channels = {channel.name for channel in model.campaign.channels}
    owned = [bool(channels & {*each.label}) for each in model.layout.parameters]
    return np.flatnonzero(owned)


def suspected_columns(run: Run) -> list[Covariate]:
    """Return the recorded columns of a run whose values may be wrong: what a bench or an instrument says."""
    if run.tumble is not None or PROCEDURES[run.procedure].driven:
        return []
    found = [each for each in recorded() if each.name in run.covariates and each.name not in _NOT_SUSPECTED]
    turns = [each for each in found if each.si != "rad/s" or np.any(run.covariates[each.name] != 0)]
    return [each for each in turns if np.isfinite(run.covariates[each.name]).any()]


# A time is judged by the reader, and the arc of a row and its acceleration follow from the rate.
_NOT_SUSPECTED = {"time", "power_on", *(name for name in COVARIATES if name.endswith(("_span", "_acceleration")))}


def problem_of(model: Model, campaign: Campaign) -> Problem | None:
    """Return the problem of a model for a changed record of its campaign; None if the nodes are no longer the same.

    Arrays have the shapes that they had, so that nothing is traced.
    """
    before = model.campaign
    nodes = rejoin_nodes(model.nodes, campaign)
    same = nodes.turns == model.nodes.turns and np.array_equal(nodes.row_of, model.nodes.row_of)
    if not same or not np.array_equal(nodes.stand, model.nodes.stand):
        return None
    arrays, value = nodes_of(campaign, nodes), np.asarray(model.problem.observations.value)
    if any(run.observed is not known.observed for run, known in zip(campaign.runs, before.runs, strict=True)):
        value = value + (join_entries(campaign).value - join_entries(before).value)
    return replace(model.problem, nodes=arrays, observations=replace(model.problem.observations, value=value))


@in_numpy
def _misfit(problem: Problem, z: Array) -> Array:
    return problem.observations.value - predict(problem, z)


@in_numpy
def _turn(vector: Array) -> Array:
    return exponential(vector)


class Predictions:
    """Misfits of a model at parameters z, for changed records of its campaign."""

    def __init__(self, model: Model, z: np.ndarray):
        self.model, self.z = model, np.asarray(z)

    @cached_property
    def _predicted(self) -> np.ndarray:
        """The predicted outputs of the campaign of the model, (E,)."""
        problem = self.model.problem
        return np.asarray(problem.observations.value) - np.asarray(_misfit(problem, self.z))

    def misfit(self, campaign: Campaign) -> np.ndarray | None:
        """Return observed less predicted of every entry, (E,); None if the prediction is not defined."""
        problem = problem_of(self.model, campaign)
        return None if problem is None else np.asarray(_misfit(problem, self.z))

    def response(self, wrong: WrongInput, campaign: Campaign) -> np.ndarray | None:
        """Return the derivative of −misfit by the size of a wrong input, (E, d), in a campaign."""
        if not wrong.covariate and wrong.form != "seat":
            return self._of_outputs(wrong, campaign)
        step, columns = wrong.step(campaign), []
        for along in np.eye(wrong.freedom(campaign)):
            high, low = (self.misfit(wrong.corrected(campaign, sign * step * along)) for sign in (1, -1))
            if high is None or low is None:
                return None
            columns.append((low - high) / (2 * step))
        found = np.stack(columns, axis=1)
        return found if np.isfinite(found).all() and np.any(found) else None

    def _of_outputs(self, wrong: WrongInput, campaign: Campaign) -> np.ndarray:
        """Return the same for outputs: what is recorded moves, and not the prediction.

        A factor acts on the predicted outputs: about the recorded ones it would explain their noise by itself.
        """
        entries = self.model.entries
        own = (entries.run == wrong.run) & ~entries.closing & ((entries.row == wrong.row) | (wrong.row is None))
        return np.where(own[:, None], self.responses_of_outputs(campaign)[wrong.form, wrong.channel], 0.0)

    def responses_of_outputs(self, campaign: Campaign) -> Mapping[tuple[Form, int | None], np.ndarray]:
        """Return the response to outputs of all channels, or of one, that are off, (E, d), all runs at once."""
        entries, channels = self.model.entries, campaign.channels
        channel = np.where(entries.closing, 0, entries.channel)
        offsets = np.array([each.offset for each in channels])[channel]
        found: dict[tuple[Form, int | None], np.ndarray] = {
            ("output_offset", None): -np.eye(len(channels))[channel] * ~entries.closing[:, None],
            ("output_factor", None): np.where(entries.closing, 0.0, offsets - self._predicted)[:, None],
        }
        for k in range(len(channels)):
            found["output_offset", k] = found["output_offset", None][:, k : k + 1]
            found["output_factor", k] = np.where((channel == k)[:, None], found["output_factor", None], 0.0)
        return found

    def responses_of_columns(self, campaign: Campaign) -> Mapping[str, np.ndarray]:
        """Return the derivative by each column of the record, (E,), each row by its own value, all runs at once."""
        every = [suspected_columns(run) for run in campaign.runs]
        names = dict.fromkeys(each.name for columns in every for each in columns)
        found = {}
        for name in names:
            concerned = [
                WrongInput(k, "offset", name)
                for k, columns in enumerate(every)
                if any(column.name == name for column in columns)
            ]
            step = max(each.step(campaign) for each in concerned)
            if (response := self._of_all(campaign, concerned, np.array([step]))) is not None:
                found[name] = response
        return found

    def response_of_seats(self, campaign: Campaign) -> np.ndarray | None:
        """Return the derivative by the attitude of the seat, (E, 3), each run by its own, all runs at once."""
        concerned = [each for k in range(len(campaign.runs)) for each in suspected(campaign, k) if each.form == "seat"]
        if not concerned:
            return None
        found = [self._of_all(campaign, concerned, _STEP * along) for along in np.eye(3)]
        known = [each for each in found if each is not None]
        return np.stack(known, axis=1) if len(known) == len(found) else None

    def _of_all(self, campaign: Campaign, concerned: Sequence[WrongInput], step: np.ndarray) -> np.ndarray | None:
        high, low = campaign, campaign
        for each in concerned:
            high, low = each.corrected(high, step), each.corrected(low, -step)
        misfits = [self.misfit(each) for each in (high, low)]
        if misfits[0] is None or misfits[1] is None:
            return None
        return np.nan_to_num((misfits[1] - misfits[0]) / (2 * float(np.linalg.norm(step))))
