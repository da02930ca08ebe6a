"""A diagnosed result as linear algebra: what is asked of the diagnosis, and the estimates that a preview moves."""

import math
from collections.abc import Sequence
from functools import cached_property

import jax.numpy as jnp
import numpy as np

from imubayes.adequacy.known_noise_fit import KnownNoisePoint
from imubayes.criticism.diagnose import ExplainedFit
from imubayes.criticism.diagnosis_record import Diagnosis, ScreenedEffect
from imubayes.criticism.linear_answers import LinearAnswers
from imubayes.criticism.refit_ahead import Ahead, refitted, told_values
from imubayes.explorer.messages import MovedEstimate
from imubayes.foundations.progress import Tell
from imubayes.model.bind import Model
from imubayes.model.derived_quantities import derived_jacobian
from imubayes.parameters.declarations import prior_slopes
from imubayes.responses.candidate_effects import CatalogueModel
from imubayes.results.summary import ParameterSummary, Summary, in_output_units

_MOST_MOVED, _STAYED = 60, 0.05


class LinearView(LinearAnswers):
    """A diagnosed result, and what it answers without a refit."""

    def __init__(self, explained: ExplainedFit, diagnosis: Diagnosis, summary: Summary):
        super().__init__(explained)
        self._diagnosis, self._shown = diagnosis, in_output_units(summary)
        self._acting: tuple[tuple[str, ...], Ahead | None] = (), None

    def prepare(self, tell: Tell) -> None:
        super().prepare(tell)
        _ = self._slopes, self._catalogue

    @cached_property
    def _catalogue(self) -> CatalogueModel:
        return CatalogueModel(self.fit)

    def ahead(
        self, changed: Model, estimates: Sequence[ScreenedEffect] = (), columns: np.ndarray | None = None
    ) -> Ahead | None:
        """Return the fit of a changed model before it is made (see `refit_ahead.refitted`); None where it must be."""
        return refitted(self._catalogue, self.point, changed, estimates, columns)

    def with_causes(self, effects: Sequence[str]) -> KnownNoisePoint:
        """Return the fit at the noise known beforehand with causes beside; raises InputError for an unknown one.

        A cause of one sign, such as a dead zone or a saturation, is no line: it acts as it is found, and the
        parameters of the model are fitted beside it.
        """
        of, linear, asked = self.explained.of, super().with_causes(effects), tuple(effects)
        bent = [each for each in effects if of.problem.sign[list(of.variants[self.variants[each]].places)].any()]
        if not bent:
            return linear
        known, found = self._acting
        if known != asked:  # the points of a preview are asked for after its words
            told = told_values([each for each in map(self._diagnosis.estimate, bent) if each is not None])
            plain = [self._columns(each)[0] for each in effects if each not in bent]
            beside = np.concatenate(plain, axis=1) if plain else None
            found = refitted(self._catalogue.at(told), self.point, self.fit.model, columns=beside)
            self._acting = asked, found
        return linear if found is None else found.point

    def whitened(self, point: KnownNoisePoint | None = None) -> np.ndarray:
        """Return the residual of every entry in units of the noise known beforehand, (E,)."""
        return (point or self.point).left[: len(self.entries)]

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
                name=each.name, unit=each.unit, before=each.mean, after=each.mean + steps[each.name], sd=each.sd,
                in_sd=steps[each.name] / each.sd,
            )
            for each in (*self._shown.derived, *self._shown.parameters)
            if each.name in steps and each.mean is not None and each.sd and not each.repeats_misalignments
            if not (isinstance(each, ParameterSummary) and each.nuisance)
        ]  # fmt: skip
        told = [each for each in found if math.isfinite(each.in_sd) and abs(each.in_sd) >= _STAYED]
        return tuple(sorted(told, key=lambda each: -abs(each.in_sd))[:_MOST_MOVED])
