"""A model with effects added or removed, before its fit: what the loop fits next."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from imubayes.criticism.verdict import CoefficientEstimate, EffectChoice
from imubayes.model.bind import Model
from imubayes.model.model_spec import ModelSpec
from imubayes.parameters.vector import Layout

_NOTHING = np.zeros(0)


@dataclass(frozen=True)
class ChangedModel:
    """A model with effects added or removed, before its fit.

    Attributes
    ----------
    model : as changed, bound.
    z, h : start of the fit, shapes (P,) and (H,).
    null : shape (P,), the mode before, with the new parameters at their null values.
    new : shape (P,), True for the parameters that the model before did not have.
    added, removed : what it has more and less than the model before.
    delta_chi2 : of effects added: predicted drop of χ² at the noise scales before; None where the gradient at the null
        values vanishes, and where the linear prediction is a rise.
    coefficients : of effects added: predicted, with uncertainty; empty where the gradient vanishes.
    asked : shape (K,), estimates of the new parameters from the data alone, SI, where they contradict the prior; 0
        elsewhere.
    widened : priors that were widened for these estimates, by ``effect.parameter``, as written in a model file.
    residual, explained : shape (E,), whitened residual and the part explained by the effects added, both projected off
        the model before: the added-variable plot, of slope 1 where the prediction is right.  Empty of a removal.
    """

    model: Model
    z: np.ndarray
    h: np.ndarray
    null: np.ndarray
    new: np.ndarray
    added: tuple[EffectChoice, ...] = ()
    removed: tuple[EffectChoice, ...] = ()
    delta_chi2: float | None = None
    coefficients: tuple[CoefficientEstimate, ...] = ()
    asked: np.ndarray = field(default_factory=_NOTHING.copy)
    residual: np.ndarray = field(default_factory=_NOTHING.copy)
    explained: np.ndarray = field(default_factory=_NOTHING.copy)
    widened: Mapping[str, str] = field(default_factory=dict)


def beyond(spec: ModelSpec, other: ModelSpec) -> tuple[EffectChoice, ...]:
    """Return the effects with their channels that a model has and another one lacks."""
    known = {(each.name, each.channels) for each in other.effects}
    return tuple(
        EffectChoice(effect=each.name, channels=each.channels)
        for each in spec.effects
        if (each.name, each.channels) not in known
    )


def new_in(layout: Layout, before: Layout) -> np.ndarray:
    """Return which parameters of a layout the one before lacks, shape (P,) bool."""
    known = set(before.names)
    return np.array([name not in known for name in layout.names], dtype=bool)
