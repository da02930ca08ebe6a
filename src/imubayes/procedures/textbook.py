"""Results and common parts of textbook evaluations (NumPy only).

Each procedure is evaluated by itself, with fixture angles, table and temperature taken as exact, for comparison with
the joint fit.  Standard deviations come from the residuals of the fitted curve (type A); they do not include the errors
of these assumptions.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import SupportsFloat

import numpy as np

from imubayes.foundations.campaign_data import Campaign, Channel, Run
from imubayes.foundations.units import to_si
from imubayes.procedures.kinematics import turned_back

RESIDUALS = "type A: residuals of the fitted curve"
DEGREE_PER_HOUR, ARCSEC = to_si("deg/h"), to_si("arcsec")
# Tests at temperatures closer than this are tests at the same temperature.
_SAME_TEMPERATURE = 5.0


# A probability from draws is not distinguished from 0 or 1 below this: some thousand draws have none beyond.
_LEAST_PROBABILITY = 1e-3


def compared_probability(probability: float) -> str:
    """Return a probability from draws with its relation: `= 0.014`, `< 0.001`, `> 0.999`."""
    if probability < _LEAST_PROBABILITY:
        return f"< {_LEAST_PROBABILITY:g}"
    return f"> {1 - _LEAST_PROBABILITY:g}" if probability > 1 - _LEAST_PROBABILITY else f"= {probability:.2g}"


@dataclass(frozen=True)
class Estimate:
    """One number of a textbook evaluation.

    Attributes
    ----------
    name : as in the joint fit if that has the quantity: `scale_factor[gx]`.
    run : the run or runs evaluated.
    value, sd, unit : with the textbook standard uncertainty; NaN if the textbook gives none.
    method : source of the formula.
    angle : name of the mounting angle that the formula takes as exact; empty if none.
    nominal : that angle, deg.
    decision : textbook conclusion from the value; empty if none.
    uncertainty : how the standard uncertainty was evaluated (GUM).
    """

    name: str
    run: str
    value: float
    sd: float
    unit: str
    method: str
    angle: str = ""
    nominal: float = float("nan")
    decision: str = ""
    uncertainty: str = RESIDUALS


@dataclass(frozen=True)
class Undetermined:
    """Quantities that a run does not determine, with the reason, for display."""

    run: str
    sentence: str


TextbookResult = Estimate | Undetermined


@dataclass(frozen=True)
class Evaluation:
    """What is evaluated at once: a channel in some runs, by one method.

    Attributes
    ----------
    of : in the brackets of names: the channel, with mounting or run if it has a value for each.
    run, method, uncertainty : as in `Estimate`.
    """

    of: str
    run: str
    method: str
    uncertainty: str = RESIDUALS

    def estimate(
        self,
        symbol: str,
        value: SupportsFloat,
        sd: SupportsFloat,
        unit: str,
        how: str = "",
        decision: str = "",
        uncertainty: str = "",
    ) -> Estimate:
        """Return an estimate; `how` is said behind the method, and `uncertainty` is that of the evaluation if empty."""
        return Estimate(
            f"{symbol}[{self.of}]", self.run, float(value), float(sd), unit,
            f"{self.method}: {how}" if how else self.method,
            decision=decision, uncertainty=uncertainty or self.uncertainty,
        )  # fmt: skip


@dataclass(frozen=True)
class Line:
    """y = intercept + slope·x by least squares, with standard deviations and the residuals."""

    slope: float
    intercept: float
    slope_sd: float
    intercept_sd: float
    residual: np.ndarray


def line(x: np.ndarray, y: np.ndarray) -> Line:
    """Return the straight line through points; standard deviations are NaN for two points."""
    design = np.stack([np.ones_like(x), x], axis=1)
    (intercept, slope), covariance, residual = least_squares(design, y)
    intercept_sd, slope_sd = np.sqrt(np.diag(covariance))
    return Line(float(slope), float(intercept), float(slope_sd), float(intercept_sd), residual)


def least_squares(design: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return coefficients, their covariance from the scatter of the residuals, and the residuals.

    Parameters
    ----------
    design : shape (n, k), of full rank.
    y : shape (n,).
    """
    coefficients, *_ = np.linalg.lstsq(design, y)
    residual = y - design @ coefficients
    freedom = len(y) - design.shape[1]
    variance = float(residual @ residual) / freedom if freedom > 0 else float("nan")
    return coefficients, variance * np.linalg.inv(design.T @ design), residual


def measured(run: Run, campaign: Campaign, kind: str) -> list[tuple[Channel, np.ndarray]]:
    """Return the channels of a kind with complete outputs in a run, and these less the nominal offset, shape (R,)."""
    found = []
    for place, channel in enumerate(campaign.channels):
        output = run.observed[:, place]
        if channel.kind == kind and np.isfinite(output).all() and len(output):
            found.append((channel, output - channel.offset))
    return found


def along_table(run: Run, campaign: Campaign, axis: np.ndarray) -> np.ndarray:
    """Return a body direction in table axes, nominal, shape (3,)."""
    assert run.mounting is not None
    return campaign.mountings[run.mounting].body_to_table @ axis


def up_in_table(run: Run, campaign: Campaign) -> np.ndarray:
    """Return the direction of the specific force at table angle 0 in table axes, shape (3,)."""
    assert run.table is not None
    table = campaign.tables[run.table]
    return table.to_local.T @ np.array([0.0, 0.0, 1.0])


def components(run: Run, campaign: Campaign, channel: Channel, angle: np.ndarray | None = None) -> np.ndarray:
    """Return the specific force along a channel's I, O and S axes at table angles (default: the rows), g, (3, n)."""
    angle = run.covariates["table_angle"] if angle is None else angle
    assert run.mounting is not None
    to_body = campaign.mountings[run.mounting].body_to_table.T
    return channel.axes @ to_body @ turned_back(up_in_table(run, campaign), angle)


def axial(run: Run, campaign: Campaign, vector: np.ndarray) -> float:
    """Return the component of a vector of the local level along the table's axis."""
    assert run.table is not None
    table = campaign.tables[run.table]
    return float(table.to_local[:, 2] @ vector)


def temperature_of(run: Run) -> float:
    """Return the mean sensor temperature of a run, °C; NaN if not recorded."""
    return float(np.mean(run.covariates.get("temperature", np.array([np.nan]))))


def by_temperature(runs: Sequence[Run]) -> list[list[Run]]:
    """Return the runs in groups at the same temperature, the coldest first; those without one are the last group."""
    groups: list[list[Run]] = []
    last = float("-inf")
    for run in sorted(runs, key=lambda run: (np.isnan(temperature_of(run)), temperature_of(run))):
        here = temperature_of(run)
        if groups and (here - last < _SAME_TEMPERATURE or (np.isnan(here) and np.isnan(last))):
            groups[-1].append(run)
        else:
            groups.append([run])
        last = here
    return [[run for run in runs if any(run is other for other in group)] for group in groups]


def standard_deviation(values: Sequence[float] | np.ndarray) -> tuple[float, float]:
    """Return the standard deviation of repeated values and its standard uncertainty, s/√(2(n − 1)) for normal scatter.

    Source: JCGM 100:2008, E.4.3.
    """
    spread = float(np.std(values, ddof=1))
    return spread, spread / np.sqrt(2 * (len(values) - 1))


def names_of(runs: Sequence[Run]) -> str:
    """Return the names of runs, as an estimate from several of them quotes them."""
    return ", ".join(run.name for run in runs)
