"""Simple dependences outside the catalogue that explain a finding as well as the effects named.

A single name is certain only where the runs could have shown another cause.  Where a plain function of one or two
covariates explains the same, or explains more of the residual, and none of the effects named is that function, a cause
that the catalogue lacks would look alike: in positions of a gyro, magnetic sensitivity past the model is what a scale
factor error would be.  The two components of a vector across the input axis are one function, linear in both.
Of an effect that remembers the temperature, the other kind of memory is such a cause.
"""

import numpy as np

from imubayes.criticism import thresholds
from imubayes.criticism.equivalent_effects import EquivalenceGroup
from imubayes.criticism.localised_structure import Feature, FeatureScan
from imubayes.criticism.projection import orthonormal
from imubayes.criticism.residual_covariates import ResidualCovariate
from imubayes.criticism.score_test import Candidate
from imubayes.criticism.stepwise_search import Screening, SearchResult
from imubayes.criticism.temperature_memory import other_memory

Causes = tuple[tuple[ResidualCovariate, ...], ...]
"""Covariates, one or two, of each plain function."""
_ACROSS = (("rate_o", "rate_s"), ("force_o", "force_s"))


def unlisted_causes(found: SearchResult, group: EquivalenceGroup) -> Causes:
    """Return the covariates of each plain function that fits as well as a group without being one of its effects."""
    at, leader = found.first, group.leader
    explained = leader.score.fitted
    if not np.any(explained):
        return ()
    raw = np.stack([_response(at, member) for member in group.members], axis=1)
    targets = np.stack([explained, at.projection.residual])
    near = [
        feature
        for scan in at.scans
        for feature, (along, gain), freedom in (*_of_plain(scan, targets), *_of_vectors(scan, targets))
        if _as_good(leader, along, gain, freedom) and not _is_one_of(scan, feature, raw)
    ]
    by_name = {tuple(covariate.name for covariate in feature.covariates): feature.covariates for feature in near}
    if (remembered := other_memory(found, group)) is not None:
        by_name[remembered.name,] = (remembered,)
    return tuple(by_name.values())


_Scored = tuple[Feature, np.ndarray, int]
"""A feature, the drops of χ² of some targets by it, and its degrees of freedom."""


def _of_plain(scan: FeatureScan, targets: np.ndarray) -> list[_Scored]:
    """Return the plain features with the drops of χ² of targets (n, R)."""
    scored = [
        (member, drops, freedom)
        for batch, scores in scan.scores(targets)
        for member, drops, freedom in zip(batch.members.tolist(), scores.T, batch.freedom.tolist(), strict=True)
    ]
    found = [(scan.features.found[member], *rest) for member, *rest in sorted(scored, key=lambda each: each[0])]
    return [each for each in found if each[0].plain]


def _of_vectors(scan: FeatureScan, targets: np.ndarray) -> list[_Scored]:
    """Return the features linear in both components of a vector across the input axis, likewise."""
    plain = [feature for feature in scan.features.found if feature.plain and len(feature.covariates) == 1]
    linear = {feature.covariates[0].name: feature for feature in reversed(plain)}
    found: list[_Scored] = []
    for across in _ACROSS:
        if not all(name in linear for name in across):
            continue
        first, second = (linear[name] for name in across)
        feature = Feature(first.covariates + second.covariates, first.test, first.columns + second.columns, plain=True)
        columns = scan.features.whole(feature, targets.shape[1])
        projected = columns - scan.basis @ (scan.basis.T @ columns)
        span = orthonormal(projected, np.linalg.norm(columns, axis=0), thresholds.FORM_RETAINED_MIN)
        found.append((feature, np.sum((targets @ span) ** 2, axis=1), span.shape[1]))
    return found


def _as_good(leader: Candidate, along: float, gain: float, freedom: int) -> bool:
    """Tell whether a refit could not distinguish a feature from the leader, were that the truth, or prefers it.

    Parameters
    ----------
    along, gain : drops of χ² by the feature, of what the leader explains and of the residual.
    """
    left = (1 - along / leader.score.delta_chi2_at_fit) * leader.delta_chi2
    if left < min(thresholds.DISTINGUISHABLE_CHI2, leader.delta_chi2 / 2):
        return True
    return bool(gain - freedom > leader.score.delta_chi2_at_fit - leader.dof)


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
