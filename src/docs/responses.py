"""Residuals that every effect of the catalogue leaves in the residuals of shipped campaigns, by linear algebra.

The model of a campaign has bias, scale factor, misalignment and the errors of the equipment; every other effect is a
candidate.  At the mode of that model the outputs respond linearly to all of them, as in `imubayes diagnose`.  An effect
that is not modelled leaves what the model's own parameters and the offsets of the runs do not take up.  A procedure is
judged by its own runs alone.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from imubayes.adequacy.known_noise import known_scales
from imubayes.adequacy.known_noise_fit import noise_sd
from imubayes.api.fitting import bound
from imubayes.criticism.evidence.linear_problem import typical_sizes
from imubayes.display.fit_quality_tables import run_design_text
from imubayes.foundations.campaign_data import Channel
from imubayes.foundations.covariates import COVARIATES
from imubayes.foundations.units import to_si
from imubayes.inference.experiment_design import with_planned
from imubayes.inference.fitted_model import Fit
from imubayes.model.model_file import read_model
from imubayes.model.problem import prior_widths
from imubayes.parameters.declarations import prior_slopes
from imubayes.responses.candidate_effects import Coefficient, candidate_responses
from imubayes.responses.residual_covariates import ResidualCovariate, covariates, covariates_of

ROOT = Path(__file__).parents[2]
CAMPAIGNS = {
    "full-qualification": ("polar_tumble", "thermal_ramp", "current_injection", "reference_gyro"),
    "trihedral-imu": ("rate_table", "dividing_head"),
    "multi-axis-table": ("multi_axis_table",),
    "centrifuge": ("centrifuge",),
    "servo-table": ("servo_table",),
    "rotation-modulation": ("rotation_modulation",),
    "geographic-tumble": ("geographic_tumble",),
}
"""Campaigns, the most expensive first, with the procedures that they show."""
SHOWN = 3.0
"""Standard deviations at which an effect of its largest typical size has to stand to be drawn."""
DRAWN = 30.0
"""Standard deviations at which it is drawn, so that noise is seen beside it, within the sizes met in practice."""
_OFFSET = 0.5
"""Standard deviation of the offset of a run, in noise of a raw sample: the default prior of `run_scatter`."""
_ROUNDING = 1e-10
"""Rounding error of a squared response, as a share."""
_MOSTLY = 0.5
"""Share of a response from which on a family that takes it up is one to be distinguished from."""
_ALIKE = 0.8
"""Share of what an effect leaves that another has to explain in order to imitate it."""


@dataclass(frozen=True)
class Column:
    """One coefficient of an effect for one shape, with sizes met in practice; what belongs together has one `cause`."""

    effect: str
    cause: int
    name: str
    owner: str
    unit: str
    size: float
    least: float


@dataclass(frozen=True)
class Left:
    """What an effect leaves in the runs of one procedure.

    Attributes
    ----------
    coefficient : the one that is shown best, at the size that is drawn.
    standing : standard deviations at which its largest typical size stands beside all parameters of the model.
    retained : share of its squared response that these do not take up.
    absorbed : parameter families that take up the rest, with their shares.
    imitators : effects that explain most of what it leaves, with the share.
    separating : run that distinguishes it from the first of these, and Δχ² between the two without and with that run.
    freeing : run that distinguishes it from what the model takes up most of it with, if that is half; Δχ² beside the
        model without and with that run.
    channel, unit : that is drawn, and unit of response, left and noise.
    covariate : of the abscissa.
    others : further covariates that vary in the rows.
    run : of each row.
    """

    effect: str
    procedure: str
    campaign: str
    coefficient: Column
    standing: float
    retained: float
    absorbed: tuple[tuple[str, float], ...]
    imitators: tuple[tuple[str, float], ...]
    separating: tuple[str, float, float] | None
    freeing: tuple[str, float, float] | None
    channel: str
    unit: str
    covariate: ResidualCovariate
    others: tuple[ResidualCovariate, ...]
    run: np.ndarray
    response: np.ndarray
    left: np.ndarray
    noise: np.ndarray


class LinearCampaign:
    """A campaign linearised in the parameters of a model and in all effects that it lacks, at the prior medians."""

    def __init__(self, name: str):
        self.name = name
        start = "servo-table.toml" if name == "servo-table" else "start.toml"
        spec = read_model(ROOT / "models" / start)
        kept = tuple(effect for effect in spec.effects if effect.name != "run_scatter")
        declared = bound(ROOT / "data" / name, replace(spec, effects=kept))
        at = Fit(declared, np.zeros(len(declared.layout)), np.zeros(len(declared.hyper_layout)), True)
        self.recorded = len(declared.campaign.runs)
        self.fit, planned = with_planned(at, elsewhere=True)
        self.designs = [run_design_text(each.design) for each in planned]
        self.model = self.fit.model
        responses = candidate_responses(self.fit)
        problem = self.model.problem
        self.sd = np.asarray(noise_sd(problem, known_scales(self.fit)))
        slopes = np.asarray(prior_slopes(problem.priors, jnp.asarray(self.fit.z)))
        widths = np.asarray(prior_widths(problem, jnp.asarray(self.fit.h)))
        own = responses.jacobian * widths
        columns, values = [], []
        for k, parameter in enumerate(self.model.layout.parameters):
            least, size = typical_sizes(Coefficient(parameter, ",".join(parameter.label), parameter.typical))
            owner = ",".join(parameter.label)
            columns.append(Column(parameter.effect, -1, parameter.name, owner, parameter.shown_unit, size, least))
            values.append(responses.jacobian[:, k] / slopes[k] * parameter.factor * size)
        for cause, response in enumerate(responses.candidates):
            for one, values_of_one in zip(response.coefficients, response.columns.T, strict=True):
                (least, size), known = typical_sizes(one), one.parameter
                name, unit = known.name, known.shown_unit
                columns.append(Column(response.scan.effect, cause, name, one.owner, unit, size, least))
                values.append(values_of_one * size)
        self.columns = columns
        self.families = [f"{p.effect}.{p.field}" for p in self.model.layout.parameters]
        offsets = self._offsets()
        self.families += ["run offsets"] * offsets.shape[1]
        self.absorbing = np.concatenate([own, offsets], axis=1) / self.sd[:, None]
        self.free = np.stack(values, axis=1) / self.sd[:, None]
        self.absorbing[~np.isfinite(self.absorbing)] = 0.0

    def _offsets(self) -> np.ndarray:
        entries = self.model.entries
        groups, member = np.unique(np.stack([entries.run, entries.channel]), axis=1, return_inverse=True)
        columns = np.zeros((len(entries), groups.shape[1]))
        columns[np.arange(len(entries)), member.reshape(-1)] = _OFFSET * self.sd * np.sqrt(entries.samples)
        return np.where(entries.closing[:, None], 0.0, columns)

    def rows(self, procedure: str) -> np.ndarray:
        """Return which entries belong to recorded runs of a procedure."""
        of = [run.procedure == procedure and k < self.recorded for k, run in enumerate(self.model.campaign.runs)]
        return np.array(of)[self.model.entries.run]

    @cached_property
    def covariates(self) -> list[ResidualCovariate]:
        """The covariates of all entries."""
        return covariates(self.fit)

    def left_by_all(self) -> Iterator[Left]:
        """Yield what each effect leaves in the runs of each procedure."""
        effects = dict.fromkeys(column.effect for column in self.columns)
        for procedure in CAMPAIGNS[self.name]:
            rows = self.rows(procedure)
            further = [rows | (self.model.entries.run == self.recorded + k) for k in range(len(self.designs))]
            grams = [_Gram(self, each) for each in (rows, *further)]
            for effect in effects:
                found = self._left(effect, procedure, rows, grams)
                if found is not None:
                    yield found

    def _left(self, effect: str, procedure: str, rows: np.ndarray, grams: "Sequence[_Gram]") -> Left | None:
        here = grams[0].beside(effect)
        mine = [k for k, column in enumerate(self.columns) if column.effect == effect and here.raw[k] > 0]
        if not mine:
            return None
        k = mine[int(np.argmax(here.left[mine, mine]))]
        imitators, absorbed = here.imitators(k), here.absorbed(k)
        besides = [gram.beside(effect) for gram in grams]
        separating = self._helping([each.apart(k, imitators[0][0]) for each in besides]) if imitators else None
        taken = bool(absorbed) and absorbed[0][1] >= _MOSTLY and absorbed[0][0] != "run offsets"
        freeing = self._helping([float(each.left[k, k]) for each in besides]) if taken else None
        square = max(float(here.left[k, k]), 0.0)
        column, size = self.columns[k], min(1.0, DRAWN / (math.sqrt(square) or 1.0))
        size = max(size, min(1.0, column.least / column.size))
        response, left = (size * each for each in (self.free[:, k], self.free[:, k] - self.absorbing @ here.shift(k)))
        channel, shown = self._channel(column, rows, left)
        unit, factor = _unit_of(channel, self.model.campaign.site.gravity)
        scale = self.sd[shown] / factor
        followed = left if square > 1e-6 * here.raw[k] else response
        varying = [each for each in self.covariates if each.name != "row" and _varies(each.values[shown])]
        return Left(
            effect, procedure, self.name, replace(column, size=size * column.size), math.sqrt(square),
            square / float(here.raw[k]), absorbed, imitators, separating, freeing, channel.name, unit,
            self._covariate(effect, channel.kind, shown, followed[shown], varying),
            tuple(replace(each, values=each.values[shown]) for each in varying), self.model.entries.run[shown],
            response[shown] * scale, left[shown] * scale, scale,
        )  # fmt: skip

    def _helping(self, apart: Sequence[float]) -> tuple[str, float, float] | None:
        """Return the run that adds most, and Δχ² without (the first of `apart`) and with it; None if none helps."""
        if not self.designs:
            return None
        best = int(np.argmax(apart[1:]))
        return (
            (self.designs[best], apart[0], apart[1 + best]) if apart[1 + best] > max(2 * apart[0], SHOWN**2) else None
        )

    def _channel(self, column: Column, rows: np.ndarray, left: np.ndarray) -> tuple[Channel, np.ndarray]:
        """Return the channel that is drawn, the coefficient's own or the one that shows it best, and its rows."""
        entries, channels = self.model.entries, self.model.campaign.channels
        of = [rows & ~entries.closing & (entries.channel == place) for place in range(len(channels))]
        names, power = [channel.name for channel in channels], [float(np.sum(left[each] ** 2)) for each in of]
        # A gyro that drives a table has no outputs of its own: the angle of the table shows its errors.
        own = column.owner in names and of[names.index(column.owner)].any()
        place = names.index(column.owner) if own else int(np.argmax(power))
        return channels[place], of[place]

    def _covariate(
        self, effect: str, kind: str, shown: np.ndarray, drawn: np.ndarray, varying: Sequence[ResidualCovariate]
    ) -> ResidualCovariate:
        """Return the covariate that the rows shown follow best: of those of the formula, if they vary."""
        member, row = self.model.registry.effects[effect], np.arange(int(shown.sum()), dtype=float)
        formula = covariates_of(member, kind) if kind in member.kinds else ()
        named = set().union(*formula) | {COVARIATES[need].column for need in member.needs if need in COVARIATES}
        candidates = [each for each in varying if each.name in named] or varying
        best = max(candidates, key=lambda each: _followed(each.values[shown], drawn), default=None)
        if best is None:
            return ResidualCovariate("row", "", row, "row")
        return replace(best, values=best.values[shown])


class _Gram:
    """Scalar products of all columns over some rows, noise divided out, the model's parameters with their priors."""

    def __init__(self, of: LinearCampaign, rows: np.ndarray):
        self.of = of
        absorbing, free = of.absorbing[rows], of.free[rows]
        self.own = absorbing.T @ absorbing + np.eye(absorbing.shape[1])
        self.across, self.products = absorbing.T @ free, free.T @ free
        self._whole: _Beside | None = None

    def beside(self, effect: str) -> "_Beside":
        """Return what the columns leave beside the model without an effect, if that is its own."""
        own = np.array([not family.startswith(f"{effect}.") for family in self.of.families])
        if not own.all():
            return _Beside(self, own)
        self._whole = self._whole or _Beside(self, own)
        return self._whole


class _Beside:
    def __init__(self, gram: _Gram, own: np.ndarray):
        self.of, self.own = gram.of, own
        self.across = gram.across[own]
        self.shifts = np.linalg.solve(gram.own[np.ix_(own, own)], self.across)
        self.raw = np.diag(gram.products)
        self.left = gram.products - self.across.T @ self.shifts
        self.left[np.diag(self.left) < _ROUNDING * self.raw] = 0.0

    def shift(self, k: int) -> np.ndarray:
        whole = np.zeros(len(self.own))
        whole[self.own] = self.shifts[:, k]
        return whole

    def absorbed(self, k: int) -> tuple[tuple[str, float], ...]:
        """Return the families that take up most of a response; shares are of the response, those below 0 left out."""
        shares: dict[str, float] = {}
        families = [family for family, own in zip(self.of.families, self.own, strict=True) if own]
        for family, share in zip(families, self.shifts[:, k] * self.across[:, k] / self.raw[k], strict=True):
            shares[family] = shares.get(family, 0.0) + float(share)
        whole = sum(share for share in shares.values() if share > 0) or 1.0
        taken = (1 - self.left[k, k] / self.raw[k]) / whole
        found = [(family, taken * share) for family, share in shares.items() if taken * share >= 0.02]
        return tuple(sorted(found, key=lambda each: -each[1])[:3])

    def _explained(self, k: int, other: Sequence[int]) -> float:
        places = list(other)
        across = self.left[places, k]
        return float(across @ np.linalg.solve(self.left[np.ix_(places, places)] + np.eye(len(places)), across))

    def _causes(self, effect: str) -> list[list[int]]:
        found: dict[int, list[int]] = {}
        for place, column in enumerate(self.of.columns):
            if column.effect == effect and column.cause >= 0:
                found.setdefault(column.cause, []).append(place)
        return list(found.values())

    def imitators(self, k: int) -> tuple[tuple[str, float], ...]:
        if self.left[k, k] < SHOWN**2:
            return ()
        others = dict.fromkeys(
            c.effect for c in self.of.columns if c.cause >= 0 and c.effect != self.of.columns[k].effect
        )
        shares = [
            (name, max(self._explained(k, each) for each in self._causes(name)) / self.left[k, k]) for name in others
        ]
        return tuple(sorted((each for each in shares if each[1] >= _ALIKE), key=lambda each: -each[1])[:3])

    def apart(self, k: int, other: str) -> float:
        return max(0.0, self.left[k, k] - max(self._explained(k, each) for each in self._causes(other)))


def _unit_of(channel: Channel, gravity: float) -> tuple[str, float]:
    """Return the unit in which a channel's residuals are drawn, and that unit in output units."""
    if channel.kind == "gyro":
        return "deg/h", abs(channel.scale_si) * to_si("deg/h")
    if channel.kind == "accelerometer":
        return "µg", abs(channel.scale_si) * to_si("ug", gravity)
    return "arcsec", 1 / 3600


def _varies(x: np.ndarray) -> bool:
    known = x[np.isfinite(x)]
    return len(known) > 0.9 * len(x) and float(np.ptp(known)) > 1e-6 * float(np.abs(known).max())


def _followed(x: np.ndarray, y: np.ndarray) -> float:
    """Return the share of the variance of y between levels of x, less what chance gives."""
    known = np.isfinite(x)
    x, y = x[known], y[known] - y[known].mean()
    order = np.argsort(x, kind="stable")
    parts = [part for part in np.array_split(y[order], min(12, max(3, len(x) // 4))) if len(part)]
    between = sum(len(part) * part.mean() ** 2 for part in parts)
    whole = float(y @ y)
    return (
        (between - len(parts) * max(whole - between, 0.0) / max(len(y) - len(parts), 1)) / whole if whole > 0 else 0.0
    )
