"""The cases of the study of the evidence: drawn plans, what is planted in them, and how a campaign is written.

S is that of `detectability`: linear algebra at the truth, which shares no line with the library.
"""
# pyright: reportMissingImports=false

import csv
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from datetime import datetime
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "data" / "generators"))
sys.path.insert(0, str(Path(__file__).parent))
import hidden
from blind import PROCEDURES
from divergence import seen_past_noise
from foreign_causes import CAUSES, NOISES, ROUNDED, Rows

FIRST = 520001
SIZES = (1.0, 0.3, 0.15)
"""Of hidden effects, in units of the drawn typical size."""
SEEN, EQUAL = 25.0, 0.99
"""S from which an effect counts as detectable, and share of a signal from which an effect is the same shape."""
TEMPLATES = ("table", "temperatures", "head", "cycle", "converter", "gyros", "converter_cycle")
PLACES = tuple(each for each in PROCEDURES if each not in ("servo_table", "dividing_head")) + TEMPLATES
TRIES = 5
"""Effects that a plan may fail to show before it is given up."""
UNCUT = ("geographic_tumble", "rotation_modulation", "free_tumble", "static_record")
"""Procedures of too few runs to be cut."""


@dataclass(frozen=True)
class Setting:
    """A procedure, whether the model has scatter between runs, and whether runs are cut out."""

    procedure: str
    seed: int
    scatter: bool
    cut: bool


@dataclass(frozen=True)
class Bench:
    """A drawn plan with its truth, as a sight, and the effects that its model lacks and the plan may show."""

    sight: Any
    model: Path
    first: str
    missing: tuple[str, ...]


@dataclass(frozen=True)
class Case:
    """A campaign to be written: planted effects with S, and what is done to the outputs (rows, K) afterwards.

    `explained` shows which share of S of a cause some effects of the catalogue explain together.
    """

    part: str
    label: str
    planted: tuple[dict[str, Any], ...] = ()
    edit: Callable[[np.ndarray], np.ndarray] | None = None
    cause: dict[str, Any] = field(default_factory=dict)
    explained: Callable[[Iterable[str]], float] = lambda effects: 0.0


def settings() -> Iterator[Setting]:
    """Yield all settings: each round holds every procedure once, so that a part of them is balanced."""
    kinds = [(scatter, cut) for cut in (False, True) for scatter in (True, False)]
    for number in range(len(kinds) * len(PLACES)):
        turn, place = divmod(number, len(PLACES))
        scatter, cut = kinds[(turn + place) % len(kinds)]
        yield Setting(PLACES[place], FIRST + number, scatter, cut and PLACES[place] not in UNCUT)


def bench_of(setting: Setting, folder: Path) -> Bench | None:
    """Draw plan, hidden effect and truth; None if no effect could be shown."""
    random = np.random.default_rng(setting.seed)
    drawn = hidden.PLANS.get(setting.procedure)
    plan = drawn.draw(random) if drawn else hidden.random_plan(setting.procedure, random)
    plan = replace(_cut(plan, random) if setting.cut else plan, model=folder / "model.toml")
    effects = [each for each in hidden.applicable(setting.procedure, hidden.CATALOGUE) if plan.shows(each)]
    for first in random.permutation(effects)[:TRIES].tolist():
        base = hidden._base("hidden", setting.procedure, [first], random)
        gone = [first, *([] if setting.scatter else ["run_scatter"])]
        gone += hidden.belonging_to_others(base, {channel.kind for channel in plan.channels})
        plan.model.write_text(text := hidden.without(base, gone), encoding="utf-8")
        values = {f"run_scatter.tau[{channel.name}]": 0.0 for channel in plan.channels}
        sight = hidden.look(plan, values | plan.draw(setting.seed))
        bench = Bench(sight, plan.model, first, tuple(each for each in effects if f'name = "{each}"' not in text))
        if _planted(bench, first, 1.0, random) is not None:
            return bench
    return None


def _cut(plan: Any, random: np.random.Generator) -> Any:
    count = min(int(random.integers(4, 10)), len(plan.runs) - 1)
    stay = sorted(random.permutation(len(plan.runs))[:count].tolist())
    runs = tuple(plan.runs[each] for each in stay)
    used = {run.table for run in runs}, {run.mounting for run in runs}
    poses = {"poses": tuple(plan.poses[each] for each in stay)} if hasattr(plan, "poses") else {}
    tables, mountings = (
        tuple(x for x in every if x.name in names)
        for every, names in zip((plan.tables, plan.mountings), used, strict=True)
    )
    return replace(plan, runs=runs, tables=tables, mountings=mountings, **poses)


def _planted(bench: Bench, effect: str, size: float, random: np.random.Generator) -> dict[str, Any] | None:
    """Draw an effect at its typical size times another; None if the plan does not show it."""
    where = hidden.places(bench.sight.moments.plan, hidden.CATALOGUE[effect].on, random)
    if not where:
        return None
    values = hidden.scaled(hidden.unit_effect(bench.sight.moments.plan, effect, where, random), size)
    s = bench.sight.detectability(values)
    return _as_planted(effect, where, values, s) if np.isfinite(s) and s >= SEEN else None


def _as_planted(effect: str, where: tuple[str, ...], values: dict[str, float], s: float) -> dict[str, Any]:
    channels = () if hidden.CATALOGUE[effect].on in hidden.EQUIPMENT else where
    return {"effect": effect, "channels": list(channels), "where": list(where), "values": values, "s": s}


# the cases of a setting


def singles(bench: Bench, random: np.random.Generator) -> Iterator[Case]:
    """Yield two hidden effects, each at every size; `seen` is S where nobody knows the size of the noise."""
    others = [each for each in random.permutation(bench.missing).tolist() if each != bench.first]
    drawn = (_planted(bench, effect, 1.0, random) for effect in [bench.first] * 4 + others[:8])
    shown: dict[str, dict[str, Any]] = {}
    for one in drawn:
        if one is not None and len(shown) < 2:
            shown.setdefault(one["effect"], one)
    for number, one in enumerate(shown.values()):
        for size in SIZES:
            values = hidden.scaled(one["values"], size)
            s = float(bench.sight.detectability(values))
            seen = min(bench.sight.seen(values), seen_past_noise(bench.sight, values)) if s >= SEEN else 0.0
            planted = _as_planted(one["effect"], tuple(one["where"]), values, s) | {"size": size, "seen": float(seen)}
            yield Case("a", f"{number + 1}×{size:g}", (planted,))


def several(bench: Bench, random: np.random.Generator) -> Iterator[Case]:
    """Yield a pair and a triple: each is detectable beside the others; `seen` as of single ones."""
    for count in (2, 3):
        for _ in range(8):
            names = random.permutation(bench.missing)[:count].tolist()
            found = [_planted(bench, name, float(random.uniform(0.3, 1.0)), random) for name in names]
            planted = [each for each in found if each is not None]
            if len(planted) < count:
                continue
            columns = [hidden.tangents(bench.sight, each["effect"], tuple(each["where"])) for each in planted]
            for place, each in enumerate(planted):
                beside = np.concatenate([x for other, x in enumerate(columns) if other != place], axis=1)
                each["s"] = float(bench.sight.detectability(each["values"], beside))
                past_noise = seen_past_noise(bench.sight, each["values"])
                each["seen"] = float(min(bench.sight.seen(each["values"], beside), past_noise))
            if min(each["s"] for each in planted) >= SEEN:
                yield Case("b", str(count), tuple(planted))
                break


def nulls(bench: Bench, random: np.random.Generator, setting: Setting) -> Iterator[Case]:
    """Yield campaigns without effect: noise as stated, then two noises of another law."""
    yield from (Case("c", f"null {number}") for number in range(4))
    names = [each for each in NOISES if not (setting.scatter and each == "offsets of runs")]
    plan, values = bench.sight.moments.plan, bench.sight.values
    for name in (names[(2 * setting.seed + each) % len(names)] for each in range(2)):
        if hasattr(plan, "moves"):
            return

        def edit(outputs: np.ndarray, name: str = name) -> np.ndarray:
            found, run = bench.sight.exact.copy(), bench.sight.moments.run_of_row
            for column, channel in enumerate(plan.channels):
                for place in np.unique(run):
                    at = run == place
                    offset = values[f"run_scatter.tau[{channel.name}]"] * random.standard_normal()
                    found[at, column] += offset + _row_noise(bench)[at, column] * NOISES[name](random, int(at.sum()))
            step = ROUNDED * np.median(_row_noise(bench), axis=0)
            return np.round(found / step) * step if name == "rounding" else found

        yield Case("c", name, edit=edit)


def _row_noise(bench: Bench) -> np.ndarray:
    plan, values = bench.sight.moments.plan, bench.sight.values
    samples = np.array([row.samples for run in plan.runs for row in run.rows])
    return np.array([values[f"white_noise.sigma[{each.name}]"] / np.sqrt(samples) for each in plan.channels]).T


def foreign(bench: Bench, random: np.random.Generator, setting: Setting) -> Iterator[Case]:
    """Yield two causes outside the catalogue, sized by S past the closest effect of the catalogue."""
    plan, sight, names, made = bench.sight.moments.plan, bench.sight, list(CAUSES), 0
    rows = rows_of(bench)
    for name in [] if hasattr(plan, "moves") else np.roll(names, -3 * (setting.seed % len(names))).tolist():
        kind = str(random.choice(sorted({channel.kind for channel in plan.channels})))
        where = [each for each, channel in enumerate(plan.channels) if channel.kind == kind]
        where = [int(random.choice(where))] if random.random() < 0.5 else where
        cause, delta = CAUSES[name](rows, random), np.zeros_like(sight.exact)
        for column in where:
            delta[:, column] = cause.shape(column) * np.median(_row_noise(bench)[:, column]) * random.uniform(0.7, 1.3)
        shift = sight._whiten(delta)
        s = float(np.sum(sight.left(shift) ** 2))
        if not s > 0.01 * np.sum(shift**2) or s == 0 or not np.isfinite(s):
            continue
        around = hidden.rivals(sight, tuple(plan.channels[each].name for each in where))

        def explained(
            effects: Iterable[str], around: dict[str, np.ndarray] = around, shift: np.ndarray = shift, s: float = s
        ) -> float:
            columns = [around[each] for each in effects if each in around]
            return 1 - float(np.sum(sight.left(shift, np.concatenate(columns, axis=1)) ** 2)) / s if columns else 0.0

        share = {each: explained([each]) for each in around}
        past = s * (1 - max(x for x in share.values() if x < EQUAL)) if max(share.values()) < EQUAL else s
        factor = np.sqrt(np.exp(random.uniform(np.log(100), np.log(1500))) / past)
        if factor > 100:
            continue
        told = {
            "name": name,
            "words": list(cause.words),
            "run": plan.runs[cause.run].name if cause.run is not None else "",
        }
        told |= {"s": s * factor**2, "equal": [e for e, x in share.items() if x >= EQUAL], "past": past * factor**2}
        told |= {"channels": [plan.channels[each].name for each in where], "largest": max(share.values())}
        yield Case(
            "d", name, edit=lambda outputs, moved=factor * delta: outputs + moved, cause=told, explained=explained
        )
        if (made := made + 1) == 2:
            return


def rows_of(bench: Bench) -> Rows:
    """Return what the rows of the plan hold."""
    plan, moments = bench.sight.moments.plan, bench.sight.moments
    rows = [row for run in plan.runs for row in run.rows]
    starts = [datetime.fromisoformat(run.start) for run in plan.runs]
    since = np.array([(each - min(starts)).total_seconds() / 3600 for each in starts])[moments.run_of_row]
    signal = bench.sight.exact - np.array([channel.offset for channel in plan.channels])
    numbers = np.array([(row.rate, row.angle, row.temperature, row.time) for row in rows], dtype=float).T
    signal = signal / np.abs(signal).max(axis=0)
    return Rows(
        numbers[0],
        np.radians(numbers[1]),
        numbers[2],
        numbers[3],
        since + numbers[3] / 3600,
        moments.run_of_row,
        signal,
    )


def write_case(bench: Bench, case: Case, place: Path, seed: int) -> None:
    """Write a campaign of a case into a folder."""
    plan, whole = bench.sight.moments.plan, dict(bench.sight.values)
    for one in case.planted:
        whole |= one["values"]
    hidden.WRITERS.get(type(plan), hidden.write_simulated)(place, plan, seed, values=whole, hidden={})
    if case.edit is None:
        return
    files = [place / "runs" / f"{run.name}.csv" for run in plan.runs]
    read = [list(csv.DictReader(file.read_text().splitlines())) for file in files]
    names = [channel.name for channel in plan.channels]
    outputs = np.array([[float(row.get(name) or np.nan) for name in names] for row in chain(*read)])
    moved = iter(case.edit(outputs).tolist())
    for file, rows in zip(files, read, strict=True):
        for row, values in zip(rows, moved, strict=False):
            row.update({name: f"{value:.6f}" for name, value in zip(names, values, strict=True) if row.get(name)})
        with file.open("w", newline="") as target:
            writer = csv.DictWriter(target, list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)


def cases(bench: Bench, setting: Setting, parts: str) -> Iterator[Case]:
    """Yield the cases of a setting; each part has its own random numbers."""
    random = {part: np.random.default_rng([setting.seed, ord(part)]) for part in "abcd"}
    made = {"a": lambda: singles(bench, random["a"]), "b": lambda: several(bench, random["b"])}
    made |= {"c": lambda: nulls(bench, random["c"], setting), "d": lambda: foreign(bench, random["d"], setting)}
    yield from chain.from_iterable(made[part]() for part in parts if not (part == "b" and setting.cut))
