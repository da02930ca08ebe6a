"""Simple dependences outside the catalogue that explain a finding as well as the effects named.

A single name is certain only where the runs could have shown another cause.  Where a plain function of one or two
covariates explains the same, and none of the effects named is that function, a cause that the catalogue lacks would
look alike: in positions of a gyro, magnetic sensitivity past the model is what a scale factor error would be.
"""

import numpy as np

from imubayes.criticism import thresholds
from imubayes.criticism.equivalent_effects import EquivalenceGroup
from imubayes.criticism.localised_structure import Feature, FeatureScan
from imubayes.criticism.residual_covariates import ResidualCovariate
from imubayes.criticism.score_test import Candidate
from imubayes.criticism.stepwise_search import Screening, SearchResult


def unlisted_causes(found: SearchResult, group: EquivalenceGroup) -> tuple[tuple[ResidualCovariate, ...], ...]:
    """Return the covariates of each plain function that fits as well as a group without being one of its effects."""
    at, leader = found.first, group.leader
    raw = np.stack([_response(at, member) for member in group.members], axis=1)
    near = [
        feature
        for scan in at.scans
        for feature in _explaining_as_much(scan, leader)
        if not _is_one_of(scan, feature, raw)
    ]
    by_name = {tuple(covariate.name for covariate in feature.covariates): feature.covariates for feature in near}
    return tuple(by_name.values())


def _explaining_as_much(scan: FeatureScan, leader: Candidate) -> list[Feature]:
    """Return the plain features that a refit could not distinguish from the leader, were that the truth."""
    explained = leader.score.fitted
    whole = float(explained @ explained)
    if whole <= 0:
        return []
    near = []
    for batch, chi2 in scan.scores(explained[None]):
        left = (1 - chi2[0] / whole) * leader.delta_chi2
        chosen = batch.members[left < min(thresholds.DISTINGUISHABLE_CHI2, leader.delta_chi2 / 2)]
        near += [scan.features.found[place] for place in chosen.tolist()]
    return [feature for feature in near if feature.plain]


def _response(at: Screening, member: Candidate) -> np.ndarray:
    """Return the whitened response to a candidate at its estimate, nothing projected out, (R,)."""
    prepared = next(each for each in at.prepared if each.response.scan == member.scan)
    names = [coefficient.parameter.name for coefficient in prepared.response.coefficients]
    value = np.zeros(len(names))
    for coefficient, size in zip(member.coefficients, member.value.tolist(), strict=True):
        value[names.index(coefficient.parameter.name)] = size
    return prepared.whitened @ value


def _is_one_of(scan: FeatureScan, feature: Feature, raw: np.ndarray) -> bool:
    """Tell whether one of some responses (R, members) is the feature itself, before anything is projected out."""
    columns = scan.features.whole(feature, len(raw))
    left = raw - columns @ np.linalg.lstsq(columns, raw, rcond=1e-12)[0]
    shares = np.sum(left**2, axis=0) / np.maximum(np.sum(raw**2, axis=0), 1e-300)
    return bool(np.any(shares < thresholds.SAME_RESPONSE))
