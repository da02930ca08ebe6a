"""Detectability: what absorbs a missing effect, how small an effect the runs show, and the run that separates rivals.

All of it is linear algebra on the Gram matrices of the evidence, at the noise known beforehand.

The candidate run that best distinguishes the members of a slot is found without a simulation.  Were the leader the
truth with the coefficients found, a refit with another member would leave |(I − P_b) w|² of χ² over all runs, the new
one included; the run that makes the smallest of these largest distinguishes them.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from statistics import NormalDist

import numpy as np

from imubayes.adequacy.known_noise import known_scales
from imubayes.criticism.evidence.effect_variants import EffectVariant, effect_variants
from imubayes.criticism.evidence.hypothesis_evidence import Evaluated, EvidenceOf, Hypothesis, inverse
from imubayes.criticism.evidence.posterior_summary import ExplanationPosterior, MissingEffect
from imubayes.criticism.explanation_records import NAMED_ODDS, Absorber, NeglectedUncertainty, ParameterBias
from imubayes.inference.candidate_runs import RunDesign
from imubayes.inference.experiment_design import with_planned
from imubayes.inference.fitted_model import Fit
from imubayes.inference.parameter_fit import whitened_columns
from imubayes.model.problem import prior_widths
from imubayes.parameters.declarations import prior_slopes
from imubayes.responses.candidate_effects import candidate_responses
from imubayes.responses.uncertain_equipment import stated_size

RUN_OFFSETS = "run offsets"
DETECTION_POWER = 0.8
"""Probability with which an effect of the smallest detectable size would be named (convention)."""
ABSORBER_SHARE = 0.01
"""Share of a response below which what absorbs it is not reported."""
NEGLECTED_SHIFT = 0.5
"""Posterior standard deviations by which a neglected uncertainty, or an effect that the runs cannot show, shifts a
parameter, to be reported (convention)."""


@dataclass(frozen=True)
class Detectability:
    """How well the runs can show one effect, by the coefficient that they show best relative to its typical size.

    Attributes
    ----------
    effect, name, unit : effect, and name and unit of the coefficient.
    retained : fraction of its squared response that the model does not absorb.
    smallest_detectable : size that would be named with a probability of 80 %, in its unit; infinite if none is.
    typical : smallest and largest magnitude met in practice.
    absorbed_by : what absorbs the rest, largest share first.
    bias : of the reported parameters if the effect is present and not modelled; None without parameters.
    """

    effect: str
    name: str
    unit: str
    retained: float
    smallest_detectable: float
    typical: tuple[float, float]
    absorbed_by: tuple[Absorber, ...]
    bias: ParameterBias | None

    @property
    def undetectable(self) -> bool:
        """Whether even the largest size met in practice would be missed."""
        return self.smallest_detectable > self.typical[1]


class AbsorbedResponses:
    """What the model's own parameters absorb of the response to every coefficient, at the noise known beforehand.

    Attributes
    ----------
    shift : shape (P, C), the parameters that fit each response best, in z per largest typical size.
    taken : shape (P, C), share of the squared response that each parameter takes, times it.
    raw, white, left : shape (C,), squared responses to the largest typical sizes: in all, beside offsets of runs, and
        past all parameters.
    sd : shape (P,), of the parameters, in z.
    """

    def __init__(self, of: EvidenceOf, fitted: Fit):
        self.of, self.fitted, problem = of, fitted, of.problem
        count = len(problem.coefficients)
        own, across = np.diag(problem.precision).astype(float), np.zeros((problem.own, count))
        self.raw, self.white = np.zeros(count), np.zeros(count)
        stated = Hypothesis((), of.as_fitted)
        apart = Hypothesis((), tuple(replace(each, scatter=0.0) for each in of.as_fitted))
        parameters, every = np.arange(problem.own), problem.own + np.arange(count)
        for k in of.unit_of:
            products = of.gram(stated, k).products
            here, mine = of.select(k, parameters)
            there, place = of.select(k, every)
            rows, columns = np.flatnonzero(here), np.flatnonzero(there)
            own[np.ix_(rows, rows)] += products[np.ix_(mine, mine)]
            across[np.ix_(rows, columns)] += products[np.ix_(mine, place)]
            self.white[columns] += np.diag(products)[place]
            self.raw[columns] += np.diag(of.gram(apart, k).products)[place]
        covariance = inverse(own) if len(own) else own
        self.shift = covariance @ across
        self.taken = self.shift * across
        self.left = np.maximum(self.white - self.taken.sum(axis=0), 0.0)
        self.sd = np.sqrt(np.diag(covariance))

    @cached_property
    def of_effects(self) -> tuple[Detectability, ...]:
        """How well each effect can be detected, by its best coefficient and shape."""
        best: dict[str, Detectability] = {}
        for seen in self._of_responses():
            known = best.get(seen.effect)
            if (
                known is None
                or seen.smallest_detectable / seen.typical[1] < known.smallest_detectable / known.typical[1]
            ):
                best[seen.effect] = seen
        return tuple(best.values())

    def _of_responses(self) -> Iterator[Detectability]:
        first, odds = 0, {each.response: each for each in reversed(effect_variants(self.of.problem))}
        for place, response in enumerate(self.of.problem.candidates):
            places = np.arange(first, first + len(response.coefficients))
            first += len(places)
            if place in odds and self.raw[places].any():
                yield self._detectability(places, odds[place])

    def _detectability(self, places: np.ndarray, variant: EffectVariant) -> Detectability:
        problem = self.of.problem
        told = self.left[places] > 1e-12 * self.raw[places]
        length = np.sqrt(np.where(told, self.left[places], 0.0))
        k = int(places[np.argmax(length)])
        coefficient, size = problem.coefficients[k], float(problem.sizes[k])
        best = float(length.max())
        return Detectability(
            effect=variant.effect,
            name=coefficient.parameter.name,
            unit=coefficient.parameter.shown_unit,
            retained=float(self.left[k] / self.raw[k]) if self.raw[k] > 0 else 0.0,
            smallest_detectable=deviations_needed(variant) * size / best if best > 0 else math.inf,
            typical=(min(coefficient.typical[0], size), size),
            absorbed_by=self._absorbers(k),
            bias=self._bias(variant.effect, places),
        )

    def _absorbers(self, k: int) -> tuple[Absorber, ...]:
        """Return the shares of a response that parameter families and offsets of runs absorb."""
        if self.raw[k] <= 0:
            return ()
        shares = {RUN_OFFSETS: max(0.0, 1 - float(self.white[k] / self.raw[k]))}
        for parameter, share in zip(self.fitted.model.layout.parameters, self.taken[:, k] / self.raw[k], strict=True):
            family = f"{parameter.effect}.{parameter.field}"
            shares[family] = shares.get(family, 0.0) + float(share)
        absorbed = min(sum(shares.values()), 1.0)
        positive = {name: share for name, share in shares.items() if share > 0}
        whole = sum(positive.values()) or 1.0
        found = [Absorber(name, share / whole * absorbed) for name, share in positive.items()]
        return tuple(sorted((each for each in found if each.share >= ABSORBER_SHARE), key=lambda each: -each.share))

    def _bias(self, effect: str, places: np.ndarray) -> ParameterBias | None:
        """Return the worst bias by one of the coefficients at its largest typical size."""
        if not len(self.sd):
            return None
        coefficients = [self.of.problem.coefficients[k] for k in places]
        stated = np.array([stated_size(self.fitted.model, effect, each) is None for each in coefficients])
        in_sd = self.shift[:, places] * stated / self.sd[:, None]
        most, worst = divmod(int(np.argmax(np.abs(in_sd))), len(coefficients))
        parameter, cause = self.fitted.model.layout.parameters[most], coefficients[worst].parameter
        return ParameterBias(
            parameter=parameter.name,
            unit=parameter.shown_unit,
            value=float(self.shift[most, places[worst]] * stated[worst] * self._slopes[most] / parameter.factor),
            in_sd=float(in_sd[most, worst]),
            coefficient=cause.name,
            size=float(self.of.problem.sizes[places[worst]]) * float(stated[worst]),
            size_unit=cause.shown_unit,
        )

    @cached_property
    def _slopes(self) -> np.ndarray:
        """The derivative of each parameter by its z, SI, (P,)."""
        return np.asarray(prior_slopes(self.fitted.model.problem.priors, self.fitted.z))

    @property
    def neglected(self) -> tuple[NeglectedUncertainty, ...]:
        """The stated uncertainties that matter beside the posterior, the worst of each effect, the largest first."""
        worst: dict[str, NeglectedUncertainty] = {}
        for each in self._shifts():
            known = worst.get(each.effect)
            if each.in_sd >= NEGLECTED_SHIFT and (known is None or each.in_sd > known.in_sd):
                worst[each.effect] = each
        return tuple(sorted(worst.values(), key=lambda each: -each.in_sd))

    def _shifts(self) -> Iterator[NeglectedUncertainty]:
        """Yield each stated uncertainty of a candidate with the shift of the parameter that it moves most."""
        model, problem, first = self.fitted.model, self.of.problem, 0
        for response in problem.candidates if len(self.sd) else ():
            for k, coefficient in enumerate(response.coefficients, first):
                stated = stated_size(model, response.scan.effect, coefficient)
                if not stated:
                    continue
                shift = np.abs(self.shift[:, k] * stated / problem.sizes[k] / self.sd)
                most = int(np.argmax(shift))
                yield NeglectedUncertainty(
                    effect=response.scan.effect, parameter=coefficient.parameter.name, value=stated,
                    unit=coefficient.parameter.shown_unit, shifts=model.layout.names[most],
                    in_sd=float(shift[most]),
                )  # fmt: skip
            first += len(response.coefficients)

    def explained(self, found: Evaluated, places: Sequence[int]) -> np.ndarray:
        """Return what the own parameters take of some coefficients at their sizes in a hypothesis, in z, (P,)."""
        return self.shift[:, list(places)] @ found.mean[self.of.among(found, places)]


def deviations_needed(variant: EffectVariant) -> float:
    """Return the standard deviations at which a coefficient must truly stand for its effect to be named.

    With an estimate at z the log odds are those before, and z²/2 · s²/(1 + s²) − log(1 + s²)/2 at the most probable
    width s of the prior, s² = z² − 1, one of so many.
    """
    z = np.linspace(1.0, 20.0, 1901)
    gain = 0.5 * (z**2 - 1) - np.log(z) - math.log(len(variant.widths)) + variant.log_odds
    return float(z[np.argmax(gain >= NAMED_ODDS)]) + NormalDist().inv_cdf(DETECTION_POWER)


_POWER = NormalDist().inv_cdf(DETECTION_POWER)
_DISTINGUISHED = (_POWER + math.sqrt(_POWER**2 + 2 * NAMED_ODDS)) ** 2
"""χ² by which a planned run has to distinguish the members of a slot, so that one will be named.  Derived: 9.6."""


def discriminating_run(fitted: Fit, posterior: ExplanationPosterior, slot: MissingEffect) -> RunDesign | None:
    """Return the run that best distinguishes the members of a slot; None if no feasible run does."""
    if len(slot.members) < 2:
        return None
    extended, planned = with_planned(fitted, elsewhere=True)
    if not planned:
        return None
    entries = extended.model.entries
    responses = candidate_responses(extended, only=[member.effect for member in slot.members])
    if {each.scan.effect for each in responses.candidates} < {member.effect for member in slot.members}:
        return None
    members = [posterior.response_to(member, responses) for member in slot.members]
    # The runs that are planned have the noise that is known of their channels.
    h = known_scales(extended)
    parts = [responses.jacobian, *(columns for columns, _ in members)]
    white = whitened_columns(extended.model.problem, h, np.concatenate(parts, axis=1))
    jacobian, *columns = np.split(white, np.cumsum([part.shape[1] for part in parts])[:-1], axis=1)
    prior = np.diag(1 / np.asarray(prior_widths(extended.model.problem, h)))
    recorded = len(fitted.model.campaign.runs)
    sized = [(own, sizes) for own, (_, sizes) in zip(columns, members, strict=True)]
    differences = [
        _least_difference(jacobian, prior, sized, (entries.run < recorded) | (entries.run == recorded + place))
        for place in range(len(planned))
    ]
    best = int(np.argmax(differences))
    return planned[best].design if differences[best] >= _DISTINGUISHED else None


def _least_difference(
    jacobian: np.ndarray, prior: np.ndarray, members: list[tuple[np.ndarray, np.ndarray]], included: np.ndarray
) -> float:
    """Return the smallest χ² that another member would leave over some entries, (E,) bool, were the first true."""
    leader, values = members[0]
    wanted = np.concatenate([leader[included] @ values, np.zeros(len(prior))])
    differences = []
    for columns, _ in members[1:]:
        size = np.linalg.norm(columns[included], axis=0)
        scaled = columns[included] / np.where(size > 0, size, 1.0)
        rows = np.concatenate([jacobian[included], scaled], axis=1)
        prior_rows = np.concatenate([prior, np.zeros((len(prior), scaled.shape[1]))], axis=1)
        basis, _ = np.linalg.qr(np.concatenate([rows, prior_rows]))
        differences.append(float(np.sum((wanted - basis @ (basis.T @ wanted)) ** 2)))
    return min(differences)
