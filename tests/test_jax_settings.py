"""Double precision is set by the library; a process that has computed in single precision is told so."""

import os
import subprocess
import sys
import time

import pytest

from imubayes.compiled.jax_settings import _without_empty

_SCRIPT = """
import jax, jax.numpy as jnp
{before}
from imubayes.foundations.errors import InputError
from imubayes.compiled.jax_settings import prepare_jax
try:
    prepare_jax()
except InputError as error:
    print(error.issues[0])
print(jnp.zeros(1).dtype)
"""


def said(before: str) -> str:
    script = _SCRIPT.format(before=before)
    return subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout


def test_double_precision_is_switched_on():
    assert said("").split() == ["float64"]


@pytest.mark.slow
def test_a_campaign_begun_in_a_fresh_process_is_in_double_precision(tmp_path):
    """Nothing is traced before double precision is switched on, whichever public function comes first."""
    (tmp_path / "poses.csv").write_text("ax,ay,az\n" + "9.8,0,0\n0,9.8,0\n0,0,9.8\n-9.8,0,0\n0,-9.8,0\n0,0,-9.8\n")
    script = f"import imubayes; imubayes.new({str(tmp_path / 'unit')!r}, {str(tmp_path / 'poses.csv')!r}, rows='means')"
    subprocess.run([sys.executable, "-W", "error::UserWarning:jax", "-c", script], check=True)


def test_single_precision_in_use_is_an_error_with_its_remedy():
    answer = said("jnp.zeros(1) + 1")
    assert "JAX has been started in single precision" in answer
    assert 'jax.config.update("jax_enable_x64", True)' in answer
    assert answer.split()[-1] == "float32"


def test_empty_entries_of_killed_processes_are_removed_from_the_cache(tmp_path):
    for name, content, age in (("whole", b"code", 3600.0), ("empty", b"", 3600.0), ("begun", b"", 0.0)):
        file = tmp_path / name
        file.write_bytes(content)
        os.utime(file, (time.time() - age, time.time() - age))
    _without_empty(tmp_path)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["begun", "whole"]
