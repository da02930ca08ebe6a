"""A full disk or a plain terminal is no internal error."""

import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from imubayes.cli import main
from imubayes.cli.main import run

ROOT = Path(__file__).parents[2]
CAMPAIGN = str(ROOT / "data" / "accel-channel")


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), "the disk is full"),
        (OSError(errno.EDQUOT, "Disk quota exceeded", "/home/file"), "/home/file"),
        (RuntimeError("Can't write data (errno = 28, error message = 'No space left on device')"), "the disk is full"),
        (OSError(errno.EIO, "Input/output error"), "file system error: Input/output error"),
        (MemoryError(), "not enough memory"),
    ],
    ids=["full", "quota", "of a library", "other", "memory"],
)
def test_a_full_disk_and_a_full_memory_are_said(monkeypatch, capsys, error, said):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr(main, "app", fail)
    assert run(["check", CAMPAIGN]) == 2
    err = capsys.readouterr().err
    assert said in err
    assert "internal error" not in err
    assert all(part in err for part in ("error: ", "  where:   ", "  allowed: ", "  do:      "))


def command(environment: dict[str, str], *words: str, stdout: int = subprocess.PIPE) -> subprocess.CompletedProcess:
    line = [sys.executable, "-m", "imubayes.cli.main", *words]
    return subprocess.run(line, env=environment, stdout=stdout, stderr=subprocess.PIPE, text=True, check=False)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
@pytest.mark.slow
def test_output_that_is_lost_is_told(command_environment):
    full = os.open("/dev/full", os.O_WRONLY)
    try:
        done = command(command_environment, "effects", stdout=full)
    finally:
        os.close(full)
    assert done.returncode == 2
    assert "error: the disk is full" in done.stderr


@pytest.mark.slow
def test_a_terminal_without_greek_letters(command_environment):
    plain = command_environment | {"PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0", "LC_ALL": "C"}
    done = command(plain, "check", CAMPAIGN, "--json")
    assert (done.returncode, "internal" in done.stderr) == (0, False)
    assert json.loads(done.stdout)["campaign"]
    shown = command(plain, "effects", "accel_scale_factor")
    assert (shown.returncode, "error" in shown.stderr) == (0, False)
    assert "accel_scale_factor" in shown.stdout


def test_names_do_not_steer_the_terminal(tmp_path, capsys):
    (tmp_path / "campaign.toml").write_text('format = 1\nname = "a\\u001b]0;title\\u0007"\n')
    assert run(["check", str(tmp_path)]) == 2
    err = capsys.readouterr().err
    assert "\x1b" not in err
    assert "text without brackets, commas and control characters" in err
    assert run(["check", str(tmp_path / "no\x1b[31mfolder")]) == 2
    err = capsys.readouterr().err
    assert "\x1b" not in err
    assert "no\\x1b[31mfolder" in err
