"""Questions to a diagnosed fit that linear algebra answers: what explains some rows, and what causes would do.

Both rest on what the diagnosis has made already.  How probable causes of some rows are is answered by the evidence of
the diagnosis (`ExplainedFit.rows`).

A preview is the least squares at the noise known beforehand that predicts Δχ² in the diagnosis; it moves estimates.
"""

import math
import threading
from collections.abc import Sequence
from functools import cached_property

import jax.numpy as jnp
import numpy as np

from imubayes import Diagnosis
from imubayes.adequacy.known_noise_fit import KnownNoisePoint
from imubayes.criticism.diagnose import ExplainedFit
from imubayes.criticism.diagnosis_record import ScreenedEffect
from imubayes.criticism.explanation_records import ResidualFormula
from imubayes.criticism.formula_search import find_formula, terms_beside, terms_of
from imubayes.display.numbers_and_labels import pretty, rounded
from imubayes.foundations.errors import closest_first, input_error
from imubayes.foundations.progress import Tell
from imubayes.inference.parameter_fit import whitened_columns
from imubayes.model.bind import Model
from imubayes.model.derived_quantities import derived_jacobian
from imubayes.parameters.declarations import prior_slopes
from imubayes.responses.candidate_effects import CatalogueModel
from imubayes.results.summary import ParameterSummary, Summary, in_output_units
from imubayes_explorer.drawn_shape import DrawnCurve, drawn_shape, likest
from imubayes_explorer.known_noise_view import KnownNoiseView
from imubayes_explorer.messages import MovedEstimate, RankedCause, RowsRanking
from imubayes_explorer.refit_ahead import Ahead, refitted, told_values

_MOST_RANKED = 12
_MOST_MOVED, _STAYED = 60, 0.05
_MOST_ACTING = 60
"""Previews of causes that are no lines, which are kept."""


class LinearView(KnownNoiseView):
    """A diagnosed result, and what it answers without a refit.

    Attributes
    ----------
    explained : the diagnosed fit.
    """

    def __init__(self, explained: ExplainedFit, diagnosis: Diagnosis, summary: Summary):
        super().__init__(explained.fit, explained.known, explained.at_known_noise)
        self.explained = explained
        self._diagnosis, self._shown = diagnosis, in_output_units(summary)
        self._acting = dict[tuple[str, ...], Ahead | None]()
        self._white: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        self._evidence = threading.Lock()  # it keeps the columns used last, which two threads must not do at once

    def prepare(self, tell: Tell) -> None:
        """Make ready what every question needs, so that the first one is answered as fast as the others."""
        tell("preparing previews")
        for effect in self.variants:
            self._columns(effect)
        _ = self._slopes, self._catalogue
        for effect in self.variants:
            if self._bends(effect):
                tell(f"preparing previews: {effect}")
                self.with_causes([effect])

    # ---- what explains selected rows ----

    def rank(self, chosen: np.ndarray, without: Sequence[str] = ()) -> RowsRanking:
        """Return how probable single causes of chosen entries, (E,) bool, are; some effects left out."""
        with self._evidence:
            found = self.explained.rows.odds(chosen, without, offset=not chosen[self.entries].all())
        odds, form, offset = found.effects, found.form, found.offset
        whole = float(
            np.logaddexp.reduce([0.0, *odds.values(), *(each for each in (form, offset) if each is not None)])
        )
        ranked = sorted(odds.items(), key=lambda pair: -pair[1])[:_MOST_RANKED]
        causes = tuple(RankedCause(effect=e, probability=math.exp(o - whole), log_odds=o) for e, o in ranked)
        of_form, of_offset = (None if each is None else math.exp(each - whole) for each in (form, offset))
        return RowsRanking(causes=causes, nothing=math.exp(-whole), form=of_form, offset=of_offset)

    def formula(self, channel: str, drawing: DrawnCurve | None = None) -> ResidualFormula | None:
        """Return the simplest formula for what the model leaves of a channel, or the one that is like a drawing.

        None if no term is worth its odds; a drawing is its own term if no other is like it.
        """
        names = [each.name for each in self.explained.of.problem.of_channels]
        if channel not in names:
            raise input_error(
                f"no channel '{channel}'", "formula", closest_first(channel, names), "choose one of these"
            )
        fitted, known, place = self.explained.posterior.fitted, self.known, names.index(channel)
        with self._evidence:
            of, at = self.explained.of, self.explained.rows.nothing.at
            if drawing is None:
                return find_formula(of, at, at.scale, fitted, known, place)
            drawn = drawn_shape(drawing, known, fitted.model.campaign.site.gravity)
            own = terms_of(fitted, [each for each in known if each.name == drawing.over], place)
            return likest(terms_beside(of, at, at.scale, fitted, [*own, drawn.term], place), drawn)

    def columns_of(self, found: ResidualFormula, drawing: DrawnCurve | None = None) -> np.ndarray:
        """Return the responses (E, T) to the terms of a formula."""
        campaign, known = self.fit.model.campaign, self.known
        channel = [each.name for each in campaign.channels].index(found.channel)
        drawn = () if drawing is None else (drawn_shape(drawing, known, campaign.site.gravity).term,)
        terms = {each.expression: each.values for each in (*terms_of(self.fit, known, channel), *drawn)}
        here = self.entries & (self.fit.model.entries.channel == channel)
        return np.stack([np.where(here, terms[each.expression], 0.0) for each in found.terms], axis=1)

    # ---- what causes would do ----

    @cached_property
    def variants(self) -> dict[str, int]:
        """The variant that stands for each effect: of the leading explanation, or the best one alone."""
        of, found = self.explained.of, dict[str, int]()
        for slot in self.explained.posterior.slots:
            for member in slot.members:
                found.setdefault(member.effect, member.variant)
        for n in self.explained.rows.alone:
            found.setdefault(of.variants[n].effect, n)
        return found

    def _columns(self, effect: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the responses (E, C) to the coefficients of an effect, plain and whitened."""
        if effect not in self._white:
            if effect not in self.variants:
                allowed = closest_first(effect, self.variants)
                raise input_error(
                    f"'{effect}' is not in the list of causes", "preview", allowed, "choose one of the list"
                )
            posterior = self.explained.posterior
            columns = posterior.columns_of(self.variants[effect], self.explained.responses)[1]
            self._white[effect] = columns, whitened_columns(self.fit.model.problem, self.point.h, columns)
        return self._white[effect]

    def acting_linearly(self, effects: Sequence[str]) -> KnownNoisePoint:
        """Return the fit at the noise known beforehand with causes beside, each along its response."""
        if not effects:
            return self.point
        plain, white = zip(*map(self._columns, effects), strict=True)
        return self.point.with_columns(np.concatenate(plain, axis=1), np.concatenate(white, axis=1))

    def with_causes(self, effects: Sequence[str]) -> KnownNoisePoint:
        """Return the fit at the noise known beforehand with causes beside; raises InputError for an unknown one.

        A cause of one sign, such as a dead zone or a saturation, is no line: it acts as it is found, and the
        parameters of the model are fitted beside it.
        """
        linear, asked = self.acting_linearly(effects), tuple(effects)
        bent = [each for each in effects if self._bends(each)]
        if not bent:
            return linear
        if asked not in self._acting:
            told = told_values([each for each in map(self._diagnosis.estimate, bent) if each is not None])
            plain = [self._columns(each)[0] for each in effects if each not in bent]
            beside = np.concatenate(plain, axis=1) if plain else None
            found = refitted(self._catalogue.at(told), self.point, self.fit.model, columns=beside)
            while len(self._acting) > _MOST_ACTING:
                self._acting.pop(next(iter(self._acting)))
            self._acting[asked] = found
        else:
            found = self._acting[asked]
        return linear if found is None else found.point

    def _bends(self, effect: str) -> bool:
        """Return whether a cause is of one sign, and so no line."""
        of = self.explained.of
        return bool(of.problem.sign[list(of.variants[self.variants[effect]].places)].any())

    @cached_property
    def _catalogue(self) -> CatalogueModel:
        return CatalogueModel(self.fit)

    def ahead(
        self, changed: Model, estimates: Sequence[ScreenedEffect] = (), columns: np.ndarray | None = None
    ) -> Ahead | None:
        """Return the fit of a changed model before it is made (see `refit_ahead.refitted`); None if it must be."""
        return refitted(self._catalogue, self.point, changed, estimates, columns)

    @cached_property
    def _slopes(self) -> np.ndarray:
        """The derivatives of parameters and derived quantities, in their units, by z, (P + D, P)."""
        model, z = self.fit.model, self.fit.z
        own = np.asarray(prior_slopes(model.problem.priors, jnp.asarray(z))) / model.layout.factors()
        return np.concatenate([np.diag(own), derived_jacobian(self.fit.derived.derivation, model.problem, z)])

    def moved(self, point: KnownNoisePoint) -> tuple[MovedEstimate, ...]:
        """Return the estimates that a previewed fit moves, those that it moves most first; none of another model's."""
        if point is self.point or point.model is not self.fit.model:
            return ()
        names = (*self.fit.model.layout.names, *(each.name for each in self.fit.derived.names))
        steps = dict(zip(names, (self._slopes @ (point.z - self.point.z)).tolist(), strict=True))
        found = [
            MovedEstimate(
                name=each.name, unit=pretty(each.unit), after=rounded((each.mean + steps[each.name],), each.sd)[0],
                in_sd=steps[each.name] / each.sd,
            )
            for each in (*self._shown.derived, *self._shown.parameters)
            if each.name in steps and each.mean is not None and each.sd and not each.repeats_misalignments
            if not (isinstance(each, ParameterSummary) and each.nuisance)
        ]  # fmt: skip
        told = [each for each in found if math.isfinite(each.in_sd) and abs(each.in_sd) >= _STAYED]
        return tuple(sorted(told, key=lambda each: -abs(each.in_sd))[:_MOST_MOVED])
