"""Every public name is documented as a user needs it, and the example of its docstring gives what it shows.

The examples run in a folder like the source tree, in which the shipped accelerometer channel has been fitted, and a
later calibration of it.
"""

import doctest
import inspect
import re
import shutil
from pathlib import Path

import pytest

import imubayes
from later_campaign import write_later

ROOT = Path(__file__).parents[1]
ALIASES = ("Scalar",)  # of an annotation; it has no docstring of its own
NAMES = [name for name in imubayes.__all__ if name not in ALIASES]
# What their examples take long for is computed by tests of their own as well.
LONG = ("navigation_impact", "plant", "selftest")
EXAMPLES = [pytest.param(name, marks=pytest.mark.slow) if name in LONG else name for name in NAMES]
FUNCTIONS = [name for name in NAMES if not isinstance(getattr(imubayes, name), type)]
FORM = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def text_of(name: str) -> str:
    return inspect.getdoc(getattr(imubayes, name)) or ""


def failures(text: str, name: str) -> str:
    """Run the examples of a text; return what differs from what it shows."""
    test = doctest.DocTestParser().get_doctest(text, {"__name__": "examples"}, name, None, 0)
    said: list[str] = []
    doctest.DocTestRunner(optionflags=FORM).run(test, out=said.append)
    return "".join(said)


@pytest.fixture(scope="module")
def folder(accel_channel, tmp_path_factory) -> Path:
    place = tmp_path_factory.mktemp("examples")
    for name in ("data", "models"):
        (place / name).symlink_to(ROOT / name)
    shutil.copytree(accel_channel, place / "results" / "accel-channel")
    write_later(ROOT / "data" / "accel-channel", place / "campaigns" / "later")
    imubayes.fit(place / "campaigns" / "later", "accel-channel", place / "results" / "later", sample=False)
    return place


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_example_gives_what_it_shows(name, folder, monkeypatch):
    monkeypatch.chdir(folder)
    text = text_of(name)
    assert "\nExamples\n--------\n>>> " in text
    assert failures(text, name) == ""


def test_a_wrong_example_is_seen():
    assert "Expected" in failures(">>> import imubayes\n>>> imubayes.to_si('mm')\n0.002", "wrong")


@pytest.mark.parametrize("name", FUNCTIONS)
def test_every_argument_is_explained(name):
    """In the section of the parameters, or, if there is none, by its name in the first sentence."""
    arguments = inspect.signature(getattr(imubayes, name)).parameters
    section = text_of(name).partition("\nParameters\n")[2].partition("\nRaises\n")[0]
    heads = re.findall(r"^([\w, ]+) : ", section, re.MULTILINE)
    explained = {word.strip() for head in heads for word in head.split(",")}
    sentence = set(re.findall(r"\w+", text_of(name).partition("\n")[0])) if not section else set()
    assert set(arguments) <= explained | sentence
