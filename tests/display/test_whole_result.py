"""A result folder is one thing: at every instant the old result or the new one; what is neither is refused."""

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
from imubayes.display.compare_report import compare
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
from imubayes.results.folder_state import claim
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


def which(folder: Path, place: Path) -> str:
    """Return which of two results a folder is, after reading it as every command does."""
    result, diagnosis = read_result(folder), read_diagnosis(folder)
    found = "old" if result.summary.sampled else "new"
    assert content(folder) == content(place / found)
    assert (result.posterior_file is None, diagnosis is None) == (found == "new",) * 2
    assert not [file.name for file in folder.iterdir() if file.name == ".committed"]
    return found


@pytest.mark.compiled  # processes
def test_a_kill_at_any_instant_leaves_the_old_result_or_the_new(place, tmp_path, command_environment):
    count = killed(command_environment, place / "old", place / "new", tmp_path)
    begun = [number for number in range(count + 1) if (tmp_path / str(number) / ".committed").is_dir()]
    # A reader that completes what was begun may be killed as well.
    for number in begun[:2]:
        again = killed(command_environment, tmp_path / str(number), tmp_path / "read", tmp_path / "again")
        assert {which(tmp_path / "again" / str(each), place) for each in range(again + 1)} == {"new"}
        shutil.rmtree(tmp_path / "again")
    middle = Path(shutil.copytree(tmp_path / str(begun[1]), tmp_path / "middle"))
    found = [which(tmp_path / str(number), place) for number in range(count + 1)]
    assert found == sorted(found, key=["old", "new"].index)
    assert (found[0], found[-1], found[begun[0]]) == ("old", "new", "new")
    assert len(begun) >= 4, "a folder between two results was met"
    # The next writer finishes: nothing of what was left behind stays.
    with replacing_result(middle, 0) as scratch:
        for name in (SUMMARY, RESIDUALS):
            shutil.copyfile(place / "new" / name, scratch / name)
    assert not read_result(middle).summary.sampled
    assert not [file.name for file in middle.iterdir() if file.name.startswith(".") or file.name == DIAGNOSIS]


@pytest.mark.compiled  # processes
def test_a_first_result_that_was_committed_is_one(place, tmp_path, command_environment):
    (tmp_path / "none").mkdir()
    count = killed(command_environment, tmp_path / "none", place / "new", tmp_path / "copies")
    seen = set()
    for folder in (tmp_path / "copies" / str(number) for number in range(count + 1)):
        committed = (folder / ".committed").is_dir() or (folder / MANIFEST).is_file()
        seen.add(committed)
        claim(folder) if not committed else which(folder, place)
    assert seen == {False, True}


@pytest.mark.compiled  # processes
def test_a_kill_while_a_file_is_added_leaves_the_fit_with_or_without_it(place, tmp_path, command_environment):
    (tmp_path / "text").write_text("{}\n")
    count = killed(command_environment, place / "old", tmp_path / "text", tmp_path)
    found = []
    for number in range(count + 1):
        folder = tmp_path / str(number)
        assert checked(folder).identity == checked(place / "old").identity
        assert content(folder) == content(place / "old")
        found.append(added(folder, BUDGETS) is not None)
        add_to(folder, BUDGETS, "{}\n")
        assert added(folder, BUDGETS) == folder / BUDGETS
        assert not [file.name for file in folder.iterdir() if file.name.startswith(".")]
    assert found == sorted(found)
    assert {*found} == {False, True}


def test_a_change_that_cannot_be_completed_is_told_and_kept(place, result, monkeypatch):
    shutil.copytree(place / "new", result / ".committed")
    (result / ".committed" / ".removed").write_text("\0".join((POSTERIOR, DIAGNOSIS)))

    def read_only(*_, **__):
        raise OSError(errno.EROFS, "Read-only file system", str(result))

    with monkeypatch.context() as patched:
        patched.setattr("imubayes.foundations.files.only_writer", read_only)
        patched.setattr("imubayes.foundations.files.PATIENCE", 0.0)
        with pytest.raises(InputError, match="interrupted and cannot be completed: Read-only"):
            read_result(result)
    assert which(result, place) == "new"


def test_what_came_along_removes_nothing_elsewhere(result, tmp_path):
    (tmp_path / "mine").write_text("mine")
    (result / ".committed").mkdir()
    names = "\0".join(["../mine", str(tmp_path / "mine"), "figures/../../mine", "notes"])
    (result / ".committed" / ".removed").write_text(names)
    (result / "notes").write_text("notes")
    assert read_result(result).summary.sampled
    assert (tmp_path / "mine").read_text() == "mine"
    assert not (result / "notes").exists()


@pytest.mark.parametrize("read", [checked, lambda folder: added(folder, DIAGNOSIS)], ids=["fit", "added"])
def test_a_result_replaced_while_it_is_checked_is_read_anew(place, result, monkeypatch, read):
    """The manifest is that of the old result, and its files are looked at when they are those of the new one."""
    unpatched, manifests = folder_files._read, []

    def replaced_after(folder: Path):
        found = unpatched(folder)
        manifests.append(found)
        if len(manifests) == 1:
            with replacing_result(folder, 0) as scratch:
                for name in (SUMMARY, RESIDUALS):
                    shutil.copyfile(place / "new" / name, scratch / name)
        return found

    monkeypatch.setattr(folder_files, "_read", replaced_after)
    found = read(result)
    assert found is None or found.identity == unpatched(place / "new").identity
    assert content(result) == content(place / "new")
    (result / SUMMARY).write_text("altered")
    with pytest.raises(InputError, match=r"summary\.json has"):
        read(result)


@pytest.mark.parametrize("kind", ["folder", "file", "nothing"])
def test_a_link_in_place_of_a_change_takes_nothing_from_where_it_leads(result, tmp_path, kind):
    elsewhere = tmp_path / "elsewhere"
    if kind == "folder":
        elsewhere.mkdir()
        (elsewhere / "mine").write_text("mine")
    elif kind == "file":
        elsewhere.write_text("mine")
    (result / ".committed").symlink_to(elsewhere)
    for step in (lambda: read_result(result), lambda: add_to(result, BUDGETS, "{}\n")):
        with pytest.raises(InputError, match=r"\.committed is not a folder") as caught:
            step()
        assert caught.value.issues[0].where == str(result / ".committed")
    assert kind != "folder" or (elsewhere / "mine").read_text() == "mine"
    (result / ".committed").unlink()
    assert read_result(result).summary.sampled


def test_a_folder_in_the_way_of_a_change_is_named(place, result, monkeypatch):
    shutil.copytree(place / "new", result / ".committed")
    (result / ".committed" / ".removed").write_text("\0".join((POSTERIOR, DIAGNOSIS)))
    (result / SUMMARY).unlink()
    (result / SUMMARY).mkdir()
    monkeypatch.setattr("imubayes.foundations.files.PATIENCE", 0.0)
    with pytest.raises(InputError, match="a folder is in the way") as caught:
        read_result(result)
    assert caught.value.issues[0].where == str(result / SUMMARY)
    assert "move" in caught.value.issues[0].remedy
    (result / SUMMARY).rmdir()
    assert which(result, place) == "new"


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


def test_no_picture_of_the_result_before_stays(place, result):
    compare(result)
    figures = result / "figures"
    assert len([*figures.glob("*.png")]) == 5
    for name in ("diagnosis.png", "recorded_noise.png", "mine.png"):
        (figures / name).write_text("drawn")
    with replacing_result(result, 0) as scratch:
        for name in (SUMMARY, RESIDUALS):
            shutil.copyfile(place / "new" / name, scratch / name)
    assert not (result / PAGE).exists()
    assert [file.name for file in figures.iterdir()] == ["mine.png"]


def test_digests_are_computed_once(result, monkeypatch):
    checked(result)
    monkeypatch.setattr(folder_files.hashlib, "file_digest", lambda *_: pytest.fail("read again"))
    checked(result)


def test_a_manifest_lists_every_file(place):
    record = json.loads((place / "old" / MANIFEST).read_text())
    assert {each["name"] for each in record["fit"]} == {SUMMARY, RESIDUALS, POSTERIOR}
    assert [each["name"] for each in record["added"]] == [DIAGNOSIS]
