"""The run-time type checker of the tests: beartype, with an int where a float is asked for (PEP 484)."""

from pathlib import Path

from beartype import BeartypeConf, beartype

CONFIGURATION = BeartypeConf(is_pep484_tower=True)
checked = beartype(conf=CONFIGURATION)
# What takes jaxtyping: shapes of arrays, and names that exist for type checkers alone, which it passes over.
_OF_JAXTYPING = ("imubayes.foundations.arrays", "from jaxtyping", "TYPE_CHECKING")


def modules(source: Path, shaped: bool) -> tuple[str, ...]:
    """Return the modules below a folder that jaxtyping has to check, or those for which beartype is enough."""
    files = [file for file in sorted(source.rglob("*.py")) if file.stem != "__init__"]
    return tuple(
        ".".join(file.relative_to(source).with_suffix("").parts)
        for file in files
        if any(word in file.read_text() for word in _OF_JAXTYPING) == shaped
    )
