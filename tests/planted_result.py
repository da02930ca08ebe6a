"""Results of units whose parameters are known, without a fit: for what is made of results."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from imubayes.inference.fitted_model import Fit
from imubayes.model.bind import Model
from imubayes.model.problem import predict
from imubayes.results.result import Result
from imubayes.results.stored_tables import Residuals
from imubayes.results.summary import ParameterSummary, Summary


def planted(
    model: Model, z: np.ndarray, effects: tuple[str, ...] = (), sd: float = 0.0, like: Fit | None = None
) -> Result:
    """Return the result of a model at z, with the readings that it predicts as data and independent posteriors.

    Parameters
    ----------
    effects : the ones that the unit has; all if none is named.  The others are to be at their nulls.
    sd : posterior standard deviation over the one of the prior.
    like : a fit of the same model, of which the derived quantities are taken.
    """
    runs = [replace(run, observed=np.full_like(run.observed, np.nan)) for run in model.campaign.runs]
    entries, predicted = model.entries, np.asarray(predict(model.problem, jnp.asarray(z)))
    for value, run, row, channel, closing in zip(
        predicted, entries.run, entries.row, entries.channel, entries.closing, strict=True
    ):
        if not closing:
            runs[run].observed[row, channel] = value
    kept = tuple(each for each in model.assembly.effects if not effects or each.name in effects)
    changed = replace(
        model,
        campaign=replace(model.campaign, runs=tuple(runs)),
        assembly=replace(model.assembly, effects=kept),
    )
    rng = np.random.default_rng(11)
    scatter = np.concatenate([np.zeros((1, len(z))), sd * rng.normal(size=(50 if sd else 1, len(z)))])
    fit = Fit(changed, z, np.zeros(len(model.hyper_layout)), True)
    if like is not None:
        fit.__dict__["derived"] = like.derived
    layout = model.layout
    draws = np.stack([np.asarray(model.problem.priors.values(z + shift)) for shift in scatter]) / layout.factors()
    own = [
        ParameterSummary(name=name, unit=p.unit, mean=float(column.mean()), sd=float(column.std()))
        for name, p, column in zip(layout.names, layout.parameters, draws.T, strict=True)
    ]
    scales = np.asarray(model.problem.hyper_priors.values(fit.h)) / model.hyper_layout.factors()
    own += [
        ParameterSummary(name=p.name, unit=p.unit, mean=float(value), sd=0.0)
        for p, value in zip(model.hyper_layout.parameters, scales, strict=True)
    ]
    summary = Summary.model_construct(parameters=tuple(own), derived=(), converged=True)
    result = Result(summary, Residuals.__new__(Residuals), None, _fit=fit)
    result.__dict__["draws"] = dict(zip(layout.names, draws.T, strict=True))
    return result
