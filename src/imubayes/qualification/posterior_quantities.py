"""The quantities of a result with their posterior draws: what conformity, digits and budget are computed from."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.errors import InputError, Issue
from imubayes.inference.determined_combinations import combined
from imubayes.qualification.marginal import Marginal
from imubayes.results.result import Result
from imubayes.results.summary import CombinationSummary, ParameterSummary, Quantity


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
        where the result has no draws, because the fit did not converge.
    """
    summary = result.summary
    if not summary.converged:
        where = str(result.folder) if result.folder is not None else "this fit"
        raise InputError(Issue("there are no posterior draws", where, "a fit that converged", summary.message))
    lines = (*summary.parameters, *summary.derived)
    entries = {line.name: line for line in lines if not (isinstance(line, ParameterSummary) and line.nuisance)}
    draws = {name: result.draws[name] for name in entries if name in result.draws}
    least = min((_sampled_size(line) for line in summary.parameters), default=math.inf)
    sizes = {name: _effective(entries[name], draws[name], least) for name in draws}
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


def slopes(found: CombinationSummary, members: Sequence[np.ndarray]) -> tuple[float, ...]:
    """Return the derivatives of a combination by its members, at the means of their draws."""
    if found.weights is not None:
        return found.weights
    scale, angle = (float(np.nanmean(each)) for each in members)
    return float(np.cos(np.radians(angle))), float(-scale * np.sin(np.radians(angle)) * np.pi / 180)


def _sampled_size(line: ParameterSummary) -> float:
    """Return the smaller effective size of a parameter; infinite for independent draws."""
    return min((size for size in (line.ess_bulk, line.ess_tail) if size is not None), default=math.inf)


def _effective(line: Quantity, draws: np.ndarray, least: float) -> float:
    """Return the effective number of draws.

    A derived quantity is computed for some of the draws, so that its error has two parts: that of all draws, which is
    taken from the parameter sampled worst, and that of the selection.
    """
    own = _sampled_size(line) if isinstance(line, ParameterSummary) else least
    finite = int(np.isfinite(draws).sum())
    if finite == len(draws):
        return float(min(own, finite))
    return 1 / (1 / own + 1 / finite)
