"""Mistakes in a set-up are named with their remedy before any fit, and valid campaigns pass."""

import shutil
from pathlib import Path

import pytest
from seeded_mistakes import MISTAKES, Planted, plant, says, valid_campaign

from imubayes.campaign import FINDINGS, Inspection, inspect_campaign
from imubayes.campaign.setup_gate.mistakes import MISTAKES as REGISTERED
from imubayes.errors import InputError

DATA = Path(__file__).parents[2] / "data"
SHIPPED = sorted(file.parent.name for file in DATA.glob("*/campaign.toml"))
SEEDS = (0, 2, 4, 8, 10)


@pytest.fixture(scope="module")
def valid(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    """Valid campaigns drawn at random, by seed."""
    folders = {seed: tmp_path_factory.mktemp("valid") / str(seed) for seed in SEEDS}
    for seed, folder in folders.items():
        valid_campaign(folder, seed)
    return folders


def gate(inspection: Inspection) -> set[str]:
    kinds = {kind.kind for kind in REGISTERED} | {"setup_disagrees"}
    return {finding.name for finding in inspection.findings} & kinds


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_campaigns_pass(name: str) -> None:
    assert not gate(inspect_campaign(DATA / name))


def test_drawn_campaigns_pass(valid: dict[int, Path]) -> None:
    for folder in valid.values():
        assert not gate(inspect_campaign(folder))


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", [name for name in MISTAKES if name != "latitude"])
def test_a_seeded_mistake_is_named(valid: dict[int, Path], tmp_path: Path, name: str, seed: int) -> None:
    folder = Path(shutil.copytree(valid[seed], tmp_path / "campaign"))
    planted = plant(folder, name, seed)
    if planted is None:
        return  # the template has no run or channel of this kind
    text = " ".join(str(issue) for issue in inspect_campaign(folder).issues)
    assert says(planted, text), text


def test_a_negated_latitude_is_named_where_the_gyros_show_it(tmp_path: Path) -> None:
    folder = Path(shutil.copytree(DATA / "trihedral-imu", tmp_path / "campaign"))
    file = folder / "campaign.toml"
    file.write_text(file.read_text(encoding="utf-8").replace("latitude_deg = 34.25", "latitude_deg = -34.25"))
    passed = inspect_campaign(folder)
    # Evidence that is worth a warning, not an error.
    assert not passed.issues
    (finding,) = passed.findings
    assert finding.severity == "warning"
    assert says(Planted("latitude_sign", ("latitude_deg to 34.25",)), str(finding))


def test_an_accepted_finding_is_a_warning(valid: dict[int, Path], tmp_path: Path) -> None:
    folder = Path(shutil.copytree(valid[0], tmp_path / "campaign"))
    plant(folder, "zero_of_table", 0)
    assert inspect_campaign(folder).campaign is None
    file = folder / "campaign.toml"
    file.write_text('accepted = ["table_zero"]\n' + file.read_text(encoding="utf-8"), encoding="utf-8")
    passed = inspect_campaign(folder)
    assert passed.campaign is not None
    assert gate(passed) == {"table_zero"}
    assert any("zero of the table angle" in note for note in passed.campaign.notes)


def test_every_kind_has_a_meaning() -> None:
    assert {kind.kind for kind in REGISTERED} <= set(FINDINGS)


def test_an_unknown_name_is_no_finding_to_accept(valid: dict[int, Path], tmp_path: Path) -> None:
    folder = Path(shutil.copytree(valid[0], tmp_path / "campaign"))
    file = folder / "campaign.toml"
    file.write_text('accepted = ["table_zer"]\n' + file.read_text(encoding="utf-8"), encoding="utf-8")
    with pytest.raises(InputError, match="table_zero"):
        raise InputError(inspect_campaign(folder).issues)


@pytest.mark.slow
def test_a_thousand_seeded_mistakes(tmp_path: Path) -> None:
    """Of 1000 mistakes 99 % are named with their remedy; of the valid campaigns among them at most 0.5 % are doubted.

    The sign of a latitude counts where its effect exceeds what the gyros' errors conceal: see the test above.
    """
    named, made, doubted, seed = 0, 0, 0, 1000
    missed = []
    while made < 1000:
        folder = tmp_path / str(seed)
        valid_campaign(folder, seed)
        doubted += bool(gate(inspect_campaign(folder)))
        for name in MISTAKES:
            wrong = tmp_path / f"{seed}-{name}"
            shutil.copytree(folder, wrong)
            planted = None if name == "latitude" else plant(wrong, name, seed)
            if planted is not None:
                found = says(planted, " ".join(str(issue) for issue in inspect_campaign(wrong).issues))
                named, made = named + found, made + 1
                missed += [] if found else [f"{name} of seed {seed}"]
            shutil.rmtree(wrong)
        shutil.rmtree(folder)
        seed += 1
    assert doubted <= 0.005 * (seed - 1000)
    assert named >= 0.99 * made, missed
