"""A whole recording of a calibrated unit turned into rate and specific force of the body, with uncertainty.

All channels of a row are solved jointly (`imubayes.model.body_solution`), so that misalignment, nonlinear terms and the
g-sensitivity of the gyros are removed together.  Two standard uncertainties go with every number.  The *systematic* one
comes from the posterior of the parameters, from the offset that a recording may have of its own and from the effects
that are left in, for want of what they depend on: it is taken as the same for all rows and does not average.  The
*random* one comes from the noise of the row and averages over rows.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import jax.numpy as jnp
import numpy as np

from imubayes.campaign.run_tables import RowBatch
from imubayes.campaign_data import Campaign, Channel
from imubayes.covariates import COVARIATES, REFERENCE_TEMPERATURE
from imubayes.errors import InputError, Issue
from imubayes.model.body_solution import solve_rows
from imubayes.model.sensitive_axes import acting_on
from imubayes.qualification.onboard_record import UnexpressedEffect
from imubayes.qualification.reading_noise import ReadingNoise, reading_noise
from imubayes.qualification.sensor_posterior import (
    TEMPERATURES,
    SensorPosterior,
    complete_kinds,
    sensor_posterior,
    temperature_ranges,
)
from imubayes.qualification.unexpressed_effects import Acting, acts_linearly, input_ranges, uncorrected_effects
from imubayes.results.result import Result

_ROWS_AT_ONCE = 2048
# A row is solved where the last step is below this share of the largest component.
_CONVERGED = 1e-9
# Vibration and noise exceed the largest mean of a row by a part of it.
_BEYOND = 1.1
VECTORS = {"gyro": ("rate", "rad_s"), "accelerometer": ("force", "m_s2")}
"""Kind of channel → name and unit of the vector of its columns."""


@dataclass
class RowTally:
    """What was noticed in the rows of a recording.

    Attributes
    ----------
    rows : rows read.
    incomplete : rows in which an output that is needed is missing or not finite.
    unsolved : rows outside the range in which the model can be inverted.
    beyond : temperature, or kind of channel → rows outside its range in the runs that were fitted.
    """

    rows: int = 0
    incomplete: int = 0
    unsolved: int = 0
    beyond: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Correction:
    """A calibrated unit, ready to correct rows.

    Attributes
    ----------
    posterior, noise : of the unit.
    kinds : kinds of channels that the recording has and that span three dimensions.
    needs : temperatures that the outputs of these kinds depend on in the model.
    ranges : temperature → lowest and highest calibrated value, °C; kind of channel → those of the inputs, in SI.
    left_in : effects that are not taken out; what they may do is in the systematic uncertainty.
    """

    posterior: SensorPosterior
    noise: ReadingNoise
    kinds: tuple[str, ...]
    needs: tuple[str, ...]
    ranges: dict[str, tuple[float, float]]
    left_in: tuple[UnexpressedEffect, ...] = ()

    @property
    def channels(self) -> list[Channel]:
        """The channels that are read, one kind after the other."""
        return [channel for kind in self.kinds for channel in self.posterior.campaign.of_kind(kind)]

    def columns(self, batch: RowBatch, stated: dict[str, float], tally: RowTally) -> dict[str, np.ndarray]:
        """Return the columns of corrected rows: for each vector its components, its length, and their uncertainties.

        Parameters
        ----------
        batch : rows, with a column for every channel.
        stated : temperature → value for all rows, where no column gives it, °C.
        tally : is updated.
        """
        outputs = np.stack([batch.numbers[channel.name] for channel in self.channels], axis=1)
        samples = batch.numbers.get("samples", np.ones(batch.rows))
        temperatures = self._temperatures(batch, stated, tally)
        usable = np.isfinite(temperatures).all(axis=1) & (samples >= 1)
        missing = self._missing(outputs, usable)
        nominal = np.array([channel.offset for channel in self.channels])
        filled = np.where(np.isfinite(outputs), outputs, nominal)
        sound = np.where(usable, samples, 1.0)
        variances = np.stack(
            [self.noise.variances(channel, sound, filled[:, k]) for k, channel in enumerate(self.channels)], axis=1
        )
        warm = np.where(np.isfinite(temperatures), temperatures, REFERENCE_TEMPERATURE)
        inputs, systematic, random, unsolved = self._solved(filled, variances, warm)
        tally.rows += batch.rows
        tally.incomplete += int(missing.any(axis=1).sum())
        tally.unsolved += int((unsolved & ~missing.any(axis=1)).sum())
        for place, kind in enumerate(kind for kind in ("gyro", "accelerometer") if kind in self.kinds):
            acting = np.abs(inputs[~missing.any(axis=1) & ~unsolved, 3 * place : 3 * place + 3])
            self._count_beyond(kind, acting.max(axis=1) / _BEYOND, tally)
        return self._named(inputs, systematic, random, missing | unsolved[:, None])

    def _temperatures(self, batch: RowBatch, stated: dict[str, float], tally: RowTally) -> np.ndarray:
        """Return the temperatures of sensor and converter, shape (R, 2); what the model does not need is T_ref."""
        found = []
        for name in TEMPERATURES:
            unsaid = np.full(batch.rows, stated.get(name, np.nan))
            values = batch.numbers.get(COVARIATES[name].column, unsaid)
            self._count_beyond(name, values, tally)
            found.append(values if name in self.needs else np.full(batch.rows, REFERENCE_TEMPERATURE))
        return np.stack(found, axis=1)

    def _count_beyond(self, name: str, values: np.ndarray, tally: RowTally) -> None:
        if name in self.ranges:
            low, high = self.ranges[name]
            tally.beyond[name] = tally.beyond.get(name, 0) + int(np.sum((values < low) | (values > high)))

    def _missing(self, outputs: np.ndarray, usable: np.ndarray) -> np.ndarray:
        """Return for each row and kind whether it cannot be solved, shape (R, kinds).

        A gyro's own g-sensitivity needs the specific force: without it the rate is missing as well.
        """
        absent, first = [], 0
        for kind in self.kinds:
            count = len(self.posterior.campaign.of_kind(kind))
            absent.append(~np.isfinite(outputs[:, first : first + count]).all(axis=1) | ~usable)
            first += count
        found = np.stack(absent, axis=1)
        if "accelerometer" in self.kinds and "gyro" in self.kinds:
            found[:, self.kinds.index("gyro")] |= found[:, self.kinds.index("accelerometer")]
        return found

    def _solved(
        self, outputs: np.ndarray, variances: np.ndarray, temperatures: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return inputs (R, n), systematic and random error vectors (R, n, K) and (R, n, C), and unsolved rows (R,)."""
        posterior, blocks = self.posterior, []
        shared = np.array([np.hypot(self.noise.run_sd[c.name], left_in_sd(self.left_in, c)) for c in self.channels])
        weights = 1 / np.where(variances > 0, variances, 1.0)
        for first in range(0, len(outputs), _ROWS_AT_ONCE):
            # All blocks have one size, so that one program serves all: the last is padded with its last row.
            rows = np.minimum(np.arange(first, first + _ROWS_AT_ONCE), len(outputs) - 1)
            found = solve_rows(
                posterior.inputs, jnp.asarray(posterior.values), jnp.asarray(posterior.places),
                jnp.asarray(posterior.factor), self.kinds,
                *(jnp.asarray(each[rows]) for each in (outputs, weights, temperatures)),
            )  # fmt: skip
            gain = np.asarray(found.gain)
            systematic = np.concatenate([np.asarray(found.by_parameters), gain * shared], axis=2)
            random = gain * np.sqrt(variances[rows])[:, None, :]
            size = np.abs(np.asarray(found.inputs)).max(axis=1)
            unsolved = ~(np.abs(np.asarray(found.step)).max(axis=1) <= _CONVERGED * np.maximum(size, 1e-6))
            kept = min(_ROWS_AT_ONCE, len(outputs) - first)
            blocks.append([each[:kept] for each in (np.asarray(found.inputs), systematic, random, unsolved)])
        whole = [np.concatenate(part) for part in zip(*blocks, strict=True)]
        return whole[0], whole[1], whole[2], whole[3]

    def _named(
        self, inputs: np.ndarray, systematic: np.ndarray, random: np.ndarray, absent: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Return the columns of the vectors; gyros come first in the solution."""
        columns: dict[str, np.ndarray] = {}
        order = [kind for kind in ("gyro", "accelerometer") if kind in self.kinds]
        for place, kind in enumerate(order):
            chosen = slice(3 * place, 3 * place + 3)
            vector, gone = inputs[:, chosen], absent[:, self.kinds.index(kind)]
            length = np.linalg.norm(vector, axis=1)
            direction = vector / np.where(length > 0, length, 1.0)[:, None]
            name, unit = VECTORS[kind]
            for axis, part, values in (
                *((axis, np.eye(3)[k][None], vector[:, k]) for k, axis in enumerate("xyz")),
                ("norm", direction, length),
            ):
                spread = [np.linalg.norm(np.sum(part[:, :, None] * error[:, chosen], axis=1), axis=1)
                          for error in (systematic, random)]  # fmt: skip
                named = zip(("", "_systematic_sd", "_random_sd"), (values, *spread), strict=True)
                columns |= {f"{name}_{axis}{suffix}_{unit}": np.where(gone, np.nan, found) for suffix, found in named}
        return columns


def _refusal(campaign: Campaign, where: str) -> InputError:
    """Return the error for a recording, or a unit, without channels for all three axes."""
    names = [channel.name for channel in campaign.channels if channel.kind != "angle"]
    if complete_kinds(campaign.channels, names):
        what = "the recording has no complete set of gyros or accelerometers that span three axes"
        issue = Issue(what, f"{where}, header", f"columns {', '.join(names)}", "name the columns like the channels")
        return InputError(issue)
    return InputError(
        Issue(
            "neither the gyros nor the accelerometers of the unit span three axes", where,
            f"a table of readings, CSV or Parquet, with columns among {', '.join(names)}",
            "give the readings as a table: `imubayes apply` then gives the input along each axis",
        )
    )  # fmt: skip


def correction_of(result: Result, header: tuple[str, ...], where: str) -> Correction:
    """Return the correction of recordings of a fitted unit.

    Parameters
    ----------
    header : columns of the recording.
    where : the recording, for errors.

    Raises
    ------
    InputError
        where the fit did not converge, or the recording lacks channels for all three axes.
    """
    posterior = sensor_posterior(result)
    kinds = complete_kinds(posterior.campaign.channels, header)
    if not kinds:
        raise _refusal(posterior.campaign, where)
    campaign = posterior.campaign
    channels = [channel for kind in kinds for channel in campaign.of_kind(kind)]
    ranges, inputs = temperature_ranges(campaign), input_ranges(campaign)

    def known(everything: Acting) -> Acting:
        return {
            kind: acting_on(each.rate * ("gyro" in kinds), each.force * ("accelerometer" in kinds))
            for kind, each in everything.items()
        }

    left_in = uncorrected_effects(result, posterior, known, inputs, ranges)
    return Correction(
        posterior, reading_noise(result, channels), kinds, needed_temperatures(result, channels),
        ranges | {kind: (-inputs[kind], inputs[kind]) for kind in kinds},
        tuple(each for each in left_in if each.kind in kinds),
    )  # fmt: skip


def needed_temperatures(result: Result, channels: Sequence[Channel]) -> tuple[str, ...]:
    """Return the temperatures that a correction of some channels depends on."""
    names = {channel.name for channel in channels}
    acting = [each for each in result.fit.model.assembly.effects if acts_linearly(each) and names & set(each.channels)]
    needed = {need for effect in acting for need in effect.effect_class.needs}
    return tuple(name for name in TEMPERATURES if name in needed)


def left_in_sd(left_in: Iterable[UnexpressedEffect], channel: Channel) -> float:
    """Return the standard uncertainty that the effects left in give a channel, output units."""
    own = [each.standard_uncertainty for each in left_in if channel.name in each.channels]
    return float(np.linalg.norm(own)) * abs(channel.scale_si)
