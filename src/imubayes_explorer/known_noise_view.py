"""A fit at the noise known beforehand, without any candidate: what map and residuals show before a diagnosis."""

from collections.abc import Sequence

import numpy as np

from imubayes import Fit
from imubayes.adequacy.known_noise import known_scales
from imubayes.adequacy.known_noise_fit import KnownNoisePoint, known_noise_point
from imubayes.foundations.errors import InputError, input_error
from imubayes.inference.parameter_fit import Linearised
from imubayes.responses.candidate_effects import responses_of_model
from imubayes.responses.residual_covariates import ResidualCovariate, covariates


class KnownNoiseView:
    """A fit at the noise known beforehand.

    Attributes
    ----------
    fit, known, point : the fit, the covariates of its entries, and its linear model fitted at the known noise.
    entries : shape (E,) bool, which count.
    """

    def __init__(self, fit: Fit, known: Sequence[ResidualCovariate], point: KnownNoisePoint):
        self.fit, self.known, self.point = fit, known, point
        observations, entries = fit.model.problem.observations, fit.model.entries
        self.entries = (np.asarray(observations.weight) > 0) & ~np.asarray(entries.closing)

    def whitened(self, point: KnownNoisePoint | None = None) -> np.ndarray:
        """Return the residual of every entry in units of the noise known beforehand, (E,)."""
        return (point or self.point).left[: len(self.entries)]


def view_of(fit: Fit, where: str) -> KnownNoiseView:
    """Return a fit at the noise known beforehand, within a second or two: no candidate is looked at.

    Raises
    ------
    InputError
        if the fit stands nowhere finite; `where` names its folder.
    """
    alone = responses_of_model(fit) if np.isfinite(fit.z).all() else None
    if alone is None or not np.isfinite(alone.misfit).all():
        raise nowhere(fit, where)
    about = Linearised(np.asarray(fit.z), alone.misfit, alone.jacobian)
    return KnownNoiseView(fit, covariates(fit), known_noise_point(fit.model, about, known_scales(fit)))


def nowhere(fit: Fit, where: str) -> InputError:
    """Return that a fit stands nowhere finite; `where` names its folder."""
    return input_error(
        fit.message or "the fit did not converge", where, "a fit that converged",
        "remove the cause of the failure to converge, and fit again",
    )  # fmt: skip
