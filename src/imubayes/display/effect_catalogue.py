"""The catalogue of effects, as tables."""

import inspect
import re
from collections.abc import Iterator

from rich.console import Console
from rich.markup import escape
from rich.table import Column
from rich.table import Table as Grid

from imubayes.effects.base import Effect, MotionEffect, Order
from imubayes.effects.shared_formulas import Sensor
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.covariates import remedy
from imubayes.foundations.units import BIAS_CONVENTION
from imubayes.foundations.wording import counted
from imubayes.model.bound_effects import observability
from imubayes.model.effect_registry import EffectClass, Registry
from imubayes.parameters.declarations import Declared, declared_options, declared_parameters


def print_catalogue() -> None:
    """Print every effect and noise member with what it needs and what its parameters are."""
    grid = Grid(Column("effect", no_wrap=True), "acts on", "needs", "parameters", box=None)
    for member in Registry().effects.values():
        by_unit: dict[str, list[str]] = {}
        for name, declared in declared_parameters(member).items():
            by_unit.setdefault(declared.unit, []).append(name)
        parameters = ", ".join(f"{', '.join(names)} ({unit})" for unit, names in by_unit.items())
        grid.add_row(member.name, _acts_on(member), ", ".join(member.needs) or "–", parameters)
    Console().print(grid)
    print("\nimubayes effects NAME explains one, with its needs in words.")
    print("imubayes effects --for CAMPAIGN lists those that a campaign could show.")


_TYPICAL = (
    "typical: sizes met in practice, from which `diagnose` derives its prior. The source may state those of one class "
    "of sensors."
)


def print_observable(campaign: Campaign) -> None:
    """Print which effects a campaign could show, in how many of its runs, and what the others lack."""
    found = observability(campaign)
    shown = [effect for effect in found if not effect.missing]
    grid = Grid(Column("effect", no_wrap=True), "acts on", "runs", box=None)
    for effect in shown:
        runs = f"{len(effect.runs)} of {len(campaign.runs)}"
        grid.add_row(effect.effect_class.name, _acts_on(effect.effect_class), runs)
    console = Console()
    many = counted(len(found), "effect")
    console.print(f"[bold]{escape(campaign.name)}[/bold] could show {len(shown)} of {many}:\n", highlight=False)
    console.print(grid)
    if len(shown) == len(found):
        return
    print("\nNeeded for the other effects:\n")
    lacking = Grid(Column("effects", no_wrap=True), "need", box=None)
    by_need: dict[str, list[str]] = {}
    for effect in found:
        if effect.missing:
            needed = "; ".join(dict.fromkeys(map(remedy, effect.missing)))
            by_need.setdefault(needed, []).append(effect.effect_class.name)
    for needed, names in by_need.items():
        lacking.add_row("\n".join(names), escape(needed))
    console.print(lacking)
    print("\nOnly a fit shows whether the runs determine the effects that they could show.")


def print_effect(effect: str) -> None:
    """Print one effect in full; raises InputError for an unknown name."""
    member = Registry().find(effect, "NAME")
    console = Console()
    console.print(f"[bold]{member.name}[/bold]  ({_acts_on(member)})\n")
    # Lines of a paragraph are as long as the terminal is wide, not as the source is.
    text = re.sub(r"(?<=[^\s-])\n(?=[^\s>-])", " ", inspect.getdoc(member) or "")
    console.print(text, highlight=False, markup=False)
    if issubclass(member, Sensor) and member.order == Order.BIAS:
        console.print(f"\n{BIAS_CONVENTION}", highlight=False, markup=False)
    grid = Grid("parameter", "unit", "default prior", "typical", "meaning", box=None)
    parameters = declared_parameters(member)
    for name, declared in parameters.items():
        low, high = declared.typical
        of_scale = declared.unit.replace("output", "scale")
        sizes = f"{low:g} … {high:g}" + (f" {of_scale}" if of_scale != declared.unit else "")
        grid.add_row(name, declared.unit, declared.prior, sizes, declared.meaning)
    console.print()
    console.print(grid)
    for name, declared in parameters.items():
        if declared.shape:
            tried = ", ".join(f"{value:g}" for value in declared.shape)
            console.print(f"diagnose scans {name} over {tried} {declared.unit}", highlight=False)
        for line in _further_priors(name, declared):
            console.print(line, highlight=False)
    for setting, default in declared_options(member).items():
        console.print(f"setting: {setting} = {default:g}")
    console.print(_TYPICAL, highlight=False)
    console.print(f"\nneeds: {', '.join(map(remedy, member.needs)) or 'nothing special'}", highlight=False)
    console.print(f"one value per: {_scope(member)}", highlight=False)
    if member.excludes:
        console.print(f"not together with: {', '.join(member.excludes)}", highlight=False)
    if member.confused_with:
        console.print(f"confused with: {member.confused_with}", highlight=False, markup=False)
    console.print(f"source: {member.reference}", highlight=False, markup=False)


def _scope(member: EffectClass) -> str:
    return ", ".join(member.per) or "campaign"


def _further_priors(name: str, declared: Declared) -> Iterator[str]:
    """Yield the default priors of a parameter for other units than that of the table: coarser ones, and gyros."""
    if declared.coarse is not None:
        wider = ", ".join(f"{declared.prior_of(grade)} ({grade})" for grade in ("industrial", "consumer"))
        yield f"default prior of {name} for a coarser unit: {wider}"
    if declared.of_gyro is not None:
        prior, (low, high) = declared.of_gyro
        of_scale = declared.unit.replace("output", "scale")
        yield f"{name} of a gyro: default prior {prior}, typical {low:g} … {high:g} {of_scale}"


def _acts_on(member: EffectClass) -> str:
    if not issubclass(member, Effect):
        return "noise"
    stage = member.stage.name.lower()
    return stage if issubclass(member, MotionEffect) else f"{stage}, {' and '.join(member.kinds)}"
