"""The picture of a finding: the residual of a channel against what the missing effect depends on."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.criticism import thresholds
from imubayes.criticism.candidate_effects import Responses
from imubayes.criticism.lack_of_fit import Structure
from imubayes.criticism.projection import PRIOR, Projection
from imubayes.criticism.residual_covariates import ResidualCovariate
from imubayes.criticism.score_test import Candidate, ProjectedResponse


@dataclass(frozen=True)
class Telling:
    """Residuals of one channel with what a candidate explains of them (n entries).

    Attributes
    ----------
    channel : name.
    covariate : the covariate it depends on; None where no single one tells.
    at : shape (n,), values of the covariate; of what it explains where there is none.
    run : shape (n,), name of the run of each entry.
    residual, explained : shape (n,), in nominal input units: deg/s or g.
    unit : of the two.
    """

    channel: str
    covariate: ResidualCovariate | None
    at: np.ndarray
    run: np.ndarray
    residual: np.ndarray
    explained: np.ndarray
    unit: str

    @property
    def rms(self) -> dict[str, str | float]:
        """The residual of the channel before and after the candidate is added, rms, in deg/h or ug."""
        factor, unit = (3600.0, "deg/h") if self.unit == "deg/s" else (1e6, "ug")
        before, after = (
            factor * float(np.sqrt(np.mean(rest**2))) for rest in (self.residual, self.residual - self.explained)
        )
        return {"channel": self.channel, "before": before, "after": after, "unit": unit}


def telling_covariate(
    projection: Projection, structures: Sequence[Structure], candidate: Candidate, channel: str
) -> ResidualCovariate | None:
    """Return the covariate whose free form follows what a candidate explains of a channel; None where none does."""
    names = [one.name for one in projection.fitted.model.campaign.channels]
    of_row, strata = projection.strata.of_row, projection.strata
    here = (of_row != PRIOR) & (strata.channel[np.maximum(of_row, 0)] == names.index(channel))
    target = np.where(here, candidate.score.fitted, 0.0)
    whole = float(target @ target)
    shares = [
        (float(np.sum((one.score.span.T @ target) ** 2)) / whole, one.covariates[0])
        for one in structures
        if one.channel == channel and len(one.covariates) == 1 and whole > 0
    ]
    share, covariate = max(shares, key=lambda pair: pair[0], default=(0.0, None))
    return covariate if share > thresholds.COVARIATE_SHARE else None


def tell(
    projection: Projection,
    responses: Responses,
    one: ProjectedResponse,
    candidate: Candidate,
    channel: str,
    covariate: ResidualCovariate | None,
) -> Telling:
    """Return the residuals of a channel with what a candidate explains of them.

    Parameters
    ----------
    one : the response that the candidate is made of.
    """
    model = projection.fitted.model
    names = [coefficient.parameter.name for coefficient in one.response.coefficients]
    value = np.zeros(len(names))
    for coefficient, found in zip(candidate.coefficients, candidate.value.tolist(), strict=True):
        value[names.index(coefficient.parameter.name)] = found
    # The other parameters would move when the effect is added: what they would take up is taken off.
    moved = projection.absorb(one.whitened @ value)
    explained = one.response.columns @ value - responses.jacobian @ moved
    place = [each.name for each in model.campaign.channels].index(channel)
    constants = model.campaign.channels[place]
    unit, size = ("deg/s", np.pi / 180) if constants.kind == "gyro" else ("g", model.campaign.site.gravity)
    here = np.flatnonzero((model.entries.channel == place) & ~model.entries.closing)
    factor = 1 / (constants.scale_si * size)
    runs = np.array([run.name for run in model.campaign.runs])
    return Telling(
        channel=channel,
        covariate=covariate,
        at=covariate.values[here] if covariate is not None else explained[here] * factor,
        run=runs[model.entries.run[here]],
        residual=responses.misfit[here] * factor,
        explained=explained[here] * factor,
        unit=unit,
    )
