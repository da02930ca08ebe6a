"""Damaged and hostile recordings: one input error that names the file, in bounded time and memory."""

import gc
import gzip
import shutil
import warnings
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from test_recording_formats import EXTRA, ROWS, WRITERS, gyroflow, receiver

from imubayes.campaign import inspect_campaign
from imubayes.cli.main import run
from imubayes.foundations.errors import InputError, Issue
from imubayes_recordings.convert import read_recordings, recording
from imubayes_recordings.convert.formats import KINDS, open_recording

CASES = Path(__file__).parents[2].parent / "shared" / "cases" / "rel" / "readers"
LIMIT, ZEROS = 1 << 20, 1 << 18
NAMED = ("time_s", "ax", "ay", "az", "gx", "gy", "gz")


def packed_text(folder: Path) -> Path:
    file = folder / "log.csv.gz"
    rows = "\n".join(",".join(f"{value:.6g}" for value in row) for row in ROWS)
    file.write_bytes(gzip.compress(f"{','.join(NAMED)}\n{rows}\n".encode()))
    return file


def understood(file: Path) -> bool:
    """Whether a file is read; False if it is refused with an error in four parts that names it."""
    refused: tuple[Issue, ...] = ()
    try:
        with warnings.catch_warnings(action="ignore", category=RuntimeWarning):  # of numbers beyond all sense
            read_recordings([file], gravity_m_s2=9.8, latitude_deg=50)
    except InputError as error:
        refused = error.issues
    assert all(issue.what and issue.remedy and file.name.partition(".")[0] in issue.where for issue in refused)
    return not refused


WRITTEN = (*WRITERS, packed_text, receiver, gyroflow)


def test_each_registered_kind_is_written(tmp_path: Path) -> None:
    """So that the law below holds over all of them."""
    kinds = set()
    for write in WRITTEN:
        (folder := tmp_path / write.__name__).mkdir()
        file = write(folder)
        head = b"" if file.is_dir() else file.read_bytes()[:4096]
        kinds |= {kind.name for kind in KINDS if kind.fits(head)} | ({"ROS bag"} if write.__name__ == "ros2" else set())
    assert kinds == {kind.name for kind in KINDS}


@pytest.mark.parametrize("write", WRITTEN, ids=lambda write: write.__name__)
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # half-made readers leave files open
def test_a_file_that_is_cut_off_or_has_other_bytes_is_read_or_refused(
    tmp_path: Path, write: Callable[[Path], Path], capfd: pytest.CaptureFixture[str]
) -> None:
    if write in EXTRA:
        pytest.importorskip(EXTRA[write])
    file, random = write(tmp_path), np.random.default_rng(11)
    place = next(part for part in sorted(file.rglob("*")) if part.suffix in (".csv", ".db3")) if file.is_dir() else file
    whole = place.read_bytes()
    for size in np.linspace(0, len(whole), 10, endpoint=False).astype(int).tolist():
        place.write_bytes(whole[:size])
        understood(file)
    for _ in range(10):
        damaged = np.frombuffer(whole, np.uint8).copy()
        damaged[random.integers(0, len(whole), 40)] ^= random.integers(1, 255, 40).astype(np.uint8)
        place.write_bytes(damaged.tobytes())
        understood(file)
    place.write_bytes(whole)
    gc.collect()
    assert "bad header" not in "".join(capfd.readouterr())  # what a foreign reader prints


def test_a_reader_that_fails_in_any_way_is_one_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    np.save(tmp_path / "log.npy", ROWS)

    def failing(file: Path) -> None:
        print("a message of the reader")
        raise ZeroDivisionError("somewhere inside")

    [kind] = [kind for kind in KINDS if kind.name == "NumPy .npy"]
    monkeypatch.setattr("imubayes_recordings.convert.formats.KINDS", (kind.__class__(kind.name, kind.fits, failing),))
    with pytest.raises(InputError, match=r"the NumPy \.npy file cannot be read: somewhere inside"):
        read_recordings([tmp_path / "log.npy"], gravity_m_s2=9.8)


def zeros_npz(folder: Path) -> Path:
    np.savez_compressed(folder / "bomb.npz", **{name: np.zeros(ZEROS) for name in NAMED})
    return folder / "bomb.npz"


def zeros_mat(folder: Path) -> Path:
    scipy_io = pytest.importorskip("scipy.io")
    values = {name: np.zeros(ZEROS) for name in NAMED}
    scipy_io.savemat(folder / "bomb.mat", {"log": values}, do_compression=True)
    return folder / "bomb.mat"


def claiming_h5(folder: Path) -> Path:
    with h5py.File(folder / "claims.h5", "w") as content:
        for name in NAMED:
            content.create_dataset(name, (10**10,), chunks=(1024,), dtype="f8")
    return folder / "claims.h5"


def zeros_parquet(folder: Path) -> Path:
    pl = pytest.importorskip("polars")
    columns = {name: np.zeros(ZEROS) for name in NAMED}
    columns["time_s"] = np.repeat(np.arange(ZEROS // 4096 + 1) * 0.01, 4096)[:ZEROS]
    pl.DataFrame(columns).write_parquet(folder / "bomb.parquet")
    return folder / "bomb.parquet"


@pytest.mark.parametrize("write", [zeros_npz, zeros_mat, claiming_h5, zeros_parquet])
def test_a_small_file_that_expands_without_bounds_is_refused(
    tmp_path: Path, write: Callable[[Path], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording, "LEAST_LIMIT", LIMIT)
    file = write(tmp_path)
    assert file.stat().st_size < 40_000
    with pytest.raises(InputError, match=r"the file of .* bytes expands to .* bytes of numbers"):
        read_recordings([file], gravity_m_s2=9.8)


def test_a_dataset_in_another_file_is_not_read(tmp_path: Path) -> None:
    (tmp_path / "secret").write_bytes(np.arange(100.0).tobytes())
    with h5py.File(tmp_path / "log.h5", "w") as content:
        for name in NAMED:
            content.create_dataset(name, (100,), "f8", external=[(str(tmp_path / "secret"), 0, 800)])
    with pytest.raises(InputError, match="takes its data from other files"):
        read_recordings([tmp_path / "log.h5"], gravity_m_s2=9.8)


def test_an_impossible_sampling_rate_is_named_with_the_unit_that_fits(tmp_path: Path) -> None:
    rows = np.c_[0.02 * np.arange(1500), np.tile([0.0, 0.0, 9.8, 0.0, 0.0, 0.0], (1500, 1))]
    rows[:, 1:] += np.random.default_rng(1).normal(0, 0.01, (1500, 6))
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header=",".join(NAMED), comments="")
    with pytest.raises(InputError) as refused:
        read_recordings([tmp_path / "log.csv"], gravity_m_s2=9.8, time_unit="us")
    assert "5e+07 Hz in us, as stated" in refused.value.issues[0].what
    assert refused.value.issues[0].allowed == "50 Hz in s"
    read_recordings([tmp_path / "log.csv"], gravity_m_s2=9.8, latitude_deg=50).write(tmp_path / "campaign")
    [table] = (tmp_path / "campaign" / "runs").iterdir()
    rows[:, 0] *= 1e-6
    np.savetxt(table, rows, delimiter=",", header=",".join(NAMED), comments="")
    [issue] = inspect_campaign(tmp_path / "campaign").issues
    assert "the sampling rate is 5e+07 Hz" in issue.what
    assert issue.remedy == "multiply the column by 1e+06: 50 Hz"


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.skipif(not CASES.is_dir(), reason="the cases that others tried are not here")
def test_the_cases_that_others_tried(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    for case in sorted(CASES.glob("damaged-*")) + sorted(CASES.glob("claims-*")):
        file = Path(shutil.copy(case, tmp_path))
        assert run(["convert", str(file), "--out", str(tmp_path / "out"), "--gravity-m-s2", "9.81"]) == 2
        gc.collect()
        said = capfd.readouterr().err
        assert file.name in said
        assert "internal error" not in said
        assert "file system error" not in said


def test_nul_bytes_at_the_ends_of_lines_are_left_out_and_said(tmp_path: Path) -> None:
    """A logger on a serial port began with them; one whose power failed goes on in the middle of the file."""
    lines = [",".join(NAMED), *(",".join(f"{value:.6g}" for value in row) for row in ROWS)]
    (plain := tmp_path / "plain.csv").write_text("\n".join(lines) + "\n")
    broken = [lines[0], "\0" * 577 + lines[0], *lines[1:40], "\0" * 512 + lines[40], lines[41] + "\0" * 9, *lines[42:]]
    (padded := tmp_path / "padded.csv").write_text("\r\n".join(broken) + "\r\n" + "\0" * 4096)
    read, expected = open_recording(padded), open_recording(plain)
    columns = range(len(NAMED))
    found, known = (np.concatenate(list(one.blocks(one.topics()[0], columns))) for one in (read, expected))
    np.testing.assert_array_equal(found, known)
    assert any("NUL bytes are left out (line 42, " in note for note in read.notes()), read.notes()
    assert not expected.notes()


def test_wide_characters_without_a_mark_and_binary_numbers_are_no_padded_text(tmp_path: Path) -> None:
    for name, content in (("wide", "time,ax\n1,2\n".encode("utf-16-le")), ("binary", np.arange(99.0).tobytes())):
        (file := tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match="no known kind"):
            read_recordings([file], gravity_m_s2=9.8, latitude_deg=50)
