"""Scores of all candidate effects in one fit, in a form that can be added over units.

With r the whitened residual and g⊥ the whitened response to the coefficients of a candidate, less what the
parameters of the model absorb, the score U = g⊥ᵀr and the information I = g⊥ᵀg⊥ are all that is needed of a unit: U
and I of a coefficient that units share are sums over the units.  All coefficients of all candidates stand in one U
and one I, so that candidates can be compared with and cleared of each other.

Priors give no evidence here.  A population that its prior does not expect would speak for an effect in every unit,
and over a hundred units loudly: what the parameters absorb is projected out as if their priors were flat.

Each unit has its own noise scale, estimated from its residuals once the candidate is projected out.  Its F test is
turned into the χ² of the same p-value, so that sums over units have the distribution that they should have;
`factor` is the ratio of that χ² to UᵀI⁻¹U.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import polars as pl

from imubayes.batch.posterior_table import packed
from imubayes.criticism import thresholds
from imubayes.criticism.candidate_effects import Response, candidate_responses
from imubayes.criticism.projection import Projection, project
from imubayes.criticism.score_test import ProjectedResponse, coefficient_subsets, project_responses, score_test
from imubayes.inference.fitted_model import Fit
from imubayes.tail_probabilities import chi2_at

# Singular values of the model's Jacobian, relative to the largest, below which a direction is rounding.
_RANK = 1e-10

SCORES = pl.Schema(
    {
        "digest": pl.String, "unit": pl.String, "effect": pl.String, "shape": pl.String, "scope": pl.String,
        "coefficients": pl.List(pl.String), "measures": pl.List(pl.String), "signs": pl.List(pl.Int8),
        "dof": pl.Int64, "chi2": pl.Float64, "p": pl.Float64, "factor": pl.Float64,
        "score": pl.List(pl.Float64), "information": pl.List(pl.Float64),
    }
)  # fmt: skip
"""One row per campaign and candidate; one more per campaign, without an effect, with score and information of all
coefficients, the information as lower triangle, at the noise scale of the fit."""


@dataclass(frozen=True)
class CandidateScore:
    """The test of one candidate in one unit.

    Attributes
    ----------
    effect, shape : the candidate, and the values of its shape parameters as text; empty where it has none.
    scope : the kind of channel whose coefficients are tested together, or the owner of the coefficients.
    coefficients, measures, signs : C of them: names, units of measure, and the only sign allowed, 0 for either.
    dof : directions that could be resolved.
    chi2, p : calibrated χ², and its p-value; of either sign.
    factor : ratio of `chi2` to UᵀI⁻¹U.
    """

    effect: str
    shape: str
    scope: str
    coefficients: tuple[str, ...]
    measures: tuple[str, ...]
    signs: tuple[int, ...]
    dof: int
    chi2: float
    p: float
    factor: float


@dataclass(frozen=True)
class UnitScores:
    """All candidates of one unit.

    Attributes
    ----------
    candidates : their tests.
    names : C coefficients of all candidates and shapes.
    score, information : shapes (C,) and (C, C), at the noise scale of the fit.
    """

    candidates: tuple[CandidateScore, ...]
    names: tuple[str, ...]
    score: np.ndarray
    information: np.ndarray


def unit_scores(fit: Fit) -> UnitScores:
    """Return the scores of every candidate effect of a converged fit."""
    responses = candidate_responses(fit)
    projection = without_priors(project(fit, responses.misfit, responses.jacobian))
    projected = [_retained(each) for each in project_responses(projection, responses.candidates)]
    projected = [each for each in projected if each.response.coefficients]
    kinds = {channel.name: channel.kind for channel in fit.model.campaign.channels}
    tests = tuple(test for each in projected for test in _tests(projection, each, kinds))
    columns = np.concatenate([np.zeros((len(projection.residual), 0)), *(each.projected for each in projected)], axis=1)
    names = tuple(name for each in projected for name in _names(each.response))
    return UnitScores(tests, names, columns.T @ projection.residual, columns.T @ columns)


def without_priors(projection: Projection) -> Projection:
    """Return the projection in which the priors neither hold parameters back nor give evidence."""
    priors = projection.turn.priors
    rows = len(projection.residual) - priors
    jacobian = projection.jacobian[:rows]
    size = np.linalg.norm(jacobian, axis=0)
    left, singular, _ = np.linalg.svd(jacobian / np.where(size > 0, size, 1.0), full_matrices=False)
    span = left[:, singular > _RANK * singular.max(initial=0.0)]
    basis = np.zeros((rows + priors, span.shape[1] + priors))
    basis[:rows, : span.shape[1]] = span
    basis[rows:, span.shape[1] :] = np.eye(priors)
    residual = projection.residual - basis @ (basis.T @ projection.residual)
    used = np.concatenate([np.asarray(projection.fitted.model.problem.observations.weight) > 0, np.ones(priors, bool)])
    freedom = projection.strata.sums(used.astype(float)) - projection.strata.sums(np.sum(basis**2, axis=1))
    return replace(projection, basis=basis, residual=residual, freedom=freedom)


def _retained(each: ProjectedResponse) -> ProjectedResponse:
    """Return a response without the coefficients that the model absorbs in full."""
    whole, left = (np.sum(columns**2, axis=0) for columns in (each.whitened, each.projected))
    kept = np.flatnonzero(left > thresholds.FORM_RETAINED_MIN * whole)
    response = each.response
    coefficients = tuple(response.coefficients[place] for place in kept)
    fewer = replace(response, coefficients=coefficients, columns=response.columns[:, kept])
    return ProjectedResponse(fewer, each.whitened[:, kept], each.projected[:, kept])


def _shape(response: Response) -> str:
    return ", ".join(f"{name}={value:g}" for name, value in response.scan.shape.items())


def _names(response: Response) -> list[str]:
    shape = _shape(response)
    return [f"{each.parameter.name}{f' at {shape}' if shape else ''}" for each in response.coefficients]


def _tests(projection: Projection, each: ProjectedResponse, kinds: dict[str, str]) -> Iterator[CandidateScore]:
    """Yield the tests of a candidate on each kind of channel and on each owner alone."""
    response, names = each.response, _names(each.response)
    for chosen in coefficient_subsets(response, kinds):
        columns = each.projected[:, chosen]
        # The directions that are left are those of the whitened columns: what was absorbed counts as annihilated.
        length = np.linalg.norm(each.whitened[:, chosen], axis=0)
        test = score_test(projection, columns, length, thresholds.FORM_RETAINED_MIN)
        count = test.span.shape[1]
        if not count or test.delta_chi2_at_fit <= 0:
            continue
        chi2 = chi2_at(test.log_p, count)
        coefficients = [response.coefficients[place] for place in chosen]
        owners = {coefficient.owner for coefficient in coefficients}
        of_kind = {kinds.get(owner, "") for owner in owners}
        alone = len(owners) == 1 and len(owners) < len({c.owner for c in response.coefficients})
        yield CandidateScore(
            effect=response.scan.effect,
            shape=_shape(response),
            scope=min(owners) if alone else min(of_kind),
            coefficients=tuple(names[place] for place in chosen),
            measures=tuple(coefficient.parameter.unit for coefficient in coefficients),
            signs=tuple(coefficient.sign for coefficient in coefficients),
            dof=count,
            chi2=chi2,
            p=test.p,
            factor=chi2 / test.delta_chi2_at_fit,
        )


def score_table(unit: str, digest: str, scores: UnitScores) -> pl.DataFrame:
    """Return the scores of a unit as a table, schema `SCORES`."""
    rows = [
        {
            "digest": digest, "unit": unit, "effect": each.effect, "shape": each.shape, "scope": each.scope,
            "coefficients": list(each.coefficients), "measures": list(each.measures), "signs": list(each.signs),
            "dof": each.dof, "chi2": each.chi2, "p": each.p, "factor": each.factor,
        }
        for each in scores.candidates
    ]  # fmt: skip
    together = {
        "digest": digest, "unit": unit, "coefficients": list(scores.names), "score": scores.score.tolist(),
        "information": packed(scores.information),
    }  # fmt: skip
    return pl.DataFrame([*rows, together], schema=SCORES)
