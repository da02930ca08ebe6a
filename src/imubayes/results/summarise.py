"""The summary of a fit: every number that is reported, in datasheet units, with what the data contributed to it.

It holds the combinations that the data determine although they do not determine their members, with their estimates.

It names the intervals that rest on the prior of a noise scale which the data do not determine.  Few runs say little of
the scatter between runs.  If their offsets are also those of a parameter, the posterior of that parameter is a mixture
of narrow and wide ones, as the prior of the scatter has it: its tails are far beyond what its standard deviation
suggests, and another prior gives another interval.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from imubayes.adequacy.adequacy_record import KnownNoiseFit, NoiseComparison
from imubayes.adequacy.known_noise import compare_with_known
from imubayes.adequacy.known_noise_fit import fit_at_known_noise
from imubayes.adequacy.noise_tests import NoiseJudgement, judged_noise_in, projected
from imubayes.adequacy.weighed_records import doubted_runs
from imubayes.foundations.quantity_names import DELTA_K, MOUNTING_ANGLE, SCALE_FACTOR, QuantityName, family_of
from imubayes.foundations.records import finite
from imubayes.inference import identifiability
from imubayes.inference.chains import Chains
from imubayes.inference.determined_combinations import (
    DeterminedCombination,
    Draws,
    combined,
    determined_combinations,
    members,
)
from imubayes.inference.experiment_design import next_runs
from imubayes.inference.fitted_model import Fit
from imubayes.inference.nested_laplace import posterior_precision
from imubayes.inference.plausibility import prior_conflicts
from imubayes.inference.posterior_mode import log_evidence
from imubayes.inference.procedure_contributions import QuantityDraws, contributions
from imubayes.model.derived_quantities import DerivedQuantity, derived_jacobian
from imubayes.procedures import declared_combinations
from imubayes.procedures.converter_temperature import THRESHOLD
from imubayes.procedures.fitted_terms import written
from imubayes.responses.uncertain_equipment import uncertain_equipment
from imubayes.results import summary as records
from imubayes.results.fit_file import provenance
from imubayes.results.posterior_groups import in_units
from imubayes.results.standard_uncertainties import EstimatedCombination, standard_uncertainties, with_stated
from imubayes.results.stored_tables import Residuals


def combinations(fit: Fit, precision: np.ndarray | None) -> tuple[EstimatedCombination, ...]:
    """Return the determined combinations of a fit, those with a standard symbol first.

    Parameters
    ----------
    precision : shape (P, P), posterior precision of the parameters in z; None if the fit did not converge.
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


def _summary(found: DeterminedCombination, draws: np.ndarray, prior: np.ndarray) -> records.CombinationSummary:
    weights = found.weights
    formula = "" if weights is None else written(weights, found.quantities)
    return records.CombinationSummary(
        name=found.symbol or formula,
        unit=found.unit,
        prior_sd=finite(float(prior.std())),
        from_data=float(identifiability.from_data(float(np.var(draws)), float(np.var(prior)))),
        standard=bool(found.symbol),
        quantities=found.quantities,
        weights=weights,
        constant=found.constant,
        middle_of=found.middle_of,
        **records.estimated(draws).model_dump(),
    )


# Lowest and highest fifth of the draws of a scale; a standard deviation that changes by less between them is its own.
_FIFTH, _FACTOR = 0.2, 2.0


def prior_scatter(fit: Fit) -> tuple[records.PriorScatter, ...]:
    """Return the noise scales known from their priors alone, with the parameters whose intervals follow them."""
    if fit.posterior is None:
        return ()
    size, points, found = len(fit.z), fit.posterior.points, []
    for place, scale in enumerate(fit.model.hyper_layout.parameters):
        draws = points[:, size + place]
        share = float(identifiability.from_data(float(np.var(draws)), 1.0))
        if share >= identifiability.WEAK_SHARE:
            continue
        order, count = np.argsort(draws), max(int(_FIFTH * len(draws)), 2)
        narrow, wide = (points[rows, :size].std(axis=0) for rows in (order[:count], order[-count:]))
        with np.errstate(divide="ignore", invalid="ignore"):
            factor = np.nan_to_num(wide / narrow, nan=1.0, posinf=1.0)
        chosen = [
            parameter
            for parameter in np.argsort(-factor)
            if factor[parameter] > _FACTOR and not fit.model.layout.parameters[parameter].nuisance
        ]
        if chosen:
            names = tuple(fit.model.layout.names[parameter] for parameter in chosen)
            found.append(
                records.PriorScatter(
                    scale=scale.name, from_data=share, parameters=names, factor=float(factor[chosen[0]])
                )
            )
    return tuple(found)


def summarise(fit: Fit, residuals: Residuals, load_seconds: float = 0.0, seed: int = 0) -> records.Summary:
    """Return the summary of a fit made in this process; `seed` is that of its sampler."""
    model, mode = fit.model, fit.mode
    assert mode is not None, "a fit read from a folder has its summary there"
    usable = fit.posterior is not None
    precision = np.asarray(posterior_precision(model.problem, mode)) if usable else None
    entries = int(np.sum(model.problem.observations.weight))
    dof = entries - (identifiability.effective_parameters(precision) if precision is not None else len(model.layout))
    weak = _weak(fit, precision) if precision is not None else []
    parameters, derived, found = _parameters(fit), _derived(fit), combinations(fit, precision)
    stated = standard_uncertainties(fit, (*parameters, *derived), found)
    shares = {quantity.name: quantity.from_data for quantity in (*derived, *parameters)}
    chains = fit.posterior.chains if fit.posterior is not None else None
    noise, contradicted, known = _noise(fit)
    return records.Summary(
        campaign=model.campaign.name,
        model=model.spec.name,
        provenance=provenance(fit, seed),
        converged=fit.converged,
        message=fit.message,
        implausible=fit.implausible,
        unexplained=fit.unexplained,
        interval="95 % equal-tailed",
        uncertainty="standard deviation of the joint posterior distribution (GUM, type A and B combined)",
        **_sampling(chains),
        intervals_valid=fit.converged and not noise.violations and not contradicted,
        noise_violations=noise.violations,
        noise_suspected=noise.suspected,
        noise_contradicted=contradicted,
        known_noise=known,
        prior_scatter=prior_scatter(fit),
        doubted_runs=doubted_runs(fit),
        left_out=model.left_out,
        exact=uncertain_equipment(fit),
        set_aside=model.spec.set_aside,
        parameters=with_stated(parameters, stated),
        derived=with_stated(derived, stated),
        runs=residuals.by_run_and_channel(),
        chi2=finite(residuals.chi2),
        dof=round(dof, 1),
        log_evidence=log_evidence(mode) if usable else None,
        weak_directions=tuple(weak),
        combinations=with_stated([each.summary for each in found], stated),
        prior_conflicts=prior_conflicts(model, fit.z, precision) if precision is not None else (),
        next_runs=next_runs(fit, weak, shares) if usable else (),
        contributions=_contributions(fit, found, stated),
        notes=(*model.campaign.notes, *(f"{run.name}: {note}" for run in model.campaign.runs for note in run.notes)),
        seconds=records.Seconds(load=load_seconds, **fit.seconds),
    )


def _noise(fit: Fit) -> tuple[NoiseJudgement, tuple[NoiseComparison, ...], KnownNoiseFit | None]:
    """Return how the noise departs from its model, what contradicts the noise known beforehand, and the fit at it."""
    if fit.posterior is None:
        return NoiseJudgement((), ()), (), None
    return (*noise_of(fit), fit_at_known_noise(fit))


def noise_of(fit: Fit) -> tuple[NoiseJudgement, tuple[NoiseComparison, ...]]:
    """Return how the noise of a fit made in this process departs from its model, and what contradicts what is known."""
    at = projected(fit)
    return judged_noise_in(at), compare_with_known(at).contradicted


def _sampling(chains: Chains | None) -> dict[str, Any]:
    """Return what is said of the sampling; nothing was sampled if there are no chains."""
    if chains is None:
        return {"sampled": False, "acceptance": None}
    return {"sampled": True, "acceptance": chains.acceptance, "pareto_k": chains.diagnosis.pareto_k}


def _contributions(
    fit: Fit, found: Sequence[EstimatedCombination], stated: Mapping[str, float]
) -> tuple[identifiability.Contribution, ...]:
    """Return the contribution of each procedure to angles, scale factors and determined combinations."""
    sums = [QuantityDraws(each.summary.name, each.summary.unit, each.posterior, each.prior) for each in found]
    return contributions(fit, sums, stated)


def _parameters(fit: Fit) -> tuple[records.ParameterSummary, ...]:
    """Return one line per parameter; estimates are None if the fit did not converge."""
    parameters = fit.model.layout.parameters + fit.model.hyper_layout.parameters
    fixed: list[dict[str, Any]] = [
        {"name": p.name, "unit": p.unit, "nuisance": p.nuisance, "prior_sd": finite(p.prior_sd)} for p in parameters
    ]
    if fit.posterior is None:
        return tuple(records.ParameterSummary(**line) for line in fixed)
    points = fit.posterior.points
    values = in_units(fit.model, points)
    best = in_units(fit.model, np.concatenate([fit.z, fit.h])[None])[0]
    return tuple(
        records.ParameterSummary(
            **line,
            **records.estimated(values[:, place]).model_dump(),
            map=float(best[place]),
            # In z: the standard deviation of a skewed prior says little of its width.
            from_data=float(identifiability.from_data(float(np.var(points[:, place])), 1.0)),
            **_diagnostics(fit, place),
        )
        for place, line in enumerate(fixed)
    )


def _diagnostics(fit: Fit, place: int) -> dict[str, Any]:
    """Return R̂ and effective sizes of a parameter; nothing if the posterior was not sampled."""
    if fit.posterior is None or fit.posterior.chains is None:
        return {}
    found = fit.posterior.chains.diagnosis
    return {key: float(getattr(found, key)[place]) for key in ("r_hat", "ess_bulk", "ess_tail")}


def _derived(fit: Fit) -> tuple[records.DerivedSummary, ...]:
    """Return one line per derived quantity; estimates are None if the fit did not converge."""
    names = fit.derived.names
    if fit.posterior is None:
        return tuple(records.DerivedSummary(name=n.name, unit=n.unit, within=_conformance(fit, n, None)) for n in names)
    lines = []
    for name, draws, prior in zip(names, fit.posterior.derived.T, fit.posterior.prior_derived.T, strict=True):
        # A quantity that no parameter changes has no share from the data.
        fixed = records.is_constant(prior)
        share = None if fixed else float(identifiability.from_data(float(np.var(draws)), float(np.var(prior))))
        lines.append(
            records.DerivedSummary(
                name=name.name,
                unit=name.unit,
                prior_sd=0.0 if fixed else float(prior.std()),
                from_data=share,
                within=_conformance(fit, name, draws),
                **records.estimated(draws).model_dump(),
            )
        )
    return tuple(lines)


def _conformance(fit: Fit, quantity: DerivedQuantity, draws: np.ndarray | None) -> records.Conformance | None:
    """Return how probably a Δk is below the threshold up to which the 1 g line applies; None for other quantities."""
    if family_of(quantity.name) != DELTA_K:
        return None
    stated = (fit.model.spec.delta_k_threshold, fit.model.campaign.delta_k_threshold, THRESHOLD)
    threshold = 100 * next(each for each in stated if each is not None)
    within = None if draws is None else float(np.mean(draws <= threshold))
    return records.Conformance(threshold=threshold, unit=quantity.unit, probability=within)


def _weak(fit: Fit, precision: np.ndarray) -> list[identifiability.WeakDirection]:
    """Return what the data did not determine: pairs of derived quantities first, then combinations of parameters."""
    model = fit.model
    gradient = derived_jacobian(fit.derived.derivation, model.problem, fit.z)
    directions = np.linalg.solve(precision, gradient.T)
    prior, posterior = gradient @ gradient.T, gradient @ directions
    spread = np.sum(directions * np.linalg.solve(precision, directions), axis=0)
    along = 1 - spread / np.maximum(np.sum(directions**2, axis=0), 1e-300)
    names = [name.name for name in fit.derived.names]
    parts = [QuantityName.of(name) for name in names]
    pairs = [
        (i, j)
        for i, first in enumerate(parts)
        for j, second in enumerate(parts)
        if first.family == SCALE_FACTOR and second.family == MOUNTING_ANGLE and first.first == second.first
    ]
    hidden = np.array([parameter.nuisance for parameter in model.layout.parameters])
    shown = {name for name, hide in zip(model.layout.names, hidden, strict=True) if not hide}
    found = identifiability.weak_directions(precision, model.layout.names, hidden)
    # A combination of nuisance parameters alone, such as the heading of a tumble, is of no interest.
    return identifiability.confusions(prior, posterior, along, names, pairs) + [
        weak for weak in found if shown & {*weak.quantities}
    ]
