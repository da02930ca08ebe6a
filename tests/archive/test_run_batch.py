"""A batch goes on after any interruption, keeps what is done, and names what cannot be fitted."""

import errno
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from killed_process import kill_after
from polars.testing import assert_frame_equal
from small_units import DAMAGE, MODEL, edit, make_units

from imubayes.foundations.errors import InputError
from imubayes.model import trusted_files
from imubayes.model.model_file import PriorCorrelation, read_carried_model, read_model
from imubayes.results.folder_files import trust
from imubayes_archive.unit_fits.batch_folder import BatchSettings, PartFiles, batch_key, sources_of, unread
from imubayes_archive.unit_fits.posterior_table import (
    Outcome,
    Quantities,
    UnitPosterior,
    model_folder,
    models_in,
    read_parameters,
    read_units,
)
from imubayes_archive.unit_fits.run_batch import BatchProgress, ChunkTask, run_batch

TOY = Path(__file__).parent / "toy_executor.py"


def toy_executor(tasks, seconds: float = 0.0):
    """Fit nothing: estimates that depend on the campaign alone; campaigns whose digest begins with 0 fail."""
    for task in tasks:
        units = []
        for source in task.sources:
            time.sleep(seconds)
            random = np.random.default_rng(int(source.digest, 16))
            mean, sd, prior_mean, prior_sd, share = (random.normal(size=2) for _ in range(5))
            quantiles = random.normal(size=(5, 2))
            parts = Quantities("parameter", ("a", "b"), ("ppm", "g"), mean, sd, quantiles, prior_mean, prior_sd, share)
            failed = source.digest.startswith("0")
            outcome = Outcome("failed", "toy", source.path, source.fingerprint()) if failed else Outcome("fitted")
            units.append(UnitPosterior(unread(source), outcome, () if failed else (parts,), np.eye(2) * (not failed)))
        yield tuple(units)


@pytest.fixture(scope="module")
def many(tmp_path_factory):
    folder = tmp_path_factory.mktemp("many")
    make_units(folder, 40)
    return folder


@pytest.fixture(scope="module")
def uninterrupted(many, tmp_path_factory):
    out = tmp_path_factory.mktemp("whole")
    run_batch(many, MODEL, out, toy_executor, chunk=5)
    return out


def assert_same_tables(out: Path, expected: Path) -> None:
    for read in (read_parameters, read_units):
        found, wanted = read(out), read(expected)
        assert_frame_equal(found.drop("seconds"), wanted.drop("seconds"))


def test_every_unit_once_whatever_the_chunks(many, uninterrupted, tmp_path):
    units = read_units(uninterrupted)
    assert units["digest"].n_unique() == units.height == 40
    assert 0 < (units["status"] == "failed").sum() < 10
    run_batch(many, MODEL, tmp_path, toy_executor, chunk=7)
    assert_same_tables(tmp_path, uninterrupted)


def test_a_batch_that_is_run_again_does_what_is_missing_alone(many, uninterrupted, tmp_path):
    asked: list[ChunkTask] = []

    def watched(tasks):
        for task in tasks:
            asked.append(task)
            yield from toy_executor([task])

    def interrupted(tasks):
        for place, chunk in enumerate(toy_executor(tasks)):
            if place == 3:
                raise KeyboardInterrupt
            yield chunk

    with pytest.raises(KeyboardInterrupt):
        run_batch(many, MODEL, tmp_path, interrupted, chunk=5)
    state = run_batch(many, MODEL, tmp_path, watched, chunk=4)
    assert (state.before, state.done) == (15, 25)
    assert sum(len(task.sources) for task in asked) == 25
    assert_same_tables(tmp_path, uninterrupted)
    assert run_batch(many, MODEL, tmp_path, watched).done == 0


def kill_at_random_moments(many: Path, out: Path, kills: int, random: np.random.Generator) -> int:
    """Run the toy batch in a process of its own, which is killed; return the parts found after the kills."""
    command = [sys.executable, str(TOY), str(many), str(MODEL), str(out)]
    for _ in range(kills):
        process = subprocess.Popen(command, stdout=subprocess.PIPE, start_new_session=True)
        kill_after(process, random.integers(1, 7), random.uniform(0.0, 0.02))
    return len(list(out.glob("model-*/part-*")))


@pytest.mark.parametrize("kills", [3, pytest.param(20, marks=pytest.mark.slow)])
def test_kill_9_at_random_moments_changes_nothing(many, uninterrupted, tmp_path, kills):
    written = kill_at_random_moments(many, tmp_path, kills, np.random.default_rng(kills))
    assert written > 0
    run_batch(many, MODEL, tmp_path, toy_executor, chunk=3)
    assert_same_tables(tmp_path, uninterrupted)
    assert not list(tmp_path.glob("model-*/.part-*"))


def test_the_comparison_sees_a_lost_and_a_doubled_unit(many, uninterrupted, tmp_path):
    run_batch(many, MODEL, tmp_path, toy_executor, chunk=5)
    part = next(iter(sorted(model_folder(tmp_path, models_in(tmp_path)[0]).glob("part-*"))))
    part.rename(part.with_name("lost"))
    with pytest.raises(AssertionError):
        assert_same_tables(tmp_path, uninterrupted)
    (part.with_name("lost")).rename(part)
    copy = part.with_name("part-copy")
    copy.mkdir()
    for file in part.iterdir():
        (copy / file.name).write_bytes(file.read_bytes())
    with pytest.raises(AssertionError):
        assert_same_tables(tmp_path, uninterrupted)


def test_one_batch_writes_at_a_time(many, tmp_path):
    parts = PartFiles(tmp_path, "abc", "code")
    with parts.writing(), ThreadPoolExecutor(1) as other:
        second = other.submit(run_batch, many, MODEL, tmp_path, toy_executor)
        assert "another process is writing here" in str(second.exception())


def test_a_unit_without_estimates_is_tried_again_when_its_file_has_changed(tmp_path):
    units = make_units(tmp_path / "units", 3)

    def all_fail(tasks):
        for task in tasks:
            outcomes = [Outcome("refused", "no", source.path, source.fingerprint()) for source in task.sources]
            pairs = zip(task.sources, outcomes, strict=True)
            yield tuple(UnitPosterior(unread(s), o) for s, o in pairs)

    def all_succeed(tasks):
        for task in tasks:
            yield tuple(UnitPosterior(unread(s), Outcome("fitted")) for s in task.sources)

    out = tmp_path / "out"
    assert run_batch(tmp_path / "units", MODEL, out, all_fail).failed == 3
    assert run_batch(tmp_path / "units", MODEL, out, all_succeed).done == 0
    edit(units[1] / "campaign.toml", "height_m = 400.0", "height_m = 401.0")
    assert run_batch(tmp_path / "units", MODEL, out, all_succeed).done == 1
    assert sorted(read_units(out)["status"]) == ["fitted", "refused", "refused"]
    assert run_batch(tmp_path / "units", MODEL, out, all_succeed, retry=True).done == 2
    assert read_units(out)["status"].to_list() == ["fitted"] * 3


def test_another_model_or_setting_makes_new_parts_beside_the_old(many, uninterrupted, tmp_path):
    run_batch(many, MODEL, tmp_path, toy_executor)
    run_batch(many, MODEL, tmp_path, toy_executor, BatchSettings(seed=1))
    assert len(models_in(tmp_path)) == 2
    first = batch_key(read_model(MODEL), BatchSettings())
    assert_frame_equal(read_units(tmp_path, first).drop("seconds"), read_units(uninterrupted).drop("seconds"))


def test_a_campaign_in_two_folders_counts_once(tmp_path):
    for name in ("a", "b"):
        make_units(tmp_path / name, 2)
    assert len(sources_of(tmp_path)) == 2


def test_campaigns_that_lack_a_table_are_told_apart_by_the_others(tmp_path):
    for seed, unit in enumerate(make_units(tmp_path / "first", 1) + make_units(tmp_path / "second", 1, seed=1)):
        sorted((unit / "runs").glob("*.csv"))[seed].unlink()
    assert len(sources_of(tmp_path)) == 2


def test_rate_and_time_left():
    state = BatchProgress("k", units=100, before=20, done=40, failed=1, seconds=10.0)
    assert (state.rate, state.seconds_left) == (4.0, 10.0)
    assert BatchProgress("k", 100, 0, 0, 0, 0.0).seconds_left is None


def test_ten_kinds_of_damage_each_with_its_reason_and_all_others_fitted(tmp_path):
    # Units are fitted for real: by the command, from folders.
    from imubayes.cli.main import run

    units = make_units(tmp_path / "units", len(DAMAGE) + 2)
    for unit, damage in zip(units, DAMAGE.values(), strict=False):
        damage(unit)
    out = tmp_path / "out"
    assert run(["batch", str(tmp_path / "units"), "--model", str(MODEL), "--out", str(out)]) == 1
    table = read_units(out).sort("file")
    assert table["status"].to_list() == ["refused"] * len(DAMAGE) + ["fitted"] * 2
    refused = table.head(len(DAMAGE))
    assert refused["reason"].n_unique() == len(DAMAGE)
    for row in refused.iter_rows(named=True):
        assert row["where"]
        assert row["file"].startswith(str(tmp_path))
    long = read_parameters(out)
    estimates = long.filter(pl.col("status") == "fitted")
    assert estimates.filter(pl.col("kind") != "derived")["mean"].is_not_null().all()
    assert estimates.filter(pl.col("q2_5") > pl.col("q97_5")).is_empty()
    assert table["covariance"][-1].len() == len(table["names"][-1]) * (len(table["names"][-1]) + 1) // 2


EFFECT = '''"""An effect of the user's own."""

from imubayes import Order, Scalar, SignalEffect, Stage, parameter


class Mine(SignalEffect):
    """A quadratic of one's own."""

    name = "mine"
    stage, order, kinds = Stage.SENSOR, Order.SCALE, ("gyro",)
    k: Scalar = parameter("ppm", "normal(0, 100 ppm)", (10, 300), "k")

    def apply(self, signal, sample):
        return signal * (1 + self.k * signal)
'''
NOISE = """format = 1
name = "noise"

[[effect]]
name = "white_noise"
prior = { sigma = "lognormal(1 noise, 0.5)" }
"""


@pytest.fixture
def own(tmp_path, monkeypatch) -> Path:
    """A model with an effect file below it and noise priors beside its folder, of a user who trusts nothing yet."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "configuration"))
    monkeypatch.setattr(trusted_files, "_ran", set())
    model = tmp_path / "models" / "model.toml"
    (model.parent / "effects").mkdir(parents=True)
    (model.parent / "effects" / "mine.py").write_text(EFFECT)
    (tmp_path / "noise.toml").write_text(NOISE)
    first, rest = MODEL.read_text().split("[[effect]]", 1)
    own = 'files = ["effects/mine.py"]\nnoise_priors = "../noise.toml"\n'
    model.write_text(f'{first}{own}\n[[effect]]\nname = "mine"\n\n[[effect]]{rest}')
    return model


def test_the_model_of_a_batch_is_kept_with_all_files_that_it_names(own, many, tmp_path):
    given = read_model(own)
    key = run_batch(many, own, tmp_path / "out", toy_executor).key
    file = model_folder(tmp_path / "out", key) / "model.toml"
    for source in (own, tmp_path / "noise.toml", own.parent / "effects" / "mine.py"):
        source.unlink()
    with pytest.raises(InputError, match=r"'mine\.py' is Python code that came with the input"):
        read_carried_model(file)
    trust(file)
    kept = read_carried_model(file)
    assert batch_key(kept, BatchSettings()) == key
    assert kept.noise_priors is not None
    assert given.noise_priors is not None
    assert [each.prior for each in kept.noise_priors.effects] == [each.prior for each in given.noise_priors.effects]


def test_noise_priors_and_correlations_are_of_the_model(own, tmp_path):
    key = batch_key(read_model(own), BatchSettings())
    (tmp_path / "noise.toml").write_text(NOISE.replace("0.5", "0.6"))
    assert batch_key(other := read_model(own), BatchSettings()) != key
    block = PriorCorrelation(("white_noise.sigma[g]", "run_scatter.tau[g]"), ((1.0, 0.5), (0.5, 1.0)))
    assert batch_key(replace(other, correlations=(block,)), BatchSettings()) not in (
        key, batch_key(other, BatchSettings())
    )  # fmt: skip


@pytest.mark.slow
def test_questions_asked_of_a_batch_with_an_effect_of_the_users_own(own, tmp_path, capsys, monkeypatch):
    from imubayes.cli.main import run

    def said(*words: object) -> tuple[int, str]:
        status = run(["batch", *map(str, words)])
        return status, "".join(capsys.readouterr())

    make_units(tmp_path / "units", 6)
    out, following = tmp_path / "out", tmp_path / "next" / "model.toml"
    assert said(tmp_path / "units", "--model", own, "--out", out)[0] == 0
    monkeypatch.setattr(trusted_files, "_ran", set())  # as in another process
    for words in (("diagnose", out), ("prior", out, "--out", following)):
        status, text = said(*words)
        assert (status, "'mine.py' is Python code that came with the input" in text) == (2, True)
    assert not following.exists()
    monkeypatch.setattr("imubayes_archive.unit_fits.unit_scores.replacing", _full)
    status, text = said("diagnose", out, "--trust")
    assert status == 0, text
    assert "6 campaigns of 6 units" in text
    assert "nothing of this is kept in" in text
    assert said("prior", out, "--out", following)[0] == 0
    spec = read_model(following)
    assert [Path(file).read_text() for file in spec.files] == [EFFECT]
    assert spec.noise_priors is not None


def _full(*_, **__):
    raise OSError(errno.ENOSPC, "No space left on device")
