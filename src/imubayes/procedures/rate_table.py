"""Rate table: constant rates about one axis (P1, P2).

In a tilted fixture a channel sees Ω cos θ: one mounting determines only the product k·cos θ·(1 + table rate error);
other mountings, tumble runs or a reference gyro separate the three.

The textbook fits a straight line of output against table rate, per channel.  With F̄_j the mean output at the rate Ω_j
and F̄_s, F̄_e those of the static records at start and end,

    F_j = F̄_j − (F̄_s + F̄_e)/2,   F_j = k′ Ω_j + F_0 + ν_j,   k = k′/cos θ

(IEEE Std 952 § 12.9).  θ is the nominal angle from the input axis to the table axis and is taken as exact: an error of
dθ is an error of tan θ·dθ in ln k, 6.86 ppm for each arcsec at the trihedral angle.
"""

from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from imubayes.campaign_data import Campaign, Channel, Run
from imubayes.procedures.base import Procedure
from imubayes.procedures.planned_steps import PlannedRows, PlannedSteps, PlanRules, whole_turns
from imubayes.procedures.textbook import Estimate, TextbookResult, Undetermined, along_table, line, measured
from imubayes.units import to_si

METHOD = "IEEE Std 952 rate test"
# Channels with |cos θ| below this are not evaluated.
_LEAST_COSINE = 0.1
_DEGREE = np.pi / 180


def rate_test(campaign: Campaign, runs: Sequence[Run]) -> list[TextbookResult]:
    """Return scale factor, zero-rate output, nonlinearity and asymmetry per run, and the repeatability over runs."""
    found: list[TextbookResult] = []
    scales: dict[tuple[str, str], list[tuple[Run, float, float]]] = defaultdict(list)
    for run in runs:
        rate = run.covariates["table_rate"]
        if len(np.unique(rate[rate != 0])) < 2:
            found.append(Undetermined(run.name, "fewer than two rates: no straight line can be fitted"))
            continue
        for channel, output in measured(run, campaign, "gyro"):
            cosine = float(along_table(run, campaign, channel.axes[0])[2])
            if abs(cosine) > _LEAST_COSINE:
                found += _of_run(run, channel, rate, output, cosine)
                k = _scale(rate, output)[0] / cosine
                temperature = float(np.mean(run.covariates.get("temperature", np.array([np.nan]))))
                scales[channel.name, str(run.mounting)].append((run, k, temperature))
    for (channel, _), series in scales.items():
        found += _over_runs(channel, series)
    return found


def corrected(run_rate: np.ndarray, output: np.ndarray) -> np.ndarray:
    """Return the outputs less the mean of the static records at start and end, if there are any, shape (R,)."""
    still = np.flatnonzero(run_rate == 0)
    return output - (output[still[0]] + output[still[-1]]) / 2 if len(still) else output


def _scale(rate: np.ndarray, output: np.ndarray) -> tuple[float, float, np.ndarray, np.ndarray]:
    """Return k′, its standard deviation, and the residuals and corrected outputs of the turning rows."""
    turning = rate != 0
    values = corrected(rate, output)[turning]
    fitted = line(rate[turning], values)
    return fitted.slope, fitted.slope_sd, fitted.residual, values


def _of_run(run: Run, channel: Channel, rate: np.ndarray, output: np.ndarray, cosine: float) -> list[TextbookResult]:
    slope, sd, residual, values = _scale(rate, output)
    factor, unit = to_si(channel.per), f"{channel.output_unit} per {channel.per}"
    angle, nominal = f"mounting_angle[{channel.name},{run.mounting}]", float(np.degrees(np.arccos(cosine)))
    turning = rate[rate != 0]
    found: list[TextbookResult] = [
        Estimate(
            f"scale_factor[{channel.name}]", run.name, slope / cosine * factor, abs(sd / cosine) * factor, unit,
            METHOD, angle, nominal,
        ),
        Estimate(
            f"nonlinearity[{channel.name}]", run.name, float(np.abs(residual).max() / np.abs(values).max()) * 1e6,
            float("nan"), "ppm", f"{METHOD}: largest deviation from the line over the largest output",
        ),
    ]  # fmt: skip
    forward, reverse = turning > 0, turning < 0
    if len(np.unique(turning[forward])) > 1 and len(np.unique(turning[reverse])) > 1:
        plus, minus = line(turning[forward], values[forward]), line(turning[reverse], values[reverse])
        mean = (plus.slope + minus.slope) / 2
        found.append(
            Estimate(
                f"asymmetry[{channel.name}]", run.name, abs(plus.slope - minus.slope) / abs(mean) * 1e6,
                float(np.hypot(plus.slope_sd, minus.slope_sd)) / abs(mean) * 1e6, "ppm",
                f"{METHOD}: |K₊ − K₋| over their mean",
            )
        )  # fmt: skip
    still = rate == 0
    if still.any():
        # The bias of the textbook is the output at rest, which includes the Earth rate.
        zero = float(np.mean(output[still])) / slope * cosine / (_DEGREE / 3600)
        found.append(
            Estimate(
                f"zero_rate_output[{channel.name}]", run.name, zero, float("nan"), "deg/h",
                f"{METHOD}: at rest, Earth rate included",
            )
        )  # fmt: skip
    return found


def _over_runs(channel: str, series: list[tuple[Run, float, float]]) -> list[TextbookResult]:
    """Return the repeatability of the scale factor at constant temperature, otherwise its temperature sensitivity."""
    names = ", ".join(run.name for run, _, _ in series)
    k = np.array([scale for _, scale, _ in series])
    temperature = np.array([mean for _, _, mean in series])
    found: list[TextbookResult] = []
    if len(k) < 2:
        return found
    middle = float(np.mean(k))
    if not np.isfinite(temperature).all() or np.ptp(temperature) < 2.0:
        spread = float(np.std(k, ddof=1)) / abs(middle) * 1e6
        found.append(
            Estimate(f"repeatability[{channel}]", names, spread, float("nan"), "ppm", f"{METHOD}: sd of K over series")
        )
        return found
    reference = int(np.argmin(np.abs(temperature - np.median(temperature))))
    others = np.abs(temperature - temperature[reference]) > 1.0
    slopes = (k[others] - k[reference]) / k[reference] / (temperature[others] - temperature[reference])
    found.append(
        Estimate(
            f"temperature_sensitivity[{channel}]", names, float(slopes[np.argmax(np.abs(slopes))]) * 1e6, float("nan"),
            "ppm/degC", f"{METHOD}: largest change of K from the median temperature, per degree",
        )
    )  # fmt: skip
    return found


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
)
