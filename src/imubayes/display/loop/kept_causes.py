"""The effects behind differences of classical estimates, kept in the result folder once they are found.

They take the model of the fit, and with it JAX: longer to load than all else that a comparison needs.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import polars as pl

from imubayes.foundations.deferred_modules import DeferredModule
from imubayes.foundations.errors import InputError
from imubayes.foundations.records import Record
from imubayes.results.folder_files import CAUSES, add_to, added, checked
from imubayes.results.summary import Summary

# They load JAX.
effects_behind: Any = DeferredModule("imubayes.display.loop.effects_behind")
fit_file: Any = DeferredModule("imubayes.results.fit_file")

# Changed if the effects behind the same differences come out otherwise, so that those that are kept are found anew.
_METHOD = 1


class ClassicalCause(Record):
    """What an effect adds to the classical less the joint estimate of a quantity from a run, in the unit of both."""

    name: str
    run: str
    effect: str
    size: float


class KeptCauses(Record):
    """The contents of `causes.json`: what each effect adds to each difference, and the method that found it."""

    method: int
    causes: tuple[ClassicalCause, ...]


def causes_of(
    folder: Path, residuals: pl.DataFrame, summary: Summary
) -> Mapping[tuple[str, str], Sequence[tuple[str, float]]]:
    """Return what each effect of a result adds to the classical less the joint estimate, by (name, run).

    Budgets kept in the result folder are taken if it is of this fit; else it is found and kept there.

    Parameters
    ----------
    residuals, summary : of the folder, whose campaign is as it was fitted.

    Raises
    ------
    InputError
        if the folder holds no whole fit, or its campaign or model is no longer the one that was fitted.
    """
    kept = _kept(folder)
    if kept is None or kept.method != _METHOD:
        identity = checked(folder).identity
        found = effects_behind.effects_behind(fit_file.read_fit(folder), residuals, summary)
        causes = [
            ClassicalCause(name=name, run=run, effect=effect, size=size)
            for (name, run), own in found.items()
            for effect, size in own
        ]
        kept = KeptCauses(method=_METHOD, causes=tuple(causes))
        with suppress(OSError, InputError):  # of a result that cannot be written to they are found every time
            add_to(folder, CAUSES, kept.model_dump_json() + "\n", identity)
    behind: dict[tuple[str, str], list[tuple[str, float]]] = {}
    for each in kept.causes:
        behind.setdefault((each.name, each.run), []).append((each.effect, each.size))
    return behind


def _kept(folder: Path) -> KeptCauses | None:
    """Return what a folder keeps of its fit; None if there is nothing as it was written."""
    try:
        file = added(folder, CAUSES)
        return KeptCauses.model_validate_json(file.read_bytes()) if file is not None else None
    except (InputError, OSError, ValueError):
        return None
