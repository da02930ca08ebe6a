"""Readings of a calibrated unit, and the temperature of its converter, turned into inputs with uncertainty.

The fitted model is inverted at draws of its posterior: the mean over the draws is the input along the axis of a
channel, their standard deviation the uncertainty of the calibration, in which the correlations of all parameters are
contained.  So is the offset that a recording may have of its own, and what effects of the model do that depend on what
a single channel does not tell: the input across its axis, or that of the other kind of sensor.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import polars as pl

from imubayes import Fit
from imubayes.campaign.run_tables import refuse_too_large
from imubayes.compiled.kept_programs import kept
from imubayes.foundations.arrays import Array, Float
from imubayes.foundations.campaign_data import Campaign, Channel
from imubayes.foundations.covariates import COVARIATES, REFERENCE_TEMPERATURE
from imubayes.foundations.errors import Issue, closest_first, input_error, refuse
from imubayes.foundations.quantity_names import name_of
from imubayes.foundations.units import to_si
from imubayes.model.model_file import UncertainEquipment
from imubayes.model.problem import Problem, values_of
from imubayes.model.sensitive_axes import SensitivityInputs, acting_on
from imubayes.results.result import Result
from imubayes.results.stored_tables import complete, draws_of, thinned
from imubayes_qualification.budgets.taken_as_exact import included_shifts, with_included
from imubayes_qualification.onboard import correct_recording as correction
from imubayes_qualification.onboard.inverted_path import inputs_of
from imubayes_qualification.onboard.record import UnexpressedEffect
from imubayes_qualification.onboard.response import TEMPERATURES, sensor_posterior, temperature_ranges
from imubayes_qualification.onboard.unexpressed_effects import Acting, input_ranges, uncorrected_effects

_MOST_DRAWS = 200
_ROWS_AT_ONCE = 500


@dataclass(frozen=True)
class CalibratedInputs:
    """Inputs along the axes of the channels that were read.

    Attributes
    ----------
    table : the readings, and for each channel its input, the standard uncertainty of the calibration, and that of the
        row: with the white noise of its samples.  In the input unit of the channel, named in the column.
    beyond : temperature, or kind of channel → rows outside its range in the runs that were fitted.
    ranges : temperature → calibrated range, °C; kind of channel → range of inputs, rad/s or m/s².
    left_in : effects that are not corrected; both uncertainties include their possible size.
    exact : uncertainties of site and equipment that the model takes as exact; both uncertainties include them.
    incomplete : number of rows without a result, because an output, a temperature or a number of samples is missing.

    Examples
    --------
    >>> import polars as pl
    >>> import imubayes
    >>> readings = pl.DataFrame({"ax": [20000.0], "converter_temperature_degC": [25.0]})
    >>> found = imubayes.apply("results/accel-channel", readings, nothing_across=True)
    >>> found.table["ax_g"].round(2).to_list(), found.incomplete
    ([1.0], 0)
    """

    table: pl.DataFrame
    beyond: Mapping[str, int]
    ranges: Mapping[str, tuple[float, float]]
    left_in: tuple[UnexpressedEffect, ...]
    exact: tuple[UncertainEquipment, ...] = ()
    incomplete: int = 0


def inputs_along_axes(
    result: Result, readings: pl.DataFrame, where: str = "readings", *,
    temperatures: Mapping[str, float] | None = None, nothing_across: bool = False,
) -> CalibratedInputs:  # fmt: skip
    """Return the inputs of a calibrated unit from its outputs.

    Parameters
    ----------
    result : a fit of the unit that converged.
    readings : a column per channel in output units; `converter_temperature_degC` and `temperature_degC` if the model
        depends on them; `samples` if rows are means.
    where : place of the readings, for errors.
    temperatures : temperature → value for all rows, if no column gives it, °C.
    nothing_across : whether there was no input across the axes; else there may have been one within the range of the
        runs that were fitted.

    Raises
    ------
    InputError
        if there are no posterior draws, or columns are missing or not numeric.
    """
    correction.check_stated(temperatures or {})
    fit = result.fit
    campaign = fit.model.campaign
    channels = [channel for channel in campaign.channels if channel.name in readings.columns]
    stated = {COVARIATES[name].column: value for name, value in (temperatures or {}).items()}
    readings = readings.with_columns(
        pl.lit(value).alias(name) for name, value in stated.items() if name not in readings.columns
    )
    _check(readings, campaign, channels, correction.needed_temperatures(result, channels), where)
    spans = input_ranges(campaign)
    ranges = temperature_ranges(campaign) | {kind: (-span, span) for kind, span in spans.items()}
    felt, beyond = _temperatures(readings, ranges)
    outputs = {
        kind: np.stack([_numbers(readings, channel.name, 0.0) for channel in campaign.of_kind(kind)], axis=1)
        for kind in fit.derived.derivation.inputs.channels
    }
    draws, exact = _draws(result, channels)
    mean, spread = _inverted(fit, draws, outputs, felt)
    samples = _numbers(readings, "samples", 1.0)
    samples = np.where(samples >= 1, samples, np.nan)
    left_in = effects_left_in(result, channels, nothing_across)
    noise = correction.reading_noise(result, channels)
    sigmas = {parameter.name: parameter.mean or 0.0 for parameter in result.summary.parameters}
    columns: list[pl.Series] = []
    incomplete = np.zeros(readings.height, dtype=bool)
    for channel in channels:
        place, scale = campaign.of_kind(channel.kind).index(channel), abs(channel.scale_si)
        white = sigmas.get(name_of("white_noise.sigma", channel.name), 0.0) / scale / np.sqrt(samples)
        shared = math.hypot(noise.run_sd[channel.name], correction.left_in_sd(left_in, channel)) / scale
        found, own = mean[channel.kind][:, place], np.hypot(spread[channel.kind][:, place], shared)
        columns += _columns(channel, campaign.site.gravity, found, own, white)
        rows = int(np.sum(np.abs(found) > correction.BEYOND * spans[channel.kind]))
        beyond[channel.kind] = max(beyond.get(channel.kind, 0), rows)
        incomplete |= ~np.isfinite(found + own + white)
    return CalibratedInputs(readings.with_columns(columns), beyond, ranges, left_in, exact, int(incomplete.sum()))


def effects_left_in(result: Result, channels: Sequence[Channel], nothing_across: bool) -> tuple[UnexpressedEffect, ...]:
    """Return the effects on channels that their own inputs do not determine."""
    posterior = sensor_posterior(result)

    def known(everything: Acting) -> Acting:
        found = {}
        for kind, each in everything.items():
            own = np.asarray(each.rate if kind == "gyro" else each.force)
            if not nothing_across:
                axes = np.stack([channel.axes[0] for channel in posterior.campaign.of_kind(kind)])
                own = np.sum(own * axes, axis=2, keepdims=True) * axes
            zero = np.zeros_like(own)
            found[kind] = acting_on(*((own, zero) if kind == "gyro" else (zero, own)))
        return found

    names = {channel.name for channel in channels}
    campaign = posterior.campaign
    found = uncorrected_effects(result, posterior, known, input_ranges(campaign), temperature_ranges(campaign))
    return tuple(each for each in found if names & set(each.channels))


def _columns(
    channel: Channel, gravity: float, found: np.ndarray, calibration: np.ndarray, noise: np.ndarray
) -> list[pl.Series]:
    """Return the columns of one channel, in its input unit."""
    factor, unit = to_si(channel.per, gravity), channel.per.replace("^", "").replace("/", "_")
    values = {"": found, "_calibration_sd": calibration, "_sd": np.hypot(calibration, noise)}
    return [pl.Series(f"{channel.name}{n}_{unit}", each / factor, nan_to_null=True) for n, each in values.items()]


def read_readings(file: Path) -> pl.DataFrame:
    """Read a table of readings, CSV or Parquet.

    Raises
    ------
    InputError
        if the file is missing or no such table.
    """
    try:
        if file.suffix != ".parquet":
            return pl.read_csv(file, infer_schema_length=None)
        scanned = pl.scan_parquet(file)
        refuse_too_large(file, scanned.select(pl.len()).collect().item() * len(scanned.collect_schema()))
        return scanned.collect()
    except (OSError, pl.exceptions.PolarsError) as error:
        fault = "the file cannot be read as a table" if file.is_file() else "there is no such file"
        allowed = "a CSV or Parquet table with a header"
        raise input_error(fault, str(file), allowed, "give the path of the readings") from error


def _numbers(readings: pl.DataFrame, name: str, otherwise: float) -> np.ndarray:
    """Return a column as numbers, shape (R,); a constant if it is not given."""
    given = name in readings.columns
    return readings[name].cast(pl.Float64).to_numpy() if given else np.full(readings.height, otherwise)


def _check(
    readings: pl.DataFrame, campaign: Campaign, channels: Sequence[Channel], needed: Sequence[str], where: str
) -> None:
    """Raise InputError with everything that is wrong with the columns of readings."""
    issues = [*_missing(readings, needed, where), *_not_numeric(readings, channels, where)]
    if not channels:
        names = [channel.name for channel in campaign.channels if channel.kind != "angle"]
        allowed = closest_first(next(iter(readings.columns), ""), names)
        issues.append(Issue("no column is a channel of the unit", where, allowed, "name the columns like the channels"))
    refuse(issues)


def _missing(readings: pl.DataFrame, needed: Sequence[str], where: str) -> list[Issue]:
    """Return an issue for every temperature that the channels depend on and the readings lack."""
    return [correction.not_given(name, where) for name in needed if COVARIATES[name].column not in readings.columns]


def _not_numeric(readings: pl.DataFrame, channels: Sequence[Channel], where: str) -> list[Issue]:
    used = [*(channel.name for channel in channels), "samples", *(COVARIATES[name].column for name in TEMPERATURES)]
    return [
        Issue(f"column '{name}' is not numeric", f"{where}, column '{name}'", "numbers in every row", "correct it")
        for name in used
        if name in readings.columns and not readings[name].dtype.is_numeric()
    ]


def _temperatures(readings: pl.DataFrame, ranges: dict[str, tuple[float, float]]) -> tuple[np.ndarray, dict[str, int]]:
    """Return the temperatures of sensor and converter, shape (R, 2), and the rows in which one is beyond its range."""
    found = [_numbers(readings, COVARIATES[name].column, REFERENCE_TEMPERATURE) for name in TEMPERATURES]
    beyond = {}
    for name, values in zip(TEMPERATURES, found, strict=True):
        if name in ranges and COVARIATES[name].column in readings.columns:
            low, high = ranges[name]
            beyond[name] = int(np.sum((values < low) | (values > high)))
    return np.stack(found, axis=1), beyond


def _draws(result: Result, channels: Sequence[Channel]) -> tuple[np.ndarray, tuple[UncertainEquipment, ...]]:
    """Return draws in z, (S, P), with what a report includes of site and equipment, and what of it channels feel.

    Raises
    ------
    InputError
        if the fit did not converge, so that there are none.
    """
    layout = result.fit.model.layout
    found = thinned(complete(draws_of(result.posterior, layout.names)), _MOST_DRAWS)
    values = np.stack([found[name] for name in layout.names], axis=1)
    points = np.stack([layout.z_of(row) for row in values])
    own = {channel.name for channel in channels}
    told = np.array([bool(own & set(parameter.label)) for parameter in layout.parameters])
    return with_included(points, included_shifts(result.fit), told)


@kept
def _invert(
    inputs: SensitivityInputs, problem: Problem, points: Float[Array, "S P"], outputs, temperatures: Float[Array, "R 2"]
):
    """Return mean and standard deviation over the draws of the inputs of every row, kind → (R, C)."""
    values = jax.vmap(lambda z: values_of(problem, z))(points)

    def of_row(row, at):
        ambient = {"temperature": at[0], "converter_temperature": at[1]}
        return jax.vmap(lambda each: inputs_of(inputs, each, row, ambient))(values)

    found = jax.vmap(of_row)(outputs, temperatures)
    return jax.tree.map(lambda each: each.mean(axis=1), found), jax.tree.map(lambda each: each.std(axis=1), found)


def _inverted(
    fit: Fit, points: np.ndarray, outputs: dict[str, np.ndarray], temperatures: np.ndarray
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    inputs, problem = fit.derived.derivation.inputs, fit.model.problem
    rows = len(temperatures)
    size = min(_ROWS_AT_ONCE, max(rows, 1))
    blocks = math.ceil(rows / size)
    means, spreads = [], []
    for block in range(blocks):
        # All blocks have one size, so that one program serves all: the last is padded with its last row.
        chosen = np.minimum(np.arange(block * size, (block + 1) * size), rows - 1)
        mean, spread = _invert(
            inputs, problem, jnp.asarray(points), {kind: jnp.asarray(y[chosen]) for kind, y in outputs.items()},
            jnp.asarray(temperatures[chosen]),
        )  # fmt: skip
        means.append(mean)
        spreads.append(spread)
    return _joined(means, rows), _joined(spreads, rows)


def _joined(blocks: list[dict[str, Array]], rows: int) -> dict[str, np.ndarray]:
    kinds = blocks[0] if blocks else {}
    return {kind: np.concatenate([np.asarray(block[kind]) for block in blocks])[:rows] for kind in kinds}
