"""Numbers behind the pictures of a report: errors with limits, residuals, mountings, priors and posteriors."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Literal

import numpy as np
import polars as pl
import scipy  # loads its parts when they are first used

from imubayes.foundations.campaign_data import Campaign, Channel
from imubayes.foundations.quantity_names import name_of
from imubayes.foundations.records import Record
from imubayes.foundations.units import to_si
from imubayes.results.stored_tables import thinned
from imubayes.results.temperature_range import course_over_range
from imubayes_qualification.budgets.standard_quantities import SensorKind
from imubayes_qualification.budgets.unit_under_test import TestedUnit
from imubayes_qualification.certificate.conformity import ConformityOfQuantity

_CURVE, _DENSITY, _BINS = 33, 49, 16
# Draws behind a curve: its band is then known to a tenth of its width.
_MOST_DRAWS = 2000
_DIGITS = 7
_LARGEST_G = 1.05
ERROR_UNIT: dict[SensorKind, str] = {"gyro": "deg/h", "accelerometer": "ug"}
_PREFIX = {"gyro": "gyro", "accelerometer": "accel"}
Abscissa = Literal["input_rate", "input_angle", "temperature", "table_angle"]


class ErrorCurve(Record):
    """Error of one channel referred to its input, with the 95 % coverage band."""

    channel: str
    x: tuple[float, ...]
    y: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]


class LimitCurve(Record):
    """Limits of the error of one channel; None if there is none on that side."""

    channel: str
    x: tuple[float, ...]
    lower: tuple[float, ...] | None
    upper: tuple[float, ...] | None


class ResidualMeans(Record):
    """Means of whitened residuals of one channel in classes of the abscissa, and their numbers."""

    channel: str
    x: tuple[float, ...]
    mean: tuple[float, ...]
    count: tuple[int, ...]


class ErrorPicture(Record):
    """Error against rate, angle or temperature, and the residuals below it.

    Attributes
    ----------
    abscissa, x_unit : rate along the input axis, angle of that axis above the horizontal, temperature, table angle.
    curves : error of the unit with its nominal constants, in `unit`; none if only residuals are shown.
    limits : from the specification.
    residuals : standardised.
    """

    kind: SensorKind
    abscissa: Abscissa
    x_unit: str
    unit: str
    curves: tuple[ErrorCurve, ...]
    limits: tuple[LimitCurve, ...]
    residuals: tuple[ResidualMeans, ...]


class WorstResidual(Record):
    """The class means that stand out most, of all channels and covariates.

    Attributes
    ----------
    largest : the largest mean in its standard errors.
    expected : the size that the largest of so many exceeds by chance in 5 % of all cases.
    classes : number of class means looked at.
    """

    channel: str
    abscissa: str
    unit: str
    means: ResidualMeans
    largest: float
    expected: float
    classes: int


class AxisInMounting(Record):
    """Direction of a sensitive axis in the frame of the table, which turns about z: azimuth, angles to z, deg."""

    channel: str
    azimuth: float
    nominal: float
    found: float


class MountingPicture(Record):
    """The sensitive axes of one kind in one mounting."""

    mounting: str
    kind: SensorKind
    axes: tuple[AxisInMounting, ...]


class AngleDensity(Record):
    """Prior and posterior density of a mounting angle, as deviation from its nominal value in arcsec."""

    channel: str
    mounting: str
    prior_x: tuple[float, ...]
    prior: tuple[float, ...]
    posterior_x: tuple[float, ...]
    posterior: tuple[float, ...]


class PictureData(Record):
    """The numbers of all drawings that are in no table."""

    errors: tuple[ErrorPicture, ...] = ()
    worst: WorstResidual | None = None
    mountings: tuple[MountingPicture, ...] = ()
    angles: tuple[AngleDensity, ...] = ()


def _numbers(values: np.ndarray) -> tuple[float, ...]:
    """Return numbers with the digits that a picture shows."""
    return tuple(float(f"{value:.{_DIGITS}g}") for value in np.asarray(values, dtype=float))


_Rows = tuple[Abscissa, str, pl.DataFrame, str]
"""Abscissa, its unit, rows of the residuals, and their column with the abscissa."""
_Drawn = tuple[ErrorCurve, list[LimitCurve]]


def error_pictures(
    unit: TestedUnit, residuals: pl.DataFrame, limits: Sequence[ConformityOfQuantity]
) -> tuple[ErrorPicture, ...]:
    """Return the pictures of errors against rate, angle and temperature that the runs allow."""
    kinds: tuple[SensorKind, ...] = ("gyro", "accelerometer")
    return tuple(picture for kind in kinds for picture in _of_kind(unit, kind, residuals, limits))


def _of_kind(
    unit: TestedUnit, kind: SensorKind, residuals: pl.DataFrame, limits: Sequence[ConformityOfQuantity]
) -> Iterator[ErrorPicture]:
    """Yield the pictures of one kind; against the angle of a table, on which no error depends, residuals alone."""
    channels = [channel for channel in unit.channels if channel.kind == kind]
    own = residuals.filter((pl.col("kind") == kind) & (pl.col("procedure") != "current_injection"))
    for abscissa, x_unit, rows, column in _abscissae(kind, own) if channels and not own.is_empty() else ():
        means = tuple(_class_means(rows, channels, column))
        if not means:
            continue
        known = [each for channel in channels if (each := _drawn(unit, channel, abscissa, means, limits)) is not None]
        yield ErrorPicture(
            kind=kind, abscissa=abscissa, x_unit=x_unit, unit=ERROR_UNIT[kind], residuals=means,
            curves=tuple(curve for curve, _ in known), limits=tuple(bound for _, bounds in known for bound in bounds),
        )  # fmt: skip


def _abscissae(kind: SensorKind, own: pl.DataFrame) -> Iterator[_Rows]:
    if kind == "gyro":
        yield "input_rate", "deg/s", own, "input_observed"
    else:
        still = (pl.col("input_observed").abs() <= _LARGEST_G) & (pl.col("table_rate_deg_s").fill_null(0.0) == 0)
        angle = pl.col("input_observed").clip(-1.0, 1.0).arcsin().degrees().alias("input_angle_deg")
        yield "input_angle", "deg", own.filter(still).with_columns(angle), "input_angle_deg"
    yield "temperature", "degC", own, "temperature_degC"
    yield "table_angle", "deg", own.with_columns(pl.col("^table_angle_deg$") % 360.0), "table_angle_deg"


# Parameter → error by a unit of it at an input: in deg/h at a rate in deg/s, in µg at a specific force in g.
_SHAPES: dict[str, dict[str, Callable[[np.ndarray], np.ndarray]]] = {
    "gyro": {
        "gyro_scale_factor.scale": lambda rate: 3600e-6 * rate,
        "gyro_bias.bias": np.ones_like,
        "gyro_scale_asymmetry.asymmetry": lambda rate: 3600e-6 * np.abs(rate),
        "gyro_scale_quadratic.quadratic": lambda rate: 3600e-6 * rate**2,
        "gyro_scale_cubic.cubic": lambda rate: 3600e-6 * rate**3,
    },
    "accelerometer": {
        "accel_scale_factor.scale": lambda force: force,
        "accel_bias.bias": np.ones_like,
        "accel_scale_asymmetry.asymmetry": np.abs,
        "accel_quadratic.quadratic": np.square,
        "accel_odd_quadratic.odd_quadratic": lambda force: force * np.abs(force),
        "accel_cubic.cubic": lambda force: force**3,
    },
}


def _error(unit: TestedUnit, channel: Channel, along: np.ndarray) -> np.ndarray | None:
    """Return the error at inputs (n,) along the input axis, (S, n) as `_SHAPES` says; None without its parameters."""
    draws = thinned(unit.quantities.draws, _MOST_DRAWS)
    shapes = {name_of(family, channel.name): shape for family, shape in _SHAPES[channel.kind].items()}
    parts = [draws[name][:, None] * shape(along)[None, :] for name, shape in shapes.items() if name in draws]
    return np.sum(parts, axis=0) if parts else None


def _drawn(
    unit: TestedUnit, channel: Channel, abscissa: Abscissa, means: Sequence[ResidualMeans],
    limits: Sequence[ConformityOfQuantity],
) -> _Drawn | None:  # fmt: skip
    if abscissa == "temperature":
        span = min(min(each.x) for each in means), max(max(each.x) for each in means)
        return _over_temperature(unit, channel, span, limits)
    return None if abscissa == "table_angle" else _over_input(unit, channel, limits)


def _over_input(unit: TestedUnit, channel: Channel, limits: Sequence[ConformityOfQuantity]) -> _Drawn | None:
    """Return the error of a gyro over rate, of an accelerometer over angle; None if the model has none."""
    low, high = unit.input_range(channel.name) if channel.kind == "gyro" else (-90.0, 90.0)
    x = np.linspace(low, high, _CURVE)
    along = x if channel.kind == "gyro" else np.sin(np.radians(x))
    error = _error(unit, channel, along)
    if error is None or not high > low:
        return None
    return _curve(channel.name, x, error), _envelope(limits, channel, x, along)


def _over_temperature(
    unit: TestedUnit, channel: Channel, span: tuple[float, float], limits: Sequence[ConformityOfQuantity]
) -> _Drawn | None:
    draws, name = (
        thinned(unit.quantities.draws, _MOST_DRAWS),
        name_of(f"{_PREFIX[channel.kind]}_bias.bias", channel.name),
    )
    if name not in draws:
        return None
    x, values = course_over_range(name, unit.quantities.entries[name].unit, draws, unit.thermal, span)
    own = [found.limit for found in limits if found.limit.quantity.name == name]
    return _curve(channel.name, x, values), [
        _bound(channel.name, np.array(each.span or span), each.tolerance.lower, each.tolerance.upper) for each in own
    ]


def _curve(channel: str, x: np.ndarray, values: np.ndarray) -> ErrorCurve:
    finite = values[np.isfinite(values).all(axis=1)]
    low, high = np.quantile(finite, (0.025, 0.975), axis=0)
    return ErrorCurve(channel=channel, x=_numbers(x), y=_numbers(finite.mean(axis=0)), low=_numbers(low),
                      high=_numbers(high))  # fmt: skip


def _bound(channel: str, x: np.ndarray, lower: float | np.ndarray, upper: float | np.ndarray) -> LimitCurve:
    """Return limits that are constants or curves; None on a side if they are infinite."""
    below, above = (np.broadcast_to(end, x.shape) for end in (lower, upper))
    return LimitCurve(
        channel=channel,
        x=_numbers(x),
        lower=_numbers(below) if np.isfinite(below).all() else None,
        upper=_numbers(above) if np.isfinite(above).all() else None,
    )


def _envelope(
    limits: Sequence[ConformityOfQuantity], channel: Channel, x: np.ndarray, along: np.ndarray
) -> list[LimitCurve]:
    """Return the error that limits of bias and of relative scale factor (ppm) allow together, at inputs (n,)."""
    of = {found.limit.quantity.name: found.limit.tolerance for found in limits}
    prefix, per_input = _PREFIX[channel.kind], 3600.0 if channel.kind == "gyro" else 1e6
    constant, slope = (
        of.get(name_of(f"{prefix}_{each}", channel.name)) for each in ("bias.bias", "scale_factor.scale")
    )
    if constant is None or slope is None:
        return []
    ends = np.stack([slope.lower * 1e-6 * per_input * along, slope.upper * 1e-6 * per_input * along])
    return [_bound(channel.name, x, constant.lower + ends.min(axis=0), constant.upper + ends.max(axis=0))]


def _class_means(own: pl.DataFrame, channels: Sequence[Channel], column: str) -> Iterator[ResidualMeans]:
    """Yield means of whitened residuals in classes of equal width, for channels with two different values at least."""
    for channel in channels:
        if column not in own.columns:
            continue
        rows = own.filter(pl.col("channel") == channel.name).select(column, "whitened").drop_nulls()
        x, y = (rows[name].cast(pl.Float64).to_numpy() for name in (column, "whitened"))
        known = np.isfinite(x) & np.isfinite(y)
        x, y = x[known], y[known]
        if len(x) < 2 or np.ptp(x) <= 1e-6 * max(1.0, float(np.abs(x).max())):
            continue
        classes = np.minimum(((x - x.min()) / np.ptp(x) * _BINS).astype(int), _BINS - 1)
        parts = [np.flatnonzero(classes == place) for place in range(_BINS) if (classes == place).any()]
        yield ResidualMeans(
            channel=channel.name,
            x=_numbers(np.array([x[part].mean() for part in parts])),
            mean=_numbers(np.array([y[part].mean() for part in parts])),
            count=tuple(len(part) for part in parts),
        )


def worst_residual(
    residuals: pl.DataFrame, channels: Sequence[Channel], covariates: Mapping[str, tuple[str, str]]
) -> WorstResidual | None:
    """Return the class means that stand out most.

    Parameters
    ----------
    covariates : column → its words and unit.
    """
    largest, classes = None, 0
    for column, (phrase, unit) in covariates.items():
        for means in _class_means(residuals, channels, column):
            size = np.abs(np.array(means.mean)) * np.sqrt(means.count)
            classes += len(size)
            if largest is None or size.max() > largest[0]:
                largest = (float(size.max()), means, phrase, unit)
    if largest is None:
        return None
    size, means, phrase, unit = largest
    expected = float(scipy.stats.norm.isf(0.025 / classes))
    return WorstResidual(
        channel=means.channel, abscissa=phrase, unit=unit, means=means, largest=size, expected=expected, classes=classes
    )


def mounting_pictures(
    campaign: Campaign, angles: Mapping[tuple[str, str], tuple[float, float]]
) -> tuple[MountingPicture, ...]:
    """Return the sensitive axes in every mounting; `angles` is (channel, mounting) → nominal and found angle, deg."""
    found = []
    for name, mounting in campaign.mountings.items():
        for kind in ("gyro", "accelerometer"):
            axes = tuple(
                AxisInMounting(
                    channel=channel.name,
                    azimuth=_azimuth(mounting.body_to_table @ channel.axes[0]),
                    nominal=angles[channel.name, name][0],
                    found=angles[channel.name, name][1],
                )
                for channel in campaign.of_kind(kind)
                if (channel.name, name) in angles
            )
            if axes:
                found.append(MountingPicture(mounting=name, kind=kind, axes=axes))
    return tuple(found)


def _azimuth(direction: np.ndarray) -> float:
    across = np.hypot(direction[0], direction[1])
    return float(np.degrees(np.arctan2(direction[1], direction[0]))) if across > 1e-9 else 0.0


def angle_density(
    channel: str, mounting: str, prior: np.ndarray, posterior: np.ndarray, nominal: float
) -> AngleDensity:
    """Return densities of a mounting angle from draws of prior and posterior in degrees, (S,) each."""
    before, after = (_density((draws - nominal) * to_si("deg") / to_si("arcsec")) for draws in (prior, posterior))
    return AngleDensity(
        channel=channel, mounting=mounting, prior_x=before[0], prior=before[1], posterior_x=after[0], posterior=after[1]
    )


def _density(draws: np.ndarray) -> tuple[tuple[float, ...], tuple[float, ...]]:
    draws = draws[np.isfinite(draws)][:_MOST_DRAWS]
    low, high = np.quantile(draws, (0.001, 0.999))
    if not high > low:
        return (float(low),), (1.0,)
    x = np.linspace(low, high, _DENSITY)
    return _numbers(x), _numbers(scipy.stats.gaussian_kde(draws)(x))
