"""Wrong inputs as explanations: a column of the record of a run is off, its seat, its outputs, or one row of a column.

A wrong input responds as the model does to that column of the record (`imubayes.responses.wrong_inputs`).  Where it is
not among the explanations a thermometer that is off becomes a thermal effect, and a mistyped angle heavy tails.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from imubayes.criticism.evidence.effect_variants import WIDTH_RATIO
from imubayes.criticism.evidence.free_forms import FormHypothesis, with_prior
from imubayes.criticism.evidence.linear_problem import UNEXPECTED, LinearProblem
from imubayes.inference.fitted_model import Fit
from imubayes.responses.wrong_inputs import Predictions, WrongInput, suspected

_ERRORS = tuple((WIDTH_RATIO ** np.arange(7)).tolist())
"""Standard deviations of what is wrong, by its largest response in units of noise: a mistake is no small effect."""


@dataclass(frozen=True, eq=False)
class WrongInputs:
    """What may be wrong in all rows of a run, with prior probabilities, and in single rows; None where nothing is."""

    of_runs: tuple[FormHypothesis, ...]
    of_rows: "WrongRows | None"


def wrong_inputs(problem: LinearProblem, fitted: Fit) -> WrongInputs:
    """Return what may be wrong in the record of the campaign of a fit."""
    predictions = Predictions(fitted.model, fitted.z)
    columns = predictions.responses_of_columns(fitted.model.campaign)
    of_runs = list(_of_runs(problem, fitted, predictions, columns))
    return WrongInputs(with_prior(of_runs, UNEXPECTED / 4), _wrong_rows(problem, fitted, columns))


def _of_runs(
    problem: LinearProblem, fitted: Fit, predictions: Predictions, columns: Mapping[str, np.ndarray]
) -> Iterator[FormHypothesis]:
    """Yield what may be wrong in all rows of one run."""
    campaign = fitted.model.campaign
    seats = predictions.response_of_seats(campaign)
    for run in range(len(campaign.runs)):
        for wrong in suspected(campaign, run):
            response = _of_run(problem, fitted, wrong, columns, seats, predictions)
            largest = float(np.abs(problem.root[:, None] * response).max(initial=0.0)) if response is not None else 0.0
            if response is not None and np.isfinite(largest) and largest > 0:
                shape = _in_noise(problem, response, largest)
                name = f"{wrong.form} of {wrong.covariate or 'outputs'}" if wrong.form != "seat" else "attitude"
                yield FormHypothesis("input", name, (), shape, _ERRORS, run=run, wrong=wrong, unit=1 / largest)


def _of_run(
    problem: LinearProblem,
    fitted: Fit,
    wrong: WrongInput,
    columns: Mapping[str, np.ndarray],
    seats: np.ndarray | None,
    predictions: Predictions,
) -> np.ndarray | None:
    """Return the response to a wrong input of one run, (E, d), from the derivatives by the record of all runs."""
    model = fitted.model
    if wrong.form == "seat":
        every = seats
    elif wrong.covariate:
        every = columns.get(wrong.covariate)
    else:
        return predictions.response(wrong, model.campaign)
    if every is None:
        return None
    here, found = (problem.run == wrong.run) & ~model.entries.closing, np.zeros((len(every), every[0].size))
    own = every.reshape(found.shape)[here]
    if wrong.form == "factor":
        own = (
            own
            * np.nan_to_num(model.campaign.runs[wrong.run].covariates[wrong.covariate])[model.entries.row[here], None]
        )
    found[here] = own
    return found


def _in_noise(problem: LinearProblem, response: np.ndarray, largest: float) -> dict[int, np.ndarray]:
    """Return a response of all entries (E, d), output units, over the noise of each, its largest value 1."""
    root = problem.root[:, None] * response
    found = {k: root[rows.entry] / largest for k, rows in enumerate(problem.rows)}
    return {k: columns for k, columns in found.items() if np.any(columns)}


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
    amplitudes: tuple[float, ...] = _ERRORS

    @property
    def log_prior(self) -> float:
        """Logarithm of the prior probability of each: as likely together as a run that is wrong."""
        return math.log(UNEXPECTED / 4 / max(len(self.columns), 1) / max(len(self.run), 1))

    def form(self, column: str, row: int) -> FormHypothesis:
        """Return one of them as a form."""
        shape = {k: np.where(self.row[k] == row, x, 0.0)[:, None] for k, x in self.columns[column].items()}
        shape = {k: x for k, x in shape.items() if np.any(x)}
        run, place = int(self.run[row]), int(self.place[row])
        channel = self.outputs.get(column)
        wrong = WrongInput(run, "offset", column, place)
        if channel is not None:
            wrong = WrongInput(run, "output_offset", row=place, channel=channel)
        name = f"offset of {column}" if channel is None else f"output of {column} off"
        unit = float(self.unit[column][row])
        return FormHypothesis("input", name, (), shape, _ERRORS, self.log_prior, run, place, wrong, unit)


def _wrong_rows(problem: LinearProblem, fitted: Fit, columns: Mapping[str, np.ndarray]) -> WrongRows | None:
    """Return what may be wrong in single rows; None where there are none."""
    runs, entries = fitted.model.campaign.runs, fitted.model.entries
    first = np.cumsum([0, *(run.rows for run in runs)])
    row = {k: first[entries.run[rows.entry]] + entries.row[rows.entry] for k, rows in enumerate(problem.rows)}
    found: dict[str, dict[int, np.ndarray]] = {}
    units: dict[str, np.ndarray] = {}
    outputs = {channel.name: k for k, channel in enumerate(problem.channels) if len(problem.rows[k].entry)}
    of_outputs = {name: np.where(entries.channel == k, -1.0, 0.0) for name, k in outputs.items()}
    for name, response in {**columns, **of_outputs}.items():
        white = {k: problem.root[rows.entry] * response[rows.entry] for k, rows in enumerate(problem.rows)}
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
