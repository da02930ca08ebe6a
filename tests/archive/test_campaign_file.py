"""A campaign that was archived reads back as the same record, and damage is noticed."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from beartype.roar import BeartypeCallHintViolation

from imubayes.campaign import load_campaign
from imubayes.foundations.campaign_data import Instruments, Thermometer
from imubayes.foundations.errors import InputError
from imubayes_archive.dataset import campaign_file
from imubayes_archive.dataset.campaign_file import content_checksum, read_campaign, read_head, write_campaign

DATA = Path(__file__).parents[2] / "data"
SHIPPED = sorted(file.parent.name for file in DATA.glob("*/campaign.toml"))
# Of the kinds of which others are read at every run, or as large as all others together.
OTHERS = (
    "full-qualification", "rotation-modulation", "trihedral-imu", "hidden-gyro", "hidden-outside", "hidden-thermal",
    "hidden-two", "hidden-kinematic", "hidden-accelerometer",
)  # fmt: skip


def differences(found, expected, where: str = "campaign") -> list[str]:
    """Compare two records field by field, types and element types included."""
    if type(found) is not type(expected) and not isinstance(expected, Mapping):
        return [f"{where}: {type(found).__name__} instead of {type(expected).__name__}"]
    if dataclasses.is_dataclass(expected):
        names = [each.name for each in dataclasses.fields(expected)]
        return [d for n in names for d in differences(getattr(found, n), getattr(expected, n), f"{where}.{n}")]
    if isinstance(expected, np.ndarray):
        same = found.dtype == expected.dtype and np.array_equal(found, expected, equal_nan=found.dtype.kind == "f")
        return [] if same else [where]
    if isinstance(expected, Mapping):
        if list(found) != list(expected):
            return [f"{where}: keys"]
        return [d for key in expected for d in differences(found[key], expected[key], f"{where}[{key}]")]
    if isinstance(expected, tuple):
        if len(found) != len(expected):
            return [f"{where}: length"]
        return [
            d for i, (a, b) in enumerate(zip(found, expected, strict=True)) for d in differences(a, b, f"{where}[{i}]")
        ]
    return [] if found == expected else [where]


@pytest.mark.parametrize(
    "name", [pytest.param(one, marks=pytest.mark.slow) if one in OTHERS else one for one in SHIPPED]
)
def test_every_shipped_campaign_reads_back_the_same(name, tmp_path):
    campaign = load_campaign(DATA / name)
    write_campaign(campaign, tmp_path / "campaign.parquet")
    found = read_campaign(tmp_path / "campaign.parquet")
    assert differences(found, campaign) == []
    assert content_checksum(found) == content_checksum(campaign)


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    file = tmp_path_factory.mktemp("archive") / "campaign.parquet"
    write_campaign(load_campaign(DATA / "polar-tumble"), file)
    return file


def test_the_comparison_sees_a_changed_value():
    campaign = load_campaign(DATA / "polar-tumble")
    run = campaign.runs[0]
    other = run.observed.copy()
    other[0, 0] = np.nextafter(other[0, 0], np.inf)
    changed = dataclasses.replace(campaign, runs=(dataclasses.replace(run, observed=other), *campaign.runs[1:]))
    assert differences(changed, campaign) == ["campaign.runs[0].observed"]
    assert content_checksum(changed) != content_checksum(campaign)


def test_the_uncertainty_of_a_temperature_is_kept(tmp_path):
    campaign = load_campaign(DATA / "polar-tumble")
    first = dataclasses.replace(campaign.runs[0], temperature_uncertainty=0.5, converter_temperature_uncertainty=2.0)
    stated = dataclasses.replace(campaign, runs=(first, *campaign.runs[1:]))
    write_campaign(stated, tmp_path / "campaign.parquet")
    found = read_campaign(tmp_path / "campaign.parquet")
    assert (found.runs[0].temperature_uncertainty, found.runs[0].converter_temperature_uncertainty) == (0.5, 2.0)
    assert differences(found, stated) == []
    assert content_checksum(stated) != content_checksum(campaign)


def test_thermometers_and_instruments_are_kept(tmp_path):
    campaign = load_campaign(DATA / "polar-tumble")
    first = dataclasses.replace(campaign.runs[0], thermometer="Pt")
    known = {"thermometers": {"Pt": Thermometer("Pt", 0.1, None)}, "instruments": Instruments(time_base=1e-6)}
    stated = dataclasses.replace(campaign, runs=(first, *campaign.runs[1:]), **known)
    write_campaign(stated, tmp_path / "campaign.parquet")
    found = read_campaign(tmp_path / "campaign.parquet")
    assert (found.runs[0].thermometer, found.thermometers, found.instruments) == ("Pt", *known.values())
    assert content_checksum(stated) != content_checksum(campaign)


def test_the_head_is_read_without_the_rows(small):
    head, campaign = read_head(small), load_campaign(DATA / "polar-tumble")
    assert (head.unit, head.name, head.digest) == (campaign.serial, campaign.name, campaign.digest)
    assert (head.runs, head.rows) == (len(campaign.runs), sum(run.rows for run in campaign.runs))


def test_a_flipped_byte_never_changes_what_is_read(small, tmp_path):
    """Bytes that the reader does not look at, such as a second copy of the schema, may flip without effect."""
    content, expected = small.read_bytes(), content_checksum(read_campaign(small))
    noticed = 0
    for place in np.linspace(0, len(content) - 1, 40).astype(int):
        damaged = tmp_path / "damaged.parquet"
        damaged.write_bytes(content[:place] + bytes([content[place] ^ 0x55]) + content[place + 1 :])
        try:
            assert content_checksum(read_campaign(damaged)) == expected
        except InputError as error:
            noticed += "damaged" in str(error) or "schema version" in str(error)
        except BeartypeCallHintViolation:  # types are checked in tests alone; without, the checksum differs
            noticed += 1
    assert noticed > 15


def test_a_truncated_file_is_noticed(small, tmp_path):
    damaged = tmp_path / "damaged.parquet"
    damaged.write_bytes(small.read_bytes()[:-100])
    with pytest.raises(InputError, match="damaged"):
        read_head(damaged)


def test_the_files_of_earlier_versions_are_read(monkeypatch):
    """The shipped archive was packed before tables had a zero angle and two uncertainties of their axis."""
    files = sorted((DATA / "unit-archive").rglob("*.parquet"))
    assert files
    for file in files:
        assert all(table.zero_angle == 0 for table in read_campaign(file).tables.values())
    # Planted fault: the checksum is that of all fields that records have today.
    monkeypatch.setattr(campaign_file, "_stored_fields", lambda _: {})
    with pytest.raises(InputError, match="checksum"):
        read_campaign(files[0])
