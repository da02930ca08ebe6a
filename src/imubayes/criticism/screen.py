"""One pass over all candidates, before any refit: what a refit would bring, and which coefficients it would find.

With r the whitened residual and g⊥ a candidate's whitened response less what the model can absorb, u = g⊥ᵀr and
V = g⊥ᵀg⊥ give the score S = uᵀV⁻¹u, the drop of χ² of a refit, and β̂ = V⁻¹u, the coefficients it would find.

A hidden effect has inflated the noise scales that the fit found, so S is measured against the scale of each stratum
as it is *after* the candidate has been taken out: F = Σ_s (S_s/s_s²)/d with Satterthwaite's degrees of freedom.  In a
single stratum that is the F test of a nested linear model, exactly.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import stats

from imubayes.criticism.candidates import Coefficient, Response, Scan
from imubayes.criticism.projection import Projection, orthonormal

_SMALLEST = 1e-300


@dataclass(frozen=True)
class Candidate:
    """A candidate on some channels (or mountings, tables), as screened.

    Attributes
    ----------
    scan : effect and shape.
    coefficients : C of them.
    owners : the channels, mountings or tables of the coefficients.
    value, sd : shape (C,), in the coefficients' units, the sd with the noise scale after the candidate.
    drop : S with the noise scale after the candidate: the drop of χ² that a refit brings.
    drop_at_fit : S with the noise scale of the fit.
    dof : number of directions that could be resolved.
    p : chance of such a drop where there is no effect, of this candidate alone.
    retained : share of the response that the model cannot absorb, shape (C,).
    fitted : shape (R,), the part of the residual that it explains.
    span : shape (R, dof), orthonormal basis of its projected response.
    within : share of S that comes from within runs.
    scales : shape (strata + 1,), noise scale after the candidate, relative to the fit's.
    """

    scan: Scan
    coefficients: tuple[Coefficient, ...]
    owners: tuple[str, ...]
    value: np.ndarray
    sd: np.ndarray
    drop: float
    drop_at_fit: float
    dof: int
    p: float
    retained: np.ndarray
    within: float
    fitted: np.ndarray = field(repr=False)
    span: np.ndarray = field(repr=False)
    scales: np.ndarray = field(repr=False)

    @property
    def effect(self) -> str:
        """Name of the effect."""
        return self.scan.effect


@dataclass(frozen=True)
class Projected:
    """A response as rows, before and after projection: whitened (R, C) and projected (R, C)."""

    response: Response
    whitened: np.ndarray
    projected: np.ndarray


def prepare(projection: Projection, responses: Sequence[Response]) -> list[Projected]:
    """Return the responses as rows of the projection."""
    if not responses:
        return []
    whitened = projection.whitened(np.concatenate([one.columns for one in responses], axis=1))
    projected = projection.project(whitened)
    ends = np.cumsum([len(one.coefficients) for one in responses])
    return [
        Projected(one, whitened[:, end - len(one.coefficients) : end], projected[:, end - len(one.coefficients) : end])
        for one, end in zip(responses, ends, strict=True)
    ]


def assess(projection: Projection, one: Projected, chosen: np.ndarray | None = None) -> Candidate:
    """Return a candidate with the chosen coefficients; all of them where None."""
    chosen = np.arange(len(one.response.coefficients)) if chosen is None else chosen
    columns, length = one.projected[:, chosen], np.linalg.norm(one.whitened[:, chosen], axis=0)
    span = orthonormal(columns, length)
    along = span.T @ projection.residual
    explained = span @ along
    strata = projection.strata
    drop = strata.sums(explained**2)
    left = strata.sums((projection.residual - explained) ** 2)
    spent = strata.sums(np.sum(span**2, axis=1))
    freedom = projection.freedom - spent
    # The prior's scale is known; a stratum with no freedom left has none that could be judged.
    judged = freedom > 0.5
    judged[-1] = False
    scale = np.where(judged, left / np.where(judged, freedom, 1.0), 1.0)
    scale = np.maximum(scale, 1e-12)
    weighted = drop / scale
    total, count = float(weighted.sum()), span.shape[1]
    finite = np.where(judged, freedom, 1e9)
    denominator = total**2 / max(float(np.sum(weighted**2 / finite)), 1e-300) if total > 0 else 1.0
    p = float(stats.f.sf(total / count, count, denominator)) if count else 1.0
    value, sd = _coefficients(projection, columns, explained, scale)
    within = weighted[:-1][~strata.between].sum() / total if total > 0 else 1.0
    retained = np.sum(columns**2, axis=0) / np.where(length > 0, length**2, 1.0)
    coefficients = tuple(one.response.coefficients[place] for place in chosen)
    return Candidate(
        scan=one.response.scan,
        coefficients=coefficients,
        owners=tuple(dict.fromkeys(coefficient.owner for coefficient in coefficients)),
        value=value,
        sd=sd,
        drop=total,
        drop_at_fit=float(np.sum(along**2)),
        dof=count,
        p=max(p, _SMALLEST),
        retained=retained,
        within=float(within),
        fitted=explained,
        span=span,
        scales=np.sqrt(scale),
    )


def _coefficients(projection: Projection, columns, explained, scale) -> tuple[np.ndarray, np.ndarray]:
    """Return coefficients and standard deviations by generalised least squares with the scales of the strata."""
    place = np.where(projection.strata.of_row < 0, len(scale) - 1, projection.strata.of_row)
    size = np.linalg.norm(columns, axis=0)
    unit = columns / np.where(size > 0, size, 1.0)
    inverse = np.linalg.pinv(unit, rcond=1e-6)
    value = inverse @ explained
    covariance = (inverse * scale[place]) @ inverse.T
    with np.errstate(divide="ignore"):
        # A column that is all absorbed has no coefficient: its uncertainty is boundless.
        sd = np.where(size > 0, np.sqrt(np.diag(covariance)) / np.where(size > 0, size, 1.0), np.inf)
    return np.where(size > 0, value / np.where(size > 0, size, 1.0), 0.0), sd


def variants(response: Response) -> list[np.ndarray]:
    """Return which coefficients to try together: all, and those of each owner alone."""
    owners = [coefficient.owner for coefficient in response.coefficients]
    every = np.arange(len(owners))
    alone = [np.array([i for i in every if owners[i] == owner]) for owner in dict.fromkeys(owners)]
    return [every, *alone] if len(alone) > 1 else [every]


def screen(projection: Projection, responses: Sequence[Projected]) -> list[Candidate]:
    """Return every candidate on all its channels together and on each alone, best first."""
    found = [assess(projection, one, chosen) for one in responses for chosen in variants(one.response)]
    return sorted((one for one in found if one.dof), key=lambda one: (one.p, -one.drop))
