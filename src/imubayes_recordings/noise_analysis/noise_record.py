"""The noise of the static records of a campaign, as a record: terms in the units of datasheets, Allan deviations."""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from imubayes.campaign.campaign_reader import raw_log
from imubayes.foundations.campaign_data import Campaign, Channel, Run
from imubayes.foundations.errors import closest_first, input_error
from imubayes.foundations.progress import counted, silent
from imubayes.foundations.records import Record, finite
from imubayes_recordings.noise_analysis import described_band as described
from imubayes_recordings.noise_analysis.allan_deviation import AllanVariance, allan_variance
from imubayes_recordings.noise_analysis.contamination import Contamination
from imubayes_recordings.noise_analysis.cosine_spectra import cosine_statistics
from imubayes_recordings.noise_analysis.likelihood import NoiseLikelihood
from imubayes_recordings.noise_analysis.noise_terms import NoiseTerm, allan_shape, coefficient_unit
from imubayes_recordings.noise_analysis.record_examination import (
    Repetition,
    TemperatureDrift,
    examined,
    unequal_levels,
    widened,
    without_rounding,
)
from imubayes_recordings.noise_analysis.running_sum import OutlyingSamples, RunningSum, SuddenChange, running_sums
from imubayes_recordings.noise_analysis.spectral_lines import SpectralLine
from imubayes_recordings.noise_analysis.term_estimates import PROBABILITY, NoiseEstimate, TermEstimate, estimate_terms

PROCEDURE, _WARM_UP = "static_record", "thermal_ramp"
_TEMPERATURE = "temperature_degC"
LEAST_SAMPLES = 256
_CORRELATION_TIME = "correlation_time"
_LEAST_CONSECUTIVE = 2  # samples between gaps, on average; with half of the samples missing at random they are two
_EXPONENTS = {NoiseTerm.QUANTISATION: 2, NoiseTerm.WHITE: 0, NoiseTerm.FLICKER: -1, NoiseTerm.RANDOM_WALK: -2}


class TermRecord(Record):
    """One coefficient with its interval of `probability`, or its upper limit of that probability.

    `output_per_unit` is one unit of the coefficient in output units and seconds.  A term that is `withheld` has neither
    estimate nor limit.
    """

    term: NoiseTerm
    unit: str
    determined: bool
    value: float | None
    sd: float | None
    low: float | None
    high: float | None
    upper_limit: float | None
    evidence: float | None
    in_output_units: float | None
    maximum_in_output_units: float
    output_per_unit: float
    withheld: described.Cause | None = None


class AllanPoint(Record):
    """Overlapping Allan deviation at one averaging time, with its interval and that of the fitted terms."""

    tau_s: float
    deviation: float
    low: float
    high: float
    degrees_of_freedom: float
    dominant_term: NoiseTerm
    fitted: float


class SilentChannel(Record):
    """A channel without noise to estimate: without a sample (`empty`), or of a single value (`constant`)."""

    run: str
    channel: str
    reason: Literal["empty", "constant"]


class ChannelNoise(Record):
    """The noise of one channel in one record.

    `undecided` are terms that are not determined, of which the record needs at least one; `alternatives` pairs of a
    determined term and one that describes the record as well in its place.  `rounding_share` is the part that rounding
    to the steps of the log, `resolution_in_output_units`, has in the variance of single samples, and `rounding_removed`
    whether it is taken out of white noise.  `unequal_levels` is the factor by which the level of noise scatters more
    over the record than it should, and by which the interval of white noise is widened.
    """

    run: str
    channel: str
    kind: str
    samples: int
    missing: int
    interval_s: float
    deviation_unit: str
    output_per_unit: float
    output_unit: str
    converged: bool
    terms: list[TermRecord]
    correlation_time_s: float | None
    correlation_time_sd_s: float | None
    correlated_terms: list[str]
    correlation: list[list[float]]
    undecided: list[NoiseTerm] = []
    alternatives: list[tuple[NoiseTerm, NoiseTerm]]
    misfit: list[described.Octave]
    repetition: Repetition | None = None
    outliers: OutlyingSamples | None = None
    contamination: Contamination | None = None
    temperature: TemperatureDrift | None = None
    lines: list[SpectralLine] = []
    gaps: list[described.Gap] = []
    roll_off: described.RollOff | None = None
    shortest_tau_s: float = 0.0
    unequal_levels: float = 1.0
    sudden_change: SuddenChange | None = None
    resolution_in_output_units: float = 0.0
    rounding_share: float = 0.0
    rounding_removed: bool = False
    allan: list[AllanPoint]

    def of(self, term: NoiseTerm) -> TermRecord:
        """Return a term."""
        return next(record for record in self.terms if record.term is term)


class StaticNoise(Record):
    """The noise of all static records of a campaign.

    Intervals: profile likelihood for the terms (of the ramp a posterior interval), chi-square for the Allan deviations.
    `serial` is the unit's; empty if the campaign states none.
    """

    format: int = 1
    campaign: str
    serial: str = ""
    probability: float = PROBABILITY
    channels: list[ChannelNoise]
    left_out: list[SilentChannel] = []


def static_noise(
    campaign: Campaign,
    runs: Sequence[str] = (),
    shortest_tau: float = 0.0,
    progress: Callable[[str], None] | None = None,
    robust: bool = False,
) -> StaticNoise:
    """Return the noise of the static records of a campaign.

    Parameters
    ----------
    campaign : read from a folder.
    runs : names of static records; all if empty.
    shortest_tau : leave out frequencies above 1/(2 `shortest_tau`), s, if a filter shapes the noise.
    progress : called with a short text as the work goes on.
    robust : leave out stretches in which the unit did not rest.

    Raises
    ------
    InputError
        if there is no static record, one is too short, or no channel varies.
    """
    found: list[ChannelNoise] = []
    left_out: list[SilentChannel] = []
    tell = progress or silent
    for run in _chosen(campaign, runs):
        tell(f"reading {run.name}")
        source = raw_log(campaign, run)
        columns = [*source.layout.channels, *({_TEMPERATURE} & set(source.layout.numbers))]
        sums = running_sums(source, columns, str(source.file))
        temperature = sums.get(_TEMPERATURE)
        recorded = [channel for channel in campaign.channels if channel.name in source.layout.channels]
        for channel in counted(tell, f"noise of {run.name}, channel", recorded):
            record = sums.pop(channel.name, None)
            noise = None
            if record is not None and record.resolution:
                noise = _of_channel(campaign, run, channel, record, temperature, shortest_tau, robust)
            if noise is None:
                reason = "empty" if record is None else "constant"
                left_out.append(SilentChannel(run=run.name, channel=channel.name, reason=reason))
            else:
                found.append(noise)
    if not found:
        raise input_error(
            "no channel varies", f"campaign '{campaign.name}', {', '.join(sorted({each.run for each in left_out}))}",
            "samples with noise, at the resolution of the sensor", "correct the log",
        )  # fmt: skip
    return StaticNoise(campaign=campaign.name, serial=campaign.serial, channels=found, left_out=left_out)


def _chosen(campaign: Campaign, names: Sequence[str]) -> list[Run]:
    records = {run.name: run for run in campaign.runs if run.procedure == PROCEDURE}
    unknown = [name for name in names if name not in records]
    if unknown or not records:
        what = f"'{unknown[0]}' is not a static record" if unknown else "there is no static record"
        allowed = closest_first(unknown[0], list(records)) if unknown and records else f"a run of {PROCEDURE}"
        raise input_error(what, f"campaign '{campaign.name}'", allowed, _remedy(campaign, unknown))
    return [records[name] for name in names] if names else list(records.values())


def _remedy(campaign: Campaign, names: Sequence[str]) -> str:
    """Return what to do without a static record: a warm-up in one attitude may be read as one."""
    still = [run.name for run in campaign.runs if run.procedure == _WARM_UP and run.name in (names or [run.name])]
    if not still:
        return "name a run of this procedure, or add one"
    return (
        f"write procedure = \"{PROCEDURE}\" in the [[run]] of '{still[0]}', a {_WARM_UP} in one attitude: its drift "
        f"with temperature counts as noise then; or convert a part at constant temperature with --procedure {PROCEDURE}"
    )


def _of_channel(
    campaign: Campaign,
    run: Run,
    channel: Channel,
    record: RunningSum,
    temperature: RunningSum | None,
    shortest_tau: float,
    robust: bool,
) -> ChannelNoise | None:
    """Return the noise of a channel; None if it is constant but for steps over gaps."""
    _refuse_short(record, shortest_tau, f"run '{run.name}', channel '{channel.name}'")
    variance = allan_variance(record)
    if not variance.variance[0] > 0:
        return None
    seen = examined(record, temperature, robust)
    band = seen.band(shortest_tau)
    estimate = estimate_terms(band.likelihood)
    own = seen.own_rate
    variance = variance if own is record else allan_variance(own)
    share = own.resolution**2 / 12 / float(variance.variance[0])
    withheld = seen.withheld(band, estimate, share)
    levels = unequal_levels(seen.cleaned, band.likelihood, estimate.full)
    white, removed = without_rounding(widened(estimate.of(NoiseTerm.WHITE), levels * band.growth), estimate, own)
    estimates = [white if term.term is NoiseTerm.WHITE else term for term in estimate.estimates]
    kept = _stated(estimate, withheld)
    stated = [[*map(str, estimate.determined), _CORRELATION_TIME][place] for place in kept]
    return ChannelNoise(
        run=run.name,
        channel=channel.name,
        kind=channel.kind,
        samples=own.present,
        missing=own.samples - own.present,
        interval_s=own.interval,
        deviation_unit=coefficient_unit(channel, NoiseTerm.FLICKER, campaign.site.gravity)[0],
        output_per_unit=_output_per_unit(channel, campaign.site.gravity),
        output_unit=channel.output_unit,
        converged=estimate.full.converged,
        terms=[_term(term, channel, campaign.site.gravity, withheld.get(term.term)) for term in estimates],
        correlation_time_s=finite(estimate.correlation_time),
        correlation_time_sd_s=finite(estimate.correlation_time_sd) if _CORRELATION_TIME in stated else None,
        correlated_terms=stated,
        correlation=estimate.correlation[np.ix_(kept, kept)].tolist(),
        undecided=[term for term in estimate.undecided if term not in withheld],
        alternatives=[pair for pair in estimate.alternatives if not set(pair) & set(withheld)],
        misfit=described.misfits(described.octave_fits(band.likelihood, estimate.full)),
        repetition=seen.repetition,
        outliers=seen.outliers,
        contamination=seen.contamination,
        temperature=seen.temperature,
        lines=list(seen.lines),
        gaps=list(band.gaps),
        roll_off=band.roll_off if band.filtered else None,
        shortest_tau_s=0.5 / float(band.likelihood.frequency.max()),
        unequal_levels=levels,
        sudden_change=seen.change,
        resolution_in_output_units=own.resolution,
        rounding_share=share,
        rounding_removed=removed,
        allan=_allan(variance, estimate, channel, campaign.site.gravity),
    )


def _stated(estimate: NoiseEstimate, withheld: Collection[NoiseTerm]) -> list[int]:
    """Return the places of what is stated in the correlation."""
    kept = [place for place, term in enumerate(estimate.determined) if term not in withheld]
    markov = NoiseTerm.MARKOV in estimate.determined and NoiseTerm.MARKOV not in withheld
    return [*kept, len(estimate.determined)] if markov else kept


def _refuse_short(record: RunningSum, shortest_tau: float, where: str) -> None:
    if record.present < LEAST_SAMPLES:
        raise input_error(
            f"{record.present} samples are too few for an analysis of noise", where,
            f"at least {LEAST_SAMPLES}", "give a longer record, or its raw samples",
        )  # fmt: skip
    if record.holes is not None and record.present < _LEAST_CONSECUTIVE * len(record.holes.start):
        raise input_error(
            "most samples are isolated between empty cells", where, "consecutive samples",
            "give a channel of a lower rate in a run of its own, without the empty rows",
        )  # fmt: skip
    if len(NoiseLikelihood(cosine_statistics(record), shortest_tau).octaves()) < described.LEAST_OCTAVES:
        allowed = "an averaging time far below the length of the record"
        raise input_error("too few octaves of frequency are left", where, allowed, "choose a shorter --shortest-tau")


def _term(found: TermEstimate, channel: Channel, gravity: float, withheld: described.Cause | None) -> TermRecord:
    unit, factor = coefficient_unit(channel, found.term, gravity)
    per = abs(channel.scale_si) * factor
    numbers = {
        "value": found.value / per, "sd": found.sd / per, "low": found.low / per, "high": found.high / per,
        "upper_limit": found.limit / per, "evidence": found.evidence, "in_output_units": found.value,
    }  # fmt: skip
    return TermRecord(
        term=found.term,
        unit=unit,
        determined=found.determined and withheld is None,
        **{name: None if withheld else finite(number) for name, number in numbers.items()},
        maximum_in_output_units=found.maximum,
        output_per_unit=per,
        withheld=withheld,
    )


def _output_per_unit(channel: Channel, gravity: float) -> float:
    """Return what one unit of the Allan deviation is in output units."""
    return abs(channel.scale_si) * coefficient_unit(channel, NoiseTerm.FLICKER, gravity)[1]


def fitted_deviations(noise: ChannelNoise, tau: np.ndarray) -> tuple[dict[NoiseTerm, np.ndarray], np.ndarray]:
    """Return the Allan deviation of every determined term, and of all terms at the maximum of the likelihood.

    Parameters
    ----------
    tau : averaging times, s; the deviations are in the unit of the record.
    """
    parts = _deviations(noise, tau)
    total = np.sqrt(np.sum([part**2 for part in parts.values()], axis=0))
    return {term: part for term, part in parts.items() if noise.of(term).determined}, total


def undetermined_deviations(noise: ChannelNoise, tau: np.ndarray) -> dict[NoiseTerm, np.ndarray]:
    """Return the Allan deviation of every term that is not determined, at the maximum of the likelihood."""
    return {term: part for term, part in _deviations(noise, tau).items() if not noise.of(term).determined}


def _deviations(noise: ChannelNoise, tau: np.ndarray) -> dict[NoiseTerm, np.ndarray]:
    time = math.nan if noise.correlation_time_s is None else noise.correlation_time_s
    return {
        found.term: abs(found.maximum_in_output_units)
        * np.sqrt(allan_shape(found.term, tau, time))
        / noise.output_per_unit
        for found in noise.terms
        if found.maximum_in_output_units
    }


def _allan(variance: AllanVariance, estimate: NoiseEstimate, channel: Channel, gravity: float) -> list[AllanPoint]:
    parts = {
        found.term: found.maximum**2 * allan_shape(found.term, variance.tau, estimate.correlation_time)
        for found in estimate.estimates
        if found.maximum
    }
    terms, sizes = list(parts), np.stack(list(parts.values()))
    dominant = [terms[int(place)] for place in np.argmax(sizes, axis=0)]
    exponents = np.array([_exponent(term, tau, estimate) for term, tau in zip(dominant, variance.tau, strict=True)])
    low, high, degrees = variance.interval(exponents, PROBABILITY)
    per = _output_per_unit(channel, gravity)
    deviation, fitted = np.sqrt(variance.variance) / per, np.sqrt(sizes.sum(axis=0)) / per
    return [
        AllanPoint(
            tau_s=float(variance.tau[k]), deviation=float(deviation[k]), low=float(low[k] / per),
            high=float(high[k] / per), degrees_of_freedom=float(degrees[k]), dominant_term=dominant[k],
            fitted=float(fitted[k]),
        )
        for k in range(len(dominant))
    ]  # fmt: skip


def _exponent(term: NoiseTerm, tau: float, estimate: NoiseEstimate) -> int:
    """Return the power-law exponent for the degrees of freedom.

    A Gauss–Markov process is a random walk at averaging times below that of its largest deviation, 1.9 T, and white
    noise above.  A ramp has no degrees of freedom of its own: those of a random walk are the fewest.
    """
    if term is NoiseTerm.MARKOV:
        return -2 if tau < 1.9 * estimate.correlation_time else 0
    return _EXPONENTS.get(term, -2)


@dataclass(frozen=True)
class NoiseDensity:
    """The noise of the gyros or the accelerometers.

    Attributes
    ----------
    white : rad/s/√Hz or m/s²/√Hz; None if unknown.
    walk : rad/s²/√Hz or m/s³/√Hz; None if unknown.
    walk_is_limit : whether the walk is an upper limit of 95 %.
    """

    white: float | None
    walk: float | None
    walk_is_limit: bool = False


def of_record(noise: StaticNoise, campaign: Campaign) -> dict[str, NoiseDensity]:
    """Return the noise of a static record, kind → density."""
    found = {}
    for kind in ("gyro", "accelerometer"):
        white, walk = [], []
        for record in noise.channels:
            channel = next((c for c in campaign.of_kind(kind) if c.name == record.channel), None)
            if channel is None:
                continue
            for term, into in ((NoiseTerm.WHITE, white), (NoiseTerm.RANDOM_WALK, walk)):
                si = coefficient_unit(channel, term, campaign.site.gravity)[1]
                own = record.of(term)
                value = own.value if own.determined else own.upper_limit
                if value is not None:
                    into.append((value * si, not own.determined))
        if white:
            largest, limit = max(walk) if walk else (None, False)
            found[kind] = NoiseDensity(max(white)[0], largest, limit)
    return found
