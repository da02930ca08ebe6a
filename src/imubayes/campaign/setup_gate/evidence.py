"""Evidence of the recorded outputs for a set-up: a linear Gaussian model of everything that may err in a valid one.

Output over nominal scale factor, less the nominal input u along the input axis I, is

    e = (δk u·I + α u·O + β u·S) + b + b_r + c·T + …  + δ_m·(u × I) + τ_t·(v × C I) + noise,

with errors of scale factor and input axis, a bias, one offset per run, slopes with temperature, for gyros a
g-sensitivity, a small rotation of every mounting and of every table.  All have Gaussian priors (`plausible_errors`), so
the marginal likelihood is in closed form.  Every run adds a term to the normal equations, and a suspected mistake
changes the terms of the runs that it concerns: one evaluation is the solution of some hundred equations.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.campaign.setup_gate.plausible_errors import (
    G_SENSITIVITIES,
    GROSS,
    LEVER_ARM,
    MOUNTING_LEAST,
    MOUNTING_UNSTATED,
    TABLE_LEAST,
    TABLE_UNSTATED,
    Widths,
    widths,
)
from imubayes.campaign.setup_gate.run_view import RunView
from imubayes.campaign.unit_grade import grade_of
from imubayes.campaign_data import Campaign
from imubayes.earth import earth_rate

_OWN = 10  # parameters of a channel: scale, two misalignments, bias, three of temperature, three of g-sensitivity
_WARM = 25.0


@dataclass(frozen=True)
class NormalTerms:
    """What a run adds to the normal equations, and to the log likelihood.

    Attributes
    ----------
    matrix, vector, square : of the normal equations, (P, P), (P,) and the sum of weighted squares.
    volume : sum of the logarithms of the variances.
    values : number of outputs.
    """

    matrix: np.ndarray
    vector: np.ndarray
    square: float
    volume: float
    values: int

    def __add__(self, other: "NormalTerms") -> "NormalTerms":
        return NormalTerms(
            self.matrix + other.matrix, self.vector + other.vector, self.square + other.square,
            self.volume + other.volume, self.values + other.values,
        )  # fmt: skip

    def __sub__(self, other: "NormalTerms") -> "NormalTerms":
        return NormalTerms(
            self.matrix - other.matrix, self.vector - other.vector, self.square - other.square,
            self.volume - other.volume, self.values - other.values,
        )  # fmt: skip

    def with_volume(self, more: float) -> "NormalTerms":
        """Return the terms with more volume."""
        return NormalTerms(self.matrix, self.vector, self.square, self.volume + more, self.values)

    def scaled(self, factor: float) -> "NormalTerms":
        """Return the terms of so many times as many outputs."""
        return NormalTerms(
            self.matrix * factor, self.vector * factor, self.square * factor, self.volume * factor,
            round(self.values * factor),
        )  # fmt: skip


class ErrorModel:
    """The linear model of plausible errors of one campaign; of gross ones, where missing effects may be large."""

    def __init__(self, campaign: Campaign, gross: bool = False):
        self.gross = gross
        self.places = [k for k, channel in enumerate(campaign.channels) if channel.kind != "angle"]
        self.channels = [campaign.channels[k] for k in self.places]
        self.widths = [widths(channel.kind, grade_of(campaign, channel.kind)) for channel in self.channels]
        start = _OWN * len(self.channels)
        self.mountings = {name: start + 3 * k for k, name in enumerate(campaign.mountings)}
        start += 3 * len(self.mountings)
        self.tables = {name: start + 3 * k for k, name in enumerate(campaign.tables)}
        self.size = start + 3 * len(self.tables)
        self.sd = self._standard_deviations(campaign)
        gyro = [k for k, channel in enumerate(self.channels) if channel.kind == "gyro"]
        self.g_sensitive = np.array([_OWN * k + 7 + axis for k in gyro for axis in range(3)], dtype=int)

    def _standard_deviations(self, campaign: Campaign) -> np.ndarray:
        sd = np.ones(self.size)
        for k, width in enumerate(self.widths):
            own = [width.scale, width.misalignment, width.misalignment, width.bias, width.bias_slope]
            sd[_OWN * k : _OWN * k + 7] = [*own, width.bias_slope / 3, width.scale_slope]
        for name, place in self.mountings.items():
            stated = campaign.mountings[name].uncertainty
            sd[place : place + 3] = MOUNTING_UNSTATED if stated is None else max(2 * stated, MOUNTING_LEAST)
        for name, place in self.tables.items():
            stated = campaign.tables[name].axis_uncertainty
            sd[place : place + 3] = TABLE_UNSTATED if stated is None else max(2 * stated, TABLE_LEAST)
        return sd

    def terms(self, view: RunView) -> NormalTerms:
        """Return what a run adds to the normal equations."""
        matrix, vector = np.zeros((self.size, self.size)), np.zeros(self.size)
        square, volume, values = 0.0, 0.0, 0
        stand = view.local_to_body()
        up, earth = np.array([0.0, 0.0, view.gravity]), earth_rate(view.latitude)
        force, rate = stand @ up, view.rate_in_body(stand)
        warm = (view.temperatures.get("temperature", np.full(view.rows, _WARM)) - _WARM) / 10
        left_out = {"gyro": _cross(earth), "accelerometer": _cross(up)}
        size = {"gyro": np.linalg.norm(rate, axis=1), "accelerometer": np.full(view.rows, view.gravity)}
        shared = self._shared(view)
        design = np.zeros((view.rows, _OWN + len(shared)))
        for k, channel in enumerate(self.channels):
            output = view.observed[:, self.places[k]]
            there = np.isfinite(output)
            if not there.any():
                continue
            gyro = channel.kind == "gyro"
            along = (rate if gyro else force) @ channel.axes.T
            design[:, :3], design[:, 3], design[:, 4], design[:, 5] = along, 1.0, warm, warm**2
            design[:, 6] = warm * along[:, 0]
            design[:, 7:10] = force @ channel.axes.T / view.gravity if gyro else 0.0
            place = _OWN
            if view.mounting is not None:
                design[:, place : place + 3] = (rate if gyro else force) @ _cross(channel.axes[0])
                place += 3
            if view.table is not None:
                design[:, place : place + 3] = (channel.axes[0] @ stand) @ left_out[channel.kind]
            error = (output - channel.offset) / channel.scale_si - along[:, 0]
            noise = (channel.noise or 0.0) / abs(channel.scale_si)
            variance = noise**2 / view.samples + self._left_out(view, k, size[channel.kind])
            found = _weighted(design[there], error[there], variance[there], self.widths[k])
            own = slice(_OWN * k, _OWN * (k + 1))
            matrix[own, own] += found.matrix[:_OWN, :_OWN]
            matrix[own, shared] += found.matrix[:_OWN, _OWN:]
            matrix[shared, own] += found.matrix[_OWN:, :_OWN]
            matrix[np.ix_(shared, shared)] += found.matrix[_OWN:, _OWN:]
            vector[own] += found.vector[:_OWN]
            vector[shared] += found.vector[_OWN:]
            square, volume, values = square + found.square, volume + found.volume, values + found.values
        return NormalTerms(matrix, vector, square, volume, values)

    def _shared(self, view: RunView) -> np.ndarray:
        places = [self.mountings[view.mounting]] if view.mounting is not None else []
        places += [self.tables[view.table]] if view.table is not None else []
        return np.concatenate([np.arange(0), *(np.arange(place, place + 3) for place in places)]).astype(int)

    def _left_out(self, view: RunView, k: int, size: np.ndarray) -> np.ndarray:
        """Return the variance of what the linear model leaves out of inputs of a size, SI, shape (R,)."""
        width = self.widths[k]
        found = (size * width.share) ** 2 + width.rest**2
        found = found + GROSS[self.channels[k].kind] ** 2 if self.gross else found
        return found if self.channels[k].kind == "gyro" else found + view.largest_rate() ** 4 * LEVER_ARM**2

    def score(self, terms: NormalTerms) -> float:
        """Return −2 log of the evidence, up to a constant, with the g-sensitivity that the gyros show."""
        widest = G_SENSITIVITIES if len(self.g_sensitive) else G_SENSITIVITIES[:1]
        return min(self._score(terms, width) for width in widest)

    def _score(self, terms: NormalTerms, g_sensitivity: float) -> float:
        sd = self._sd(g_sensitivity)
        # In units of the priors the normal matrix is the unit matrix and more, and well conditioned.
        lower = np.linalg.cholesky(np.eye(self.size) + sd[:, None] * terms.matrix * sd)
        solved = np.linalg.solve(lower, sd * terms.vector)
        return float(terms.square - solved @ solved + 2 * np.log(np.diag(lower)).sum() + terms.volume)

    def _sd(self, g_sensitivity: float) -> np.ndarray:
        sd = self.sd.copy()
        sd[self.g_sensitive] = g_sensitivity
        return sd

    def errors(self, terms: NormalTerms) -> np.ndarray:
        """Return the estimated errors in units of their standard deviations, shape (P,)."""
        sd = self._sd(min(G_SENSITIVITIES, key=lambda width: self._score(terms, width)))
        return np.linalg.solve(np.eye(self.size) + sd[:, None] * terms.matrix * sd, sd * terms.vector)

    def misfit(self, terms: NormalTerms) -> float:
        """Return the sum of squared residuals and errors in units of their standard deviations."""
        sd = self._sd(G_SENSITIVITIES[-1])
        lower = np.linalg.cholesky(np.eye(self.size) + sd[:, None] * terms.matrix * sd)
        solved = np.linalg.solve(lower, sd * terms.vector)
        return float(terms.square - solved @ solved)


def _weighted(design: np.ndarray, error: np.ndarray, variance: np.ndarray, width: Widths) -> NormalTerms:
    """Return the terms of one channel in one run; the offset of the run is integrated out."""
    weight = 1 / variance
    weighted = design * weight[:, None]
    total = 1 / width.offset**2 + weight.sum()
    mean, at = weighted.sum(axis=0), float(weight @ error)
    matrix = design.T @ weighted - np.outer(mean, mean) / total
    square = float(error @ (weight * error)) - at**2 / total
    volume = float(np.log(variance).sum() + np.log(total * width.offset**2))
    return NormalTerms(matrix, weighted.T @ error - mean * at / total, square, volume, len(error))


def _cross(vector: np.ndarray) -> np.ndarray:
    """Return the matrix M of a vector v with u M = u × v."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def total(terms: Sequence[NormalTerms]) -> NormalTerms:
    """Return the sum of the terms of runs."""
    found = terms[0]
    for more in terms[1:]:
        found = found + more
    return found
