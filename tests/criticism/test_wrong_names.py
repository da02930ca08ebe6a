"""A wrong effect that takes a part of what the cause does is not named alone, and a right one is not doubted by chance.

What is planted is worked out here, without the package's effects.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from null_data import fitted_to, redrawn
from test_chain_stage import signal, without

from imubayes.criticism import effect_selection
from imubayes.criticism.diagnose import judge
from imubayes.adequacy.adequacy_record import NoiseComparison
from imubayes.criticism.stepwise_search import SearchResult, search
from imubayes.criticism.unexplained_structure import unexplained_structure
from imubayes.display.diagnosis_sentences import sentence
from imubayes.inference.fitted_model import Fit


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


def cubic_drift(fitted: Fit) -> np.ndarray:
    """Return a drift of the gyro as the third power of the rate of the arm, where the unit turns back, (E,).

    A scale factor linear in the force gives it: the force grows with the square of the rate, and the unit turns as fast
    as the arm.
    """
    entries, campaign = fitted.model.entries, fitted.model.campaign
    gyro = [channel.kind for channel in campaign.channels].index("gyro")
    drift = np.zeros(len(entries))
    for place, run in enumerate(campaign.runs):
        rate = run.covariates["outer_rate"]
        here = (entries.run == place) & (entries.channel == gyro) & ~entries.closing
        if run.name in ("counter-z-up", "counter-y-up"):
            drift[here] = -1.87e-3 * (rate / rate.max())[entries.row[here]] ** 3
    return drift


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_rows_that_still_scatter_leave_a_name_open(monkeypatch, seed):
    """Without its cause a wobble of the table takes most of the drift; the rest has no plain form.

    The unit that turns back has next to no input rate: an asymmetry, which is of the input alone, explains none of it.
    """
    fitted = fitted_to("centrifuge", "centrifuge")
    planted = redrawn(fitted, seed, change=cubic_drift(fitted))
    assert judge(planted).groups[0].effects == ("gyro_scale_g_dependence",)
    found = without(monkeypatch, planted, "gyro_scale_g_dependence")
    assert found.verdict == "equivalent_effects"
    assert found.groups[0].effects == ("table_wobble",)
    assert "it may only resemble the cause" in sentence(found)
    # Planted fault: neither the record of the noise nor pairs of effects are looked at.
    monkeypatch.setattr(NoiseComparison, "excess_chi2", 0.0)
    monkeypatch.setattr(effect_selection, "rival_pairs", lambda *_: [])
    assert judge(planted).verdict == "missing_effect"
