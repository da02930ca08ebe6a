"""Residual evidence: one channel against the covariate that a missing effect depends on, and outlying rows.

An outlier is a row that the leading explanation predicts wrongly beyond chance.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np

from imubayes.criticism.detectability import AbsorbedResponses
from imubayes.criticism.evidence.free_forms import HIGHEST_POWER
from imubayes.criticism.evidence.linear_problem import ChannelRows
from imubayes.criticism.evidence.posterior_summary import ExplanationPosterior, SlotMember
from imubayes.criticism.evidence.proposals import base_columns
from imubayes.foundations.campaign_data import INPUT_UNIT, Kind
from imubayes.foundations.covariates import COVARIATES, INPUTS
from imubayes.foundations.numerics import group_means
from imubayes.foundations.records import Record
from imubayes.foundations.units import to_si
from imubayes.model.bind import Model
from imubayes.responses.candidate_effects import Responses
from imubayes.responses.residual_covariates import MEMORY, ResidualCovariate, as_read, covariates_of

COVARIATE_SHARE = 0.9
"""Share of the squares of what an effect explains that a polynomial of a covariate gives, to be said to follow it."""


@dataclass(frozen=True)
class InputTimes:
    """A covariate c with the response input × f(c).

    Attributes
    ----------
    covariate : c.
    input : shape (n,), along the input axis, in the unit of the residuals.
    """

    covariate: ResidualCovariate
    input: np.ndarray


@dataclass(frozen=True)
class ResidualEvidence:
    """Residuals of one channel with the part that a candidate explains (n entries).

    Attributes
    ----------
    channel, effect : names of the channel and of the candidate.
    covariate : the covariate that the explained part follows; None if no single one does.
    at : shape (n,), values of the covariate, or of `over`'s; the number of the entry if there is neither.
    run : shape (n,), name of the run of each entry.
    residual, explained : shape (n,), in `unit`.
    unit : nominal input unit, deg/s or g, of the angle of a driven table deg.
    over : if the response is the input times a function of a covariate.
    within : whether `residual` is without the offset that each run has beside the explained part: if the model has
        such offsets and the evidence lies within runs.
    """

    channel: str
    effect: str
    covariate: ResidualCovariate | None
    at: np.ndarray
    run: np.ndarray
    residual: np.ndarray
    explained: np.ndarray
    unit: str
    over: "InputTimes | None" = None
    within: bool = False


def of_runs(values: np.ndarray, runs: np.ndarray) -> np.ndarray:
    """Return the mean of the finite values of its run at each entry, (n,)."""
    return group_means(values, np.unique(runs, return_inverse=True)[1])


def residual_evidence(
    posterior: ExplanationPosterior,
    absorbed: AbsorbedResponses,
    responses: Responses,
    member: SlotMember,
    known: Sequence[ResidualCovariate] = (),
) -> ResidualEvidence:
    """Return the residuals of the channel that shows an effect best, with the part that the effect explains.

    Parameters
    ----------
    responses : of the fit.
    known : covariates of the runs.
    """
    fitted = absorbed.fitted
    model, of = fitted.model, posterior.of
    response, sizes = posterior.response_to(member, responses)
    columns = response @ sizes
    # The other parameters would change when the effect is added: what they absorb is subtracted.
    parts = columns - responses.jacobian @ absorbed.explained(member.found, of.variants[member.variant].places)
    rows = _dominant_rows(posterior, parts, of.variants[member.variant].owners)
    if rows.kind == "closure":
        return _of_turns(rows, member.effect, model, responses.misfit, parts)
    place = [each.name for each in model.campaign.channels].index(rows.name)
    constants = model.campaign.channels[place]
    unit = INPUT_UNIT[constants.kind]
    here = np.flatnonzero((model.entries.channel == place) & ~model.entries.closing)
    factor = 1 / (constants.scale_si * to_si(unit, model.campaign.site.gravity))
    near = [replace(each, values=each.values[here]) for each in known]
    follows = _following(member.effect, model.registry.effects[member.effect], constants.kind, columns[here], near)
    over = None if follows is not None else input_times(columns[here], constants.kind, near)
    shown = follows or (over.covariate if over is not None else None)
    covariate = next((each for each in known if shown is not None and each.name == shown.name), None)
    runs = np.array([run.name for run in model.campaign.runs])[model.entries.run[here]]
    residual, explained = factor * responses.misfit[here], factor * parts[here]
    # What runs differ by is no residual of a model in which every run has an offset.
    within = bool(rows.run_scatter) and _lies_within(explained, runs)
    offsets = of_runs(residual - explained, runs) if within else np.zeros(len(here))
    return ResidualEvidence(
        channel=constants.name,
        effect=member.effect,
        covariate=covariate if follows is not None else None,
        at=as_read(fitted, covariate)[here] if covariate is not None else np.arange(len(here), dtype=float),
        run=runs,
        residual=residual - offsets,
        explained=explained,
        unit=unit,
        over=over,
        within=within,
    )


def _dominant_rows(posterior: ExplanationPosterior, explained: np.ndarray, owners: Sequence[str]) -> ChannelRows:
    """Return where a response, (E,), stands out of the noise most: in a channel that the effect acts on, or in turns.

    An effect on gyros acts in turns.
    """
    problem = posterior.of.problem
    own = {rows.name: rows.kind for rows in problem.of_channels if rows.name in owners}
    turns = not own or "gyro" in own.values()
    allowed = [rows for rows in problem.rows if (turns if rows.kind == "closure" else not own or rows.name in own)]
    return max(allowed, key=lambda rows: float(np.sum((problem.root[rows.entry] * explained[rows.entry]) ** 2)))


def _of_turns(
    rows: ChannelRows, effect: str, model: Model, misfit: np.ndarray, explained: np.ndarray
) -> ResidualEvidence:
    """Return the closing rotations of a run with the part that an effect explains."""
    entry, factor = rows.entry, 1 / to_si("deg")
    return ResidualEvidence(
        channel=rows.name, effect=effect, covariate=None, at=np.arange(len(entry), dtype=float),
        run=np.full(len(entry), model.campaign.runs[model.entries.run[entry[0]]].name),
        residual=factor * misfit[entry], explained=factor * explained[entry], unit="deg",
    )  # fmt: skip


def _lies_within(explained: np.ndarray, runs: np.ndarray) -> bool:
    """Whether most of what is explained lies within runs."""
    inside = explained - of_runs(explained, runs)
    return float(inside @ inside) > 0.5 * float(explained @ explained)


def _following(
    effect: str, member: type, kind: Kind, response: np.ndarray, known: Sequence[ResidualCovariate]
) -> ResidualCovariate | None:
    """Return the covariate that a response follows alone: one that the effect depends on; None if none does.

    Any if these are not known, and of a memory, which follows the time as well.
    """
    own = frozenset[str]().union(*covariates_of(member, kind))
    free = not own or MEMORY in own
    shares = [(_share(response, np.ones(len(response)), each.values), each) for each in known
              if free or each.name in own]  # fmt: skip
    share, covariate = max(shares, key=lambda pair: pair[0], default=(0.0, None))
    return covariate if share > COVARIATE_SHARE else None


def input_times(response: np.ndarray, kind: Kind, known: Sequence[ResidualCovariate]) -> InputTimes | None:
    """Return the covariate c for which a response is best input × f(c); None if there is none, or no input."""
    own = next((each for each in known if each.name == INPUTS.get(kind)), None)
    if own is None:
        return None
    recorded = [each for each in known if not each.name.startswith(("rate_", "force_"))]
    shares = [(_share(response, own.values, each.values), each) for each in recorded]
    share, covariate = max(shares, key=lambda pair: pair[0], default=(0.0, own))
    return InputTimes(covariate, own.values) if share > COVARIATE_SHARE else None


def _share(response: np.ndarray, stimulus: np.ndarray, values: np.ndarray) -> float:
    """Return the share of the squares of a response that the input times a polynomial of a covariate gives."""
    good = np.isfinite(values) & np.isfinite(stimulus)
    whole = float(response @ response)
    if good.sum() <= 2 * HIGHEST_POWER or whole == 0 or np.ptp(values[good]) == 0:
        return 0.0
    middle, half = np.mean([values[good].min(), values[good].max()]), np.ptp(values[good]) / 2
    design = stimulus[good, None] * np.vander((values[good] - middle) / half, HIGHEST_POWER + 1)
    left = response[good] - design @ np.linalg.lstsq(design, response[good])[0]
    return (float(response[good] @ response[good]) - float(left @ left)) / whole


_CHANCE = 0.01
"""Probability that any row of a campaign is reported by chance (convention)."""


class Outlier(Record):
    """An outlying sample, or turn of a free tumble.

    Attributes
    ----------
    channel : of a turn, the component of its closing rotation, such as `closure_x`.
    row : counts from 1; of a raw log, the rows are its means.
    distance : deletion residual in standard deviations.
    time_s, table_angle_deg : of the row, as recorded; None if it has none.
    """

    run: str
    channel: str
    row: int
    distance: float
    time_s: float | None = None
    table_angle_deg: float | None = None


def outliers(posterior: ExplanationPosterior) -> tuple[Outlier, ...]:
    """Return the outlying rows beside the leading explanation, the farthest first.

    The deletion residual of a row is its residual over √(1 − leverage), in standard deviations of the noise of the
    explanation (Cook and Weisberg, 1982).
    """
    of, model = posterior.of, posterior.fitted.model
    least = -NormalDist().inv_cdf(0.5 * _CHANCE / max(of.problem.outputs, 1))
    found = [
        _outlier(model, int(of.problem.rows[k].entry[place]), float(distance[place]))
        for k in of.unit_of
        for distance in (_distances(posterior, k),)
        for place in np.flatnonzero(np.abs(distance) > least)
    ]
    return tuple(sorted(found, key=lambda each: -abs(each.distance)))


def _distances(posterior: ExplanationPosterior, channel: int) -> np.ndarray:
    """Return the deletion residual of each row of a channel, (n,)."""
    of, top = posterior.of, posterior.top
    where = of.taking_part(channel, top.columns, top.hypothesis.form)
    white = base_columns(of, top, channel) / top.scale[channel]
    weight = top.weight.get(channel)
    columns = white[:, :-1]
    covariance = of.solved(top).covariance[np.ix_(where, where)]
    leverage = np.sum((columns @ covariance) * columns, axis=1)
    residual = white[:, -1] - columns @ top.mean[where]
    if weight is not None:
        residual = residual / np.sqrt(weight)
    return residual / np.sqrt(np.maximum(1 - leverage, np.finfo(float).eps))


def _outlier(model: Model, entry: int, distance: float) -> Outlier:
    entries = model.entries
    return Outlier(
        run=model.campaign.runs[entries.run[entry]].name,
        channel=str(model.output_names[entries.channel[entry]]),
        row=int(entries.row[entry]) + 1,
        distance=distance,
        time_s=_read(model, "time", entry),
        table_angle_deg=_read(model, "table_angle", entry),
    )


def _read(model: Model, covariate: str, entry: int) -> float | None:
    """Return what the row of an entry recorded of a covariate, in the unit of its column; None if nothing."""
    run = model.campaign.runs[model.entries.run[entry]]
    if covariate not in run.covariates or model.entries.closing[entry]:
        return None
    value = model.campaign.as_read(run, covariate)[model.entries.row[entry]]
    known = np.isfinite(value) and (run.table is not None or not covariate.startswith("table_"))
    return float(value) / COVARIATES[covariate].factor() if known else None
