"""No command loads what it has no use for: reading a result needs no JAX, a fit no report, archive or page."""

import functools
import subprocess
import sys
from pathlib import Path

import pytest

# What `imubayes fit --no-sample` imports, command line and report included.
FIT = ("imubayes.cli.main", "imubayes.cli.fit", "imubayes.results.folder_state", "imubayes.display.check_report",
       "imubayes.api.fitting", "imubayes.display.fit_report")  # fmt: skip
SATELLITES = ("criticism.evidence", "simulation")
CAMPAIGN = Path(__file__).parents[2] / "data" / "hidden-gyro"
MOST_MODULES = 198
"""Modules of our own that a fit of that campaign may import."""
HEAVY = {"jax", "equinox", "optimistix", "emcee", "arviz_stats", "arviz_base"}


@functools.cache
def executed(*modules: str, then: str = "") -> frozenset[str]:
    """Return the modules that a process has executed after importing modules, and what it does then.

    Lazy ones are left to their first use.
    """
    code = (
        f"import sys, importlib.util, {', '.join(modules)}\n{then}\n"
        "lazy = importlib.util._LazyModule\n"
        "print(*(name for name, module in sys.modules.items() if type(module) is not lazy))"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    return frozenset(told.split())


def loaded(*modules: str) -> set[str]:
    """Return the packages that a process has loaded after importing modules."""
    return {name.partition(".")[0] for name in executed(*modules)}


def satellites(modules: frozenset[str]) -> list[str]:
    """Return the modules of satellites among some; a package that holds nothing but its docstring is none."""
    prefixes = tuple(f"imubayes.{name}." for name in SATELLITES)
    beside = {name for name in modules if name.startswith("imubayes_") and "." in name}
    registered = {name for name in beside if name.split(".")[1] == "cli" or name == "imubayes_qualification.onboard"}
    return sorted({name for name in modules if name.startswith(prefixes)} | beside - registered)


@pytest.mark.compiled  # processes
def test_reading_a_result_needs_no_jax():
    found = loaded("imubayes.display.compare_report", "imubayes.display.loop.history")
    assert "polars" in found
    assert not found & HEAVY
    # It would be seen.
    assert "jax" in loaded("imubayes.results.result")


@pytest.mark.compiled  # processes
def test_a_fit_loads_no_satellite():
    found = executed(*FIT)
    assert "imubayes.inference.run_fit" in found
    assert satellites(found) == []
    unused = {"arviz_base", "arviz_stats", "emcee", "h5netcdf", "matplotlib", "pandas", "pyarrow.compute", "xarray"}
    assert not found & unused
    # It would be seen.
    assert satellites(executed(*FIT, "imubayes_qualification.budgets.report_budgets"))


@pytest.mark.compiled  # processes
def test_a_fit_imports_what_its_campaign_needs():
    def own(*modules: str) -> set[str]:
        read = f"import imubayes.campaign as read; read.inspect_campaign({str(CAMPAIGN)!r})"
        return {name for name in executed(*FIT, *modules, then=read) if name.startswith("imubayes")}

    found = own()
    assert {"imubayes.procedures.rate_table", "imubayes.inference.run_fit"} <= found
    assert len(found) <= MOST_MODULES
    unused = ("procedures.free_tumble", "campaign.reduction", "inference.ensemble_sampling", "cli.loop")
    assert not found & {f"imubayes.{name}" for name in unused}
    assert "optimistix" not in executed(*FIT)
    # It would be seen.
    assert len(own("imubayes.campaign.reduction", "imubayes.inference.ensemble_sampling")) > MOST_MODULES


@pytest.mark.compiled  # a process
def test_the_page_of_the_loop_loads_no_figures():
    """It draws by itself, and its first points wait for what it loads."""
    assert not loaded("imubayes_explorer.start") & {"matplotlib", "emcee", "arviz_stats", "pandas"}


@pytest.mark.compiled  # processes
def test_numbers_of_a_table_are_read_without_the_functions_of_arrow():
    code = f"import sys, imubayes.campaign as read; read.load_campaign({str(CAMPAIGN)!r}); print(*sys.modules)"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert "pyarrow" in told.split()
    assert "pyarrow.compute" not in told.split()
