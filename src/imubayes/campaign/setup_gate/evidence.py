"""Evidence of the recorded outputs for a set-up: a linear Gaussian model of everything that may err in a valid one.

Output over nominal scale factor, less the nominal input u along the input axis I, is

    e = (δk u·I + α u·O + β u·S) + b + b_r + c·T + …  + δ_m·(u × I) + τ_t·(v × C I) + noise,

with errors of scale factor and input axis, a bias, one offset per run, slopes with the temperatures, for gyros a
g-sensitivity, a small rotation of every mounting and of every table.  All have Gaussian priors (`error_model`), so
the marginal likelihood is in closed form.  Every run adds a term to the normal equations, and a suspected mistake
changes the terms of the runs that it concerns: one evaluation is the solution of some hundred equations.

The rotations are linear in δ and τ about zero, or about a `centre`, their estimates in the set-up as stated.  About
zero their squares are left out, and count with what else a linear model leaves out.
"""

import copy
import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from imubayes.campaign.setup_gate.error_model import (
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
    NormalTerms,
    Numbers,
    Steadiness,
    weighted,
    widths,
)
from imubayes.campaign.setup_gate.setup_view import (
    RunView,
    changed,
    feels_the_earth_alone,
    in_body,
    stacked,
    views_of,
)
from imubayes.campaign.unit_grade import grade_of
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.numerics import cross_matrices

# Parameters of a channel: scale, two misalignments, bias, three of the temperature, three of g-sensitivity, three of
# the converter's temperature (as many as of the sensor's, or a curve would show that the thermometers are exchanged);
# of gyros that feel the Earth rate alone six terms quadratic in g, of which every tumble makes the same pattern.
_OWN, _SQUARES = 13, ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))
_OF_TEMPERATURE = (4, 5, 6, 10, 11, 12)
_WARM = 25.0
_AT_ONCE = 2**15  # responses of outputs to errors in views that are evaluated together: they stay in the cache


@dataclass(frozen=True)
class ErrorFit:
    """How well the errors of the model explain outputs, with each of several g-sensitivities, (..., G).

    Attributes
    ----------
    misfit : sum of squared residuals and errors in units of their standard deviations.
    score : −2 log of the evidence, up to a constant.
    """

    misfit: np.ndarray
    score: np.ndarray


class ErrorModel:
    """The linear model of plausible errors of one campaign.

    Parameters
    ----------
    gross : whether missing effects may be large.
    steadiness : of the channels, over that of a poor unit.
    centre : errors about which the model is linear, shape (P,); those of mountings and tables count, None is zero.
    """

    def __init__(
        self, campaign: Campaign, gross: bool = False, steadiness: Steadiness = POOR, centre: np.ndarray | None = None
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
        self.g_sensitive, self.quadratic = self._terms_of_g()

    def _terms_of_g(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the places of the terms of g of the gyros, and which of them are quadratic, each (n,)."""
        gyro = [k for k, channel in enumerate(self.channels) if channel.kind == "gyro"]
        each = np.array([*range(7, 10), *range(_OWN, self.own)])
        places = np.add.outer(self.own * np.array(gyro, dtype=int), each)
        return places.ravel(), np.broadcast_to(each >= _OWN, places.shape).ravel()

    def as_steady_as(self, steadiness: Steadiness) -> "ErrorModel":
        """Return the model of a unit of another steadiness."""
        found = copy.copy(self)
        found._stack(steadiness)
        return found

    def _stack(self, steadiness: Steadiness) -> None:
        """Set the facts about the channels as arrays: gyro and run_offset (K,), others (K, 1)."""
        self.gyro = np.array([channel.kind == "gyro" for channel in self.channels])
        self.offset = np.array([[channel.offset] for channel in self.channels])
        self.scale = np.array([[channel.scale_si] for channel in self.channels])
        self.noise = np.array([[channel.noise or 0.0] for channel in self.channels]) * _column(steadiness.noise)
        rows = _column(steadiness.rows)
        self.share = np.array([[width.share] for width in self.widths]) * rows
        gross = [GROSS[channel.kind] if self.gross else 0.0 for channel in self.channels]
        self.rest = np.hypot(np.array([[width.rest] for width in self.widths]) * rows, np.array(gross)[:, None])
        self.run_offset = np.array([width.offset for width in self.widths]) * steadiness.runs

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

    def seen_in_parts(self, views: Sequence[RunView]) -> Iterator[tuple[list[int], "Seen"]]:
        """Yield the places of views of one shape, and what is seen of them together."""
        alike: dict[tuple[int | bool, ...], list[int]] = {}
        for place, view in enumerate(views):
            # The motion of outer axes is integrated for each view.
            alike.setdefault(view.shape if view.outer is None else (-place,), []).append(place)
        for places in alike.values():
            most = _AT_ONCE // (len(self.channels) * views[places[0]].rows * self.own)
            for some in itertools.batched(places, max(1, most)):
                yield list(some), self.seen_together([views[k] for k in some])

    def seen_of(self, views: Sequence[RunView]) -> list["Seen"]:
        """Return what is seen of each view."""
        found = {at: part[k] for places, part in self.seen_in_parts(views) for k, at in enumerate(places)}
        return [found[at] for at in range(len(views))]

    def terms_of_parts(self, count: int, parts: Iterable[tuple[list[int], "Seen"]]) -> NormalTerms:
        """Return what each of so many views adds to the normal equations."""
        moments, volume, values = np.empty((count, self.size + 1, self.size + 1)), np.empty(count), np.empty(count)
        for at, seen in parts:
            made = self.terms_of(seen)
            moments[at], volume[at], values[at] = made.moments, made.volume, made.values
        return NormalTerms(moments, volume, values)

    def terms_of(self, seen: "Seen", loose: bool = False, drift: "RunDrift | None" = None) -> NormalTerms:
        """Return what the outputs of a run add to the normal equations.

        The outputs may drift; of a loose run bias and scale factor are its own.
        """
        variance = self.white(seen) + self.left_out(seen) + seen.unknown
        weight = np.where(seen.there, 1 / variance, 0.0)
        own, spread = self._of_run(seen.along, loose)
        if drift is not None:
            courses = np.broadcast_to(drift.courses, (len(own), *drift.courses.shape))
            own, spread = np.concatenate([own, courses], axis=2), np.concatenate([spread, drift.sd], axis=1)
        found = weighted(seen.design, seen.error, weight, own, spread)
        volume = np.sum(np.log(variance), axis=(-2, -1), where=seen.there) + found.volume.sum(axis=-1)
        return NormalTerms(self._placed(found.moments, seen.shared), volume, seen.there.sum(axis=(-2, -1)))

    def _placed(self, moments: np.ndarray, shared: np.ndarray) -> np.ndarray:
        """Return the moments of channels, (..., K, n + 1, n + 1), at the places of their errors and shared ones."""
        batch, each = moments.shape[:-3], self.own
        moments = moments.reshape(-1, *moments.shape[-3:])
        channels = np.arange(each * len(self.channels)).reshape(-1, each)
        shared = shared.reshape(len(moments), -1)
        rest = np.concatenate([shared, np.full((len(shared), 1), self.size)], axis=1)
        placed = np.zeros((len(moments), self.size + 1, self.size + 1))
        placed[:, channels[:, :, None], channels[:, None, :]] = moments[:, :, :each, :each]
        across = moments[:, :, :each, each:].reshape(len(moments), channels.size, -1)
        run, own = np.arange(len(moments))[:, None, None], channels.ravel()
        placed[run, own[:, None], rest[:, None, :]] = across
        placed[run, rest[:, :, None], own] = across.swapaxes(1, 2)
        placed[run, rest[:, :, None], rest[:, None, :]] = moments[:, :, each:, each:].sum(axis=1)
        return placed.reshape(*batch, *placed.shape[1:])

    def seen(self, view: RunView) -> "Seen":
        """Return the errors of the outputs of a run and their response to the errors of the model."""
        return self.seen_together([view])[0]

    def seen_together(self, views: Sequence[RunView]) -> "Seen":
        """Return the same of several views of one shape, with a first axis for the view."""
        (view, tilted), shared = self._centred(views), self._shared(views)
        stand = view.local_to_body(tilted)
        up, earth = view.up(), view.earth_rate()
        force, rate = in_body(stand, up), view.rate_in_body(stand)
        nominal = np.where(self.gyro[:, None, None], rate[..., None, :, :], force[..., None, :, :])
        response = view.response[..., self.places, None, None]
        felt = nominal * response  # of each channel, (..., K, R, 3)
        axes = view.axes[..., self.places, :, :]
        along = felt @ axes.swapaxes(-2, -1)
        along = np.broadcast_to(along, (len(views), *along.shape[-3:]))
        still = np.where(self.gyro[:, None], earth[..., None, :], up[..., None, :]) * response[..., 0]
        design = self._design(view, axes, stand, felt, along, still, shared.shape[1])
        output = view.observed[..., self.places].swapaxes(-2, -1)
        there = np.isfinite(output)
        at_zero = along[..., 0]
        if self.centre is not None:
            at_zero = at_zero - (design[..., self.own :] @ self.centre[shared][:, None, :, None])[..., 0]
        error = np.where(there, (output - self.offset) / self.scale - at_zero, 0.0)
        level = np.asarray(view.unknown_level_rate)[..., None, None]
        unknown = np.where(self.gyro[:, None], level**2, view.largest_rate()[..., None, :] ** 4 * LEVER_ARM**2)
        there, samples, square, unknown = (
            np.broadcast_to(each, along.shape[:-1])
            for each in (there, view.samples[..., None, :], np.sum(nominal**2, axis=-1), unknown)
        )
        turned = np.sum(self.sd[shared[:, ::3]] ** 2, axis=1) if self.centre is None else np.zeros(len(shared))
        return Seen(design, error, there, samples, square, turned, unknown, along[..., :1], shared)

    def white(self, seen: "Seen") -> np.ndarray:
        """Return the variance of the noise of outputs, SI, shape (..., K, R)."""
        return (self.noise / self.scale) ** 2 / seen.samples

    def left_out(self, seen: "Seen") -> np.ndarray:
        """Return the variance of what the linear model leaves out of outputs, SI, shape (..., K, R)."""
        return seen.square * (self.share**2 + np.asarray(seen.turned)[..., None, None] ** 2) + self.rest**2

    def _design(
        self, view: RunView, axes: np.ndarray, stand: np.ndarray, felt: np.ndarray, along: np.ndarray,
        still: np.ndarray, shared: int,
    ) -> np.ndarray:  # fmt: skip
        """Return the response of outputs to errors, shape (B, K, R, parameters of a channel and shared ones)."""
        warm, converter = (
            ((view.temperatures[name] - _WARM) / 10)[..., None, :] if name in view.temperatures else 0.0
            for name in ("temperature", "converter_temperature")
        )
        in_g = (stand[..., None, :, :, 2] @ axes.swapaxes(-2, -1)) * self.gyro[:, None, None]
        design = np.empty((*along.shape[:-1], self.own + shared))
        design[..., :3], design[..., 3], design[..., 4], design[..., 5] = along, 1.0, warm, warm**2
        design[..., 6], design[..., 7:10] = warm * along[..., 0], in_g
        design[..., 10], design[..., 11] = converter, converter**2
        design[..., 12] = converter * along[..., 0]
        for place, (a, b) in enumerate(self.squares, start=_OWN):
            design[..., place] = in_g[..., a] * in_g[..., b]
        place = self.own
        if view.mounting is not None:
            design[..., place : place + 3] = -felt @ cross_matrices(axes[..., 0, :])
            place += 3
        if view.table is not None:
            held = np.einsum("...kj,...rji->...kri", axes[..., 0, :], stand)  # input axes in local level
            design[..., place : place + 3] = held @ cross_matrices(still)
        return design

    def _of_run(self, along: np.ndarray, loose: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return the responses to the errors of a run alone, (..., K, R, q), and their standard deviations, (K, q)."""
        if not loose:
            return np.ones_like(along), self.run_offset[:, None]
        spread = np.stack([LOOSE_OFFSET * self.run_offset, [width.scale for width in self.widths]], axis=1)
        return np.concatenate([np.ones_like(along), along], axis=-1), spread

    def _centred(self, views: Sequence[RunView]) -> tuple[RunView, np.ndarray | None]:
        """Return views as one with mountings at the centre, and the rotations of the axes of their tables (B, 3, 3)."""
        view = stacked(views)
        if self.centre is None:
            return view, None
        mounted = np.stack([self._at_centre(self.mountings.get(each.mounting or "")) for each in views])
        tilted = np.stack([self._at_centre(self.tables.get(each.table or "")) for each in views])
        return changed(view, body_to_table=view.body_to_table @ mounted.swapaxes(1, 2)), tilted

    def _at_centre(self, place: int | None) -> np.ndarray:
        """Return the rotation of a mounting or a table at the centre; none if there is no such place."""
        if place is None or self.centre is None:
            return np.eye(3)
        if place not in self.rotated:
            self.rotated[place] = rotation(self.centre[place : place + 3])
        return self.rotated[place]

    def _shared(self, views: Sequence[RunView]) -> np.ndarray:
        """Return the places of the errors of mountings and tables of views of one shape, (B, m)."""
        places = [[self.mountings[view.mounting] for view in views if view.mounting is not None]]
        places.append([self.tables[view.table] for view in views if view.table is not None])
        starts = np.array([each for each in places if each], dtype=int).reshape(-1, len(views)).T
        return np.add.outer(starts, np.arange(3)).reshape(len(views), -1)

    def fit(
        self, terms: NormalTerms, g_sensitivities: Sequence[float] = G_SENSITIVITIES, compensated: bool = False
    ) -> ErrorFit:
        """Return how well the errors of the model explain outputs, with each of some g-sensitivities, rad/s per g.

        The outputs of a compensated unit hardly follow the temperature.
        """
        last = [*self.g_sensitive, self.size]
        order = np.append(np.delete(np.arange(self.size + 1), last), last)
        count = len(order) - len(last)
        sd = np.append(self.sd, 1.0)
        sd[last] = 1.0
        if compensated:
            sd[self.thermal] *= COMPENSATED
        # In units of the priors the normal matrix is the unit matrix and more, and well conditioned.
        scaled = terms.moments[..., order[:, None], order]
        scaled *= np.multiply.outer(sd, sd)[order[:, None], order]
        bordering = scaled[..., count:, count:].copy()
        # The factor of the first errors does not depend on the last block, as long as there is one.
        enough = 1 + 2 * np.sum(scaled[..., :count, count:] ** 2, axis=(-2, -1))
        scaled[..., count:, count:] = enough[..., None, None] * np.eye(len(last))
        scaled[..., range(count), range(count)] += 1.0
        lower = np.linalg.cholesky(scaled)
        across = lower[..., count:, :count]
        left = (bordering - across @ across.swapaxes(-2, -1))[..., None, :, :]
        variance = np.square(self._widths_of_g(np.asarray(g_sensitivities)))[:, :, None]
        inner = np.eye(len(last) - 1) + variance * left[..., :-1, :-1]
        rest = left[..., :-1, -1:]
        solved = np.linalg.solve(inner, variance * rest)
        misfit = left[..., -1, -1] - np.sum(rest * solved, axis=(-2, -1))
        known = 2 * np.log(np.diagonal(lower, axis1=-2, axis2=-1)[..., :count]).sum(axis=-1) + terms.volume
        return ErrorFit(misfit, misfit + np.linalg.slogdet(inner)[1] + known[..., None])

    def score(self, terms: NormalTerms, g_sensitivity: float | None = None, compensated: bool = False) -> Numbers:
        """Return −2 log of the evidence, up to a constant; by default with the g-sensitivity that the gyros show."""
        tried = G_SENSITIVITIES if g_sensitivity is None else (g_sensitivity,)
        return self.fit(terms, tried, compensated).score.min(axis=-1)

    def best_g_sensitivity(self, terms: NormalTerms) -> float:
        """Return the standard deviation of the g-sensitivity of most evidence, rad/s per g."""
        return G_SENSITIVITIES[int(np.argmin(self.fit(terms).score))]

    def widths_with(self, g_sensitivity: float) -> np.ndarray:
        """Return the standard deviations of all errors with that of the g-sensitivity, shape (P,)."""
        sd = self.sd.copy()
        sd[self.g_sensitive] = self._widths_of_g(np.array([g_sensitivity]))[0]
        return sd

    def _widths_of_g(self, g_sensitivities: np.ndarray) -> np.ndarray:
        """Return the standard deviations of the terms of g with each of G sensitivities, shape (G, n).

        A gyro that g hardly moves has no larger quadratic terms.
        """
        each = g_sensitivities[:, None]
        return np.where(self.quadratic, np.minimum(each, G_SQUARED), each)

    def estimates(self, terms: NormalTerms) -> np.ndarray:
        """Return the estimated errors, those of mountings and tables in rad, shape (P,)."""
        sd = self.widths_with(self.best_g_sensitivity(terms))
        return sd * self._errors(terms, sd)

    def errors(self, terms: NormalTerms) -> np.ndarray:
        """Return the estimated errors in units of their standard deviations, shape (P,)."""
        return self._errors(terms, self.widths_with(self.best_g_sensitivity(terms)))

    def _errors(self, terms: NormalTerms, sd: np.ndarray) -> np.ndarray:
        matrix, vector = terms.moments[:-1, :-1], terms.moments[:-1, -1]
        return np.linalg.solve(np.eye(self.size) + sd[:, None] * matrix * sd, sd * vector)

    def misfit(self, terms: NormalTerms) -> Numbers:
        """Return the sum of squared residuals and errors in units of their standard deviations."""
        return self.fit(terms, G_SENSITIVITIES[-1:]).misfit[..., 0]


def rotation(vector: np.ndarray) -> np.ndarray:
    """Return the matrix of a rotation vector, rad (Rodrigues)."""
    cross, angle = cross_matrices(vector).T, float(np.linalg.norm(vector))
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
    """The outputs of one run, or with a first axis of several views, beside what the model says of them.

    Attributes
    ----------
    design : response of each output to the errors of its channel and to shared ones, shape (..., K, R, n).
    error : of each output over its nominal input, SI, shape (..., K, R); 0 where there is none.
    there : whether there is an output, shape (..., K, R).
    samples, square : that a row is the mean of, and squared nominal input, SI, shape (..., K, R).
    turned : plausible square of the rotations of mounting and table about which the model is not linear, (...).
    unknown : variance of what lever arms do, or an azimuth that nobody stated, shape (..., K, R).
    along : nominal input along each input axis, shape (..., K, R, 1).
    shared : places of the errors of mounting and table, shape (..., m).
    """

    design: np.ndarray
    error: np.ndarray
    there: np.ndarray
    samples: np.ndarray
    square: np.ndarray
    turned: Numbers
    unknown: np.ndarray
    along: np.ndarray
    shared: np.ndarray

    def __getitem__(self, place: int) -> "Seen":
        return Seen(**{each.name: getattr(self, each.name)[place] for each in fields(self)})

    def without_row(self, row: int) -> "Seen":
        """Return the outputs of a run without those of a row."""
        there = self.there & (np.arange(self.there.shape[-1]) != row)
        return replace(self, there=there, error=np.where(there, self.error, 0.0))

    def without_shared(self, errors: np.ndarray) -> "Seen":
        """Return the outputs less what errors (P,) of the mounting and the table make."""
        first = self.design.shape[-1] - self.shared.shape[-1]
        made = (self.design[..., first:] @ errors[self.shared][..., None, :, None])[..., 0]
        return replace(self, error=np.where(self.there, self.error - made, 0.0))
