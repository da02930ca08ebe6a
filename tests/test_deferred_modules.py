"""Modules that are imported when they are first used are not imported by code that looks at all loaded modules."""

import subprocess
import sys

import pytest

from imubayes.foundations.deferred_modules import DeferredModule

LOOKS = """
import inspect
import sys
from types import ModuleType
import imubayes.inference.run_fit
waiting = [name for name, each in sys.modules.items() if type(each) is not ModuleType and "Lazy" in type(each).__name__]
inspect.stack()
print(*(name for name in waiting if name.startswith("imubayes")), file=sys.stderr)
print("imubayes.inference.ensemble_sampling" in sys.modules, file=sys.stderr)
"""


@pytest.mark.compiled  # a process
def test_looking_at_all_modules_imports_none_of_a_fit() -> None:
    """ArviZ looks at them while it is imported: a lazy module that imports ArviZ itself would wait for ever."""
    ended = subprocess.run([sys.executable, "-c", LOOKS], capture_output=True, text=True, check=True)
    assert ended.stderr.splitlines()[-2:] == ["", "False"]


def test_a_deferred_module_is_that_module() -> None:
    assert DeferredModule("math").pi == pytest.approx(3.14159265)
    with pytest.raises(ModuleNotFoundError):
        _ = DeferredModule("no_such_module").member
