"""Sampling that goes on until every quantity deserves the digits asked for (JCGM 101, 7.9.4).

Monte Carlo errors fall with the root of the number of draws, so the errors of what there is say how many draws are
needed.  Draws of a Laplace approximation are independent and made at once; chains are continued from their checkpoint.
"""

import math
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from imubayes.inference.checkpoint import steps_in
from imubayes.inference.ensemble_sampling import Settings
from imubayes.inference.fitted_model import Fit
from imubayes.inference.run_fit import LAPLACE_DRAWS, joint_fit, redrawn
from imubayes.model.bind import Model
from imubayes.qualification.digits import Digits, draws_needed
from imubayes.qualification.posterior_quantities import posterior_quantities, with_combinations
from imubayes.results.estimates import is_constant
from imubayes.results.result import result_of

# Rounds of sampling: the first tells how many draws are needed, the second mostly is the last.
_MOST_ROUNDS = 4
# Draws beyond those that the errors ask for, which are estimates themselves.
_MARGIN = 1.15
# Draws that are made or kept at most: derived quantities of more take minutes and their file a gigabyte.
_MOST_DRAWS = 200_000


def fit_until_digits(
    model: Model,
    sampling: Settings | None,
    digits: Digits,
    checkpoint: Path | None = None,
    resume: bool = False,
    progress: Callable[[str], None] | None = None,
) -> Fit:
    """Fit a model and sample until every quantity deserves so many digits of its standard uncertainty.

    It ends earlier where the fit does not converge or the most draws are reached; a quantity that then deserves fewer
    digits is stated with these, or withheld.

    Parameters
    ----------
    model, sampling, checkpoint, resume, progress : as of `joint_fit`.
    digits : 1 or 2 significant digits.
    """
    tell = progress or (lambda text: None)
    draws = LAPLACE_DRAWS
    with tempfile.TemporaryDirectory() as scratch:
        file = checkpoint or Path(scratch) / "checkpoint.h5"
        sampling = None if sampling is None else replace(sampling, most_kept=_MOST_DRAWS)
        fit = joint_fit(model, sampling, file, resume, progress, laplace_draws=draws)
        for _ in range(_MOST_ROUNDS):
            if not fit.converged:
                break
            lacking, name = draws_lacking(fit, digits)
            if lacking <= 1:
                break
            tell(f"{name}: {lacking:.1f} times the draws for {digits} digits")
            if sampling is None:
                more = min(_MOST_DRAWS, LAPLACE_DRAWS * math.ceil(_MARGIN * lacking * draws / LAPLACE_DRAWS))
                if more == draws:
                    break
                draws = more
                fit = redrawn(fit, draws)
            else:
                steps = steps_in(file)
                if steps < sampling.least_steps:  # memory allows no more
                    break
                sampling = replace(sampling, least_steps=math.ceil(_MARGIN * lacking * steps))
                fit = joint_fit(model, sampling, file, True, progress)
    return fit


def draws_lacking(fit: Fit, digits: Digits) -> tuple[float, str]:
    """Return how many times the draws are needed for all quantities to deserve so many digits, and which needs most."""
    result = result_of(fit)
    quantities = with_combinations(posterior_quantities(result), result.summary.combinations)
    worst, worst_name = 0.0, ""
    for name, draws in quantities.draws.items():
        if is_constant(draws):
            continue
        factor = draws_needed(quantities.marginal(name), digits)
        if factor > worst:
            worst, worst_name = factor, name
    return worst, worst_name
