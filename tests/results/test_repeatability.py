"""Two calibrations of one simulated unit: differences as uncertain as stated, and one that moved is found."""

import sys
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from test_predicted_runs import ROOT, scales

import imubayes
from imubayes.foundations.campaign_data import Campaign
from imubayes.inference.fitted_model import Fit
from imubayes.inference.parameter_fit import fit_at
from imubayes.inference.run_fit import joint_fit
from imubayes.results import repeatability as module
from imubayes.results.repeatability import Repeatability, repeatability_of

sys.path.insert(0, str(ROOT / "data" / "generators"))
PAIRS = 6
SEATS = ("O-north", "O-south", "I-north")


def campaigns(folder: Path, seed: int) -> tuple[Campaign, Campaign]:
    """Return the runs of two calibrations of a unit on one table, on seats that it did not leave."""
    once = __import__("polar_tumble").plan(seed)
    again = [
        replace(each, name=f"{each.name}-2", start=(each.start or "").replace("2026", "2027")) for each in once.runs
    ]
    __import__("simulate").write_simulated(folder / f"unit-{seed}", replace(once, runs=(*once.runs, *again)), seed)
    whole = imubayes.load_campaign(folder / f"unit-{seed}")
    first, second = (whole.only(*[each.name for each in runs]) for runs in (once.runs, again))
    return first, second


def fitted(campaign: Campaign) -> Fit:
    return joint_fit(imubayes.bind(imubayes.load_model(ROOT / "models/polar-tumble.toml"), campaign), None)


def compared(pair: tuple[Fit, Fit], **options) -> Repeatability:
    return repeatability_of(*pair, (scales(pair[0]), scales(pair[1])), **options)


@pytest.fixture(scope="module")
def pairs(tmp_path_factory) -> list[tuple[Fit, Fit]]:
    folder = tmp_path_factory.mktemp("pairs")
    both = [campaigns(folder, seed) for seed in range(1, PAIRS + 1)]
    return [(fitted(first), fitted(second)) for first, second in both]


@pytest.fixture(scope="module")
def pair(tmp_path_factory) -> tuple[Fit, Fit]:
    first, second = campaigns(tmp_path_factory.mktemp("pair"), 1)
    return fitted(first), fitted(second)


def spread(pairs) -> tuple[float, float]:
    """Return the rms of differences in their deviations, and the root of χ² per degree of freedom."""
    found = [compared(each) for each in pairs]
    single = [2 * line.e_n for each in found for line in each.quantities]
    chi2 = sum(each.chi2 for each in found) / sum(each.freedom for each in found)
    return float(np.sqrt(np.mean(np.square(single)))), float(np.sqrt(chi2))


@pytest.mark.slow
def test_differences_are_as_uncertain_as_stated(pairs, monkeypatch):
    single, together = spread(pairs)
    print(f"\nrms {single:.3f}, together {together:.3f}")
    assert single == pytest.approx(1.0, abs=0.2)
    assert together == pytest.approx(1.0, abs=0.15)
    # Taken as independent, what both share counts twice, and the differences look too small.
    monkeypatch.setattr(module, "_cross", lambda one, other, alike: np.zeros((len(one.names), len(other.names))))
    single, together = spread(pairs)
    print(f"as independent: rms {single:.3f}, together {together:.3f}")
    assert single < 0.8


@pytest.mark.slow
def test_one_that_moved_is_found(pair, tmp_path):
    assert compared(pair).agree
    _, second = campaigns(tmp_path, 1)
    moved = replace(second, runs=tuple(replace(run, observed=run.observed + 5e-3) for run in second.runs))
    found = compared((pair[0], fitted(moved)))
    assert not found.agree
    assert not found.pooled
    bias = next(each for each in found.quantities if each.name == "gyro_bias.bias[g]")
    assert bias.moved
    assert bias.difference == pytest.approx(5e-3 / 0.01, abs=3 * bias.difference_sd)  # mA over mA per deg/h
    assert "gyro_bias.bias[g] moved by" in str(found)
    assert "as left 2026-06-01" in str(found)
    assert found.days == pytest.approx(365)


@pytest.mark.slow
def test_both_as_one_are_the_fit_to_all_runs(pair, tmp_path):
    first, second = campaigns(tmp_path, 1)
    whole = fitted(replace(first, runs=(*first.runs, *second.runs)))
    told = dict(zip(whole.model.layout.names, values_of(whole), strict=True))
    h = whole.h
    # At one noise for all: the fit to all runs knows it better, which moves estimates by half a deviation.
    one, other = (
        replace(fit, z=np.asarray(fit_at(fit.model.problem, jnp.asarray(fit.z), jnp.asarray(h))), h=h) for fit in pair
    )
    lines = [each for each in repeatability_of(one, other, (h, h)).quantities if each.name in told]
    assert len(lines) > 5
    for each in lines:
        assert each.pooled is not None
        assert each.pooled_sd is not None
        assert each.pooled == pytest.approx(told[each.name], abs=0.02 * each.pooled_sd)
        assert each.pooled_sd < min(each.first_sd, each.second_sd)


def values_of(fit: Fit) -> list[float]:
    return np.asarray(fit.model.to_units(jnp.asarray(np.append(fit.z, fit.h))))[: len(fit.z)].tolist()


def test_what_cannot_be_compared_is_refused(pair, tmp_path):
    first, second = pair
    other = replace(second, model=replace(second.model, campaign=replace(second.model.campaign, serial="another")))
    with pytest.raises(imubayes.InputError, match="is of unit 'another'"):
        compared((first, other))
    with pytest.raises(imubayes.InputError, match=r"all runs|have the run"):
        compared((first, first))
    changed = compared(pair, changed=SEATS)
    assert changed.changed == SEATS
    assert not any("mounting_error" in each.name for each in changed.quantities)
