"""What a textbook evaluation yields, and the straight line that most of them come down to (NumPy only).

Each procedure is evaluated by itself, with the fixture angle, the table and the temperature taken as exact: that is
what the joint fit is compared with.  Standard deviations are the textbook's own, from the scatter about the fitted
curve; what is wrong with its assumptions they do not contain.
"""

from dataclasses import dataclass

import numpy as np

from imubayes.earth import table_to_local
from imubayes.run import Campaign, Channel, Run

_MAX_HARMONIC = 5


@dataclass(frozen=True)
class Estimate:
    """One number of a textbook evaluation.

    Attributes
    ----------
    name : as the joint fit names the same quantity where it has it: `scale_factor[gx]`.
    run : the run, or the runs, that it was made of.
    value, sd, unit : with the standard uncertainty that the textbook states; NaN where it states none.
    method : where the formula is from.
    angle : name of the mounting angle that the formula takes as exact, empty where it takes none.
    nominal : that angle, deg.
    decision : what the textbook concludes from the number, in words; empty where nothing.
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


@dataclass(frozen=True)
class Undetermined:
    """What a run cannot determine, and why, in a sentence."""

    run: str
    sentence: str


TextbookResult = Estimate | Undetermined


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
    """Return the channels of a kind that a run has readings of, with the readings less the nominal offset, (R,)."""
    found = []
    for place, channel in enumerate(campaign.channels):
        readings = run.observed[:, place]
        if channel.kind == kind and np.isfinite(readings).all() and len(readings):
            found.append((channel, readings - channel.offset))
    return found


def along_table(run: Run, campaign: Campaign, axis: np.ndarray) -> np.ndarray:
    """Return a body direction in table axes, nominal, shape (3,)."""
    assert run.mounting is not None
    return campaign.mountings[run.mounting].body_to_table @ axis


def up_in_table(run: Run, campaign: Campaign) -> np.ndarray:
    """Return the direction of the specific force at table angle 0 in table axes, shape (3,)."""
    assert run.table is not None
    table = campaign.tables[run.table]
    return table_to_local(table.azimuth, table.elevation).T @ np.array([0.0, 0.0, 1.0])


def components(run: Run, campaign: Campaign, channel: Channel, angle: np.ndarray | None = None) -> np.ndarray:
    """Return the specific force along a channel's I, O and S axes, in g, shape (3, n); at each row where no angle."""
    angle = run.covariates["table_angle"] if angle is None else angle
    x, y, z = up_in_table(run, campaign)
    c, s = np.cos(angle), np.sin(angle)
    turned = np.stack([c * x + s * y, c * y - s * x, np.full_like(angle, z)])
    assert run.mounting is not None
    return channel.axes @ campaign.mountings[run.mounting].body_to_table.T @ turned


def axial(run: Run, campaign: Campaign, vector: np.ndarray) -> float:
    """Return the component of a vector of the local level along the table's axis."""
    assert run.table is not None
    table = campaign.tables[run.table]
    return float(table_to_local(table.azimuth, table.elevation)[:, 2] @ vector)


def harmonics(psi: np.ndarray, output: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
    """Return B0, C1, S1, C2, S2, … by least squares, and their covariance.

    Parameters
    ----------
    psi : shape (n,), rad.
    output : shape (n,).
    order : highest harmonic; at n = 2·order positions the last sine is zero everywhere and is left out.
    """
    columns = [np.ones_like(psi)]
    for k in range(1, order + 1):
        columns += [np.cos(k * psi), np.sin(k * psi)]
    if len(psi) == 2 * order:
        columns.pop()
    coefficients, covariance, _ = least_squares(np.stack(columns, axis=1), output)
    return coefficients, covariance


def order_of(positions: int) -> int:
    """Return the highest harmonic that so many positions over the circle determine: 2 for 4 points, 5 from 11 on."""
    return min(_MAX_HARMONIC, positions // 2)
