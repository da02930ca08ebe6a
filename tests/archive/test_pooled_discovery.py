"""Evidence added over units: what each of them has too little of is found, and named; nothing is found in nothing."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from imubayes.criticism.effect_scores import CandidateKey
from imubayes.foundations.errors import InputError
from imubayes.results.folder_files import seal
from imubayes_archive.unit_fits.pooled_discovery import pooled_discovery
from imubayes_archive.unit_fits.pooled_evidence import effect_in_units, law_tables, pooled_scores, unit_gains
from imubayes_archive.unit_fits.posterior_table import packed
from imubayes_archive.unit_fits.unit_scores import SCORES, read_unit_scores

EFFECTS = ("quadratic", "twin", "drift", "pair", "width")
ROWS, UNITS, SIZE = 40, 100, 50.0


def design(seed: int) -> np.ndarray:
    """Return projected responses (rows, 6): quadratic, its near twin, drift, a pair, and one of a single sign."""
    columns = np.random.default_rng(seed).normal(size=(ROWS, 6))
    columns[:, 1] = 3 * columns[:, 0] + 0.05 * columns[:, 1]
    return columns


def score_rows(seed: int, effect: np.ndarray, noise: float = 1.0) -> list[dict]:
    """Return the rows of one unit whose response is `effect` (6,) in standard deviations of each coefficient.

    Typical sizes reach ten standard deviations.
    """
    columns = design(1)
    columns *= 10 / np.linalg.norm(columns, axis=0)
    residual = noise * np.random.default_rng(seed).normal(size=ROWS) + columns @ effect / 10
    digest, names = f"d{seed}", ["q[ax]", "t[ax]", "d[ax]", "p1[ax]", "p2[ax]", "w[ax]"]
    own = {"quadratic": [0], "twin": [1], "drift": [2], "pair": [3, 4], "width": [5]}
    u, v = columns.T @ residual / noise**2, columns.T @ columns / noise**2
    rows = [
        {"digest": digest, "unit": f"U{seed}", "effect": name, "shape": "", "scope": "accelerometer", "part": "",
         "owners": ["ax"], "coefficients": [names[place] for place in places], "log_odds": np.log(0.2),
         "widths": [0.01, 0.04, 0.16, 0.64, 2.5, 10.0]}
        for name, places in own.items()
    ]  # fmt: skip
    together = {"digest": digest, "unit": f"U{seed}", "coefficients": names, "measures": ["ug"] * 6,
                "sizes": [SIZE] * 6, "signs": [0, 0, 0, 0, 0, 1], "score": u.tolist(),
                "information": packed(v)}  # fmt: skip
    return [*rows, together]


def archive(seed: int, effects: np.ndarray, tables: list[str] | None = None) -> tuple[pl.DataFrame, pl.DataFrame]:
    """Return scores and units of an archive, with the effects (n, 6) of its units."""
    seeds = [1000 * seed + place for place in range(len(effects))]
    rows = [row for each, effect in zip(seeds, effects, strict=True) for row in score_rows(each, effect)]
    count = len(seeds)
    units = pl.DataFrame(
        {"model": ["m"] * count, "digest": [f"d{each}" for each in seeds],
         "tables": [[name] for name in (tables or ["t"] * count)], "mountings": [["up"]] * count,
         "year": [2020 + place % 3 for place in range(count)]}
    )  # fmt: skip
    return pl.DataFrame(rows, schema=SCORES), units


def of_effect(place: int, sizes: np.ndarray) -> np.ndarray:
    effects = np.zeros((len(sizes), 6))
    effects[:, place] = sizes
    return effects


def test_what_no_unit_shows_is_found_in_a_hundred():
    found = pooled_discovery(*archive(1, of_effect(0, np.full(UNITS, 1.5))))
    (first,) = found.findings
    assert set(first.effects) == {"quadratic", "twin"}
    assert (first.evidence.law, first.evidence.units, first.equipment) == ("common", UNITS, None)
    assert first.probability > 0.999
    assert sum(each.probability for each in first.place) == pytest.approx(1.0, abs=0.05)
    (coefficient,) = first.coefficients
    assert coefficient.value == pytest.approx(0.15 * SIZE, abs=3 * coefficient.sd)
    assert (coefficient.sd, coefficient.spread) == (pytest.approx(0.1 * SIZE / np.sqrt(UNITS), rel=0.02), 0.0)
    assert first.supporting[0].gain > 0 > first.opposing[0].gain
    assert found.nothing < 0.001
    assert found.nothing_else > 0.5


@pytest.mark.parametrize("size", [3.0, 30.0, 300.0])
def test_evidence_beyond_the_range_of_a_double_is_ranked(size):
    found = pooled_discovery(*archive(1, of_effect(2, np.full(UNITS, size))))
    (first,) = found.findings
    assert first.effects == ("drift",)
    assert first.evidence.log_odds == pytest.approx(0.5 * UNITS * size**2, rel=0.15)
    assert first.evidence.probability == pytest.approx(1.0)
    assert set(first.evidence.laws) == {"common", "own", "some"}


def test_the_evidence_is_that_of_all_units_in_one_model():
    """Against the joint normal law of the scores, whose sizes share a mean."""
    scores = pooled_scores(archive(9, of_effect(2, np.array([2.0, 3.0, 1.0])))[0])
    candidate = scores.candidates[CandidateKey("drift", "", "accelerometer")]
    gains = unit_gains(scores, candidate)
    found = law_tables(gains, np.ones((1, 3), dtype=bool))["own"][0]
    (place,) = candidate.places
    u, v = scores.score[:, place], np.diag(scores.information[:, place, place])

    def joint(spread: float, width: float) -> float:
        covariance = v + v @ (spread**2 * np.eye(3) + width**2) @ v
        return -0.5 * float(u @ np.linalg.solve(covariance, u)) - 0.5 * float(np.linalg.slogdet(covariance)[1])

    first = joint(gains.widths[2], gains.widths[3])
    for q, m in ((2, 5), (3, 2), (5, 4)):
        expected = joint(gains.widths[q], gains.widths[m]) - first
        assert found[q, 1 + m] - found[2, 1 + 3] == pytest.approx(expected)


def test_sizes_of_their_own_are_found_where_their_mean_is_zero():
    signs = np.random.default_rng(2).choice([-1.0, 1.0], UNITS)
    first = pooled_discovery(*archive(2, of_effect(2, 1.5 * signs))).findings[0]
    assert (first.effects, first.evidence.law) == (("drift",), "own")
    assert first.coefficients[0].spread > 0


def test_sizes_about_a_mean_are_told_from_a_common_one():
    sizes = np.random.default_rng(9).normal(3.0, 2.0, UNITS)
    first = pooled_discovery(*archive(9, of_effect(2, sizes))).findings[0]
    (coefficient,) = first.coefficients
    assert (first.effects, first.evidence.law) == (("drift",), "own")
    assert coefficient.value == pytest.approx(0.3 * SIZE, abs=3 * coefficient.sd)


def test_the_fifth_of_the_units_that_have_it_is_named():
    sizes = np.where(np.arange(UNITS) % 5 == 0, 6.0, 0.0)
    first = pooled_discovery(*archive(3, of_effect(2, sizes))).findings[0]
    truth = {f"U{3000 + place}" for place in np.flatnonzero(sizes)}
    named = set(first.named)
    assert (first.effects, first.evidence.law) == (("drift",), "some")
    assert len(named & truth) / len(named) >= 0.85
    assert len(named & truth) / len(truth) >= 0.9
    assert not {each.unit for each in first.opposing} & truth


def test_a_fault_of_one_table_is_found_in_its_units_and_not_in_the_others():
    tables = ["t2" if place % 4 == 0 else "t1" for place in range(UNITS)]
    sizes = np.array([3.0 if name == "t2" else 0.0 for name in tables])
    (first,) = pooled_discovery(*archive(4, of_effect(2, sizes), tables)).findings
    assert first.effects == ("drift",)
    assert first.equipment is not None
    assert (first.equipment.kind, first.equipment.name, first.equipment.inside) == ("table", "t2", 25)
    assert first.equipment.log_bayes_outside is not None
    assert first.equipment.log_bayes_outside < 0 < first.evidence.log_odds
    assert {int(each.unit[1:]) % 4 for each in first.every_unit} == {0}


def test_two_effects_are_found_one_after_the_other():
    both = of_effect(2, np.full(UNITS, 1.5)) + of_effect(0, np.full(UNITS, 1.5))
    found = pooled_discovery(*archive(8, both)).findings
    assert [set(each.effects) for each in found] == [{"drift"}, {"quadratic", "twin"}]


def test_archives_without_an_effect_give_no_alarm_unless_the_noise_is_understated():
    quiet = [pooled_discovery(*archive(seed, np.zeros((30, 6)))) for seed in range(10, 30)]
    assert not any(each.alarm for each in quiet)
    assert np.median([each.nothing for each in quiet]) > 0.8
    scores, units = archive(5, np.zeros((UNITS, 6)))
    # The noise of every unit is 1.5 times what its scores say.
    understated = scores.with_columns(pl.col("score", "information").list.eval(pl.element() * 2.25))
    assert not pooled_discovery(scores, units).alarm
    assert pooled_discovery(understated, units).alarm


def test_a_unit_with_more_noise_weighs_less():
    quiet, loud = (score_rows(seed, np.zeros(6), noise) for seed, noise in ((1, 1.0), (2, 10.0)))
    both = pooled_scores(pl.DataFrame([*quiet, *loud], schema=SCORES))
    effect = effect_in_units(both, CandidateKey("drift", "", "accelerometer"), "common")
    assert effect.sd[0] == pytest.approx(0.1 * SIZE / np.sqrt(1.01), rel=1e-3)


def test_an_effect_of_one_sign_is_not_found_with_the_other():
    right, wrong = (archive(6, of_effect(5, np.full(UNITS, sign))) for sign in (1.0, -1.0))
    assert pooled_discovery(*right).findings[0].effects == ("width",)
    assert not pooled_discovery(*wrong).alarm


def test_a_batch_without_scores_is_refused():
    with pytest.raises(InputError, match="no campaign of the batch has scores"):
        pooled_discovery(SCORES.to_frame(), archive(7, np.zeros((2, 6)))[1])


def _keep(place: Path, scores: pl.DataFrame) -> None:
    place.mkdir()
    scores.write_parquet(place / "scores.parquet")
    seal(place)


def test_scores_of_another_version_are_refused(tmp_path):
    folder = tmp_path / "model-m"
    folder.mkdir()
    (folder / "model.toml").touch()
    _keep(folder / "scores-new", archive(7, np.zeros((2, 6)))[0])
    assert read_unit_scores(tmp_path).height == 12
    _keep(folder / "scores-old", pl.DataFrame({"digest": ["d"], "p": [0.5]}))
    with pytest.raises(InputError, match="another version") as refused:
        read_unit_scores(tmp_path)
    assert "run imubayes batch again" in refused.value.issues[0].remedy
