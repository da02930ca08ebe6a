"""The residual that shows a missing effect: one channel against the covariate that the effect depends on."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imubayes.campaign_data import INPUT_UNIT, Kind
from imubayes.criticism.detectability import AbsorbedResponses
from imubayes.criticism.evidence.free_forms import HIGHEST_POWER
from imubayes.criticism.evidence.posterior_summary import ExplanationPosterior, SlotMember
from imubayes.group_means import group_means
from imubayes.responses.candidate_effects import Responses
from imubayes.responses.effect_covariates import INPUTS, MEMORY, covariates_of
from imubayes.responses.residual_covariates import ResidualCovariate, as_read
from imubayes.units import to_si

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
    covariate : the covariate that the explained part follows; None where no single one does.
    at : shape (n,), values of the covariate, or of `over`'s; the number of the entry where there is neither.
    run : shape (n,), name of the run of each entry.
    residual, explained : shape (n,), in `unit`.
    unit : nominal input unit, deg/s or g, of the angle of a driven table deg.
    over : where the response is the input times a function of a covariate.
    within : whether `residual` is without the offset that each run has beside the explained part: where the model has
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
    place = _dominant_channel(posterior, parts, of.variants[member.variant].owners)
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
    within = bool(of.problem.rows[place].run_scatter) and _lies_within(explained, runs)
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


def _dominant_channel(posterior: ExplanationPosterior, explained: np.ndarray, owners: Sequence[str]) -> int:
    """Return the channel in which a response, (E,), stands out of the noise most: one that the effect acts on."""
    problem = posterior.of.problem
    squares = np.array([np.sum((problem.root[rows.entry] * explained[rows.entry]) ** 2) for rows in problem.rows])
    own = np.array([channel.name in owners for channel in problem.channels])
    return int(np.argmax(np.where(own | ~own.any(), squares, -1.0)))


def _lies_within(explained: np.ndarray, runs: np.ndarray) -> bool:
    """Whether most of what is explained lies within runs."""
    inside = explained - of_runs(explained, runs)
    return float(inside @ inside) > 0.5 * float(explained @ explained)


def _following(
    effect: str, member: type, kind: Kind, response: np.ndarray, known: Sequence[ResidualCovariate]
) -> ResidualCovariate | None:
    """Return the covariate that a response follows alone: one that the effect depends on; None where none does.

    Any where these are not known, and of a memory, which follows the time as well.
    """
    own = frozenset[str]().union(*covariates_of(member, kind))
    free = not own or MEMORY in own
    shares = [(_share(response, np.ones(len(response)), each.values), each) for each in known
              if free or each.name in own]  # fmt: skip
    share, covariate = max(shares, key=lambda pair: pair[0], default=(0.0, None))
    return covariate if share > COVARIATE_SHARE else None


def input_times(response: np.ndarray, kind: Kind, known: Sequence[ResidualCovariate]) -> InputTimes | None:
    """Return the covariate c for which a response is best input × f(c); None where there is none, or no input."""
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
