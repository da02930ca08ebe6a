"""What only reads a result, `history` and `compare`, loads neither JAX nor ArviZ."""

import subprocess
import sys

import pytest

HEAVY = {"jax", "equinox", "optimistix", "emcee", "arviz_stats", "arviz_base"}


def loaded(*modules: str) -> set[str]:
    """Return the packages that a process has loaded after importing modules."""
    code = f"import sys, {', '.join(modules)}; print(*{{name.partition('.')[0] for name in sys.modules}})"
    return set(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split())


@pytest.mark.compiled  # processes
def test_reading_a_result_needs_no_jax():
    found = loaded("imubayes.display.compare_report", "imubayes.display.loop.history")
    assert "polars" in found
    assert not found & HEAVY
    # It would be seen.
    assert "jax" in loaded("imubayes.results.result")
