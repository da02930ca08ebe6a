"""Which folders a fit may write to: a sampled result is replaced only if that is asked for."""

import json
from pathlib import Path

import pytest

from imubayes.foundations.errors import InputError
from imubayes.results.folder_files import FIT, POSTERIOR, SUMMARY, missing
from imubayes.results.folder_state import claim


def result_in(folder: Path, *, sampled: bool) -> Path:
    folder.mkdir()
    for name in (FIT, POSTERIOR):
        (folder / name).write_text("{}")
    (folder / SUMMARY).write_text(json.dumps({"sampled": sampled}))
    return folder


def test_a_sampled_result_is_kept_unless_it_is_to_be_replaced(tmp_path):
    folder = result_in(tmp_path / "sampled", sampled=True)
    with pytest.raises(InputError, match="the folder holds a sampled result") as caught:
        claim(folder)
    assert "--replace" in caught.value.issues[0].remedy
    claim(folder, replace=True)
    assert (folder / POSTERIOR).is_file(), "nothing is removed before there is a new result"


def test_a_result_that_was_not_sampled_is_replaced_without_asking(tmp_path):
    claim(result_in(tmp_path / "laplace", sampled=False))


def test_a_campaign_folder_is_named_as_such(tmp_path):
    """The advice is never to fit into the folder of a campaign."""
    (tmp_path / "campaign.toml").write_text("")
    (issue,) = missing(tmp_path)
    assert issue.what == "this is a campaign folder, not a result folder"
    assert "--replace" not in issue.remedy
