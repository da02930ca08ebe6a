"""A result folder is one thing: at every instant the old result, the new one, or a folder that is refused."""

import errno
import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import synthetic_results as made

from imubayes.criticism.diagnosis_record import Diagnosis
from imubayes.display.model_against_measurement import compare
from imubayes.foundations.errors import InputError
from imubayes.results import folder_files
from imubayes.results.change_records import read_diagnosis, write_diagnosis
from imubayes.results.folder_files import (
    BUDGETS,
    DIAGNOSIS,
    MANIFEST,
    PAGE,
    POSTERIOR,
    RESIDUALS,
    SUMMARY,
    add_to,
    added,
    checked,
    replacing_result,
)
from imubayes.results.result import read_result
from kept_results import listed

WRITER = Path(__file__).parents[1] / "results" / "killed_writer.py"


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """Results of two units, the first one sampled and diagnosed, of which every file differs."""
    folder = tmp_path_factory.mktemp("whole")
    made.trihedral_folder(folder / "old", temperatures=(25,), channels=("gx",))
    write_diagnosis(folder / "old", Diagnosis(verdict="adequate", result="old"))
    residuals = made.trihedral_residuals(temperatures=(25,), channels=("gy",))
    made.write_folder(folder / "new", residuals, made.summary_of(residuals, sampled=False))
    return folder


@pytest.fixture
def result(place, tmp_path) -> Path:
    return Path(shutil.copytree(place / "old", tmp_path / "result"))


def killed(environment: dict[str, str], *words: Path) -> int:
    """Return how many operations the writing takes."""
    done = subprocess.run(
        [sys.executable, str(WRITER), *map(str, words)], env=environment, capture_output=True, text=True, check=True
    )
    return int(done.stdout)


def content(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in (SUMMARY, RESIDUALS, POSTERIOR) if (folder / name).is_file()}


def test_a_kill_at_any_instant_leaves_the_old_result_or_the_new_or_a_refusal(place, tmp_path, command_environment):
    count = killed(command_environment, place / "old", place / "new", tmp_path)
    found, refusals = [], []
    for number in range(count + 1):
        folder = tmp_path / str(number)
        try:
            result = read_result(folder)
            diagnosis = read_diagnosis(folder)
        except InputError as error:
            found.append("refused")
            refusals.extend(error.issues)
            continue
        which = "old" if result.summary.sampled else "new"
        found.append(which)
        assert content(folder) == content(place / which)
        assert (result.posterior_file is None, diagnosis is None) == (which == "new",) * 2
    assert all("interrupted" in issue.what for issue in refusals)
    assert all(issue.remedy.startswith("run `imubayes fit` again") for issue in refusals)
    assert found == sorted(found, key=["old", "refused", "new"].index)
    assert found.count("refused") >= 3, "a folder between two results was met"
    assert (found[0], found[-1]) == ("old", "new")
    # The next writer finishes: nothing of what was left behind stays.
    middle = tmp_path / str(found.index("refused"))
    with replacing_result(middle, 0) as scratch:
        for name in (SUMMARY, RESIDUALS):
            shutil.copyfile(place / "new" / name, scratch / name)
    assert not read_result(middle).summary.sampled
    assert not [file.name for file in middle.iterdir() if file.name.startswith(".") or file.name == DIAGNOSIS]


def test_a_kill_while_a_file_is_added_leaves_the_fit(place, tmp_path, command_environment):
    (tmp_path / "text").write_text("{}\n")
    count = killed(command_environment, place / "old", tmp_path / "text", tmp_path)
    refusals = []
    for number in range(count + 1):
        folder = tmp_path / str(number)
        assert content(folder) == content(place / "old")
        assert checked(folder).identity == checked(place / "old").identity
        try:
            added(folder, BUDGETS)
        except InputError as error:
            refusals.append(str(error))
        add_to(folder, BUDGETS, "{}\n")
        assert added(folder, BUDGETS) == folder / BUDGETS
    assert refusals
    assert all("budgets.json is not of this result" in each for each in refusals)


def _first_half(folder: Path) -> None:
    file = folder / RESIDUALS
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


def _altered(folder: Path) -> None:
    file = folder / SUMMARY
    text = file.read_text()
    file.write_text(text.replace("0", "1", 1))
    assert file.stat().st_size == len(text.encode())


SPOILT: dict[str, tuple[Callable[[Path], object], str]] = {
    "truncated": (_first_half, "bytes, not the"),
    "altered": (_altered, "summary.json was altered"),
    "without a file": (lambda folder: (folder / POSTERIOR).unlink(), "posterior.nc is missing"),
    "older": (lambda folder: (folder / MANIFEST).unlink(), "no manifest.json"),
    "manifest cut": (lambda folder: (folder / MANIFEST).write_text('{"format": 1, "fit"'), "cannot be read"),
    "manifest that leads elsewhere": (
        lambda folder: (folder / MANIFEST).write_text('{"fit": [{"name": "../a", "size": 1, "sha256": ""}]}'),
        "cannot be read",
    ),
}


@pytest.mark.parametrize("fault", SPOILT)
@pytest.mark.parametrize("read", [read_result, compare, read_diagnosis], ids=lambda read: read.__name__)
def test_a_folder_that_is_not_whole_is_refused(result, fault, read):
    spoil, said = SPOILT[fault]
    spoil(result)
    with pytest.raises(InputError, match=said):
        read(result)


def test_files_of_two_results_are_not_mixed(place, result):
    shutil.copyfile(place / "new" / RESIDUALS, result / RESIDUALS)
    with pytest.raises(InputError, match=RESIDUALS):
        read_result(result)


def test_a_diagnosis_belongs_to_the_fit_that_was_diagnosed(place, result, tmp_path):
    name = DIAGNOSIS
    other = Path(shutil.copytree(place / "new", tmp_path / "other"))
    shutil.copyfile(result / name, other / name)
    with pytest.raises(InputError, match=r"diagnosis\.json is not of this result") as caught:
        read_diagnosis(other)
    assert "imubayes diagnose" in caught.value.issues[0].remedy
    text = (result / name).read_text()
    (result / name).write_text(text.replace('"adequate"', '"missing"'))
    with pytest.raises(InputError, match=name):
        read_diagnosis(result)
    write_diagnosis(result, Diagnosis(verdict="adequate", result="old"))
    assert read_diagnosis(result) is not None


def test_what_was_read_is_not_continued_with_another_result(place, result):
    read = read_result(result)
    assert read.posterior_file is not None
    for name in (SUMMARY, RESIDUALS):
        shutil.copyfile(place / "new" / name, result / name)
    listed(result)
    for step in (lambda: read.posterior_file, lambda: read.fit, lambda: write_diagnosis(
        result, Diagnosis(verdict="adequate", result="old"), read.identity)):  # fmt: skip
        with pytest.raises(InputError, match="replaced since it was read"):
            step()


def test_a_whole_result_may_be_moved_and_read_only(result, tmp_path):
    moved = result.rename(tmp_path / "moved")
    moved.chmod(0o555)
    try:
        assert read_result(moved).summary.sampled
    finally:
        moved.chmod(0o755)


def test_a_disk_that_is_full_leaves_the_old_result(place, result):
    def full() -> None:
        with replacing_result(result, 0) as scratch:
            (scratch / SUMMARY).write_text("half")
            raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(OSError, match="No space left"):
        full()
    assert content(result) == content(place / "old")
    assert read_result(result).summary.sampled
    assert not [file for file in result.iterdir() if file.name.startswith(".")]


def test_no_page_of_the_result_before_stays(place, result):
    compare(result)
    with replacing_result(result, 0) as scratch:
        for name in (SUMMARY, RESIDUALS):
            shutil.copyfile(place / "new" / name, scratch / name)
    assert not (result / PAGE).exists()


def test_digests_are_computed_once(result, monkeypatch):
    checked(result)
    monkeypatch.setattr(folder_files.hashlib, "file_digest", lambda *_: pytest.fail("read again"))
    checked(result)


def test_a_manifest_lists_every_file(place):
    record = json.loads((place / "old" / MANIFEST).read_text())
    assert {each["name"] for each in record["fit"]} == {SUMMARY, RESIDUALS, POSTERIOR}
    assert [each["name"] for each in record["added"]] == [DIAGNOSIS]
