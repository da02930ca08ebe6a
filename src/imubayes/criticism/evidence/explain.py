"""The evidence of a fit: a search, and another about its leader where that is large.

A large effect acts by its curvature and by its products with other parameters as well, which the linear model leaves
over and which look like further effects and forms.  The campaign is linearised anew where the leader puts parameters
and coefficients, at the price of one evaluation, and searched again (one Gauss–Newton step).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imubayes.criticism.candidate_effects import LinearisationPoint, Responses, candidate_responses
from imubayes.criticism.evidence.evidence_record import Evidence
from imubayes.criticism.evidence.free_forms import free_forms
from imubayes.criticism.evidence.hypothesis import Evaluated
from imubayes.criticism.evidence.linear_problem import LinearProblem, linear_problem
from imubayes.criticism.evidence.model_search import ModelSearch
from imubayes.criticism.evidence.posterior_summary import evidence_of
from imubayes.criticism.evidence.wrong_input_forms import wrong_inputs
from imubayes.criticism.residual_covariates import ResidualCovariate
from imubayes.inference.fitted_model import Fit

LARGE = 500.0
"""Nats of an effect above which the campaign is linearised anew about it.  Derived: where it stands out of the noise by
thirty standard deviations, a curvature of a tenth of it does by three."""
_NEAR, _ROUNDS = 0.1, 2
"""Relative change of a coefficient within which a linearisation stands, and how often it is made anew."""


def explain(fitted: Fit, responses: Responses, covariates: Sequence[ResidualCovariate]) -> Evidence:
    """Return how probable each explanation of what a converged fit leaves is."""
    search = _searched(fitted, linear_problem(fitted, responses), covariates)
    about = LinearisationPoint()
    for _ in range(_ROUNDS):
        top = _leader(search)
        point = _point(search, top)
        if not _is_large(search, top) or _stands(about, point):
            break
        at = replace(fitted, z=fitted.z + top.mean[: search.of.problem.own])
        moved = _linearised_about(search.of.problem, at, point)
        if moved is None:
            break
        fitted, about, search = at, point, _searched(at, moved, covariates)
    return evidence_of(search)


def _searched(fitted: Fit, problem: LinearProblem, covariates: Sequence[ResidualCovariate]) -> ModelSearch:
    wrong = wrong_inputs(problem, fitted)
    return ModelSearch(problem, (*free_forms(problem, covariates), *wrong.of_runs), wrong.of_rows).run()


def _leader(search: ModelSearch) -> Evaluated:
    """Return the likeliest hypothesis without a form: what a large effect leaves looks like one."""
    return search.best(lambda each: each.hypothesis.form is None)


def _is_large(search: ModelSearch, top: Evaluated) -> bool:
    without = [search.of.known.get(top.hypothesis.without(each)) for each in top.hypothesis.variants]
    return max((top.log_posterior - each.log_posterior for each in without if each is not None), default=0.0) > LARGE


def _stands(before: LinearisationPoint, now: LinearisationPoint) -> bool:
    """Tell whether a linearisation about the former point serves the other."""
    same = before.values.keys() == now.values.keys() and before.shapes == now.shapes
    return same and all(abs(now.values[name] - x) <= _NEAR * abs(x) for name, x in before.values.items())


def _linearised_about(problem: LinearProblem, fitted: Fit, point: LinearisationPoint) -> LinearProblem | None:
    """Return the problem linearised about a fit and coefficients; None where the model is not defined there."""
    if not np.isfinite(fitted.z).all():
        return None
    responses = candidate_responses(fitted, about=point)
    if not np.isfinite(responses.misfit).all():
        return None
    # The coefficients stay measured from their nulls, where their priors are centred.
    columns = {
        c.parameter.name: x for r in responses.candidates for c, x in zip(r.coefficients, r.columns.T, strict=True)
    }
    nulls = {each.parameter.name: each.null / each.parameter.factor for each in problem.coefficients}
    moved = {name: value - nulls[name] for name, value in point.values.items() if name in columns}
    restored = responses.misfit + sum(columns[name] * size for name, size in moved.items())
    return linear_problem(fitted, replace(responses, misfit=restored))


def _point(search: ModelSearch, top: Evaluated) -> LinearisationPoint:
    """Return where a hypothesis puts its coefficients."""
    of = search.of
    at = {int(column) - of.problem.own: n for n, column in enumerate(top.columns)}
    values: dict[str, float] = {}
    shapes: dict[str, dict[str, float]] = {}
    for variant in (of.variants[n] for n in top.hypothesis.variants):
        shape = of.problem.candidates[variant.response].scan.shape
        if shape:
            shapes[variant.effect] = dict(shape)
        for k in variant.places:
            one = of.problem.coefficients[k]
            size = float(top.mean[at[k]] * of.problem.sizes[k])
            values[one.parameter.name] = one.null / one.parameter.factor + size
    return LinearisationPoint(values, shapes)
