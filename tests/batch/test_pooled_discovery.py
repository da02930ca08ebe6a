"""Evidence added over units: what each of them has too little of is found, and named; nothing is found in nothing."""

import numpy as np
import polars as pl
import pytest
from scipy import stats

from imubayes.batch.pooled_discovery import pooled_discovery
from imubayes.batch.pooled_evidence import CandidateKey, adjusted, pooled_evidence, pooled_scores
from imubayes.batch.posterior_table import packed
from imubayes.batch.unit_scores import SCORES
from imubayes.errors import InputError

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
    first = found.findings[0]
    assert first.effects == ("quadratic", "twin") or first.effects == ("twin", "quadratic")
    assert (first.evidence.law, first.evidence.units, len(found.findings)) == ("common", UNITS, 1)
    assert first.evidence.log10_adjusted < -20
    (coefficient,) = first.coefficients
    assert coefficient.value is not None
    assert coefficient.sd is not None
    assert np.log10(0.01) < first.log10_p_differing
    assert first.supporting[0].contribution > 0 > first.opposing[0].contribution
    assert found.equipment == ()


@pytest.mark.parametrize("size", [3.0, 30.0, 300.0])
def test_evidence_beyond_the_range_of_a_double_is_ranked(size):
    # The smallest positive double is that of χ² 1485: 100 units reach it at 4 standard deviations each.
    found = pooled_discovery(*archive(1, of_effect(2, np.full(UNITS, size))))
    expected = stats.chi2.logsf(1000, 1) / np.log(10) * found.findings[0].evidence.chi2 / 1000
    assert found.findings[0].effects == ("drift",)
    assert found.ranking[0].log10_p == pytest.approx(expected, rel=0.02)
    assert found.findings[0].log10_p_differing < 0


def test_sizes_of_their_own_are_found_where_their_mean_is_zero():
    signs = np.random.default_rng(2).choice([-1.0, 1.0], UNITS)
    first = pooled_discovery(*archive(2, of_effect(2, 1.5 * signs))).findings[0]
    assert (first.effects, first.evidence.law) == (("drift",), "own")


def test_the_fifth_of_the_units_that_have_it_is_named():
    sizes = np.where(np.arange(UNITS) % 5 == 0, 6.0, 0.0)
    first = pooled_discovery(*archive(3, of_effect(2, sizes))).findings[0]
    truth = {f"U{3000 + place}" for place in np.flatnonzero(sizes)}
    named = set(first.named)
    assert first.effects == ("drift",)
    assert len(named & truth) / len(named) >= 0.85
    assert len(named & truth) / len(truth) >= 0.9
    assert not {each.unit for each in first.opposing} & truth


def test_a_fault_of_one_table_is_found_in_its_units_and_not_in_the_others():
    tables = ["t2" if place % 4 == 0 else "t1" for place in range(UNITS)]
    sizes = np.array([3.0 if name == "t2" else 0.0 for name in tables])
    found = pooled_discovery(*archive(4, of_effect(2, sizes), tables))
    assert [(each.kind, each.name, each.effects) for each in found.equipment] == [("table", "t2", ("drift",))]


def test_archives_without_an_effect_give_no_alarm_unless_the_noise_is_understated():
    quiet = [pooled_discovery(*archive(seed, np.zeros((30, 6)))).alarm for seed in range(10, 30)]
    assert sum(quiet) <= 2
    scores, units = archive(5, np.zeros((UNITS, 6)))
    # The noise of every unit is 1.5 times what its calibration says.
    understated = scores.with_columns(factor=pl.col("factor") * 2.25)
    assert pooled_discovery(understated, units).alarm


def test_a_unit_with_more_noise_weighs_less():
    quiet, loud = (score_rows(seed, np.zeros(6), noise) for seed, noise in ((1, 1.0), (2, 10.0)))
    both = pooled_scores(pl.DataFrame([*quiet, *loud], schema=SCORES))
    evidence = pooled_evidence(both, CandidateKey("drift", "", "accelerometer"))
    size = np.linalg.norm(design(1)[:, 2])
    assert evidence.covariance[0, 0] == pytest.approx(1 / (size**2 * 1.01))


def test_an_effect_of_one_sign_is_not_found_with_the_other():
    right = pooled_scores(archive(6, of_effect(5, np.full(UNITS, 1.0)))[0])
    wrong = pooled_scores(archive(6, of_effect(5, np.full(UNITS, -1.0)))[0])
    key = CandidateKey("width", "", "accelerometer")
    assert pooled_evidence(right, key).log_p["common"] < -20
    assert pooled_evidence(wrong, key).log_p["common"] > np.log(0.99)


def test_the_adjustment_is_that_of_benjamini_and_yekutieli():
    p = np.array([1e-4, 0.3, 0.004, 0.02, 0.7])
    assert np.allclose(np.exp(adjusted(np.log(p))), stats.false_discovery_control(p, method="by"))


def test_a_batch_without_scores_is_refused():
    with pytest.raises(InputError, match="no campaign of the batch has scores"):
        pooled_discovery(SCORES.to_frame(), archive(7, np.zeros((2, 6)))[1])
