"""The runs that do not agree with the others as records of a diagnosis, held against the effects of the catalogue.

An effect acts in all runs alike.  Where it explains as much, with no more parameters, as what would be wrong in the
record of one run, it goes before: most diagnoses are of models that still lack something, and few of campaigns with a
mistake in them.
"""

import math
from collections.abc import Sequence

import numpy as np

from imubayes.campaign_data import Campaign
from imubayes.covariates import COVARIATES
from imubayes.criticism import thresholds
from imubayes.criticism.candidate_effects import Response, Responses
from imubayes.criticism.deletion_diagnostics import LinearFit, divide, linear_fit
from imubayes.criticism.disagreement_record import AgreeingInput, Disagreement, RivalOfInput
from imubayes.criticism.run_agreement import (
    Disagreeing,
    InputExplanation,
    agreement_of_runs,
    known_before,
    most_that_runs_explain,
)
from imubayes.inference.fitted_model import Fit
from imubayes.units import to_si

# Width of the prior of a coefficient over its largest typical size.
_WIDTH = 10.0
_NEAR = thresholds.DISAGREEMENT_EQUAL / 2


def disagreements(fitted: Fit, responses: Responses, named: Sequence[str]) -> tuple[Disagreement, ...]:
    """Return the runs and rows that do not agree with the others, with the effects that explain the same.

    Parameters
    ----------
    responses : to the effects that the model lacks.
    named : the effects that the search found missing together.
    """
    h = known_before(fitted)
    linear = linear_fit(fitted.model, fitted.model.problem, fitted.z, h)
    most = most_that_runs_explain(fitted, linear)
    if most is None:
        return ()
    gains = _gains(fitted, linear, h, responses, named)
    if max(gains.values(), default=-math.inf) >= most:
        return ()
    agreement = agreement_of_runs(fitted, linear, h)
    told = [each for each in agreement.found if not _is_noise(each)]
    if not told or not agreement.agree:
        return ()
    needed = linear.chi2 - agreement.corrected - agreement.cost
    odds = {effects: (gain - needed) / 2 for effects, gain in gains.items()}
    near = [RivalOfInput(effects=effects, log_odds=each) for effects, each in odds.items() if each > -_NEAR]
    rivals = tuple(sorted(near, key=lambda each: -each.log_odds))
    return tuple(_record(fitted.model.campaign, each, rivals) for each in told)


def _is_noise(found: Disagreeing) -> bool:
    """Whether no input makes the outputs so, but noise: an offset of a run, or a row off in one channel alone.

    These are told as scatter between runs beyond its prior, and as an outlier.
    """
    best = found.best
    if best.wrong.form != "output_offset":
        return False
    return best.wrong.row is None or int(np.sum(np.abs(best.size) > thresholds.OUTLIER_SD * best.sd)) < 2


def _gains(
    fitted: Fit, linear: LinearFit, h: np.ndarray, responses: Responses, named: Sequence[str]
) -> dict[tuple[str, ...], float]:
    """Return twice the log evidence, roughly, of effects alone and of those named together (Schwarz's criterion)."""
    model = fitted.model
    first = {each.scan.effect: each for each in reversed(responses.candidates)}
    cost, looks = math.log(len(linear.misfit)), 2 * math.log(max(len(first), 1))
    found: dict[tuple[str, ...], float] = {}
    together = [first[name] for name in dict.fromkeys(named) if name in first]
    for members in (*([each] for each in responses.candidates), *([together] if len(together) > 1 else [])):
        columns = np.concatenate([each.columns for each in members], axis=1)
        divided = divide(model.problem, h, columns)
        score = linear.score(columns, divided, np.concatenate([_ties(each) for each in members]))
        names = tuple(each.scan.effect for each in members)
        found[names] = max(score.drop - score.freedom * cost - looks, found.get(names, -math.inf))
    return found


def _ties(response: Response) -> np.ndarray:
    """Return the precision of the prior of each coefficient, in the unit of its response."""
    return np.array([(_WIDTH * each.typical[1]) ** -2.0 for each in response.coefficients])


def _record(campaign: Campaign, found: Disagreeing, rivals: tuple[RivalOfInput, ...]) -> Disagreement:
    wrong = found.best.wrong
    names = dict.fromkeys(_place(campaign, each) for each in found.others)
    return Disagreement(
        run=campaign.runs[wrong.run].name,
        row=None if wrong.row is None else wrong.row + 1,
        chi2=found.chi2,
        dof=found.dof,
        p=math.exp(max(found.best.log_p, -700.0)),
        causes=tuple(_cause(campaign, each) for each in found.equal),
        instead=tuple(names),
        rivals=rivals,
    )


def _place(campaign: Campaign, each: InputExplanation) -> str:
    name = campaign.runs[each.wrong.run].name
    return name if each.wrong.row is None else f"row {each.wrong.row + 1} of run {name}"


def _cause(campaign: Campaign, found: InputExplanation) -> AgreeingInput:
    """Return an explanation in the unit of the record."""
    wrong, run = found.wrong, campaign.runs[found.wrong.run]
    recorded: float | None = None
    if wrong.form.endswith("factor"):
        quantity = COVARIATES[wrong.covariate].column if wrong.covariate else "outputs"
        unit, recorded, factor = "1", 1.0, 1.0
    elif wrong.form == "seat":
        quantity, unit, recorded, factor = "mounting", "arcmin", 0.0, to_si("arcmin")
    elif wrong.covariate:
        column = COVARIATES[wrong.covariate]
        values = campaign.as_read(run, wrong.covariate)
        quantity, unit, factor = column.column, column.unit, column.factor(campaign.site.gravity)
        recorded = float(np.nanmean(values) if wrong.row is None else values[wrong.row]) / factor
    else:
        quantity, unit, recorded, factor = "outputs", campaign.channels[0].output_unit, 0.0, 1.0
    return AgreeingInput(
        form=wrong.form, quantity=quantity, unit=unit, recorded=recorded,
        agreeing=tuple((recorded + found.size / factor).tolist()), sd=tuple((found.sd / factor).tolist()),
        delta_chi2=found.drop,
    )  # fmt: skip
