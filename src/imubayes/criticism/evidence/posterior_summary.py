"""From the hypotheses of a search to the probabilities of explanations, of effects, and of what stands in their place.

Noise that the model leaves open is a nuisance, such as the scatter between runs: hypotheses that differ in it
alone count once, by the most probable.  A search evaluates more sizes about its leader than about others, and their sum
would favour it.

Rows that scatter less than their samples say lack nothing: no effect takes noise away, and the fit has the scale of the
rows.  A vibration averages out within a row, for example.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from imubayes.criticism import explanation_records as record
from imubayes.criticism.evidence.hypothesis_evidence import Evaluated
from imubayes.criticism.evidence.linear_problem import LinearProblem
from imubayes.criticism.evidence.model_search import ModelSearch, possible
from imubayes.criticism.evidence.noise_structures import NoiseOfUnit, NoiseUnit
from imubayes.inference.fitted_model import Fit
from imubayes.responses.candidate_effects import Responses

_TABLED = 8
"""Effects in the table of inclusion."""
UNLISTED = 0.25
"""Share of explanations by effects beside noise above what is known, of which a cause outside the catalogue is
the truth: the effect imitates a part of it and the noise takes the rest.  A belief that no data of the kind refute."""
_STANDS_OUT = 3.0
"""Standard deviations from the known noise beyond which the noise of a channel is reported by itself (convention)."""
_KINDS: tuple[record.Explanation, ...] = ("nothing", "noise", "effects", "input", "outside")


@dataclass(frozen=True)
class SlotMember:
    """A variant of an effect in a slot, the most probable hypothesis with it there, and the share of its effect."""

    effect: str
    variant: int
    found: Evaluated
    share: float


@dataclass(frozen=True)
class MissingEffect:
    """One missing effect of the leading hypothesis, and what may stand in its place, the rest held.

    Attributes
    ----------
    members : the most probable first, until 95 % are reported.
    gain : natural logarithm of the evidence for it.
    probability : that an effect of the slot is missing.
    """

    members: tuple[SlotMember, ...]
    gain: float
    probability: float


class ExplanationPosterior:
    """The hypotheses of a search with their probabilities.

    Attributes
    ----------
    fitted : the fit that the search is about; its record is corrected if the leader is a gross wrong input.
    of : the evidence of hypotheses.
    distinct, share : hypotheses that differ in more than the scatter between runs, and their probabilities, (n,).
    unlisted : probability of a cause outside the catalogue that no form of the search takes.
    """

    def __init__(self, search: ModelSearch, fitted: Fit):
        self.search, self.of, self.fitted = search, search.of, fitted
        self.distinct = [each for each in _distinct(search.known) if possible(each)]
        self._logs = np.array([each.log_posterior for each in self.distinct])
        share = np.exp(self._logs - np.logaddexp.reduce(self._logs))
        self._imitating = np.array([self._beside_excess(each) for each in self.distinct])
        taken = UNLISTED * self._imitating
        self.share, self.unlisted = share * (1 - taken), float(share @ taken)

    def kind_of(self, found: Evaluated) -> record.Explanation:
        """Return what kind of explanation a hypothesis is."""
        form = found.hypothesis.form
        if form is not None:
            return "input" if form.form.wrong is not None else "outside"
        if found.hypothesis.variants:
            return "effects"
        units = zip(self.of.units, found.hypothesis.noise, strict=True)
        return "nothing" if all(noise.stated or self._is_less(unit, noise, found) for unit, noise in units) else "noise"

    def _is_less(self, unit: NoiseUnit, noise: NoiseOfUnit, found: Evaluated) -> bool:
        """Return whether noise is as known but for a smaller scale on each channel that differs."""
        if noise.family != "scale" or noise.scatter not in {each.scatter for each in unit.stated}:
            return False
        return all(found.scale[k] < 1 for k in self._unlike_known(unit.channels, found))

    def _beside_excess(self, found: Evaluated) -> bool:
        """Return whether effects stand beside noise of the rows above what is known."""
        units = zip(self.of.units, found.hypothesis.noise, strict=True)
        scales = [found.scale[list(unit.channels)] for unit, noise in units if noise.rows.free]
        return bool(found.hypothesis.variants) and any(np.log(each).mean() > 0 for each in scales)

    @cached_property
    def evidence(self) -> record.Evidence:
        """How probable each explanation is, as a record."""
        return record.Evidence(
            explanations=self._explanations,
            slots=tuple(map(self._slot_record, self.slots)),
            inclusion=self.inclusion[:_TABLED],
            form=self._form_record(),
            noise=tuple(self._noise_records()),
            noise_known=max(rows.scale_sd for rows in self.of.problem.of_channels if len(rows.entry)),
            hypotheses=len(self.search.known),
        )

    @cached_property
    def _explanations(self) -> tuple[record.ProbableExplanation, ...]:
        kinds = [self.kind_of(each) for each in self.distinct]

        def explanation(kind: record.Explanation) -> record.ProbableExplanation:
            here = np.array([each == kind for each in kinds])
            probability, logs = float(self.share[here].sum()), self._logs[here]
            if kind == "outside":
                probability += self.unlisted
                logs = np.concatenate([logs, self._logs[self._imitating] + math.log(UNLISTED)])
            odds = float(logs.max() - self._logs.max()) if len(logs) else None
            return record.ProbableExplanation(kind=kind, probability=min(probability, 1.0), log_odds=odds)

        return tuple(map(explanation, _KINDS))

    @cached_property
    def leading(self) -> record.Explanation:
        """The kind of explanation that is most probable."""
        return max(self._explanations, key=lambda each: each.probability).kind

    @cached_property
    def top(self) -> Evaluated:
        """The most probable hypothesis of the leading kind."""
        mine = [each for each in self.distinct if self.kind_of(each) == self.leading]
        return max(mine, key=lambda each: each.log_posterior)

    @cached_property
    def slots(self) -> tuple[MissingEffect, ...]:
        """The effects of the leading hypothesis, the strongest first."""
        return tuple(sorted(map(self._slot, self.top.hypothesis.variants), key=lambda each: -each.gain))

    def _slot(self, variant: int) -> MissingEffect:
        top = self.top
        rest, form = set(top.hypothesis.variants) - {variant}, top.hypothesis.form
        inside: dict[str, list[Evaluated]] = {}
        without = -math.inf
        for each in self.distinct:
            own = set(each.hypothesis.variants)
            if each.hypothesis.form is not form or not rest <= own:
                continue
            if own == rest:
                without = max(without, each.log_posterior)
            elif len(own) == len(rest) + 1:
                inside.setdefault(self.of.variants[next(iter(own - rest))].effect, []).append(each)
        mass = {e: float(np.logaddexp.reduce([one.log_posterior for one in every])) for e, every in inside.items()}
        whole, members = np.logaddexp.reduce(list(mass.values())), list[SlotMember]()
        for effect in sorted(mass, key=lambda each: -mass[each]):
            if sum(each.share for each in members) >= 1 - math.exp(-record.NEAR):
                break
            best = max(inside[effect], key=lambda each: each.log_posterior)
            own = next(iter(set(best.hypothesis.variants) - rest))
            members.append(SlotMember(effect, own, best, float(np.exp(mass[effect] - whole))))
        gain = float(top.log_posterior - without) if math.isfinite(without) else 0.0
        return MissingEffect(tuple(members), gain, self.including([each.effect for each in members]))

    def including(self, effects: Sequence[str]) -> float:
        """Return the probability that any of some effects is missing."""
        told = set(effects)
        named = [told & {self.of.variants[n].effect for n in each.hypothesis.variants} for each in self.distinct]
        return min(float(self.share[[bool(each) for each in named]].sum()), 1.0)

    @cached_property
    def inclusion(self) -> tuple[record.ProbableEffect, ...]:
        """The effects of all hypotheses with their probabilities, the most probable first."""
        owners: dict[str, tuple[str, ...]] = {}
        for place in np.argsort(-self.share):
            for n in self.distinct[place].hypothesis.variants:
                owners.setdefault(self.of.variants[n].effect, self.of.variants[n].owners)
        found = [
            record.ProbableEffect(effect=effect, channels=own, probability=self.including([effect]))
            for effect, own in owners.items()
        ]
        return tuple(sorted(found, key=lambda each: -each.probability))

    def coefficients(self, variant: int, found: Evaluated) -> tuple[record.CoefficientEstimate, ...]:
        """Return the coefficients of a variant in a hypothesis, with their posterior standard deviations."""
        places = self.of.variants[variant].places
        at, variance = self.of.among(found, places), np.diag(self.of.solved(found).covariance)
        return estimates(self.of.problem, places, found.mean[at], variance[at])

    def columns_of(self, variant: int, responses: Responses) -> tuple[list[str], np.ndarray]:
        """Return a variant's coefficients by name, (k,), and how other rows, or at another point, respond, (E, k)."""
        own, problem = self.of.variants[variant], self.of.problem
        scan, told = problem.candidates[own.response].scan, {problem.coefficients[k].parameter.name for k in own.places}
        fitting = [each for each in responses.candidates if each.scan.effect == scan.effect]
        response = next((each for each in fitting if each.scan == scan), fitting[0])
        names = [each.parameter.name for each in response.coefficients]
        here = [place for place, name in enumerate(names) if name in told]
        return [names[place] for place in here], response.columns[:, here]

    def response_to(self, member: SlotMember, responses: Responses) -> tuple[np.ndarray, np.ndarray]:
        """Return the responses (E, k) of other rows or at another point to a member's coefficients, and these (k,)."""
        names, columns = self.columns_of(member.variant, responses)
        sizes = {each.name: each.value or 0.0 for each in self.coefficients(member.variant, member.found)}
        return columns, np.array([sizes[name] for name in names])

    @cached_property
    def wrong_inputs(self) -> tuple[tuple[float, Evaluated], ...]:
        """Wrong inputs near the most probable, with their probabilities among them; empty without one."""
        found = [each for each in self.distinct if self.kind_of(each) == "input"]
        best = max((each.log_posterior for each in found), default=-math.inf)
        near = sorted(
            (each for each in found if each.log_posterior > best - record.NEAR), key=lambda e: -e.log_posterior
        )
        mass = np.logaddexp.reduce([each.log_posterior for each in near]) if near else 0.0
        return tuple((float(np.exp(each.log_posterior - mass)), each) for each in near)

    def _slot_record(self, slot: MissingEffect) -> record.EffectSlot:
        return record.EffectSlot(
            candidates=tuple(
                record.ProbableEffect(effect=m.effect, channels=self.of.variants[m.variant].owners, probability=m.share)
                for m in slot.members
            ),
            gain=slot.gain,
            probability=slot.probability,
        )

    @cached_property
    def _without_form(self) -> float:
        return max(each.log_posterior for each in self.distinct if each.hypothesis.form is None)

    @cached_property
    def with_form(self) -> Evaluated | None:
        """The most probable hypothesis with a form outside the catalogue or a wrong input; None if none is near."""
        formed = [each for each in self.distinct if each.hypothesis.form is not None]
        best = max(formed, key=lambda each: each.log_posterior, default=None)
        return None if best is None or best.log_posterior < self._without_form - record.NEAR else best

    def _form_record(self) -> record.FoundForm | None:
        best = self.with_form
        if best is None:
            return None
        chosen, problem = best.hypothesis.form, self.of.problem
        assert chosen is not None
        form = chosen.form
        return record.FoundForm(
            name=form.name,
            channels=tuple(problem.rows[k].name for k in chosen.channels),
            covariates=form.covariates,
            run=problem.runs[form.run] if form.run is not None else "",
            row=form.row + 1 if form.row is not None else None,
            log_odds=float(best.log_posterior - self._without_form),
            wrong=form.wrong is not None,
        )

    def _noise_records(self) -> Iterable[record.FoundNoise]:
        names = [each.name for each in self.of.problem.rows]
        for unit, noise in zip(self.of.units, self.top.hypothesis.noise, strict=True):
            if not noise.stated:
                own = self._unlike_known(unit.channels, self.top) if noise.family == "scale" else unit.channels
                scale = float(np.exp(np.mean(np.log(self.top.scale[list(own)]))))
                channels = tuple(names[k] for k in own)
                yield record.FoundNoise(channels=channels, family=noise.family, scale=scale)

    def _unlike_known(self, channels: Sequence[int], at: Evaluated) -> Sequence[int]:
        """Return the channels of a structure whose noise is not as known; all if none stands out."""
        rows = self.of.problem.rows
        sd = {k: math.hypot(rows[k].scale_sd, math.sqrt(0.5 / max(len(rows[k].entry), 1))) for k in channels}
        found = [k for k in channels if abs(math.log(at.scale[k])) > _STANDS_OUT * sd[k]]
        return found or channels


def estimates(
    problem: LinearProblem, places: Sequence[int], mean: np.ndarray, variance: np.ndarray
) -> tuple[record.CoefficientEstimate, ...]:
    """Return coefficients in their units, from means and variances in their largest typical sizes, (k,)."""
    return tuple(
        record.CoefficientEstimate(
            name=problem.coefficients[k].parameter.name,
            value=float(value * problem.sizes[k]),
            sd=float(np.sqrt(square) * problem.sizes[k]),
            unit=problem.coefficients[k].parameter.shown_unit,
        )
        for k, value, square in zip(places, mean, variance, strict=True)
    )


def _distinct(known: Iterable[Evaluated]) -> list[Evaluated]:
    found: dict[object, Evaluated] = {}
    for each in known:
        own = each.hypothesis
        key = own.variants, own.form, tuple((noise.stated or noise.rows, noise.stated) for noise in own.noise)
        if key not in found or found[key].log_posterior < each.log_posterior:
            found[key] = each
    return list(found.values())
