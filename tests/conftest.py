"""Tests run strict: double precision, no silent promotion of rank or type, shapes and types checked at every call."""

import os
from importlib import import_module
from pathlib import Path

import jax
import pytest
from hypothesis import settings
from jaxtyping import install_import_hook

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")
# Everything compiled is kept, for tests and for the commands they run alike, so that it is paid for once.
os.environ["XDG_CACHE_HOME"] = str(Path(__file__).parents[1] / ".cache" / "commands")
jax.config.update("jax_compilation_cache_dir", str(Path(os.environ["XDG_CACHE_HOME"]) / "imubayes" / "compiled"))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)

# The same examples every time, and no clock: a first call compiles.
settings.register_profile("tests", derandomize=True, deadline=None, max_examples=50)
settings.load_profile("tests")

# Folders whose tests compile models of their own.
HEAVY = ("readme", "criticism", "cli", "conformance", "inference", "model", "display", "results")

# What is imported from within a module under the hook is looked for as if it, too, had been compiled under it, and is
# compiled anew: some 1400 modules, so they come first.
for package in (
    "arviz_base",
    "arviz_stats",
    "cyclopts",
    "diffrax",
    "emcee",
    "h5netcdf",
    "matplotlib.backends.backend_agg",
    "optimistix",
    "polars",
    "pyarrow.parquet",
    "pydantic",
    "rich.table",
    "scipy.interpolate",
    "scipy.ndimage",
    "tomlkit",
):
    import_module(package)
# The hook must stand before the first import of the package, which test modules make after this file.
install_import_hook("imubayes", "strict_types.checked")


def pytest_configure(config):
    # Most of what is tested runs once, so that compiling is what takes time.  The long studies, and the commands that
    # are run as a user would run them, are compiled as a user has them.
    jax.config.update("jax_disable_most_optimizations", "not slow" in config.option.markexpr)
    # Two test processes share the cache: an entry that is still being written is compiled again.
    config.addinivalue_line("filterwarnings", "ignore:Error (reading|writing) persistent compilation cache:UserWarning")
    # Aliases of other packages, such as rich's, are still written in the old way.
    config.addinivalue_line("filterwarnings", "ignore::beartype.roar.BeartypeDecorHintPep585DeprecationWarning")


def pytest_collection_modifyitems(items):
    """Heavy tests first, so that none is left over at the end; a file stays with one process, for its fixtures."""
    items.sort(key=lambda item: HEAVY.index(_part(item)) if _part(item) in HEAVY else len(HEAVY))


def _part(item) -> str:
    return item.path.relative_to(Path(__file__).parent).parts[0]


@pytest.fixture(scope="session")
def compile_cache() -> dict[str, str]:
    """Environment for commands run as a user would: the package from this tree, compiled code kept between tests."""
    return os.environ | {"PYTHONPATH": str(Path(__file__).parents[1] / "src")}
