"""The grade that the errors of a unit show: biases, scale factors and misalignments of all its channels.

The grade chooses the default priors.  The noise of raw samples determines it as a rule.  If an output filter hides that
noise, or if means state none, the default priors of too fine a grade would confine the errors of a consumer unit.

Under the priors of a grade the posterior mean m of a parameter, with posterior variance c and prior variance w, has the
prior predictive variance w − c.  A grade is contradicted if the distance |m|/√(w − c) of one parameter is improbable,
or if the sum of squares over the channels of an effect is.
"""

from dataclasses import dataclass, replace

import numpy as np

from imubayes.campaign.unit_grade import LEAST_NOISE, grade_of
from imubayes.foundations.campaign_data import GRADES, Campaign, Grade
from imubayes.foundations.tail_probabilities import chi2_survival, normal_survival
from imubayes.inference.linear_information import TOLD, likely_scales, linear_information
from imubayes.model.bind import Model, bind
from imubayes.model.model_file import ModelSpec
from imubayes_recordings.convert.proposed_effects import SENSORS, EffectProposal

_IMPROBABLE = 1e-3
"""Probability, over all parameters or effects, of a distance at which a grade counts as contradicted (convention)."""


@dataclass(frozen=True)
class ShownGrade:
    """A grade that the errors of a unit show.

    Attributes
    ----------
    grade : the finest whose default priors the errors do not contradict.
    by_noise : the finest grade that the noise of the channels shows.
    parameter : farthest from its default prior under `by_noise`.
    distance : of it, in standard deviations.
    """

    grade: Grade
    by_noise: Grade
    parameter: str
    distance: float


@dataclass(frozen=True)
class _Distances:
    """Parameters of sensors that the data determine, and their distances from the middle of their priors."""

    names: tuple[str, ...]
    effects: np.ndarray
    size: np.ndarray

    @property
    def contradict(self) -> bool:
        single = 2 * normal_survival(self.size) * len(self.size)
        groups = [self.size[self.effects == name] for name in set(self.effects)]
        joint = [float(chi2_survival(group @ group, len(group))) * len(groups) for group in groups]
        return bool(min((*single, *joint), default=1.0) < _IMPROBABLE)


def shown_grade(campaign: Campaign, proposal: EffectProposal) -> ShownGrade | None:
    """Return the finest grade that the errors of a unit allow; None if that by noise is, or if one is stated.

    One axis with a large error widens the default priors of all axes.

    Parameters
    ----------
    proposal : the effects of a model for the campaign, which is linear about nominal sensors.
    """
    if campaign.grade is not None:
        return None
    finest = max(GRADES.index(grade_of(campaign, kind)) for kind in LEAST_NOISE if campaign.of_kind(kind))
    by_noise, coarser = GRADES[finest], GRADES[:finest]
    if not coarser:
        return None
    spec = ModelSpec(campaign.name, tuple(each.spec for each in proposal.effects))
    grade: Grade = coarser[0]
    # Under the widest priors the noise scales do not make up for errors that the priors forbid.
    wide = _graded(spec, campaign, grade)
    h = likely_scales(wide)
    plain = _distances(bind(spec, campaign), h)
    if not plain.contradict:
        return None
    for each in coarser[1:]:
        if not _distances(_graded(spec, campaign, each), h).contradict:
            grade = each
    place = int(np.argmax(plain.size))
    return ShownGrade(grade, by_noise, plain.names[place], float(plain.size[place]))


def _graded(spec: ModelSpec, campaign: Campaign, grade: Grade) -> Model:
    return bind(spec, replace(campaign, grade=grade))


def _distances(model: Model, h: np.ndarray) -> _Distances:
    known = linear_information(model, h)
    chosen = np.flatnonzero(np.isin(known.owner, SENSORS) & (known.told > TOLD))
    names = tuple(known.parameters[place].name for place in chosen)
    return _Distances(names, known.owner[chosen], known.distances[chosen])
