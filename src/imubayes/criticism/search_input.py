"""What a search begins with: a fit linearised with all candidates, and their screening at one noise."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from imubayes.criticism import thresholds
from imubayes.criticism.candidate_effects import Responses
from imubayes.criticism.free_form_dependence import (
    ProjectedForm,
    Structure,
    free_forms,
    project_forms,
    screen_structure,
)
from imubayes.criticism.localised_structure import FeatureScan, FeatureSet, features, scan_features
from imubayes.criticism.noise_tests import Prewhitening
from imubayes.criticism.projection import Projection, Whitening, project
from imubayes.criticism.residual_covariates import ResidualCovariate
from imubayes.criticism.score_test import Candidate, ProjectedResponse, project_responses, screen
from imubayes.criticism.slow_noise_records import SlowRecords, slow_records, slow_whitening, with_slow_noise
from imubayes.inference.fitted_model import Fit


@dataclass(frozen=True)
class Screening:
    """Candidates and free forms, tested against one projected residual; both sorted, the most significant first.

    Structure is sought where it is asked for: that takes most of the time, and a search needs it at its ends alone.
    """

    projection: Projection
    prepared: tuple[ProjectedResponse, ...]
    forms: tuple[ProjectedForm, ...]
    feature_sets: tuple[FeatureSet, ...]
    candidates: tuple[Candidate, ...]

    @cached_property
    def scans(self) -> tuple[FeatureScan, ...]:
        """The features, scanned."""
        return tuple(scan_features(self.projection, each) for each in self.feature_sets)

    @cached_property
    def structures(self) -> tuple[Structure, ...]:
        """Free forms and features, tested."""
        return tuple(screen_structure(self.projection, self.forms, self.scans))


@dataclass(frozen=True)
class SearchInput:
    """A fit, linearised with all candidates, and the covariates of its residuals.

    Records with correlated noise are judged at the likeliest noise, or at that of the model.
    """

    fitted: Fit
    responses: Responses
    covariates: tuple[ResidualCovariate, ...]
    as_modelled: bool = False

    @cached_property
    def records(self) -> dict[int, SlowRecords]:
        """The records of the channels whose model has correlated noise, by the place of the channel."""
        return slow_records(self._as_modelled, self.responses) if with_slow_noise(self.fitted) else {}

    @cached_property
    def _as_modelled(self) -> Projection:
        return project(self.fitted, self.responses.misfit, self.responses.jacobian)

    @cached_property
    def _likeliest_noise(self) -> Whitening | None:
        """Whitens records with correlated noise by the likeliest one; None where there are none."""
        return slow_whitening(self._as_modelled, self.records, {}) if self.records and not self.as_modelled else None

    @property
    def factor(self) -> float:
        """Factor on the budget of false alarms: the noise of records with correlated noise is estimated."""
        return thresholds.SLOW_NOISE_FACTOR if self.records else 1.0

    def screening_beside(self, columns: np.ndarray) -> Screening:
        """Return the screening with the noise of records with correlated noise as it is beside effects (E, C)."""
        beside = {place: own.directions(columns) for place, own in self.records.items()}
        return self._screened(slow_whitening(self._as_modelled, self.records, beside))

    def screening(self, extra: Prewhitening | None = None, offsets: bool = False) -> Screening:
        """Return the first screening, with further noise where `extra` and `offsets` say so."""
        likeliest = self._likeliest_noise
        if likeliest is None or extra is None:
            return self._screened(likeliest or extra, offsets)
        return self._screened(lambda white: extra(likeliest(white)), offsets)

    def _screened(self, extra: Whitening | None, offsets: bool = False) -> Screening:
        at = project(self.fitted, self.responses.misfit, self.responses.jacobian, extra, offsets)
        responses = project_responses(at, self.responses.candidates)
        forms = project_forms(at, free_forms(at, self.covariates))
        return screened(at, responses, forms, features(at, self.covariates))


def screened(
    projection: Projection,
    prepared: Sequence[ProjectedResponse],
    forms: Sequence[ProjectedForm],
    feature_sets: Sequence[FeatureSet],
) -> Screening:
    """Return responses, forms and features tested against the residual of a projection."""
    candidates = tuple(screen(projection, prepared))
    return Screening(projection, tuple(prepared), tuple(forms), tuple(feature_sets), candidates)
