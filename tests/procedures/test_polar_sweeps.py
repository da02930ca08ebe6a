"""Polar sweeps with any axis along the pole, repeated or not, of a gyro written down here from the frames.

Plain NumPy: z of the table is the pole, up is (0, −cos L, sin L) in its axes at table angle 0, body = mountingᵀ·Rz(−φ).
"""

import numpy as np
import pytest

from imubayes.foundations.campaign_data import Campaign, Channel, Mounting, Run, Site, Table
from imubayes.procedures import classical
from imubayes.procedures.textbook import Estimate, Undetermined

LATITUDE = np.radians(41.0)
POLE_RATE = 15.041067  # deg/h
DEGREE_PER_HOUR = np.pi / 180 / 3600
# Columns are the input, output and spin axes in table axes; S = I × O.
SEATS = {
    "O-Np": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "O-Sp": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "S-Np": np.eye(3),
    "S-Sp": np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]]),
    "I-Np": np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]),
}
NAMES = ["D_F", "D_I", "D_O", "D_S", "D_II", "D_OO", "D_SS", "D_IO", "D_OS", "D_SI"]


def measured_drift(seat, angle, d):
    up = np.array([-np.cos(LATITUDE) * np.sin(angle), -np.cos(LATITUDE) * np.cos(angle), np.full(len(angle), 1.0)])
    up[2] *= np.sin(LATITUDE)
    i, o, s = SEATS[seat].T @ up
    terms = [1, i, o, s, i * i, o * o, s * s, i * o, o * s, s * i]
    return sum(one * term for one, term in zip(d, terms, strict=True)) + POLE_RATE * SEATS[seat][2, 0]


def campaign(order, d, seed, noise=0.004, offset=0.0, positions=12, temperature=lambda k: 25.0):
    """Sweeps in the given mountings; noise of a position and offset of a run in deg/h."""
    generator = np.random.default_rng(seed)
    angle = 2 * np.pi * np.arange(positions) / positions
    runs = []
    for place, seat in enumerate(order):
        drift = measured_drift(seat, angle, d) + offset * generator.normal() + noise * generator.normal(size=positions)
        zero, one = np.zeros(positions), np.full((positions, 1), np.nan)
        columns = {"table_angle": angle, "table_rate": zero, "table_angle_span": zero}
        columns["temperature"] = np.full(positions, float(temperature(place)))
        observed = (0.01 * drift + 0.3)[:, None]
        runs.append(Run(f"{place}-{seat}", "polar_tumble", "polar", seat, columns, observed, zero + 100, one))
    channel = Channel("g", "gyro", np.eye(3), "mA", 0.01, "deg/h", 0.01 / DEGREE_PER_HOUR, offset=0.3)
    seats = {name: Mounting(name, matrix) for name, matrix in SEATS.items()}
    site = Site(LATITUDE, 0.0, 9.8)
    return Campaign("polar", site, (channel,), {"polar": Table("polar", 0.0, LATITUDE)}, seats, tuple(runs))


def drawn(seed):
    return np.random.default_rng(1000 + seed).normal(size=10) * [1, 3, 3, 3, 0.2, 0.2, 0.2, 0.2, 0.2, 0.2]


def value_of(symbol, d):
    """Evaluate a written combination of drift coefficients."""
    sine, cosine = np.sin(LATITUDE), np.cos(LATITUDE)
    text = symbol.replace("sin²L", str(sine**2)).replace("cos²L", str(cosine**2)).replace("sinL", str(sine))
    return eval(text.replace("½", "0.5*").replace("·", "*"), dict(zip(NAMES, d, strict=True)))


JOINT = {"gyro_bias.bias": "D_F", "gyro_g_sensitivity.d_": "D_", "gyro_g2_sensitivity.d_": "D_"}


def symbol_of(name):
    bare = name.removesuffix("[g]")
    for start, symbol in JOINT.items():
        if bare.startswith(start):
            return symbol if symbol == "D_F" else symbol + bare.removeprefix(start).upper()
    return bare


def scores(found, d):
    estimates = [one for one in found if isinstance(one, Estimate) and not one.name.startswith("repeat")]
    assert all(one.uncertainty.startswith("type A") for one in estimates)
    return {symbol_of(one.name): (one.value - value_of(symbol_of(one.name), d)) / one.sd for one in estimates}


@pytest.mark.parametrize(
    ("order", "together"),
    [
        (["S-Np", "S-Sp"], {"D_II-D_OO", "D_F+D_SS·sin²L+½(D_II+D_OO)·cos²L"}),
        (["S-Np"], {"D_II-D_OO"}),
        (["O-Np", "O-Sp"], {"D_II-D_SS", "D_F+D_OO·sin²L+½(D_II+D_SS)·cos²L"}),
        (["O-Np", "O-Sp", "I-Np"], {"D_II-D_SS", "D_II-D_OO", "D_F+D_II"}),
        (["O-Np", "O-Sp", "S-Np", "S-Sp"], {"D_II-D_SS", "D_II-D_OO", "D_F+D_II"}),
        (["O-Np", "I-Np"], {"D_II-D_SS"}),
    ],
)
def test_every_set_of_sweeps_has_an_evaluation(order, together):
    found = {}
    for seed in range(30):
        d = drawn(seed)
        for symbol, score in scores(classical(campaign(order, d, seed, positions=24)), d).items():
            found.setdefault(symbol, []).append(score)
    assert together <= found.keys()
    for symbol, values in found.items():
        assert len(values) == 30, symbol
        assert 0.6 < np.sqrt(np.mean(np.square(values))) < 1.5, symbol
    assert 0.85 < np.sqrt(np.mean(np.square(list(found.values())))) < 1.2


def test_all_repeated_sweeps_are_used_and_their_repeatability_is_given():
    """With an offset of each run the scatter between the sweeps is what their means scatter by."""
    order = ["O-Np", "O-Sp", "O-Np", "O-Sp", "O-Np", "O-Sp", "O-Np", "O-Sp"]
    d_o, stated, total = [], [], []
    for seed in range(40):
        d = drawn(seed)
        found = classical(campaign(order, d, seed, offset=0.05))
        score = scores(found, d)
        d_o.append(score["D_O"])
        (each,) = [one for one in found if isinstance(one, Estimate) and one.name == "repeatability(D_O)[g]"]
        assert each.run.count(",") == 7
        stated.append(each.value)
        assert each.sd == pytest.approx(each.value / np.sqrt(12))
        total.append(score["D_I"])
    # One determination, half the difference of two sweeps over sin L.
    assert np.mean(stated) == pytest.approx(0.05 / np.sqrt(2) / np.sin(LATITUDE), rel=0.1)
    assert 0.7 < np.sqrt(np.mean(np.square(d_o))) < 1.4
    assert 0.5 < np.sqrt(np.mean(np.square(total))) < 1.2
    # Fault planted: the scatter within the sweeps alone denies the offsets.
    alone = [scores(classical(campaign(order[:2], drawn(s), s, offset=0.05)), drawn(s))["D_O"] for s in range(10)]
    assert np.sqrt(np.mean(np.square(alone))) > 5


def test_sweeps_at_two_temperatures_are_two_evaluations():
    order = ["O-Np", "O-Sp"] * 2
    found = classical(campaign(order, drawn(1), 1, temperature=lambda k: 20.0 if k < 2 else 60.0))
    names = [one.run for one in found if isinstance(one, Estimate) and one.name == "gyro_g_sensitivity.d_i[g]"]
    assert names == ["0-O-Np, 1-O-Sp", "2-O-Np, 3-O-Sp"]


def test_the_advice_asks_for_what_is_missing_and_not_for_what_is_there():
    def advice(order):
        (said,) = [one.sentence for one in classical(campaign(order, drawn(1), 1)) if isinstance(one, Undetermined)]
        return said

    assert "D_F, D_II, D_OO, D_SS are not separated from each other" in advice(["O-Np", "O-Sp"])
    assert "would determine" in advice(["O-Np", "O-Sp"])
    assert "no sweep separates them" in advice(["O-Np", "O-Sp", "I-Np"])


def test_four_positions_and_missing_rows():
    d = drawn(3)
    four = {
        one.name: one
        for one in classical(campaign(["O-Np", "O-Sp"], d, 1, noise=0.0, positions=4))
        if isinstance(one, Estimate)
    }
    assert four["gyro_g_sensitivity.d_o[g]"].value == pytest.approx(d[2], abs=1e-9)
    whole = campaign(["O-Np", "O-Sp"], d, 1, noise=0.0, positions=12)
    whole.runs[0].observed[3] = np.nan
    found = {one.name: one for one in classical(whole) if isinstance(one, Estimate)}
    assert found["gyro_g_sensitivity.d_i[g]"].value == pytest.approx(d[1], abs=1e-9)
    few = classical(campaign(["O-Np"], d, 1, positions=3))
    assert "4 or more evenly spaced" in few[0].sentence
