"""Tests run strict: double precision, no silent promotion of rank or type, shapes and types checked."""

import functools
import os
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import jax
import jaxtyping
from beartype import BeartypeConf, beartype
from beartype.claw import beartype_packages
from beartype.claw._ast.clawastmain import BeartypeNodeTransformer
from hypothesis import settings
from hypothesis.internal.conjecture import providers

# An int stands if a float is asked for (PEP 484).
CONFIGURATION = BeartypeConf(is_pep484_tower=True)
checked = beartype(conf=CONFIGURATION)
# What takes jaxtyping: shapes of arrays, and names that exist for type checkers alone, which it passes over.
_OF_JAXTYPING = ("imubayes.foundations.arrays", "from jaxtyping", "TYPE_CHECKING")

# What is imported from within a module under the hook is looked for as if it, too, had been compiled under it, and is
# compiled anew: some 1400 modules, so they come first.
IMPORTED_FIRST = (
    "arviz_base",
    "arviz_stats",
    "cyclopts",
    "diffrax",
    "emcee",
    "h5netcdf",
    "matplotlib.backends.backend_agg",
    "polars",
    "pyarrow.parquet",
    "pydantic",
    "rich.table",
    "scipy.interpolate",
    "scipy.ndimage",
    "tomlkit",
)


# Shapes are checked at the first calls of a function and at every hundredth later on: a check takes longer than most of
# the functions, and some are called 100 000 times in a test.
FIRST_CALLS, EVERY = 30, 100


def _sampled(function: Callable, checked_function: Callable) -> Callable:
    """Return a function that is checked at its first calls, and now and then later."""
    calls = 0

    @functools.wraps(function)
    def called(*args, **kwargs):
        nonlocal calls
        calls += 1
        return (checked_function if calls <= FIRST_CALLS or calls % EVERY == 0 else function)(*args, **kwargs)

    return called


def shaped(checked_item: Any = None, *, typechecker: Callable) -> Any:
    """Decorate a function, or the constructor of a record, as `jaxtyping.jaxtyped` does, for a sample of its calls."""
    if checked_item is None:
        return functools.partial(shaped, typechecker=typechecker)
    if "<locals>" in checked_item.__qualname__:
        return checked_item
    plain = checked_item.__init__ if isinstance(checked_item, type) else checked_item
    decorated = _JAXTYPED(checked_item, typechecker=typechecker)
    if not isinstance(decorated, type):
        return _sampled(plain, decorated)
    if decorated.__init__ is not plain:
        decorated.__init__ = _sampled(plain, decorated.__init__)
    return decorated


_JAXTYPED = jaxtyping.jaxtyped


def _unless_nested(visit: Callable) -> Callable:
    """Return a visitor of functions that passes over nested ones: they would be decorated anew at every outer call."""

    def visited(self, node):
        outermost = self._scopes.is_scope_module or self._scopes.is_scope_class
        return visit(self, node) if outermost else self.generic_visit(node)

    return visited


def modules(source: Path, shaped: bool) -> tuple[str, ...]:
    """Return the modules below a folder that jaxtyping has to check, or those for which beartype is enough."""
    files = [file for file in sorted(source.rglob("*.py")) if file.stem != "__init__"]
    return tuple(
        ".".join(file.relative_to(source).with_suffix("").parts)
        for file in files
        if any(word in file.read_text() for word in _OF_JAXTYPING) == shaped
    )


def be_strict() -> None:
    """Set JAX, Hypothesis and the import hooks, before the first import of the package."""
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_numpy_rank_promotion", "raise")
    jax.config.update("jax_numpy_dtype_promotion", "strict")
    jax.config.update("jax_compilation_cache_dir", str(Path(os.environ["XDG_CACHE_HOME"]) / "imubayes" / "compiled"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    # The same examples every time, and no clock: a first call compiles.
    settings.register_profile("tests", derandomize=True, deadline=None, max_examples=50)
    settings.load_profile("tests")
    # Constants of the source would be collected at each start, and any edit of the source would change the examples.
    providers._get_local_constants = lambda: providers._local_constants
    for package in IMPORTED_FIRST:
        import_module(package)
    # Beartype alone is a tenth of the cost if no shapes are declared.
    source = Path(__file__).parents[1] / "src"
    jaxtyping.jaxtyped = shaped
    jaxtyping.install_import_hook(modules(source, shaped=True), "strict_types.checked")
    BeartypeNodeTransformer.visit_FunctionDef = _unless_nested(BeartypeNodeTransformer.visit_FunctionDef)
    beartype_packages(modules(source, shaped=False), conf=CONFIGURATION)
