"""Whether a converged fit can be of the unit and the set-up that the campaign describes; prior–data conflict.

A mistake in the set-up still has a posterior mode: with a scale factor of −2 000 000 ppm a table turns the other way.
Three signs of it are looked for.  An estimate lies outside the domain of its parameter; it lies far from its prior; the
model leaves outputs unexplained that are no noise and no small error.

Whether prior and data disagree, and which of them decided an estimate, shows in z, where a prior is the standard
normal.  If a parameter has the posterior mean m and variance v, all other parameters integrated out, the likelihood
alone has its maximum at m/(1 − v) with variance v/(1 − v).  The distance of this maximum from the prior mean, over its
standard deviation under prior and likelihood together, is

    |m| / √(1 − v),

the test of prior–data conflict (Evans and Moshonov, Bayesian Analysis 2006), and the normalised residual of a prior
value in least-squares adjustment.  If the data decide, v is small and it is the distance of the estimate from the
prior mean in prior standard deviations; if the prior decides, the estimate itself looks like any other.
"""

import math

import numpy as np

from imubayes.foundations.campaign_data import INPUT_UNIT, Channel
from imubayes.foundations.numerics import group_means
from imubayes.foundations.records import finite
from imubayes.foundations.units import to_si
from imubayes.inference.identifiability import ImplausibleEstimate, PriorConflict, UnexplainedOutput
from imubayes.model.bind import Model
from imubayes.model.bound_effects import BoundEffect
from imubayes.parameters.declarations import Parameter, prior_values
from imubayes.parameters.priors import HalfNormal, Normal, rounded_width

# Distance from the middle of a prior, in its standard deviations, from which the estimate is of something else.
# Convention, between what is met: at most 2.6 in the shipped campaigns, hidden effects included, and 30 in a unit
# fifteen times worse than two standard deviations of its prior; hundreds if a table or a mounting is wrong.  Smaller
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
    values = np.concatenate([prior_values(problem.priors, z), prior_values(problem.hyper_priors, h)])
    at = dict(zip(names, zip([*z.tolist(), *h.tolist()], values.tolist(), strict=True), strict=True))
    judged = [
        _judged(effect, parameter, *at[parameter.name], model.campaign.site.gravity)
        for effect in model.assembly.effects
        for parameter in (*effect.parameters, *effect.hyperparameters)
    ]
    return tuple(sorted((each for each in judged if each is not None), key=lambda each: -each.distance))


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
        prior_mean=finite(parameter.value_at(0.0)),
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


# Distance in standard deviations from which prior and data disagree.  Convention: 0.3 % by chance.  Larger lets priors
# decide against the data unnoticed; smaller names parameters of good fits.
CONFLICT_SD = 3.0
# Below this share of information from the data nothing can be said of what the likelihood favours: its width is
# hundreds of times that of the prior, and the mode is off by the echo of other parameters.  Numerical.
_LEAST_FROM_DATA = 1e-5


def prior_conflicts(model: Model, z: np.ndarray, precision: np.ndarray) -> tuple[PriorConflict, ...]:
    """Return the parameters whose prior disagrees with the data, the largest distance first.

    Parameters
    ----------
    z : shape (P,), posterior mode.
    precision : shape (P, P), posterior precision in z.
    """
    variance = np.diag(np.linalg.inv(precision))
    informed = 1 - variance
    distance = np.where(informed > _LEAST_FROM_DATA, np.abs(z) / np.sqrt(np.maximum(informed, _LEAST_FROM_DATA)), 0.0)
    found = []
    for place in np.argsort(-distance).tolist():
        parameter = model.layout.parameters[place]
        effect = _owner(model, parameter)
        declared = effect.declared[parameter.field]
        # A prior that is learnt from the same data cannot disagree with them; one without end in either direction says
        # nothing that they could contradict.
        hidden = parameter.nuisance and not declared.equipment
        if distance[place] <= CONFLICT_SD or hidden or declared.spread:
            continue
        found.append(_conflict(parameter, effect, float(z[place]), float(variance[place]), float(distance[place])))
    return tuple(found)


def _owner(model: Model, parameter: Parameter) -> BoundEffect:
    same = [effect for effect in model.assembly.effects if effect.name == parameter.effect]
    return next(effect for effect in same if any(known.name == parameter.name for known in effect.parameters))


def _conflict(parameter: Parameter, effect: BoundEffect, z: float, variance: float, distance: float) -> PriorConflict:
    about, slope = parameter.value_at(z), _slope(parameter, z)
    alone, spread = z / (1 - variance), np.sqrt(variance / (1 - variance))
    declared, written = effect.declared[parameter.field], parameter.field in effect.spec.prior
    asked = about + slope * (alone - z)
    return PriorConflict(
        name=parameter.name,
        unit=parameter.shown_unit,
        effect=parameter.effect,
        parameter=parameter.field,
        prior_mean=parameter.value_at(0.0),
        prior_sd=finite(parameter.prior_sd),
        value=about,
        sd=slope * float(np.sqrt(variance)),
        data_value=asked,
        data_sd=slope * float(spread),
        distance=distance,
        decided_by="data" if variance < 0.5 else "prior",
        stated_in="campaign" if declared.equipment and not written else "model",
        wider=_wider(parameter, asked),
    )


def _slope(parameter: Parameter, z: float) -> float:
    """Return the derivative of the value by z, in the unit."""
    step = 1e-4
    return (parameter.value_at(z + step) - parameter.value_at(z - step)) / (2 * step)


def _wider(parameter: Parameter, asked: float) -> str:
    """Return a prior of the same family with room for a value, in the parameter's unit."""
    prior = parameter.prior
    if isinstance(prior, Normal):
        mean = float(prior.mean) / parameter.factor
        return f"normal({mean:g}, {rounded_width(abs(asked - mean)):g} {parameter.unit})"
    if isinstance(prior, HalfNormal):
        return f"halfnormal({rounded_width(abs(asked)):g} {parameter.unit})"
    return ""
