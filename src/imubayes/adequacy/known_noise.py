"""Noise known beforehand, and noise as fitted: a scale that contradicts what is known stands in for something else.

Whatever acts from row to row, or from run to run, and is missing in the model ends in a scale of its noise, and then no
residual is left.  Knowledge of a scale from before the fit decides.

- Raw samples: rows carry the standard deviation s of their n samples (`samples` and `<channel>_sd`).  The fit estimates
  the same σ from the scatter *between* rows, and (σ/s)² follows F with the degrees of freedom of both.  Correlated
  samples scatter the rows more than s/√n says: the excess is real, and what it means is not reported.
- The prior, which by default holds the noise that the campaign states of the channel: the probability of a larger
  scale.  The mode is drawn towards the median of the prior, so that a true scale exceeds it more rarely than that.
- The sister channels, those with the same kind of sensor and of scale: with independent estimates the ratio of two
  variances follows F, times the lognormal law by which equal sensors differ.  Scales are compared as multiples of what
  the prior states, and only a scale that exceeds that is doubted.

Of a scale that raw samples determine nothing else counts.  Correlations, slow noise and tails are left to the tests of
the residuals: their parameters are no sizes of independent noise.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imubayes.adequacy.adequacy_record import NOISE_AGREES, NOISE_TOLD_SD, NoiseComparison
from imubayes.adequacy.noise_tests import to_entries
from imubayes.adequacy.projection import Projection
from imubayes.foundations.tail_probabilities import LEAST_P, f_survival, normal_survival
from imubayes.inference.conditional_precision import run_means
from imubayes.inference.fitted_model import Fit
from imubayes.model.bind import Model
from imubayes.model.effect_registry import EffectClass
from imubayes.model.problem import Problem
from imubayes.noise.components import EntryNoise, Noise, SeriesNoise, SharedNoise, SlowNoise, WhiteNoise
from imubayes.parameters.declarations import Parameter
from imubayes.parameters.priors import HalfNormal

SISTERS_LOG_SD = 0.5
"""Standard deviation of the logarithm of a scale among equal sensors, as in the default prior of white_noise.
Convention: with it a scatter of five runs is distinguished from 12 times that of two sisters, one of many runs from 8
times. Scales drawn from half-normal priors, each by itself, differ more: then one campaign in a hundred is reported."""
_SISTERS_FREEDOM_MIN = 0.5
"""Fewest degrees of freedom between runs for such a comparison.  Numerical: below, a variance is rounding."""
_NOISE_FREEDOM_MIN = 5.0
"""Fewest degrees of freedom within runs for which a comparison is made.  Convention: below, σ is known to 30 % at
best."""
_RUNS_AGREE = 1.5
"""Scatter of the corrected runs over the noise of raw samples, up to which they agree with one another.  Convention."""

_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(61)
# z of a correlation of 0 under a uniform prior.
_NO_CORRELATION = -8.0


@dataclass(frozen=True)
class KnownNoise:
    """Every noise scale against what is known of it.

    Attributes
    ----------
    comparisons : in the order of the parameters.
    channel, run : shape (n,), names, of each row of the channels whose white noise is known.
    scatter : shape (n,), whitened residual in standard deviations of the row's mean as known.
    """

    comparisons: tuple[NoiseComparison, ...]
    channel: np.ndarray
    run: np.ndarray
    scatter: np.ndarray

    @property
    def contradicted(self) -> tuple[NoiseComparison, ...]:
        """All comparisons of the scales that contradict what is known, the least probable first."""
        least: dict[str, float] = {}
        for each in sorted(self.comparisons, key=lambda each: each.p):
            if each.excessive:
                least.setdefault(each.parameter, each.p)
        told = [each for each in self.comparisons if each.parameter in least]
        return tuple(sorted(told, key=lambda each: (least[each.parameter], each.parameter, each.p)))

    @property
    def of_rows(self) -> tuple[NoiseComparison, ...]:
        """The comparisons of the white noise of rows."""
        return tuple(each for each in self.comparisons if each.of_rows)


@dataclass(frozen=True)
class SampleNoise:
    """Standard deviation of one raw sample within rows, with its degrees of freedom.

    `varying`: the stimulus varies within every row that counts, and adds to it.
    """

    sd: float
    freedom: float
    varying: bool


@dataclass(frozen=True)
class _ScaleEstimate:
    """What the rows of a channel say of a scale.

    Attributes
    ----------
    variance, freedom : of one raw sample, or of the mean of a run about the model.
    floor : the part of the variance that is another scale's.
    """

    variance: float
    freedom: float
    floor: float = 0.0

    def in_units_of(self, parameter: Parameter) -> "_ScaleEstimate":
        """Return the same over the square of what the prior of a scale states."""
        unit = (stated(parameter) * parameter.factor) ** 2
        return replace(self, variance=self.variance / unit, floor=self.floor / unit)


def compare_with_known(projection: Projection) -> KnownNoise:
    """Return every noise scale of a fit against what is known of it beforehand.

    Parameters
    ----------
    projection : without a further whitening, so that its rows are in units of the model's own noise.
    """
    model, rows = projection.fitted.model, _rows_of(projection)
    records, between = sample_noise(model), _between_runs(projection)
    found, estimates = list[NoiseComparison](), dict[int, _ScaleEstimate]()
    for k, (parameter, member, place) in enumerate(noise_scales(model)):
        if not issubclass(member, EntryNoise | SharedNoise):
            continue
        base, estimate, record = rows.as_fitted(parameter, member, place, float(projection.fitted.h[k])), None, None
        if base.between_runs and place is not None:
            estimate = between.get(place)
        elif issubclass(member, WhiteNoise) and place is not None:
            estimate, record = rows.estimate(place), records.get(place)
            if estimate is None:
                continue
            base = replace(base, fitted=math.sqrt(estimate.variance) / parameter.factor, freedom=estimate.freedom)
        if estimate is not None and record is None:
            estimates[k] = estimate.in_units_of(parameter)
        found.append(_against_record(base, record, parameter.factor) if record else _against_prior(base, parameter))
    found += _against_sisters({each.parameter: each for each in found}, model, estimates)
    adjusted = _holm(np.array([each.p for each in found])).tolist()
    counted = tuple(replace(each, p=p) for each, p in zip(found, adjusted, strict=True))
    return KnownNoise(counted, *rows.over_known(counted))


@dataclass(frozen=True)
class _FittedRows:
    """The rows of a projection, and the white noise of one raw sample that the fit gives them, all of shape (E,).

    Attributes
    ----------
    used : which count.
    sigma : white noise of one raw sample, 0 without.
    correlated : whether the model has autocorrelated noise there.
    """

    projection: Projection
    used: np.ndarray
    sigma: np.ndarray
    correlated: np.ndarray

    def of(self, channel: int | None) -> np.ndarray:
        """Return which rows of a channel have white noise, (E,) bool."""
        return self.used & (self.projection.fitted.model.entries.channel == channel) & (self.sigma > 0)

    def as_fitted(self, parameter: Parameter, member: EffectClass, channel: int | None, z: float) -> NoiseComparison:
        """Return a scale as fitted, compared with nothing yet."""
        channels = self.projection.fitted.model.campaign.channels
        return NoiseComparison(
            channel=channels[channel].name if channel is not None else ",".join(parameter.label),
            fitted=parameter.value_at(z), recorded=0.0, source="prior", ratio=1.0, ratio_sd=0.0, p=1.0,
            correlated=bool(self.correlated[self.of(channel)].any()), unit=parameter.shown_unit,
            parameter=parameter.name, between_runs=issubclass(member, SharedNoise),
        )  # fmt: skip

    def estimate(self, channel: int) -> _ScaleEstimate | None:
        """Return what the scatter of rows says of one raw sample; None if they are too few."""
        here, (chi2, freedom) = self.of(channel), _within(self.projection, channel)
        if not here.any() or freedom < _NOISE_FREEDOM_MIN:
            return None
        return _ScaleEstimate(float(np.median(self.sigma[here])) ** 2 * chi2 / freedom, freedom)

    def over_known(self, comparisons: Sequence[NoiseComparison]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return channel, run and whitened residual of the rows whose white noise is known, in units of that."""
        model = self.projection.fitted.model
        names = np.array([channel.name for channel in model.campaign.channels])
        runs = np.array([run.name for run in model.campaign.runs])
        white = to_entries(self.projection, self.projection.residual[:, None])[:, 0]
        known = {each.channel: each.fitted / each.ratio for each in comparisons if each.of_rows}
        scatter, entries = np.full(len(white), np.nan), model.entries
        for place, channel in enumerate(names.tolist()):
            here = self.of(place)
            if channel in known and here.any():
                scatter[here] = white[here] * float(np.median(self.sigma[here])) / known[channel]
        shown = np.isfinite(scatter)
        return names[entries.channel[shown]], runs[entries.run[shown]], scatter[shown]


def _rows_of(projection: Projection) -> _FittedRows:
    model = projection.fitted.model
    used = (np.asarray(model.problem.observations.weight) > 0) & ~model.entries.closing
    return _FittedRows(projection, used, *_white_noise(model.problem, projection.fitted.h))


def known_scales(fitted: Fit, *, correlated: bool = False) -> np.ndarray:
    """Return the noise scales that were known beforehand, in z, shape (H,).

    White noise as the raw samples determine; if they do not, and of every other noise, that of turns included, what the
    prior states.  Of what is no noise, and of the motion of a hand, nothing is known, and the fit stands.

    Parameters
    ----------
    correlated : whether rows keep the correlation of the fit; they have none otherwise.
    """
    records, h = sample_noise(fitted.model), np.array(fitted.h, dtype=float)
    for k, (parameter, member, place) in enumerate(noise_scales(fitted.model)):
        if not issubclass(member, Noise) or member.of_motion:
            continue
        record = records.get(place) if issubclass(member, WhiteNoise) and place is not None else None
        if issubclass(member, SeriesNoise):
            z = parameter.z_at(0.0)
            h[k] = h[k] if correlated else _NO_CORRELATION if z is None else z
        else:
            h[k] = _known_size(parameter, record)
    return h


def scales_between_runs(model: Model) -> np.ndarray:
    """Return which noise scales are a scatter between runs, (H,) bool."""
    return np.array([issubclass(member, SharedNoise) for _, member, _ in noise_scales(model)], dtype=bool)


def largest_scatter(model: Model) -> np.ndarray:
    """Return the factor on the known noise of each channel up to which its rows agree with it, (K,).

    Raw samples determine white noise nearly; a prior, within two of its standard deviations.
    """
    found, records = np.full(len(model.campaign.channels), _RUNS_AGREE), sample_noise(model)
    for parameter, member, place in noise_scales(model):
        if issubclass(member, WhiteNoise) and place is not None and place not in records:
            found[place] = max(_RUNS_AGREE, parameter.value_at(2.0) / stated(parameter))
    return found


def _known_size(parameter: Parameter, record: SampleNoise | None) -> float:
    """Return z of what is known of a size: of its raw samples, else what the prior states."""
    told = parameter.z_at(record.sd / parameter.factor) if record is not None else None
    # Far beyond the prior it is the stimulus that varies within rows.
    if record is not None and told is not None and not (record.varying and told > NOISE_TOLD_SD):
        return told
    z = parameter.z_at(stated(parameter))
    return 0.0 if z is None else z


def stated(parameter: Parameter) -> float:
    """Return the size that a prior states, in the parameter's unit: its scale if it reaches down to zero."""
    prior = parameter.prior
    return float(prior.scale) / parameter.factor if isinstance(prior, HalfNormal) else parameter.value_at(0.0)


def noise_scales(model: Model) -> list[tuple[Parameter, EffectClass, int | None]]:
    """Return each noise scale with its class and the place of its channel; None if it has no channel."""
    places = {channel.name: place for place, channel in enumerate(model.campaign.channels)}
    members = {each.name: each.effect_class for each in model.assembly.effects}
    return [
        (each, members[each.effect], places.get(each.label[0]) if each.label else None)
        for each in model.hyper_layout.parameters
    ]


def _against_record(base: NoiseComparison, record: SampleNoise, factor: float) -> NoiseComparison:
    known = record.sd / factor
    ratio = base.fitted / known
    p = float(f_survival((ratio / NOISE_AGREES) ** 2, base.freedom, record.freedom))
    sd = ratio * math.sqrt(0.5 / base.freedom + 0.5 / record.freedom)
    return replace(base, recorded=known, source="samples", ratio=ratio, ratio_sd=sd, p=p)


def _against_prior(base: NoiseComparison, parameter: Parameter) -> NoiseComparison:
    known, z = stated(parameter), parameter.z_at(base.fitted)
    ratio = base.fitted / known
    spread = 0.5 * math.log(parameter.value_at(1.0) / parameter.value_at(-1.0))
    sd = ratio * math.hypot(spread, math.sqrt(0.5 / base.freedom) if base.freedom else 0.0)
    # A size that the prior excludes is beyond every one that it allows.
    p = float(normal_survival(z)) if z is not None else (LEAST_P if ratio > 1 else 1.0)
    return replace(base, recorded=known, source="prior", ratio=ratio, ratio_sd=sd, p=p)


def _against_sisters(
    found: Mapping[str, NoiseComparison], model: Model, of_scale: Mapping[int, _ScaleEstimate]
) -> Iterator[NoiseComparison]:
    """Yield the comparison of every scale with that of the same kind of sensor, as multiples of what is stated."""
    scales, channels = noise_scales(model), model.campaign.channels
    kinds = {k: (scales[k][0].effect, channels[place].kind) for k in of_scale if (place := scales[k][2]) is not None}
    for k, own in of_scale.items():
        sisters = [each for each in kinds if each != k and kinds[each] == kinds[k]]
        freedom = sum(of_scale[each].freedom for each in sisters)
        if not sisters or freedom <= 0:
            continue
        pooled = sum(of_scale[each].freedom * of_scale[each].variance for each in sisters) / freedom
        p = chance_among_sisters(own.variance, own.freedom, pooled, freedom, len(sisters), own.floor)
        spread = _spread_among(len(sisters))
        ratio, base = math.sqrt(own.variance / pooled), found[scales[k][0].name]
        yield replace(
            base,
            source="sisters",
            recorded=base.fitted / ratio,
            ratio=ratio,
            ratio_sd=ratio * math.hypot(spread, math.sqrt(0.5 / own.freedom + 0.5 / freedom)),
            # A scale within what its own prior states contradicts nothing that is known of its size.
            p=p if base.fitted > stated(scales[k][0]) else 1.0,
            freedom=own.freedom,
            sisters=tuple(channels[place].name for j in sisters if (place := scales[j][2]) is not None),
        )


def chance_among_sisters(
    variance: float, freedom: float, pooled: float, of_pooled: float, sisters: int, floor: float = 0.0
) -> float:
    """Return the chance of a larger variance of a sensor, beside that of its sisters.

    Parameters
    ----------
    variance, freedom : of the sensor, estimated with so many degrees of freedom.
    pooled, of_pooled, sisters : variance of so many sisters, with its degrees of freedom.
    floor : the part of the variance that another scale makes.
    """
    expected = pooled * np.exp(2 * _spread_among(sisters) * _NODES) + floor
    return float(_WEIGHTS @ f_survival(variance / expected, freedom, of_pooled) / _WEIGHTS.sum())


def _spread_among(sisters: int) -> float:
    """Return the standard deviation of the logarithm of a scale about the mean of so many others of its kind."""
    return SISTERS_LOG_SD * math.sqrt(1 + 1 / sisters)


def _holm(p: np.ndarray) -> np.ndarray:
    """Return p-values adjusted for their number (Holm)."""
    order = np.argsort(p, kind="stable")
    adjusted = np.empty(len(p))
    adjusted[order] = np.minimum(np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1)), 1.0)
    return adjusted


def _within(projection: Projection, channel: int) -> tuple[float, float]:
    """Return χ² and degrees of freedom of a channel within its runs."""
    strata = projection.strata
    own = np.flatnonzero((strata.channel == channel) & ~strata.between)
    squares = strata.sums(projection.residual**2)
    return float(squares[own].sum()), float(projection.freedom[own].sum())


def _between_runs(projection: Projection) -> dict[int, _ScaleEstimate]:
    """Return the scatter of the means of the runs of each channel about the model."""
    apart = projection.offsets_apart
    fitted, strata = projection.fitted, apart.strata
    problem, h = fitted.model.problem, fitted.h
    precision, shared = map(np.asarray, run_means(problem, h))
    channel = fitted.model.entries.channel[projection.turn.members[:, 0]]
    squares, found = strata.sums(apart.residual**2), {}
    for place in np.flatnonzero(strata.between).tolist():
        groups, freedom = (channel == strata.channel[place]) & (precision > 0), float(apart.freedom[place])
        if freedom >= _SISTERS_FREEDOM_MIN:
            floor = float(np.mean(1 / precision[groups]))
            whole = floor + float(np.mean(shared[groups]))
            found[int(strata.channel[place])] = _ScaleEstimate(whole * float(squares[place]) / freedom, freedom, floor)
    return found


def _white_noise(problem: Problem, h: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the white noise of one raw sample at each entry, 0 without, and whether its noise is autocorrelated."""
    observations = problem.observations
    variance = np.asarray(_white_variances(problem, h))
    correlated = np.zeros(len(observations.value), dtype=bool)
    for layer in problem.noise:
        if issubclass(layer.noise, SeriesNoise):
            correlated |= (np.asarray(layer.acts) > 0)[np.asarray(observations.group)]
        elif issubclass(layer.noise, SlowNoise):
            correlated |= np.asarray(layer.acts) > 0
    return np.sqrt(variance * np.asarray(observations.entry.samples)), correlated


def _white_variances(problem: Problem, h: np.ndarray) -> np.ndarray:
    """Return the variance of the white noise of each entry, (E,)."""
    values, entries = problem.hyper_priors.values(h), problem.observations.entry
    white = [layer for layer in problem.noise if issubclass(layer.noise, WhiteNoise)]
    return np.sum(
        [np.zeros(len(entries.samples)), *(layer.entry_variances(values, entries) for layer in white)], axis=0
    )


def sample_noise(model: Model) -> dict[int, SampleNoise]:
    """Return what the raw samples within rows show of the noise of each channel, by its place."""
    found, single = dict[int, SampleNoise](), _single_nodes(model)
    first = np.cumsum([0, *(run.rows for run in model.campaign.runs)])
    for channel in range(len(model.campaign.channels)):
        steady, varying = [], []
        for run, start in zip(model.campaign.runs, first.tolist(), strict=False):
            sd, samples = run.sample_sd[:, channel], run.samples
            known, here = np.isfinite(sd) & (samples > 1), single[start : start + run.rows]
            steady.append(np.stack([sd, samples])[:, known & here])
            varying.append(np.stack([sd, samples])[:, known & ~here])
        # A stimulus that varies within a row adds to the scatter of its samples: rows at a constant one go first.
        for varies, parts in ((False, steady), (True, varying)):
            sd, samples = np.concatenate(parts, axis=1)
            freedom = float(np.sum(samples - 1))
            pooled = math.sqrt(float(np.sum((samples - 1) * sd**2)) / freedom) if freedom > 0 else 0.0
            if pooled > 0:
                found[channel] = SampleNoise(pooled, freedom, varies)
                break
    return found


def _single_nodes(model: Model) -> np.ndarray:
    """Return which rows, counted over all runs, have one constant stimulus, bool."""
    sizes = np.concatenate([np.full(count, size) for count, size in model.nodes.turns])
    single = np.zeros(len(sizes), dtype=bool)
    single[model.nodes.row_of] = sizes == 1
    return single
