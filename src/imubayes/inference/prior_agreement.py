"""Parameters whose prior and data disagree, and whether the prior or the data decided the estimate.

In z a prior is the standard normal.  Where a parameter has the posterior mean m and variance v, all other parameters
integrated out, the likelihood alone has its maximum at m/(1 − v) with variance v/(1 − v).  The distance of this maximum
from the prior mean, over its standard deviation under prior and likelihood together, is

    |m| / √(1 − v),

the test of prior–data conflict (Evans and Moshonov, Bayesian Analysis 2006), and the normalised residual of a prior
value in least-squares adjustment.  Where the data decide, v is small and it is the distance of the estimate from the
prior mean in prior standard deviations; where the prior decides, the estimate itself looks like any other.
"""

import jax.numpy as jnp
import numpy as np

from imubayes.inference.prior_conflict import PriorConflict
from imubayes.json_record import finite
from imubayes.model.bind import Model
from imubayes.model.bound_effects import BoundEffect
from imubayes.parameters.priors import HalfNormal, Normal, rounded_width
from imubayes.parameters.vector import Parameter

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
    about, slope = _in_unit(parameter, z), _slope(parameter, z)
    alone, spread = z / (1 - variance), np.sqrt(variance / (1 - variance))
    declared, written = effect.declared[parameter.field], parameter.field in effect.spec.prior
    asked = about + slope * (alone - z)
    return PriorConflict(
        name=parameter.name,
        unit=parameter.shown_unit,
        effect=parameter.effect,
        parameter=parameter.field,
        prior_mean=_in_unit(parameter, 0.0),
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


def _in_unit(parameter: Parameter, z: float) -> float:
    return float(parameter.prior.value(jnp.asarray(z))) / parameter.factor


def _slope(parameter: Parameter, z: float) -> float:
    """Return the derivative of the value by z, in the unit."""
    step = 1e-4
    return (_in_unit(parameter, z + step) - _in_unit(parameter, z - step)) / (2 * step)


def _wider(parameter: Parameter, asked: float) -> str:
    """Return a prior of the same family with room for a value, in the parameter's unit."""
    prior = parameter.prior
    if isinstance(prior, Normal):
        mean = float(prior.mean) / parameter.factor
        return f"normal({mean:g}, {rounded_width(abs(asked - mean)):g} {parameter.unit})"
    if isinstance(prior, HalfNormal):
        return f"halfnormal({rounded_width(abs(asked)):g} {parameter.unit})"
    return ""
