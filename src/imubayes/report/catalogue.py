"""The catalogue of effects, as tables."""

import inspect

from rich.console import Console
from rich.table import Table as Grid

from imubayes.effects.base import Effect
from imubayes.model.registry import Member, Registry
from imubayes.parameters.parameter import declared_options, declared_parameters


def print_catalogue() -> None:
    """Print every effect and noise member with what it needs and what its parameters are."""
    grid = Grid("effect", "acts on", "needs", "parameters", box=None)
    for member in Registry().members.values():
        parameters = ", ".join(f"{name} ({one.unit})" for name, one in declared_parameters(member).items())
        grid.add_row(member.name, _acts_on(member), ", ".join(member.needs) or "–", parameters)
    Console().print(grid)
    print("\nimubayes effects NAME explains one")


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
    for setting, default in declared_options(member).items():
        console.print(f"setting: {setting} = {default:g}")
    console.print(f"\nneeds: {', '.join(member.needs) or 'nothing special'}", highlight=False)
    console.print(f"one value per: {', '.join(member.per)}", highlight=False)
    if member.confused_with:
        console.print(f"confused with: {member.confused_with}", highlight=False)
    console.print(f"source: {member.reference}", highlight=False)


def _acts_on(member: Member) -> str:
    if not issubclass(member, Effect):
        return "noise"
    return f"{member.stage.name.lower()}, {' and '.join(member.kinds)}"
