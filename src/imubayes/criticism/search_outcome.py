"""What the steps of a search hand on: the first pass with the noise of the model, and the outcome at some noise."""

from collections.abc import Sequence
from dataclasses import dataclass

from imubayes.criticism import thresholds
from imubayes.criticism.effect_selection import Selection, at_noise_left, deflate, span_over_shapes
from imubayes.criticism.equivalent_effects import EquivalenceGroup
from imubayes.criticism.free_form_dependence import Structure
from imubayes.criticism.multiple_testing import LookElsewhere
from imubayes.criticism.noise_tests import NoiseCandidate
from imubayes.criticism.projection import Projection
from imubayes.criticism.search_input import Screening
from imubayes.criticism.slow_noise_records import WanderingNoise

Significant = tuple[Structure, float]
"""A structure with its p-value, corrected for the number of looks."""


@dataclass(frozen=True)
class Corrections:
    """Look-elsewhere corrections: for the effects screened, and for the structure screened."""

    of_effect: LookElsewhere
    of_structure: LookElsewhere

    def significant(self, structures: Sequence[Structure], factor: float = 1.0) -> tuple[Significant, ...]:
        """Return the structures below `factor` times the threshold, with their corrected p-values."""
        corrected = [(structure, self.of_structure(structure.score.p)) for structure in structures]
        return tuple(pair for pair in corrected if pair[1] < factor * thresholds.FALSE_ALARM_STRUCTURE)


@dataclass(frozen=True)
class FirstPass:
    """What is significant with the noise of the model.

    Attributes
    ----------
    first : the screening before anything was projected out.
    selection : the effects that it shows.
    alarm : whether an effect or structure is significant.
    cleared : the projection without groups and without patterns that cannot be noise.
    """

    first: Screening
    corrections: Corrections
    noise: tuple[NoiseCandidate, ...]
    selection: Selection
    alarm: bool
    cleared: Projection


@dataclass(frozen=True)
class SearchOutcome:
    """First screening, the effects that it shows, the factor on the budget of false alarms, and noise as a rival."""

    first: Screening
    selection: Selection
    factor: float = 1.0
    wandering: WanderingNoise = ""

    @property
    def groups(self) -> tuple[EquivalenceGroup, ...]:
        """One per effect found, in order of evidence."""
        return self.selection.groups


def only(at: Screening, group: EquivalenceGroup) -> Selection:
    """Return the selection of one group."""
    last = deflate(at, span_over_shapes(at, group.leader))
    return Selection((group,), last, at_noise_left(last))
