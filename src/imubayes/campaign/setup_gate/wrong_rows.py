"""Rows whose recorded table angle or rate is wrong, and runs whose table rate is wrong by a factor.

In such a row every channel is off as the other angle or rate predicts.  The row is predicted from all others by the
linear model of plausible errors, without the row.  The other rows show how well rows are predicted, so that no size of
errors has to be assumed: a row is reported if it stands out from everything else that the linear model leaves out,
and another angle, rate or output brings it back in line.

The rate of a whole run may be wrong by a factor: that of another range, or of a slipping drive.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np

from imubayes.campaign.setup_gate.axis_mistakes import AXES, recorded_column, with_column
from imubayes.campaign.setup_gate.equipment_mistakes import RIVALLED, Concealed, Mistake, Scope, single_runs, turns
from imubayes.campaign.setup_gate.error_model import NormalTerms, stacked_terms
from imubayes.campaign.setup_gate.evidence import ErrorModel, Seen
from imubayes.campaign.setup_gate.reading_mistakes import RATES, NominalScale, rate_factor
from imubayes.campaign.setup_gate.setup_view import REFERENCE, RunView, changed, views_of
from imubayes.campaign.setup_gate.thermal_mistakes import LEAST_COURSE
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.covariates import COVARIATES
from imubayes.foundations.wrong_records import OPEN, Form, WrongRecord

STANDS_OUT = 5.0
"""How many times as far off as the next a row has to be: what a linear model leaves out grows toward the largest
inputs, and several rows have these."""
LEAST_SD = 10.0
"""How many standard deviations of the other rows it has to be off, at least."""
LEFT = 0.2
"""Share of its error that the other angle or rate may leave."""
LEAST_ANGLE, LEAST_RATE = np.radians(0.5), 0.02
"""Errors that are told: of an angle, rad, and of a rate over the largest one of the run.  Smaller ones are the business
of a diagnosis, at the noise of the unit."""
LEAST_OUTPUT = 1e-3
"""The same of one output, as a share of it."""
_OPEN, _RIVAL = 12.0, 10.0
"""Gain that an open value needs over a reversed sign, and within which of the best a record is a rival."""
MOST_ROWS = 3
_MOST_LEFT_OUT = 4
_STEPS, _REWEIGHED = 5, 2
_STARTS = np.linspace(-np.pi / 2, np.pi, 4)
_NORMAL_MAD = 0.6745
_STEP = 1e-4


@dataclass(frozen=True)
class WrongRow:
    """A row whose column `angle` or `rate` of the table, or one output, does not agree with the rest.

    Attributes
    ----------
    run, row : name of the run, and place of the row from 0.
    recorded, agreeing, sd : of that column, rad, rad/s or output units, the last from the scatter of the other rows; 0
        of a reversed sign, which has no value to estimate.
    distance : of its outputs from the prediction, in standard deviations of the other rows.
    column : covariate; empty of an output.
    channel : place of the output; None of a column.
    rivals : other records of the row that agree as well.
    """

    run: str
    row: int
    column: str
    recorded: float
    agreeing: float
    sd: float
    distance: float
    channel: int | None = None
    rivals: "tuple[WrongRow, ...]" = ()

    def wrong_record(self, campaign: Campaign) -> WrongRecord:
        """Return what is wrong in the record of the row, in the units of the record."""
        channel = None if self.channel is None else campaign.channels[self.channel]
        form: Form
        if channel is not None:
            quantity, kind, unit, form = channel.name, channel.kind, channel.output_unit, "output_offset"
            recorded, agreeing, sd = 0.0, self.agreeing - self.recorded, self.sd
        else:
            covariate = COVARIATES[self.column]
            table = next(run.table for run in campaign.runs if run.name == self.run)
            zero = campaign.tables[table or ""].zero_angle if self.column == "table_angle" else 0.0
            quantity, kind, unit, form = covariate.column, "", covariate.unit, "offset"
            recorded, agreeing = ((value + zero) / covariate.factor() for value in (self.recorded, self.agreeing))
            sd = self.sd / covariate.factor()
        if not sd:  # a reversed sign
            form, unit, recorded, agreeing = "factor" if channel is None else "output_factor", "1", 1.0, -1.0
        return WrongRecord(
            run=self.run, row=self.row + 1, form=form, quantity=quantity, unit=unit, recorded=recorded,
            agreeing=(agreeing,), sd=(sd,) if sd else (), kind=kind,
            about=channel.offset if channel is not None and form == "output_factor" else 0.0,
        )  # fmt: skip


def wrong_rows(campaign: Campaign) -> list[WrongRow]:
    """Return the rows whose angle or rate is wrong by far."""
    views, found = list(views_of(campaign)), []
    several = [place for place, view in enumerate(views) if view.rows > 2]
    if not several or sum(view.rows for view in views) < 2 * LEAST_SD:
        return []
    model = ErrorModel(campaign)
    while len(found) < MOST_ROWS:
        one = _wrong_row(model, views)
        if one is None:
            break
        place = next(k for k, view in enumerate(views) if view.name == one.run)
        found.append(one)
        views[place] = _set(views[place], one, one.agreeing)
    return found


def with_rows(campaign: Campaign, rows: Sequence[WrongRow]) -> Campaign:
    """Return the campaign with the agreeing values in place of those recorded."""
    runs = list(campaign.runs)
    for each in rows:
        place = next(k for k, run in enumerate(runs) if run.name == each.run)
        if each.channel is not None:
            observed = runs[place].observed.copy()
            observed[each.row, each.channel] = each.agreeing
            runs[place] = replace(runs[place], observed=observed)
            continue
        values = runs[place].covariates.get(each.column, np.zeros(runs[place].rows)).copy()
        values[each.row] = each.agreeing
        runs[place] = replace(runs[place], covariates={**runs[place].covariates, each.column: values})
    return replace(campaign, runs=tuple(runs)) if rows else campaign


def _wrong_row(model: ErrorModel, views: Sequence[RunView]) -> WrongRow | None:
    """Return the row that is farthest off, as soon as rows that are left out stand out from all others.

    Two wrong rows may hide each other behind a right one, which is left out first and then agrees.
    """
    recorded, turning = model.seen_of(views), [view.largest_rate() > 0 for view in views]
    fitted = _robust(model, recorded, turning)
    if fitted is None:
        return None
    out, terms = list[tuple[int, int]](), [model.terms_of(seen) for seen in fitted]
    judged = _judged(model, terms, fitted, recorded, turning)
    while len(out) < _MOST_LEFT_OUT:
        place, row = _farthest(judged.apart, out)
        out.append((place, row))
        fitted[place] = fitted[place].without_row(row)
        terms[place] = model.terms_of(fitted[place])
        judged = _judged(model, terms, fitted, recorded, turning)
        apart = judged.apart
        sizes = {each: float(apart[each[0]][each[1]]) for each in out}
        rest = _farthest(apart, out)
        least = max(LEAST_SD, STANDS_OUT * float(apart[rest[0]][rest[1]]))
        wrong = {each: size for each, size in sizes.items() if size >= least}
        right = max((size for each, size in sizes.items() if each not in wrong), default=0.0)
        if 0 < len(wrong) <= MOST_ROWS and min(wrong.values()) >= STANDS_OUT * right:
            place, row = max(wrong, key=lambda each: wrong[each])
            several = int(np.sum(apart[place] >= LEAST_SD))
            found = WrongRow(views[place].name, row, "", 0.0, 0.0, 0.0, wrong[place, row])
            return _likeliest(model, views[place], place, found, several, judged)
    return None


def _no_more_than_it_moves(seen: Seen) -> Seen:
    """Return the rows of a run as fitted: what is left out of a row is a share of its output as well as of its input.

    A row whose recorded rate is near zero, and whose outputs are not, would draw the fit to itself and seem right.
    """
    apart = np.where(seen.there, seen.error - _medians(np.where(seen.there, seen.error, np.nan)), 0.0)
    return replace(seen, square=np.maximum(seen.square, apart**2))


def _robust(model: ErrorModel, recorded: Sequence[Seen], turning: Sequence[np.ndarray]) -> list[Seen] | None:
    """Return the rows with weights that no row far off draws to itself; None if all are near their predictions."""
    fitted = [_no_more_than_it_moves(seen) for seen in recorded]
    for _ in range(_REWEIGHED):
        judged = _judged(model, [model.terms_of(seen) for seen in fitted], fitted, recorded, turning)
        if max(float(each.max(initial=0.0)) for each in judged.apart) < LEAST_SD / 2:
            return None
        fitted = [_no_surer(seen, left) for seen, left in zip(recorded, judged.left, strict=True)]
    return fitted


def _no_surer(seen: Seen, left: np.ndarray) -> Seen:
    """Return the rows of a run with variances no less than the squares of what a fit leaves (Cauchy weights).

    A row that is far off does not draw the fit to itself, whatever its leverage.
    """
    return replace(seen, unknown=np.maximum(seen.unknown, np.nan_to_num(left) ** 2))


def _likeliest(
    model: ErrorModel, view: RunView, place: int, wrong: WrongRow, several: int, judged: "_JudgedRows"
) -> WrongRow | None:
    """Return what in the record of a row brings it in line, with what does so as well; None if nothing does."""
    columns = [replace(wrong, column=column) for column in _columns(view, wrong.row, several)]
    outputs = [replace(wrong, channel=k) for k in model.places if _is_of_rows(model, view, k, wrong.row, several)]
    found: list[tuple[float, WrongRow]] = []
    for each in (*columns, *(outputs if len(model.places) > 1 else [])):
        error = partial(_error_of_row, judged.error, place, view, each)
        offset = model.channels[model.places.index(each.channel)].offset if each.channel is not None else 0.0
        found += _agreeing_records(view, each, error, offset)
    if not found:
        return None
    found = sorted(found, key=lambda each: each[0])
    near = [each for score, each in found if score < found[0][0] + _RIVAL and _record(each) != _record(found[0][1])]
    return replace(found[0][1], rivals=tuple(near))


def _is_of_rows(model: ErrorModel, view: RunView, channel: int, row: int, wrong: int) -> bool:
    """Whether an output has a size, of its nominal one, in more rows than are wrong: else the whole run is."""
    at = model.places.index(channel)
    size = np.nan_to_num(np.abs(view.observed[:, channel] - model.channels[at].offset))
    nominal = float(np.abs(model.seen(view).along[at]).max()) * abs(model.channels[at].scale_si)
    return bool(np.isfinite(view.observed[row, channel]) and _moved(size, row, nominal) > 2 * wrong)


def _moved(values: np.ndarray, row: int, reach: float = 0.0) -> int:
    """Return in how many rows a quantity has a size, beside the largest of the rows but one, which may be wrong.

    Parameters
    ----------
    reach : that the largest has at least.
    """
    largest = float(np.delete(values, row).max(initial=reach))
    return int(np.sum(values > LEAST_RATE * largest)) if largest > 0 else 0


def _record(each: WrongRow) -> tuple[str, int | None]:
    return each.column, each.channel


def _error_of_row(
    error: Callable[[int, RunView], np.ndarray], place: int, view: RunView, wrong: WrongRow, value: float
) -> np.ndarray:
    """Return the errors of the outputs of a row with another value in its record, over their scatter, (K,)."""
    return error(place, _set(view, wrong, value))[:, wrong.row]


def _farthest(apart: Sequence[np.ndarray], out: Sequence[tuple[int, int]]) -> tuple[int, int]:
    """Return run and row of the largest distance, but for those left out."""
    left = [each.copy() for each in apart]
    for place, row in out:
        left[place][row] = 0.0
    place = max(range(len(left)), key=lambda k: float(left[k].max(initial=0.0)))
    return place, int(np.argmax(left[place]))


def _columns(view: RunView, row: int, wrong: int) -> Iterator[str]:
    """Yield what may be wrong in so many rows of a run."""
    for axis in () if view.table is None else AXES[-1:] if view.outer is None else AXES:
        angle, rate = recorded_column(view, f"{axis}_angle"), np.abs(recorded_column(view, f"{axis}_rate"))
        if np.isfinite(angle).any() and view.attitude is None:
            yield f"{axis}_angle"
        # What is wrong in most rows that turn is wrong in the run: its sense, its unit, or a scale factor.
        if _moved(rate, row) > 2 * wrong:
            yield f"{axis}_rate"
    # A row that is named by a direction may be in another one, which looks like another temperature.
    yield from view.temperatures if view.attitude is None else ()


def _agreeing_records(
    view: RunView, wrong: WrongRow, error: Callable[[float], np.ndarray], offset: float
) -> list[tuple[float, WrongRow]]:
    """Return the values of one record of a row that bring it in line, with −2 log of their evidence; the least is best.

    The reversed sign is a point on the open value, and is named if it does as well.

    Parameters
    ----------
    error : value → errors of the outputs of the row less the prediction, over their scatter, (K,).
    offset : of the outputs, about which their sign is reversed.
    """
    of_output, size = wrong.channel is not None, wrong.distance
    recorded = float(
        view.observed[wrong.row, wrong.channel] if of_output else recorded_column(view, wrong.column)[wrong.row]
    )
    if not np.isfinite(recorded):
        return []
    angle, temperature = wrong.column.endswith("angle"), wrong.column in view.temperatures
    step = LEAST_OUTPUT * abs(recorded - offset) if of_output else _STEP
    least = step if of_output else _least(view, wrong)
    # Outputs go around a circle with the angle: a search that starts a quarter of a turn away may end beside it.
    starts = recorded + (_STARTS if angle else np.zeros(1))
    left, value, sd = min(_agreeing(error, at, step) for at in starts) if step > 0 else (np.inf, recorded, 0.0)
    if angle:
        value = recorded + float((value - recorded + np.pi) % (2 * np.pi) - np.pi)
    count, reversed_ = len(error(recorded)), 2 * offset - recorded
    tried = [(count * left**2 + _OPEN, left, replace(wrong, recorded=recorded, agreeing=value, sd=sd))]
    if not angle and not temperature:
        rest = float(np.sqrt(np.mean(error(reversed_) ** 2)))
        tried.append((count * rest**2, rest, replace(wrong, recorded=recorded, agreeing=reversed_)))
    in_line = [
        (score, each) for score, rest, each in tried
        if abs(each.agreeing - recorded) > least and rest <= max(LEFT * size, 3.0)
    ]  # fmt: skip
    return [min(in_line, key=lambda each: each[0])] if in_line else []


def _least(view: RunView, wrong: WrongRow) -> float:
    """Return the least error of a column in a row that is told."""
    if wrong.column in view.temperatures:
        return LEAST_COURSE
    if wrong.column.endswith("angle"):
        return float(LEAST_ANGLE)
    return LEAST_RATE * float(np.delete(np.abs(recorded_column(view, wrong.column)), wrong.row).max())


def _agreeing(error: Callable[[float], np.ndarray], value: float, step: float) -> tuple[float, float, float]:
    """Return what is left of the error at the value where Gauss–Newton ends, that value, and its standard deviation."""
    sd = np.inf
    for _ in range(_STEPS):
        at = error(value)
        rate = (error(value + step) - at) / step
        if not rate @ rate > 0:
            break
        value, sd = value - float(rate @ at / (rate @ rate)), float(1 / np.sqrt(rate @ rate))
    return float(np.sqrt(np.mean(error(value) ** 2))), value, sd


def _set(view: RunView, wrong: WrongRow, value: float) -> RunView:
    if wrong.channel is not None:
        observed = view.observed.copy()
        observed[wrong.row, wrong.channel] = value
        return changed(view, observed=observed)
    values = recorded_column(view, wrong.column).copy()
    values[wrong.row] = value
    return with_column(view, wrong.column, values)


@dataclass(frozen=True)
class _JudgedRows:
    """How well the rows of a campaign are predicted.

    Attributes
    ----------
    apart : distance of every row of a run from its prediction, in standard deviations of all rows, shape (R,).
    left : errors of the outputs of each run less the prediction, SI, shape (K, R).
    error : place and view → the same of another view, over their scatter, (K, R).
    """

    apart: list[np.ndarray]
    left: list[np.ndarray]
    error: Callable[[int, RunView], np.ndarray]


def _judged(
    model: ErrorModel,
    terms: Sequence[NormalTerms],
    fitted: Sequence[Seen],
    recorded: Sequence[Seen],
    turning: Sequence[np.ndarray],
) -> _JudgedRows:
    """Judge the recorded rows by the errors that those fitted, which have these terms, show.

    Parameters
    ----------
    turning : of each run, whether the table turns in a row, (R,).
    """
    errors = model.estimates(stacked_terms(terms).total())
    own = errors[: model.own * len(model.channels)].reshape(-1, model.own)

    def left(seen: Seen) -> np.ndarray:
        shared = np.broadcast_to(errors[seen.shared], (len(own), len(seen.shared)))
        made = (seen.design @ np.concatenate([own, shared], axis=1)[:, :, None])[:, :, 0]
        return np.where(seen.there, seen.error - made, np.nan)

    every = [left(seen) for seen in recorded]
    offsets = [_medians(np.where(seen.there, one, np.nan)) for seen, one in zip(fitted, every, strict=True)]
    every = [one - offset for one, offset in zip(every, offsets, strict=True)]
    rest = [np.where(seen.there, one, np.nan) for seen, one in zip(fitted, every, strict=True)]
    scatter = _scatters(rest, [model.white(seen) for seen in fitted], turning)

    def error(place: int, view: RunView) -> np.ndarray:
        return np.nan_to_num((left(model.seen(view)) - offsets[place]) / scatter[place])

    apart = [np.sqrt(np.mean(np.nan_to_num(one / own) ** 2, axis=0)) for one, own in zip(every, scatter, strict=True)]
    return _JudgedRows(apart, every, error)


def _scatters(
    errors: Sequence[np.ndarray], white: Sequence[np.ndarray], turning: Sequence[np.ndarray]
) -> list[np.ndarray]:
    """Return the scatter of each output among those of its kind, at rest or turning, shape (K, R) of each run.

    A linear model leaves more of the outputs of a unit that turns.  If few rows are of a kind all serve.
    """
    every, noise, turn = np.concatenate(errors, axis=1), np.concatenate(white, axis=1), np.concatenate(turning)
    kinds = [turn, ~turn]
    of_kind = [each if each.sum() >= 2 * LEAST_SD else np.ones_like(turn) for each in kinds]
    scatter = np.empty_like(every)
    for kind, rows in zip(kinds, of_kind, strict=True):
        own = _medians(np.abs(every[:, rows])) / _NORMAL_MAD
        own = np.maximum(own, np.sqrt(np.median(noise[:, rows], axis=1, keepdims=True)))
        scatter[:, kind] = np.where(own > 0, own, np.inf)
    return np.split(scatter, np.cumsum([len(each) for each in turning])[:-1], axis=1)


def _medians(values: np.ndarray) -> np.ndarray:
    """Return the medians of rows but for NaN, shape (K, 1), without the masked arrays of NumPy's."""
    ordered, count = np.sort(values, axis=1), np.isfinite(values).sum(axis=1)
    each = np.arange(len(values))
    return ((ordered[each, (count - 1) // 2] + ordered[each, count // 2]) / 2)[:, None]


def _rates_recorded(view: RunView) -> bool:
    return turns(view) or view.reference is not None


@dataclass(frozen=True)
class RateFactor(Mistake):
    """The rates of one run, of its table or its reference gyro, are the recorded ones times a factor.

    The size is the logarithm of the factor.  The other runs that turn determine it.  Another unit is a point on it.
    """

    kind: ClassVar[str] = "table_rate"
    concealed: ClassVar[Concealed] = Concealed.BY_INPUTS
    estimated: ClassVar[bool] = True
    of_doubted_runs: ClassVar[int] = 2
    least: ClassVar[float] = 0.005  # scale factors of a good unit repeat from run to run
    rarity: ClassVar[float] = OPEN
    sizes: ClassVar[tuple[float, ...]] = tuple(np.linspace(-2.4, 2.4, 25).tolist())
    usual_within: ClassVar[float] = 0.02
    open_value: ClassVar[bool] = True

    @property
    def record(self) -> str:
        """The rates of a table."""
        return RATES

    @classmethod
    def scopes(cls, campaign: Campaign, views: Sequence[RunView]) -> Sequence[Scope]:
        """Return every run that turns, if there are several: a scale factor is known by the rate alone."""
        turning = [scope for scope in single_runs(views) if _rates_recorded(views[scope.runs[0]])]
        return turning if len(turning) > 1 and campaign.of_kind("gyro") else []

    def possible(self, size: float) -> bool:
        """Return whether the factor is within the range of those tried: at its end there is no estimate."""
        return abs(size) < self.sizes[-1]

    def bar(self, campaign: Campaign) -> float:
        """Return what other scale factors in a run would gain."""
        return RIVALLED * len(campaign.of_kind("gyro"))

    def like(self, other: Mistake) -> bool:
        """Return whether another is the scale factor of one gyro in the run, alike if it alone sees the rate."""
        return isinstance(other, NominalScale) and other.scope == self.scope and len(other.places) == 1

    def wrong_record(self, campaign: Campaign, size: float, sd: float) -> WrongRecord | None:
        """Return the factor on the rates of the run."""
        factor, recorded = float(np.exp(size)), campaign.runs[self.scope.runs[0]].covariates
        if REFERENCE[0] not in recorded:
            return rate_factor(self.scope, factor, sd * factor)
        # The unit turns about one axis of the reference gyro: the others show the Earth rate.
        fastest = max(REFERENCE, key=lambda name: float(np.nanmax(np.abs(recorded[name]))))
        return rate_factor(self.scope, factor, sd * factor, fastest)

    def corrected(self, views: Sequence[RunView], place: int, size: float) -> RunView:
        """Return the run with its rates multiplied."""
        view, factor = views[place], np.exp(size)
        reference = None if view.reference is None else view.reference * factor
        return changed(view, rate=view.rate * factor, reference=reference)
