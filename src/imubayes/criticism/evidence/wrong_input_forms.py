"""Wrong inputs as explanations: a column of the record of a run is off, its seat, its outputs, or one row of a column.

A wrong input responds as the model does to that column of the record (`imubayes.responses.wrong_inputs`).  If it is
not among the explanations a thermometer that is off becomes a thermal effect, and a mistyped angle heavy tails.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from imubayes.criticism.evidence.effect_variants import WIDTH_RATIO
from imubayes.criticism.evidence.free_forms import FormColumns, FormHypothesis, columns_of_run, with_prior
from imubayes.criticism.evidence.linear_problem import UNEXPECTED, ChannelRows, LinearProblem
from imubayes.foundations.campaign_data import Campaign
from imubayes.inference.fitted_model import Fit
from imubayes.responses.wrong_inputs import NO_RUN, Form, Predictions, WrongInput, exchanged, of_sensors, suspected

_ERRORS = tuple((WIDTH_RATIO ** np.arange(7)).tolist())
"""Standard deviations of what is wrong in a run, by its largest response in units of noise: a mistake is no small
effect."""
_BETWEEN_UNITS = math.sqrt(2.0)
"""Standard deviation of the parameters of two units about each other, in that of the prior of each."""
_BEYOND = (6.0, 20.0, 60.0, 200.0)
"""Standard deviations of parameters whose prior is too narrow, over it: from where no draw of the prior leads."""
_LEAST_RUNS = 3
"""Runs from which on the others determine what the unit is like."""
_ERRORS_OF_ROWS = tuple((WIDTH_RATIO ** np.arange(10)).tolist())
"""The same of one row: an angle that is mistyped by some degrees is 10⁵ of them."""


@dataclass(frozen=True, eq=False)
class WrongInputs:
    """What may be wrong in all rows of a run, with prior probabilities, and in single rows; None if nothing is."""

    of_runs: tuple[FormHypothesis, ...]
    of_rows: "WrongRows | None"


def wrong_inputs(problem: LinearProblem, fitted: Fit, recorded: Campaign) -> WrongInputs:
    """Return what may be wrong in the record of the campaign of a fit.

    Parameters
    ----------
    recorded : the campaign as it was recorded; that of the fit may be corrected.
    """
    predictions = Predictions(fitted.model, fitted.z)
    columns = predictions.responses_of_columns(fitted.model.campaign)
    of_runs = list(_of_runs(problem, fitted, predictions, columns))
    of_runs += [
        *_exchanges(problem, fitted, recorded, columns),
        *_other_units(problem, fitted),
        *_priors(problem, fitted),
    ]
    return WrongInputs(with_prior(of_runs, UNEXPECTED / 4), _wrong_rows(problem, fitted, columns))


def _exchanges(
    problem: LinearProblem, fitted: Fit, recorded: Campaign, columns: Mapping[str, np.ndarray]
) -> Iterator[FormHypothesis]:
    """Yield the columns that two runs may have exchanged."""
    entries = fitted.model.entries
    for wrong in exchanged(recorded):
        every = columns.get(wrong.covariate)
        if every is None:
            continue
        apart, moved = np.array(wrong.apart), np.zeros(len(every))
        for place, sign in ((wrong.run, 1.0), (wrong.other, -1.0)):
            here = (entries.run == place) & ~entries.closing
            moved[here] = sign * every[here] * (apart[entries.row[here]] if len(apart) > 1 else apart[0])
        white = problem.root * moved
        largest = float(np.abs(white).max())
        if not largest > 0:
            continue
        parts = {k: white[rows.entry][:, None] / largest for k, rows in enumerate(problem.rows) if len(rows.entry)}
        shape = {k: FormColumns(1, partial(np.copy, x)) for k, x in parts.items() if np.any(x)}
        name = f"exchange of {wrong.covariate}"
        yield FormHypothesis("input", name, (), shape, _ERRORS, run=wrong.run, wrong=wrong, unit=1 / largest)


def _other_units(problem: LinearProblem, fitted: Fit) -> Iterator[FormHypothesis]:
    """Yield that each run is of another unit: it responds to parameters of its own as to those of the others."""
    own = of_sensors(fitted.model)
    if len(problem.runs) < _LEAST_RUNS or not len(own):
        return
    for run in range(len(problem.runs)):
        parts = {}
        for k, rows in enumerate(problem.rows):
            here = problem.run[rows.entry] == run
            if here.any() and rows.kind != "closure":
                parts[k] = FormColumns(len(own), partial(_own_responses, rows, own, here))
        if parts:
            wrong = WrongInput(run, "unit")
            yield FormHypothesis("input", "another unit", (), parts, (_BETWEEN_UNITS,), run=run, wrong=wrong, unit=1.0)


def _priors(problem: LinearProblem, fitted: Fit) -> Iterator[FormHypothesis]:
    """Yield that the stated prior of each effect of the model, or of each parameter alone, is too narrow."""
    parameters = fitted.model.layout.parameters
    groups = {each.name: [k] for k, each in enumerate(parameters)}
    for k, each in enumerate(parameters):
        groups.setdefault(each.effect, []).append(k)
    for name, own in groups.items():
        places, parts = np.array(own), {}
        for k, rows in enumerate(problem.rows):
            if np.isin(places, rows.live).any():
                here = np.ones(len(rows.entry), dtype=bool)
                parts[k] = FormColumns(len(own), partial(_own_responses, rows, places, here))
        if parts and len(own) != len(parameters):
            wrong = WrongInput(NO_RUN, "prior", parameters=tuple(own))
            yield FormHypothesis("input", f"prior of {name}", (), parts, _BEYOND, wrong=wrong, unit=1.0)


def _own_responses(rows: ChannelRows, parameters: np.ndarray, here: np.ndarray) -> np.ndarray:
    """Return the responses of some rows of a channel to parameters, (n, p); of others none."""
    found = np.zeros((len(rows.entry), len(parameters)))
    place = {int(column): n for n, column in enumerate(rows.live)}
    for n, parameter in enumerate(parameters.tolist()):
        if parameter in place:
            found[here, n] = rows.columns[here, place[parameter]]
    return found


def _of_runs(
    problem: LinearProblem, fitted: Fit, predictions: Predictions, columns: Mapping[str, np.ndarray]
) -> Iterator[FormHypothesis]:
    """Yield what may be wrong in all rows of one run."""
    campaign = fitted.model.campaign
    suspects = [each for run in range(len(campaign.runs)) for each in suspected(campaign, run)]
    of_outputs, seats = predictions.responses_of_outputs(campaign), predictions.response_of_seats(campaign)
    kinds: dict[tuple[Form, str, int | None], list[WrongInput]] = {}
    for each in suspects:
        kinds.setdefault((each.form, each.covariate, each.channel), []).append(each)
    for (form, column, channel), alike in kinds.items():
        every = seats if form == "seat" else of_outputs.get((form, channel)) if not column else columns.get(column)
        if every is None:
            continue
        if form == "factor":
            every = every * np.nan_to_num(_recorded(fitted, column))
        outputs = "outputs" if channel is None else campaign.channels[channel].name
        name = f"{form} of {column or outputs}" if form != "seat" else "attitude"
        yield from _in_runs(problem, fitted, every.reshape(len(every), -1), name, alike)


def _recorded(fitted: Fit, column: str) -> np.ndarray:
    """Return the value of a column of the record at every entry, (E,); NaN in runs without it."""
    entries, found = fitted.model.entries, np.full(len(fitted.model.entries), np.nan)
    for k, run in enumerate(fitted.model.campaign.runs):
        if column in run.covariates:
            here = (entries.run == k) & ~entries.closing
            found[here] = run.covariates[column][entries.row[here]]
    return found


def _in_runs(
    problem: LinearProblem, fitted: Fit, every: np.ndarray, name: str, suspects: Sequence[WrongInput]
) -> Iterator[FormHypothesis]:
    """Yield one wrong input in each of some runs, from the response of all entries to that of their own, (E, d)."""
    root = np.where(fitted.model.entries.closing, 0.0, problem.root)[:, None] * every
    largest = np.zeros(len(problem.runs))
    np.maximum.at(largest, problem.run, np.abs(root).max(axis=1))
    sound = np.isfinite(largest) & (largest > 0)
    root *= np.divide(1.0, largest, where=sound, out=np.zeros_like(largest))[problem.run][:, None]
    shapes: dict[int, dict[int, FormColumns]] = {}
    for k, rows in enumerate(problem.rows):
        own = root[rows.entry]
        for series, (start, length) in enumerate(rows.series):
            if np.any(own[start : start + length]):
                shapes.setdefault(int(problem.run[rows.entry[start]]), {})[k] = columns_of_run(rows, own, series)
    for wrong in suspects:
        run = wrong.run
        if sound[run]:
            yield FormHypothesis(
                "input", name, (), shapes[run], _ERRORS, run=run, wrong=wrong, unit=1 / float(largest[run])
            )


@dataclass(frozen=True, eq=False)
class WrongRows:
    """What may be wrong in one row of a run: one column of the record there, or the output of one channel.

    Attributes
    ----------
    columns : column of the record, or channel → channel → (n,), the response of each row to its own value, its largest
        1.
    unit : column of the record, or channel → (rows,), error of the row for a coefficient of 1.
    outputs : channel → its place.
    row : channel → (n,), row of each entry, counted over all runs.
    run, place : shape (rows,), run of each row, and its place there.
    """

    columns: Mapping[str, Mapping[int, np.ndarray]]
    unit: Mapping[str, np.ndarray]
    row: Mapping[int, np.ndarray]
    run: np.ndarray
    place: np.ndarray
    outputs: Mapping[str, int]
    amplitudes: tuple[float, ...] = _ERRORS_OF_ROWS

    @property
    def log_prior(self) -> float:
        """Logarithm of the prior probability of each: as likely together as a run that is wrong."""
        return math.log(UNEXPECTED / 4 / max(len(self.columns), 1) / max(len(self.run), 1))

    def form(self, column: str, row: int) -> FormHypothesis:
        """Return one of them as a form."""
        alone = {k: np.where(self.row[k] == row, x, 0.0)[:, None] for k, x in self.columns[column].items()}
        shape = {k: FormColumns(1, partial(np.copy, x)) for k, x in alone.items() if np.any(x)}
        run, place = int(self.run[row]), int(self.place[row])
        channel = self.outputs.get(column)
        wrong = WrongInput(run, "offset", column, place)
        if channel is not None:
            wrong = WrongInput(run, "output_offset", row=place, channel=channel)
        name = f"offset of {column}" if channel is None else f"output of {column} off"
        unit = float(self.unit[column][row])
        return FormHypothesis("input", name, (), shape, self.amplitudes, self.log_prior, run, place, wrong, unit)


def _wrong_rows(problem: LinearProblem, fitted: Fit, columns: Mapping[str, np.ndarray]) -> WrongRows | None:
    """Return what may be wrong in single rows; None if there are none."""
    runs, entries = fitted.model.campaign.runs, fitted.model.entries
    first = np.cumsum([0, *(run.rows for run in runs)])
    readings = {k: rows.entry for k, rows in enumerate(problem.of_channels) if len(rows.entry)}
    row = {k: first[entries.run[entry]] + entries.row[entry] for k, entry in readings.items()}
    found: dict[str, dict[int, np.ndarray]] = {}
    units: dict[str, np.ndarray] = {}
    outputs = {problem.rows[k].name: k for k in readings}
    of_outputs = {name: np.where(entries.channel == k, -1.0, 0.0) for name, k in outputs.items()}
    for name, response in {**columns, **of_outputs}.items():
        white = {k: problem.root[entry] * response[entry] for k, entry in readings.items()}
        largest = np.zeros(first[-1])
        for k, x in white.items():
            np.maximum.at(largest, row[k], np.abs(x))
        safe = np.where(largest > 0, largest, 1.0)
        units[name] = 1 / safe
        found[name] = {k: x / safe[row[k]] for k, x in white.items()}
    if not found:
        return None
    run = np.repeat(np.arange(len(runs)), [each.rows for each in runs])
    return WrongRows(found, units, row, run, np.arange(first[-1]) - first[run], outputs)
