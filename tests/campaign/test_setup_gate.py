"""Mistakes in a set-up are named with their remedy before any fit, and valid campaigns pass."""

import re
import shutil
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from campaign_files import Files
from generating_law import DETECTABLE, STATED, chi_square
from seeded_mistakes import MISTAKES, Planted, plant, says
from valid_campaigns import KINDS, valid_campaign

from imubayes.campaign import FINDINGS, Inspection, inspect_campaign, load_campaign
from imubayes.campaign.setup_gate.equipment_mistakes import TableZero
from imubayes.campaign.setup_gate.judgement import SETUP_FINDINGS
from imubayes.campaign.setup_gate.search import Search
from imubayes.campaign.setup_gate.steadiness import SteadinessLevels
from imubayes.foundations.errors import InputError

ROOT = Path(__file__).parents[2]
DATA = ROOT / "data"
SHIPPED = sorted(file.parent.name for file in DATA.glob("*/campaign.toml"))
QUICK = ("polar-tumble", "head", "converter", "converter_cycle", "cycle")
"""Kinds of campaigns of the default tests, each judged in half a second; the study has all."""
SHIPPED_QUICK = ("polar-tumble", "redundant-imu", "trihedral-imu")
SEEDS = tuple(next(seed for seed in range(7000, 8000) if KINDS[seed % len(KINDS)] == kind) for kind in QUICK)
FIRST = next(seed for seed in SEEDS if KINDS[seed % len(KINDS)] == "head")
PER_MISTAKE = 1
"""Campaigns that each mistake is planted into, in the default tests; the study has thousands."""
SUBTLE = (
    "latitude", "latitude_value", "height", "fahrenheit", "fahrenheit_throughout", "thermometers",
    "temperature_reversed",
)  # fmt: skip
"""Mistakes that few campaigns show; the study counts them like all others if they can be detected."""


@pytest.fixture(scope="module")
def valid(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    """Valid campaigns drawn at random, by seed: one of each quick kind."""
    folders = {seed: tmp_path_factory.mktemp("valid") / str(seed) for seed in SEEDS}
    for seed, folder in folders.items():
        valid_campaign(folder, seed)
    return folders


def gate(inspection: Inspection) -> set[str]:
    kinds = {*SETUP_FINDINGS, "setup_disagrees"}
    return {finding.name for finding in inspection.findings} & kinds


def said(folder: Path) -> str:
    inspection = inspect_campaign(folder)
    return " ".join(map(str, (*inspection.issues, *inspection.findings)))


def planted_into(valid: Path, folder: Path, name: str, seed: int) -> Planted | None:
    """Plant a mistake into a copy of a campaign; None if it has no such runs, or nobody could detect it."""
    shutil.copytree(valid, folder)
    planted = plant(folder, name, seed)
    return planted if planted is not None and _detectable(valid, folder) else None


def _detectable(valid: Path, folder: Path) -> bool:
    # An input that the law does not know, such as an angle beyond a turn, is no number.
    return not chi_square(folder) - chi_square(valid) < DETECTABLE


@pytest.mark.parametrize(
    "name", [name if name in SHIPPED_QUICK else pytest.param(name, marks=pytest.mark.slow) for name in SHIPPED]
)
def test_shipped_campaigns_pass(name: str) -> None:
    assert not gate(inspect_campaign(DATA / name))


def test_drawn_campaigns_pass(valid: dict[int, Path]) -> None:
    for folder in valid.values():
        assert not gate(inspect_campaign(folder))


@pytest.mark.parametrize("name", [name for name in MISTAKES if name not in SUBTLE])
def test_a_seeded_mistake_is_named(valid: dict[int, Path], tmp_path: Path, name: str) -> None:
    made = 0
    for seed in SEEDS:
        folder = tmp_path / str(seed)
        planted = planted_into(valid[seed], folder, name, seed)
        if planted is not None:
            text = said(folder)
            assert says(planted, text), (planted, text)
            made += 1
        if made == PER_MISTAKE:
            break
    assert made, "no campaign shows the mistake"


def test_a_negated_latitude_is_named_where_the_gyros_show_it(tmp_path: Path) -> None:
    folder = Path(shutil.copytree(DATA / "trihedral-imu", tmp_path / "campaign"))
    file = folder / "campaign.toml"
    file.write_text(file.read_text(encoding="utf-8").replace("latitude_deg = 34.25", "latitude_deg = -34.25"))
    assert says(Planted("latitude_sign", ("latitude_deg = 34.25",)), said(folder))


@pytest.mark.slow
def test_without_a_kind_of_mistake_none_is_named(
    valid: dict[int, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The planted fault of these tests: a gate that does not look for the zero does not pass them."""
    seed = FIRST
    planted = planted_into(valid[seed], tmp_path / "campaign", "zero_of_table", seed)
    assert planted is not None
    assert says(planted, said(tmp_path / "campaign"))
    monkeypatch.setattr(TableZero, "suspected", classmethod(lambda cls, campaign, views: iter(())))
    assert not says(planted, said(tmp_path / "campaign"))


def test_a_remedy_is_a_line_to_write(valid: dict[int, Path], tmp_path: Path) -> None:
    """What the remedy says at the line that it names makes the campaign pass."""
    folder, seed = tmp_path / "campaign", FIRST
    planted = planted_into(valid[seed], folder, "elevation", seed)
    assert planted is not None
    (issue,) = inspect_campaign(folder).issues
    line = int(issue.where.split("campaign.toml:")[1].split(",")[0])
    remedy = issue.remedy.split("write ")[1].split(";")[0].split(",")[0]
    file = folder / "campaign.toml"
    lines = file.read_text(encoding="utf-8").splitlines()
    assert lines[line - 1].split(" = ")[0] == remedy.split(" = ")[0] == "elevation_deg"
    lines[line - 1] = remedy
    file.write_text("\n".join(lines), encoding="utf-8")
    assert not inspect_campaign(folder).issues


def test_an_accepted_finding_is_a_warning(valid: dict[int, Path], tmp_path: Path) -> None:
    folder = Path(shutil.copytree(valid[FIRST], tmp_path / "campaign"))
    plant(folder, "zero_of_table", 0)
    assert inspect_campaign(folder).campaign is None
    file = folder / "campaign.toml"
    file.write_text('accepted = ["table_zero"]\n' + file.read_text(encoding="utf-8"), encoding="utf-8")
    passed = inspect_campaign(folder)
    assert passed.campaign is not None
    assert gate(passed) == {"table_zero"}
    assert any("zero of the table angle" in note for note in passed.campaign.notes)


def test_the_noise_of_each_channel_is_what_its_outputs_show(valid: dict[int, Path]) -> None:
    """If rows repeat a position the noise that the outputs were drawn with is found, not the stated one."""
    (folder,) = (valid[seed] for seed in SEEDS if KINDS[seed % len(KINDS)] == "cycle")
    truth = tomllib.loads((folder / "truth.toml").read_text(encoding="utf-8"))["parameters"]
    drawn = folder / "drawn_noise.toml"
    stated = tomllib.loads(drawn.read_text(encoding="utf-8")) if drawn.exists() else {}
    campaign = load_campaign(folder)
    channels = [channel for channel in campaign.channels if channel.kind != "angle"]
    true = np.array([truth[f"white_noise.sigma[{c.name}]"] / stated.get(c.name, c.noise) for c in channels])
    assert np.ptp(true) > 1
    found = np.asarray(SteadinessLevels(campaign).shown.noise)
    np.testing.assert_allclose(found, true, rtol=0.4)


def test_a_tumble_does_not_tell_a_mistake_from_offsets_of_runs(valid: dict[int, Path], tmp_path: Path) -> None:
    """A reversed gyro is a warning: the law of what the files state does not detect it, that of the draw does."""
    seed = next(seed for seed in SEEDS if KINDS[seed % len(KINDS)] == "polar-tumble")
    folder = tmp_path / "reversed"
    planted = planted_into(valid[seed], folder, "axis_reversed", seed)
    assert planted is not None
    assert chi_square(folder) - chi_square(valid[seed]) > DETECTABLE
    assert chi_square(folder, STATED) - chi_square(valid[seed], STATED) < DETECTABLE
    passed = inspect_campaign(folder)
    assert passed.campaign is not None
    (finding,) = (each for each in passed.findings if each.name in SETUP_FINDINGS)
    assert "do not distinguish it from a bias that changes from run to run" in str(finding)
    # The planted fault: were offsets of runs known to be small, the law of what the files state would detect it.
    steady = replace(STATED, offsets={"gyro": STATED.offsets["gyro"] / 100}) if STATED.offsets else STATED
    assert chi_square(folder, steady) - chi_square(valid[seed], steady) > DETECTABLE


def test_noise_is_no_mistaken_unit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Outputs of a thousand times the stated noise would have less of it in a larger unit."""
    folder = Path(shutil.copytree(DATA / "polar-tumble", tmp_path / "noisy"))
    files, generator = Files(folder), np.random.default_rng(20261124)

    def shake(columns: dict[str, list[str]]) -> None:
        rows = zip(columns["g"], columns["samples"], strict=True)
        columns["g"] = [f"{float(g) + 0.5 * generator.normal() / float(n) ** 0.5:.6f}" for g, n in rows]

    for run in files.runs:
        files.edit(run, shake)
    assert gate(inspect_campaign(folder)) <= {"setup_disagrees"}
    monkeypatch.setattr(Search, "passes_for_noise", lambda self, mistake: False)
    assert "channel_unit" in gate(inspect_campaign(folder))


def test_an_angle_is_said_as_exactly_as_the_mountings_tell_it(valid: dict[int, Path], tmp_path: Path) -> None:
    """The zero of a table whose mountings may all be turned by a degree is no better known than they are."""
    known: list[float] = []
    for arcmin in (1.0, 60.0):
        folder = tmp_path / f"{arcmin:g}"
        shutil.copytree(valid[FIRST], folder)
        files = Files(folder)
        for mounting in files.document["mounting"]:
            mounting["uncertainty_arcmin"] = arcmin
        files.save()
        planted = plant(folder, "zero_of_table", FIRST)
        assert planted is not None
        text = said(folder)
        shown = re.search(r"zero of the table angle is off by [+-][\d.]+ deg \(± ([\d.]+) deg\)", text)
        known.append(float(shown[1]) if shown else 0.0)
        assert says(planted, text, known[-1])
    seats = len({run["mounting"] for run in Files(valid[FIRST]).of("dividing_head")})
    assert known[0] < 0.15
    # The gate takes mountings for twice as uncertain as they are stated.
    np.testing.assert_allclose(known[1], 2 / seats**0.5, rtol=0.5)


def test_every_kind_has_a_meaning() -> None:
    assert set(SETUP_FINDINGS) <= set(FINDINGS)


def test_an_unknown_name_is_no_finding_to_accept(valid: dict[int, Path], tmp_path: Path) -> None:
    folder = Path(shutil.copytree(valid[FIRST], tmp_path / "campaign"))
    file = folder / "campaign.toml"
    file.write_text('accepted = ["table_zer"]\n' + file.read_text(encoding="utf-8"), encoding="utf-8")
    with pytest.raises(InputError, match="table_zero"):
        raise InputError(inspect_campaign(folder).issues)


def test_a_scale_that_is_stated_twice_as_large_is_a_line_to_write(valid: dict[int, Path], tmp_path: Path) -> None:
    folder = Path(shutil.copytree(valid[FIRST], tmp_path / "campaign"))
    files = Files(folder)
    channel = next(each for each in files.document["channel"] if each["kind"] == "accelerometer")
    right = float(channel["scale"])
    channel["scale"] = 2 * right
    files.save()
    text = said(folder)
    assert "times its nominal scale" in text
    remedy = re.search(rf"write scale = ([\d.e+-]+) for '{channel['name']}'", text)
    assert remedy is not None
    np.testing.assert_allclose(float(remedy[1]), right, rtol=0.03)
