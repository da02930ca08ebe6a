"""The parameters of all units together: their population means jointly, and each unit given the others.

Runs often determine a combination of parameters and not each of them: a scale factor and the angle of its mounting, in
every unit alike.  The population means are then as correlated as the parameters of a unit, and what one of them lacks
must not be averaged away over the units.  With the likelihood of a unit, normal with information Λᵢ and linear term ηᵢ
in its P parameters, and a population

    θᵢ ~ N(μ + eᵢ, T),   T = diag(τ²),

where eᵢ are the offsets of groups, steps and trends, μ given T is normal with

    precision  1/σ₀² + Σᵢ Gᵢ,   Gᵢ = T⁻¹ − T⁻¹ (Λᵢ + T⁻¹)⁻¹ T⁻¹,

and θᵢ given μ is normal with precision Λᵢ + T⁻¹.  The prior of μ is that of the model.  The spread of one parameter is
estimated from the units as in `population.population`, its means of the other parameters given: an error that they
share moves all units alike.  Means and spreads are computed in turn until they settle.
Spreads that the units determine only together are then integrated over (`confounded_spreads`).

All parameters are in units of the standard deviation of their prior, about its mean, so that the prior of a unit is
standard normal.  Directions in which a posterior is hardly narrower than that are no information (`LEAST_FROM_DATA`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import polars as pl

from imubayes_archive.population.population import LEAST_FROM_DATA, UnitPosteriors
from imubayes_archive.unit_fits.posterior_table import unpacked

# Least variance of a population, in units of the prior: smaller ones lose digits in the quotient of precisions.
_LEAST_VARIANCE = 1e-10
_WIDE = 1e3


@dataclass(frozen=True)
class JointUnits:
    """Likelihoods of n units in P parameters, in units of their priors.

    Attributes
    ----------
    names, digests : of the parameters and of the units.
    centre, width : shape (P,), mean and standard deviation of the prior of each parameter.
    information : shape (n, P, P); 0 for a parameter that a unit lacks.
    linear : shape (n, P).
    present : shape (n, P), bool.
    draws : shape (n,), effective number of draws of each posterior.
    """

    names: tuple[str, ...]
    digests: tuple[str, ...]
    centre: np.ndarray
    width: np.ndarray
    information: np.ndarray
    linear: np.ndarray
    present: np.ndarray
    draws: np.ndarray

    @staticmethod
    def of(table: pl.DataFrame, units: pl.DataFrame) -> "JointUnits":
        """Return the likelihoods of units.

        Parameters
        ----------
        table : rows of the parameters of these units, each on a linear scale.
        units : rows of the units, with means and covariances.
        """
        names = tuple(table["parameter"].unique(maintain_order=True))
        centre, width = _priors(table, names)
        rows = [_likelihood(row, names, centre, width) for row in units.iter_rows(named=True)]
        information, linear, present = (np.stack(part) for part in zip(*rows, strict=True))
        draws = units["draws"].fill_null(np.inf).to_numpy()
        return JointUnits(names, tuple(units["digest"]), centre, width, information, linear, present, draws)


def _priors(table: pl.DataFrame, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and standard deviation of the prior of each parameter; wide ones for flat priors."""
    found = table.group_by("parameter").agg(
        pl.col("prior_mean").median(), pl.col("prior_sd").median(), pl.col("mean").median(), pl.col("sd").max()
    )
    by_name = {row["parameter"]: row for row in found.iter_rows(named=True)}
    centre, width = np.zeros(len(names)), np.zeros(len(names))
    for place, name in enumerate(names):
        row = by_name[name]
        known = row["prior_sd"] is not None and np.isfinite(row["prior_sd"]) and row["prior_mean"] is not None
        centre[place] = row["prior_mean"] if known else row["mean"]
        width[place] = row["prior_sd"] if known else _WIDE * row["sd"]
    return centre, width


def _likelihood(
    row: dict, names: Sequence[str], centre: np.ndarray, width: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return information (P, P), linear term (P,) and presence (P,) of one unit: its posterior over its prior."""
    known = {name: place for place, name in enumerate(row["names"])}
    mine = np.array([place for place, name in enumerate(names) if name in known], dtype=int)
    own = np.array([known[names[place]] for place in mine], dtype=int)
    information, linear = np.zeros((len(names), len(names))), np.zeros(len(names))
    present = np.isin(np.arange(len(names)), mine)
    covariance = unpacked(row["covariance"])[np.ix_(own, own)] / np.outer(width[mine], width[mine])
    mean = (np.asarray(row["mean"])[own] - centre[mine]) / width[mine]
    values, axes = np.linalg.eigh(covariance)
    draws = np.inf if row["draws"] is None else row["draws"]
    tells = (1 - values > max(LEAST_FROM_DATA, np.sqrt(2 / draws))) & (values > 0)
    safe = np.where(tells, values, 1.0)
    information[np.ix_(mine, mine)] = (axes * np.where(tells, 1 / safe - 1, 0.0)) @ axes.T
    linear[mine] = axes @ (np.where(tells, 1 / safe, 0.0) * (axes.T @ mean))
    return information, linear, present


@dataclass(frozen=True)
class JointPopulation:
    """Means of the population and units given it, the spreads being known; in units of the priors.

    Attributes
    ----------
    units : the likelihoods.
    variance : shape (P,), τ² of each parameter.
    weight : shape (n, P), of each unit under a law with heavy tails; 1 under the normal law.
    offsets : shape (n, P), eᵢ.
    """

    units: JointUnits
    variance: np.ndarray
    weight: np.ndarray
    offsets: np.ndarray

    @staticmethod
    def start(units: JointUnits) -> "JointPopulation":
        """Return the population before its spreads are known: as wide as the priors."""
        shape = units.linear.shape
        return JointPopulation(units, np.ones(shape[1]), np.ones(shape), np.zeros(shape))

    @cached_property
    def precision(self) -> np.ndarray:
        """1/τ² of each unit and parameter, (n, P)."""
        return self.weight / np.maximum(self.variance, _LEAST_VARIANCE)

    @cached_property
    def conditional(self) -> np.ndarray:
        """Covariance of each unit given μ, (n, P, P)."""
        size = len(self.variance)
        return np.linalg.inv(self.units.information + self.precision[:, :, None] * np.eye(size))

    @cached_property
    def gains(self) -> np.ndarray:
        """Precision of each unit about μ, Gᵢ, (n, P, P)."""
        carried = self.precision[:, :, None] * self.conditional
        return self.precision[:, :, None] * np.eye(len(self.variance)) - carried * self.precision[:, None, :]

    @cached_property
    def means(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean (P,) and covariance (P, P) of μ."""
        carried = self.precision[:, :, None] * self.conditional
        # A parameter that a unit lacks says nothing of the mean.
        linear = np.einsum("npq,nq->np", carried, self.units.linear) - np.einsum("npq,nq->np", self.gains, self.offsets)
        covariance = np.linalg.inv(np.eye(len(self.variance)) + self.gains.sum(axis=0))
        return covariance @ linear.sum(axis=0), covariance

    @cached_property
    def given(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation of each unit given all units, (n, P) each."""
        mean, covariance = self.means
        prior = self.precision * (mean + self.offsets)
        own = np.einsum("npq,nq->np", self.conditional, self.units.linear + prior)
        by_mean = self.conditional * self.precision[:, None, :]
        shared = np.einsum("npq,qr,npr->np", by_mean, covariance, by_mean)
        return own, np.sqrt(np.einsum("npp->np", self.conditional) + shared)

    def site(self, place: int) -> UnitPosteriors:
        """Return what the data of each unit say of one parameter, the means of the others given; in its own unit."""
        mean, _ = self.means
        variance = self.conditional[:, place, place]
        own, prior = self.precision[:, place], mean[place] + self.offsets[:, place]
        estimate = np.einsum("nq,nq->n", self.conditional[:, place], self._linear())
        precision = 1 / variance - own
        tells = precision > LEAST_FROM_DATA / (1 - LEAST_FROM_DATA)
        safe = np.where(tells, precision, 1.0)
        value = np.where(tells, (estimate / variance - own * prior) / safe, np.nan)
        width = self.units.width[place]
        sd = np.where(tells, width / np.sqrt(safe), np.nan)
        count = len(value)
        flat = np.zeros(count), np.full(count, np.inf)
        stated = float(self.units.centre[place]), float(width)
        return UnitPosteriors(self.units.centre[place] + width * value, sd, *flat, self.units.draws, stated)

    def _linear(self) -> np.ndarray:
        return self.units.linear + self.precision * (self.means[0] + self.offsets)

    def with_spread(self, place: int, spread: float, weight: np.ndarray | None = None) -> "JointPopulation":
        """Return the population with another spread of one parameter, in its own unit."""
        variance = self.variance.copy()
        variance[place] = (spread / self.units.width[place]) ** 2
        weights = self.weight.copy()
        weights[:, place] = 1.0 if weight is None else weight
        return replace(self, variance=variance, weight=weights)

    def with_variances(self, places: np.ndarray, variances: np.ndarray) -> "JointPopulation":
        """Return the population with other variances τ² of some parameters, (K,) each; weights stay."""
        variance = self.variance.copy()
        variance[places] = variances
        return replace(self, variance=variance)

    def with_offsets(self, place: int, offsets: np.ndarray) -> "JointPopulation":
        """Return the population with offsets (n,) of one parameter, in its own unit."""
        changed = self.offsets.copy()
        changed[:, place] = offsets / self.units.width[place]
        return replace(self, offsets=changed)
