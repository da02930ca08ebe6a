"""The catalogue of effects, as tables."""

import inspect

from rich.console import Console
from rich.table import Column
from rich.table import Table as Grid

from imubayes.campaign_data import Campaign
from imubayes.covariates import COVARIATES
from imubayes.effects.base import Effect, MotionEffect
from imubayes.model.effect_registry import EffectClass, Registry
from imubayes.model.observability import observability
from imubayes.parameters.parameter_declarations import declared_options, declared_parameters


def print_catalogue() -> None:
    """Print every effect and noise member with what it needs and what its parameters are."""
    grid = Grid(Column("effect", no_wrap=True), "acts on", "needs", "parameters", box=None)
    for member in Registry().effects.values():
        by_unit: dict[str, list[str]] = {}
        for name, one in declared_parameters(member).items():
            by_unit.setdefault(one.unit, []).append(name)
        parameters = ", ".join(f"{', '.join(names)} ({unit})" for unit, names in by_unit.items())
        grid.add_row(member.name, _acts_on(member), ", ".join(member.needs) or "–", parameters)
    Console().print(grid)
    print("\nimubayes effects NAME explains one; imubayes effects --for CAMPAIGN says which a campaign could show")


# What brings a condition other than a covariate into a run: the words after "needs".
_CONDITIONS = {
    "acceleration": "table_acceleration_deg_s2 that is not 0",
    "injection": "a run of procedure current_injection",
    "mounting": "a run in a mounting",
    "table": "a run on a table",
    "turning": "a run that turns",
    "commanded": "a table that turns at a commanded rate",
    "reference": "a reference gyro that rides along",
    "driven": "a table that the gyro drives",
    "pose": "a free tumble",
    "free tumble": "a free tumble",
    "gyro": "a gyro",
    "accelerometer": "an accelerometer",
}


def _remedy(need: str) -> str:
    """Return what brings a covariate or condition into a run, in words."""
    return COVARIATES[need].remedy if need in COVARIATES else _CONDITIONS.get(need, need)


def print_observable(campaign: Campaign) -> None:
    """Print which effects a campaign could show, in how many of its runs, and what the others lack."""
    found = observability(campaign)
    shown = [one for one in found if not one.missing]
    grid = Grid(Column("effect", no_wrap=True), "acts on", "runs", box=None)
    for one in shown:
        grid.add_row(one.effect_class.name, _acts_on(one.effect_class), f"{len(one.runs)} of {len(campaign.runs)}")
    console = Console()
    console.print(f"[bold]{campaign.name}[/bold] could show {len(shown)} of {len(found)} effects:\n", highlight=False)
    console.print(grid)
    if len(shown) == len(found):
        return
    print("\nand for the others lacks:\n")
    lacking = Grid(Column("effects", no_wrap=True), "need", box=None)
    by_need: dict[str, list[str]] = {}
    for one in found:
        if one.missing:
            needed = "; ".join(dict.fromkeys(_remedy(name) for name in one.missing))
            by_need.setdefault(needed, []).append(one.effect_class.name)
    for needed, names in by_need.items():
        lacking.add_row("\n".join(names), needed)
    console.print(lacking)
    print("\nWhether the runs determine an effect that they could show is for a fit to say.")


def print_effect(name: str) -> None:
    """Print one effect in full; raises InputError for an unknown name."""
    member = Registry().find(name, "NAME")
    console = Console()
    console.print(f"[bold]{member.name}[/bold]  ({_acts_on(member)})\n")
    console.print(inspect.getdoc(member) or "", highlight=False, markup=False)
    grid = Grid("parameter", "unit", "default prior", "typical", "meaning", box=None)
    for field, one in declared_parameters(member).items():
        low, high = one.typical
        grid.add_row(field, one.unit, one.prior, f"{low:g} … {high:g}", one.meaning)
    console.print()
    console.print(grid)
    for field, one in declared_parameters(member).items():
        if one.shape:
            tried = ", ".join(f"{value:g}" for value in one.shape)
            console.print(f"{field} is no coefficient: a scan tries {tried} {one.unit}", highlight=False)
    for setting, default in declared_options(member).items():
        console.print(f"setting: {setting} = {default:g}")
    console.print(f"\nneeds: {', '.join(member.needs) or 'nothing special'}", highlight=False)
    console.print(f"one value per: {', '.join(member.per)}", highlight=False)
    if member.excludes:
        console.print(f"not together with: {', '.join(member.excludes)}", highlight=False)
    if member.confused_with:
        console.print(f"confused with: {member.confused_with}", highlight=False)
    console.print(f"source: {member.reference}", highlight=False)


def _acts_on(member: EffectClass) -> str:
    if not issubclass(member, Effect):
        return "noise"
    stage = member.stage.name.lower()
    return stage if issubclass(member, MotionEffect) else f"{stage}, {' and '.join(member.kinds)}"
