"""Two effects that mend one another's shape are no two causes; two that explain the same as well are one group."""

from unittest.mock import Mock

import numpy as np
import pytest

from imubayes.criticism.equivalent_effects import equivalence_group
from imubayes.adequacy.projection import Projection, Strata
from imubayes.criticism.score_test import Candidate, ScoreTest
from imubayes.criticism.search_input import Screening
from imubayes.criticism.stepwise_search import SearchResult
from imubayes.criticism.unexplained_structure import _rivals

RATE = np.linspace(-1.0, 1.0, 201)


def stub(kind: type, **facts):
    """An object of a kind that knows these facts alone."""
    made = Mock(spec=kind)
    for name, value in facts.items():
        setattr(made, name, value)
    return made


def candidate(name: str, response: np.ndarray, owners: tuple[str, ...] = ("gx",)):
    """A candidate as screened, as far as the question looks at it: the mean is what the bias absorbs."""
    free = response - response.mean()
    found = stub(ScoreTest, fitted=3.0 * free, span=(free / np.linalg.norm(free))[:, None], variance=np.ones(1))
    return stub(Candidate, effect=name, owners=owners, score=found)


@pytest.mark.parametrize(
    ("other", "owners", "expected"),
    [
        (RATE**2, ("gx",), True),
        (RATE**2, ("gy",), False),
        (RATE**3, ("gx",), False),
        (np.sin(40 * RATE), ("gx",), False),
    ],
)
def test_what_could_do_most_of_what_the_leader_does(other, owners, expected):
    leader, second = candidate("asymmetry", np.abs(RATE)), candidate("second", other, owners)
    strata = stub(Strata, at_rows=lambda variance: np.full(len(RATE), variance[0]))
    look = stub(Screening, projection=stub(Projection, strata=strata), candidates=(leader, second))
    # Asked only for a second group that shares a channel with the first.
    together = stub(Candidate, effect="second", owners=("gx",))
    assert _rivals(stub(SearchResult, first=look), together, leader) is expected


@pytest.mark.parametrize(
    ("response", "doubt", "expected"),
    [
        (RATE**2, -48.0, True),
        # Odds of more than 20 to 1 against it.
        (RATE**2, -46.5, False),
        # As well founded, by something else.
        (np.sin(40 * RATE), -49.0, False),
    ],
)
def test_near_odds_for_the_same_are_one_group(response, doubt, expected):
    leader, other = candidate("asymmetry", np.abs(RATE)), candidate("other", response)
    # So large that what the other leaves is beyond all doubt were the leader the truth.
    leader.score.fitted = 20 * leader.score.fitted
    leader.log_p, other.log_p = -50.0, doubt
    leader.dof = other.dof = 1
    strata = stub(Strata, at_rows=lambda variance: np.full(len(RATE), variance[0]))
    found = equivalence_group(stub(Projection, strata=strata), leader, [leader, other], 1e-9)
    assert ("other" in found.effects) is expected
