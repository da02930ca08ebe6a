"""Converter of an accelerometer over temperature: a line per input, and whether one line serves all inputs (P8).

For each input (1 g, 1/√3 g in the trihedral mounting, a current equivalent to several g) the output is linear in the
converter temperature.  With k the relative slope at the input nearest 1 g and k′ that at another input,
Δk = |k′ − k|/|k|; up to the threshold the 1 g line applies, above it the input needs its own line.
"""

from collections.abc import Sequence

import numpy as np

from imubayes.campaign_data import Campaign, Channel, Run
from imubayes.procedures.textbook import Estimate, TextbookResult, Undetermined, components, line, measured

METHOD = "straight line against converter temperature"
THRESHOLD = 0.1
"""Default Δk up to which the 1 g line applies to all inputs."""
_LEAST_INPUT = 0.1
_LEAST_RAMP = 2.0


def converter_test(campaign: Campaign, runs: Sequence[Run], threshold: float = THRESHOLD) -> list[TextbookResult]:
    """Return the relative slope, Δk and the decision for each input."""
    found: list[TextbookResult] = []
    slopes: dict[str, list[tuple[float, Run, float, float]]] = {}
    for run in runs:
        temperature = run.covariates.get("converter_temperature")
        if temperature is None or np.ptp(temperature) < _LEAST_RAMP:
            found.append(Undetermined(run.name, "the converter temperature is constant"))
            continue
        for channel, output in measured(run, campaign, "accelerometer"):
            level = _input(run, campaign, channel)
            if abs(level) < _LEAST_INPUT:
                continue
            fitted = line(temperature - temperature.mean(), output)
            nominal = level * channel.scale_si * campaign.site.gravity
            slope, sd = fitted.slope / nominal * 1e6, abs(fitted.slope_sd / nominal) * 1e6
            found.append(Estimate(f"thermal_slope[{channel.name},{run.name}]", run.name, slope, sd, "ppm/degC", METHOD))
            slopes.setdefault(channel.name, []).append((level, run, slope, sd))
    for channel, each in slopes.items():
        found += _decisions(channel, each, threshold)
    return found


def _input(run: Run, campaign: Campaign, channel: Channel) -> float:
    """Return the nominal input in g."""
    if "current" in run.covariates and channel.current_per_acceleration:
        acceleration = float(np.mean(run.covariates["current"])) / channel.current_per_acceleration
        return acceleration / campaign.site.gravity
    if run.mounting is None or run.table is None:
        return 0.0
    return float(np.mean(components(run, campaign, channel)[0]))


def _decisions(channel: str, each: list[tuple[float, Run, float, float]], threshold: float) -> list[TextbookResult]:
    base = min(each, key=lambda slope: abs(abs(slope[0]) - 1))
    found: list[TextbookResult] = []
    for level, run, slope, sd in each:
        if run is base[1]:
            continue
        delta = abs(slope - base[2]) / abs(base[2])
        spread = float(np.hypot(sd, slope / base[2] * base[3])) / abs(base[2])
        decision = f"the {base[0]:.3g} g line applies" if delta <= threshold else f"{level:.3g} g needs its own line"
        found.append(
            Estimate(
                f"delta_k[{channel},{run.name}]", f"{run.name}, {base[1].name}", delta * 100, spread * 100, "%",
                METHOD, decision=f"threshold {threshold * 100:g} %: {decision}",
            )
        )  # fmt: skip
    return found
