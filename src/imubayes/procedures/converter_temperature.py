"""Converter of an accelerometer over temperature (P8): thermal ramp, current injection, and a line per input.

In a thermal ramp the unit is at rest while the temperature of sensor or converter varies.  In current injection a known
current replaces the accelerometer at the converter input.  It is equivalent to inputs beyond the range of a table, 12 g
and more.  The sensor is out of the loop, which separates the gain drift of the converter from that of the sensor.

The question is whether one line serves all inputs.  For each input (1 g, 1/√3 g in the trihedral mounting, a current
equivalent to several g) the output is linear in the converter temperature, D = f(T) = D₀ + s T, with its slope s and
its intercept D₀ at 0 °C.  With k the slope per unit of input at 1 g and k′ that at another input, Δk = |k′ − k|/|k|.
If a current equivalent to 1 g was injected, other injected currents are compared with it, because the sensor is in
neither.  Δk of the raw slopes s, not divided by the input, is given beside it: it is zero for a drift of the offset
alone.

Up to the threshold the 1 g line applies, above it the input needs its own line.  Both slopes are uncertain.  The
decision follows the probability that Δk does not exceed the threshold, for Student t distributed slopes; between 5 %
and 95 % there is none (JCGM 106, guard bands).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.foundations.campaign_data import Campaign, Channel, Mounting, Run, Site, Table
from imubayes.procedures import textbook
from imubayes.procedures.base import RAMP_KEYS, PlanRules, Procedure, Reduction
from imubayes.procedures.fitted_terms import LinearCombination, StandardCombination
from imubayes.procedures.textbook import Evaluation, Line, TextbookResult, Undetermined

METHOD = "straight line against converter temperature"
THRESHOLD = 0.1
"""Default Δk up to which the 1 g line applies to all inputs; a campaign, a model or an option sets another."""
NEAR_ONE_G = 0.1
"""Largest relative difference from 1 g of an injected current that stands for 1 g."""
_LEAST_INPUT = 0.1
_LEAST_RAMP = 2.0
_SURE = 0.95
_DRAWS = 20_000


@dataclass(frozen=True)
class ThermalLine:
    """The line of one channel in one run.

    Attributes
    ----------
    run, channel : what was measured.
    input : nominal, g.
    fitted : output against converter temperature in °C, recorded output units.
    """

    run: Run
    channel: Channel
    input: float
    fitted: Line

    @property
    def injected(self) -> bool:
        """Whether a current replaced the sensor."""
        return "current" in self.run.covariates

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the residuals."""
        return len(self.fitted.residual) - 2

    def draws(self, generator: np.random.Generator, raw: bool) -> np.ndarray:
        """Return draws of the slope, raw or per unit of input, shape (_DRAWS,)."""
        scatter = generator.standard_t(self.freedom, _DRAWS) if self.freedom > 0 else np.full(_DRAWS, np.nan)
        return (self.fitted.slope + self.fitted.slope_sd * scatter) / (1.0 if raw else self.input)


def converter_test(campaign: Campaign, runs: Sequence[Run], threshold: float | None = None) -> list[TextbookResult]:
    """Return line, relative slope, Δk and the decision for each input.

    Parameters
    ----------
    threshold : of Δk; that of the campaign if None.
    """
    if threshold is None:
        threshold = THRESHOLD if campaign.delta_k_threshold is None else campaign.delta_k_threshold
    found: list[TextbookResult] = []
    lines: dict[str, list[ThermalLine]] = {}
    for run in runs:
        temperature = run.covariates.get("converter_temperature")
        if temperature is None or np.ptp(temperature) < _LEAST_RAMP:
            found.append(Undetermined(run.name, "the converter temperature is constant"))
            continue
        for channel, output in textbook.measured(run, campaign, "accelerometer"):
            level = _input(run, campaign, channel)
            if abs(level) < _LEAST_INPUT:
                continue
            fitted = ThermalLine(run, channel, level, textbook.line(temperature, output + channel.offset))
            found += _line(fitted, campaign)
            lines.setdefault(channel.name, []).append(fitted)
    for each in lines.values():
        for one in each:
            base = base_of(one, each)
            if base is not one:
                found += _comparison(one, base, threshold)
    return found


def combinations(campaign: Campaign, runs: Sequence[Run]) -> list[StandardCombination]:
    """Return the slope of the line of every input: offset drift plus gain drift times the output."""
    found: list[StandardCombination] = []
    for run in runs:
        temperature = run.covariates.get("converter_temperature")
        if temperature is None or np.ptp(temperature) < _LEAST_RAMP:
            continue
        for channel, _ in textbook.measured(run, campaign, "accelerometer"):
            output = _input(run, campaign, channel) * campaign.site.gravity * channel.scale_si
            weights = {
                f"converter_offset_drift.slope[{channel.name}]": 1.0,
                f"converter_gain_drift.slope[{channel.name}]": 1e-6 * output,
            }
            name = f"slope[{channel.name},{run.name}]"
            found.append(LinearCombination(name, f"{channel.output_unit}/degC", weights))
    return found


def base_of(line: ThermalLine, lines: Sequence[ThermalLine]) -> ThermalLine:
    """Return the line at 1 g that a line is compared with: of injected currents the injected 1 g, if there is one."""

    def away(other: ThermalLine) -> float:
        return abs(abs(other.input) - 1)

    injected = [other for other in lines if other.injected and away(other) <= NEAR_ONE_G]
    sensed = [other for other in lines if not other.injected]
    return min((injected if line.injected else sensed) or lines, key=away)


def _input(run: Run, campaign: Campaign, channel: Channel) -> float:
    """Return the nominal input in g."""
    if "current" in run.covariates and channel.current_per_acceleration:
        acceleration = float(np.mean(run.covariates["current"])) / channel.current_per_acceleration
        return acceleration / campaign.site.gravity
    if run.mounting is None or run.table is None:
        return 0.0
    return float(np.mean(textbook.components(run, campaign, channel)[0]))


def _line(one: ThermalLine, campaign: Campaign) -> list[TextbookResult]:
    fitted, unit, how = one.fitted, one.channel.output_unit, "D = f(T)"
    nominal = one.input * one.channel.scale_si * campaign.site.gravity * 1e-6
    text = f"type A: residuals of the line, {one.freedom} degrees of freedom"
    tested = Evaluation(f"{one.channel.name},{one.run.name}", one.run.name, METHOD, text)
    return [
        tested.estimate("slope", fitted.slope, fitted.slope_sd, f"{unit}/degC", how),
        tested.estimate("intercept", fitted.intercept, fitted.intercept_sd, unit, f"{how}, at 0 °C"),
        tested.estimate("thermal_slope", fitted.slope / nominal, abs(fitted.slope_sd / nominal), "ppm/degC"),
    ]


def _comparison(one: ThermalLine, base: ThermalLine, threshold: float) -> Iterator[TextbookResult]:
    """Yield Δk with the decision, and Δk of the raw slopes."""
    runs, evaluation = f"{one.run.name}, {base.run.name}", "type A: residuals of both lines"
    tested = Evaluation(f"{one.channel.name},{one.run.name}", runs, METHOD, evaluation)
    for name, raw in (("delta_k", False), ("delta_k_raw", True)):
        slopes = [each.fitted.slope / (1.0 if raw else each.input) for each in (one, base)]
        errors = [each.fitted.slope_sd / (1.0 if raw else abs(each.input)) for each in (one, base)]
        delta = abs(slopes[0] - slopes[1]) / abs(slopes[1])
        spread = float(np.hypot(errors[0], slopes[0] / slopes[1] * errors[1])) / abs(slopes[1])
        how, decision = ("of the raw slopes", "") if raw else ("", decided(one, base, threshold))
        yield tested.estimate(name, delta * 100, spread * 100, "%", how, decision)


def within_threshold(one: ThermalLine, base: ThermalLine, threshold: float) -> float:
    """Return the probability that Δk does not exceed a threshold; NaN where a line has no degrees of freedom."""
    generator = np.random.default_rng(0)
    own, reference = one.draws(generator, raw=False), base.draws(generator, raw=False)
    if not (np.isfinite(own).all() and np.isfinite(reference).all()):
        return float("nan")
    return float(np.mean(np.abs(own - reference) <= threshold * np.abs(reference)))


def decided(one: ThermalLine, base: ThermalLine, threshold: float) -> str:
    """Return the decision between the 1 g line and a line of its own."""
    probability = within_threshold(one, base, threshold)
    kind = "injected " if base.injected else ""
    if probability >= _SURE:
        text = f"the {kind}{base.input:.3g} g line applies"
    elif probability <= 1 - _SURE:
        text = f"{one.input:.3g} g needs its own line"
    else:
        text = "not decided by these data"
    chance = (
        "" if np.isnan(probability) else f", P(Δk ≤ {threshold * 100:g} %) {textbook.compared_probability(probability)}"
    )
    return f"threshold {threshold * 100:g} %: {text}{chance}"


def _nominal_input(
    run: Run, channel: Channel, _site: Site, _table: Table | None, _mounting: Mounting | None
) -> np.ndarray | None:
    """Return the acceleration equivalent to the current, m/s², shape (R,)."""
    if not channel.current_per_acceleration or "current" not in run.covariates:
        return None
    return run.covariates["current"] / channel.current_per_acceleration


CURRENT_INJECTION = Procedure(
    name="current_injection",
    reference="IEEE Std 1293, electronics calibration",
    columns=(("current_mA",),),
    reduction=Reduction.BINNED,
    injected=True,
    abscissae=("converter_temperature", "current", "temperature", "time"),
    plan=PlanRules(("current_mA",), RAMP_KEYS),
    nominal_input=_nominal_input,
    evaluate=converter_test,
    combinations=combinations,
)


THERMAL_RAMP = Procedure(
    name="thermal_ramp",
    reference="IEEE Std 1293, thermal sensitivity test",
    columns=(("converter_temperature_degC", "temperature_degC"),),
    needs_table=True,
    reduction=Reduction.BINNED,
    abscissae=("converter_temperature", "temperature", "time"),
    plan=PlanRules(("converter_temperature_degC",), ("rows", "rate_degC_per_h")),
    evaluate=converter_test,
    combinations=combinations,
)
