"""The small campaign, made once and copied for each test that wants to spoil it."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from small_files import write_small_campaign


@pytest.fixture(scope="session")
def template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("template") / "small"
    write_small_campaign(folder)
    return folder


@pytest.fixture
def small(template: Path, tmp_path: Path) -> Path:
    """A copy of the small campaign, to be spoilt."""
    return Path(shutil.copytree(template, tmp_path / "small"))


@pytest.fixture
def edit(small: Path) -> Callable[[str, str, str], None]:
    """Replace a text once in a file of the small campaign."""

    def replace(file: str, old: str, new: str) -> None:
        text = (small / file).read_text()
        assert old in text
        (small / file).write_text(text.replace(old, new, 1))

    return replace
