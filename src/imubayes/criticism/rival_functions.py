"""Functions that an unlisted cause could be, beside the terms of the library: of the input, and of a table angle.

What a saturation does over three levels of the input, a square or a cube does as well.  The input is the predicted
output, so that injected currents count in it; where it follows the rate or the force along the axis, it is that.

Over one turn every smooth function of the angle of a table is nearly a short Fourier series.  An effect that is a free
series there, such as the wobble of the table, is like any drift that depends on the angle.  Where a gyro drives the
table, a drift d(φ) turns it by δφ = φ′ ∫ d/φ′ dt, the solution of the linearised δφ̇ = (∂φ′/∂φ) δφ + d.
"""

from dataclasses import replace

import numpy as np
import scipy  # loads its parts when they are first used

from imubayes.covariates import COVARIATES
from imubayes.criticism import thresholds
from imubayes.criticism.effect_covariates import INPUTS
from imubayes.criticism.localised_structure import Feature, FeatureScan, feature_set, scan_features
from imubayes.criticism.residual_covariates import ResidualCovariate
from imubayes.criticism.stepwise_search import SearchResult
from imubayes.model.nodes_and_entries import servo_runs

_ANGLE = COVARIATES["table_angle"]
_ORDERS = (1, 2, 3, 4)
"""Of a drift over the angle: what is linear in g times a wobble of two harmonics has four."""
SERIES = "series"


def rival_scans(found: SearchResult) -> list[FeatureScan]:
    """Return the functions of the input by kind of channel, and of the angle of the tables that gyros drive."""
    return [*_of_inputs(found), *_of_driven_tables(found)]


def _of_inputs(found: SearchResult) -> list[FeatureScan]:
    """Return the curves of the input, and its square with its cube, as features of each kind of channel."""
    at, channels = found.first.projection, found.first.projection.fitted.model.campaign.channels
    entries, scans = at.fitted.model.entries, []
    for kind in dict.fromkeys(channel.kind for channel in channels):
        places = [place for place, channel in enumerate(channels) if channel.kind == kind]
        here = np.isin(entries.channel, places) & ~entries.closing
        if kind not in INPUTS or not np.any(at.input[here]):
            continue
        covariate = _input(found, INPUTS[kind], here)
        x = np.where(here, covariate.values, 0.0)
        x = x / np.abs(x).max()
        columns = np.stack([x**2, x**3, np.abs(x), x * np.abs(x)], axis=1)
        curves = _curves(covariate, COVARIATES[INPUTS[kind]].symbol)
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


def _of_driven_tables(found: SearchResult) -> list[FeatureScan]:
    """Return the series of a drift over the angle of each table that a gyro drives, all harmonics as one feature."""
    at = found.first.projection
    entries, campaign = at.fitted.model.entries, at.fitted.model.campaign
    columns, places = np.zeros((len(entries), 2 * len(_ORDERS))), set[int]()
    for place in servo_runs(campaign):
        covariates = campaign.runs[place].covariates
        here = (entries.run == place) & ~entries.closing
        columns[here] = drifts_of_series(covariates[_ANGLE.name], covariates["time"])[entries.row[here]]
        places.update(entries.channel[here].tolist())
    label = next((each for each in found.covariates if each.name == _ANGLE.column), None)
    if not places or label is None:
        return []
    series = Feature((label,), SERIES, tuple(range(columns.shape[1])), SERIES, plain=True)
    return [scan_features(at, feature_set(at, sorted(places), columns, (series,)))]


def drifts_of_series(angle: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return what a drift by each harmonic of the angle changes of the angle itself, (K, 8) in s.

    Parameters
    ----------
    angle, time : of a table that a gyro drives, (K,) in rad and s.
    """
    drift = np.stack([f(order * angle) for order in _ORDERS for f in (np.sin, np.cos)], axis=1)
    rate = np.gradient(angle, time)
    # Where the table stops, or turns back, the linearised solution has no such form.
    rate = (rate if np.all(rate > 0) or np.all(rate < 0) else np.ones_like(rate))[:, None]
    return rate * scipy.integrate.cumulative_trapezoid(drift / rate, time, axis=0, initial=0)
