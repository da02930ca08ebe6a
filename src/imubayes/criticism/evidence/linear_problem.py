"""The fit as one linear model: residual, Jacobian and the responses of all candidates, at the noise known beforehand.

    r = J t + X b + F c + e

t are the model's own parameters with their priors, b the coefficients of missing effects, c a free form, e the noise.
Rows are divided by the independent noise that was known before the fit, as raw samples, priors or the campaign
determine it, so that a scale of 1 is the noise as known; what correlates rows is a matter of the hypothesis.  The
closing rotations of a free tumble are rows as well: turns show what poses at rest do not, such as the misalignment of a
gyro.  Nothing is projected out: parameters are coefficients with priors like all others, and noise may change between
hypotheses. Coefficients of effects count in their largest typical sizes.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from imubayes.adequacy.known_noise import known_scales, noise_scales, sample_noise
from imubayes.criticism.evidence.row_correlation import RowCorrelation, correlations_of
from imubayes.foundations.campaign_data import Kind
from imubayes.foundations.tail_probabilities import normal_survival
from imubayes.inference.fitted_model import Fit
from imubayes.model.bind import Model
from imubayes.model.noise_covariance import noise_distribution
from imubayes.model.problem import Problem, prior_widths
from imubayes.noise.components import Noise, SeriesNoise, SharedNoise, TailNoise, WhiteNoise
from imubayes.noise.hand_components import CarriedClosure, RotationClosure
from imubayes.responses.candidate_effects import Coefficient, Response, Responses

BELIEVED = 0.03
"""Standard deviation of the logarithm of a noise scale that raw samples determine.  Calibrated on complete shipped
models: rounding of the recorded deviations and a stimulus that varies a little within rows stay within it."""
UNKNOWN = 0.7
"""The same of a scale that nothing determines: a factor of two either way."""
_PRIOR_Z = np.array([-2.0, -1.0, 0.0, 1.0, 2.0, 3.0, 4.0])
"""Places of the prior of a noise scale, in its standard deviations, that stand for it.  Numerical."""
UNEXPECTED = 0.1
"""Prior probability of what neither model nor catalogue foresees: in a kind of channel other noise than stated, or
scatter unlike that of sister channels; a form outside the catalogue or a wrong input, half each.  Calibrated: complete
models keep "nothing missing", and foreign causes are reported as such."""
SAME_LEVEL = 0.02
"""Share of its range, or of its largest size, within which a covariate is at one level: scatter about a set point."""
NEGLIGIBLE = float(np.sqrt(np.finfo(float).eps))
"""Rounding error of a sum of squares, as a share.  Derived."""

Grid = tuple[tuple[float, float], ...]
"""Sizes that a prior allows, with the logarithm of the probability of each."""
RowKind = Kind | Literal["closure"]


@dataclass(frozen=True)
class ChannelRows:
    """The rows of a channel in order of run and time, divided by the noise known beforehand.

    The closing rotations of a run are such rows, its components one after the other; they have no input.

    Attributes
    ----------
    name, kind : of the channel.
    live : shape (L,), which columns of [J X] this channel responds to.
    columns : shape (n, L + 1), those columns, the residual last.
    entry : shape (n,), entry of each row.
    series : start and length of each run.
    root : shape (n,), noise of the median row over that of each: the response to an offset of the outputs of one
        standard deviation of its noise.
    input : shape (n,), predicted output less the nominal offset, over its largest magnitude.
    scale_sd : standard deviation of the logarithm of the noise scale, as known.
    run_scatter : standard deviations of offsets of runs that the model's prior allows, in units of the noise of a row,
        with the logarithm of the probability of each; empty of a model without them.
    tails : degrees of freedom of heavy tails that the model's prior allows, likewise.
    correlations : correlation in time that the model states, at each size that its prior allows.
    noise : of the median row, at the input, rad/s or m/s²; 0 if it is not known.
    runs : run of each of `series`; empty if it is not known, as of closing rotations.
    """

    name: str
    kind: RowKind
    live: np.ndarray
    columns: np.ndarray
    entry: np.ndarray
    series: tuple[tuple[int, int], ...]
    root: np.ndarray
    input: np.ndarray
    scale_sd: float
    run_scatter: Grid
    tails: Grid = ()
    correlations: tuple[RowCorrelation, ...] = ()
    noise: float = 0.0
    runs: tuple[int, ...] = ()

    @property
    def input_varies(self) -> bool:
        """Whether what depends on the input can be distinguished from what does not."""
        size = np.abs(self.input)
        return len(size) > 0 and float(np.ptp(size)) > SAME_LEVEL


@dataclass(frozen=True)
class LinearProblem:
    """A linearised fit with the responses of its candidates.

    Attributes
    ----------
    candidates : one response per effect and shape; their coefficients are the columns X in this order.
    runs : of the campaign, in its order.
    run : shape (E,), run of each entry.
    precision, pull : shape (P,), of the priors of the model's own parameters about the fit, and precision × mean.
    root : shape (E,), one over the noise of each entry as known, output units.
    rows : one of each channel in the order of the campaign, then one of the closing rotations of each run with turns.
    """

    candidates: tuple[Response, ...]
    runs: tuple[str, ...]
    run: np.ndarray
    precision: np.ndarray
    pull: np.ndarray
    root: np.ndarray
    rows: tuple[ChannelRows, ...]

    @property
    def own(self) -> int:
        """The number P of the model's own parameters."""
        return len(self.precision)

    @cached_property
    def coefficients(self) -> tuple[Coefficient, ...]:
        """All C coefficients, in the order of the columns."""
        return tuple(each for response in self.candidates for each in response.coefficients)

    @cached_property
    def sizes(self) -> np.ndarray:
        """The largest typical size of each coefficient, (C,), in its unit: what the columns count in."""
        return np.array([typical_sizes(each)[1] for each in self.coefficients])

    @cached_property
    def of_channels(self) -> tuple[ChannelRows, ...]:
        """The rows of the channels, without closing rotations."""
        return tuple(each for each in self.rows if each.kind != "closure")

    @cached_property
    def sign(self) -> np.ndarray:
        """The only sign that each coefficient may have, (C,); 0 for either."""
        return np.array([each.sign for each in self.coefficients], dtype=int)

    @property
    def outputs(self) -> int:
        """The number of outputs that count."""
        return sum(len(each.entry) for each in self.rows)

    @cached_property
    def shown(self) -> np.ndarray:
        """Which coefficients any row responds to, (C,) bool."""
        found = np.zeros(self.own + len(self.coefficients), dtype=bool)
        for rows in self.rows:
            found[rows.live] = True
        return found[self.own :]


def typical_sizes(coefficient: Coefficient) -> tuple[float, float]:
    """Return the smallest and the largest typical size of a coefficient: if no one states them, of its prior."""
    least, largest = coefficient.typical
    if not np.isfinite(largest) or largest <= 0:
        largest = coefficient.parameter.prior_sd
        largest = largest if np.isfinite(largest) and largest > 0 else 1.0
    return min(least, largest), largest


def linear_problem(fitted: Fit, responses: Responses) -> LinearProblem:
    """Return a converged fit as a linear model with candidates."""
    model, problem = fitted.model, fitted.model.problem
    h = known_scales(fitted, correlated=True)
    typical = np.array([typical_sizes(each)[1] for one in responses.candidates for each in one.coefficients])
    candidates = [each.columns for each in responses.candidates]
    free = np.concatenate(candidates, axis=1) * typical if candidates else np.zeros((len(responses.misfit), 0))
    whole = np.concatenate([responses.jacobian, free, responses.misfit[:, None]], axis=1)
    own = noise_distribution(problem, h).squared_scale
    root = problem.observations.weight / np.sqrt(own)
    width = prior_widths(problem, fitted.h)
    at = _At(model, whole, root, _noise_sizes(problem, _PRIOR_Z))
    parts = [_in_order(model, k) for k in range(len(model.campaign.channels))]
    entries = [np.concatenate([*each, np.zeros(0, dtype=int)]).astype(int) for each in parts]
    correlations = correlations_of(fitted, h, dict(enumerate(entries)), own)
    rows = [_rows_of(at, k, parts[k], entry, correlations.get(k, ())) for k, entry in enumerate(entries)]
    return LinearProblem(
        responses.candidates, tuple(run.name for run in model.campaign.runs), model.entries.run, width**-2.0,
        -fitted.z * width**-2.0, root, (*rows, *_closing_rows(at)),
    )  # fmt: skip


@dataclass(frozen=True)
class _At:
    """The columns [J X misfit] of all entries in output units, one over their noise, and the prior of noise scales."""

    model: Model
    columns: np.ndarray
    root: np.ndarray
    sizes: np.ndarray


def _in_order(model: Model, channel: int) -> list[np.ndarray]:
    """Return the entries of each run of a channel that count, in order of time."""
    entries, observations = model.entries, model.problem.observations
    used = (np.asarray(observations.weight) > 0) & ~entries.closing & (entries.channel == channel)
    padded = np.append(used, np.zeros(1, dtype=bool))
    parts = [group[padded[group]] for group in np.asarray(observations.in_time)]
    return sorted((part for part in parts if len(part)), key=lambda part: int(entries.run[part[0]]))


def _rows_of(
    at: _At, channel: int, parts: list[np.ndarray], entry: np.ndarray, correlations: tuple[RowCorrelation, ...]
) -> ChannelRows:
    model, root, own = at.model, at.root[entry], at.model.campaign.channels[channel]
    ends = np.cumsum([0, *map(len, parts)]).tolist()
    misfit = at.columns[entry, -1]
    live, columns = _responding(at, entry)
    noise = 1 / float(np.median(root)) if len(entry) else 1.0
    value = model.entries.value[entry] - misfit - own.offset
    scatter = [(tau / noise, log_p) for tau, log_p in _prior_grid(at, channel, SharedNoise)]
    return ChannelRows(
        name=own.name,
        kind=own.kind,
        live=live,
        columns=columns,
        entry=entry,
        series=tuple(zip(ends[:-1], np.diff(ends).tolist(), strict=True)),
        root=root * noise,
        input=value / max(float(np.abs(value).max(initial=0.0)), np.finfo(float).tiny),
        scale_sd=_scale_sd(model, channel, at.sizes),
        run_scatter=tuple(scatter),
        tails=_prior_grid(at, channel, TailNoise),
        correlations=correlations,
        noise=abs(noise / own.scale_si) if own.kind != "angle" else 0.0,
        runs=tuple(int(model.entries.run[part[0]]) for part in parts),
    )


def _closing_rows(at: _At) -> Iterator[ChannelRows]:
    """Yield the closing rotations of each run, rad, whose model has their noise."""
    entries, parameters = at.model.entries, noise_scales(at.model)
    used = (np.asarray(at.model.problem.observations.weight) > 0) & entries.closing & np.isfinite(at.root)
    for k, run in enumerate(at.model.campaign.runs):
        entry = np.flatnonzero(used & (entries.run == k))
        own = (p for p, (each, kind, _) in enumerate(parameters)
               if (issubclass(kind, RotationClosure) and run.name in each.label)
               or (issubclass(kind, CarriedClosure) and run.tumble is not None and run.tumble.carried))  # fmt: skip
        place = next(own, None)
        if not len(entry) or place is None:
            continue
        entry = entry[np.lexsort((entries.channel[entry], entries.row[entry]))]
        live, columns = _responding(at, entry)
        low, high = at.sizes[[1, 3], place].tolist()
        yield ChannelRows(
            name=f"closing rotations of {run.name}", kind="closure", live=live, columns=columns, entry=entry,
            series=((0, len(entry)),), root=np.ones(len(entry)), input=np.zeros(len(entry)),
            scale_sd=0.5 * float(np.log(high / low)), run_scatter=(),
        )  # fmt: skip


def _responding(at: _At, entry: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return which columns entries respond to, (L,), and these over the noise of each, the residual last."""
    own = at.root[entry][:, None] * at.columns[entry]
    live = np.flatnonzero(np.linalg.norm(own[:, :-1], axis=0) > NEGLIGIBLE)
    return live, own[:, [*live, own.shape[1] - 1]]


def _scale_sd(model: Model, channel: int, sizes: np.ndarray) -> float:
    """Return how well the noise of a channel is known: the standard deviation of its logarithm.

    If the whole noise is correlated from row to row, so are the samples, and their scatter does not determine it.  Nor
    do they determine the motion of a hand, which rows in motion average.
    """
    kind = model.campaign.channels[channel].kind
    if any(
        issubclass(member, Noise) and member.of_motion and kind in member.kinds for _, member, _ in noise_scales(model)
    ):
        return UNKNOWN
    samples, correlated = sample_noise(model).get(channel), _scale(model, channel, SeriesNoise) is not None
    if samples is not None and not samples.varying and not correlated:
        return float(np.hypot(BELIEVED, np.sqrt(0.5 / samples.freedom)))
    place = _scale(model, channel, WhiteNoise)
    if place is None:
        return BELIEVED
    low, high = sizes[[1, 3], place].tolist()
    spread = 0.5 * float(np.log(high / low)) if low > 0 else UNKNOWN
    return max(min(spread, np.inf if correlated else UNKNOWN), BELIEVED)


def _prior_grid(at: _At, channel: int, kind: type) -> Grid:
    """Return the sizes of a kind of noise that its prior allows, SI, as intervals of z; empty if it is not there."""
    place = _scale(at.model, channel, kind)
    if place is None:
        return ()
    between = 0.5 * (_PRIOR_Z[1:] + _PRIOR_Z[:-1])
    share = np.diff([0.0, *(1 - normal_survival(between)), 1.0])
    return tuple(zip(at.sizes[:, place].tolist(), np.log(share).tolist(), strict=True))


def _noise_sizes(problem: Problem, z: np.ndarray) -> np.ndarray:
    """Return every noise scale at places of its prior, (n, H), SI."""
    return problem.hyper_priors.values(np.tile(z[:, None], problem.size[1]))


def _scale(model: Model, channel: int, kind: type) -> int | None:
    """Return the place of the noise scale of a kind that a channel has; None without one."""
    scales = enumerate(noise_scales(model))
    return next((k for k, (_, member, place) in scales if place == channel and issubclass(member, kind)), None)
