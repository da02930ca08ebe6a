"""Whether a fit that converged can be of the unit and the set-up that the campaign describes.

A mistake in the set-up still has a posterior mode: with a scale factor of −2 000 000 ppm a table turns the other way.
Three signs of it are looked for.  An estimate lies outside the domain of its parameter; it lies far from its prior; the
model leaves outputs unexplained that are no noise and no small error.
"""

import math

import jax.numpy as jnp
import numpy as np

from imubayes.array_shapes import Array, Float
from imubayes.campaign_data import INPUT_UNIT, Channel
from imubayes.group_means import group_means
from imubayes.inference.implausible_record import ImplausibleEstimate, UnexplainedOutput
from imubayes.json_record import finite
from imubayes.kept_programs import kept
from imubayes.model.bind import Model
from imubayes.model.bound_effects import BoundEffect
from imubayes.parameters.vector import Parameter, Priors
from imubayes.units import to_si

# Distance from the middle of a prior, in its standard deviations, from which the estimate is of something else.
# Convention, between what is met: at most 2.6 in the shipped campaigns, hidden effects included, and 30 in a unit
# fifteen times worse than two standard deviations of its prior; hundreds where a table or a mounting is wrong.  Smaller
# refuses such units, larger lets gross mistakes pass for estimates.
FAR_SD = 30.0
# Residual of a channel, in all and about the mean of each run, over its outputs, and over the recorded noise of the
# rows' means, from which the model has not described the measurement.  Derived: no error of a working unit is half of
# its input, none that varies within a run a tenth; rows that scatter less than a hundred times their noise may be
# noisy.  Smaller refuses models that lack a large effect.
UNEXPLAINED_SHARE, UNEXPLAINED_WITHIN_RUNS, UNEXPLAINED_NOISE = 0.5, 0.1, 100.0
# Least size of the outputs of a channel in that comparison: drifts of consumer units over temperature are
# large against the input of a unit at rest.
LEAST_OUTPUT = {"deg/s": 30.0, "g": 1.0}


def implausible_estimates(model: Model, z: np.ndarray, h: np.ndarray) -> tuple[ImplausibleEstimate, ...]:
    """Return the estimates that a working unit cannot have, the farthest from its prior first.

    Parameters
    ----------
    z, h : shapes (P,) and (H,), posterior mode.
    """
    names, problem = (*model.layout.names, *model.hyper_layout.names), model.problem
    values = np.concatenate([_in_si(problem.priors, z), _in_si(problem.hyper_priors, h)])
    at = dict(zip(names, zip([*z.tolist(), *h.tolist()], values.tolist(), strict=True), strict=True))
    judged = [
        _judged(effect, parameter, *at[parameter.name], model.campaign.site.gravity)
        for effect in model.assembly.effects
        for parameter in (*effect.parameters, *effect.hyperparameters)
    ]
    return tuple(sorted((each for each in judged if each is not None), key=lambda each: -each.distance))


@kept
def _in_si(priors: Priors, z: Float[Array, " n"]) -> Float[Array, " n"]:
    return priors.values(z)


def _judged(
    effect: BoundEffect, parameter: Parameter, z: float, si: float, gravity: float
) -> ImplausibleEstimate | None:
    declared = effect.declared[parameter.field]
    value = si / parameter.factor
    lowest, highest = -math.inf, math.inf
    if declared.domain is not None:
        unit = to_si(declared.domain.unit, gravity) / parameter.factor
        lowest, highest = declared.domain.low * unit, declared.domain.high * unit
    inside = lowest < value < highest
    # The width of a learnt prior follows the estimates.
    if inside and (abs(z) <= FAR_SD or declared.spread):
        return None
    return ImplausibleEstimate(
        reason="far_from_prior" if inside else "outside_domain",
        name=parameter.name,
        unit=parameter.shown_unit,
        value=value,
        lowest=None if inside else finite(lowest),
        highest=None if inside else finite(highest),
        prior_mean=finite(float(parameter.prior.value(jnp.asarray(0.0))) / parameter.factor),
        prior_sd=finite(parameter.prior_sd),
        distance=abs(z),
    )


def unexplained_outputs(model: Model, misfit: np.ndarray) -> tuple[UnexplainedOutput, ...]:
    """Return the channels whose outputs a fit does not describe, the least described first.

    Parameters
    ----------
    misfit : shape (E,), measured less predicted values, output units; what follows is padding.
    """
    entries, found = model.entries, []
    misfit = misfit[: len(entries.channel)]
    for place, channel in enumerate(model.campaign.channels):
        here = (entries.channel == place) & ~np.asarray(entries.closing)
        if channel.kind != "angle" and channel.noise and here.any():
            found.append(_described(model, channel, misfit[here], here))
    return tuple(sorted(filter(_contradicts, found), key=lambda each: -each.residual / each.noise))


def _contradicts(found: UnexplainedOutput) -> bool:
    output = max(found.output, LEAST_OUTPUT[found.unit])
    if found.residual < UNEXPLAINED_NOISE * found.noise:
        return False
    return found.residual > UNEXPLAINED_SHARE * output or found.within_runs > UNEXPLAINED_WITHIN_RUNS * output


def _described(model: Model, channel: Channel, misfit: np.ndarray, here: np.ndarray) -> UnexplainedOutput:
    unit = INPUT_UNIT[channel.kind]
    per_input = abs(channel.scale_si) * to_si(unit, model.campaign.site.gravity)
    _, run = np.unique(model.entries.run[here], return_inverse=True)
    centred = misfit - group_means(misfit, run)
    outputs = model.entries.value[here] - channel.offset
    variance = (channel.noise or 0.0) ** 2 / model.entries.samples[here]
    squares = (misfit**2, centred**2, outputs**2, variance)
    residual, within_runs, output, noise = (math.sqrt(float(each.mean())) / per_input for each in squares)
    return UnexplainedOutput(
        channel=channel.name, unit=unit, residual=residual, within_runs=within_runs, output=output, noise=noise
    )
