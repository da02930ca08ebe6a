"""What a large effect leaves once it is fitted, not merely projected out.

The score is linear in the effect.  Where an effect is many times the noise, the curvature of the response and its
products with other parameters leave structure of their own, and imitate further effects.  One refit with the effect in
the model tells this from a cause that the effect only resembles: what remains then is small beside what it explained,
or it is not.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imubayes.criticism import thresholds
from imubayes.criticism.free_form_dependence import Structure, free_forms, project_forms, screen_structure
from imubayes.criticism.known_noise import KnownNoise, compare_with_known
from imubayes.criticism.localised_structure import features, scan_features
from imubayes.criticism.multiple_testing import look_elsewhere
from imubayes.criticism.projection import Projection, project
from imubayes.criticism.score_test import Candidate
from imubayes.criticism.stepwise_search import SearchResult
from imubayes.criticism.unexplained_structure import channels_of
from imubayes.criticism.warm_start import extend
from imubayes.inference.fitted_model import Fit
from imubayes.inference.posterior_mode import Mode, find_mode
from imubayes.model.problem import masked


@dataclass(frozen=True)
class Remainder:
    """What is left when the first effect found was fitted.

    Attributes
    ----------
    explained : drop of χ² by the refit, in units of the noise after it.
    structures : significant ones on the channels of the effect, and larger ones on others, with corrected p-values.
    record : noise that remains, against the noise that the campaign records.
    """

    explained: float
    structures: tuple[tuple[Structure, float], ...]
    record: KnownNoise

    @property
    def small(self) -> bool:
        """Whether all that is left is small beside what was explained."""
        largest = max((structure.score.delta_chi2 for structure, _ in self.structures), default=0.0)
        return largest < thresholds.REMAINDER_SHARE * self.explained


def remainder_of_leader(found: SearchResult) -> Remainder | None:
    """Return what the first effect leaves when it is fitted; None where it is not large or its refit fails."""
    leader = found.groups[0].leader if found.groups else None
    if leader is None or leader.delta_chi2 < thresholds.LARGE_EFFECT_CHI2:
        return None
    refit = _refit(found, leader)
    if refit is None:
        return None
    fitted, mode = refit
    at = project(fitted, np.asarray(mode.about.misfit), np.asarray(mode.about.jacobian))
    forms = project_forms(at, free_forms(at, found.covariates))
    scans = [scan_features(at, each) for each in features(at, found.covariates)]
    screened = screen_structure(at, forms, scans)
    corrected = look_elsewhere([structure.score for structure in screened], scans)
    owners = channels_of(found, leader)
    explained = _explained(found, at, mode)
    left = [
        (each, corrected(each.score.p))
        for each in screened
        if not owners or each.channel in owners or each.score.delta_chi2 > explained
    ]
    significant = tuple(pair for pair in left if pair[1] < thresholds.FALSE_ALARM_STRUCTURE)
    return Remainder(explained, significant, compare_with_known(at))


def _refit(found: SearchResult, leader: Candidate) -> tuple[Fit, Mode] | None:
    """Return the fit with the leader in the model, without the outliers; None where it does not converge."""
    before = found.first.projection.fitted
    shape = {f"{leader.effect}.{field}": value for field, value in leader.scan.shape.items()}
    values = zip(leader.coefficients, leader.value.tolist(), strict=True)
    hints = {coefficient.parameter.name: value for coefficient, value in values}
    extension = extend(before, [leader.effect], channels_of(found, leader) or None, shape, hints)
    problem = masked(extension.model.problem, found.outlier_sd != 0)
    mode = find_mode(problem, extension.z, extension.h)
    if not bool(mode.converged):
        return None
    return Fit(replace(extension.model, problem=problem), np.asarray(mode.z), np.asarray(mode.h), True), mode


def _explained(found: SearchResult, at: Projection, mode: Mode) -> float:
    """Return the drop of χ² by the refit, both residuals whitened by the noise after it."""
    misfits: Sequence[np.ndarray] = (found.responses.misfit, np.asarray(mode.about.misfit))
    before, after = (float(np.sum(at.whitened(misfit[:, None]) ** 2)) for misfit in misfits)
    return before - after
