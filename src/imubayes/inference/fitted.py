"""A model with the point at which it fits: all that criticism and simulation need of a fit."""

from dataclasses import dataclass

import numpy as np

from imubayes.model.bind import Model


@dataclass(frozen=True)
class Fitted:
    """A fitted model.

    Attributes
    ----------
    model : as declared.
    z, h : shapes (P,) and (H,), the mode of parameters and noise scales, in z.
    converged : whether the fit, and the sampling where there was any, converged.
    message : what did not converge, in a sentence; empty where all did.
    """

    model: Model
    z: np.ndarray
    h: np.ndarray
    converged: bool
    message: str = ""
