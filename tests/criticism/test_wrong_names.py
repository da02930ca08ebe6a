"""A wrong effect that takes a part of what the cause does is not named alone, and a right one is not doubted by chance.

What is planted is worked out here, without the package's effects.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from null_data import fitted_to, redrawn
from test_chain_stage import signal

from imubayes.criticism.stepwise_search import SearchResult, search
from imubayes.criticism.unexplained_structure import unexplained_structure


@cache
def found_on_gx() -> SearchResult:
    """Return a search that found an asymmetry of gx, and nothing else."""
    fitted = fitted_to("hidden-none")
    found = search(
        redrawn(fitted, 5, change=np.where(fitted.model.entries.channel == 0, 1e-5 * abs(signal(fitted)), 0))
    )
    assert [group.leader.owners for group in found.groups] == [("gx",)]
    assert not unexplained_structure(found)
    return found


def leaving(channel: str, times: float, p: float) -> SearchResult:
    """Return the search as if it left structure on a channel, of so many times the Δχ² of what was found."""
    found = found_on_gx()
    some = next(each for each in found.first.structures if each.channel == channel)
    score = replace(some.score, delta_chi2=times * found.groups[0].leader.delta_chi2)
    return replace(found, remaining=((replace(some, score=score), p),))


@pytest.mark.parametrize("channel", ["gx", "ax"])
def test_larger_structure_contradicts_a_name_whatever_its_channel(channel):
    """A time skew turns gyros and accelerometers; without it a lever arm takes what the accelerometers show of it."""
    assert unexplained_structure(leaving(channel, 1.5, 1e-30))
    # On other channels a smaller one does not: something else may act there.
    assert bool(unexplained_structure(leaving(channel, 0.9, 1e-30))) == (channel == "gx")


@pytest.mark.parametrize("channel", ["gx", "ax"])
def test_large_but_hardly_significant_structure_contradicts_no_name(channel):
    """With six degrees of freedom between runs a form may leave next to nothing, and its Δχ² is large by chance."""
    assert not unexplained_structure(leaving(channel, 2.7, 7e-3))
