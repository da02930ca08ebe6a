"""Campaigns with an effect that the model lacks, drawn at random: which one, where, how large, in which plan.

The size is set by how plainly the effect shows: S, see `detectability`.  Effects that a plan cannot show at any
sensible size are passed over, and listed.
"""

import re
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from scipy import stats

import truth
from detectability import Sight, look
from divergence import seen_past_noise
from effect_kinds import ALL, CATALOGUE, EQUIPMENT, HEADS, OUTSIDE, Kind, between
from plan import Plan
from procedure_plans import PLANS
from random_plans import TEMPLATES, random_plan
from sensor import Values
from serial_plans import SerialPlan, write_serial
from serial_table import SerialTable
from simulate import write_simulated
from tumble_plans import TumblePlan, write_tumble

PLAIN, FULL = "hidden-effects", "hidden-effects-thermal"
SMALLEST, LARGEST, LEAST_OF_TWO = 36.0, 2000.0, 80.0
LARGE = 1e6
"""Largest S of the campaigns with a large effect, whose S begins where that of the others ends."""
MOST = 30.0
"""Largest size that counts as sensible, in units of the typical one."""
WRITERS = {SerialPlan: write_serial, TumblePlan: write_tumble}
"""How campaigns are written whose rows are no rows of a plan."""
LEAST_SHOWN = 0.003
"""Smallest share of an effect's own square that may be left past the baseline."""


@dataclass(frozen=True)
class Planted:
    """One hidden effect.

    Attributes
    ----------
    channels : where it acts; empty for an effect of a table.
    parameters : true values by full name.
    s : S past the baseline; `s_alone` past the baseline and whatever could be taken for it.
    seen : what is left of `s_alone` if the noise may be taken for larger than it is.
    within : S where the offsets of all runs are free.
    shown : S over the effect's own square.
    """

    effect: str
    channels: tuple[str, ...]
    parameters: dict[str, float]
    s: float
    s_alone: float
    seen: float
    within: float
    shown: float


@dataclass(frozen=True)
class Campaign:
    """What was drawn: folder, model file beside it, what is hidden, and what this plan could not show."""

    folder: Path
    model: Path
    kind: str
    template: str
    seed: int
    readings: int
    planted: tuple[Planted, ...]
    passed_over: tuple[str, ...]


class CannotShowError(Exception):
    """The plan cannot show the effect at a sensible size."""


def without(model: str, effects: Iterable[str]) -> str:
    """Text of a shipped model file without some of its effects."""
    blocks = re.split(r"(?m)^(?=\[\[effect\]\])", (truth.MODELS / f"{model}.toml").read_text(encoding="utf-8"))
    gone = {f'name = "{name}"' for name in effects}
    return "".join(
        block for block in blocks if not any(line.split("#")[0].strip() in gone for line in block.splitlines())
    )


def belonging_to_others(model: str, kinds: set[str]) -> list[str]:
    """Effects of a shipped model that act on kinds of channel that a unit has none of."""
    prefixes = {"gyro": ("gyro_",), "accelerometer": ("accel_", "lever_arm", "injection_error", "converter_")}
    gone = tuple(prefix for kind, own in prefixes.items() if kind not in kinds for prefix in own)
    return [effect["name"] for effect in truth.effects_of(model) if gone and effect["name"].startswith(gone)]


def places(plan: Plan, on: str, generator: np.random.Generator) -> tuple[str, ...]:
    """Draw where an effect acts: one channel or all of a kind, or a table."""
    if on == "head":
        return tuple(table.name for table in plan.tables if table.name in HEADS)
    if on == "axes":
        return tuple(table.name for table in plan.tables if isinstance(table, SerialTable))
    if on == "station":
        return ("all",)
    kinds = {channel.kind for channel in plan.channels}
    kind = str(generator.choice(sorted(kinds))) if on == "any" else on
    names = [channel.name for channel in plan.channels if channel.kind == kind]
    if names and generator.random() < 0.5:
        return (str(generator.choice(names)),)
    return tuple(names)


def unit_effect(plan: Plan, effect: str, where: tuple[str, ...], generator: np.random.Generator) -> dict[str, float]:
    """Draw directions and shapes of an effect at about its typical size."""
    kind, values = ALL[effect], {}
    shapes = {name: drawn(generator) for name, drawn in kind.shapes.items()}
    if effect == "outside_step":
        long = [index for index, run in enumerate(plan.runs) if len(run.rows) >= 12]
        if not long:
            raise CannotShowError
        shapes["run"] = float(generator.choice(long))
    sign = generator.choice([-1.0, 1.0])
    for label in where:
        for name, size in kind.sizes.items():
            direction = sign * generator.uniform(0.7, 1.3) if len(kind.sizes) == 1 else generator.standard_normal()
            values[f"{effect}.{name}[{label}]"] = size * (abs(direction) if name == "half_width" else direction)
        values |= {f"{effect}.{name}[{label}]": shape for name, shape in shapes.items()}
    return values


def scaled(effect: Values, factor: float) -> dict[str, float]:
    """The coefficients of an effect times `factor`, its shapes as they are."""
    shapes = {f"{name}.{shape}" for name, kind in ALL.items() for shape in (*kind.shapes, "run")}
    return {name: value if name.split("[")[0] in shapes else factor * value for name, value in effect.items()}


def sized(
    sight: Sight, effect: Values, aim: float, also: np.ndarray | None = None, largest: float = LARGEST
) -> tuple[dict[str, float], float]:
    """Scale an effect until S past the baseline and `also` is `aim`; return it and S.

    Where the baseline could take most of it for noise the size grows until enough is left to be seen.
    """
    factor = 1.0
    for _ in range(12):
        found = sight.detectability(scaled(effect, factor), also)
        if found <= 0:
            raise CannotShowError
        if abs(found / aim - 1) < 0.01:
            break
        factor *= np.sqrt(aim / found)
        if not factor < MOST:
            raise CannotShowError
    while sight.seen(scaled(effect, factor), also) < SMALLEST and factor < MOST:
        factor *= 1.15
    here = scaled(effect, factor)
    reached = sight.detectability(here, also)
    if (
        not (0.9 * aim < reached < 1.1 * largest)
        or factor >= MOST
        or sight.detectability(here) / np.sum(sight.shift(here) ** 2) < LEAST_SHOWN
    ):
        raise CannotShowError
    return here, reached


def tangents(sight: Sight, effect: str, where: tuple[str, ...]) -> np.ndarray:
    """Whitened shifts (readings, k) by each coefficient of an effect at each place, over a few shapes."""
    kind, columns = ALL[effect], []
    generators = [np.random.default_rng(index) for index in range(4 if kind.shapes else 1)]
    for generator in generators:
        shapes = {name: drawn(generator) for name, drawn in kind.shapes.items()}
        for label in where:
            for name, size in kind.sizes.items():
                one = {f"{effect}.{name}[{label}]": size} | {
                    f"{effect}.{shape}[{label}]": value for shape, value in shapes.items()
                }
                columns.append(sight.shift(one))
    return np.array(columns).T


def rivals(sight: Sight, where: tuple[str, ...], apart_from: Iterable[str] = ()) -> dict[str, np.ndarray]:
    """Tangents of every effect of the catalogue that could be taken for one at these channels."""
    plan = sight.moments.plan
    kinds = {channel.kind for channel in plan.channels if channel.name in where}
    heads = tuple(table.name for table in plan.tables if table.name in HEADS)
    found = {}
    for name, kind in CATALOGUE.items():
        if name in apart_from or not plan.shows(name):
            continue
        at = {"head": heads, "station": ("all",)}.get(kind.on, where if kind.on in kinds else ())
        if at:
            found[name] = tangents(sight, name, at)
    return found


def with_free_offsets(sight: Sight) -> Sight:
    """The same plan where the offsets of the runs may be anything."""
    plan = sight.moments.plan
    values = dict(sight.values) | {f"run_scatter.tau[{channel.name}]": 100 * channel.noise for channel in plan.channels}
    return look(plan, values)


def planted(sight: Sight, effect: str, where: tuple[str, ...], values: Values, also: np.ndarray | None) -> Planted:
    shift = sight.shift(values)
    s = float(np.sum(sight.left(shift) ** 2))
    return Planted(
        effect=effect,
        channels=() if ALL[effect].on in EQUIPMENT else where,
        parameters=dict(values),
        s=s,
        s_alone=sight.detectability(values, also),
        seen=sight.seen(values, also),
        within=with_free_offsets(sight).detectability(values),
        shown=s / float(np.sum(shift**2)),
    )


def row_sd(plan: Plan, values: Values, channel: str) -> float:
    """Typical standard deviation of a row's mean."""
    samples = np.median([row.samples for run in plan.runs for row in run.rows])
    return values[f"white_noise.sigma[{channel}]"] / np.sqrt(samples)


def noise_of(kind: str, plan: Plan, values: Values, generator: np.random.Generator) -> dict[str, float]:
    """The noise that a kind of campaign asks for, in place of what was drawn from the priors."""
    changed, stated = {}, truth.priors(plan.effects, plan.channels)
    for channel in plan.channels:
        sd = row_sd(plan, values, channel.name)
        tau, slow = f"run_scatter.tau[{channel.name}]", f"correlated_noise.sigma[{channel.name}]"
        if kind == "null-white":
            changed[tau] = 0.02 * sd
        if kind == "null-runs":
            # Scatter beyond its prior would be a finding, and no alarm.
            changed[tau] = min(generator.uniform(0.5, 3.0) * sd, truth.at_score(stated[tau], 1.0))
        if kind == "null-ar1":
            changed[tau] = 0.02 * sd
            changed[slow] = generator.uniform(0.7, 1.5) * sd
            changed[f"correlated_noise.correlation[{channel.name}]"] = generator.uniform(0.3, 0.8)
    return changed


def _one_catalogued(
    sight: Sight, effect: str, generator: np.random.Generator, aim: float, largest: float = LARGEST
) -> tuple[Planted, ...]:
    where = places(sight.moments.plan, CATALOGUE[effect].on, generator)
    if not where:
        raise CannotShowError
    values, _ = sized(sight, unit_effect(sight.moments.plan, effect, where, generator), aim, largest=largest)
    one = planted(sight, effect, where, values, None)
    exact = replace(one, seen=min(one.seen, seen_past_noise(sight, values)))
    if exact.seen < SMALLEST:
        raise CannotShowError
    return (exact,)


def _one_outside(sight: Sight, effect: str, generator: np.random.Generator, aim: float) -> tuple[Planted, ...]:
    """S counts past the baseline and whichever single effect of the catalogue comes closest."""
    plan = sight.moments.plan
    where = places(plan, OUTSIDE[effect].on, generator)
    if not where:
        raise CannotShowError
    unit = unit_effect(plan, effect, where, generator)
    shift = sight.shift(unit)
    closest = min(rivals(sight, where).values(), key=lambda columns: float(np.sum(sight.left(shift, columns) ** 2)))
    values, _ = sized(sight, unit, aim, closest)
    return (planted(sight, effect, where, values, closest),)


def _two(sight: Sight, effects: tuple[str, ...], generator: np.random.Generator, aims: list[float]) -> tuple:
    """Each is sized past the baseline and the other, and must not be mostly hidden behind it."""
    plan = sight.moments.plan
    where = [places(plan, CATALOGUE[effect].on, generator) for effect in effects]
    if not all(where):
        raise CannotShowError
    units = [unit_effect(plan, effect, at, generator) for effect, at in zip(effects, where, strict=True)]
    others = [tangents(sight, effect, at) for effect, at in zip(effects, where, strict=True)][::-1]
    found = []
    for effect, at, unit, other, aim in zip(effects, where, units, others, aims, strict=True):
        values, _ = sized(sight, unit, aim, other)
        one = planted(sight, effect, at, values, other)
        if one.s_alone < 0.3 * one.s:
            raise CannotShowError
        found.append(one)
    return tuple(found)


def _in_offsets(sight: Sight, effect: str, generator: np.random.Generator, aim: float) -> tuple[Planted, ...]:
    """Sized as if there were no run offsets; what is left of it with them must be below notice."""
    plan = sight.moments.plan
    where = places(plan, CATALOGUE[effect].on, generator)
    still = {f"run_scatter.tau[{channel.name}]": 1e-3 * channel.noise for channel in plan.channels}
    values, _ = sized(look(plan, {**sight.values, **still}), unit_effect(plan, effect, where, generator), aim)
    one = planted(sight, effect, where, values, None)
    if one.s > 1.0:
        raise CannotShowError
    return (one,)


def applicable(template: str, among: dict[str, Kind]) -> list[str]:
    return [name for name, kind in among.items() if not kind.templates or template in kind.templates]


def _constant_temperature(plan: Plan) -> Plan:
    """The same plan with one exact temperature in each run."""
    runs = tuple(
        replace(run, rows=[replace(row, temperature=run.rows[0].temperature) for row in run.rows]) for run in plan.runs
    )
    return replace(plan, runs=runs)


KINDS = ("hidden", "null-white", "null-ar1", "null-runs", "outside", "offsets", "two", "large")


def random_campaign(
    folder: str | Path, seed: int, kind: str = "hidden", template: str | None = None, effect: str | None = None
) -> Campaign:
    """Draw a campaign and write it into `folder`, with `model.toml`, the model that lacks what is hidden.

    Parameters
    ----------
    seed : of everything.
    kind : one of `KINDS`.
    template, effect : instead of drawn ones; a template is one of `random_plans`, or a procedure of `procedure_plans`.
    """
    folder = Path(folder)
    generator = np.random.default_rng([seed, KINDS.index(kind)])
    passed_over: list[str] = []
    for attempt in range(60):
        chosen = template or str(generator.choice(list(TEMPLATES)))
        if kind == "offsets":
            chosen = "temperatures"
        names = _effects(kind, chosen, effect, generator)
        if names is None:
            continue
        base = _base(kind, chosen, names, generator)
        drawn = PLANS[chosen].draw(generator) if chosen in PLANS else random_plan(chosen, generator)
        plan = replace(drawn, model=folder / "model.toml")
        kinds = {channel.kind for channel in plan.channels}
        folder.mkdir(parents=True, exist_ok=True)
        model = folder / "model.toml"
        model.write_text(without(base, [*names, *belonging_to_others(base, kinds)]), encoding="utf-8")
        values = plan.draw(int(generator.integers(2**31)))
        if kind == "offsets":
            plan = _constant_temperature(plan)
            values |= {
                f"run_scatter.tau[{channel.name}]": 30 * row_sd(plan, values, channel.name) for channel in plan.channels
            }
        values |= noise_of(kind, plan, values, generator)
        try:
            found = _plant(kind, plan, values, names, generator)
            if chosen in PLANS and not all(_stands_out(one) for one in found):
                raise CannotShowError
        except CannotShowError:
            passed_over.append(f"{chosen}: {', '.join(names)}")
            continue
        return _written(folder, model, kind, chosen, seed, plan, values, found, passed_over, attempt)
    raise CannotShowError(f"nothing that could be shown in 60 plans: {passed_over}")


def _base(kind: str, template: str, names: Iterable[str], generator: np.random.Generator) -> str:
    """Name of the shipped model from which what is hidden is taken out."""
    if template in PLANS:
        return PLANS[template].model
    base = PLAIN if kind == "offsets" or generator.random() < 0.5 else FULL
    full = (truth.MODELS / f"{FULL}.toml").read_text(encoding="utf-8")
    return PLAIN if any(f'"{name}"' in full for name in names) else base


def _effects(kind: str, template: str, effect: str | None, generator: np.random.Generator) -> tuple[str, ...] | None:
    if kind.startswith("null"):
        return ()
    if kind == "offsets":
        return (str(generator.choice(["gyro_bias_temperature", "accel_bias_temperature"])),)
    names = applicable(template, OUTSIDE if kind == "outside" else CATALOGUE)
    if kind == "two":
        first, second = generator.choice(names, 2, replace=False)
        return str(first), str(second)
    if effect is not None:
        return (effect,) if effect in names else None
    return (str(generator.choice(names)),)


def _plant(kind: str, plan: Plan, values: Values, names: tuple[str, ...], generator) -> tuple[Planted, ...]:
    if not names:
        return ()
    sight = look(plan, values)
    if kind == "large":
        return _one_catalogued(sight, names[0], generator, between(LARGEST, LARGE)(generator), LARGE)
    least = LEAST_OF_TWO if kind == "two" else SMALLEST
    aims = [between(least, LARGEST)(generator) for _ in names]
    if kind == "outside":
        return _one_outside(sight, names[0], generator, aims[0])
    if kind == "two":
        return _two(sight, names, generator, aims)
    if kind == "offsets":
        return _in_offsets(sight, names[0], generator, aims[0])
    return _one_catalogued(sight, names[0], generator, aims[0])


def _stands_out(one: Planted) -> bool:
    """Whether an effect of many coefficients is seen as clearly as one of a single coefficient with the smallest S.

    In plans of one procedure there may be hardly more runs than coefficients.
    """
    shapes = {name for kind in ALL.values() for name in kind.shapes}
    free = sum(name.split("[")[0].split(".")[1] not in shapes for name in one.parameters)
    return one.seen >= float(stats.chi2.isf(stats.chi2.sf(SMALLEST, 1), max(free, 1)))


def _written(folder, model, kind, template, seed, plan, values, found, passed_over, attempt) -> Campaign:
    whole = dict(values)
    for one in found:
        whole |= one.parameters
    hidden = {
        "kind": kind,
        "template": template,
        "seed": seed,
        "attempt": attempt,
        "effect": [asdict(one) | {"channels": list(one.channels)} for one in found],
        "passed_over": passed_over,
    }
    WRITERS.get(type(plan), write_simulated)(folder, plan, seed, values=whole, hidden=hidden)
    readings = len(plan.channels) * sum(len(run.rows) for run in plan.runs)
    return Campaign(folder, model, kind, template, seed, readings, found, tuple(passed_over))
