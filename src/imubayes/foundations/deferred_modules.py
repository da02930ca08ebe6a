"""Modules that are imported when they are first used: those of extras, and those that take long and few commands need.

A deferred module is not in `sys.modules` before its import.  One that is, as of `lazy_loader.load`, is imported by any
code that looks at all loaded modules, such as `inspect.stack`.  ArviZ does so within an import, and the process hangs.
"""

from importlib import import_module
from typing import Any


class DeferredModule:
    """A module that is imported when a member of it is first used; ModuleNotFoundError if it is missing."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, member: str) -> Any:
        return getattr(import_module(self._name), member)
