"""Simple dependences outside the catalogue that explain a finding as well as the effects named.

A single name is certain only where the runs could have shown another cause.  Where a plain function of one or two
covariates explains the same, or explains more of the residual, and none of the effects named is that function, a cause
that the catalogue lacks would look alike: in positions of a gyro, magnetic sensitivity past the model is what a scale
factor error would be.  Linear in the components of a vector, across the input axis or all of them, is one function,
and so is quadratic in them; curves of the input are others (`imubayes.criticism.rival_functions`).  An effect that is
a free series of an angle is like any function of it: such a series is always a rival.  A function with more terms than
the effect has coefficients is none, as it fits by its freedom.  Of an effect that remembers the temperature, the other
kind of memory is such a cause, and not the other functions of a rate of change at few levels.

An effect that goes with several covariates coincides with a function of fewer of them where the others do not vary, and
one of the bias with one of the scale factor where the input does not: at one input, a scale factor over temperature and
a bias over temperature are alike.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from imubayes.criticism import thresholds
from imubayes.criticism.effect_covariates import INPUTS, covariates_of
from imubayes.criticism.equivalent_effects import EquivalenceGroup
from imubayes.criticism.localised_structure import Feature, FeatureScan
from imubayes.criticism.projection import orthonormal
from imubayes.criticism.residual_covariates import ResidualCovariate
from imubayes.criticism.rival_functions import SERIES, rival_scans
from imubayes.criticism.score_test import Candidate
from imubayes.criticism.search_input import Screening
from imubayes.criticism.stepwise_search import SearchResult
from imubayes.criticism.temperature_memory import kind_of_memory, may_scale, other_memory

Causes = tuple[tuple[ResidualCovariate, ...], ...]
"""Covariates, one to three, of each function."""
_VECTORS = (("rate_i", "rate_o", "rate_s"), ("force_i", "force_o", "force_s"))
_LINEAR, _SQUARE = 0, 1  # places among the plain functions of one covariate
_ALWAYS = 2
"""Terms that a function may have, however few coefficients the effect has."""


def unlisted_causes(found: SearchResult, group: EquivalenceGroup) -> Causes:
    """Return the covariates of each function that fits as well as a group without being one of its effects."""
    at, leader = found.first, group.leader
    if not np.any(leader.score.fitted):
        return ()
    near, same = _as_good_functions(found, group)
    if not kind_of_memory(at.projection.fitted.model.registry.effects[leader.effect]):
        near.extend(_undetermined_forms(same))
    near.extend(_of_other_covariates(found, group, [feature for _, feature in same]))
    by_name = {tuple(covariate.name for covariate in feature.covariates): feature.covariates for feature in near}
    if (remembered := other_memory(found, group)) is not None:
        by_name[remembered.name,] = (remembered,)
    return tuple(by_name.values())


def _as_good_functions(
    found: SearchResult, group: EquivalenceGroup
) -> tuple[list[Feature], list[tuple[FeatureScan, Feature]]]:
    """Return the functions that fit as well as a group: those that are none of its effects, and those that are one."""
    at, leader = found.first, group.leader
    raw = np.stack([_response(at, member) for member in group.members], axis=1)
    targets = np.stack([leader.score.fitted, at.projection.residual])
    most = max(_ALWAYS, *(sum(each.owner == owner for each in leader.coefficients) for owner in leader.owners))
    scans = [(scan, [*_of_plain(scan, targets), *_of_vectors(scan, targets)]) for scan in at.scans]
    scans += [(scan, _of_plain(scan, targets)) for scan in rival_scans(found)]
    near: list[Feature] = []
    same: list[tuple[FeatureScan, Feature]] = []
    for scan, scored in scans:
        for feature, (along, gain), freedom in scored:
            if len(feature.columns) > most or not _as_good(leader, along, gain, freedom):
                continue
            if feature.test != SERIES and _is_one_of(scan, feature, raw):
                same.append((scan, feature))
            else:
                near.append(feature)
    return near, same


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
    """Return the features linear in the components of a vector, across the input axis and all, or quadratic in all."""
    alone, products = _by_covariates(scan)
    found: list[_Scored] = []
    for vector in _VECTORS:
        has = [name for name in vector if len(alone.get(name, ())) > _SQUARE]
        linear = [alone[name][_LINEAR] for name in has]
        crossed = [products[pair] for pair in map(frozenset, combinations(has, 2)) if pair in products]
        across = [each for each, name in zip(linear, has, strict=True) if name != vector[0]]
        quadratic = [*(alone[name][_SQUARE] for name in has), *crossed]
        ways = {tuple(each.columns for each in way): way for way in (across, linear, quadratic) if len(way) > 1}
        found += [_together(scan, targets, way) for way in ways.values()]
    return found


def _by_covariates(scan: FeatureScan) -> tuple[dict[str, list[Feature]], dict[frozenset[str], Feature]]:
    """Return the plain functions of each covariate, and of each pair."""
    alone: dict[str, list[Feature]] = {}
    products: dict[frozenset[str], Feature] = {}
    for feature in scan.features.found:
        names = [covariate.name for covariate in feature.covariates]
        if feature.plain and len(names) == 1:
            alone.setdefault(names[0], []).append(feature)
        elif feature.plain:
            products[frozenset(names)] = feature
    return alone, products


def _together(scan: FeatureScan, targets: np.ndarray, parts: Sequence[Feature]) -> _Scored:
    """Return some features as one, with the drops of χ² of targets."""
    covariates = {covariate.name: covariate for part in parts for covariate in part.covariates}
    columns = tuple(column for part in parts for column in part.columns)
    feature = Feature(tuple(covariates.values()), parts[0].test, columns, plain=True)
    whole = scan.features.whole(feature, targets.shape[1])
    projected = whole - scan.basis @ (scan.basis.T @ whole)
    span = orthonormal(projected, np.linalg.norm(whole, axis=0), thresholds.FORM_RETAINED_MIN)
    return feature, np.sum((targets @ span) ** 2, axis=1), span.shape[1]


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


def _undetermined_forms(same: Sequence[tuple[FeatureScan, Feature]]) -> list[Feature]:
    """Return the functions that coincide with an effect of the group where others of the same covariates do as well.

    At few levels of its covariates an effect is like every function of them, linear or quadratic: its form is not
    determined.  A function that includes another one is not another form.
    """
    forms: dict[tuple[str, ...], list[Feature]] = {}
    for scan, feature in same:
        own = [each for other, each in same if other is scan]
        if not any(set(each.columns) < set(feature.columns) for each in own):
            forms.setdefault(tuple(covariate.name for covariate in feature.covariates), []).append(feature)
    return [found[0] for found in forms.values() if len({(each.family, len(each.columns)) for each in found}) > 1]


def _of_other_covariates(found: SearchResult, group: EquivalenceGroup, same: Sequence[Feature]) -> list[Feature]:
    """Return the functions that coincide with an effect of the group, and leave out or add a covariate.

    They leave out any that the effect goes with, or add the input: then the effect might be one of the scale factor.
    """
    own, scaled = _goes_with(found, group)
    other = [(frozenset(covariate.name for covariate in feature.covariates), feature) for feature in same]
    return [
        feature
        for names, feature in other
        if names not in own and (names in scaled or any(names < each for each in own))
    ]


def _goes_with(found: SearchResult, group: EquivalenceGroup) -> tuple[set[frozenset[str]], set[frozenset[str]]]:
    """Return what the coefficients of a group go with, and what they would as changes of the scale factor."""
    model = found.first.projection.fitted.model
    kinds = {channel.kind for channel in model.campaign.channels if channel.name in group.leader.owners}
    pairs = [(model.registry.effects[name], kind) for name in group.effects for kind in kinds]
    own = {(each, INPUTS[kind]) for member, kind in pairs for each in covariates_of(member, kind)}
    scaled = {each | {along} for each, along in own if each} if may_scale(found, group) else set()
    return {each for each, _ in own}, scaled


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
