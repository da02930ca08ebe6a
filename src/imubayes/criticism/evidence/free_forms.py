"""Explanations outside the catalogue: free functions of covariates, steps and harmonics.

A cause that is not among the hypotheses gives its probability to the nearest that is: without free forms an effect that
the catalogue lacks gets a wrong name with confidence.  A form is a few columns with one amplitude in units of noise;
its coefficients are normal.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from typing import Literal

import numpy as np

from imubayes.criticism.evidence.effect_variants import ONE_OWNER, WIDTH_RATIO
from imubayes.criticism.evidence.linear_problem import NEGLIGIBLE, UNEXPECTED, ChannelRows, LinearProblem
from imubayes.responses.residual_covariates import ResidualCovariate
from imubayes.responses.wrong_inputs import WrongInput

FormFamily = Literal[
    "function", "vector", "gain", "level", "threshold", "harmonic", "product", "memory", "step", "input"
]

AMPLITUDES = tuple((WIDTH_RATIO ** np.arange(4)).tolist())
"""Standard deviations of the coefficients of a form, in units of the noise of a row; equally likely.  A gross form
would stand in the place of large effects, about which the campaign is not linearised yet."""
HIGHEST_POWER, HARMONICS, PLACES = 5, 12, 10
"""Powers of a covariate; harmonics of an angle, and waves through a range; steps between places of what is local."""
STEP_WITHIN, STEP_OF_BIAS = "step within the run", "step of the bias"
_MOST_STEPS = 400
"""Places of steps that last, so that their number does not grow with that of runs.  Numerical."""
_SMOOTH, _ROUGH = (0.25, 7), (0.06, 16)
"""Length of a Gaussian process over the range of its covariate, and its columns."""
_ORDERS = range(1, 7)
"""Harmonics of a free function of an angle."""
_FIRST_HARMONIC = 3
"""The first that the catalogue does not have."""
_SHARES = tuple(2.0**-k for k in range(1, 7))
"""Of the largest input, at which a response sets in or saturates."""
_LEAST_ROWS = 8
"""Rows for a free function of a covariate."""
_POWERS = tuple((p, q) for p in range(1, HIGHEST_POWER) for q in range(1, HIGHEST_POWER - p))
_VECTORS = {"rate": "angular rate, as a vector", "force": "specific force, as a vector"}


@dataclass(frozen=True, eq=False)
class FormColumns:
    """Columns of a form over the rows of a channel, in units of their noise: forms × readings are not kept.

    Attributes
    ----------
    make : returns them, (n, width).
    every, series : of a form that acts in one run alone, the columns (n, width) of its like in all runs, which share
        them, and the place of its run among those of the channel.
    """

    width: int
    make: Callable[[], np.ndarray]
    every: np.ndarray | None = None
    series: int = 0


def columns_of_run(rows: ChannelRows, every: np.ndarray, series: int) -> FormColumns:
    """Return the columns of the one among forms that share columns (n, k) which acts in a run."""

    def make() -> np.ndarray:
        (start, length), found = rows.series[series], np.zeros_like(every)
        found[start : start + length] = every[start : start + length]
        return found

    return FormColumns(every.shape[1], make, every, series)


@dataclass(frozen=True, eq=False)
class FormHypothesis:
    """A form of one kind of channel.

    Attributes
    ----------
    covariates : columns of the covariates it depends on; of a step none.
    columns : channel → columns.
    amplitudes : standard deviations of its coefficients.
    log_prior : logarithm of its prior probability, shared by its amplitudes.
    run, row : of a step or a wrong input; the row counts from 0, None for all.
    wrong, unit : the wrong input it is, and its size for a coefficient of 1.
    log_share : logarithm of its share among others of its kind, one of which was chosen by the residuals.
    """

    family: FormFamily
    name: str
    covariates: tuple[str, ...]
    columns: Mapping[int, FormColumns]
    amplitudes: tuple[float, ...] = AMPLITUDES
    log_prior: float = 0.0
    run: int | None = None
    row: int | None = None
    wrong: WrongInput | None = None
    unit: float = 0.0
    log_share: float = 0.0

    @property
    def of_outputs(self) -> bool:
        """Whether it is a step of the outputs from a row on, its coefficients in units of their noise."""
        return self.name in (STEP_WITHIN, STEP_OF_BIAS)


@dataclass(frozen=True)
class ChosenForm:
    """A form with its amplitude, on all of its channels or on one alone."""

    form: FormHypothesis
    amplitude: float
    channels: tuple[int, ...]

    @property
    def log_prior(self) -> float:
        """Logarithm of the prior probability."""
        several = len(self.form.columns)
        alone = len(self.channels) == 1 and several > 1
        share = math.log(ONE_OWNER / several) if alone else math.log(1 - ONE_OWNER) if several > 1 else 0.0
        return self.form.log_prior + (share if self.form.wrong is None else 0.0) - math.log(len(self.form.amplitudes))

    def span(self, channel: int) -> slice:
        """Return the places of a channel's coefficients: each its own, but a wrong input has the same for all."""
        own = self.form.columns[channel].width
        earlier = () if self.form.wrong is not None else (k for k in self.channels if k < channel)
        before = sum(self.form.columns[k].width for k in earlier)
        return slice(before, before + own)

    @property
    def width(self) -> int:
        """The number of its coefficients."""
        return max(self.span(k).stop for k in self.channels)

    def at(self, amplitude: float) -> "ChosenForm":
        """Return the form with another amplitude."""
        return ChosenForm(self.form, amplitude, self.channels)


def free_forms(problem: LinearProblem, known: Sequence[ResidualCovariate]) -> tuple[FormHypothesis, ...]:
    """Return all forms outside the catalogue, with their prior probabilities, whatever a sensor can do."""
    forms: list[FormHypothesis] = []
    kinds = [rows.kind for rows in problem.of_channels]
    for kind in dict.fromkeys(kinds):
        forms += _of_kind(problem, known, [k for k, each in enumerate(kinds) if each == kind])
    return with_prior(forms, UNEXPECTED / 2)


def with_prior(forms: Sequence[FormHypothesis], whole: float) -> tuple[FormHypothesis, ...]:
    """Return forms with a prior probability in equal shares of families and members, but for their own share."""
    weight: dict[str, float] = {}
    for each in forms:
        weight[each.family] = weight.get(each.family, 0.0) + math.exp(each.log_share)
    share = {family: math.log(whole / len(weight) / total) for family, total in weight.items()}
    return tuple(replace(each, log_prior=share[each.family] + each.log_share) for each in forms)


@dataclass(frozen=True)
class _Place:
    """Rows of a channel with its covariates as seen there."""

    rows: ChannelRows
    run: np.ndarray

    def columns(self, width: int, make: Callable[[], np.ndarray]) -> FormColumns:
        """Return what a function makes, (n, width), over the noise of the rows."""
        return FormColumns(width, lambda: make() * self.rows.root[:, None])


def _of_kind(
    problem: LinearProblem, known: Sequence[ResidualCovariate], channels: list[int]
) -> Iterator[FormHypothesis]:
    places = {
        k: _Place(problem.rows[k], problem.run[problem.rows[k].entry]) for k in channels if len(problem.rows[k].entry)
    }
    if not places:
        return
    for covariate in known:
        values = {k: covariate.values[place.rows.entry] for k, place in places.items()}
        seen = {k: x for k, x in values.items() if _varies(x)}
        if seen:
            yield from _of_covariate(covariate, seen, places)
    yield from _vectors(known, places)
    yield from _products(known, places)
    before = {k: place.columns(2, partial(_rows_before, place.rows)) for k, place in places.items()}
    yield FormHypothesis("memory", "delayed response to the input", (), before)
    yield from _steps(places, problem)


def _varies(values: np.ndarray) -> bool:
    told = values[np.isfinite(values)]
    return len(told) >= _LEAST_ROWS and float(np.ptp(told)) > NEGLIGIBLE * (1 + float(np.abs(told).max()))


def _of_covariate(
    covariate: ResidualCovariate, seen: Mapping[int, np.ndarray], places: Mapping[int, _Place]
) -> Iterator[FormHypothesis]:
    name, said, own = covariate.name, covariate.phrase, (covariate.name,)
    if covariate.periodic:
        angle = {k: np.radians(x) for k, x in seen.items()}
        basis = {k: (2 * len(_ORDERS), partial(_harmonics, x, _ORDERS, 0.5)) for k, x in angle.items()}
        for order in range(_FIRST_HARMONIC, HARMONICS + 1):
            shape = {k: places[k].columns(2, partial(_harmonics, x, [order])) for k, x in angle.items()}
            yield FormHypothesis("harmonic", f"harmonic {order} of {said}", own, shape)
    else:
        basis = {k: _gaussian_process(x, *_SMOOTH) for k, x in seen.items()}
        rough = {k: places[k].columns(*_gaussian_process(x, *_ROUGH)) for k, x in seen.items()}
        yield FormHypothesis("function", f"rapidly varying function of {said}", own, rough)
        if name.startswith(("rate", "force")):
            yield from _levels(covariate, seen, places)
            yield from _thresholds(covariate, seen, places)
    yield FormHypothesis("function", f"function of {said}", own, {k: places[k].columns(*b) for k, b in basis.items()})
    if any(places[k].rows.input_varies for k in basis):
        gained = {k: places[k].columns(width, partial(_gained, places[k], b)) for k, (width, b) in basis.items()}
        yield FormHypothesis("gain", f"input × function of {said}", own, gained)


def _gained(place: _Place, make: Callable[[], np.ndarray]) -> np.ndarray:
    return make() * place.rows.input[:, None]


def _harmonics(angle: np.ndarray, orders: Sequence[int], size: float = 1.0) -> np.ndarray:
    waves = [size * wave(order * np.nan_to_num(angle)) for order in orders for wave in (np.cos, np.sin)]
    return np.where(np.isfinite(angle)[:, None], np.stack(waves, axis=1), 0.0)


def _gaussian_process(values: np.ndarray, length: float, columns: int) -> tuple[int, Callable[[], np.ndarray]]:
    """Return columns whose normal combinations are a Gaussian process of unit variance; zero if not finite.

    Its coordinate is the mean of value and rank, both scaled to their range: levels far apart are not one.
    """
    told = np.isfinite(values)
    x = values[told]
    _, rank = np.unique(np.round(x / float(np.ptp(x)), 3), return_inverse=True)
    at = 0.5 * (x - x.min()) / np.ptp(x) + 0.5 * rank / max(int(rank.max()), 1)
    grid, place = np.unique(np.round(at, 3), return_inverse=True)
    squares, axes = np.linalg.eigh(np.exp(-0.5 * ((grid[:, None] - grid) / length) ** 2))
    best = np.argsort(-squares)[:columns]
    table = np.append(axes[:, best] * np.sqrt(np.maximum(squares[best], 0.0)), np.zeros((1, len(best))), axis=0)
    row = np.full(len(values), len(grid))
    row[told] = place
    return len(best), partial(np.take, table, row, axis=0)


def _levels(
    covariate: ResidualCovariate, seen: Mapping[int, np.ndarray], places: Mapping[int, _Place]
) -> Iterator[FormHypothesis]:
    """Yield an even and an odd response at one level of an input alone, as of a resonance."""
    filled = {k: np.nan_to_num(x) for k, x in seen.items()}
    top = max(float(np.abs(x).max()) for x in filled.values())
    level = {k: np.round(np.abs(x) / top * 50) for k, x in filled.items()}
    levels, rows = np.unique(np.concatenate(list(level.values())), return_counts=True)
    if len(levels) > 2:
        # One row of a channel would be matched whatever it is.
        for one in levels[1:][rows[1:] >= 2 * len(level)].tolist():
            both = {k: places[k].columns(2, partial(_at_level, at == one, filled[k])) for k, at in level.items()}
            said = f"response at |{covariate.phrase}| = {one * top / 50:.3g} {covariate.unit} alone"
            yield FormHypothesis("level", said, (covariate.name,), both)


def _at_level(here: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.stack([here, here * np.sign(values)], axis=1).astype(float)


def _thresholds(
    covariate: ResidualCovariate, seen: Mapping[int, np.ndarray], places: Mapping[int, _Place]
) -> Iterator[FormHypothesis]:
    """Yield responses that set in, or saturate, at a share of the largest input; odd and even."""
    top = max(float(np.nanmax(np.abs(x))) for x in seen.values())
    scaled = {k: np.nan_to_num(x) / top for k, x in seen.items()}
    for share in _SHARES:
        for what, odd in (("saturation", _saturating), ("onset", _beyond)):
            shape = {k: places[k].columns(2, partial(odd, x, share)) for k, x in scaled.items()}
            said = f"{what} of {covariate.phrase} at {share * top:.3g} {covariate.unit}"
            yield FormHypothesis("threshold", said, (covariate.name,), shape)


def _saturating(scaled: np.ndarray, share: float) -> np.ndarray:
    odd = np.tanh(scaled / share)
    return np.stack([odd, np.abs(odd)], axis=1)


def _beyond(scaled: np.ndarray, share: float) -> np.ndarray:
    even = np.maximum(np.abs(scaled) - share, 0.0)
    return np.stack([np.sign(scaled) * even, even], axis=1)


def _vectors(known: Sequence[ResidualCovariate], places: Mapping[int, _Place]) -> Iterator[FormHypothesis]:
    """Yield responses that are linear in a vector: in all of its components that vary."""
    for vector, said in _VECTORS.items():
        own = [each for each in known if each.name.startswith(f"{vector}_")]
        parts = [part for each in own if (part := _scaled(each, places))]
        seen = [k for k in places if all(k in part for part in parts)]
        if len(parts) > 1 and seen:
            columns = {
                k: places[k].columns(len(parts), partial(np.stack, [part[k] for part in parts], axis=1)) for k in seen
            }
            yield FormHypothesis("vector", f"linear response to the {said}", tuple(each.name for each in own), columns)


def _products(known: Sequence[ResidualCovariate], places: Mapping[int, _Place]) -> Iterator[FormHypothesis]:
    phrase = {covariate.name: covariate.phrase for covariate in known}
    scaled = {each.name: own for each in known if not each.periodic and (own := _scaled(each, places))}
    for one, other in combinations(scaled, 2):
        shapes = {}
        for k in scaled[one].keys() & scaled[other].keys():
            if _alike(scaled[one][k], scaled[other][k]):
                continue
            make = partial(_products_of, scaled[one][k], scaled[other][k])
            shapes[k] = places[k].columns(len(_POWERS) + 2, make)
        if shapes:
            yield FormHypothesis("product", f"function of {phrase[one]} and {phrase[other]}", (one, other), shapes)


def _products_of(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.stack([a**p * b**q for p, q in _POWERS] + [np.sign(a) * b, a * np.sign(b)], axis=1)


def _scaled(covariate: ResidualCovariate, places: Mapping[int, _Place]) -> dict[int, np.ndarray]:
    """Return a covariate on each channel that sees it vary, over its largest size; empty if none does."""
    seen = {k: covariate.values[place.rows.entry] for k, place in places.items()}
    seen = {k: np.nan_to_num(x) for k, x in seen.items() if _varies(x)}
    if not seen:
        return {}
    every = np.concatenate(list(seen.values()))
    centre = float(every.mean()) if covariate.relative else 0.0
    size = float(np.abs(every - centre).max()) or 1.0
    return {k: (x - centre) / size for k, x in seen.items()}


def _alike(one: np.ndarray, other: np.ndarray) -> bool:
    """Return whether two covariates are one, as the times of a run and of the campaign if there is one run."""
    a, b = one - one.mean(), other - other.mean()
    return float(a @ b) ** 2 > (1 - NEGLIGIBLE) * float(a @ a) * float(b @ b)


def _rows_before(rows: ChannelRows) -> np.ndarray:
    """Return the input of the row before, and the sign of the change since, (n, 2)."""
    found = np.zeros((len(rows.entry), 2))
    for start, length in rows.series:
        own = rows.input[start : start + length]
        found[start + 1 : start + length] = np.stack([own[:-1], np.sign(np.diff(own))], axis=1)
    return found


def _steps(places: Mapping[int, _Place], problem: LinearProblem) -> Iterator[FormHypothesis]:
    """Yield steps in a run, and from a row of a run on, of bias and of scale."""
    lengths = [(int(each.run[start]), length) for each in places.values() for start, length in each.rows.series]
    rows_of = dict(sorted(lengths))
    at = {run: range(2, rows, max(1, rows // PLACES)) for run, rows in rows_of.items()}
    for n in range(max(map(len, at.values()))):
        row_of = {run: rows[n] for run, rows in at.items() if n < len(rows)}
        yield from _steps_within_runs(places, row_of)
    every = [(run, row) for run, rows in at.items() for row in rows]
    for run, row in every[:: max(1, len(every) // _MOST_STEPS)]:
        yield from _lasting_steps(places, run, row)
    for run, row in _likely_steps(places, problem, at):
        # One of all rows of the run, and chosen by its residuals.
        share = -math.log(rows_of[run] / len(at[run]))
        found = (*_steps_within_runs(places, {run: row}), *_lasting_steps(places, run, row))
        yield from (replace(form, log_share=share) for form in found)


def _steps_within_runs(places: Mapping[int, _Place], row_of: Mapping[int, int]) -> Iterator[FormHypothesis]:
    """Yield the step within each run from a row of it on."""
    within = {k: _steps_within(place, row_of) for k, place in places.items()}
    for run, row in row_of.items():
        here = {k: steps[run] for k, steps in within.items() if run in steps}
        yield FormHypothesis("step", STEP_WITHIN, (), here, run=run, row=row)


def _likely_steps(
    places: Mapping[int, _Place], problem: LinearProblem, at: Mapping[int, range]
) -> list[tuple[int, int]]:
    """Return for long runs the rows from which on a step would explain most of a channel, as (run, row)."""
    found = [
        (int(place.run[start]), row)
        for place in places.values()
        for start, length in place.rows.series
        if at[int(place.run[start])].step > 1
        and (row := _likeliest_row(place.rows, problem, start, length)) not in at[int(place.run[start])]
    ]
    return list(dict.fromkeys(found))


def _likeliest_row(rows: ChannelRows, problem: LinearProblem, start: int, length: int) -> int:
    """Return the row of a run from which on a step lowers χ² most, beside the model's own parameters."""
    live = rows.live < problem.own
    own, residual = rows.columns[:, :-1][:, live], rows.columns[:, -1]
    information = own.T @ own + np.diag(problem.precision[rows.live[live]])
    root, here = rows.root[start : start + length], slice(start, start + length)
    along = np.cumsum((root * residual[here])[::-1])[::-1]
    shared = np.cumsum((root[:, None] * own[here])[::-1], axis=0)[::-1]
    size = np.cumsum((root**2)[::-1])[::-1] - np.sum(shared * np.linalg.solve(information, shared.T).T, axis=1)
    gain = along**2 / np.maximum(size, NEGLIGIBLE * length)
    return 2 + int(np.argmax(gain[2:-1])) if length > 4 else 2


def _lasting_steps(places: Mapping[int, _Place], run: int, row: int) -> Iterator[FormHypothesis]:
    first = {k: _first_row(place, run, row) for k, place in places.items()}
    first = {k: start for k, start in first.items() if start < len(places[k].run)}
    for name, gain in ((STEP_OF_BIAS, False), ("step of the scale factor", True)):
        shape = {k: places[k].columns(1, partial(_onward, places[k], start, gain)) for k, start in first.items()}
        yield FormHypothesis("step", name, (), shape, run=run, row=row)


def _steps_within(place: _Place, row_of: Mapping[int, int]) -> dict[int, FormColumns]:
    """Return the step from a row of each run to its end."""
    every, found = np.zeros((len(place.run), 1)), {}
    for series, (start, length) in enumerate(place.rows.series):
        run = int(place.run[start])
        if row_of.get(run, length) < length:
            every[start + row_of[run] : start + length, 0] = place.rows.root[start + row_of[run] : start + length]
            found[run] = columns_of_run(place.rows, every, series)
    return found


def _first_row(place: _Place, run: int, row: int) -> int:
    """Return where a channel is from a row of a run on."""
    start, end = np.searchsorted(place.run, [run, run + 1]).tolist()
    return min(start + row, end)


def _onward(place: _Place, first: int, gain: bool) -> np.ndarray:
    after = (np.arange(len(place.run)) >= first).astype(float)
    return (after * place.rows.input if gain else after)[:, None]
