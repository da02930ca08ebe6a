"""Shares of seeded set-up mistakes that are named, and of valid campaigns that are doubted, on seeds of their own."""

import shutil
from pathlib import Path

import pytest
from setup_gate_shares import Judged, judge_mistakes, judge_valid, tables

MISTAKES, VALID = 1000, 420


@pytest.mark.slow
def test_a_thousand_seeded_mistakes(tmp_path: Path) -> None:
    """Of 1000 mistakes that the outputs show to a reader of the campaign files 99 % are named with their remedy."""
    judged: list[Judged] = []
    seed = 100_000
    while sum(each.stated for each in judged) < MISTAKES:
        judged += judge_mistakes(seed, tmp_path / str(seed))
        shutil.rmtree(tmp_path / str(seed))
        seed += 1
    print(tables(judged))
    missed = [f"{each.mistake} of seed {each.seed}" for each in judged if each.stated and not each.named]
    assert len(missed) <= 0.01 * MISTAKES, missed


@pytest.mark.slow
def test_valid_campaigns_are_not_doubted(tmp_path: Path) -> None:
    """At most 0.5 % of the campaigns with errors as large as their stated uncertainties allow are doubted."""
    judged = [judge_valid(seed, tmp_path / str(seed)) for seed in range(200_000, 200_000 + VALID)]
    print(tables(judged))
    doubted = [f"{each.campaign} of seed {each.seed}" for each in judged if each.named]
    assert len(doubted) <= 0.005 * VALID, doubted
