"""The combinations that the data determine although they do not determine their members, with their estimates."""

from dataclasses import dataclass

import numpy as np

from imubayes.inference.determined_combinations import (
    DeterminedCombination,
    Draws,
    combined,
    determined_combinations,
    members,
)
from imubayes.inference.fitted_model import Fit
from imubayes.inference.identifiability import from_data
from imubayes.inference.posterior_groups import in_units
from imubayes.json_record import finite
from imubayes.procedures.classical import declared_combinations
from imubayes.procedures.estimable_functions import written
from imubayes.results.estimates import estimated
from imubayes.results.summary import CombinationSummary


@dataclass(frozen=True)
class EstimatedCombination:
    """A determined combination with draws of its posterior and of its prior, (S,) each, in its unit."""

    summary: CombinationSummary
    posterior: np.ndarray
    prior: np.ndarray


def combinations(fit: Fit, precision: np.ndarray | None) -> tuple[EstimatedCombination, ...]:
    """Return the determined combinations of a fit, those with a standard symbol first.

    Parameters
    ----------
    precision : shape (P, P), posterior precision of the parameters in z; None where the fit did not converge.
    """
    posterior, layout = fit.posterior, fit.model.layout
    if posterior is None or precision is None:
        return ()
    candidates = members(precision) & ~np.array([parameter.nuisance for parameter in layout.parameters], dtype=bool)
    size, names = len(layout), tuple(quantity.name for quantity in fit.derived.names)
    units = tuple(quantity.unit for quantity in fit.derived.names)
    own = tuple(parameter.unit for parameter in layout.parameters)
    scales = np.zeros((len(posterior.prior_points), len(fit.h)))
    after = in_units(fit.model, posterior.points)[:, :size]
    before = in_units(fit.model, np.concatenate([posterior.prior_points, scales], axis=1))[:, :size]
    parameters, derived = Draws(layout.names, own, after), Draws(names, units, posterior.derived)
    prior = Draws(layout.names, own, before), Draws(names, units, posterior.prior_derived)
    standard = declared_combinations(fit.model.campaign)
    made = []
    for found in determined_combinations(parameters, candidates, derived, standard):
        draws, before = _values(found, parameters, derived), _values(found, *prior)
        made.append(EstimatedCombination(_summary(found, draws, before), draws, before))
    return tuple(made)


def _values(found: DeterminedCombination, parameters: Draws, derived: Draws) -> np.ndarray:
    """Return draws of a combination, (S,)."""
    of = derived if found.weights is None else parameters
    members = [of.values[:, of.names.index(name)] for name in found.quantities]
    return combined(found.weights, found.constant, members)


def _summary(found: DeterminedCombination, draws: np.ndarray, prior: np.ndarray) -> CombinationSummary:
    weights = found.weights
    formula = "" if weights is None else written(weights, found.quantities)
    return CombinationSummary(
        name=found.symbol or formula,
        unit=found.unit,
        prior_sd=finite(float(prior.std())),
        from_data=float(from_data(float(np.var(draws)), float(np.var(prior)))),
        standard=bool(found.symbol),
        quantities=found.quantities,
        weights=weights,
        constant=found.constant,
        middle_of=found.middle_of,
        **estimated(draws).model_dump(),
    )
