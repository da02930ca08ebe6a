"""The evidence of a fit: a search, and another about its leader if that is large.

A large effect acts by its curvature and by its products with other parameters as well, which the linear model leaves
over and which look like further effects and forms; so does a gross error of the record.  The campaign is linearised
anew if the leader puts parameters, coefficients and record, at the price of one evaluation, and searched again,
three times at most (Gauss–Newton steps).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from imubayes.adequacy.weighed_records import weighed_records
from imubayes.criticism.evidence.hypothesis_evidence import Evaluated
from imubayes.criticism.evidence.linear_problem import LinearProblem, linear_problem
from imubayes.criticism.evidence.model_search import ModelSearch, beyond_prior, states_noise
from imubayes.criticism.evidence.possible_forms import possible_forms
from imubayes.criticism.evidence.posterior_summary import ExplanationPosterior
from imubayes.criticism.evidence.wrong_input_forms import wrong_inputs
from imubayes.criticism.explanation_records import NEAR
from imubayes.foundations.campaign_data import Campaign
from imubayes.inference.fitted_model import Fit
from imubayes.responses.candidate_effects import LinearisationPoint, Responses, candidate_responses
from imubayes.responses.residual_covariates import ResidualCovariate
from imubayes.responses.wrong_inputs import Predictions, WrongInput, acts_through_the_model, problem_of

GROSS = 500.0
"""Nats of an effect above which the campaign is linearised anew about it.  Derived: if it stands out of the noise by
thirty standard deviations, a curvature of a tenth of it does by three."""
_NEAR, _ROUNDS = 0.1, 3
"""Relative change of a coefficient, or change of z, within which a linearisation stands; how often it is made anew."""


@dataclass(frozen=True)
class _About:
    """Where a campaign is linearised: at a fit, coefficients off their nulls, and a record that was corrected.

    Attributes
    ----------
    wrong, size : what was added to the record, (d,); None for the record as it is.
    """

    fitted: Fit
    point: LinearisationPoint = field(default_factory=LinearisationPoint)
    wrong: WrongInput | None = None
    size: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def stands_for(self, other: "_About") -> bool:
        """Return whether this linearisation serves the other; about no mode, parameters lead on as well."""
        before, now = ({**each.point.values, **_flat(each.point)} for each in (self, other))
        same = before.keys() == now.keys() and self.wrong == other.wrong
        pairs = [*((x, now.get(name, 0.0)) for name, x in before.items()), *zip(self.size, other.size, strict=False)]
        here = self.fitted.optimised or float(np.max(np.abs(other.fitted.z - self.fitted.z), initial=0.0)) <= _NEAR
        return here and same and all(abs(new - old) <= _NEAR * abs(old) for old, new in pairs)


def _flat(point: LinearisationPoint) -> dict[str, float]:
    """Return the shapes of a point by effect and field."""
    return {f"{effect}.{name}": x for effect, shape in point.shapes.items() for name, x in shape.items()}


def explain(
    fitted: Fit,
    responses: Responses,
    covariates: Sequence[ResidualCovariate],
    heard: Callable[[ModelSearch], None] = lambda _: None,
) -> ExplanationPosterior:
    """Return how probable each explanation of what a fit leaves is.

    Of a fit that did not converge it is that of where it stopped: its linear model leads on from there.
    `heard` is called with the search at work after each hypothesis.
    """
    about, problem = _About(fitted), linear_problem(fitted, responses)
    first = search = ModelSearch(problem, heard)
    if _is_large(search, search.large_effects):
        large = _moved(search, about, search.large_effects, fitted)
        moved = _linearised(problem, large) if large is not None else None
        if large is not None and moved is not None:
            about, search = large, search.about(moved)
    recorded = fitted.model.campaign
    begun = _run(search, about, recorded, covariates), about
    corrected = _corrected(first, fitted, covariates)
    gross = _gross_input if corrected is None else _gross_row
    leads = (_leader, gross, _wide_prior) if fitted.optimised else (_leader,)
    found = [_followed(*begun, fitted, covariates, lead) for lead in leads]
    best = max(found, key=_support)
    # The size of a record that was weighed is settled, that of one which leads on to within a tenth.
    if corrected is not None and _support(corrected) > _support(best) - NEAR:
        best = corrected
    search, about = best
    return ExplanationPosterior(search, about.fitted)


def _support(found: tuple[ModelSearch, _About]) -> float:
    """Return the log posterior of a search; of those that explain as much, that about a corrected record is preferred.

    The size of a wrong record has errors of second order elsewhere.
    """
    return found[0].best().log_posterior + (NEAR if found[1].wrong is not None else 0.0)


def _corrected(
    search: ModelSearch, fitted: Fit, covariates: Sequence[ResidualCovariate]
) -> tuple[ModelSearch, _About] | None:
    """Return a search about the most probable error of the record, corrected; None if none acts through the model.

    A gross one distorts the fit, so that its linear response about the fit does not lead to it.
    """
    # About a fit that failed outputs are corrected as well: nothing leads from there to a gross error.
    acting = (
        each for each in weighed_records(fitted)
        if acts_through_the_model(each.wrong) or not (fitted.optimised or each.wrong.form in ("unit", "samples"))
    )  # fmt: skip
    best = next(acting, None)
    if best is None:
        return None
    about = _about(fitted, best.wrong, best.size, best.z, LinearisationPoint())
    moved = _linearised(search.of.problem, about) if about is not None else None
    if about is None or moved is None:
        return None
    return _run(search.about(moved), about, fitted.model.campaign, covariates), about


def _followed(
    search: ModelSearch,
    about: _About,
    fitted: Fit,
    covariates: Sequence[ResidualCovariate],
    lead: Callable[[ModelSearch, Fit], Evaluated | None],
) -> tuple[ModelSearch, _About]:
    """Return the most probable of the linearisations that lead from one to the next; about no mode the last."""
    best = search, about
    for _ in range(_ROUNDS):
        leading = lead(search, fitted)
        moved = _moved(search, about, leading, fitted) if leading is not None else None
        if moved is None or about.stands_for(moved):
            break
        problem = _linearised(search.of.problem, moved)
        if problem is None:
            break
        about, search = moved, _run(search.about(problem), moved, fitted.model.campaign, covariates)
        best = max(best, (search, about), key=_support) if fitted.optimised else (search, about)
    return best


def _run(
    search: ModelSearch, about: _About, recorded: Campaign, covariates: Sequence[ResidualCovariate]
) -> ModelSearch:
    problem = search.of.problem
    wrong = wrong_inputs(problem, about.fitted, recorded)
    return search.run((*possible_forms(problem, covariates), *wrong.of_runs), wrong.of_rows)


def _leader(search: ModelSearch, fitted: Fit) -> Evaluated | None:
    """Return the most probable hypothesis if its effects are large, or there is no mode: a linearisation about it."""
    top = search.best()
    return top if not fitted.optimised or _is_large(search, top) else None


def _gross_input(search: ModelSearch, fitted: Fit) -> Evaluated | None:
    """Return the most probable wrong input that acts through the model if one of any kind leads, or it is gross.

    What its curvature leaves excludes it as long as it is not corrected, so that it need not lead.
    """
    wrong = max(filter(_is_input, search.known), key=lambda each: each.log_posterior, default=None)
    if wrong is None or wrong is _leader(search, fitted):
        return None
    gross = wrong.log_posterior > search.best(states_noise).log_posterior + GROSS
    leading = search.best().hypothesis.form
    return wrong if gross or (leading is not None and leading.form.wrong is not None) else None


def _gross_row(search: ModelSearch, fitted: Fit) -> Evaluated | None:
    """Return the most probable wrong input if it is gross and in one row: those of runs were corrected before."""
    found = _gross_input(search, fitted)
    form = found.hypothesis.form if found is not None else None
    return found if form is not None and form.form.row is not None else None


def _wide_prior(search: ModelSearch, fitted: Fit) -> Evaluated | None:
    """Return the most probable prior that is too narrow if it is gross: the effects that it forbids act from there."""
    found = max(filter(beyond_prior, search.known), key=lambda each: each.log_posterior, default=None)
    if found is None or found is _leader(search, fitted):
        return None
    return found if found.log_posterior > search.best(states_noise).log_posterior + GROSS else None


def _is_large(search: ModelSearch, top: Evaluated) -> bool:
    without = [search.of.evaluate(top.hypothesis.without(each), top) for each in top.hypothesis.variants]
    return max((top.log_posterior - each.log_posterior for each in without), default=0.0) > GROSS


def _is_input(each: Evaluated) -> bool:
    """Return whether a hypothesis is a wrong input that acts through the model."""
    form = each.hypothesis.form
    return form is not None and form.form.wrong is not None and acts_through_the_model(form.form.wrong)


def _moved(search: ModelSearch, about: _About, top: Evaluated, recorded: Fit) -> _About | None:
    """Return the linearisation about a hypothesis; None if the record cannot be corrected so."""
    z = about.fitted.z + top.mean[: search.of.problem.own]
    point, form = _point(search, top), top.hypothesis.form
    if not np.isfinite(z).all():
        return None
    if form is not None and form.form.wrong is not None and form.form.wrong.form == "prior":
        z = z.copy()
        z[list(form.form.wrong.parameters)] += top.mean[len(top.columns) :]
    if form is None or form.form.wrong is None or form.form.wrong.form in ("unit", "prior"):
        return _About(replace(recorded, z=z), point)
    return _about(recorded, form.form.wrong, top.mean[len(top.columns) :] * form.form.unit, z, point)


def _about(
    recorded: Fit, wrong: WrongInput, size: np.ndarray, z: np.ndarray, point: LinearisationPoint
) -> _About | None:
    """Return the linearisation about a corrected record; None if it cannot be corrected so."""
    campaign = recorded.model.campaign
    if not wrong.possible(size):
        return None
    corrected = wrong.corrected(campaign, size)
    problem = problem_of(recorded.model, corrected)
    if problem is None:
        return None
    model = replace(recorded.model, campaign=corrected, problem=problem)
    return _About(replace(recorded, model=model, z=z), point, wrong, size)


def _linearised(problem: LinearProblem, about: _About) -> LinearProblem | None:
    """Return the problem linearised anew; None if the model is not defined there.

    Coefficients and what is added to the record stay measured from zero, if their priors are centred.
    """
    responses = candidate_responses(about.fitted, about=about.point)
    if not np.isfinite(responses.misfit).all():
        return None
    columns: dict[str, np.ndarray] = {}
    for each in responses.candidates:
        if dict(each.scan.shape) == dict(about.point.shapes.get(each.scan.effect, {})):
            columns |= {c.parameter.name: x for c, x in zip(each.coefficients, each.columns.T, strict=True)}
    nulls = {each.parameter.name: each.null / each.parameter.factor for each in problem.coefficients}
    moved = {name: value - nulls[name] for name, value in about.point.values.items() if name in columns}
    restored = responses.misfit + sum(columns[name] * size for name, size in moved.items())
    if about.wrong is not None:
        predictions = Predictions(about.fitted.model, about.fitted.z)
        response = predictions.response(about.wrong, about.fitted.model.campaign)
        if response is None or not np.isfinite(response).all():
            return None
        restored = restored + response @ about.size
    return linear_problem(about.fitted, replace(responses, misfit=restored))


def _point(search: ModelSearch, top: Evaluated) -> LinearisationPoint:
    """Return where a hypothesis puts its coefficients."""
    of = search.of
    values: dict[str, float] = {}
    shapes: dict[str, dict[str, float]] = {}
    for variant in (of.variants[n] for n in top.hypothesis.variants):
        shape = of.problem.candidates[variant.response].scan.shape
        if shape:
            shapes[variant.effect] = dict(shape)
        for k, mean in zip(variant.places, top.mean[of.among(top, variant.places)], strict=True):
            one = of.problem.coefficients[k]
            size = float(mean * of.problem.sizes[k])
            values[one.parameter.name] = one.null / one.parameter.factor + size
    return LinearisationPoint(values, shapes)
