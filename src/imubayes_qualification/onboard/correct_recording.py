"""A whole recording of a calibrated unit turned into rate and specific force of the body, with uncertainty.

All channels of a row are solved jointly (`imubayes.model.sensitive_axes`), so that misalignment, nonlinear terms and
the g-sensitivity of the gyros are removed together.  Two standard uncertainties go with every number.  The *systematic*
one comes from the posterior of the parameters, from the offset that a recording may have of its own and from the
effects that are left in, for want of what they depend on: it is taken as the same for all rows and does not average.
The *random* one comes from the noise of the row and averages over rows.

The noise of one reading is that of a fit, in two parts: what differs from row to row, and what a whole recording
shares.  `white_noise.sigma` is judged by the scatter of the fitted rows, which are means of m samples.  If the
scatter s of single samples was recorded within these rows, a mean of n samples has the variance s²/n + max(σ² − s²,
0)/m: that of the fit at n = m, and that of the samples at n = 1.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np

from imubayes.campaign.run_tables import RowBatch
from imubayes.effects.shared_formulas import RunBias
from imubayes.foundations.campaign_data import Campaign, Channel
from imubayes.foundations.covariates import COVARIATES, REFERENCE_TEMPERATURE
from imubayes.foundations.errors import InputError, Issue, input_error, refuse
from imubayes.model.bound_effects import BoundEffect
from imubayes.model.sensitive_axes import acting_on
from imubayes.noise.components import Entry, EntryNoise, SharedNoise, SlowNoise, WhiteNoise
from imubayes.results.result import Result
from imubayes_qualification.onboard import response
from imubayes_qualification.onboard.inverted_path import solve_rows
from imubayes_qualification.onboard.record import UnexpressedEffect
from imubayes_qualification.onboard.unexpressed_effects import (
    Acting,
    acts_linearly,
    input_ranges,
    uncorrected_effects,
)

_NOT_OF_THE_UNIT = ("reference_noise", "rotation_closure")


@dataclass(frozen=True)
class ReadingNoise:
    """The noise of a unit's channels, at the posterior means of its parameters.

    Attributes
    ----------
    members : for each channel its independent noise components.
    recorded : for each channel the standard deviation of one sample within the fitted rows, output units, and how many
        samples such a row has; what was not recorded is not there.
    run_sd : for each channel the standard deviation of the offset that all rows of a recording share, output units.
    slow : names of components that change within a recording and are in neither part.
    """

    members: dict[str, tuple[EntryNoise, ...]]
    recorded: dict[str, tuple[float, float]]
    run_sd: dict[str, float]
    slow: tuple[str, ...]

    def variances(self, channel: Channel, samples: np.ndarray, outputs: np.ndarray) -> np.ndarray:
        """Return the variance of rows that are means of `samples` samples, shape (R,), output units squared."""
        nothing = jnp.zeros(len(samples))
        entries = Entry(jnp.asarray(samples), jnp.abs(jnp.asarray(outputs) - channel.offset), nothing, nothing)
        members = self.members[channel.name]
        if not members:
            return np.full(len(samples), (channel.noise or 0.0) ** 2) / samples
        return np.sum([self._variance(channel.name, member, entries) for member in members], axis=0)

    def _variance(self, channel: str, member: EntryNoise, entries: Entry) -> np.ndarray:
        if isinstance(member, WhiteNoise) and channel in self.recorded:
            within, usual = self.recorded[channel]
            excess = max(float(member.sigma) ** 2 - within**2, 0.0) / usual
            return within**2 / np.asarray(entries.samples) + excess
        return np.asarray(jax.vmap(member.variance)(entries))


def reading_noise(result: Result, channels: Sequence[Channel]) -> ReadingNoise:
    """Return the noise of the channels of a fitted unit."""
    effects = result.fit.model.assembly.effects
    means = {line.name: line.mean or 0.0 for line in result.summary.parameters}
    members: dict[str, tuple[EntryNoise, ...]] = {}
    run_sd: dict[str, float] = {}
    for channel in channels:
        acting = [effect for effect in effects if channel.name in effect.channels]
        independent = [e for e in acting if issubclass(e.effect_class, EntryNoise) and e.name not in _NOT_OF_THE_UNIT]
        made = [e.effect_class(**_values(e, channel, means)) for e in independent]
        members[channel.name] = tuple(each for each in made if isinstance(each, EntryNoise))
        run_sd[channel.name] = float(np.sqrt(sum(_shared(effect, channel, means) for effect in acting)))
    slow = {effect.name for effect in effects if issubclass(effect.effect_class, SlowNoise)}
    return ReadingNoise(members, _recorded(result.fit.model.campaign, channels), run_sd, tuple(sorted(slow)))


def _recorded(campaign: Campaign, channels: Sequence[Channel]) -> dict[str, tuple[float, float]]:
    """Return the pooled scatter of samples within rows and the usual number of samples, from rows at rest if any."""
    found: dict[str, tuple[float, float]] = {}
    if not campaign.runs:
        return found
    samples = np.concatenate([run.samples for run in campaign.runs])
    still = np.concatenate([run.covariates.get("table_rate", np.zeros(run.rows)) for run in campaign.runs]) == 0
    for channel in channels:
        place = campaign.channels.index(channel)
        sd = np.concatenate([run.sample_sd[:, place] for run in campaign.runs])
        good = np.isfinite(sd) & (samples > 1)
        good = good & still if (good & still).any() else good
        if good.any():
            within = math.sqrt(float(np.average(sd[good] ** 2, weights=samples[good] - 1)))
            found[channel.name] = within, float(np.median(samples[good]))
    return found


def _shared(effect: BoundEffect, channel: Channel, means: dict[str, float]) -> float:
    """Return the variance that an effect gives the offset of a whole recording, output units squared."""
    effect_class = effect.effect_class
    if issubclass(effect_class, SharedNoise):
        return float(effect_class(**_values(effect, channel, means)).shared_variance())
    if issubclass(effect_class, RunBias):
        return float(_values(effect, channel, means)["spread"] * channel.scale_si) ** 2
    return 0.0


def _values(effect: BoundEffect, channel: Channel, means: dict[str, float]) -> dict[str, jax.Array]:
    """Return the posterior means of a member's noise scales for a channel, SI."""
    found: dict[str, list[float]] = {}
    for parameter in effect.hyperparameters:
        if parameter.label == ("all",) or channel.name in parameter.label:
            found.setdefault(parameter.field, []).append(means[parameter.name] * parameter.factor)
    return {field: jnp.asarray(float(np.mean(values))) for field, values in found.items()}


_ROWS_AT_ONCE = 2048
# A row is solved if the last step is below this share of the largest component.
_CONVERGED = 1e-9
BEYOND = 1.1
"""Vibration and noise exceed the largest mean of a row by a part of it."""
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

    posterior: response.SensorPosterior
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
        stated : temperature → value for all rows, if no column gives it, °C.
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
            self._count_beyond(kind, acting.max(axis=1) / BEYOND, tally)
        return self._named(inputs, systematic, random, missing | unsolved[:, None])

    def _temperatures(self, batch: RowBatch, stated: dict[str, float], tally: RowTally) -> np.ndarray:
        """Return the temperatures of sensor and converter, shape (R, 2); what the model does not need is T_ref."""
        found = []
        for name in response.TEMPERATURES:
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
    if response.complete_kinds(campaign.channels, names):
        what = "the recording has no complete set of gyros or accelerometers that span three axes"
        return input_error(
            what, f"{where}, header", f"columns {', '.join(names)}", "name the columns like the channels"
        )
    return input_error(
        "neither the gyros nor the accelerometers of the unit span three axes", where,
        f"a table of readings, CSV or Parquet, with columns among {', '.join(names)}",
        "give the readings as a table: `imubayes apply` then gives the input along each axis",
    )  # fmt: skip


def not_given(temperature: str, where: str) -> Issue:
    """Return the issue of a recording, or of readings, without a temperature that the model depends on."""
    return Issue(
        f"the model depends on the {temperature.replace('_', ' ')}, which is not given",
        f"{where}, header", f"a column '{COVARIATES[temperature].column}'",
        f"add the column, or state one value with --{temperature.replace('_', '-')}",
    )  # fmt: skip


def check_stated(temperatures: Mapping[str, float]) -> None:
    """Raise InputError if a temperature that is stated for all rows is none."""
    refuse(
        Issue(f"a temperature of {value:g} degC", f"--{name.replace('_', '-')}", "a number above -273.15", "correct it")
        for name, value in temperatures.items()
        if not -273.15 < value < math.inf
    )


def correction_of(result: Result, header: tuple[str, ...], where: str) -> Correction:
    """Return the correction of recordings of a fitted unit.

    Parameters
    ----------
    header : columns of the recording.
    where : the recording, for errors.

    Raises
    ------
    InputError
        if the fit did not converge, or the recording lacks channels for all three axes.
    """
    posterior = response.sensor_posterior(result)
    kinds = response.complete_kinds(posterior.campaign.channels, header)
    if not kinds:
        raise _refusal(posterior.campaign, where)
    campaign = posterior.campaign
    channels = [channel for kind in kinds for channel in campaign.of_kind(kind)]
    ranges, inputs = response.temperature_ranges(campaign), input_ranges(campaign)

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
    return tuple(name for name in response.TEMPERATURES if name in needed)


def left_in_sd(left_in: Iterable[UnexpressedEffect], channel: Channel) -> float:
    """Return the standard uncertainty that the effects left in give a channel, output units."""
    own = [each.standard_uncertainty for each in left_in if channel.name in each.channels]
    return float(np.linalg.norm(own)) * abs(channel.scale_si)
