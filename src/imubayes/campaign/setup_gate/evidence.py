"""Evidence of the recorded outputs for a set-up: a linear Gaussian model of everything that may err in a valid one.

Output over nominal scale factor, less the nominal input u along the input axis I, is

    e = (δk u·I + α u·O + β u·S) + b + b_r + c·T + …  + δ_m·(u × I) + τ_t·(v × C I) + noise,

with errors of scale factor and input axis, a bias, one offset per run, slopes with the temperatures, for gyros a
g-sensitivity, a small rotation of every mounting and of every table.  All have Gaussian priors (`plausible_errors`), so
the marginal likelihood is in closed form.  Every run adds a term to the normal equations, and a suspected mistake
changes the terms of the runs that it concerns: one evaluation is the solution of some hundred equations.

The rotations are linear in δ and τ about zero, or about a `centre`, their estimates in the set-up as stated.  About
zero their squares are left out, and count with what else a linear model leaves out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imubayes.campaign.setup_gate.plausible_errors import (
    COMPENSATED,
    G_SENSITIVITIES,
    G_SQUARED,
    GROSS,
    LEVER_ARM,
    LOOSE_OFFSET,
    MOUNTING_LEAST,
    MOUNTING_UNSTATED,
    POOR,
    TABLE_LEAST,
    TABLE_UNSTATED,
    Steadiness,
    widths,
)
from imubayes.campaign.setup_gate.run_view import RunView, feels_the_earth_alone, views_of
from imubayes.campaign.unit_grade import grade_of
from imubayes.campaign_data import Campaign
from imubayes.earth import earth_rate

# Parameters of a channel: scale, two misalignments, bias, three of the temperature, three of g-sensitivity, three of
# the converter's temperature (as many as of the sensor's, or a curve would tell that the thermometers are exchanged);
# of gyros that feel the Earth rate alone six terms quadratic in g, of which every tumble makes the same pattern.
_OWN, _SQUARES = 13, ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))
_OF_TEMPERATURE = (4, 5, 6, 10, 11, 12)
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
    """The linear model of plausible errors of one campaign.

    Parameters
    ----------
    gross : whether missing effects may be large.
    steadiness : of the channels, over that of a poor unit.
    centre : errors about which the model is linear, shape (P,); those of mountings and tables count, None is zero.
    """

    def __init__(
        self,
        campaign: Campaign,
        gross: bool = False,
        steadiness: Steadiness = POOR,
        centre: np.ndarray | None = None,
    ):
        self.gross, self.centre = gross, centre
        self.rotated: dict[int, np.ndarray] = {}
        self.places = [k for k, channel in enumerate(campaign.channels) if channel.kind != "angle"]
        self.channels = [campaign.channels[k] for k in self.places]
        self.widths = [widths(channel.kind, grade_of(campaign, channel.kind)) for channel in self.channels]
        self._stack(steadiness)
        tumbled = all(channel.kind == "gyro" for channel in self.channels)
        self.squares = _SQUARES if tumbled and feels_the_earth_alone(campaign, views_of(campaign)) else ()
        self.own = _OWN + len(self.squares)
        start = self.own * len(self.channels)
        self.mountings = {name: start + 3 * k for k, name in enumerate(campaign.mountings)}
        start += 3 * len(self.mountings)
        self.tables = {name: start + 3 * k for k, name in enumerate(campaign.tables)}
        self.size = start + 3 * len(self.tables)
        self.sd = self._standard_deviations(campaign)
        self.thermal = np.add.outer(self.own * np.arange(len(self.channels)), _OF_TEMPERATURE).ravel()
        gyro = [k for k, channel in enumerate(self.channels) if channel.kind == "gyro"]
        self.g_sensitive = np.array([self.own * k + 7 + axis for k in gyro for axis in range(3)], dtype=int)

    def _stack(self, steadiness: Steadiness) -> None:
        """Set the facts about the channels as arrays: axes (K, 3, 3), gyro and run_offset (K,), others (K, 1)."""
        self.axes = np.stack([channel.axes for channel in self.channels])
        self.gyro = np.array([channel.kind == "gyro" for channel in self.channels])
        self.offset = np.array([[channel.offset] for channel in self.channels])
        self.scale = np.array([[channel.scale_si] for channel in self.channels])
        self.noise = np.array([[channel.noise or 0.0] for channel in self.channels]) * _column(steadiness.noise)
        rows = _column(steadiness.rows)
        self.share = np.array([[width.share] for width in self.widths]) * rows
        gross = [GROSS[channel.kind] if self.gross else 0.0 for channel in self.channels]
        self.rest = np.hypot(np.array([[width.rest] for width in self.widths]) * rows, np.array(gross)[:, None])
        self.run_offset = np.array([width.offset for width in self.widths]) * steadiness.runs
        self.across = np.stack([_cross(axis) for axis in self.axes[:, 0]])

    def _standard_deviations(self, campaign: Campaign) -> np.ndarray:
        sd = np.ones(self.size)
        for k, width in enumerate(self.widths):
            own = [width.scale, width.misalignment, width.misalignment, width.bias, width.bias_slope]
            first = self.own * k
            sd[first : first + 7] = [*own, width.bias_slope / 3, width.scale_slope]
            sd[first + 10 : first + _OWN] = width.bias_slope, width.bias_slope / 3, width.scale_slope
            sd[first + _OWN : first + self.own] = G_SQUARED
        for name, place in self.mountings.items():
            stated = campaign.mountings[name].uncertainty
            sd[place : place + 3] = MOUNTING_UNSTATED if stated is None else max(2 * stated, MOUNTING_LEAST)
        for name, place in self.tables.items():
            known = [each for each in campaign.tables[name].tilt_uncertainty if each is not None]
            sd[place : place + 3] = max(2 * max(known), TABLE_LEAST) if known else TABLE_UNSTATED
        return sd

    def terms(self, view: RunView, loose: bool = False) -> NormalTerms:
        """Return what a run adds to the normal equations; of a loose run bias and scale factor are its own."""
        return self.terms_of(self.seen(view), loose)

    def terms_of(self, seen: "Seen", loose: bool = False, drift: "RunDrift | None" = None) -> NormalTerms:
        """Return what the outputs of a run, which may drift, add to the normal equations."""
        design, shared, there = seen.design, seen.shared, seen.there
        variance = seen.white + seen.left_out + seen.arm
        weight = np.where(there, 1 / variance, 0.0)
        own, spread = self._of_run(seen.along, loose)
        if drift is not None:
            courses = np.broadcast_to(drift.courses, (len(own), *drift.courses.shape))
            own, spread = np.concatenate([own, courses], axis=2), np.concatenate([spread, drift.sd], axis=1)
        found = weighted(design, seen.error, weight, own, spread)
        each = self.own
        own = np.arange(each * len(self.channels))
        blocks = own.reshape(-1, each)
        matrix, vector = np.zeros((self.size, self.size)), np.zeros(self.size)
        matrix[blocks[:, :, None], blocks[:, None, :]] = found.matrix[:, :each, :each]
        across = found.matrix[:, :each, each:].reshape(len(own), len(shared))
        matrix[np.ix_(own, shared)], matrix[np.ix_(shared, own)] = across, across.T
        matrix[np.ix_(shared, shared)] = found.matrix[:, each:, each:].sum(axis=0)
        vector[own], vector[shared] = found.vector[:, :each].ravel(), found.vector[:, each:].sum(axis=0)
        volume = float(np.log(variance)[there].sum() + found.volume.sum())
        return NormalTerms(matrix, vector, float(found.square.sum()), volume, int(there.sum()))

    def seen(self, view: RunView) -> "Seen":
        """Return the errors of the outputs of a run and their response to the errors of the model."""
        moved, tilted = self._centred(view)
        stand = moved.local_to_body() @ tilted
        up, earth = np.array([0.0, 0.0, view.gravity]), earth_rate(view.latitude)
        force, rate = stand @ up, moved.rate_in_body(stand)
        nominal = np.where(self.gyro[:, None, None], rate, force)
        response = view.response[self.places][:, None, None]
        felt = nominal * response  # of each channel, (K, R, 3)
        along = felt @ self.axes.swapaxes(1, 2)
        shared = self._shared(view)
        still = np.where(self.gyro[:, None, None], earth, up) * response
        design = self._design(view, stand, felt, along, still, len(shared))
        output = view.observed[:, self.places].T
        there = np.isfinite(output)
        at_zero = (
            along[:, :, 0] if self.centre is None else along[:, :, 0] - design[:, :, self.own :] @ self.centre[shared]
        )
        error = np.where(there, (output - self.offset) / self.scale - at_zero, 0.0)
        white = (self.noise / self.scale) ** 2 / view.samples
        left_out, arm = self._left_out(view, np.linalg.norm(nominal, axis=2))
        return Seen(design, error, there, white, left_out, arm, along[:, :, :1], shared)

    def _design(
        self, view: RunView, stand: np.ndarray, felt: np.ndarray, along: np.ndarray, still: np.ndarray, shared: int
    ) -> np.ndarray:
        """Return the response of each output to each error, shape (K, R, parameters of a channel and shared ones)."""
        warm, converter = (
            (view.temperatures.get(name, np.full(view.rows, _WARM)) - _WARM) / 10
            for name in ("temperature", "converter_temperature")
        )
        in_g = (stand[:, :, 2] @ self.axes.swapaxes(1, 2)) * self.gyro[:, None, None]
        design = np.empty((len(self.channels), view.rows, self.own + shared))
        design[:, :, :3], design[:, :, 3], design[:, :, 4], design[:, :, 5] = along, 1.0, warm, warm**2
        design[:, :, 6], design[:, :, 7:10] = warm * along[:, :, 0], in_g
        design[:, :, 10], design[:, :, 11] = converter, converter**2
        design[:, :, 12] = converter * along[:, :, 0]
        for place, (a, b) in enumerate(self.squares, start=_OWN):
            design[:, :, place] = in_g[:, :, a] * in_g[:, :, b]
        place = self.own
        if view.mounting is not None:
            design[:, :, place : place + 3] = -felt @ self.across
            place += 3
        if view.table is not None:
            held = (self.axes[:, 0] @ stand).swapaxes(0, 1)  # input axes in local level, (K, R, 3)
            design[:, :, place : place + 3] = held @ np.stack([_cross(each) for each in still[:, 0]])
        return design

    def _of_run(self, along: np.ndarray, loose: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return the responses to the errors of a run alone, (K, R, q), and their standard deviations, (K, q)."""
        if not loose:
            return np.ones_like(along), self.run_offset[:, None]
        spread = np.stack([LOOSE_OFFSET * self.run_offset, [width.scale for width in self.widths]], axis=1)
        return np.concatenate([np.ones_like(along), along], axis=2), spread

    def _centred(self, view: RunView) -> tuple[RunView, np.ndarray]:
        """Return a view with its mounting, and the rotation of the axis of its table, at the centre."""
        if self.centre is None:
            return view, np.eye(3)
        if view.mounting is not None:
            view = replace(view, body_to_table=view.body_to_table @ self._at_centre(self.mountings[view.mounting]).T)
        return view, np.eye(3) if view.table is None else self._at_centre(self.tables[view.table])

    def _at_centre(self, place: int) -> np.ndarray:
        """Return the rotation of a mounting or a table at the centre."""
        if place not in self.rotated:
            self.rotated[place] = np.eye(3) if self.centre is None else _rotation(self.centre[place : place + 3])
        return self.rotated[place]

    def _shared(self, view: RunView) -> np.ndarray:
        places = [self.mountings[view.mounting]] if view.mounting is not None else []
        places += [self.tables[view.table]] if view.table is not None else []
        return np.concatenate([np.arange(0), *(np.arange(place, place + 3) for place in places)]).astype(int)

    def _left_out(self, view: RunView, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the variance of what the linear model leaves out of inputs of a size, SI, and that of lever arms."""
        arm = np.where(self.gyro[:, None], 0.0, view.largest_rate() ** 4 * LEVER_ARM**2)
        turned = np.sum(self.sd[self._shared(view)].reshape(-1, 3)[:, 0] ** 2) if self.centre is None else 0.0
        return size**2 * (self.share**2 + turned**2) + self.rest**2, arm

    def score(self, terms: NormalTerms, g_sensitivity: float | None = None, compensated: bool = False) -> float:
        """Return −2 log of the evidence, up to a constant; by default with the g-sensitivity that the gyros show.

        The outputs of a compensated unit hardly follow the temperature.
        """
        sd = self.widths_with(self.best_g_sensitivity(terms) if g_sensitivity is None else g_sensitivity)
        if compensated:
            sd[self.thermal] *= COMPENSATED
        # In units of the priors the normal matrix is the unit matrix and more, and well conditioned.
        lower = np.linalg.cholesky(np.eye(self.size) + sd[:, None] * terms.matrix * sd)
        solved = np.linalg.solve(lower, sd * terms.vector)
        return float(terms.square - solved @ solved + 2 * np.log(np.diag(lower)).sum() + terms.volume)

    def best_g_sensitivity(self, terms: NormalTerms) -> float:
        """Return the standard deviation of the g-sensitivity of most evidence, rad/s per g."""
        if not len(self.g_sensitive):
            return G_SENSITIVITIES[0]
        return min(G_SENSITIVITIES, key=lambda width: self.score(terms, width))

    def widths_with(self, g_sensitivity: float) -> np.ndarray:
        """Return the standard deviations of all errors with that of the g-sensitivity, shape (P,)."""
        sd = self.sd.copy()
        sd[self.g_sensitive] = g_sensitivity
        return sd

    def estimates(self, terms: NormalTerms) -> np.ndarray:
        """Return the estimated errors, those of mountings and tables in rad, shape (P,)."""
        return self.widths_with(self.best_g_sensitivity(terms)) * self.errors(terms)

    def errors(self, terms: NormalTerms) -> np.ndarray:
        """Return the estimated errors in units of their standard deviations, shape (P,)."""
        sd = self.widths_with(self.best_g_sensitivity(terms))
        return np.linalg.solve(np.eye(self.size) + sd[:, None] * terms.matrix * sd, sd * terms.vector)

    def misfit(self, terms: NormalTerms) -> float:
        """Return the sum of squared residuals and errors in units of their standard deviations."""
        sd = self.widths_with(G_SENSITIVITIES[-1])
        lower = np.linalg.cholesky(np.eye(self.size) + sd[:, None] * terms.matrix * sd)
        solved = np.linalg.solve(lower, sd * terms.vector)
        return float(terms.square - solved @ solved)


def _cross(vector: np.ndarray) -> np.ndarray:
    """Return the matrix C of a vector v for which a @ C is v × a."""
    x, y, z = vector
    return np.array([[0, z, -y], [-z, 0, x], [y, -x, 0]])


def _rotation(vector: np.ndarray) -> np.ndarray:
    """Return the matrix of a rotation vector, rad (Rodrigues)."""
    cross, angle = _cross(vector).T, float(np.linalg.norm(vector))
    return np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * cross @ cross


def _column(factors: float | np.ndarray) -> np.ndarray:
    return np.atleast_1d(factors)[:, None]


@dataclass(frozen=True)
class RunDrift:
    """How the outputs of one run may change with time.

    Attributes
    ----------
    courses : shape (R, q).
    sd : standard deviation of the coefficient of each course in each channel, SI, shape (K, q); 0 for none.
    """

    courses: np.ndarray
    sd: np.ndarray


@dataclass(frozen=True)
class Seen:
    """The outputs of one run beside what the model says of them.

    Attributes
    ----------
    design : response of each output to the errors of its channel and to shared ones, shape (K, R, n).
    error : of each output over its nominal input, SI, shape (K, R); 0 where there is none.
    there : whether there is an output, shape (K, R).
    white, left_out, arm : variances of the noise, of what the model leaves out and of lever arms, shape (K, R).
    along : nominal input along each input axis, shape (K, R, 1).
    shared : places of the errors of mounting and table.
    """

    design: np.ndarray
    error: np.ndarray
    there: np.ndarray
    white: np.ndarray
    left_out: np.ndarray
    arm: np.ndarray
    along: np.ndarray
    shared: np.ndarray

    def without_shared(self, errors: np.ndarray) -> "Seen":
        """Return the outputs less what errors (P,) of the mounting and the table make."""
        first = self.design.shape[2] - len(self.shared)
        made = self.design[:, :, first:] @ errors[self.shared]
        return replace(self, error=np.where(self.there, self.error - made, 0.0))


@dataclass(frozen=True)
class Weighted:
    """The normal equations of each channel in one run: (K, n, n), (K, n), (K,) and (K,)."""

    matrix: np.ndarray
    vector: np.ndarray
    square: np.ndarray
    volume: np.ndarray


def weighted(
    design: np.ndarray, error: np.ndarray, weight: np.ndarray, own: np.ndarray, spread: np.ndarray
) -> Weighted:
    """Return the normal equations of the channels in one run; the errors of each in this run alone are integrated out.

    Parameters
    ----------
    design : response to the errors that are estimated, shape (K, R, n).
    error, weight : of each output, shape (K, R).
    own : response to the errors of the run, shape (K, R, q).
    spread : their standard deviations, shape (K, q).
    """
    heavy, own = design * weight[:, :, None], own * spread[:, None, :]
    turned = own.swapaxes(1, 2)
    inner = np.eye(own.shape[2]) + turned @ (own * weight[:, :, None])
    across, at = turned @ heavy, turned @ (weight * error)[:, :, None]
    solved = np.linalg.solve(inner, np.concatenate([across, at], axis=2))
    matrix = design.swapaxes(1, 2) @ heavy - across.swapaxes(1, 2) @ solved[:, :, :-1]
    vector = np.sum(heavy * error[:, :, None], axis=1) - np.sum(solved[:, :, :-1] * at, axis=1)
    square = np.sum(weight * error**2, axis=1) - np.sum(solved[:, :, -1:] * at, axis=(1, 2))
    return Weighted(matrix, vector, square, np.linalg.slogdet(inner)[1])


def total(terms: Sequence[NormalTerms]) -> NormalTerms:
    """Return the sum of the terms of runs."""
    found = terms[0]
    for more in terms[1:]:
        found = found + more
    return found
