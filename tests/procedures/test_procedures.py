"""A run as its procedure sees it: nodes, weights, and the motion as drawn."""

import math
from dataclasses import replace

import numpy as np
import pytest

from imubayes.foundations.campaign_data import Campaign, Run
from imubayes.foundations.errors import InputError
from imubayes.inference.candidate_runs import candidate_runs
from imubayes.procedures import PROCEDURES
from imubayes.procedures.kinematics import Stimulus
from small_campaign import campaign, driven_campaign, tumble_campaign, wide_campaign

CAMPAIGN = campaign()
RUNS = {run.name: run for run in CAMPAIGN.runs}


def stimulus(run: Run, among: Campaign = CAMPAIGN) -> Stimulus:
    return PROCEDURES[run.procedure].stimulus(run, among)


def with_columns(name: str, **columns: float) -> Run:
    run = RUNS[name]
    filled = {key: np.full(run.rows, value) for key, value in columns.items()}
    return replace(run, covariates={**run.covariates, **filled})


def row_means(found: Stimulus, values: np.ndarray) -> np.ndarray:
    return np.bincount(found.row, weights=found.weight * values)


@pytest.mark.parametrize("name", RUNS)
def test_weights_of_every_row_sum_to_one(name):
    found = stimulus(RUNS[name])
    np.testing.assert_allclose(row_means(found, np.ones(len(found.row))), np.ones(RUNS[name].rows), atol=1e-15)
    assert np.all(found.weight > 0)


@pytest.mark.parametrize(("name", "nodes"), [("rate-flat", 4), ("head-flat-20", 12)])
def test_a_mean_over_whole_turns_is_exact_below_the_number_of_nodes(name, nodes):
    found = stimulus(with_columns(name, table_angle=np.nan, table_angle_span=2 * np.pi))
    for harmonic in range(1, nodes):
        for wave in (np.cos, np.sin):
            mean = row_means(found, wave(harmonic * found.table_angle + 0.3))
            np.testing.assert_allclose(mean, 0.0, atol=1e-14)
    assert len(found.row) == nodes * RUNS[name].rows


@pytest.mark.parametrize("span", [1e-6, 0.2, -0.2, 1.0, np.pi / 2])
@pytest.mark.parametrize("harmonic", [1, 2, 3])
def test_a_mean_over_an_arc_is_the_integral(span, harmonic):
    found = stimulus(with_columns("head-flat-20", table_angle=0.4, table_angle_span=span))
    mean = row_means(found, np.cos(harmonic * found.table_angle))
    half = harmonic * span / 2
    expected = np.cos(harmonic * 0.4) * np.sin(half) / half
    # The remainder of five Gauss–Legendre nodes: (5!)⁴/(11 (10!)³) times the tenth derivative over the arc.
    remainder = (harmonic * span) ** 10 * math.factorial(5) ** 4 / (11 * math.factorial(10) ** 3)
    np.testing.assert_allclose(mean, expected, rtol=0, atol=remainder + 1e-14)


def test_a_position_at_rest_has_one_node():
    found = stimulus(RUNS["head-flat-20"])
    np.testing.assert_array_equal(found.row, np.arange(8))
    np.testing.assert_array_equal(found.table_angle, RUNS["head-flat-20"].covariates["table_angle"])


def test_circumstances_follow_their_rows():
    found = stimulus(RUNS["rate-pyramid"])
    rates = RUNS["rate-pyramid"].covariates["table_rate"]
    np.testing.assert_array_equal(found.ambient["table_rate"], rates[found.row])
    np.testing.assert_array_equal(found.ambient["temperature"], np.full(len(found.row), 35.0))
    np.testing.assert_array_equal(found.mounting[0], CAMPAIGN.mountings["pyramid"].body_to_table)


@pytest.mark.parametrize(
    ("name", "there", "missing"),
    [
        ("rate-flat", {"turning", "temperature", "converter_temperature"}, {"injection", "current", "time"}),
        ("head-flat-20", {"temperature", "table_angle"}, {"turning", "injection"}),
        ("ramp", {"time", "converter_temperature"}, {"turning", "injection"}),
        ("inject", {"injection", "current", "converter_temperature"}, {"turning", "temperature"}),
    ],
)
def test_a_run_supplies_what_it_recorded(name, there, missing):
    supplied = stimulus(RUNS[name]).supplies
    assert there <= supplied
    assert not missing & supplied


def test_without_a_table_the_unit_stands_level_and_still():
    found = stimulus(RUNS["inject"])
    np.testing.assert_allclose(found.base, np.tile(np.eye(3), (len(found.row), 1, 1)), atol=1e-15)
    np.testing.assert_array_equal(found.table_rate, 0.0)
    assert found.injected


def test_poses_of_a_tumble_are_mountings_of_their_own():
    among = tumble_campaign()
    found = stimulus(among.runs[0], among)
    np.testing.assert_array_equal(found.pose, np.arange(5))
    np.testing.assert_array_equal(found.mounting, among.runs[0].tumble.attitude)


def test_a_tumble_without_its_turns_is_refused():
    among = tumble_campaign()
    with pytest.raises(InputError) as caught:
        stimulus(replace(among.runs[0], tumble=None), among)
    assert "tumble" in caught.value.issues[0].where


@pytest.mark.parametrize("name", PROCEDURES)
def test_a_procedure_says_what_it_is(name):
    procedure = PROCEDURES[name]
    assert procedure.name == name
    assert procedure.reference
    assert type(procedure).__doc__


def supplied(name: str) -> frozenset[str]:
    among = wide_campaign()
    run = next(run for run in among.runs if run.name == name)
    return PROCEDURES[run.procedure].stimulus(run, among).supplies


def test_what_is_derived_is_supplied_where_it_is_known():
    assert {"temperature_rate", "converter_temperature_rate", "campaign_time", "power_on"} <= supplied("cycle-fast")
    assert {"converter_temperature_rate"} == {one for one in supplied("ramp") if one.endswith("_rate")} - {"table_rate"}
    assert {"acceleration", "turning"} <= supplied("swept")
    assert "vibration" in supplied("shaken")
    assert not {"temperature_rate", "acceleration", "vibration"} & supplied("rate-flat")


def test_the_time_of_a_campaign_goes_on_from_run_to_run():
    among = wide_campaign()
    runs = {run.name: run for run in among.runs}

    def times(run: Run) -> np.ndarray:
        return PROCEDURES[run.procedure].stimulus(run, among).ambient["campaign_time"]

    # The first run begins nine days less four hours before.
    np.testing.assert_allclose(times(runs["cycle-fast"]) - runs["cycle-fast"].covariates["time"], 212 * 3600.0)
    np.testing.assert_allclose(times(runs["cycle-slow"]) - times(runs["cycle-fast"]), 86400.0)
    local = replace(runs["cycle-slow"], start="2026-03-11T10:00:00+02:00")
    np.testing.assert_allclose(times(local), times(runs["cycle-slow"]))
    undated = replace(among, runs=(replace(runs["ramp"], start=None),))
    found = PROCEDURES["thermal_ramp"].stimulus(undated.runs[0], undated).ambient["campaign_time"]
    np.testing.assert_allclose(found, runs["ramp"].covariates["time"])
    among = replace(among, runs=tuple(replace(run, start=None) if run.name == "ramp" else run for run in among.runs))
    ramp = next(run for run in among.runs if run.name == "ramp")
    # The others have a date and this one has none.
    assert "campaign_time" not in PROCEDURES["thermal_ramp"].stimulus(ramp, among).supplies


def test_a_covariate_with_gaps_is_not_supplied():
    among = wide_campaign()
    run = next(run for run in among.runs if run.name == "shaken")
    gaps = replace(run, covariates=dict(run.covariates) | {"vibration": np.array([0.0, np.nan, 1, 2])})
    assert "vibration" not in PROCEDURES["dividing_head"].stimulus(gaps, among).supplies


def test_a_run_to_come_has_no_angle_of_a_driven_table():
    """Read where a gyro drives the table, nowhere else: a candidate run would stand for the record of the servo."""
    planned = candidate_runs(driven_campaign())[1]
    assert planned
    for one in planned:
        assert np.isnan(one.run.observed[:, 1]).all()
        assert not np.isnan(one.run.observed[:, 0]).any()
