"""Functions that an unlisted cause could be, beside the terms of the library: curves of the input.

What a saturation does over three levels of the input, a square or a cube does as well.  The input is the predicted
output, so that injected currents count in it; where it follows the rate or the force along the axis, it is that.
"""

from dataclasses import replace

import numpy as np

from imubayes.covariates import COVARIATES
from imubayes.criticism import thresholds
from imubayes.criticism.localised_structure import Feature, FeatureScan, feature_set, scan_features
from imubayes.criticism.residual_covariates import ResidualCovariate
from imubayes.criticism.stepwise_search import SearchResult

_INPUTS = {"gyro": "rate_i", "accelerometer": "force_i"}


def rival_scans(found: SearchResult) -> list[FeatureScan]:
    """Return the curves of the input, and its square with its cube, as features of each kind of channel."""
    at, channels = found.first.projection, found.first.projection.fitted.model.campaign.channels
    entries, scans = at.fitted.model.entries, []
    for kind in dict.fromkeys(channel.kind for channel in channels):
        places = [place for place, channel in enumerate(channels) if channel.kind == kind]
        here = np.isin(entries.channel, places) & ~entries.closing
        if kind not in _INPUTS or not np.any(at.input[here]):
            continue
        covariate = _input(found, _INPUTS[kind], here)
        x = np.where(here, covariate.values, 0.0)
        x = x / np.abs(x).max()
        columns = np.stack([x**2, x**3, np.abs(x), x * np.abs(x)], axis=1)
        curves = _curves(covariate, COVARIATES[_INPUTS[kind]].symbol)
        scans.append(scan_features(at, feature_set(at, places, columns, curves)))
    return scans


def _input(found: SearchResult, name: str, here: np.ndarray) -> ResidualCovariate:
    """Return the input of some entries, (E,) bool: the rate or force along the axis, or else the predicted output."""
    entry, x = COVARIATES[name], found.first.projection.input
    label = next((each for each in found.covariates if each.name == entry.column), None)
    if label is None:
        return ResidualCovariate(entry.column, entry.unit, x, entry.phrase)
    along = np.nan_to_num(label.values[here])
    left = x[here] - along * (along @ x[here]) / max(along @ along, 1e-300)
    return label if left @ left < thresholds.SAME_RESPONSE * (x[here] @ x[here]) else replace(label, values=x)


def _curves(covariate: ResidualCovariate, symbol: str) -> tuple[Feature, ...]:
    """Return the curves, named as the library names them: by their columns a square, a cube, and two with a corner."""
    curves = (
        ((0,), f"{symbol}²"),
        ((1,), f"{symbol}³"),
        ((2,), f"|{symbol}|"),
        ((3,), f"{symbol}·|{symbol}|"),
        ((0, 1), f"{symbol}², {symbol}³"),
    )
    return tuple(Feature((covariate,), "input", own, family, plain=True) for own, family in curves)
