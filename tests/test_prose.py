"""The worst patterns of un-English prose are in no message and on no page; CONTRIBUTING.md has better wordings.

The patterns are those that have no correct use in these texts.
"""

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "src" / "docs"))
import gallery
import reference_pages

ROOT = Path(__file__).parents[1]
PAGES = ("README.md", "data/README.md", "data/your-campaign.md", "data/archives.md", "src/docs/**/*.md")
PATTERNS = {
    r"\b(to|can|cannot) be had\b": "can be obtained, can be opened",
    r"\banyhow\b": "in any case, in an unknown attitude",
    r"\blikeliest\b": "most probable",
    r"\bnobody\b": "not stated, unknown",
    r"\bheld against\b|\bholds? (it|them|two \w+|the \w+) against\b": "compared with",
    r"\b(tells?|told) of\b|\btell(s|ing)? apart\b|\btold apart\b|\btold by\b": "determine, distinguish",
    r"\b(cannot|does not|do not) tell\b": "cannot determine, does not show",
    r"\bwhat is (left|missing|said|known|there) (is|are|of|in|by)\b": "the residual, missing effects, the known …",
    r"\bstands? beside\b|\bstands? there\b": "is given beside",
    r"\b[Mm]end (the|what|it)\b": "correct",
    r"\bmay stand\b": "may be in, may be given",
    r"\bc[ao]mes? along\b": "comes with the input",
    r"\b(is|are|was|were) asked for\b|\bas asked\b": "requested",
    r"\bgo(es)? on from\b": "start from, continue from",
    r"\bwhat (the|a) model leaves\b": "the residual",
    r"\b(say|says|said) (little|nothing|much) (of|about)\b": "contain little information on",
    r"\bsome (percent|ten|hundred)\b": "a few percent, about ten",
    r"\bof what\b": "name the thing",
    r"\bwhat kept (it|them)\b": "the cause",
}


def _texts(file: Path) -> Iterator[str]:
    """Yield the strings of a module that a user may read: all but docstrings, which only the commands show."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    unseen = (
        {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)} if "cli" not in file.parts else set()
    )
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in unseen:
            yield " ".join(node.value.split())


def _found(text: str) -> list[str]:
    return [f"{match[0]!r}: {better}" for pattern, better in PATTERNS.items() for match in re.finditer(pattern, text)]


def test_no_message_has_a_pattern_that_is_not_english():
    files = sorted((ROOT / "src").glob("imubayes*/**/*.py"))
    assert len(files) > 300
    faults = [f"{file.relative_to(ROOT)}: {fault}" for file in files for text in _texts(file) for fault in _found(text)]
    assert faults == []


def test_no_sentence_of_the_explore_page_has_one():
    """A sentence of the page's scripts is a string or a template of three words or more."""
    scripts = sorted((ROOT / "src" / "imubayes_explorer" / "page").glob("*.js"))
    assert len(scripts) > 15
    sentences = r"""["`]([^"`\n]*\w+ \w+ \w+[^"`\n]*)["`]"""
    faults = [
        f"{script.name}: {fault}"
        for script in scripts
        for sentence in re.findall(sentences, script.read_text(encoding="utf-8"))
        for fault in _found(sentence)
    ]
    assert faults == []


def test_no_page_has_a_pattern_that_is_not_english():
    files = [file for pattern in PAGES for file in sorted(ROOT.glob(pattern))]
    assert len(files) > 35
    faults = [
        f"{file.relative_to(ROOT)}: {fault}"
        for file in files
        for fault in _found(" ".join(file.read_text(encoding="utf-8").split()))
    ]
    assert faults == []


def test_no_docstring_that_becomes_a_page_or_a_help_text_has_one():
    """The pages of commands, keys of files, public names, procedures and effects are made from docstrings."""
    made = {
        **reference_pages.api_pages(),
        **reference_pages.command_pages(),
        **reference_pages.schema_pages(),
        **reference_pages.procedure_pages(),
        **gallery.effect_pages([]),
    }
    assert len(made) > 150
    assert [f"{page}: {fault}" for page, text in made.items() for fault in _found(" ".join(text.split()))] == []


@pytest.mark.parametrize(
    "sentence",
    [
        "the port cannot be had",
        "The likeliest shape",
        "the runs do not tell which",
        "what is missing is named",
        "the unit that is asked for",
        "a curve for what the model leaves",
        "a scale good to some percent",
    ],
)
def test_such_a_sentence_is_found(sentence):
    assert len(_found(sentence.replace("The", "the"))) == 1
