"""A fit in memory: the model with its posterior mode and, if it was made in this process, its posterior."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import equinox as eqx
import numpy as np

from imubayes.inference.chains import Chains
from imubayes.inference.identifiability import ImplausibleEstimate, UnexplainedOutput
from imubayes.inference.nested_laplace import NestedLaplace
from imubayes.inference.parameter_fit import Linearised
from imubayes.inference.posterior_mode import Mode, log_evidence
from imubayes.model.bind import Model
from imubayes.model.derived_quantities import DerivedQuantities, derived_quantities
from imubayes.model.likelihood import whitened


@dataclass(frozen=True)
class Posterior:
    """Posterior draws of a fit.

    Attributes
    ----------
    points : shape (S, P + H), draws in z, sampled or of the Laplace approximation.
    derived : shape (S, D), the derived quantities of the points in their units.
    prior_points, prior_derived : shapes (S″, P) and (S″, D), draws of the prior in z, and what is derived from them.
    approximation : the nested Laplace approximation.
    chains : the sampled chains, of which `points` are all; None if the draws are of the Laplace approximation.
    """

    points: np.ndarray
    derived: np.ndarray
    prior_points: np.ndarray
    prior_derived: np.ndarray
    approximation: NestedLaplace
    chains: Chains | None = None


@dataclass(frozen=True)
class Fit:
    """A fitted model.

    Attributes
    ----------
    model : as declared.
    z, h : shapes (P,) and (H,), the posterior mode of parameters and noise scales, in z.
    optimised : whether the optimiser converged, at estimates that a unit can have.
    message : what did not converge, in a sentence; empty if all did.
    implausible, unexplained : estimates that no working unit has, and channels that the model does not describe.
    mode : outcome of the optimiser; None for a fit read from a result folder.
    posterior : draws; None if the fit did not converge, or was read from a result folder.
    seconds : time spent, by step.
    sampled : whether the sampling, if there was any, converged.

    Examples
    --------
    >>> import imubayes
    >>> fit = imubayes.load("results/accel-channel").fit
    >>> fit.converged, len(fit.z) == len(fit.model.layout)
    (True, True)
    """

    model: Model
    z: np.ndarray
    h: np.ndarray
    optimised: bool
    message: str = ""
    mode: Mode | None = None
    posterior: Posterior | None = None
    seconds: Mapping[str, float] = field(default_factory=dict)
    implausible: tuple[ImplausibleEstimate, ...] = ()
    unexplained: tuple[UnexplainedOutput, ...] = ()
    sampled: bool = True

    @property
    def converged(self) -> bool:
        """Whether the optimiser, and the sampling if there was any, converged."""
        return self.optimised and self.sampled

    @cached_property
    def derived(self) -> DerivedQuantities:
        """Names, units and function of the derived quantities."""
        return derived_quantities(self.model.assembly)

    @property
    def chi2(self) -> float:
        """The sum of squared residuals over the noise as fitted; NaN of a fit read from a result folder."""
        if self.mode is None:
            return np.nan
        return float(np.sum(whitened(self.model.problem, self.mode.h, self.mode.about.misfit) ** 2))

    @property
    def log_evidence(self) -> float:
        """The Laplace estimate of log p(y); NaN of a fit read from a result folder."""
        return np.nan if self.mode is None else log_evidence(self.mode)

    def without_padding(self, recorded: Model) -> "Fit":
        """Return a fit of the readings as recorded: those of its own model have further ones, of no weight, behind."""
        assert self.mode is not None
        about, count = self.mode.about, len(recorded.problem.observations.value)
        trimmed = Linearised(about.z, about.misfit[:count], about.jacobian[:count])
        return replace(self, model=recorded, mode=eqx.tree_at(lambda mode: mode.about, self.mode, trimmed))


def evenly_spaced(length: int, count: int) -> np.ndarray:
    """Return `count` indices spread evenly over a sequence, first and last included."""
    return np.linspace(0, length - 1, count).astype(int)
