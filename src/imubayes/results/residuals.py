"""Residuals of a fit in output and input units, with every covariate: what compare and criticism look at."""

import jax.numpy as jnp
import numpy as np
import polars as pl

from imubayes.campaign_data import INPUT_UNIT
from imubayes.covariates import shown
from imubayes.inference.fitted_model import Fit
from imubayes.inference.nested_laplace import posterior_precision
from imubayes.kept_programs import kept
from imubayes.model.noise_covariance import noise_deviation, whiten, whitener
from imubayes.model.problem import Problem
from imubayes.model.robust_likelihood import pseudo_values
from imubayes.results.residual_table import Residuals
from imubayes.units import to_si

@kept
def _at_mode(problem: Problem, mode):
    """Return prediction, its standard deviation, the noise's and the whitened residual, each (E,)."""
    by = whitener(problem, mode.h)
    whitened = whiten(problem, by, pseudo_values(problem, mode.h, mode.about.misfit))
    spread = jnp.linalg.solve(jnp.linalg.cholesky(posterior_precision(problem, mode)), mode.about.jacobian.T)
    predicted = problem.observations.value - mode.about.misfit
    return predicted, jnp.sqrt(jnp.sum(spread**2, axis=0)), noise_deviation(problem, by), whitened


def residuals_of(fit: Fit) -> Residuals:
    """Return the residuals of a fit made in this process, at its mode."""
    assert fit.mode is not None, "a fit read from a folder has its residuals there"
    model, campaign, entries = fit.model, fit.model.campaign, fit.model.entries
    predicted, model_sd, sd, whitened = (np.asarray(part) for part in _at_mode(model.problem, fit.mode))
    channels = campaign.channels
    closing = np.asarray(entries.closing)
    place = np.where(closing, 0, entries.channel)
    names = np.array([*(c.name for c in channels), "closure_x", "closure_y", "closure_z"])[entries.channel]
    kind = np.where(closing, "closure", np.array([c.kind for c in channels])[place])
    output_unit = np.where(closing, "deg", np.array([c.output_unit for c in channels])[place])
    input_unit = np.where(closing, "deg", np.array([INPUT_UNIT[c.kind] for c in channels])[place])
    per_output = np.array([1 / (c.scale_si * to_si(INPUT_UNIT[c.kind], campaign.site.gravity)) for c in channels])
    degree = to_si("deg")
    to_output = np.where(closing, 1 / degree, 1.0)
    to_input = np.where(closing, 1 / degree, per_output[place])
    offset = np.where(closing, 0.0, np.array([c.offset for c in channels])[place])
    residual = entries.value - predicted
    # The angle of a table that a gyro drives is an output, and is shown on the scale of the table as well.
    zeros = np.array([campaign.tables[run.table].zero_angle if run.table else 0.0 for run in campaign.runs])
    reading = np.where(kind == "angle", np.degrees(zeros)[entries.run], 0.0)
    table = {
        "run": np.array([run.name for run in campaign.runs])[entries.run],
        "procedure": np.array([run.procedure for run in campaign.runs])[entries.run],
        "mounting": pl.Series([run.mounting for run in campaign.runs], dtype=pl.String).gather(entries.run),
        "row": entries.row,
        "channel": names,
        "kind": kind,
        **_covariates(fit),
        "samples": entries.samples,
        "observed": entries.value * to_output + reading,
        "predicted": predicted * to_output + reading,
        "sd": sd * to_output,
        "model_sd": model_sd * to_output,
        "residual": residual * to_output,
        "output_unit": output_unit,
        "input_observed": (entries.value - offset) * to_input,
        "input_residual": residual * to_input,
        "input_sd": sd * np.abs(to_input),
        "input_unit": input_unit,
        "whitened": whitened,
    }
    return Residuals(pl.DataFrame(table))


def _covariates(fit: Fit) -> dict[str, pl.Series]:
    """Return each covariate per entry as it was read; null where a run lacks it and for closing rotations."""
    campaign, entries = fit.model.campaign, fit.model.entries
    found = {}
    for covariate in shown():
        name, column = covariate.name, covariate.column
        values, known = np.zeros(len(entries)), np.zeros(len(entries), dtype=bool)
        for index, run in enumerate(campaign.runs):
            chosen = (entries.run == index) & ~entries.closing
            if name in run.covariates and (run.table is not None or not name.startswith("table_")):
                read = campaign.as_read(run, name) / covariate.factor(campaign.site.gravity)
                values[chosen] = read[entries.row[chosen]]
                known[chosen] = True
        found[column] = pl.Series(column, [v if k else None for v, k in zip(values, known, strict=True)], pl.Float64)
    return found
