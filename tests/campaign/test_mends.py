"""`check --fix COPY`: what is mended needs no fact, and what needs one is left and named."""

import shutil
from pathlib import Path

import pytest

import imubayes
from imubayes.campaign.mends import mend_campaign
from imubayes.cli.main import run

SOURCE = Path(__file__).parents[2] / "data" / "accel-channel"


@pytest.fixture
def spoilt(tmp_path) -> Path:
    """A campaign with misspelt keys, words and columns, and rows out of order."""
    folder = tmp_path / "spoilt"
    shutil.copytree(SOURCE, folder)
    file = folder / "campaign.toml"
    text = file.read_text()
    for old, new in (("latitude_deg", "Latitude-deg"), ('kind = "accelerometer"', 'kind = "Accelerometer"')):
        assert old in text
        text = text.replace(old, new, 1)
    file.write_text(text)
    table = folder / "runs" / "ramp-1g.csv"
    header, first, second, *rest = table.read_text().splitlines()
    table.write_text(
        "\n".join([header.replace("time_s", "Time_s").replace(",ax,", ", AX,"), second, first, *rest]) + "\n"
    )
    return folder


def test_the_copy_is_what_was_meant(spoilt, tmp_path, capsys):
    before = {path: path.read_bytes() for path in spoilt.rglob("*") if path.is_file()}
    assert run(["check", str(spoilt)]) == 2
    capsys.readouterr()
    copy = tmp_path / "copy"
    assert run(["check", str(spoilt), "--fix", str(copy)]) == 0
    said = capsys.readouterr().err
    assert "key 'Latitude-deg' → 'latitude_deg'" in said
    assert "kind = 'Accelerometer' → 'accelerometer'" in said
    assert "rows put in order of time_s" in said
    mended, meant = imubayes.load_campaign(copy), imubayes.load_campaign(SOURCE)
    for one, other in zip(mended.runs, meant.runs, strict=True):
        assert (one.observed == other.observed).all()
    assert {path: path.read_bytes() for path in spoilt.rglob("*") if path.is_file()} == before


def test_what_needs_a_fact_is_left_and_named(tmp_path, capsys):
    folder = tmp_path / "campaign"
    shutil.copytree(SOURCE, folder)
    file = folder / "campaign.toml"
    file.write_text(file.read_text().replace("latitude_deg", "breadth_deg", 1).replace('per = "g"', 'per = "gee"', 1))
    text = file.read_text()
    assert mend_campaign(folder, tmp_path / "copy") == ()
    assert (tmp_path / "copy" / "campaign.toml").read_text() == text
    assert run(["check", str(folder), "--fix", str(tmp_path / "other")]) == 2
    said = capsys.readouterr().err
    assert "nothing can be corrected without a further fact" in said
    assert "breadth_deg" in said
    assert run(["check", str(folder), "--fix", str(tmp_path / "other")]) == 2  # never over what is there
