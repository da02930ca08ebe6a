"""Double precision is set by the library; a process that has computed in single precision is told so."""

import os
import subprocess
import sys
import time

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
