"""Simple dependences outside the catalogue that explain a finding as well as the effects named.

A single name is certain only where the runs could have shown another cause.  Where a plain function of one or two
covariates explains the same, or explains more of the residual, and none of the effects named is that function, a cause
that the catalogue lacks would look alike: in positions of a gyro, magnetic sensitivity past the model is what a scale
factor error would be.  The two components of a vector across the input axis are one function, linear in both.
"""

import numpy as np

from imubayes.criticism import thresholds
from imubayes.criticism.equivalent_effects import EquivalenceGroup
from imubayes.criticism.localised_structure import Feature, FeatureScan
from imubayes.criticism.projection import orthonormal
from imubayes.criticism.residual_covariates import ResidualCovariate
from imubayes.criticism.score_test import Candidate
from imubayes.criticism.stepwise_search import Screening, SearchResult

Causes = tuple[tuple[ResidualCovariate, ...], ...]
"""Covariates, one or two, of each plain function."""
_ACROSS = (("rate_o", "rate_s"), ("force_o", "force_s"))


def unlisted_causes(found: SearchResult, group: EquivalenceGroup) -> Causes:
    """Return the covariates of each plain function that fits as well as a group without being one of its effects."""
    at, leader = found.first, group.leader
    raw = np.stack([_response(at, member) for member in group.members], axis=1)
    near = [
        feature
        for scan in at.scans
        for feature in _plain(scan)
        if _as_good(scan, feature, leader, at.projection.residual) and not _is_one_of(scan, feature, raw)
    ]
    by_name = {tuple(covariate.name for covariate in feature.covariates): feature.covariates for feature in near}
    return tuple(by_name.values())


def _plain(scan: FeatureScan) -> list[Feature]:
    """Return the plain features, and those linear in both components of a vector across the input axis."""
    plain = [feature for feature in scan.features.found if feature.plain]
    linear = {feature.covariates[0].name: feature for feature in reversed(plain) if len(feature.covariates) == 1}
    for across in _ACROSS:
        if all(name in linear for name in across):
            first, second = (linear[name] for name in across)
            covariates = first.covariates + second.covariates
            plain.append(Feature(covariates, first.test, first.columns + second.columns, plain=True))
    return plain


def _as_good(scan: FeatureScan, feature: Feature, leader: Candidate, residual: np.ndarray) -> bool:
    """Tell whether a refit could not distinguish a feature from the leader, were that the truth, or prefers it."""
    explained = leader.score.fitted
    whole = float(explained @ explained)
    if whole <= 0:
        return False
    columns = scan.features.whole(feature, len(residual))
    projected = columns - scan.basis @ (scan.basis.T @ columns)
    span = orthonormal(projected, np.linalg.norm(columns, axis=0), thresholds.FORM_RETAINED_MIN)
    left = (1 - float(np.sum((span.T @ explained) ** 2)) / whole) * leader.delta_chi2
    if left < min(thresholds.DISTINGUISHABLE_CHI2, leader.delta_chi2 / 2):
        return True
    gain, freedom = float(np.sum((span.T @ residual) ** 2)), span.shape[1]
    return gain - freedom > leader.score.delta_chi2_at_fit - leader.dof


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
