"""Evidence for effects that noise of the model took up: the Bayes factor, with the noise at its best on either side.

An effect that acts from run to run alone is judged by the scatter between runs.  Where there are few, the F test has
two or three degrees of freedom and hardly any power: the fit took the effect for scatter, and that this scatter is many
times what its prior expects does not count.  In the marginal likelihood it counts, and so does a scatter that falls
back once the effect is in the model.  Correlated noise takes up a drift in the same way: its correlation grows, and
the score at the fitted noise is small.

    log B = max_h [log p(y, h) + ½ uᵀ(V + C⁻¹)⁻¹u − ½ log det(1 + V C)] − max_h log p(y, h)

with u = g⊥ᵀr and V = g⊥ᵀg⊥ at the noise scales h and a normal prior of covariance C for the coefficients, averaged over
widths of several orders of magnitude.  Under a complete model E[B] = 1, so that any of N candidates reaches N/α with a
probability of α at most, and 1/B is a p-value (Vovk & Wang, Annals of Statistics 49, 2021).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import jax.numpy as jnp
import numpy as np
import scipy  # loads its parts when they are first used
from scipy import special

from imubayes.criticism import thresholds
from imubayes.criticism.candidate_effects import Responses
from imubayes.criticism.known_noise import contradicted_between_runs
from imubayes.criticism.projection import Projection, project
from imubayes.criticism.score_test import Candidate, ProjectedResponse, response_of
from imubayes.criticism.slow_noise_records import with_slow_noise
from imubayes.inference.fitted_model import Fit
from imubayes.inference.noise_marginal import slope
from imubayes.inference.posterior_precision import Linearised
from imubayes.noise.base import SharedNoise


@dataclass(frozen=True)
class _AtScales:
    """The model with other noise scales: log p(y, h) relative to the fit's, and the projection there."""

    log_marginal: float
    projection: Projection

    def log_bayes_factor(self, columns: np.ndarray) -> float:
        """Return log B for candidates' columns (E, C), per largest typical size, at these scales."""
        projected = self.projection.project(self.projection.whitened(columns))
        u, v = projected.T @ self.projection.residual, projected.T @ projected
        each = []
        for width in thresholds.SIZE_WIDTHS:
            _, log_determinant = np.linalg.slogdet(np.eye(len(u)) + width**2 * v)
            each.append(0.5 * (u @ np.linalg.solve(v + np.eye(len(u)) / width**2, u) - log_determinant))
        return self.log_marginal + float(special.logsumexp(each)) - math.log(len(each))


@dataclass(frozen=True)
class _Marginal:
    """The linearised fit as a function of some noise parameters, at `places` of h."""

    fitted: Fit
    responses: Responses
    places: np.ndarray

    @property
    def as_fitted(self) -> np.ndarray:
        """The noise parameters of the fit, in z."""
        return np.asarray(self.fitted.h)[self.places]

    def at(self, noise: np.ndarray) -> _AtScales:
        """Return the model with other noise parameters."""
        h = np.array(self.fitted.h)
        h[self.places] = noise
        there = project(replace(self.fitted, h=h), self.responses.misfit, self.responses.jacobian)
        return _AtScales(self._value(h) - self._value_as_fitted, there)

    @cached_property
    def _value_as_fitted(self) -> float:
        return self._value(np.array(self.fitted.h))

    def _value(self, h: np.ndarray) -> float:
        given = self.responses
        about = Linearised(*(jnp.asarray(each) for each in (self.fitted.z, given.misfit, given.jacobian)))
        return float(slope(self.fitted.model.problem, about, jnp.asarray(h)).value)

    @cached_property
    def grid(self) -> list[_AtScales]:
        """The model with noise as fitted and, together and one by one, as its prior expects at most.

        Empty where no parameter is larger than its prior expects: then the noise has taken nothing up.
        """
        now = self.as_fitted
        if not np.any(now > 0):
            return []
        less = self._as_expected
        each = [np.where(np.arange(len(now)) == place, less, now) for place in np.flatnonzero(now > 0)]
        return [self.at(scatter) for scatter in (now, (now + less) / 2, less, *(each if len(each) > 1 else ()))]

    @property
    def _as_expected(self) -> np.ndarray:
        """The noise parameters of the fit, those that are larger than their priors expect at the median."""
        return np.minimum(self.as_fitted, 0.0)

    @cached_property
    def line(self) -> list[_AtScales]:
        """The model with noise between that of the fit and what its prior expects at most, all parameters together."""
        now, less = self.as_fitted, self._as_expected
        return [self.at(now + share * (less - now)) for share in np.linspace(0, 1, thresholds.SCATTER_STEPS)]

    def taken_up(self, columns: np.ndarray, enough: float) -> "TakenUp | None":
        """Return the evidence for an effect of columns (E, C) that the noise took up; None where B is not `enough`."""
        found = self.best(columns) if self.near(columns) > enough - thresholds.GRID_SLACK else None
        return found if found is not None and found.log_factor > enough else None

    def near(self, columns: np.ndarray) -> float:
        """Return the largest log B on the grid; −∞ where there is none."""
        return max((at.log_bayes_factor(columns) for at in self.grid), default=-math.inf)

    def best(self, columns: np.ndarray) -> "TakenUp":
        """Return the largest log B over the noise parameters."""
        now = self.as_fitted
        bounds = [(-thresholds.SCATTER_REACH, max(thresholds.SCATTER_REACH, value)) for value in now.tolist()]
        found = [
            scipy.optimize.minimize(
                lambda noise: -self.at(noise).log_bayes_factor(columns),
                start,
                method="L-BFGS-B",
                bounds=bounds,
                options={"maxiter": thresholds.SCATTER_STEPS, "eps": 1e-2, "ftol": 1e-6},
            )
            for start in (now, self._as_expected)
        ]
        likeliest = min(found, key=lambda each: float(each.fun))
        h = np.array(self.fitted.h)
        h[self.places] = likeliest.x
        return TakenUp(-float(likeliest.fun), h)


@dataclass(frozen=True)
class TakenUp:
    """An effect that noise took up: log B, and the noise parameters h, in z, beside it."""

    log_factor: float
    h: np.ndarray


def evident_between_runs(
    fitted: Fit, responses: Responses, prepared: Sequence[ProjectedResponse], candidates: Sequence[Candidate]
) -> dict[int, float]:
    """Return log B of the candidates that act between runs and are evident, by their place; often none.

    Parameters
    ----------
    prepared, candidates : as screened, all of them.
    """
    # Scatter that contradicts what is known is a finding by itself, and a name for it is no further alarm.
    told = contradicted_between_runs(fitted, responses)
    chance = thresholds.FALSE_ALARM if told else thresholds.MARGINAL_EVIDENCE
    enough = _enough(candidates, chance)
    most = 1 - thresholds.BOTH_STRATA_SHARE
    acting = [place for place, each in enumerate(candidates) if each.score.within_runs < most]
    scatter = _Scatter(fitted, responses)
    found = {
        place: scatter.log_factor(columns_of(prepared, candidates[place]), candidates[place].owners, enough)
        for place in acting
    }
    return {place: log_factor for place, log_factor in found.items() if log_factor > enough}


def evidence_with_scatter(
    fitted: Fit, responses: Responses, prepared: Sequence[ProjectedResponse], candidate: Candidate
) -> float:
    """Return log B of a candidate, with the scatter between runs at its best on either side."""
    return _Scatter(fitted, responses).log_factor(columns_of(prepared, candidate), candidate.owners)


@dataclass(frozen=True)
class _Scatter:
    """The linearised fit as a function of the scatter between runs."""

    fitted: Fit
    responses: Responses

    @cached_property
    def _of_all(self) -> _Marginal:
        return _Marginal(self.fitted, self.responses, _scatter_places(self.fitted))

    @cached_property
    def _of_owners(self) -> dict[tuple[str, ...], _Marginal]:
        return {}

    def log_factor(self, columns: np.ndarray, owners: tuple[str, ...], enough: float = -math.inf) -> float:
        """Return log B of an effect of columns (E, C), only roughly where it is far from `enough`; −∞ without scatter.

        It is the largest one on a grid and on a line, hardly less than that over all scales, and never more.
        """
        near = self._of_all.near(columns)
        if near <= enough - thresholds.GRID_SLACK:
            return near
        if owners not in self._of_owners:
            self._of_owners[owners] = _Marginal(self.fitted, self.responses, _scatter_places(self.fitted, owners))
        return max(near, *(at.log_bayes_factor(columns) for at in self._of_owners[owners].line))


def evident_in_correlated_noise(
    fitted: Fit, responses: Responses, prepared: Sequence[ProjectedResponse], candidates: Sequence[Candidate]
) -> dict[int, TakenUp]:
    """Return the candidates that correlated noise took up and that are evident, by their place; often none.

    Parameters
    ----------
    prepared, candidates : as screened at the noise of the model, all of them, the most significant first.
    """
    if len(responses.misfit) > thresholds.TAKEN_UP_ROWS:
        return {}
    slow = {fitted.model.campaign.channels[place].name for place in with_slow_noise(fitted)}
    likely = [place for place, each in enumerate(candidates) if slow & set(each.owners)]
    likely = [place for place in likely if candidates[place].p < thresholds.TAKEN_UP_P][: thresholds.TAKEN_UP_MOST]
    marginals = {
        owners: _Marginal(fitted, responses, _noise_places(fitted, slow & set(owners)))
        for owners in {candidates[place].owners for place in likely}
    }
    enough, found = _enough(candidates, thresholds.MARGINAL_EVIDENCE), {}
    for place in likely:
        own = candidates[place]
        found[place] = marginals[own.owners].taken_up(columns_of(prepared, own), enough)
    return {place: each for place, each in found.items() if each is not None}


def _enough(candidates: Sequence[Candidate], chance: float) -> float:
    """Return the log B that any of so many candidates reaches with this probability at most."""
    return math.log(len(candidates) / chance)


def _noise_places(fitted: Fit, channels: set[str]) -> np.ndarray:
    """Return the places in h of the noise parameters of some channels."""
    parameters = fitted.model.hyper_layout.parameters
    return np.array([place for place, each in enumerate(parameters) if channels & set(each.label)], dtype=int)


def _scatter_places(fitted: Fit, owners: Sequence[str] = ()) -> np.ndarray:
    """Return the places in h of the scales of run offsets: of some channels, where any of the owners is one."""
    effects = fitted.model.assembly.effects
    shared = {each.name for each in effects if issubclass(each.effect_class, SharedNoise)}
    parameters = fitted.model.hyper_layout.parameters
    places = [place for place, each in enumerate(parameters) if each.effect in shared]
    own = [place for place in places if set(owners) & set(parameters[place].label)]
    return np.array(own or places, dtype=int)


def columns_of(prepared: Sequence[ProjectedResponse], candidate: Candidate) -> np.ndarray:
    """Return the response to a candidate, (E, C), per largest typical size of its coefficients."""
    found, chosen = response_of(prepared, candidate)
    return found.response.columns[:, chosen] * np.array([each.typical[1] for each in candidate.coefficients])
