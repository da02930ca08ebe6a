"""A result held against runs that it has not seen, and against another calibration of the unit."""

from collections.abc import Callable, Sequence
from pathlib import Path

from imubayes.campaign import load_campaign
from imubayes.display.progress import progress_of
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.extensions import answer_to
from imubayes.foundations.records import several
from imubayes.results.prediction import RunPrediction, broad_scales, prediction
from imubayes.results.repeatability import Repeatability, repeatability_of
from imubayes.results.result import Result, opened


def predict(
    result: Result | str | Path,
    campaign: Campaign | str | Path,
    *,
    changed: str | Sequence[str] = (),
    any_unit: bool = False,
    progress: Callable[[str], None] | None = None,
) -> RunPrediction:
    """Compare a fitted model with runs that it has not seen; only parameters of these runs alone are fitted.

    Parameters
    ----------
    result : a result, or its folder; its campaign is read again.
    campaign : runs of the same unit, or their folder; runs that were fitted are left out.
    changed : tables and mountings that have the name of one of the fit but are different equipment, such as a seat
        on which the unit was mounted anew.
    any_unit : whether the campaign may be of another unit.
    progress : called with a short text as the work goes on.

    Raises
    ------
    InputError
        for a campaign of another unit, with other channels, or without a run that was not fitted.

    Examples
    --------
    >>> import imubayes
    >>> found = imubayes.predict("results/accel-channel", "campaigns/later")
    >>> found.summary.verdict
    'as_predicted'
    """
    with progress_of(progress) as tell:
        tell("reading the fit")
        read = opened(result)
        loaded = campaign if isinstance(campaign, Campaign) else load_campaign(campaign)
        return prediction(read, loaded, several(changed), any_unit, tell)


def repeatability(
    first: Result | str | Path,
    second: Result | str | Path,
    *,
    changed: str | Sequence[str] = (),
    any_unit: bool = False,
    limits: str | Path | None = None,
    progress: Callable[[str], None] | None = None,
) -> Repeatability:
    """Compare two calibrations of one unit: whether they agree, which quantities moved, and the pooled estimates.

    Parameters
    ----------
    first, second : results, or their folders; their campaigns are read again.
    changed : tables and mountings that have the same name in both but are different equipment, such as a seat on which
        the unit was mounted anew.
    any_unit : whether they may be of two units.
    limits : a specification, as of `imubayes report`: when the next calibration is due by it.
    progress : called with a short text as the work goes on.

    Raises
    ------
    InputError
        for calibrations of two units, of the same runs, or that did not converge; if limits are stated, for runs
        without dates.

    Examples
    --------
    >>> import imubayes
    >>> imubayes.repeatability("results/accel-channel", "results/later").verdict
    'agree'
    """
    with progress_of(progress) as tell:
        one, other = opened(first), opened(second)
        scales = broad_scales(one), broad_scales(other)
        found = repeatability_of(one.fit, other.fit, scales, several(changed), any_unit, tell)
        if limits is None:
            return found
        return found.model_copy(update={"due": answer_to("repeatability.limits")(found, other, Path(limits))})
