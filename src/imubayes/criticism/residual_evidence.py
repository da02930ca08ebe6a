"""The evidence for a missing effect: the residual of a channel against the covariate that the effect depends on."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imubayes.campaign_data import INPUT_UNIT, Kind
from imubayes.criticism import thresholds
from imubayes.criticism.candidate_effects import Responses
from imubayes.criticism.effect_covariates import INPUTS, MEMORY
from imubayes.criticism.free_form_dependence import Structure
from imubayes.criticism.projection import PRIOR, Projection
from imubayes.criticism.residual_covariates import ResidualCovariate, as_read
from imubayes.criticism.score_test import Candidate, ProjectedResponse
from imubayes.group_means import group_means
from imubayes.units import to_si

# Degree of the polynomial that stands for any function of a covariate: it follows what a term of the catalogue may be.
_DEGREE = 5


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


def following_covariate(
    projection: Projection,
    structures: Sequence[Structure],
    candidate: Candidate,
    channel: str,
    own: frozenset[str] = frozenset(),
) -> ResidualCovariate | None:
    """Return the covariate whose free form follows what a candidate explains of a channel; None where none does.

    Parameters
    ----------
    own : covariates that the effect depends on: another one that happens to go with them is not told.  Any where they
        are not known, and of a memory, which follows the time as well.
    """
    known = own if MEMORY not in own else frozenset[str]()
    names = [each.name for each in projection.fitted.model.campaign.channels]
    of_row, strata = projection.strata.of_row, projection.strata
    here = (of_row != PRIOR) & (strata.channel[np.maximum(of_row, 0)] == names.index(channel))
    target = np.where(here, candidate.score.fitted, 0.0)
    whole = float(target @ target)
    shares = [
        (float(np.sum((structure.score.span.T @ target) ** 2)) / whole, structure.covariates[0])
        for structure in structures
        if structure.channel == channel and len(structure.covariates) == 1 and whole > 0
        if not known or structure.covariates[0].name in known
    ]
    share, covariate = max(shares, key=lambda pair: pair[0], default=(0.0, None))
    return covariate if share > thresholds.COVARIATE_SHARE else None


def residual_evidence(
    projection: Projection,
    responses: Responses,
    projected: ProjectedResponse,
    candidate: Candidate,
    channel: str,
    covariate: ResidualCovariate | None,
    known: Sequence[ResidualCovariate] = (),
) -> ResidualEvidence:
    """Return the residuals of a channel with the part that a candidate explains.

    Parameters
    ----------
    projected : the response that the candidate is made of.
    covariate : that the explained part follows, if any.
    known : covariates of the runs; without one that the explained part follows, the input times one of them may.
    """
    model = projection.fitted.model
    names = [coefficient.parameter.name for coefficient in projected.response.coefficients]
    value = np.zeros(len(names))
    for coefficient, found in zip(candidate.coefficients, candidate.value.tolist(), strict=True):
        value[names.index(coefficient.parameter.name)] = found
    # The other parameters would change when the effect is added: what they absorb is subtracted.
    absorbed = projection.absorb(projected.whitened @ value)
    explained = projected.response.columns @ value - responses.jacobian @ absorbed
    place = [each.name for each in model.campaign.channels].index(channel)
    constants = model.campaign.channels[place]
    unit = INPUT_UNIT[constants.kind]
    here = np.flatnonzero((model.entries.channel == place) & ~model.entries.closing)
    factor = 1 / (constants.scale_si * to_si(unit, model.campaign.site.gravity))
    over, place_of = None, covariate
    if covariate is None:
        response = (projected.response.columns @ value)[here]
        over = input_times(response, constants.kind, [replace(each, values=each.values[here]) for each in known])
        place_of = next((each for each in known if over is not None and each.name == over.covariate.name), None)
    runs = np.array([run.name for run in model.campaign.runs])[model.entries.run[here]]
    residual, explained = factor * responses.misfit[here], factor * explained[here]
    # What runs differ by is no residual of a model in which every run has an offset.
    within = place in projection.strata.channel[projection.strata.between] and candidate.score.within_runs > 0.5
    offsets = of_runs(residual - explained, runs) if within else np.zeros(len(here))
    return ResidualEvidence(
        channel=channel,
        effect=candidate.effect,
        covariate=covariate,
        at=as_read(projection.fitted, place_of)[here] if place_of is not None else np.arange(len(here), dtype=float),
        run=runs,
        residual=residual - offsets,
        explained=explained,
        unit=unit,
        over=over,
        within=within,
    )


def input_times(response: np.ndarray, kind: Kind, known: Sequence[ResidualCovariate]) -> InputTimes | None:
    """Return the covariate c for which a response is best input × f(c); None where there is none, or no input."""
    own = next((each for each in known if each.name == INPUTS.get(kind)), None)
    if own is None:
        return None
    recorded = [each for each in known if not each.name.startswith(("rate_", "force_"))]
    shares = [(_share(response, own.values, each.values), each) for each in recorded]
    share, covariate = max(shares, key=lambda pair: pair[0], default=(0.0, own))
    return InputTimes(covariate, own.values) if share > thresholds.COVARIATE_SHARE else None


def _share(response: np.ndarray, stimulus: np.ndarray, values: np.ndarray) -> float:
    """Return the share of the squares of a response that the input times a polynomial of a covariate gives."""
    good = np.isfinite(values) & np.isfinite(stimulus)
    whole = float(response @ response)
    if good.sum() <= 2 * _DEGREE or whole == 0 or np.ptp(values[good]) == 0:
        return 0.0
    middle, half = np.mean([values[good].min(), values[good].max()]), np.ptp(values[good]) / 2
    design = stimulus[good, None] * np.vander((values[good] - middle) / half, _DEGREE + 1)
    left = response[good] - design @ np.linalg.lstsq(design, response[good])[0]
    return (float(response[good] @ response[good]) - float(left @ left)) / whole
