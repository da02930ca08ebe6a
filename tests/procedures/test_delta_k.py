"""Lines of a converter written down here: what each input is compared with, and decisions by uncertain slopes."""

import numpy as np
import pytest

from imubayes.foundations.campaign_data import Campaign, Channel, Mounting, Run, Site, Table
from imubayes.procedures import classical
from imubayes.procedures.textbook import Estimate, compared_probability

G = 9.8
SCALE, OFFSET = 20000.0, 500.0  # pulse/s per g, pulse/s
CURRENT = 1.2e-3  # A per g


def ramp(name, level, *, gain, offset, noise=0.0, seed=0, injected=False, sensor=0.0, rows=30):
    """Output at `level` g over 15 … 45 °C: gain drift in ppm/°C and offset drift in pulse/s/°C of the converter.

    `sensor` is a drift of the sensor's own output, ppm/°C: not in an injected current.
    """
    temperature = np.linspace(15, 45, rows)
    sensed = level * (1 + (0 if injected else 1e-6 * sensor) * (temperature - 25))
    output = SCALE * sensed * (1 + 1e-6 * gain * (temperature - 25)) + offset * (temperature - 25) + OFFSET
    output = output + noise * np.random.default_rng(seed).normal(size=rows)
    zero, none = np.zeros(rows), np.full((rows, 1), np.nan)
    columns = {"converter_temperature": temperature, "table_angle": zero, "table_rate": zero, "table_angle_span": zero}
    if injected:
        columns["current"] = np.full(rows, CURRENT * level)
        return Run(name, "current_injection", None, None, columns, output[:, None], zero + 12, none)
    seat = "up" if level == 1 else "lean"
    return Run(name, "thermal_ramp", "plate", seat, columns, output[:, None], zero + 12, none)


def found(*runs, threshold=None):
    axes = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    channel = Channel("a", "accelerometer", axes, "pulse/s", SCALE, "g", SCALE / G, OFFSET, None, CURRENT / G)
    lean = np.array([[1, 0, 0], [0, 0.5, -np.sqrt(0.75)], [0, np.sqrt(0.75), 0.5]])  # the input axis sees g/2
    seats = {"up": Mounting("up", np.eye(3)), "lean": Mounting("lean", lean)}
    plate = {"plate": Table("plate", 0.0, np.pi / 2)}
    campaign = Campaign("k", Site(0.6, 0.0, G), (channel,), plate, seats, tuple(runs))
    return {one.name: one for one in classical(campaign, threshold) if isinstance(one, Estimate)}


def test_line_slope_and_intercept_and_both_delta_k():
    made = found(ramp("one", 1, gain=20, offset=0.2), ramp("half", 0.5, gain=20, offset=0.2))
    assert made["slope[a,one]"].value == pytest.approx(0.4 + 0.2)
    assert made["slope[a,one]"].unit == "pulse/s/degC"
    assert made["intercept[a,one]"].value == pytest.approx(SCALE + OFFSET - 25 * 0.6)
    # Per unit of input 0.6/20000 at 1 g and 0.4/10000 at half a g; raw 0.6 and 0.4.
    assert made["delta_k[a,half]"].value == pytest.approx(100 / 3)
    assert made["delta_k_raw[a,half]"].value == pytest.approx(100 / 3)
    pure = found(ramp("one", 1, gain=0, offset=0.2), ramp("half", 0.5, gain=0, offset=0.2))
    assert pure["delta_k[a,half]"].value == pytest.approx(100)
    assert pure["delta_k_raw[a,half]"].value == pytest.approx(0, abs=1e-9)


def test_an_injected_input_is_compared_with_the_injected_1_g():
    """The sensor drifts by 15 ppm/°C: in the 1 g ramp, in no injected current."""
    runs = [ramp("one", 1, gain=20, offset=0.0, sensor=15), ramp("twelve", 12, gain=20, offset=0.0, injected=True)]
    alone = found(*runs)
    assert alone["delta_k[a,twelve]"].value == pytest.approx(100 * 15 / 35, rel=1e-3)
    both = found(*runs, ramp("inject-1", 1, gain=20, offset=0.0, injected=True))
    assert both["delta_k[a,twelve]"].run == "twelve, inject-1"
    assert both["delta_k[a,twelve]"].value == pytest.approx(0, abs=1e-6)
    assert "the injected 1 g line applies" in both["delta_k[a,twelve]"].decision
    assert "delta_k[a,inject-1]" not in both


def test_an_uncertain_delta_k_decides_nothing():
    """Δk near 12 ± 14 % at a threshold of 10 %: the value alone would send half of the units each way."""
    seen = {"applies": 0, "own": 0, "not decided": 0}
    for seed in range(60):
        runs = [ramp("one", 1, gain=20, offset=0.0, noise=2.2, seed=seed)]
        runs.append(ramp("twelve", 12, gain=22.4, offset=0.0, noise=2.0, seed=1000 + seed, injected=True))
        one = found(*runs)["delta_k[a,twelve]"]
        for word in seen:
            seen[word] += word in one.decision
    assert seen["not decided"] >= 50
    sharp = [ramp("one", 1, gain=20, offset=0.0, noise=0.01)]
    sharp.append(ramp("twelve", 12, gain=22.4, offset=0.0, noise=0.01, injected=True))
    assert "needs its own line" in found(*sharp)["delta_k[a,twelve]"].decision
    assert "line applies" in found(*sharp, threshold=0.2)["delta_k[a,twelve]"].decision
    assert "threshold 20 %" in found(*sharp, threshold=0.2)["delta_k[a,twelve]"].decision


def test_wrong_decisions_are_rare():
    """At the edge of the threshold each answer is wrong in at most one case of twenty."""
    wrong = 0
    for seed in range(300):
        runs = [ramp("one", 1, gain=20, offset=0.0, noise=0.2, seed=seed)]
        runs.append(ramp("twelve", 12, gain=22.2, offset=0.0, noise=2.0, seed=2000 + seed, injected=True))
        wrong += "line applies" in found(*runs)["delta_k[a,twelve]"].decision
    assert wrong / 300 < 0.05


@pytest.mark.parametrize(
    ("probability", "said"),
    [(0.0, "< 0.001"), (2e-4, "< 0.001"), (0.014, "= 0.014"), (0.5, "= 0.5"), (0.9995, "> 0.999"), (1.0, "> 0.999")],
)
def test_a_probability_from_draws_is_never_said_to_be_zero_or_one(probability, said):
    assert compared_probability(probability) == said
