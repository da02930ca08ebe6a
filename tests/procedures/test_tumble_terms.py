"""Every term of the tumble model of an accelerometer written down here: estimated, or named as not determined."""

import numpy as np
import pytest

from imubayes.foundations.campaign_data import Campaign, Channel, Mounting, Run, Site, Table
from imubayes.procedures import classical
from imubayes.procedures.textbook import Estimate, Undetermined

G = 9.81
TRUE = {"K0": 300e-6, "K2": 25e-6, "K3": 60e-6, "K_oq": -150e-6, "δ": 90 / 206264.8, "K_ix": 15e-6}
NAMES = {
    "accel_bias.bias[a]": ("K0", 1e6),
    "accel_quadratic.quadratic[a]": ("K2", 1e6),
    "accel_cubic.cubic[a]": ("K3", 1e6),
    "accel_odd_quadratic.odd_quadratic[a]": ("K_oq", 1e6),
    "accel_misalignment.toward_p[a]": ("δ", 206264.8),
    "accel_cross_coupling.k_ip[a]": ("K_ix", 1e6),
}


def evaluated(positions, seed=0, noise=0.0, start=0.0, **changed):
    """Horizontal axis to the North: at table angle 0 x is East and y down; a_i along y, a_p along x."""
    true = TRUE | changed
    angle = start + 2 * np.pi * np.arange(positions) / positions
    a, x = -np.cos(angle), -np.sin(angle)
    output = true["K0"] + a + true["K2"] * a**2 + true["K3"] * a**3 + true["K_oq"] * a * np.abs(a)
    output = 2000 * (output + true["δ"] * x + true["K_ix"] * a * x)
    output += 2000 * noise * np.random.default_rng(seed).normal(size=positions)
    # Input axis along y of the body, output axis along z (the axis of rotation), pendulous axis I × O = x.
    axes = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
    channel = Channel("a", "accelerometer", axes, "V", 2000.0, "g", 2000.0 / G)
    zero, none = np.zeros(positions), np.full((positions, 1), np.nan)
    columns = {"table_angle": angle, "table_rate": zero, "table_angle_span": zero}
    run = Run("tumble", "dividing_head", "head", "flat", columns, output[:, None], zero + 100, none)
    site, head = Site(0.6, 0.0, G), {"head": Table("head", 0.0, 0.0)}
    found = classical(Campaign("t", site, (channel,), head, {"flat": Mounting("flat", np.eye(3))}, (run,)))
    estimates = {one.name: one for one in found if isinstance(one, Estimate)}
    return estimates, next(one.sentence for one in found if isinstance(one, Undetermined))


@pytest.mark.parametrize("positions", [12, 16, 24])
def test_all_terms_are_estimated_exactly(positions):
    found, said = evaluated(positions, start=0.02)
    assert found["scale_factor[a]"].value == pytest.approx(2000.0, rel=1e-9)
    for name, (symbol, factor) in NAMES.items():
        assert found[name].value == pytest.approx(TRUE[symbol] * factor, rel=1e-6), name
    assert "K_pp is not separated from K0 and K2" in said
    assert "K_oq" not in said
    total = next(one for name, one in found.items() if name.startswith("K1+"))
    assert total.value == pytest.approx(2000 * (1 + 0.75 * TRUE["K3"] + 8 / (3 * np.pi) * TRUE["K_oq"]), rel=1e-9)


@pytest.mark.parametrize(("positions", "named"), [(4, ["K3", "K_oq", "K_ip"]), (6, ["K_oq"]), (8, ["K_oq"])])
def test_few_positions_name_what_they_do_not_determine(positions, named):
    found, said = evaluated(positions)
    for symbol in named:
        assert symbol in said
    assert "accel_odd_quadratic.odd_quadratic[a]" not in found


def test_uncertainties_over_replicates():
    scores = {name: [] for name in NAMES}
    for seed in range(200):
        found, _ = evaluated(24, seed, noise=5e-6)
        for name, (symbol, factor) in NAMES.items():
            scores[name].append((found[name].value - TRUE[symbol] * factor) / found[name].sd)
    for name, values in scores.items():
        assert 0.85 < np.sqrt(np.mean(np.square(values))) < 1.2, name
