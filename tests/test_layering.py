"""The house rules, read from the sources: imports go down, none hides in a function, no file grows beyond 500 lines.

The kernel is `imubayes`; guests are packages beside it, which it does not import.
"""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src"
KERNEL = (
    ("foundations", "compiled"),
    ("parameters",),
    ("procedures",),
    ("campaign",),
    ("effects", "noise"),
    ("model",),
    ("inference", "simulation"),
    ("adequacy", "responses"),
    ("criticism",),
    ("loop",),
    ("results",),
    ("display",),
    ("api", "", "kernel_names"),
    ("cli",),
    ("__main__",),
)
GUESTS = {
    "imubayes_recordings": (
        ("convert",), ("guided_capture", "noise_analysis"), ("display",), ("api",), ("cli",), ("",),
    ),
    "imubayes_qualification": (
        ("evaluation",), ("budgets",), ("certificate", "onboard"), ("display",), ("api",), ("cli",), ("",),
    ),
    "imubayes_archive": (("dataset",), ("unit_fits",), ("population",), ("display",), ("api",), ("cli",), ("",)),
    "imubayes_explorer": (),
}  # fmt: skip
PACKAGES = {"imubayes": KERNEL, **GUESTS}
"""Package → its floors, lowest first; a package without floors has one."""
BUILDS_ON = {
    "imubayes_recordings": ("imubayes",),
    "imubayes_qualification": ("imubayes", "imubayes_recordings"),
    "imubayes_archive": ("imubayes",),
    "imubayes_explorer": ("imubayes",),
}
PLUGINS = ("procedures", "effects", "noise")
# What the plug-ins of a package build on; all other modules of such a package are plug-ins.
FOUNDATIONS = (
    "base", "shared_formulas", "ambient", "carried", "components", "converter_temperature", "fitted_terms",
    "kinematics", "magnitude_estimate", "textbook",
)  # fmt: skip
MOST_LINES = 500
SOURCES = sorted(file for name in PACKAGES for file in (SOURCE / name).rglob("*.py"))


def package(module: str) -> str:
    return module.partition(".")[0]


def floor(module: str) -> int:
    parts = module.split(".")
    part, floors = parts[1] if len(parts) > 1 else "", PACKAGES[parts[0]]
    return next((height for height, names in enumerate(floors) if part in names), -1 if floors else 0)


def is_below(name: str, module: str) -> bool:
    """Return whether a module may import another: of its own floor or below it, or of a package that it builds on."""
    here, there = package(module), package(name)
    return floor(name) <= floor(module) if here == there else there in BUILDS_ON.get(here, ())


def statements(node: ast.AST, inside: bool = False) -> Iterator[tuple[ast.AST, bool]]:
    """Yield the statements below a node, each with whether a function has it; expressions are not looked into."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.stmt | ast.ExceptHandler | ast.match_case):
            yield child, inside
            yield from statements(child, inside or isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef))


def imported(node: ast.AST, modules: set[str]) -> list[str]:
    """Return the package's modules that one statement imports; `from package import module` names the module."""
    if isinstance(node, ast.Import):
        found = [alias.name for alias in node.names]
    elif isinstance(node, ast.ImportFrom):
        names = [f"{node.module}.{alias.name}" for alias in node.names]
        found = list(dict.fromkeys(name if name in modules else str(node.module) for name in names))
    else:
        found = []
    return [name for name in found if package(name) in PACKAGES]


def is_member(module: str) -> bool:
    parts = module.split(".")
    return len(parts) == 3 and parts[0] == "imubayes" and parts[1] in PLUGINS and parts[2] not in FOUNDATIONS


def violations(sources: dict[str, str]) -> list[str]:
    """Return what breaks a rule, in sentences; sources are module name → text."""
    found, edges, modules = [], {}, set(sources)
    for module, text in sources.items():
        tree = ast.parse(text)
        if text.count("\n") > MOST_LINES:
            found.append(f"{module} has more than {MOST_LINES} lines")
        if floor(module) < 0:
            found.append(f"{module} stands on no floor")
        imports = [(node, inside) for node, inside in statements(tree) if isinstance(node, ast.Import | ast.ImportFrom)]
        edges[module] = [name for node, _ in imports for name in imported(node, modules)]
        for name in edges[module]:
            if not is_below(name, module):
                found.append(f"{module} imports {name}, which is above it")
            if is_member(module) and is_member(name):
                found.append(f"{module} imports {name}: members do not know each other")
        if any(inside for _, inside in imports) and module.split(".")[1:2] != ["cli"]:
            found.append(f"{module} imports inside a function")
    return found + [f"{' → '.join(cycle)} is a cycle" for cycle in cycles(edges)]


def cycles(edges: dict[str, list[str]]) -> list[list[str]]:
    """Return one cycle for each module from which one is first met."""
    found, done = [], set()

    def visit(module: str, path: list[str]) -> None:
        if module in path:
            found.append([*path[path.index(module) :], module])
        elif module not in done:
            for name in edges.get(module, []):
                visit(name, [*path, module])
            done.add(module)

    for module in edges:
        visit(module, [])
    return found


def name_of(file: Path) -> str:
    return ".".join(file.relative_to(SOURCE).with_suffix("").parts).removesuffix(".__init__")


def test_the_sources_keep_the_rules():
    assert len(SOURCES) > 300
    assert violations({name_of(file): file.read_text(encoding="utf-8") for file in SOURCES}) == []


@pytest.mark.parametrize(
    ("sources", "complaint"),
    [
        ({"imubayes.foundations.units": "from imubayes.model.signal_path import travel"}, "is above it"),
        ({"imubayes.effects.base": "import imubayes.display.layout"}, "is above it"),
        ({"imubayes.model.grouping": "def f():\n    import imubayes.foundations.campaign_data"}, "inside a function"),
        ({"imubayes.foundations.campaign_data": "f = 1\n" * 501}, "more than 500 lines"),
        ({"imubayes.effects.a": "from imubayes.effects.b import B"}, "do not know each other"),
        ({"imubayes.effects.a": "from imubayes.effects import b", "imubayes.effects.b": ""}, "do not know each other"),
        (
            {
                "imubayes.foundations.campaign_data": "import imubayes.foundations.arrays",
                "imubayes.foundations.arrays": "import imubayes.foundations.campaign_data",
            },
            "is a cycle",
        ),
        ({"imubayes.novelty": ""}, "stands on no floor"),
        ({"imubayes.api.fitting": "import imubayes_archive.unit_fits.run_batch"}, "is above it"),
        ({"imubayes_archive.unit_fits.run_batch": "import imubayes_explorer.start"}, "is above it"),
        ({"imubayes_archive.unit_fits.run_batch": "import imubayes_archive.population.drift"}, "is above it"),
    ],
)
def test_a_planted_fault_is_found(sources, complaint):
    assert any(complaint in sentence for sentence in violations(sources))


@pytest.mark.parametrize(
    "sources",
    [
        {"imubayes.cli.fit": "def fit():\n    from imubayes.api import fit"},
        {"imubayes.effects.a": "from imubayes.effects.base import Effect\nimport jax"},
        {"imubayes.effects.a": "from imubayes.effects.shared_formulas import ConstantBias"},
        {"imubayes.model.signal_path": "from imubayes.foundations.arrays import compose"},
        {"imubayes_archive.unit_fits.run_batch": "from imubayes.model.bind import bind"},
    ],
)
def test_what_is_allowed_passes(sources):
    assert violations(sources) == []


def test_no_two_test_files_share_a_name() -> None:
    # pytest imports them by their bare name and refuses the second one, but only if both are collected.
    names = [path.name for path in Path(__file__).parent.rglob("test_*.py")]
    assert sorted(names) == sorted(set(names))
