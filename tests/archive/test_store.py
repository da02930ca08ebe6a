"""Packing: incremental, atomic, and readable as a dataset."""

import os
import shutil
from pathlib import Path

import polars as pl
import pytest

from imubayes.cli.main import run
from imubayes.foundations.errors import InputError
from imubayes_archive.dataset import Archive, campaign_folders, pack
from imubayes_archive.dataset.store import open_archive

DATA = Path(__file__).parents[2] / "data"


@pytest.fixture
def campaigns(tmp_path):
    """Two small campaigns, one of a unit with an odd serial number."""
    folder = tmp_path / "campaigns"
    for name in ("polar-tumble", "accel-channel"):
        shutil.copytree(DATA / name, folder / name)
    file = folder / "polar-tumble" / "campaign.toml"
    text = file.read_text()
    serial = next(line for line in text.splitlines() if line.startswith("serial"))
    file.write_text(text.replace(serial, 'serial = "A/7 =b"'))
    return folder


def test_packing_adds_what_is_new_and_rewrites_nothing(campaigns, tmp_path):
    out = tmp_path / "archive"
    first = pack(campaign_folders([campaigns / "polar-tumble"]), out)
    assert (len(first.added), first.present, first.refused) == (1, 0, ())
    kept = {file: file.stat().st_mtime_ns for file in Archive(out).files()}
    second = pack(campaign_folders([campaigns]), out)
    assert (len(second.added), second.present) == (1, 1)
    assert all(file.stat().st_mtime_ns == time for file, time in kept.items())
    assert open_archive(out).check() == ()
    assert {head.unit for head in Archive(out).campaigns()} >= {"A/7 =b"}


def test_a_changed_campaign_is_another_file(campaigns, tmp_path):
    out = tmp_path / "archive"
    pack(campaign_folders([campaigns]), out)
    table = next((campaigns / "accel-channel").rglob("*.csv"))
    table.write_text(table.read_text() + "\n")
    assert len(pack(campaign_folders([campaigns]), out).added) == 1
    assert len(Archive(out).files()) == 3


def test_a_folder_that_cannot_be_used_does_not_stop_the_others(campaigns, tmp_path):
    (campaigns / "accel-channel" / "campaign.toml").write_text("format = 1\n")
    packed = pack(campaign_folders([campaigns]), tmp_path / "archive")
    assert len(packed.added) == 1
    assert [Path(refusal.folder).name for refusal in packed.refused] == ["accel-channel"]
    assert packed.refused[0].issues


def test_a_failed_write_leaves_nothing(campaigns, tmp_path, monkeypatch):
    def fail(source, target):
        raise OSError("disk full")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(OSError, match="disk full"):
        pack(campaign_folders([campaigns]), tmp_path / "archive")
    assert [file for file in (tmp_path / "archive").rglob("*") if file.is_file()] == []


def test_check_reports_damage_misplacement_and_strays(campaigns, tmp_path):
    out = tmp_path / "archive"
    pack(campaign_folders([campaigns]), out)
    good, bad = Archive(out).files()
    content = bytearray(bad.read_bytes())
    content[len(content) // 2] ^= 1
    bad.write_bytes(content)
    moved = out / "unit=other" / good.name
    moved.parent.mkdir()
    good.rename(moved)
    (moved.parent / ".x.parquet.1.part").write_bytes(b"")
    words = " ".join(issue.what for issue in Archive(out).check())
    assert "damaged" in words
    assert "is missing from its folder" in words
    assert "interrupted write" in words


def test_polars_reads_the_dataset(campaigns, tmp_path):
    out = tmp_path / "archive"
    pack(campaign_folders([campaigns / "accel-channel"]), out)
    rows = pl.scan_parquet(f"{out}/unit=*/*.parquet", hive_partitioning=True, missing_columns="insert").collect()
    assert set(rows["unit"]) == {head.unit for head in Archive(out).campaigns()}
    assert rows.height == sum(head.rows for head in Archive(out).campaigns())


def test_an_empty_folder_is_refused(tmp_path):
    with pytest.raises(InputError, match="no archive"):
        open_archive(tmp_path)
    with pytest.raises(InputError, match="no campaign"):
        campaign_folders([tmp_path])


def test_the_commands(campaigns, tmp_path, capsys):
    out = tmp_path / "archive"
    assert run(["archive", "pack", str(campaigns), "--out", str(out)]) == 0
    assert "2 campaigns added" in capsys.readouterr().out
    assert run(["archive", "list", str(out)]) == 0
    assert "A/7 =b" in capsys.readouterr().out
    assert run(["archive", "check", str(out)]) == 0
    Archive(out).files()[0].write_bytes(b"nothing")
    assert run(["archive", "check", str(out)]) == 1
    assert "damaged" in capsys.readouterr().out
