"""The diagram of ARCHITECTURE.md, made from the imports: `python tests/architecture_diagram.py` writes it."""

import ast
import re
from pathlib import Path

from test_layering import KERNEL, SOURCES, name_of, statements

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "ARCHITECTURE.md"
BLOCK = re.compile(r"(?<=```mermaid\n).*?(?=```)", re.DOTALL)
FOUNDATION = KERNEL[0]
"""Bottom-floor modules, which everything may use: one node, without arrows to it."""


def room(module: str) -> str:
    """Return the package of the kernel that a dotted module name belongs to, or the guest."""
    first, _, rest = module.partition(".")
    return rest.partition(".")[0] if first == "imubayes" else first


def imports() -> dict[str, set[str]]:
    """Return room → rooms that it imports."""
    found: dict[str, set[str]] = {}
    for file in SOURCES:
        here = room(name_of(file))
        for node, _ in statements(ast.parse(file.read_text())):
            own = isinstance(node, ast.ImportFrom) and (node.module or "").startswith("imubayes")
            if own and here not in ("", "__main__"):
                found.setdefault(here, set()).add(room(str(node.module)))
    return {here: others - {here, "", *FOUNDATION} for here, others in found.items() if here not in FOUNDATION}


def reduced(edges: dict[str, set[str]]) -> dict[str, set[str]]:
    """Return the transitive reduction: an arrow that a longer way implies is left out."""

    def reach(start: str) -> set[str]:
        beyond = edges.get(start, set())
        return beyond.union(*(reach(other) for other in beyond)) if beyond else set()

    return {
        here: {other for other in others if not any(other in reach(between) for between in others - {other})}
        for here, others in edges.items()
    }


def diagram() -> str:
    """Return the Mermaid flowchart of the rooms; an arrow is the way of the data, from the imported to the importer."""
    arrows = sorted(f"    {other} --> {here}" for here, others in reduced(imports()).items() for other in others)
    return "\n".join(["flowchart LR", *arrows, ""])


def main() -> None:
    PAGE.write_text(BLOCK.sub(lambda _: diagram(), PAGE.read_text()))


if __name__ == "__main__":
    main()
