"""The quantities of a result with their posterior draws, and sampling until they deserve the digits asked for.

Conformity, digits and budget are computed from these quantities.  Sampling goes on until every quantity deserves so
many digits (JCGM 101, 7.9.4).  Monte Carlo errors fall with the root of the number of draws, so the errors of what
there is say how many draws are needed.  Draws of a Laplace approximation are independent and made at once; chains are
continued from their checkpoint.
"""

import math
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from imubayes.foundations.errors import input_error
from imubayes.inference.chains import Settings
from imubayes.inference.checkpoint import steps_in
from imubayes.inference.determined_combinations import combined
from imubayes.inference.fitted_model import Fit
from imubayes.inference.run_fit import LAPLACE_DRAWS, joint_fit, redrawn
from imubayes.model.bind import Model
from imubayes.results.marginal import Digits, Marginal, draws_needed
from imubayes.results.result import Result, result_of
from imubayes.results.standard_uncertainties import effective_size, least_effective
from imubayes.results.summary import CombinationSummary, ParameterSummary, Quantity, is_constant


@dataclass(frozen=True)
class PosteriorQuantities:
    """Quantities with draws.

    Attributes
    ----------
    entries : name → line of the summary, parameters first; nuisance parameters are left out.
    draws : name → shape (S,); NaN in draws for which a derived quantity was not computed.
    effective : name → effective number of the draws that are finite.
    """

    entries: Mapping[str, Quantity]
    draws: Mapping[str, np.ndarray]
    effective: Mapping[str, float]

    def marginal(self, name: str) -> Marginal:
        """Return the finite draws of a quantity."""
        values = self.draws[name]
        return Marginal(values[np.isfinite(values)], self.effective[name])


def posterior_quantities(result: Result) -> PosteriorQuantities:
    """Return the quantities of a result that have draws.

    Raises
    ------
    InputError
        if the result has no draws, because the fit did not converge.
    """
    summary = result.summary
    if not summary.converged:
        where = str(result.folder) if result.folder is not None else "this fit"
        raise input_error("there are no posterior draws", where, "a fit that converged", summary.message)
    lines = (*summary.parameters, *summary.derived)
    entries = {line.name: line for line in lines if not (isinstance(line, ParameterSummary) and line.nuisance)}
    draws = {name: result.draws[name] for name in entries if name in result.draws}
    least = least_effective(summary.parameters)
    sizes = {name: effective_size(entries[name], draws[name], least) for name in draws}
    return PosteriorQuantities({name: entries[name] for name in draws}, draws, sizes)


def with_combinations(known: PosteriorQuantities, combinations: Sequence[CombinationSummary]) -> PosteriorQuantities:
    """Return quantities with determined combinations of them; those with a member that has no draws are left out."""
    entries, draws, effective = dict(known.entries), dict(known.draws), dict(known.effective)
    for found in combinations:
        if not set(found.quantities) <= known.draws.keys():
            continue
        entries[found.name] = found
        members = [known.draws[name] for name in found.quantities]
        draws[found.name] = combined(found.weights, found.constant, members)
        effective[found.name] = min(known.effective[name] for name in found.quantities)
    return PosteriorQuantities(entries, draws, effective)


# Rounds of sampling: the first shows how many draws are needed, the second mostly is the last.
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
    """Fit a model and sample until the draws support so many digits of the standard uncertainty of every quantity.

    It ends earlier if the fit does not converge or the most draws are reached; a quantity that then deserves fewer
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
            tell(f"{name} needs {lacking:.1f} times as many draws for {digits} digits")
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
        marginal = quantities.marginal(name)
        factor = draws_needed(marginal.errors, marginal.sd, digits)
        if factor > worst:
            worst, worst_name = factor, name
    return worst, worst_name
