"""χ² and residuals at the noise known beforehand, so that what noise absorbed is seen again.

A scale of the noise that takes up a missing effect leaves χ² at its degrees of freedom, and the offset of a run that
grows takes up what differs between runs.  At scales that do not depend on the fit
(`imubayes.adequacy.known_noise.known_scales`) neither can happen: the least sum of squares of outputs and priors,

    min_z |Σ^(−½) (y − f(z))|² + |z|²,

has as many degrees of freedom as there are outputs, and never rises with an effect that is added.  The offset of a run
is counted with the scatter that is known, and remains in the residual.  Diagnosis, addition and history state this one
figure.
"""

import math
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from imubayes.adequacy.adequacy_record import ChannelRms, KnownNoiseFit, RunChi2
from imubayes.adequacy.known_noise import known_scales
from imubayes.foundations.arrays import Array, Float
from imubayes.foundations.campaign_data import INPUT_UNIT
from imubayes.foundations.numerics import group_means
from imubayes.foundations.units import to_si
from imubayes.inference.fitted_model import Fit
from imubayes.inference.parameter_fit import Linearised, fit_at, linearise, whitened_about, whitened_columns
from imubayes.model.bind import Model
from imubayes.model.noise_covariance import noise_deviation, whitener
from imubayes.model.problem import Problem

_RETAINED_MIN = 1e-12
"""A direction of a candidate whose projection retains less than this share of its squared length is rounding, and
cannot be detected.  Numerical: a drift turns a servo table by 10⁶ times the noise of its angle, and what only the
priors of the model speak against is 1e-10 of that; projections are accurate to some 1e-20.  Larger overlooks such
effects."""


@dataclass(frozen=True)
class KnownNoisePoint:
    """A model linearised, with its noise at known scales, and fitted there.

    Attributes
    ----------
    model, h : whose noise scales are h.
    misfit : shape (E,), in output units, at the least squares.
    jacobian : shape (E, P).
    basis, upper : shapes (E + P, P) and (P, P), QR of the whitened Jacobian with the rows of the priors.
    left : shape (E + P,), whitened residual at the least squares, the rows of the priors last.
    z : shape (P,), at the least squares.
    """

    model: Model
    h: np.ndarray
    misfit: np.ndarray
    jacobian: np.ndarray
    basis: np.ndarray
    upper: np.ndarray
    left: np.ndarray
    z: np.ndarray

    def with_columns(self, columns: np.ndarray, white: np.ndarray | None = None) -> "KnownNoisePoint":
        """Return the same with further responses (E, C) fitted, without a prior; `white`, if they are at hand."""
        if white is None:
            white = whitened_columns(self.model.problem, self.h, columns)
        fresh = np.concatenate([white, np.zeros((len(self.left) - len(white), columns.shape[1]))])
        absorbed = self.basis.T @ fresh
        across = fresh - self.basis @ absorbed
        # Columns are of one length for the least squares, whatever their units.
        length = np.linalg.norm(fresh, axis=0)
        unit = np.where(length > 0, length, 1.0)
        size = np.linalg.lstsq(across / unit, self.left, rcond=math.sqrt(_RETAINED_MIN))[0] / unit
        moved = np.linalg.solve(self.upper, absorbed @ size)
        misfit = self.misfit - columns @ size + self.jacobian @ moved
        return replace(self, misfit=misfit, left=self.left - across @ size, z=self.z - moved)

    def record(self) -> KnownNoiseFit:
        """Return χ², the residual rms of each channel, and χ² of each channel in each run."""
        outputs = float(np.sum(np.asarray(self.model.problem.observations.weight)))
        return KnownNoiseFit(
            chi2=float(self.left @ self.left), dof=outputs, channels=self._channels(), runs=self._runs()
        )

    def _runs(self) -> tuple[RunChi2, ...]:
        campaign, entries = self.model.campaign, self.model.entries
        used = (np.asarray(self.model.problem.observations.weight) > 0) & ~entries.closing
        names = [channel.name for channel in campaign.channels]
        place = (entries.run * len(names) + entries.channel)[used]
        size, square = len(campaign.runs) * len(names), self.left[: len(entries)][used] ** 2
        counts, sums = np.bincount(place, minlength=size), np.bincount(place, square, size)
        return tuple(
            RunChi2(run=run.name, channel=name, n=n, chi2=chi2)
            for (run, name), n, chi2 in zip(product(campaign.runs, names), counts.tolist(), sums.tolist(), strict=True)
            if n
        )

    def _channels(self) -> tuple[ChannelRms, ...]:
        campaign, entries = self.model.campaign, self.model.entries
        noise = np.asarray(noise_sd(self.model.problem, np.asarray(self.h)))
        used = (np.asarray(self.model.problem.observations.weight) > 0) & ~entries.closing
        found = []
        for place, channel in enumerate(campaign.channels):
            here, unit = used & (entries.channel == place), INPUT_UNIT[channel.kind]
            if here.any():
                own = self.misfit[here] / abs(channel.scale_si * to_si(unit, campaign.site.gravity))
                within = own - group_means(own, np.unique(entries.run[here], return_inverse=True)[1])
                sizes = own, within, noise[here] / abs(channel.scale_si * to_si(unit, campaign.site.gravity))
                rms, inside, assumed = (float(np.sqrt(np.mean(each**2))) for each in sizes)
                found.append(ChannelRms(channel=channel.name, rms=rms, unit=unit, within=inside, noise=assumed))
        return tuple(found)


def noise_sd(problem: Problem, h: Float[Array, " H"]) -> np.ndarray:
    """Return the standard deviation of the noise of every entry at scales h, (E,), output units."""
    return noise_deviation(problem, whitener(problem, h))


def known_noise_point(model: Model, about: Linearised, h: np.ndarray) -> KnownNoisePoint:
    """Return a linearised model fitted at noise scales h, in z, shape (H,)."""
    residual, jacobian, widths = whitened_about(model.problem, about, h)
    rows = np.concatenate([jacobian, np.diag(1 / widths)])
    right = np.concatenate([residual, -np.asarray(about.z) / widths])
    basis, upper = np.linalg.qr(rows)
    along, raw = basis.T @ right, np.asarray(about.jacobian)
    step = np.linalg.solve(upper, along)
    misfit, z = np.asarray(about.misfit) - raw @ step, np.asarray(about.z) + step
    return KnownNoisePoint(model, h, misfit, raw, basis, upper, right - basis @ along, z)


def fit_at_known_noise(fitted: Fit) -> KnownNoiseFit:
    """Return the goodness of fit of a model at the noise known beforehand, its parameters fitted there."""
    problem, h = fitted.model.problem, known_scales(fitted)
    z = fit_at(problem, np.asarray(fitted.z), np.asarray(h))
    return known_noise_point(fitted.model, linearise(problem, z), h).record()
