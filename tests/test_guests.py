"""The kernel alone: without the packages beside it the loop runs, and what they add is refused or not there."""

import ast
import shutil
import subprocess
import sys
import sysconfig
import tomllib
from collections import defaultdict
from importlib import import_module
from itertools import zip_longest

import pytest

from imubayes.foundations.errors import InputError
from imubayes.foundations.extensions import answer_to, extensions
from test_layering import GUESTS, SOURCE, SOURCES, name_of, package

ROOT = SOURCE.parent
# What a package beside the kernel may use, as a user's own tool may: the names that the reference documents.
SUBJECTS = tomllib.loads((SOURCE / "docs" / "public_modules.toml").read_text(encoding="utf-8"))["subject"]
PUBLIC = tuple(module for subject in SUBJECTS for module in subject["modules"])
LISTED = {module: names for subject in SUBJECTS for module, names in subject.get("names", {}).items()}
MODULES = {name_of(file) for file in SOURCES} | {name_of(file.parent) for file in SOURCES}
# Names that each takes from elsewhere in the kernel: they may become fewer.
FROM_WITHIN = {"imubayes_archive": 0, "imubayes_explorer": 0, "imubayes_qualification": 0, "imubayes_recordings": 0}
ALONE = """
import sys
sys.path[:0] = sys.argv[1:3]
from imubayes.cli.main import app, run
import imubayes
campaign, model = "data/accel-channel", "accel-channel"
steps = (
    ["check", campaign, "--model", model],
    ["fit", campaign, "--model", model, "--out", "fitted", "--no-sample"],
    ["compare", "fitted"],
    ["diagnose", "fitted"],
    ["history", "fitted"],
)
done = [run(step) for step in steps]
refused = run(["fit", campaign, "--model", model, "--out", "given", "--no-sample", "--population", "units"])
print(*done, file=sys.stderr)
print(refused, file=sys.stderr)
print(hasattr(imubayes, "fit"), hasattr(imubayes, "report"), "report" in imubayes.__all__, file=sys.stderr)
print(*sorted(name for name in app if not name.startswith("-")), file=sys.stderr)
print(*sorted({name.partition(".")[0] for name in sys.modules if name.startswith("imubayes")}), file=sys.stderr)
"""


@pytest.mark.compiled  # a process
def test_the_loop_runs_without_the_packages_beside_the_kernel(tmp_path):
    shutil.copytree(SOURCE / "imubayes", tmp_path / "src" / "imubayes")
    for folder in ("data", "models"):
        (tmp_path / folder).symlink_to(ROOT / folder)
    # Without `site` the installed packages are found, and those of the source tree are not.
    command = [sys.executable, "-SE", "-c", ALONE, str(tmp_path / "src"), sysconfig.get_path("purelib")]
    ended = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False)
    *_, steps, option, names, commands, loaded = ended.stderr.splitlines()
    assert steps == "0 0 0 0 0", ended.stderr
    assert option == "2"
    assert "belongs to a package that is not installed" in ended.stderr
    assert names == "True False False"
    assert {"fit", "diagnose", "add"} <= set(commands.split())
    assert not {"report", "batch", "new", "explore", "noise"} & set(commands.split())
    assert loaded == "imubayes"


def test_every_guest_adds_a_command_and_a_function():
    for group in ("commands", "functions"):
        assert {entry.module.partition(".")[0] for entry in extensions(group).values()} == set(GUESTS)


@pytest.mark.parametrize("group", ["commands", "functions", "options", "pages", "results", "schemas"])
def test_what_is_registered_is_there(group):
    assert extensions(group)
    assert all(entry.load() is not None for entry in extensions(group).values())


def test_an_option_that_nothing_answers_is_refused():
    with pytest.raises(InputError, match="not installed"):
        answer_to("fit.nothing")


def taken_from_within(sources: dict[str, str]) -> dict[str, set[str]]:
    """Return the names of the kernel that each guest takes and that are not public."""
    found: dict[str, set[str]] = {guest: set() for guest in GUESTS}
    for module, text in sources.items():
        if package(module) in GUESTS:
            found[package(module)] |= {".".join(each) for each in taken(text) if not is_public(*each)}
    return found


def taken(text: str) -> set[tuple[str, str]]:
    """Return the modules and names of the kernel that a source takes: imports, and attributes of imported modules."""
    tree, modules, found = ast.parse(text), dict[str, str](), set[tuple[str, str]]()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and package(str(node.module)) == "imubayes":
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                if whole in MODULES:
                    modules[alias.asname or alias.name] = whole
                else:
                    found.add((str(node.module), alias.name))
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in modules:
            found.add((modules[node.value.id], node.attr))
    return found


def is_public(module: str, name: str) -> bool:
    whole = module == "imubayes" or module.startswith(tuple(f"{name}." for name in PUBLIC)) or module in PUBLIC
    return whole or name in LISTED.get(module, ())


def test_guests_take_no_more_from_within_the_kernel():
    found = taken_from_within({name_of(file): file.read_text(encoding="utf-8") for file in SOURCES})
    assert {guest: len(names) for guest, names in found.items()} == FROM_WITHIN


def undocumented(text: str, wanted: set[str]) -> list[str]:
    """Return the names, of those wanted, that a module defines without a docstring or, if a constant, a comment."""
    lines, body, found = text.splitlines(), ast.parse(text).body, []
    for node, after in zip_longest(body, body[1:]):
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name in wanted and not ast.get_docstring(node):
            found.append(node.name)
        if isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = [each.id for target in targets for each in ast.walk(target) if isinstance(each, ast.Name)]
            said = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
            said = said or "# " in lines[node.lineno - 1].replace("# fmt", "") or lines[node.lineno - 2].startswith("#")
            found += [name for name in names if name in wanted and not said]
    return found


def test_public_names_that_guests_take_are_documented():
    used = defaultdict[str, set[str]](set, {module: set(names) for module, names in LISTED.items()})
    sources = {name_of(file): file.read_text(encoding="utf-8") for file in SOURCES}
    for module, text in sources.items():
        for source, name in taken(text) if package(module) in GUESTS else ():
            if is_public(source, name):
                used[source].add(name)
    found = {module: undocumented(sources[module], names) for module, names in used.items() if module in sources}
    assert {module: names for module, names in found.items() if names} == {}


def test_a_name_without_a_docstring_is_seen():
    text = 'A = 1\nB = 2\n"""Said."""\n# Said.\nC = 3\ndef f():\n    return A\n'
    assert undocumented(text, {"A", "B", "C", "f"}) == ["A", "f"]


def test_every_public_name_is_there_once():
    assert [module for module in (*PUBLIC, *LISTED) if module not in MODULES] == []
    assert len({*PUBLIC, *LISTED}) == len(PUBLIC) + len(LISTED)
    listed = ((import_module(module), name) for module, names in LISTED.items() for name in names)
    assert [name for module, name in listed if not hasattr(module, name)] == []


def test_a_name_from_within_is_seen():
    text = (
        "from imubayes.inference.run_fit import joint_fit, redrawn\nfrom imubayes.foundations.units import to_si\n"
        "from imubayes.model import problem as arrays\nbest = arrays.predict, arrays.placed"
    )
    found = taken_from_within({"imubayes_archive.unit_fits.new": text})
    assert found["imubayes_archive"] == {"imubayes.inference.run_fit.redrawn", "imubayes.model.problem.placed"}
