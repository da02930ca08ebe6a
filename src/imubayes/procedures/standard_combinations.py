"""Standard combinations: what a test determines where it does not separate the parameters themselves.

Every procedure declares its own, with the symbols of its standard; the textbook evaluation and the joint fit report
them under the same names.  A combination is declared for what the test determines at best: whether it was determined
is found from the information in the data, never from this declaration.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.campaign_data import Campaign, Channel, Run
from imubayes.procedures.textbook import along_table, components

DRIFT_COEFFICIENTS = {
    "D_F": "gyro_bias.bias",
    "D_I": "gyro_g_sensitivity.d_i", "D_O": "gyro_g_sensitivity.d_o", "D_S": "gyro_g_sensitivity.d_s",
    "D_II": "gyro_g2_sensitivity.d_ii", "D_OO": "gyro_g2_sensitivity.d_oo", "D_SS": "gyro_g2_sensitivity.d_ss",
    "D_IO": "gyro_g2_sensitivity.d_io", "D_OS": "gyro_g2_sensitivity.d_os", "D_SI": "gyro_g2_sensitivity.d_si",
}  # fmt: skip
"""Textbook symbol of a drift coefficient (IEEE Std 517) → parameter of the joint fit."""
LEAST_COSINE = 0.1
"""Gyros with |cos θ| below this to the axis of a rate table are not evaluated."""
_ROUNDING = 1e-9
_ANGLES = np.arange(72) * np.pi / 36


@dataclass(frozen=True)
class LinearCombination:
    """A sum of parameters.

    Attributes
    ----------
    name : symbol and label: `D_F+D_II[g]`.
    unit : of the sum, with each parameter in its own unit.
    weights : name of the parameter → its weight.
    constant : added to the sum, in `unit`.
    total : whether the sum stands for everything that acts together, so that a model may lack some of its members.
    middle_of : run in the middle of whose record it holds, where it changes with time; else empty.
    """

    name: str
    unit: str
    weights: Mapping[str, float]
    total: bool = False
    constant: float = 0.0
    middle_of: str = ""


@dataclass(frozen=True)
class ProjectedScaleFactor:
    """k′ = k cos θ, the slope of the output against the table rate.

    Attributes
    ----------
    name, unit : `k′[gx,pyramid]`, in the unit of the scale factor.
    scale, angle : names of the derived quantities k and θ.
    """

    name: str
    unit: str
    scale: str
    angle: str


StandardCombination = LinearCombination | ProjectedScaleFactor


def drift_terms(force: np.ndarray) -> np.ndarray:
    """Return the terms of the drift coefficients at specific forces along I, O and S in g, (3, n) → (n, 10)."""
    i, o, s = force
    return np.stack([np.ones_like(i), i, o, s, i * i, o * o, s * s, i * o, o * s, s * i], axis=1)


def of_drift(
    symbol: str, channel: str, unit: str, terms: Mapping[str, float], total: bool = False
) -> LinearCombination:
    """Return a combination of the drift coefficients of a gyro; `terms` are textbook symbol → weight."""
    weights = {f"{DRIFT_COEFFICIENTS[term]}[{channel}]": weight for term, weight in terms.items()}
    return LinearCombination(f"{symbol}[{channel}]", unit, weights, total)


def turn_mean_drift(campaign: Campaign, run: Run, channel: Channel) -> dict[str, float]:
    """Return the drift of a gyro as the mean over a whole turn of the table: textbook symbol → weight."""
    mean = drift_terms(components(run, campaign, channel, _ANGLES)).mean(axis=0)
    terms = zip(DRIFT_COEFFICIENTS, mean, strict=True)
    return {symbol: float(weight) for symbol, weight in terms if abs(weight) > _ROUNDING}


def projected_scale_factors(campaign: Campaign, runs: Sequence[Run]) -> Iterator[ProjectedScaleFactor]:
    """Return k′ of every gyro in every mounting, except where its axis is nearly across that of the table."""
    for mounting, run in {run.mounting: run for run in runs if run.mounting is not None}.items():
        for channel in campaign.of_kind("gyro"):
            if abs(float(along_table(run, campaign, channel.axes[0])[2])) > LEAST_COSINE:
                place, unit = f"[{channel.name},{mounting}]", f"{channel.output_unit} per {channel.per}"
                scale = f"scale_factor[{channel.name}]"
                yield ProjectedScaleFactor(f"k′{place}", unit, scale, f"mounting_angle{place}")
