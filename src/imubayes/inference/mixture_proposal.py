"""Mixtures of Student's t distributions as proposals, fitted to what is known of a density.

If the density is no normal distribution about one mode, draws of it show where it lies: far apart, beside an edge,
in heavy tails.  A mixture is fitted to them by expectation–maximisation; its own draws, weighted by the density, are
fitted in turn, which finds the shares of places between which no chain went (population Monte Carlo: Cappé, Douc,
Guillin, Marin, Robert 2008).  Tails are those of Student's t, so that weights stay bounded if those of a normal
proposal do not; no share falls to nothing, so that a place where a chain was stays covered.
"""

import hashlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy  # loads its parts when they are first used
from scipy.special import fdtri, gammainccinv, gammaincinv, gammaln, ndtri

from imubayes.foundations.tail_probabilities import chi2_cdf, chi2_survival, f_survival, normal_survival
from imubayes.inference.laplace_proposal import BatchedDensity, WeighedProposal, weigh

FREEDOM = 8.0
"""Degrees of freedom: heavier tails than those of posteriors of some tens of readings, and weights of a normal density
below 3 in eight dimensions."""
# Parts of a mixture, fewer if draws are few: so many draws a part for each dimension determine its covariance.
_PARTS, _DRAWS_A_DIMENSION = 16, 20
# Steps of expectation–maximisation on one set of draws.
_ITERATIONS = 20
# No share of a part falls below this, of equal shares.
_LEAST_SHARE = 0.05
# A covariance is taken from weighted draws worth so many a dimension, and kept if they are worth less.
_WORTH = 4.0
# A refit that gains less in acceptance is the last.
_GAIN = 1.02
_TINY = 1e-300


@dataclass(frozen=True)
class MixtureProposal:
    """A mixture of K multivariate t distributions in D dimensions, as a map from D + 1 standard normal numbers.

    The last number says which part is drawn from.  The way back draws it, as the density of a point is shared by all
    parts; the draw is a function of the points, so that a chain that is resumed goes on as it would have.

    Attributes
    ----------
    share : shape (K,), of sum 1.
    centre : shape (K, D).
    axes : shape (K, D, D), invertible; axes · axesᵀ is the scale matrix.
    freedom : degrees of freedom.
    """

    share: np.ndarray
    centre: np.ndarray
    axes: np.ndarray
    freedom: float = FREEDOM

    @property
    def dimensions(self) -> int:
        """Number of standard normal numbers of a point: D + 1."""
        return self.centre.shape[1] + 1

    @cached_property
    def _inverse(self) -> np.ndarray:
        return np.linalg.inv(self.axes)

    def to_point(self, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the points of standard normal vectors, (n, D + 1), and the log density of the proposal, (n,)."""
        part = np.minimum(np.searchsorted(np.cumsum(self.share), normal_survival(-normal[:, -1])), len(self.share) - 1)
        inner = normal[:, :-1]
        square = np.sum(inner**2, axis=1)
        stretched = inner * np.sqrt(self._of_chi_square(square) / np.maximum(square, _TINY))[:, None]
        points = self.centre[part] + np.einsum("nij,nj->ni", self.axes[part], stretched)
        return points, self.log_density(points)

    def to_normal(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return standard normal vectors of points, (n, D + 1), and the log density of the proposal, (n,)."""
        digest = hashlib.sha256(np.ascontiguousarray(points).tobytes()).digest()
        random = np.random.default_rng(np.frombuffer(digest, dtype=np.uint32))
        density = self.part_densities(points)
        total = np.logaddexp.reduce(density, axis=1)
        below = np.cumsum(np.exp(density - total[:, None]), axis=1)
        part = np.minimum((below < random.uniform(size=(len(points), 1))).sum(axis=1), len(self.share) - 1)
        within = np.cumsum(self.share)[part] - self.share[part] * random.uniform(size=len(points))
        away = np.einsum("nij,nj->ni", self._inverse[part], points - self.centre[part])
        square = np.sum(away**2, axis=1)
        inner = away * np.sqrt(self._to_chi_square(square) / np.maximum(square, _TINY))[:, None]
        return np.concatenate([inner, ndtri(np.clip(within, 1e-12, 1 - 1e-12))[:, None]], axis=1), total

    def log_density(self, points: np.ndarray) -> np.ndarray:
        """Return the log density, (n,), at points (n, D)."""
        return np.logaddexp.reduce(self.part_densities(points), axis=1)

    def part_densities(self, points: np.ndarray) -> np.ndarray:
        """Return the log density of each part times its share, (n, K), at points (n, D)."""
        size, freedom = points.shape[1], self.freedom
        constant = gammaln((freedom + size) / 2) - gammaln(freedom / 2) - 0.5 * size * np.log(np.pi * freedom)
        height = np.log(self.share) + constant + np.linalg.slogdet(self._inverse)[1]
        return height - 0.5 * (freedom + size) * np.log1p(self.squares(points) / freedom)

    def squares(self, points: np.ndarray) -> np.ndarray:
        """Return the squared distance, (n, K), of points (n, D) from each centre, in the scale of the part."""
        parts = zip(self._inverse, self.centre, strict=True)
        return np.stack([np.sum(((points - centre) @ inverse.T) ** 2, axis=1) for inverse, centre in parts], axis=1)

    def _of_chi_square(self, square: np.ndarray) -> np.ndarray:
        """Return the squared radii of t distributed points from those of normal ones: the same quantile of each."""
        size = float(self.dimensions - 1)
        below, above = chi2_cdf(square, size), chi2_survival(square, size)
        inner = fdtri(size, self.freedom, np.minimum(below, 0.5))
        outer = 1 / fdtri(self.freedom, size, np.minimum(above, 0.5))
        return size * np.where(below < 0.5, inner, outer)

    def _to_chi_square(self, square: np.ndarray) -> np.ndarray:
        size = float(self.dimensions - 1)
        ratio = np.maximum(square / size, _TINY)
        below, above = f_survival(1 / ratio, self.freedom, size), f_survival(ratio, size, self.freedom)
        inner = 2 * gammaincinv(size / 2, np.minimum(below, 0.5))
        return np.where(below < 0.5, inner, 2 * gammainccinv(size / 2, np.minimum(above, 0.5)))


def about_normal(centre: np.ndarray, axes: np.ndarray) -> MixtureProposal:
    """Return the t distribution, of one part, about a normal one: its centre (D,) and axes (D, D)."""
    return MixtureProposal(np.ones(1), centre[None], axes[None])


def fitted_to(draws: np.ndarray, seed: int) -> MixtureProposal | None:
    """Return the mixture fitted to draws (S, D); None if they span no volume."""
    size = draws.shape[1]
    spread = draws.std(axis=0)
    if not np.all(spread > 0) or len(draws) < _DRAWS_A_DIMENSION * size:
        return None
    white = (draws - draws.mean(axis=0)) / spread
    values, vectors = np.linalg.eigh(white.T @ white / len(white))
    if values[0] <= 1e-12 * values[-1]:
        return None
    parts = max(1, min(_PARTS, len(draws) // (_DRAWS_A_DIMENSION * size)))
    _, label = scipy.cluster.vq.kmeans2(
        white @ vectors / np.sqrt(values), parts, minit="++", rng=np.random.default_rng(seed)
    )
    kept = [part for part in range(parts) if np.sum(label == part) > 2 * size]
    if not kept:
        return None
    axes = [_root(np.cov(draws[label == part].T).reshape(size, size), spread) for part in kept]
    centre, share = [draws[label == part].mean(axis=0) for part in kept], [np.mean(label == part) for part in kept]
    mixture = MixtureProposal(np.array(share) / np.sum(share), np.array(centre), np.array(axes))
    return refitted(mixture, draws, np.full(len(draws), 1 / len(draws)))


def refitted(mixture: MixtureProposal, points: np.ndarray, weight: np.ndarray) -> MixtureProposal:
    """Return the mixture after expectation–maximisation on points (S, D) of weights (S,), of sum 1."""
    size, spread = points.shape[1], points.std(axis=0)
    for _ in range(_ITERATIONS):
        density = mixture.part_densities(points)
        part = weight[:, None] * np.exp(density - np.logaddexp.reduce(density, axis=1)[:, None])
        share = part.sum(axis=0)
        worth = share**2 / np.maximum(np.sum(part**2, axis=0), _TINY)
        near = part * (mixture.freedom + size) / (mixture.freedom + mixture.squares(points))
        centre, axes = mixture.centre.copy(), mixture.axes.copy()
        for place in np.flatnonzero(worth > _WORTH * size):
            centre[place] = near[:, place] @ points / near[:, place].sum()
            away = points - centre[place]
            axes[place] = _root((near[:, place, None] * away).T @ away / share[place], spread)
        share = np.maximum(share, _LEAST_SHARE / len(share))
        mixture = MixtureProposal(share / share.sum(), centre, axes, mixture.freedom)
    return mixture


def _root(covariance: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Return the Cholesky factor of a covariance (D, D), with next to nothing added if it is singular."""
    relative = covariance / np.outer(spread, spread)
    relative = relative + 1e-9 * np.trace(relative) / len(spread) * np.eye(len(spread))
    return spread[:, None] * np.linalg.cholesky(relative)


def adapted(
    density: BatchedDensity, mixture: MixtureProposal, rounds: int, count: int, seed: int
) -> tuple[MixtureProposal, WeighedProposal | None]:
    """Return the mixture refitted to its own weighted draws until it gains nothing, with `count` draws of it.

    Parameters
    ----------
    density : points (n, D) → log densities (n,).
    rounds : refits at most.
    """
    best, judged = mixture, weigh(density, mixture, 1, count, seed)
    for later in range(1, rounds + 1):
        if judged is None:
            break
        # A few large weights would shrink a part to their points.
        weight = np.minimum(judged.weight.reshape(-1), np.sqrt(judged.weight.size))
        tried = refitted(best, judged.points.reshape(len(weight), -1), weight / weight.sum())
        found = weigh(density, tried, 1, count, seed + later)
        if found is None or found.acceptance < _GAIN * judged.acceptance:
            break
        best, judged = tried, found
    return best, judged
