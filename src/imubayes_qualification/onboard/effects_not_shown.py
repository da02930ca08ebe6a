"""Errors of the inputs in a mission by effects that the runs of a fit could not show.

A coefficient of the largest typical size, or of the largest that the data leave open, changes the output of its
channel, by the formula of the effect at the rate and specific force of the mission.  If the runs respond to it, the
parameters of the fit take up a part: by the linear shift Δz of `taken_as_exact`, so that z − Δz and the effect describe
the unit.  The constants leave in the sum of both.  An effect is propagated if it is linear in its
coefficients and acts by rate, specific force and a stated temperature alone; the others are named.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from imubayes import Diagnosis
from imubayes.effects.base import Order, PlaceEffect, RecordEffect, SignalEffect, Stage
from imubayes.foundations.campaign_data import Channel
from imubayes.foundations.covariates import REFERENCE_TEMPERATURE, ambient_names
from imubayes.foundations.signal_path_state import Ambient
from imubayes.model.effect_registry import EffectClass
from imubayes.model.model_file import EffectSpec
from imubayes.model.parameter_priors import parameter_of
from imubayes.model.sensitive_axes import sample_at
from imubayes.parameters.declarations import Parameter, declared_parameters, prior_slopes
from imubayes.responses.candidate_effects import fitting_channels, lacking_effects
from imubayes.results.result import Result
from imubayes_qualification.budgets.taken_as_exact import exact_equipment
from imubayes_qualification.onboard.navigation_impact import (
    EffectNotPropagated,
    HiddenEffect,
    HiddenEffects,
    MissionMotion,
)
from imubayes_qualification.onboard.record import OnboardConstants
from imubayes_qualification.onboard.response import TEMPERATURES, SensorPosterior, sensor_posterior
from imubayes_qualification.onboard.unexpressed_effects import modelled_outputs

# Conditions of a run that no mission has: what needs them belongs to the test equipment.
_OF_EQUIPMENT = {"injection", "reference", "driven"}

# Standard deviations of a coefficient from which on the data would have shown it, as of `smallest_detectable`.
_SHOWN = 4.0


def effects_not_shown(
    result: Result,
    constants: OnboardConstants,
    diagnosis: Diagnosis,
    motion: MissionMotion,
    temperature: float | None = None,
) -> HiddenEffects:
    """Return what the undetectable effects of the unit do to rate and specific force along a mission.

    Parameters
    ----------
    temperature : of sensors and converter, °C; effects that depend on it are not propagated if None.
    """
    registry = result.fit.model.registry
    members = [registry.find(name, "diagnosis") for name in dict.fromkeys(e.effect for e in diagnosis.undetectable)]
    known: set[str] = set() if temperature is None else set(TEMPERATURES)
    taken = tuple(_propagated(members, known))
    left = tuple(
        EffectNotPropagated(effect=member.name, needs=tuple(need for need in member.needs if need not in known))
        for member in members
        if issubclass(member, PlaceEffect | SignalEffect | RecordEffect)
        and member not in taken
        and not _OF_EQUIPMENT & set(member.needs)
    )
    if not taken:
        return HiddenEffects((), left)
    unit = _Unit(result, constants, motion, REFERENCE_TEMPERATURE if temperature is None else temperature, taken)
    return HiddenEffects(tuple(found for member in taken for found in unit.by_kind(member)), left)


def _propagated(members: Iterable[EffectClass], known: set[str]) -> Iterator[type[SignalEffect]]:
    """Yield the effects that are linear in coefficients of channels, and act by what is known of a mission."""
    for member in members:
        shapes = any(each.shape for each in declared_parameters(member).values())
        own = member.per == ("channel",) and set(member.needs) <= known
        if issubclass(member, SignalEffect) and own and member.order < Order.LIMIT and not shapes:
            yield member


class _Unit:
    """A fitted unit in a mission, with the errors that coefficients make there."""

    def __init__(
        self, result: Result, constants: OnboardConstants, motion: MissionMotion, temperature: float,
        members: Sequence[type[SignalEffect]],
    ):  # fmt: skip
        self.result, self.constants, self.motion, self.temperature = result, constants, motion, temperature
        self.campaign = result.fit.model.campaign
        self.posterior: SensorPosterior = sensor_posterior(result)
        self.slopes = np.asarray(prior_slopes(result.fit.model.problem.priors, np.asarray(result.fit.z)))
        names = [member.name for member in members]
        self.lacking = {each.name: each.channels for each in lacking_effects(result.fit, names)[0]}
        exact = exact_equipment(result.fit, names)
        named = [each.name for each in exact.parameters]
        self.shifts = dict(zip(named, exact.response.T, strict=True))
        self.told = dict(zip(named, np.diag(exact.told).tolist(), strict=True))
        self.fitted = self._outputs(np.zeros(len(self.slopes)))

    def by_kind(self, member: type[SignalEffect]) -> list[HiddenEffect]:
        """Return an effect on the gyros, on the accelerometers, or on both, on the channels that lack it."""
        lacking = self.lacking.get(member.name, fitting_channels(member, self.campaign))
        found = []
        for triad in self.constants.triads:
            channels = [each for each in self.campaign.of_kind(triad.kind) if each.name in lacking]
            if not channels:
                continue
            made = [(each, self._parameter(member, field, each)) for each in channels
                    for field in declared_parameters(member)]  # fmt: skip
            error = np.stack([self._error(member, channel, parameter) for channel, parameter in made], axis=2)
            first = made[0][1]
            size = max(self._size(parameter) for _, parameter in made if parameter.field == first.field)
            found.append(HiddenEffect(member.name, triad.kind, size, first.shown_unit, error))
        return found

    def _size(self, parameter: Parameter) -> float:
        told = self.told.get(parameter.name, 0.0)
        return min(parameter.typical[1], _SHOWN / told**0.5 if told > 0 else np.inf)

    def _parameter(self, member: type[SignalEffect], field: str, channel: Channel) -> Parameter:
        return parameter_of(EffectSpec(member.name), member, field, {"channel": channel.name}, self.campaign)

    def _error(self, member: type[SignalEffect], channel: Channel, parameter: Parameter) -> np.ndarray:
        """Return the error of rate and specific force, (T, 6), by a coefficient of the largest size."""
        size, motion = self._size(parameter), self.motion
        shift = -size * self.shifts.get(parameter.name, np.zeros(len(self.slopes)))
        moved = self._outputs(shift) - self.fitted
        found, first = np.zeros((len(motion.body_rate), 6)), 0
        for kind, count in self._counts():
            errors = moved[:, first : first + count]
            first += count
            if kind == channel.kind:
                place = [each.name for each in self.campaign.of_kind(kind)].index(channel.name)
                errors[:, place] += self._own(member, channel, parameter, size * parameter.factor)
            triad = self.constants.triad(kind)
            if triad is not None:
                rows = slice(0, 3) if kind == "gyro" else slice(3, 6)
                found[:, rows] = errors @ np.array(triad.matrix).T
        return found

    def _counts(self) -> list[tuple[str, int]]:
        return [(kind, len(self.campaign.of_kind(kind))) for kind in self.posterior.inputs.channels]

    def _outputs(self, shift: np.ndarray) -> np.ndarray:
        """Return the inputs along all channels on the nominal scale for a shift of the parameters in z, (T, C)."""
        places, values = self.posterior.places, self.posterior.values.copy()
        values[places] += (shift * self.slopes)[places]
        stimuli = np.concatenate([self.motion.body_rate, self.motion.body_force], axis=1)
        found = modelled_outputs(self.posterior, values[None], stimuli, np.full((len(stimuli), 2), self.temperature))
        scales = {kind: np.array([c.scale_si for c in self.campaign.of_kind(kind)]) for kind in found}
        return np.concatenate([found[kind][0] / scales[kind] for kind, _ in self._counts()], axis=1)

    def _own(self, member: type[SignalEffect], channel: Channel, parameter: Parameter, size: float) -> np.ndarray:
        """Return what an effect adds to the input of its channel on the nominal scale, (T,)."""
        values = {name: each.null for name, each in declared_parameters(member).items()} | {parameter.field: size}
        make = member(**{name: np.asarray(value) for name, value in values.items()})
        none, warm = jnp.zeros(()), dict.fromkeys(TEMPERATURES, np.asarray(self.temperature))
        ambient = Ambient(**dict.fromkeys(ambient_names(), none)).updated(**warm)
        scale = channel.scale_si if member.stage == Stage.CONVERTER else 1.0

        def added(rate, force):
            seen = sample_at(np.asarray(channel.axes), rate, force, ambient)
            sample = replace(seen, output_scale=np.asarray(channel.scale_si))
            signal = scale * (sample.rate if channel.kind == "gyro" else sample.force)[0]
            return (make.apply(signal, sample) - signal) / scale

        return np.asarray(jax.vmap(added)(np.asarray(self.motion.body_rate), np.asarray(self.motion.body_force)))
