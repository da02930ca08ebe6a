"""Score test of every candidate before any refit: the Δχ² of a refit, and the coefficients it would find.

With r the whitened residual and g⊥ a candidate's whitened response less what the model absorbs, u = g⊥ᵀr and
V = g⊥ᵀg⊥ give the score S = uᵀV⁻¹u, the drop of χ² of a refit, and β̂ = V⁻¹u, the coefficients it would find.

A missing effect has inflated the fitted noise scales, so S is measured against the scale of each stratum *after* the
candidate was projected out: F = Σ_s (S_s/s_s²)/d with Satterthwaite's degrees of freedom.  In a
single stratum that is the F test of a nested linear model, exactly.  Coefficients whose prior allows one sign only are
fitted and tested with that sign (`imubayes.criticism.one_sided`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from imubayes.criticism import thresholds
from imubayes.criticism.candidate_effects import Coefficient, Response, ShapeScan
from imubayes.criticism.one_sided import Cone
from imubayes.criticism.projection import Projection, orthonormal
from imubayes.tail_probabilities import LEAST_P, chi2_log_survival, f_log_survival, p_value

# A stratum with fewer degrees of freedom has no scale that could be judged; of a known scale they are unlimited.
LEAST_FREEDOM, KNOWN_FREEDOM = 0.5, 1e9


@dataclass(frozen=True)
class Candidate:
    """A candidate on some channels (or mountings, tables), screened.

    Attributes
    ----------
    scan : effect and shape.
    coefficients : C of them.
    owners : the channels, mountings or tables of the coefficients.
    value, sd : shape (C,), in the coefficients' units, the sd with the noise scale after the candidate.
    retained : fraction of the squared response that the model does not absorb, shape (C,).
    score : its score test, what it explains.
    """

    scan: ShapeScan
    coefficients: tuple[Coefficient, ...]
    owners: tuple[str, ...]
    value: np.ndarray
    sd: np.ndarray
    retained: np.ndarray
    score: "ScoreTest" = field(repr=False)

    @property
    def effect(self) -> str:
        """Name of the effect."""
        return self.scan.effect

    @property
    def dof(self) -> int:
        """Number of directions that could be resolved."""
        return self.score.span.shape[1]

    @property
    def plausible(self) -> bool:
        """Whether its size is possible, and it is supported by data, not only by the priors at an absurd size.

        An effect that the model absorbs but for its priors would fit best without gravity, say: then all
        g-sensitivities could be zero, as their priors prefer.
        """
        typical = np.array([coefficient.typical[1] for coefficient in self.coefficients])
        size = np.abs(self.value)
        largest = thresholds.IMPOSSIBLE_SIZE * typical
        # What no run excites but by rounding has an uncertainty beyond any possible size: it is not observable.
        if np.any(size - 3 * self.sd > largest) or np.all(self.sd > largest):
            return False
        return self.score.prior_share < 0.5 or bool(np.any(size <= thresholds.IMPLAUSIBLE_SIZE * typical))

    @property
    def p(self) -> float:
        """p-value of this candidate alone."""
        return self.score.p

    @cached_property
    def log_p(self) -> float:
        """Logarithm of the p-value of the likelihood ratio, by which candidates are ranked.

        The F test of `p` loses power where part of the evidence lies between few runs; the ranking must not depend on
        that.
        """
        chi2, cone = 2 * self.score.log_likelihood_gain, self.score.cone
        return float(cone.log_survival(chi2) if cone is not None else chi2_log_survival(chi2, max(self.dof, 1)))

    @property
    def delta_chi2(self) -> float:
        """Drop of χ² of a refit, in units of the noise after it."""
        return self.score.delta_chi2


@dataclass(frozen=True)
class ProjectedResponse:
    """A response as rows: whitened (R, C), and projected (R, C)."""

    response: Response
    whitened: np.ndarray
    projected: np.ndarray

    def reweighted(self, projection: Projection, root: np.ndarray) -> "ProjectedResponse":
        """Return the same in a projection of rows that were multiplied by `root`, (R,)."""
        projected = projection.project(root[:, None] * self.projected)
        return ProjectedResponse(self.response, root[:, None] * self.whitened, projected)


def project_responses(projection: Projection, responses: Sequence[Response]) -> list[ProjectedResponse]:
    """Return the responses as rows of the projection."""
    if not responses:
        return []
    coefficients = [coefficient for response in responses for coefficient in response.coefficients]
    largest = np.array([coefficient.typical[1] for coefficient in coefficients])
    whitened = projection.whitened(np.concatenate([response.columns for response in responses], axis=1))
    whitened = np.where(largest * np.linalg.norm(whitened, axis=0) < thresholds.RESPONSE_MIN, 0.0, whitened)
    ends = np.cumsum([len(response.coefficients) for response in responses])[:-1]
    parts = (np.split(columns, ends, axis=1) for columns in (whitened, projection.project(whitened)))
    return [ProjectedResponse(*each) for each in zip(responses, *parts, strict=True)]


@dataclass(frozen=True)
class ScoreTest:
    """The part of the residual that lies in the span of some projected columns.

    Attributes
    ----------
    span : shape (R, d), orthonormal; of the columns in use where signs are bound.
    fitted : shape (R,).
    delta_chi2, delta_chi2_at_fit : S with the noise scales after it, and with those of the fit.
    log_p : logarithm of the p-value under no effect.
    log_likelihood_gain : with the noise scale of every stratum free, so that evidence counts in whichever it lies.
    within_runs, prior_share : shares of S that come from within runs, and from the priors.
    variance : shape (strata + 1,), noise variance of each stratum after it, relative to the fit's.
    cone : the directions of allowed sign; None where every sign is allowed.
    used : shape (C,), bool: columns whose coefficient is not held at 0 by its sign.
    """

    span: np.ndarray
    fitted: np.ndarray
    delta_chi2: float
    delta_chi2_at_fit: float
    log_p: float
    log_likelihood_gain: float
    within_runs: float
    prior_share: float
    variance: np.ndarray
    cone: Cone | None = None
    used: np.ndarray | None = None

    @property
    def p(self) -> float:
        """p-value under no effect."""
        return float(p_value(self.log_p))


def score_test(
    projection: Projection,
    columns: np.ndarray,
    length: np.ndarray,
    least: float = thresholds.RETAINED_MIN,
    signs: np.ndarray | None = None,
    floor: np.ndarray | None = None,
) -> ScoreTest:
    """Return what projected columns explain of the residual.

    Parameters
    ----------
    columns : shape (R, C), projected.
    length : shape (C,), their lengths before projection.
    least : directions that keep less than this share of their squared length count as absorbed.
    signs : shape (C,), the only sign allowed for each coefficient, 0 for either; either for all where None.
    floor : shape (strata + 1,), least variance of each stratum beside the columns, relative to the fit's.
    """
    cone = None if signs is None else _cone(columns, length, least, signs)
    used = _used(cone, projection.residual, len(length))
    span = orthonormal(columns[:, used], length[used], least)
    fitted = span @ (span.T @ projection.residual)
    strata = projection.strata
    drop = strata.sums(fitted**2)
    left = strata.sums((projection.residual - fitted) ** 2)
    freedom = projection.freedom - strata.sums(np.sum(span**2, axis=1))
    variance, judged = noise_left(left, freedom)
    variance = variance if floor is None else np.maximum(variance, floor)
    weighted = drop / variance
    total, count = float(weighted.sum()), span.shape[1]
    finite = np.where(judged, freedom, KNOWN_FREEDOM)
    denominator = total**2 / max(float(np.sum(weighted**2 / finite)), LEAST_P) if total > 0 else 1.0
    log_p = _log_p(total, count, denominator, cone)
    # Where the scale is estimated: half the degrees of freedom times the logarithm of what the scatter shrank by.
    shrank = np.log1p(drop / np.where(judged, freedom * variance, 1.0))
    gain = float(np.sum(np.where(judged, freedom * shrank, drop))) / 2
    within = float(weighted[:-1][~strata.between].sum()) / total if total > 0 else 1.0
    prior_share = float(weighted[-1]) / total if total > 0 else 0.0
    at_fit = float(fitted @ fitted)
    return ScoreTest(span, fitted, total, at_fit, log_p, gain, within, prior_share, variance, cone, used)


def noise_left(squares: np.ndarray, freedom: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the variance of each stratum relative to that of the fit, and whether it was judged; else it is 1.

    The prior's scale is known; a stratum with no freedom left has none that could be judged.

    Parameters
    ----------
    squares, freedom : sums of squares and degrees of freedom of each stratum, the rows of the priors last.
    """
    judged = freedom > LEAST_FREEDOM
    judged[-1] = False
    return np.maximum(np.where(judged, squares / np.where(judged, freedom, 1.0), 1.0), 1e-12), judged


def _log_p(total: float, count: int, denominator: float, cone: Cone | None) -> float:
    """Return the log p-value of a drop of χ² with so many directions, by the F distribution of an estimated scale."""
    if cone is not None:
        return cone.f_log_survival(total, denominator)
    return float(f_log_survival(total / count, count, denominator)) if count else 0.0


def _used(cone: Cone | None, residual: np.ndarray, count: int) -> np.ndarray:
    """Return which of the columns, (C,), have a coefficient that its sign does not hold at 0."""
    if cone is None:
        return np.ones(count, dtype=bool)
    return (cone.coefficients(residual[None])[0] > 0) | ~cone.bounded


def _cone(columns: np.ndarray, length: np.ndarray, least: float, signs: np.ndarray) -> Cone | None:
    """Return the cone of columns of bound sign, without those that are absorbed; None where nothing is left of them."""
    oriented = np.where(signs < 0, -columns, columns) / np.where(length > 0, length, 1.0)
    left = (length > 0) & (np.sum(oriented**2, axis=0) > least)
    if not np.any(left & (signs != 0)):
        return None
    return Cone.of(orthonormal(columns, length, least), np.where(left, oriented, 0.0), signs != 0)


def response_of(prepared: Sequence[ProjectedResponse], candidate: Candidate) -> tuple[ProjectedResponse, np.ndarray]:
    """Return the response that a candidate is of, and the places of its coefficients there."""
    found = next(each for each in prepared if each.response.scan == candidate.scan)
    names = [coefficient.parameter.name for coefficient in found.response.coefficients]
    return found, np.array([names.index(coefficient.parameter.name) for coefficient in candidate.coefficients])


def assess(
    projection: Projection, projected: ProjectedResponse, chosen: np.ndarray, floor: np.ndarray | None = None
) -> Candidate:
    """Return a candidate with the chosen coefficients, by their places; `floor` is that of `score_test`."""
    response, columns = projected.response, projected.projected[:, chosen]
    length = np.linalg.norm(projected.whitened[:, chosen], axis=0)
    coefficients = tuple(response.coefficients[place] for place in chosen)
    signs = np.array([coefficient.sign for coefficient in coefficients])
    score = score_test(projection, columns, length, signs=signs, floor=floor)
    value, sd = _estimates(projection, columns, score)
    return Candidate(
        scan=response.scan,
        coefficients=coefficients,
        owners=tuple(dict.fromkeys(coefficient.owner for coefficient in coefficients)),
        value=value,
        sd=sd,
        retained=np.sum(columns**2, axis=0) / np.where(length > 0, length**2, 1.0),
        score=score,
    )


def _estimates(projection: Projection, columns: np.ndarray, score: ScoreTest) -> tuple[np.ndarray, np.ndarray]:
    """Return coefficients and standard deviations, (C,) each; 0 for a coefficient that its sign holds there."""
    value, sd = generalised_least_squares(projection, columns, score.fitted, score.variance)
    if score.used is not None and not score.used.all():
        free, _ = generalised_least_squares(projection, columns[:, score.used], score.fitted, score.variance)
        value = np.zeros_like(value)
        value[score.used] = free
    return value, sd


def generalised_least_squares(
    projection: Projection, columns: np.ndarray, explained: np.ndarray, variance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return coefficients and standard deviations by generalised least squares with the scales of the strata."""
    size = np.linalg.norm(columns, axis=0)
    unit = columns / np.where(size > 0, size, 1.0)
    inverse = np.linalg.pinv(unit.T @ unit, rcond=1e-12, hermitian=True) @ unit.T
    value = inverse @ explained
    covariance = (inverse * projection.strata.at_rows(variance)) @ inverse.T
    with np.errstate(divide="ignore"):
        # A column that is absorbed in full has no coefficient: its uncertainty is infinite.
        sd = np.where(size > 0, np.sqrt(np.diag(covariance)) / np.where(size > 0, size, 1.0), np.inf)
    return np.where(size > 0, value / np.where(size > 0, size, 1.0), 0.0), sd


def coefficient_subsets(response: Response, kinds: Mapping[str, str]) -> list[np.ndarray]:
    """Return which coefficients to test together: those of each kind of channel, and those of each owner alone.

    An effect on gyros and accelerometers alike is one cause for each kind: tested together, two causes, one in each,
    would appear as one.

    Parameters
    ----------
    kinds : kind of each channel by name.
    """
    owners = [coefficient.owner for coefficient in response.coefficients]
    every = range(len(owners))
    alone = [[i for i in every if owners[i] == owner] for owner in dict.fromkeys(owners)]
    together = [[i for i in every if kinds.get(owners[i], "") == kind] for kind in dict.fromkeys((*kinds.values(), ""))]
    subsets = dict.fromkeys(tuple(places) for places in (*together, *alone) if places)
    return [np.array(places) for places in subsets]


def screen(projection: Projection, responses: Sequence[ProjectedResponse]) -> list[Candidate]:
    """Return every candidate on each kind of channel and on each owner alone, the most significant first."""
    kinds = {channel.name: channel.kind for channel in projection.fitted.model.campaign.channels}
    found = [
        assess(projection, response, chosen)
        for response in responses
        for chosen in coefficient_subsets(response.response, kinds)
    ]
    # One that asks for the wrong sign explains nothing, but was looked at.
    looked = [each for each in found if (each.dof or each.score.cone is not None) and each.plausible]
    return sorted(looked, key=lambda candidate: (candidate.log_p, -candidate.delta_chi2 / max(candidate.dof, 1)))
