"""Packages beside the kernel: their commands, public functions, options and file schemas, found by entry points.

A package registers what it adds in its metadata, as plug-ins of pytest and backends of xarray do; the kernel imports
none of it by name.  Without the package the command is not listed, and an option that it answers is refused.
"""

from collections.abc import Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from typing import Any, Literal

from imubayes.foundations.errors import input_error

Group = Literal["commands", "functions", "options", "pages", "results", "schemas"]


@cache
def extensions(group: Group) -> Mapping[str, EntryPoint]:
    """Return what installed packages add to a group, by name; a package that is not there adds nothing.

    Parameters
    ----------
    group : `commands` of the command line, public `functions`, `options` of functions of the kernel, named
        `function.option`, `pages` about the fits of many units in a folder, functions that keep something of their own
        in sampled `results`, or `schemas` of files.
    """
    found = sorted(entry_points(group=f"imubayes.{group}"), key=lambda entry: entry.name)
    packages = {entry.module.partition(".")[0] for entry in found}
    present = {package for package in packages if find_spec(package) is not None}
    return {entry.name: entry for entry in found if entry.module.partition(".")[0] in present}


def answer_to(option: str) -> Any:
    """Return the function that answers an option of the kernel.

    Parameters
    ----------
    option : name of function and option, such as `fit.population`.

    Raises
    ------
    InputError
        if no installed package answers it.
    """
    entry = extensions("options").get(option)
    if entry is None:
        function, _, name = option.partition(".")
        raise input_error(
            f"the option '{name}' of '{function}' belongs to a package that is not installed",
            f"option {name}",
            "options of the packages that are installed",
            "install imubayes with all its packages, or leave the option out",
        )
    return entry.load()
