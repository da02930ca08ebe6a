"""The documentation site has a page for every effect, command, public name and kind of file; Sphinx is not run here."""

import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np

import imubayes
from imubayes.adequacy import adequacy_record, noise_tests
from imubayes.campaign.file_schemas import CampaignFile
from imubayes.campaign.setup_gate.judgement import SETUP_FINDINGS
from imubayes.cli.main import app
from imubayes.criticism.explanation_records import Verdict
from imubayes.effects.base import Effect
from imubayes.model.effect_registry import Registry
from imubayes.procedures import PROCEDURES
from imubayes.responses.residual_covariates import ResidualCovariate
from test_layering import SOURCE, SOURCES

sys.path.insert(0, str(Path(__file__).parents[1] / "src" / "docs"))
import gallery
import reference_pages
import responses

DOCS = SOURCE / "docs"


def test_every_member_of_the_catalogue_has_a_page_with_cause_formula_and_parameters():
    pages = gallery.effect_pages([])
    members = Registry().effects
    assert set(gallery.CAUSES) == set(members)
    assert set(pages) == {"effects/index.md", *(f"effects/{name}.md" for name in members)}
    for name, member in members.items():
        page = pages[f"effects/{name}.md"]
        assert gallery.CAUSES[name] in page
        assert member.reference in page
        assert all(f"`{field}`" in page for field in gallery.declared_parameters(member))
        assert ("## What it leaves" in page) == issubclass(member, Effect)
        assert f"[{name}]({name}.md)" in pages["effects/index.md"]


def test_every_procedure_that_is_drawn_exists_and_those_by_hand_are_not():
    drawn = {procedure for procedures in responses.CAMPAIGNS.values() for procedure in procedures}
    assert set(PROCEDURES) - drawn == {"free_tumble", "slow_motion", "free_rotation", "static_record"}


def test_every_command_has_a_page():
    pages = reference_pages.command_pages()
    names = {name for name in app if not name.startswith("-")}
    assert {f"reference/commands/{name}.md" for name in names} == set(pages) - {"reference/command-line.md"}
    assert all(f"commands/{name}\n" in pages["reference/command-line.md"] for name in names)
    assert "--no-sample" in pages["reference/commands/fit.md"]


def test_every_public_name_is_documented_in_its_group():
    pages = "".join(reference_pages.api_pages().values())
    assert all(f"imubayes.{name}\n" in pages for name in imubayes.__all__)


def test_every_name_of_a_public_module_is_listed():
    page = reference_pages.module_pages()["reference/modules.md"]
    assert "### `imubayes.results.summary`" in page
    assert "| `Summary` | " in page
    assert "| `_" not in page
    assert re.findall(r"^\| `\w+` \| +\|$", page, re.MULTILINE) == []


def test_every_key_of_a_campaign_is_listed():
    page = reference_pages.schema_pages()["reference/formats/campaign.md"]
    schema = CampaignFile.model_json_schema()
    keys = [key for part in (schema, *schema["$defs"].values()) for key in part.get("properties", {})]
    assert len(keys) > 40
    assert all(f"| `{key}` |" in page for key in keys)


def test_every_symbol_of_the_standards_and_every_term_of_the_glossary_is_listed():
    pages = reference_pages.symbol_pages()
    source = " ".join(file.read_text(encoding="utf-8") for file in (SOURCE / "imubayes" / "campaign").rglob("*.py"))
    findings = {*SETUP_FINDINGS, *re.findall(r'Finding\(\s*"(\w+)"', source)}
    assert len(findings) > 30
    assert all(f"| `{name}` |" in pages["reference/findings.md"] for name in findings)
    symbols = [quantity.symbol for quantity in reference_pages.STANDARD_QUANTITIES]
    assert all(f"| {symbol} |" in pages["reference/standards-symbols.md"] for symbol in symbols)
    assert "retained fraction" in pages["reference/glossary.md"]


def test_links_of_documents_lead_to_pages_of_the_site():
    pages = reference_pages.adopted_pages()
    assert "](../reference/data-dictionary.md#columns)" in pages["how-to/your-campaign.md"]
    assert "](README.md" not in "".join(pages.values())


def test_every_sentence_that_is_explained_is_one_that_the_program_says_and_every_verdict_is_explained():
    page = (DOCS / "how-to" / "what-the-program-says.md").read_text(encoding="utf-8")
    source = " ".join(file.read_text(encoding="utf-8") for file in SOURCES)
    rows = re.findall(r"^\| (`.*?) \|", page, re.MULTILINE)
    said = [phrase for row in rows for phrase in re.findall(r"`([^`]+)`", row)]
    assert len(said) > 20
    assert [phrase for phrase in said if phrase not in source] == []
    diagnosed = page.partition("## `diagnose`")[2]
    assert all(f"| {verdict.replace('_', ' ')} |" in diagnosed for verdict in get_args(Verdict))


def test_the_limits_of_the_noise_tests_are_those_of_the_page():
    page = (DOCS / "how-to" / "what-the-program-says.md").read_text(encoding="utf-8")
    section = page.partition("## How the noise is judged")[2].partition("\n## ")[0]
    scale, test, suspected = (
        str(limit)
        for limit in (
            adequacy_record._NOISE_CONTRADICTED_P,
            noise_tests._FALSE_ALARM_INTERVALS,
            noise_tests._SUSPECTED_INTERVALS_P,
        )
    )
    assert re.findall(r"0\.\d+", section) == [scale, test, test, suspected]
    assert noise_tests._COARSE_STEP == 2
    assert "twice the noise of a row" in section


def test_the_pattern_of_a_residual_is_named_by_its_simplest_curve():
    rng = np.random.default_rng(5)
    x, z, run = rng.uniform(-1, 1, 200), rng.uniform(-1, 1, 200), np.repeat(np.arange(4), 50)
    rate, force = ResidualCovariate("rate_i", "deg/s", x, "rate"), ResidualCovariate("force_i", "g", z, "force")

    def left(y: np.ndarray) -> responses.Left:
        column = responses.Column("effect", 0, "effect.a", "gx", "deg/h", 1.0, 0.1)
        return responses.Left(
            "effect", "rate_table", "campaign", column, 9.0, 0.5, (), (), None, None, "gx", "deg/h", rate,
            (rate, force), run, y, y + 0.01 * rng.standard_normal(200), np.ones(200),
        )  # fmt: skip

    def said(y: np.ndarray) -> str:
        return gallery.pattern(left(y))

    assert said(x**2 - 0.3).startswith("a parabola in rate (> 99 %")
    assert said(np.sign(x) - x).startswith("a step at zero in rate")
    assert said(np.abs(x)).startswith("two straight lines that meet at zero in rate")
    assert said(x * z).startswith("the product of rate and force")
    assert said(x + np.where(run % 2, 1.0, -1.0)).startswith("a straight line in rate, beside an offset of each run")
    assert said(x + z).startswith("straight lines in rate and in force")
    assert said(np.where(run % 2, x, -x)).startswith("in each run a straight line in rate")
    assert said(np.sin(40 * x)).startswith("no simple curve in rate")
    found = {"parabola": x**2 - 0.3, "product": x * z, "none": np.sin(40 * x)}
    index = gallery._by_pattern([[replace(left(y), effect=name)] for name, y in found.items()])
    assert "| a parabola in rate | [`parabola`](parabola.md) |" in index
    assert "[`product`](product.md)" in index
    assert "none.md" not in index


def test_every_procedure_is_listed_with_its_columns_and_a_shipped_campaign():
    page = reference_pages.procedure_pages()["reference/procedures.md"]
    rows = {name: line for name in PROCEDURES for line in page.splitlines() if line.startswith(f"| [`{name}`](#")}
    headings = {title.lower().replace(" ", "-") for title in re.findall(r"^## (.*)$", page, re.MULTILINE)}
    assert set(rows) == set(PROCEDURES)
    for name, line in rows.items():
        _, _, columns, campaigns, *_ = line.split("|")
        assert all(f"`{column}`" in columns for group in PROCEDURES[name].columns for column in group)
        assert campaigns.strip()
    assert set(re.findall(r"\]\(#([^)]*)\)", page)) == headings


def test_every_page_of_measurements_is_in_the_contents():
    """A page that no table of contents names is a warning, at which the build of the site ends."""
    contents = (
        (reference_pages.ROOT / "src" / "docs" / "trust" / "index.md")
        .read_text(encoding="utf-8")
        .rpartition("```{toctree}")[2]
    )
    pages = {file.stem for file in (reference_pages.ROOT / "benchmarks" / "results").glob("*.md")}
    assert pages <= set(contents.split())
