"""What decides the numbers of a batch: the model, the settings, and the code; together they name its results."""

import hashlib
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Literal

from imubayes.model.model_spec import ModelSpec

Sampling = Literal["all", "flagged", "none"]
"""Which units are sampled by emcee: all, those whose Laplace approximation is in doubt, or none."""
_DIGITS = 12
# Packages that show results or read commands decide no number.
_SHOWN = ("display", "cli", "qualification", "campaign/convert", "api.py")


@dataclass(frozen=True)
class BatchSettings:
    """How each unit is treated.

    Attributes
    ----------
    sample : which units are sampled.
    diagnose : whether each fit is diagnosed.
    seed : of the sampler.
    """

    sample: Sampling = "none"
    diagnose: bool = False
    seed: int = 0


def batch_key(spec: ModelSpec, settings: BatchSettings) -> str:
    """Return the hash of model, settings and code, under which results are kept."""
    effects = sorted(repr(replace(effect, where="")) for effect in spec.effects)
    sources = [Path(file).read_text(encoding="utf-8") for file in spec.files]
    return _digest(spec.name, *effects, *sources, repr(spec.delta_k_threshold), repr(settings), code_version())


@cache
def code_version() -> str:
    """Return the version of the package and the hash of those of its sources that decide numbers."""
    root = Path(__file__).parents[1]
    files = sorted(file.relative_to(root).as_posix() for file in root.rglob("*.py"))
    chosen = [name for name in files if not name.startswith(_SHOWN)]
    content = [(root / name).read_text(encoding="utf-8") for name in chosen]
    return f"{version('imubayes')}+{_digest(*chosen, *content)}"


def _digest(*texts: str) -> str:
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()[:_DIGITS]
