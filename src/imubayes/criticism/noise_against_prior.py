"""Fitted noise against its prior: an effect between runs passes for scatter between runs, and fits.

Where an effect differs from run to run alone, and the catalogue lacks it or has too few runs to show it, the fit takes
it for offsets of the runs.  No residual is left, and only the size of these offsets tells.  What the prior of a noise
parameter all but excludes is therefore no adequate model: the mode of a parameter drawn from its prior is drawn towards
the median, so that it exceeds a quantile with less than the probability of the prior.

White noise is compared with the record of the campaign instead (`imubayes.criticism.recorded_noise`).  Correlations,
slow noise and tails are left to the tests of the residuals: their parameters are no sizes of independent noise.
"""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from imubayes.criticism import thresholds
from imubayes.inference.fitted_model import Fit
from imubayes.noise.base import EntryNoise, SharedNoise
from imubayes.noise.components import WhiteNoise
from imubayes.tail_probabilities import normal_survival


@dataclass(frozen=True)
class NoiseBeyondPrior:
    """A noise parameter that the fit puts far beyond its prior.

    Attributes
    ----------
    parameter, unit : its name and unit.
    value : at the mode.
    expected : what its prior exceeds with a probability of 2.5 %.
    p : p-value under its prior, over all parameters compared (Bonferroni).
    between_runs : whether it is the scatter between runs.
    """

    parameter: str
    unit: str
    value: float
    expected: float
    p: float
    between_runs: bool


def scatter_beyond_prior(fitted: Fit) -> bool:
    """Tell whether the fit puts a scatter between runs far beyond its prior."""
    return any(each.between_runs for each in noise_beyond_prior(fitted))


def noise_beyond_prior(fitted: Fit) -> tuple[NoiseBeyondPrior, ...]:
    """Return the noise parameters beyond their priors, the least probable first."""
    model = fitted.model
    classes = {each.name: each.effect_class for each in model.assembly.effects}
    shared = {name for name, member in classes.items() if issubclass(member, SharedNoise)}
    sizes = {name for name, member in classes.items() if issubclass(member, EntryNoise)} | shared
    sizes -= {name for name in sizes if issubclass(classes[name], WhiteNoise)}
    parameters, z = model.hyper_layout.parameters, np.asarray(fitted.h)
    compared = [place for place, parameter in enumerate(parameters) if parameter.effect in sizes]
    found = []
    for place in compared:
        p = min(1.0, float(normal_survival(z[place])) * len(compared))
        if p >= thresholds.NOISE_BEYOND_PRIOR_P:
            continue
        parameter = parameters[place]
        value, expected = (
            float(parameter.prior.value(jnp.asarray(at))) / parameter.factor
            for at in (z[place], thresholds.EXPECTED_NOISE_Z)
        )
        between_runs = parameter.effect in shared
        found.append(NoiseBeyondPrior(parameter.name, parameter.shown_unit, value, expected, p, between_runs))
    return tuple(sorted(found, key=lambda each: each.p))
