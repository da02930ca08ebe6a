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
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imubayes.foundations.campaign_data import Campaign, Channel, Run
from imubayes.foundations.units import to_si
from imubayes.procedures.base import PlannedRows, PlannedSteps, PlanRules, Procedure, whole_turns
from imubayes.procedures.fitted_terms import (
    LEAST_COSINE,
    StandardCombination,
    of_drift,
    projected_scale_factors,
    turn_mean_drift,
)
from imubayes.procedures.kinematics import mean_input
from imubayes.procedures.textbook import (
    Estimate,
    Line,
    TextbookResult,
    Undetermined,
    along_table,
    by_temperature,
    line,
    measured,
    names_of,
    standard_deviation,
    temperature_of,
)

METHOD = "IEEE Std 952 rate test"
_DEGREE = np.pi / 180
_DEGREE_PER_HOUR = _DEGREE / 3600


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
        return line(self.rate[self.turning], self.corrected)

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
        for channel, output in measured(run, campaign, "gyro"):
            cosine = float(along_table(run, campaign, channel.axes[0])[2])
            if abs(cosine) > LEAST_COSINE:
                series = RateSeries(run, channel, rate, output, cosine)
                found += [*_line(series), *_bias(series, campaign), *_shape(series)]
                over[channel.name, str(run.mounting)].append(series)
    for each in over.values():
        found += [*_repeatability(each), *_sensitivity(each)]
    return found


def _line(series: RateSeries) -> list[TextbookResult]:
    """Return k′, F₀ and the scale factor."""
    channel, run, fitted = series.channel, series.run, series.fitted
    factor, unit = to_si(channel.per), f"{channel.output_unit} per {channel.per}"
    place = f"{channel.name},{run.mounting}"
    angle, nominal = f"mounting_angle[{place}]", float(np.degrees(np.arccos(series.cosine)))
    k, sd = series.scale
    # The mean of two static records, by which every output is corrected, shifts the intercept.
    intercept_sd = float(np.hypot(fitted.intercept_sd, series.row_sd / np.sqrt(2) * (~series.turning).any()))
    return [
        Estimate(
            f"scale_factor[{channel.name}]", run.name, k * factor, sd * factor, unit, f"{METHOD}: k = k′/cos θ",
            angle, nominal,
        ),
        Estimate(f"k′[{place}]", run.name, fitted.slope * factor, fitted.slope_sd * factor, unit, METHOD),
        Estimate(f"F₀[{place}]", run.name, fitted.intercept, intercept_sd, channel.output_unit, METHOD),
    ]  # fmt: skip


def _bias(series: RateSeries, campaign: Campaign) -> list[TextbookResult]:
    """Return the bias, the Earth rate taken out, and the output at rest, which includes it."""
    run, name = series.run, series.channel.name
    known = mean_input(campaign, series.run, series.channel)
    fitted = line(known, series.output)
    freedom = len(known) - 2
    bias = fitted.intercept / fitted.slope
    # Delta method for a ratio: dβ = (da − β dk)/k, over the scatter of the rows.
    design = np.stack([np.ones_like(known), known], axis=1)
    gradient = np.array([1.0, -bias]) / fitted.slope
    variance = float(np.sum(fitted.residual**2)) / freedom if freedom > 0 else float("nan")
    sd = float(np.sqrt(variance * (gradient @ np.linalg.inv(design.T @ design) @ gradient)))
    found: list[TextbookResult] = [
        Estimate(
            symbol, run.name, bias / _DEGREE_PER_HOUR, sd / _DEGREE_PER_HOUR, "deg/h",
            f"{METHOD}: intercept over k, less the Earth rate along the input axis",
        )
        for symbol in (f"gyro_bias.bias[{name}]", f"F₀/k[{name},{run.mounting}]")
    ]  # fmt: skip
    still = ~series.turning
    if still.any():
        zero = float(np.mean(series.output[still])) / series.scale[0]
        spread = series.row_sd / np.sqrt(np.sum(still)) / abs(series.scale[0])
        found.append(
            Estimate(
                f"zero_rate_output[{name}]", run.name, zero / _DEGREE_PER_HOUR, spread / _DEGREE_PER_HOUR, "deg/h",
                f"{METHOD}: at rest, Earth rate included",
            )
        )  # fmt: skip
    return found


def _shape(series: RateSeries) -> list[TextbookResult]:
    """Return nonlinearity and asymmetry of the scale factor."""
    run, name, values = series.run, series.channel.name, series.corrected
    turning, largest = series.rate[series.turning], float(np.abs(values).max())
    found: list[TextbookResult] = [
        Estimate(
            f"nonlinearity[{name}]", run.name, float(np.abs(series.fitted.residual).max()) / largest * 1e6,
            series.row_sd / largest * 1e6, "ppm", f"{METHOD}: largest deviation from the line over the largest output",
            uncertainty="type A: scatter of one row about the line",
        ),
    ]  # fmt: skip
    forward, reverse = turning > 0, turning < 0
    if len(np.unique(turning[forward])) > 1 and len(np.unique(turning[reverse])) > 1:
        plus, minus = line(turning[forward], values[forward]), line(turning[reverse], values[reverse])
        mean = (plus.slope + minus.slope) / 2
        found.append(
            Estimate(
                f"asymmetry[{name}]", run.name, abs(plus.slope - minus.slope) / abs(mean) * 1e6,
                float(np.hypot(plus.slope_sd, minus.slope_sd)) / abs(mean) * 1e6, "ppm",
                f"{METHOD}: |K₊ − K₋| over their mean",
            )
        )  # fmt: skip
    return found


def _repeatability(each: Sequence[RateSeries]) -> list[TextbookResult]:
    """Return K_r at every temperature, pooled over them, and over all series."""
    found: list[TextbookResult] = []
    name = each[0].channel.name
    squares, freedom = 0.0, 0
    groups = [[series for series in each if series.run in group] for group in by_temperature([s.run for s in each])]
    for group in groups:
        if len(group) < 2:
            continue
        at = temperature_of(group[0].run)
        relative = _relative(group)
        squares, freedom = squares + float(np.sum(relative**2)), freedom + len(group) - 1
        where = f" at {np.mean([temperature_of(series.run) for series in group]):.0f} °C" if np.isfinite(at) else ""
        found.append(_spread(f"repeatability[{name}]", group, *standard_deviation(relative), where))
    if len(groups) > 1 and freedom:
        pooled = float(np.sqrt(squares / freedom))
        inside = [series for group in groups if len(group) > 1 for series in group]
        pooled_sd = pooled / np.sqrt(2 * freedom)
        found.append(_spread(f"repeatability_pooled[{name}]", inside, pooled, pooled_sd, " at each temperature"))
    if len(groups) > 1:
        found.append(_spread(f"repeatability_overall[{name}]", each, *standard_deviation(_relative(each)), _WITH))
    return found


_WITH = " at all temperatures, the change with temperature included"


def _relative(each: Sequence[RateSeries]) -> np.ndarray:
    """Return the relative deviations of the scale factors of series from their mean."""
    k = np.array([series.scale[0] for series in each])
    return k / np.mean(k) - 1


def _spread(name: str, each: Sequence[RateSeries], value: float, sd: float, where: str) -> Estimate:
    return Estimate(
        name, names_of([series.run for series in each]), value * 1e6, sd * 1e6, "ppm",
        f"{METHOD}: K_r, standard deviation of k over {len(each)} series{where}",
        uncertainty="type A: s/√(2ν) for ν degrees of freedom between the series",
    )  # fmt: skip


def _sensitivity(each: Sequence[RateSeries]) -> list[TextbookResult]:
    """Return the temperature sensitivity of the scale factor over series at several temperatures."""
    temperature = np.array([temperature_of(series.run) for series in each])
    if len(each) < 2 or not np.isfinite(temperature).all() or np.ptp(temperature) < _LEAST_RANGE:
        return []
    k, sd = (np.array(values) for values in zip(*(series.scale for series in each), strict=True))
    reference = int(np.argmin(np.abs(temperature - np.median(temperature))))
    others = np.flatnonzero(np.abs(temperature - temperature[reference]) > _LEAST_STEP)
    step = temperature[others] - temperature[reference]
    slopes = (k[others] - k[reference]) / k[reference] / step
    spread = np.hypot(sd[others], sd[reference]) / abs(k[reference]) / np.abs(step)
    largest = int(np.argmax(np.abs(slopes)))
    return [
        Estimate(
            f"temperature_sensitivity[{each[0].channel.name}]", names_of([series.run for series in each]),
            float(slopes[largest]) * 1e6, float(spread[largest]) * 1e6, "ppm/degC",
            f"{METHOD}: largest change of k from the median temperature, per degree",
        )
    ]  # fmt: skip


def combinations(campaign: Campaign, runs: Sequence[Run]) -> list[StandardCombination]:
    """Return k′ and the zero F₀/k of every gyro in every mounting."""
    found: list[StandardCombination] = [*projected_scale_factors(campaign, runs)]
    for mounting, run in {run.mounting: run for run in runs if run.mounting is not None}.items():
        for channel in campaign.of_kind("gyro"):
            zero = of_drift("F₀/k", channel.name, "deg/h", turn_mean_drift(campaign, run, channel), total=True)
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
    columns=(("table_rate_deg_s",),),
    needs_table=True,
    abscissae=("table_rate", "temperature", "time"),
    plan=PlanRules(("rates_deg_s",), ("converter_temperature_degC",), 20.0, _planned_rows),
    evaluate=rate_test,
    combinations=combinations,
)
