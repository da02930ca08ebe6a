"""Pages of the reference, made from what they describe: public names and modules, commands, schemas, tables of symbols.

Every function returns pages, file below the sources → text in MyST Markdown.
"""

import ast
import inspect
import re
import tomllib
from collections.abc import Iterator, Mapping
from itertools import zip_longest
from pathlib import Path
from typing import Any

import imubayes
from imubayes.campaign.setup_gate.judgement import SETUP_FINDINGS
from imubayes.campaign.stream_checks import FINDINGS
from imubayes.cli.campaign import kinds_of_files
from imubayes.cli.main import app
from imubayes.foundations.covariates import COVARIATES
from imubayes.procedures import PROCEDURES
from imubayes_qualification.budgets.standard_quantities import STANDARD_QUANTITIES

ROOT = Path(__file__).parents[2]
Pages = dict[str, str]


def reference_pages() -> Pages:
    """Return all of them."""
    return {
        **api_pages(), **module_pages(), **command_pages(), **schema_pages(), **symbol_pages(), **procedure_pages(),
        **adopted_pages(),
    }  # fmt: skip


def table(header: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """Return a Markdown table; bars and line breaks in a cell are written so that they stay in it."""
    lines = [header, ("---",) * len(header), *rows]
    return "\n".join("| " + " | ".join(_cell(cell) for cell in line) + " |" for line in lines) + "\n"


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def contents(title: str, intro: str, pages: Mapping[str, str]) -> str:
    """Return an index page: its pages, file → what it has, as a table, and for the navigation."""
    rows = [(f"[]({file}.md)", text) for file, text in pages.items()]
    tree = "\n".join(pages)
    return f"# {title}\n\n{intro}\n\n{table(('page', 'contents'), rows)}\n```{{toctree}}\n:hidden:\n\n{tree}\n```\n"


def public_groups() -> dict[str, tuple[str, list[str]]]:
    """Return the groups of public names as the package states them: name → sentence and names in its order."""
    groups = re.findall(r"^- (\w+): (.*?)(?=^- |\Z)", imubayes.__doc__ or "", re.MULTILINE | re.DOTALL)
    return {name: (" ".join(text.split()), re.findall(r"`(\w+)`", text)) for name, text in groups}


def api_pages() -> Pages:
    """Return a page for each group of public names, documented by their docstrings."""
    pages, index = {}, {}
    for group, (_, names) in public_groups().items():
        body = "".join(_documented(name) for name in names)
        file = f"api-{group.lower()}"
        pages[f"reference/{file}.md"] = f"# Python: {group.lower()}\n\n{body}"
        index[file] = ", ".join(f"{{py:obj}}`~imubayes.{name}`" for name in names)
    intro = f"`import imubayes`; imubayes {imubayes.__version__}. Other names are private and may change."
    return {"reference/api.md": contents("Python interface", intro, index), **pages}


def _documented(name: str) -> str:
    member = getattr(imubayes, name)
    if isinstance(member, type):
        kind, options = "autoclass", "   :members:\n   :exclude-members: model_config, model_post_init\n"
    elif callable(member):
        kind, options = "autofunction", ""
    else:
        kind, options = "autodata", "   :no-value:\n"
    return f"## {name}\n\n```{{eval-rst}}\n.. {kind}:: imubayes.{name}\n{options}```\n\n"


def module_pages() -> Pages:
    """Return the page of the modules that a tool of one's own may import: their names, each with its first sentence."""
    listed = tomllib.loads((ROOT / "src" / "docs" / "public_modules.toml").read_text(encoding="utf-8"))
    intro = (
        "# Modules for tools\n\nA tool beside the package may import these names, as packages beside the kernel do. "
        "A change of one of them is stated in the changelog. All other names are private and may change.\n"
    )
    return {"reference/modules.md": "\n".join([intro, *map(_subject, listed["subject"])])}


def _subject(subject: dict[str, Any]) -> str:
    """Return the section of a subject: its modules with all names, then those of which some are public."""
    whole = {file: names_in(file) for file in _files_of(subject["modules"])}
    some = {
        file: {name: known.get(name, "") for name in names}
        for module, names in subject.get("names", {}).items()
        for file in _files_of([module])
        for known in (names_in(file, constants=True),)
    }
    return f"## {subject['title']}\n\n{''.join(_module_section(*each) for each in (whole | some).items())}"


def _files_of(modules: list[str]) -> list[Path]:
    """Return the files of modules, and of packages with all their modules; without those that have no name."""
    files = []
    for module in modules:
        place = ROOT.joinpath("src", *module.split("."))
        files += sorted(place.rglob("*.py")) if place.is_dir() else [place.with_suffix(".py")]
    return [file for file in files if names_in(file)]


def names_in(file: Path, *, constants: bool = False) -> dict[str, str]:
    """Return the public classes and functions that a module defines, each with the first paragraph of its docstring.

    With constants, each with the docstring after it or the comment beside it.
    """
    text, found = file.read_text(encoding="utf-8"), dict[str, str]()
    body, lines = ast.parse(text).body, text.splitlines()
    for node, after in zip_longest(body, body[1:]):
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            found[node.name] = (ast.get_docstring(node) or "").partition("\n\n")[0]
        elif constants and isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = [each.id for target in targets for each in ast.walk(target) if isinstance(each, ast.Name)]
            docstring = (
                after.value.value if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) else ""
            )
            found |= dict.fromkeys(names, str(docstring or lines[node.lineno - 1].partition("  # ")[2]))
    return {name: text for name, text in found.items() if not name.startswith("_")}


def _module_section(file: Path, names: Mapping[str, str]) -> str:
    module = ".".join(file.relative_to(ROOT / "src").with_suffix("").parts)
    said = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
    rows = [(f"`{name}`", text) for name, text in names.items()]
    return f"### `{module}`\n\n{said.partition('\n\n')[0]}\n\n{table(('name', 'contents'), rows)}\n"


def command_pages() -> Pages:
    """Return a page for each command: usage, example and options, from the command itself."""
    pages, rows = {}, {}
    for name in (name for name in app if not name.startswith("-")):
        text = app[name].generate_docs(output_format="markdown", heading_level=1, usage_name=f"imubayes {name}")
        text = re.sub(r"## Table of Contents\n.*?(?=^\*\*|^## )", "", text, flags=re.DOTALL | re.MULTILINE)
        text = re.sub(r"\[(`[^`]+`)\]\(#[^)]*\)", r"\1", text)
        text = re.sub(r' \*\[default: (""|\(\))\]\*', "", text)
        text = re.sub(r"^Example: (.*)$", r"```console\n$ \1\n```", text, flags=re.MULTILINE)
        pages[f"reference/commands/{name}.md"] = text.replace(f"# {name}", f"# imubayes {name}", 1)
        rows[f"commands/{name}"] = (app[name].help or "").strip().partition("\n")[0]
    intro = (
        "Every command has `--help`. Exit status: 0 done, 1 a negative result (not converged, a limit missed), 2 "
        "unusable input. `--json` prints one object on standard output."
    )
    return {"reference/command-line.md": contents("Command line", intro, rows), **pages}


def schema_pages() -> Pages:
    """Return a page for each kind of file: its keys with type, default and meaning, from the JSON Schema."""
    pages, index = {}, {}
    for kind, record in kinds_of_files().items():
        schema = record.load().model_json_schema()
        summary, _ = _described(schema)
        nested = schema.get("$defs", {})
        body = [f"# File format: {kind}\n\n{summary}\n\n`imubayes schema {kind}` prints the JSON Schema.\n"]
        body += [
            _keys(schema),
            *(f"## {name}\n\n{_described(part)[0]}\n\n{_keys(part)}" for name, part in nested.items()),
        ]
        pages[f"reference/formats/{kind}.md"] = "\n".join(body)
        index[f"formats/{kind}"] = summary.partition("\n\n")[0]
    intro = "Units are in the names of the keys (`_deg`, `_ug`, `_degC`) or in a key `unit` beside the value."
    return {"reference/file-formats.md": contents("File formats", intro, index), **pages}


def _described(schema: Mapping[str, Any]) -> tuple[str, dict[str, str]]:
    """Return the description of a record, and that of its keys if its docstring lists them as attributes."""
    described = schema.get("description", "").partition("Examples\n--------\n")[0]
    text, _, attributes = described.partition("Attributes\n----------\n")
    found = re.findall(r"^(\w[\w, ]*) : (.*?)(?=^\w[\w, ]* : |\Z)", attributes, re.MULTILINE | re.DOTALL)
    known = {name.strip(): " ".join(meaning.split()) for names, meaning in found for name in names.split(",")}
    return text.strip(), known


def _keys(schema: Mapping[str, Any]) -> str:
    _, known = _described(schema)
    required = schema.get("required", ())
    rows = []
    for key, value in schema.get("properties", {}).items():
        stated = value.get("default")
        if isinstance(stated, dict):
            stated = ", ".join(f"{name} = {each}" for name, each in stated.items() if each)
        default = "required" if key in required else f"`{stated}`" if stated not in (None, "", []) else "–"
        rows.append((f"`{key}`", value.get("description") or known.get(key, ""), _type(value), default))
    if rows:
        return table(("key", "meaning", "type", "default"), rows)
    return f"One of: {_type(schema)}.\n" if schema.get("enum") or schema.get("anyOf") else ""


def _type(value: Mapping[str, Any]) -> str:
    for several in ("anyOf", "oneOf"):
        if several in value:
            return " or ".join(_type(each) for each in value[several] if each.get("type") != "null")
    if "$ref" in value:
        name = value["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "enum" in value or "const" in value:
        return ", ".join(f"`{each}`" for each in value.get("enum", [value.get("const")]))
    if value.get("type") == "array":
        return f"list of {_type(value.get('items', {}))}"
    if value.get("type") == "object" and isinstance(value.get("additionalProperties"), Mapping):
        return f"table of {_type(value['additionalProperties'])}"
    signs = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
    limits = [f"{sign} {value[key]:g}" for key, sign in signs.items() if key in value]
    return " ".join([value.get("type", "any"), ", ".join(limits)]).strip()


def symbol_pages() -> Pages:
    """Return the quantities of the standards, the covariates, the findings, and the glossary."""
    quantities = [
        (each.symbol, each.name, each.standard, each.term, f"`{each.key}`",
         ", ".join(f"[`{name}`](../effects/{name}.md)" for name in each.effects))
        for each in STANDARD_QUANTITIES
    ]  # fmt: skip
    standards = (
        "# Symbols of the standards\n\nNames and symbols under which the uncertainty report lists its quantities: IEEE "
        "Std 952 (fibre-optic gyros), IEEE Std 517 (rate-integrating gyros, terms of force) and IEEE Std 1293 "
        "(accelerometers). The key names a quantity in a specification. The asymmetry of the standards is the "
        "difference of two scale factors; the coefficient of the effect is half of it.\n\n"
        + table(("symbol", "quantity", "standard", "term", "key", "effects"), quantities)
    )
    columns = [
        (f"`{each.column}`", each.unit, each.symbol or "–", each.phrase, each.origin) for each in COVARIATES.values()
    ]
    covariates = (
        "# Covariates\n\nQuantities that a run may record in addition to its outputs: the column in run tables and "
        "residuals, its unit, its symbol in formulas, and whether it is recorded, derived from recorded columns by the "
        "procedure, or evaluated by the model at each sample.\n\n"
        + table(("column", "unit", "symbol", "meaning", "origin"), columns)
    )
    findings = (
        "# Findings\n\nFindings of `imubayes check`, and of the check of the set-up that `imubayes fit` makes first. A "
        'campaign accepts those about its set-up by name, `accepted = ["table_zero"]`.\n\n'
        + table(
            ("finding", "meaning", "can be accepted"),
            [(f"`{name}`", meaning, "yes" if name in SETUP_FINDINGS else "") for name, meaning in FINDINGS.items()],
        )
    )
    rows = re.findall(r"^\| ([^|]+) \| ([^|]+) \|$", _section(ROOT / "ARCHITECTURE.md", "Glossary"), re.MULTILINE)
    terms = "\n\n".join(f"{term}\n: {meaning}" for term, meaning in rows[1:] if set(term) != {"-"})
    glossary = f"# Glossary\n\n```{{glossary}}\n{terms.replace(chr(10) + ': ', chr(10) + '  ')}\n```\n"
    return {
        "reference/standards-symbols.md": standards,
        "reference/covariates.md": covariates,
        "reference/findings.md": findings,
        "reference/glossary.md": glossary,
    }


def procedure_pages() -> Pages:
    """Return the test procedures, with required columns, campaigns that have them, and the text of their modules."""
    examples: dict[str, list[str]] = {}
    for file in sorted((ROOT / "data").glob("[!h]*/campaign.toml")):
        for name in dict.fromkeys(run["procedure"] for run in tomllib.loads(file.read_text(encoding="utf-8"))["run"]):
            examples.setdefault(name, []).append(f"`{file.parent.name}`")
    sections: dict[str, str] = {}
    rows = []
    for name, procedure in PROCEDURES.items():
        text = re.sub(r" \(P\d[^)]*\)", "", inspect.getdoc(inspect.getmodule(procedure.evaluate)) or "")
        title, _, text = text.partition(": ")
        columns = ", ".join(" or ".join(f"`{each}`" for each in group) for group in procedure.columns)
        link = f"[`{name}`](#{title.lower().replace(' ', '-')})"
        rows.append((link, columns, ", ".join(examples.get(name, ["none"])), procedure.reference))
        sections[title] = f"## {title}\n\n{text[:1].upper()}{text[1:]}\n"
    intro = (
        "# Test procedures\n\nEach run of a campaign names its `procedure`. Runs of several procedures are fitted "
        "together; *the textbook* below is what `imubayes classical` evaluates run by run. The first shipped campaign "
        "is an example of its files: `imubayes example NAME --out .`\n\n"
    )
    header = ("procedure", "required columns, beside outputs", "shipped campaigns", "source")
    return {"reference/procedures.md": intro + table(header, rows) + "\n" + "\n".join(sections.values())}


def _section(file: Path, heading: str) -> str:
    text = file.read_text(encoding="utf-8")
    return text.partition(f"## {heading}\n")[2].partition("\n## ")[0]


_ADOPTED = {
    "CHANGELOG.md": "reference/changelog.md",
    "data/README.md": "reference/data-dictionary.md",
    "data/your-campaign.md": "how-to/your-campaign.md",
    "data/archives.md": "how-to/archives.md",
    "CONTRIBUTING.md": "how-to/contributing.md",
    **{f"benchmarks/results/{file.name}": f"trust/{file.name}" for file in (ROOT / "benchmarks/results").glob("*.md")},
}
"""Documents of the repository that are pages of the site as they stand."""


def adopted_pages() -> Pages:
    """Return the documents of the repository, their links led to the pages of the site; others stay as text."""
    return {page: "\n".join(_linked(ROOT / file, page)) for file, page in _ADOPTED.items()}


def _linked(file: Path, page: str) -> Iterator[str]:
    def lead(match: re.Match[str]) -> str:
        bang, text, target = match.groups()
        place, _, anchor = target.partition("#")
        if "://" in target or not place:
            return match[0]
        found = (file.parent / place).resolve()
        known = _ADOPTED.get(str(found.relative_to(ROOT))) if found.is_relative_to(ROOT) else None
        if known is None and found.is_relative_to(ROOT / "src" / "docs"):
            known = str(found.relative_to(ROOT / "src" / "docs"))
        if known is not None:
            up = "../" * page.count("/")
            return f"[{text}]({up}{known}{'#' * bool(anchor)}{anchor})"
        return f"![{text}](/repository/{found.relative_to(ROOT)})" if bang and found.is_file() else text

    for line in file.read_text(encoding="utf-8").replace("```csv", "```text").splitlines():
        yield re.sub(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)", lead, line)
