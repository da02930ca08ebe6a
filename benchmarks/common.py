"""Shared by all benchmarks: the machine in words, timings, tables, and the campaign that is measured."""

import os
import platform
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

from imubayes.campaign import load_campaign  # noqa: E402
from imubayes.model.bind import Model, bind  # noqa: E402
from imubayes.model.model_file import read_model  # noqa: E402

ROOT = Path(__file__).parents[1]
RESULTS = Path(__file__).parent / "results"


@dataclass
class Report:
    """A benchmark's tables and sentences, printed as they come and written as one page."""

    name: str
    title: str
    lines: list[str] = field(default_factory=list)

    def __post_init__(self):
        self.say(f"# {self.title}\n\n{machine()}\n")

    def say(self, text: str = "") -> None:
        self.lines.append(text)
        print(text, flush=True)

    def table(self, head: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
        cells = [[str(cell) for cell in row] for row in (head, *rows)]
        width = [max(len(row[column]) for row in cells) for column in range(len(head))]
        rule = ["-" * one for one in width]
        for row in (cells[0], rule, *cells[1:]):
            self.say("| " + " | ".join(cell.ljust(one) for cell, one in zip(row, width, strict=True)) + " |")
        self.say()

    def judge(self, what: str, value: float, bar: float, least: bool = True) -> None:
        """Say a figure beside the one that is asked for."""
        met = value >= bar if least else value <= bar
        sign = "at least" if least else "at most"
        self.say(f"- {what}: {value:.3g} (asked: {sign} {bar:g}) {'met' if met else 'NOT met'}")

    def write(self) -> Path:
        RESULTS.mkdir(parents=True, exist_ok=True)
        file = RESULTS / f"{self.name}.md"
        file.write_text("\n".join(self.lines).rstrip() + "\n", encoding="utf-8")
        return file


def machine() -> str:
    """Return the machine and the versions in a line or two."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    names = ("jax", "jaxlib", "numpy", "scipy", "emcee", "optimistix", "numpyro")
    versions = ", ".join(f"{name} {_version(name)}" for name in names if _version(name))
    return (
        f"{cores} cores ({platform.machine()}), {jax.default_backend()} backend in double precision, "
        f"Python {platform.python_version()}, {versions}."
    )


def _version(name: str) -> str:
    try:
        return version(name)
    except ModuleNotFoundError:
        return ""


def trihedral() -> Model:
    """Return the full baseline model declared on the shipped campaign."""
    return bind(read_model(ROOT / "models/trihedral-imu.toml"), load_campaign(ROOT / "data/trihedral-imu"))


def seconds(call: Callable[[], Any], least: int = 5, budget: float = 3.0) -> float:
    """Return the median time of a call whose outcome is waited for; the first, which compiles, is left out."""
    jax.block_until_ready(call())
    taken: list[float] = []
    while len(taken) < least or (sum(taken) < budget and len(taken) < 200):
        taken.append(once(call))
    return statistics.median(taken)


def once(call: Callable[[], Any]) -> float:
    """Return the time of one call."""
    clock = time.perf_counter()
    jax.block_until_ready(call())
    return time.perf_counter() - clock


def in_words(value: float) -> str:
    """Write a time with a fitting unit."""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        if value >= size:
            return f"{value / size:.3g} {unit}"
    return f"{value * 1e9:.3g} ns"


def require(package: str) -> None:
    """Leave with a sentence if a package of the `bench` extra is missing."""
    if not _version(package):
        sys.exit(
            f"This benchmark compares with {package}, which is not installed.  It belongs to the extra 'bench': "
            "run `make bench`, or `pip install imubayes[bench]`."
        )
