"""Rate table: constant rates about one axis (P1, P2).

In a tilted fixture a channel sees Ω cos θ: one mounting determines only the product k·cos θ·(1 + table rate error);
other mountings, tumble runs or a reference gyro separate the three.

The textbook fits a straight line of output against table rate, per channel.  With F̄_j the mean output at the rate Ω_j
and F̄_s, F̄_e those of the static records at start and end,

    F_j = F̄_j − (F̄_s + F̄_e)/2,   F_j = k′ Ω_j + F₀ + ν_j,   k = k′/cos θ

(IEEE Std 952 § 12.9).  θ is the nominal angle from the input axis to the table axis and is taken as exact: an error of
dθ is an error of tan θ·dθ in ln k, 6.86 ppm for each arcsec at the trihedral angle.  k′ and F₀ need no angle.

The bias is the intercept of all outputs, not corrected by static records, over k, against x = Ω cos θ + ω_E·IA: the
Earth rate along the input axis is part of the input, at the recorded table angle, or its mean over whole turns.  A gyro
that senses acceleration adds its drift in this mounting: the same number is the zero of the series, F₀/k =
D_F + D_I f_I + D_O f_O + D_S f_S + …, the mean over a turn.

The repeatability of the scale factor, K_r, is the standard deviation of k over series in one mounting at one
temperature, pooled over temperatures, and over all series with the change with temperature included.
"""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imubayes.foundations.campaign_data import Campaign, Channel, Run
from imubayes.foundations.quantity_names import MOUNTING_ANGLE, name_of
from imubayes.foundations.units import to_si
from imubayes.procedures import fitted_terms, textbook
from imubayes.procedures.base import PlannedRows, PlannedSteps, PlanRules, Procedure, whole_turns
from imubayes.procedures.fitted_terms import LEAST_COSINE, StandardCombination
from imubayes.procedures.kinematics import mean_input
from imubayes.procedures.textbook import (
    DEGREE_PER_HOUR,
    Estimate,
    Evaluation,
    Line,
    TextbookResult,
    Undetermined,
)

METHOD = "IEEE Std 952 rate test"


@dataclass(frozen=True)
class RateSeries:
    """One channel in one run.

    Attributes
    ----------
    run, channel : what was tested.
    rate : shape (R,), table rate, rad/s.
    output : shape (R,), less the nominal offset, output units.
    cosine : of the nominal angle from the input axis to the table axis.
    """

    run: Run
    channel: Channel
    rate: np.ndarray
    output: np.ndarray
    cosine: float

    @property
    def evaluation(self) -> Evaluation:
        """Of the channel in the run."""
        return Evaluation(self.channel.name, self.run.name, METHOD)

    @property
    def seated(self) -> Evaluation:
        """Of the channel in the run and its mounting."""
        return Evaluation(f"{self.channel.name},{self.run.mounting}", self.run.name, METHOD)

    @property
    def turning(self) -> np.ndarray:
        """Which rows turn, shape (R,)."""
        return self.rate != 0

    @property
    def corrected(self) -> np.ndarray:
        """Outputs of the turning rows, less the mean of the static records at start and end if there are any."""
        still = np.flatnonzero(~self.turning)
        zero = (self.output[still[0]] + self.output[still[-1]]) / 2 if len(still) else 0.0
        return self.output[self.turning] - zero

    @property
    def fitted(self) -> Line:
        """The line of the corrected outputs against the table rate."""
        return textbook.line(self.rate[self.turning], self.corrected)

    @property
    def scale(self) -> tuple[float, float]:
        """The scale factor k = k′/cos θ and its standard uncertainty, output units per rad/s."""
        fitted = self.fitted
        return fitted.slope / self.cosine, abs(fitted.slope_sd / self.cosine)

    @property
    def row_sd(self) -> float:
        """Standard deviation of a row about the line, output units; NaN for two rows."""
        freedom = int(np.sum(self.turning)) - 2
        return float(np.sqrt(np.sum(self.fitted.residual**2) / freedom)) if freedom > 0 else float("nan")


def rate_test(campaign: Campaign, runs: Sequence[Run]) -> list[TextbookResult]:
    """Return k′, F₀, scale factor, bias, nonlinearity and asymmetry per run, and the repeatability over runs."""
    found: list[TextbookResult] = []
    over: dict[tuple[str, str], list[RateSeries]] = defaultdict(list)
    for run in runs:
        rate = run.covariates["table_rate"]
        if len(np.unique(rate[rate != 0])) < 2:
            found.append(Undetermined(run.name, "fewer than two rates: no straight line can be fitted"))
            continue
        for channel, output in textbook.measured(run, campaign, "gyro"):
            cosine = float(textbook.along_table(run, campaign, channel.axes[0])[2])
            if abs(cosine) > LEAST_COSINE:
                series = RateSeries(run, channel, rate, output, cosine)
                found += [*_line(series), *_bias(series, campaign), *_shape(series)]
                over[channel.name, str(run.mounting)].append(series)
    for each in over.values():
        found += [*_repeatability(each), *_sensitivity(each)]
    return found


def _line(series: RateSeries) -> list[TextbookResult]:
    """Return k′, F₀ and the scale factor."""
    channel, fitted, seated = series.channel, series.fitted, series.seated
    factor, unit = to_si(channel.per), f"{channel.output_unit} per {channel.per}"
    angle, nominal = name_of(MOUNTING_ANGLE, seated.of), float(np.degrees(np.arccos(series.cosine)))
    k, sd = series.scale
    scale = series.evaluation.estimate("scale_factor", k * factor, sd * factor, unit, "k = k′/cos θ")
    # The mean of two static records, by which every output is corrected, shifts the intercept.
    intercept_sd = float(np.hypot(fitted.intercept_sd, series.row_sd / np.sqrt(2) * (~series.turning).any()))
    return [
        replace(scale, angle=angle, nominal=nominal),
        seated.estimate("k′", fitted.slope * factor, fitted.slope_sd * factor, unit),
        seated.estimate("F₀", fitted.intercept, intercept_sd, channel.output_unit),
    ]


def _bias(series: RateSeries, campaign: Campaign) -> list[TextbookResult]:
    """Return the bias, the Earth rate taken out, and the output at rest, which includes it."""
    known = mean_input(campaign, series.run, series.channel)
    (intercept, slope), covariance, _ = textbook.least_squares(
        np.stack([np.ones_like(known), known], axis=1), series.output
    )
    bias = intercept / slope
    # Delta method for a ratio: dβ = (da − β dk)/k, over the scatter of the rows.
    gradient = np.array([1.0, -bias]) / slope
    ratio = bias / DEGREE_PER_HOUR, np.sqrt(gradient @ covariance @ gradient) / DEGREE_PER_HOUR
    how = "intercept over k, less the Earth rate along the input axis"
    found: list[TextbookResult] = [
        series.evaluation.estimate("gyro_bias.bias", *ratio, "deg/h", how),
        series.seated.estimate("F₀/k", *ratio, "deg/h", how),
    ]
    still = ~series.turning
    if still.any():
        zero = np.mean(series.output[still]) / series.scale[0] / DEGREE_PER_HOUR
        spread = series.row_sd / np.sqrt(np.sum(still)) / abs(series.scale[0]) / DEGREE_PER_HOUR
        how = "at rest, Earth rate included"
        found.append(series.evaluation.estimate("zero_rate_output", zero, spread, "deg/h", how))
    return found


def _shape(series: RateSeries) -> list[TextbookResult]:
    """Return nonlinearity and asymmetry of the scale factor."""
    turning, values = series.rate[series.turning], series.corrected
    largest, how = float(np.abs(values).max()), "largest deviation from the line divided by the largest output"
    worst, sd = (each / largest * 1e6 for each in (np.abs(series.fitted.residual).max(), series.row_sd))
    scatter = "type A: scatter of one row about the line"
    found: list[TextbookResult] = [
        series.evaluation.estimate("nonlinearity", worst, sd, "ppm", how, uncertainty=scatter)
    ]
    forward, reverse = turning > 0, turning < 0
    if len(np.unique(turning[forward])) > 1 and len(np.unique(turning[reverse])) > 1:
        plus, minus = textbook.line(turning[forward], values[forward]), textbook.line(turning[reverse], values[reverse])
        mean = abs(plus.slope + minus.slope) / 2
        apart, sd = abs(plus.slope - minus.slope), np.hypot(plus.slope_sd, minus.slope_sd)
        how = "|K₊ − K₋| over their mean"
        found.append(series.evaluation.estimate("asymmetry", apart / mean * 1e6, sd / mean * 1e6, "ppm", how))
    return found


def _repeatability(each: Sequence[RateSeries]) -> Iterator[TextbookResult]:
    """Yield K_r at every temperature, pooled over them, and over all series."""
    squares, freedom = 0.0, 0
    groups = [
        [series for series in each if series.run in group] for group in textbook.by_temperature([s.run for s in each])
    ]
    for group in groups:
        if len(group) < 2:
            continue
        at = textbook.temperature_of(group[0].run)
        relative = _relative(group)
        squares, freedom = squares + float(np.sum(relative**2)), freedom + len(group) - 1
        where = (
            f" at {np.mean([textbook.temperature_of(series.run) for series in group]):.0f} °C"
            if np.isfinite(at)
            else ""
        )
        yield _spread("repeatability", group, *textbook.standard_deviation(relative), where)
    if len(groups) > 1 and freedom:
        pooled = float(np.sqrt(squares / freedom))
        inside = [series for group in groups if len(group) > 1 for series in group]
        pooled_sd = pooled / np.sqrt(2 * freedom)
        yield _spread("repeatability_pooled", inside, pooled, pooled_sd, " at each temperature")
    if len(groups) > 1:
        where = " at all temperatures, the change with temperature included"
        yield _spread("repeatability_overall", each, *textbook.standard_deviation(_relative(each)), where)


def _relative(each: Sequence[RateSeries]) -> np.ndarray:
    """Return the relative deviations of the scale factors of series from their mean."""
    k = np.array([series.scale[0] for series in each])
    return k / np.mean(k) - 1


def _over(each: Sequence[RateSeries]) -> Evaluation:
    """Return the evaluation of several series of a channel."""
    return Evaluation(each[0].channel.name, textbook.names_of([series.run for series in each]), METHOD)


def _spread(name: str, each: Sequence[RateSeries], value: float, sd: float, where: str) -> Estimate:
    how = f"K_r, standard deviation of k over {len(each)} series{where}"
    evaluation = "type A: s/√(2ν) for ν degrees of freedom between the series"
    return _over(each).estimate(name, value * 1e6, sd * 1e6, "ppm", how, uncertainty=evaluation)


def _sensitivity(each: Sequence[RateSeries]) -> list[TextbookResult]:
    """Return the temperature sensitivity of the scale factor over series at several temperatures."""
    temperature = np.array([textbook.temperature_of(series.run) for series in each])
    if len(each) < 2 or not np.isfinite(temperature).all() or np.ptp(temperature) < _LEAST_RANGE:
        return []
    k, sd = (np.array(values) for values in zip(*(series.scale for series in each), strict=True))
    reference = int(np.argmin(np.abs(temperature - np.median(temperature))))
    others = np.flatnonzero(np.abs(temperature - temperature[reference]) > _LEAST_STEP)
    step = temperature[others] - temperature[reference]
    slopes = (k[others] - k[reference]) / k[reference] / step
    spread = np.hypot(sd[others], sd[reference]) / abs(k[reference]) / np.abs(step)
    largest = int(np.argmax(np.abs(slopes)))
    value, error, how = slopes[largest], spread[largest], "largest change of k from the median temperature, per degree"
    return [_over(each).estimate("temperature_sensitivity", value * 1e6, error * 1e6, "ppm/degC", how)]


def combinations(campaign: Campaign, runs: Sequence[Run]) -> list[StandardCombination]:
    """Return k′ and the zero F₀/k of every gyro in every mounting."""
    found: list[StandardCombination] = [*fitted_terms.projected_scale_factors(campaign, runs)]
    for mounting, run in {run.mounting: run for run in runs if run.mounting is not None}.items():
        for channel in campaign.of_kind("gyro"):
            zero = fitted_terms.of_drift(
                "F₀/k", channel.name, "deg/h", fitted_terms.turn_mean_drift(campaign, run, channel), total=True
            )
            found.append(replace(zero, name=f"F₀/k[{channel.name},{mounting}]"))
    return found


# °C: range of temperatures over which a sensitivity is given, and the least step from the median temperature.
_LEAST_RANGE, _LEAST_STEP = 2.0, 1.0


def _planned_rows(steps: PlannedSteps) -> PlannedRows:
    rates = steps.rates_deg_s or []
    rate = np.array(rates)
    columns = {"table_rate_deg_s": rate, "table_angle_deg": np.where(rate == 0, 0.0, np.nan)}
    return PlannedRows(np.array([whole_turns(each, steps.duration) for each in rates]), columns)


RATE_TABLE = Procedure(
    name="rate_table",
    reference="IEEE Std 952, rate table test series",
    columns=(("table_rate_deg_s", "table_angle_deg"),),
    needs_table=True,
    followed=True,
    abscissae=("table_rate", "temperature", "time"),
    plan=PlanRules(("rates_deg_s",), ("converter_temperature_degC",), 20.0, _planned_rows),
    evaluate=rate_test,
    combinations=combinations,
)
