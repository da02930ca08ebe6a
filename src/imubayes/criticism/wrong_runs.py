"""The wrong inputs of the leading explanation in the units of the record: what would make the runs agree."""

import numpy as np

from imubayes.campaign_data import Campaign
from imubayes.covariates import COVARIATES
from imubayes.criticism.disagreement_record import AgreeingInput, Disagreement
from imubayes.criticism.evidence.hypothesis import Evaluated, EvidenceOf
from imubayes.criticism.evidence.posterior_summary import ExplanationPosterior
from imubayes.responses.wrong_inputs import WrongInput
from imubayes.units import to_si


def disagreements(posterior: ExplanationPosterior, campaign: Campaign) -> tuple[Disagreement, ...]:
    """Return the run or row of a campaign as recorded that is wrong in the leading explanation; else none."""
    if posterior.leading != "input":
        return ()
    near = [(share, each, _wrong(each)) for share, each in posterior.wrong_inputs]
    _, best, first = near[0]
    same = [(share, each) for share, each, wrong in near if (wrong.run, wrong.row) == (first.run, first.row)]
    causes = {(cause.form, cause.quantity): cause for share, each in reversed(same)
              for cause in (_cause(posterior.of, campaign, each, share),)}  # fmt: skip
    others = dict.fromkeys(
        _place(campaign, wrong) for _, _, wrong in near if (wrong.run, wrong.row) != (first.run, first.row)
    )
    without = max(each.log_posterior for each in posterior.distinct if each.hypothesis.form is None)
    return (
        Disagreement(
            run=campaign.runs[first.run].name,
            row=None if first.row is None else first.row + 1,
            log_odds=float(best.log_posterior - without),
            causes=tuple(sorted(causes.values(), key=lambda each: -each.probability)),
            instead=tuple(others),
        ),
    )


def _wrong(found: Evaluated) -> WrongInput:
    form = found.hypothesis.form
    assert form is not None
    assert form.form.wrong is not None
    return form.form.wrong


def _place(campaign: Campaign, wrong: WrongInput) -> str:
    name = campaign.runs[wrong.run].name
    return name if wrong.row is None else f"row {wrong.row + 1} of run {name}"


def _cause(of: EvidenceOf, campaign: Campaign, found: Evaluated, share: float) -> AgreeingInput:
    """Return a wrong input in the unit of the record."""
    wrong, form = _wrong(found), found.hypothesis.form
    assert form is not None
    own = len(found.columns)
    size, sd = (form.form.unit * each[own:] for each in (found.mean, np.sqrt(np.diag(of.solved(found).covariance))))
    run = campaign.runs[wrong.run]
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
        # The outputs of all channels, or of one.
        channel = campaign.channels[wrong.channel or 0]
        quantity = "outputs" if wrong.channel is None else channel.name
        unit, recorded, factor = channel.output_unit, 0.0, 1.0
    return AgreeingInput(
        form=wrong.form, quantity=quantity, unit=unit, recorded=recorded,
        agreeing=tuple((recorded + size / factor).tolist()), sd=tuple((sd / abs(factor)).tolist()),
        probability=share,
    )  # fmt: skip
