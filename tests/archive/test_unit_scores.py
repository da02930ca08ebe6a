"""Scores of units from their linearised fits: priors show nothing, noise is that of the unit, and they add up."""

from dataclasses import replace

import numpy as np
import polars as pl
import pytest

from imubayes.criticism.effect_scores import CandidateKey, scores_of
from imubayes.criticism.evidence.linear_problem import ChannelRows, LinearProblem
from imubayes.parameters.declarations import Parameter
from imubayes.parameters.priors import Normal
from imubayes.responses.candidate_effects import Coefficient, Response, ShapeScan
from imubayes_archive.unit_fits.pooled_discovery import pooled_discovery
from imubayes_archive.unit_fits.pooled_evidence import PooledScores, pooled_scores
from imubayes_archive.unit_fits.unit_scores import table_of

ROWS, RUNS, OWN, UNITS = 60, 6, 2, 12
RATE = np.tile(np.linspace(-1.0, 1.0, ROWS // RUNS), RUNS)
TEMPERATURE = np.repeat(np.linspace(-1.0, 1.0, RUNS), ROWS // RUNS)
EFFECTS = {"asymmetry": np.abs(RATE), "cubic": RATE**3, "temperature": TEMPERATURE, "absorbed": 2 + RATE}
LARGEST = 5.0
"""Response to the largest typical size, in units of noise."""


def linear(
    residual: np.ndarray, precision: float = 1.0, scatter: tuple[tuple[float, float], ...] = ()
) -> LinearProblem:
    """Return a channel with bias and scale factor that lacks `EFFECTS`, with a residual (ROWS,) in units of noise."""
    candidates = tuple(
        Response(
            ShapeScan(effect, {}),
            (
                Coefficient(
                    Parameter(effect, "k", ("g",), "ppm", 1.0, Normal(0.0, 10.0), typical=(0.1, 2.0)), "g", (0.1, 2.0)
                ),
            ),
            np.zeros((ROWS, 1)),
        )
        for effect in EFFECTS
    )
    columns = np.column_stack([np.ones(ROWS), RATE, *(LARGEST * shape for shape in EFFECTS.values()), residual])
    rows = ChannelRows(
        "g", "gyro", np.arange(OWN + len(EFFECTS)), columns, np.arange(ROWS),
        tuple((n * ROWS // RUNS, ROWS // RUNS) for n in range(RUNS)), np.ones(ROWS), RATE, 0.03, scatter,
    )  # fmt: skip
    run = np.repeat(np.arange(RUNS), ROWS // RUNS)
    names, width = tuple(f"run{n}" for n in range(RUNS)), np.full(OWN, precision)
    return LinearProblem(candidates, names, run, width, 0 * width, np.ones(ROWS), (rows,))


def noise(seed: int, size: float = 1.0) -> np.ndarray:
    return size * np.random.default_rng(seed).normal(size=ROWS)


def pooled(*problems: LinearProblem) -> PooledScores:
    return pooled_scores(pl.concat([table_of(scores_of(each), f"U{n}", f"d{n}") for n, each in enumerate(problems)]))


def discovered(residuals: list[np.ndarray]):
    scores = pl.concat([table_of(scores_of(linear(each)), f"U{n}", f"d{n}") for n, each in enumerate(residuals)])
    count = len(residuals)
    units = pl.DataFrame({"model": ["m"] * count, "digest": [f"d{n}" for n in range(count)], "tables": [["t"]] * count,
                          "mountings": [["up"]] * count, "year": [2026] * count})  # fmt: skip
    return pooled_discovery(scores, units)


def test_scores_are_those_of_least_squares_and_what_is_absorbed_is_no_candidate():
    residual = noise(1)
    found = pooled(linear(residual))
    jacobian = np.column_stack([np.ones(ROWS), RATE])
    for name in ("asymmetry", "cubic", "temperature"):
        column = LARGEST * EFFECTS[name]
        left = column - jacobian @ np.linalg.lstsq(jacobian, column)[0]
        k = found.candidates[CandidateKey(name, "", "gyro")].places[0]
        scale = found.information[0, k, k] / (left @ left)
        assert scale == pytest.approx(1.0, abs=0.4)
        assert found.score[0, k] == pytest.approx(scale * left @ residual)
    assert CandidateKey("absorbed", "", "gyro") not in found.candidates


def test_priors_of_the_model_tell_nothing():
    tight = linear(noise(2) + 100 * RATE, precision=1e6)
    moved = replace(tight, pull=np.full(OWN, 1e9))
    first, second, wide = (pooled(each) for each in (tight, moved, linear(noise(2))))
    assert np.allclose(first.score, wide.score, atol=1e-6)
    assert np.allclose(second.score, wide.score, atol=1e-6)
    assert np.allclose(first.information, wide.information)


def test_offsets_of_runs_that_the_model_has_are_no_effect_of_temperature():
    offsets = np.repeat(np.random.default_rng(3).normal(0, 5, RUNS), ROWS // RUNS)
    scatter = tuple((size, np.log(1 / 3)) for size in (0.1, 1.0, 5.0))
    key = CandidateKey("temperature", "", "gyro")
    without, beside = (pooled(linear(noise(3) + offsets, scatter=each)) for each in ((), scatter))
    place = without.candidates[key].places[0]
    assert beside.score[0, place] ** 2 / beside.information[0, place, place] < 9
    assert beside.information[0, place, place] < 0.5 * without.information[0, place, place]


def test_archives_without_an_effect_are_silent():
    quiet = [discovered([noise(100 * seed + n) for n in range(UNITS)]) for seed in range(20)]
    assert not any(each.alarm for each in quiet)


def test_a_unit_with_a_gross_error_does_not_outvote_the_others():
    residuals = [noise(n) + 1.0 * np.abs(RATE) for n in range(UNITS)]
    gross = noise(99, 40.0) - 60 * np.abs(RATE)
    (first,) = discovered([*residuals, gross]).findings
    (coefficient,) = first.coefficients
    assert (first.effects, first.evidence.law) == (("asymmetry",), "common")
    assert coefficient.value == pytest.approx(2.0 / LARGEST, abs=3 * coefficient.sd)
    assert not discovered([*(noise(n) for n in range(UNITS)), noise(98, 40.0)]).alarm


def test_one_unit_alone_is_found_and_named():
    residuals = [noise(n) + (8.0 * RATE**3 if n == 4 else 0) for n in range(UNITS)]
    (first,) = discovered(residuals).findings
    assert (first.effects, first.evidence.law, first.named) == (("cubic",), "some", ("U4",))


def test_an_effect_in_one_unit_does_not_hide_behind_the_scatter_that_it_makes():
    quiet, shown = (pooled(linear(noise(5) + size * RATE**3)) for size in (0.0, 12.0))
    place = shown.candidates[CandidateKey("cubic", "", "gyro")].places[0]
    assert shown.information[0, place, place] > 0.8 * quiet.information[0, place, place]
    (first,) = discovered([noise(n) + (4.0 * RATE**3 if n == 4 else 0) for n in range(UNITS)]).findings
    assert (first.effects, first.named) == (("cubic",), ("U4",))
