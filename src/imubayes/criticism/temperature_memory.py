"""Whether the data tell how an effect remembers the temperature: by a lag, by play, or by its rate.

A thermal lag and a thermal hysteresis of the same bias differ by what follows a turn of the temperature and by nothing
else; on ramps of one rate, and where the temperature hardly changes, each imitates the other.  A finding of one kind is
therefore compared with the other kind at several shapes, whether or not the catalogue has it: both follow the recorded
temperatures from row to row, along straight lines between them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.covariates import COVARIATES
from imubayes.criticism import thresholds
from imubayes.criticism.candidate_effects import Response, ShapeScan
from imubayes.criticism.effect_covariates import INPUTS, covariates_of
from imubayes.criticism.equivalent_effects import EquivalenceGroup, indistinguishable, unexplained_chi2
from imubayes.criticism.residual_covariates import ResidualCovariate
from imubayes.criticism.score_test import assess, project_responses
from imubayes.criticism.stepwise_search import SearchResult
from imubayes.effects.base import Effect
from imubayes.effects.shared_formulas import TemperatureLag, TemperaturePlay
from imubayes.inference.fitted_model import Fit

LAG, PLAY, RATE = "lag", "play", "rate"
_SHAPES = {LAG: "tau", PLAY: "play", RATE: ""}
_TEMPERATURES = ("temperature", "converter_temperature")
_RATES = {f"{name}_rate": name for name in _TEMPERATURES}
_MINUTE = 60.0


@dataclass(frozen=True)
class Course:
    """A temperature of one run over its rows, and their times in s, both (rows,)."""

    temperature: np.ndarray
    time: np.ndarray

    def lag(self, tau: float) -> np.ndarray:
        """Return the lagged less the true temperature for a time constant in s; exact along straight lines."""
        behind = np.zeros(len(self.time))
        steps, changes = np.diff(self.time), np.diff(self.temperature)
        for row, (step, change) in enumerate(zip(steps.tolist(), changes.tolist(), strict=True)):
            fade = np.exp(-step / tau)
            behind[row + 1] = behind[row] * fade - change * tau / step * (1 - fade)
        return behind

    def play(self, width: float) -> np.ndarray:
        """Return the place within a play of ±width that the temperature drags along, −1 … 1; 0 at first."""
        place = np.zeros(len(self.time))
        for row, change in enumerate(np.diff(self.temperature).tolist()):
            place[row + 1] = np.clip(place[row] + change / width, -1.0, 1.0)
        return place

    def memory(self, kind: str, shape: float) -> np.ndarray:
        """Return the lag of a time constant in min, the play of a width in °C, or the rate of change."""
        if kind == RATE:
            return np.gradient(self.temperature, self.time)
        return self.lag(_MINUTE * shape) if kind == LAG else self.play(shape)


def kind_of_memory(member: type) -> str:
    """Return how an effect remembers a temperature: `LAG`, `PLAY`, as a very short lag by its `RATE`, or nothing."""
    if not issubclass(member, Effect):
        return ""
    if issubclass(member, TemperatureLag):
        return LAG
    return PLAY if issubclass(member, TemperaturePlay) else RATE if set(member.needs) & set(_RATES) else ""


def other_memory(found: SearchResult, group: EquivalenceGroup) -> ResidualCovariate | None:
    """Return the temperature that the leader of a group remembers, where another memory of it fits as well.

    That is another kind, or the same one added to the signal in place of multiplying it, or the reverse.  None where
    the leader has no memory, where the others are in the group, or where the data tell them apart.
    """
    at, leader = found.first.projection, group.leader
    effects = at.fitted.model.registry.effects
    own, known = kind_of_memory(effects[leader.effect]), {kind_of_memory(effects[name]) for name in group.effects}
    if not own:
        return None
    name = next(_RATES.get(need, need) for need in effects[leader.effect].needs if need in (*_TEMPERATURES, *_RATES))
    columns = _columns(found, group)
    # An effect is gated off in a run whose temperature hardly changes, and so is its rival.
    acting = set(at.fitted.model.entries.run[np.any(columns, axis=1)].tolist())
    courses = {place: course for place, course in _courses(at.fitted, name).items() if place in acting}
    by_input = (np.ones(len(columns)), at.input)
    others = {} if {LAG, PLAY} <= known else _others(courses, known)
    rivals = [(_factor(found, group, courses, own, by_input), kind, shapes) for kind, shapes in others.items()]
    shapes = [leader.scan.shape.get(_SHAPES[own], 0.0)]
    rivals += [(_factor(found, group, courses, own, (by,)), own, shapes) for by in _other_multiplier(found, group)]
    if any(_fits_as_well(found, group, courses, *rival) for rival in rivals):
        return next(each for each in found.covariates if each.name == COVARIATES[name].column)
    return None


def _other_multiplier(found: SearchResult, group: EquivalenceGroup) -> list[np.ndarray]:
    """Return one where all effects of a group multiply the signal, the input, (E,), where none does, or nothing."""
    at = found.first.projection
    model = at.fitted.model
    kinds = {channel.kind for channel in model.campaign.channels if channel.name in group.leader.owners}
    pairs = [(model.registry.effects[name], kind) for name in group.effects for kind in kinds]
    multiplies = {INPUTS[kind] in each for member, kind in pairs for each in covariates_of(member, kind)}
    if multiplies == {True}:
        return [np.ones_like(at.input)]
    return [at.input] if multiplies == {False} and may_scale(found, group) else []


def may_scale(found: SearchResult, group: EquivalenceGroup) -> bool:
    """Tell whether what the leader of a group adds might be a change of the scale factor, by its size."""
    at, leader = found.first.projection, group.leader
    campaign, entries = at.fitted.model.campaign, at.fitted.model.entries
    scales = np.array([channel.scale_si for channel in campaign.channels] + [np.inf] * 3)
    names = [channel.name for channel in campaign.channels]
    here = np.isin(entries.channel, [names.index(owner) for owner in leader.owners if owner in names])
    added = _columns(found, group) @ leader.value / scales[entries.channel]
    largest = np.abs(at.input[here]).max(initial=0.0)
    return bool(np.abs(added[here]).max(initial=0.0) < thresholds.SCALE_CHANGE_MAX * largest)


def _others(courses: dict[int, Course], known: set[str]) -> dict[str, list[float]]:
    """Return several shapes of each kind of memory but the known ones."""
    span = max((float(np.ptp(course.temperature)) for course in courses.values()), default=0.0)
    widths = [share * span for share in thresholds.PLAY_SHARES] if span > 0 else []
    shapes = {LAG: list(thresholds.TIME_CONSTANTS_MIN), PLAY: widths}
    return {kind: values for kind, values in shapes.items() if kind not in known}


def _fits_as_well(
    found: SearchResult,
    group: EquivalenceGroup,
    courses: dict[int, Course],
    factor: np.ndarray,
    kind: str,
    shapes: list[float],
) -> bool:
    """Tell whether the data do not distinguish a kind of memory from the leader, at some shape."""
    at, leader = found.first.projection, group.leader
    step = thresholds.MEMORY_STEP
    for _ in range(1 + thresholds.MEMORY_ROUNDS):
        responses = [
            Response(ShapeScan(kind, {_SHAPES[kind]: shape}), leader.coefficients,
                     factor * _memory(at.fitted, courses, kind, shape))
            for shape in shapes
        ]  # fmt: skip
        rivals = [assess(at, each, np.arange(len(leader.coefficients))) for each in project_responses(at, responses)]
        rivals = [rival for rival in rivals if rival.dof]
        if not rivals or any(indistinguishable(at, leader, rival) for rival in rivals):
            return bool(rivals)
        best = min(rivals, key=lambda rival: unexplained_chi2(at, leader, rival)[0]).scan.shape[_SHAPES[kind]]
        shapes, step = [best / step, best, best * step], step**0.5
    return False


def _factor(
    found: SearchResult,
    group: EquivalenceGroup,
    courses: dict[int, Course],
    own: str,
    multipliers: Sequence[np.ndarray],
) -> np.ndarray:
    """Return what multiplies the memory in the response to the leader, (E, C), by channel: the best of some (E,)."""
    at, leader, columns = found.first.projection, group.leader, _columns(found, group)
    memory = _memory(at.fitted, courses, own, leader.scan.shape.get(_SHAPES[own], 0.0))
    places = {channel.name: place for place, channel in enumerate(at.fitted.model.campaign.channels)}
    entries = at.fitted.model.entries
    here = np.stack([entries.channel == places[each.owner] for each in leader.coefficients], axis=1)
    best, least = columns, np.inf
    for multiplier in multipliers:
        plain = here * multiplier[:, None] * memory
        size = np.sum(plain * columns, axis=0) / np.maximum(np.sum(plain**2, axis=0), 1e-300)
        left = float(np.sum((columns - plain * size) ** 2))
        if left < least:
            best, least = here * multiplier[:, None] * size, left
    return best


def _columns(found: SearchResult, group: EquivalenceGroup) -> np.ndarray:
    """Return the response to the leader of a group, (E, C)."""
    leader = group.leader
    response = next(each.response for each in found.first.prepared if each.response.scan == leader.scan)
    names = [coefficient.parameter.name for coefficient in response.coefficients]
    return response.columns[:, [names.index(each.parameter.name) for each in leader.coefficients]]


def _courses(fitted: Fit, name: str) -> dict[int, Course]:
    """Return the course of a temperature in each run that has it at known times, by the place of the run."""
    found = {}
    for place, run in enumerate(fitted.model.campaign.runs):
        time, values = run.covariates.get("time"), run.covariates.get(name)
        if time is None or values is None or len(time) < 2:
            continue
        if np.all(np.isfinite(values)) and np.all(np.diff(time) > 0):
            found[place] = Course(values, time)
    return found


def _memory(fitted: Fit, courses: dict[int, Course], kind: str, shape: float) -> np.ndarray:
    """Return the memory of every entry, (E, 1); 0 in a run without the temperature."""
    entries = fitted.model.entries
    values = np.zeros((len(entries), 1))
    for place, course in courses.items():
        here = (entries.run == place) & ~entries.closing
        values[here, 0] = course.memory(kind, shape)[entries.row[here]]
    return values
