"""The noise of one reading of a unit, by a fit: what differs from row to row, and what a whole recording shares.

`white_noise.sigma` is judged by the scatter of the fitted rows, which are means of m samples.  Where the scatter s of
single samples was recorded within these rows, a mean of n samples has the variance s²/n + max(σ² − s², 0)/m: that
of the fit at n = m, and that of the samples at n = 1.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from imubayes.campaign_data import Campaign, Channel
from imubayes.effects.shared_formulas import RunBias
from imubayes.model.bound_effects import BoundEffect
from imubayes.noise.base import Entry, EntryNoise, SharedNoise, SlowNoise
from imubayes.noise.components import WhiteNoise
from imubayes.results.result import Result

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
        entries = Entry(jnp.asarray(samples), jnp.abs(jnp.asarray(outputs) - channel.offset), jnp.zeros(len(samples)))
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
