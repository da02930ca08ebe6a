"""Rate series of a gyro written down here: k′, F₀, bias and repeatability at two temperatures.

Plain NumPy: vertical table axis, input axis at θ from it, Earth rate of which ω sin L lies along the table axis.
"""

import numpy as np
import pytest

from imubayes.foundations.campaign_data import Campaign, Channel, Mounting, Run, Site, Table
from imubayes.procedures import classical
from imubayes.procedures.textbook import Estimate

LATITUDE = np.radians(52.0)
EARTH = 15.041067  # deg/h
DEGREE = np.pi / 180
THETA = np.radians(54.7356)
TILTED = np.array([np.sin(THETA), 0.0, np.cos(THETA)])
RATES = np.array([300, -300, 60, -60, 10, -10, 1.0, -1])


def axes_of(first):
    second = np.array([0.0, 1, 0])
    return np.array([first, second, np.cross(first, second)])


def run_of(name, temperature, generator, *, scale, bias=25.0, rest=True, noise=0.02, slope=0.0):
    """Outputs in pulse/s of a gyro of `scale` pulse/s per deg/s with `bias` in deg/h; means over whole turns."""
    rate = np.concatenate([[0.0], RATES, [0.0]]) if rest else RATES
    angle = np.where(rate == 0, 0.0, np.nan)
    earth = EARTH * np.sin(LATITUDE) * np.cos(THETA) * np.ones_like(rate)
    # At table angle 0 x of the table points East: the input axis, in the x-z plane, sees no North component at rest.
    output = scale * (rate * np.cos(THETA) + (earth + bias) / 3600) + 7.0 + noise * generator.normal(size=len(rate))
    span = np.where(rate == 0, 0.0, 2 * np.pi)
    columns = {"table_rate": rate * DEGREE, "table_angle": angle, "table_angle_span": span}
    if temperature is not None:
        columns["temperature"] = np.full(len(rate), temperature) + 0.3 * generator.normal(size=len(rate))
    shape = np.full((len(rate), 1), np.nan)
    return Run(name, "rate_table", "rate", "seat", columns, output[:, None], np.full(len(rate), 100), shape)


def campaign(runs):
    scale = 1000 / DEGREE
    channel = Channel("g", "gyro", axes_of(TILTED), "pulse/s", 1000.0, "deg/s", scale, offset=7.0)
    table = {"rate": Table("rate", 0.0, np.pi / 2)}
    return Campaign("series", Site(LATITUDE, 0.0, 9.8), (channel,), table, {"seat": Mounting("seat", np.eye(3))}, runs)


def estimates(runs, name):
    return [one for one in classical(campaign(tuple(runs))) if isinstance(one, Estimate) and one.name == name]


def twelve(seed, spread=30e-6):
    generator = np.random.default_rng(seed)
    return [
        run_of(f"{t}-{k}", t, generator, scale=1000 * (1 + spread * generator.normal() + 2e-6 * t))
        for t in (-40.0, 60.0)
        for k in range(6)
    ]


@pytest.mark.parametrize(("draws", "wide"), [(15, 2.0), pytest.param(60, 1.0, marks=pytest.mark.slow)])
def test_six_series_at_each_of_two_temperatures_have_their_repeatability(draws, wide):
    at, pooled, overall = [], [], []
    for seed in range(draws):
        runs = twelve(seed)
        each = estimates(runs, "repeatability[g]")
        assert [one.run.count(",") for one in each] == [5, 5]
        assert "at -40 °C" in each[0].method
        assert all(one.sd == pytest.approx(one.value / np.sqrt(10)) for one in each)
        at += [one.value for one in each]
        pooled += [one.value for one in estimates(runs, "repeatability_pooled[g]")]
        overall += [one.value for one in estimates(runs, "repeatability_overall[g]")]
        (slope,) = estimates(runs, "temperature_sensitivity[g]")
        assert slope.value == pytest.approx(2.0, abs=1.5)
    assert np.sqrt(np.mean(np.square(at))) == pytest.approx(30, rel=0.08 * wide)
    assert np.sqrt(np.mean(np.square(pooled))) == pytest.approx(30, rel=0.06 * wide)
    # Half of six series shifted by 200 ppm against the other half.
    assert np.mean(overall) == pytest.approx(np.sqrt(12 / 11 * 100**2 + 30**2), rel=0.05 * wide)


def test_series_at_one_temperature_have_one_repeatability():
    runs = twelve(1)[:6]
    assert len(estimates(runs, "repeatability[g]")) == 1
    assert not estimates(runs, "repeatability_overall[g]")
    assert not estimates(runs, "temperature_sensitivity[g]")
    generator = np.random.default_rng(0)
    unknown = [run_of(str(k), None, generator, scale=1000) for k in range(3)]
    assert len(estimates(unknown, "repeatability[g]")) == 1


@pytest.mark.parametrize("rest", [True, False])
def test_line_and_bias_with_and_without_rows_at_rest(rest):
    """The bias without the Earth rate, F₀ and k′ without an angle; scores of type A uncertainties over replicates."""
    scores = {"gyro_bias.bias[g]": [], "k′[g,seat]": [], "F₀[g,seat]": [], "scale_factor[g]": []}
    zero = 1000.5 * (25.0 + EARTH * np.sin(LATITUDE) * np.cos(THETA)) / 3600
    truth = {"gyro_bias.bias[g]": 25.0, "k′[g,seat]": 1000.5 * np.cos(THETA), "scale_factor[g]": 1000.5}
    truth["F₀[g,seat]"] = 0.0 if rest else zero
    for seed in range(120):
        runs = [run_of("one", 25.0, np.random.default_rng(seed), scale=1000.5, rest=rest)]
        for name, values in scores.items():
            (one,) = estimates(runs, name)
            assert one.uncertainty.startswith("type A")
            values.append((one.value - truth[name]) / one.sd)
    for name, values in scores.items():
        assert 0.8 < np.sqrt(np.mean(np.square(values))) < 1.5, name  # Student t of 6 or 8 degrees: 1.15 … 1.22


def test_the_earth_rate_across_the_axis_is_known_where_the_angle_is():
    """A record at rest with the input axis turned to the North sees ω cos L sin θ more: not a bias."""
    run = run_of("north", 25.0, np.random.default_rng(1), scale=1000.0, noise=0.0)
    run.covariates["table_angle"][0] = np.pi / 2  # x of the table turns from East to North
    run.observed[0, 0] += 1000 * EARTH * np.cos(LATITUDE) * np.sin(THETA) / 3600
    (one,) = estimates([run], "gyro_bias.bias[g]")
    assert one.value == pytest.approx(25.0, abs=1e-6)
