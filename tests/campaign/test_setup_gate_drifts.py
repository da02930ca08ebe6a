"""Effects that are missing are no mistakes of the set-up: drifts, curves over temperature, dead zones."""

from pathlib import Path

import pytest
from hidden import random_campaign
from seeded_mistakes import plant, says
from valid_campaigns import KINDS, valid_campaign

from imubayes.campaign import Inspection, inspect_campaign
from imubayes.campaign.setup_gate.evidence import ErrorModel
from imubayes.campaign.setup_gate.judgement import SETUP_FINDINGS
from imubayes.campaign.setup_gate.reading_mistakes import LatitudeValue
from imubayes.campaign.setup_gate.search import Search

COURSES = (("gyro_thermal_lag", 8006), ("accel_bias_temperature_rate", 8009), ("accel_thermal_lag", 8010))
"""Effects that follow the temperature late, each with the seed of a static record."""
_CYCLE = next(seed for seed in range(7000, 8000) if KINDS[seed % len(KINDS)] == "cycle")


def gate(inspection: Inspection) -> set[str]:
    return {finding.name for finding in inspection.findings} & {*SETUP_FINDINGS, "setup_disagrees"}


@pytest.mark.parametrize(
    ("effect", "seed"), [COURSES[0], *(pytest.param(*each, marks=pytest.mark.slow) for each in COURSES[1:])]
)
def test_a_bias_that_follows_late_is_no_reversed_column(
    tmp_path: Path, effect: str, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    random_campaign(tmp_path / "record", seed, "hidden", "static_record", effect)
    assert not gate(inspect_campaign(tmp_path / "record"))
    # The planted fault: a gate to which no drift is a rival.
    monkeypatch.setattr(Search, "with_drift", lambda self, mistake: (float("inf"), 0.0))
    assert gate(inspect_campaign(tmp_path / "record")) == {"temperature_reversed"}


def test_a_reversed_column_is_named_where_a_ramp_goes_up_and_down(tmp_path: Path) -> None:
    valid_campaign(tmp_path / "cycle", _CYCLE)
    planted = plant(tmp_path / "cycle", "temperature_reversed", _CYCLE)
    assert planted is not None
    inspection = inspect_campaign(tmp_path / "cycle")
    assert says(planted, " ".join(map(str, (*inspection.issues, *inspection.findings))))


@pytest.mark.parametrize(
    ("seed", "effect"),
    [
        pytest.param(160040, "converter_offset_drift_quadratic", marks=pytest.mark.slow),
        pytest.param(150005, "converter_leakage", marks=pytest.mark.slow),
    ],
)
def test_a_curve_of_the_converter_is_no_exchange_of_thermometers(
    tmp_path: Path, seed: int, effect: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = random_campaign(tmp_path / "ramp", seed, "hidden", "thermal_ramp")
    assert [each.effect for each in drawn.planted] == [effect]
    assert not gate(inspect_campaign(tmp_path / "ramp"))
    # The planted fault: only the temperature of the sensor bends the bias.
    curved = ErrorModel._design

    def straight(self, view, *others):
        design = curved(self, view, *others)
        design[..., 11] = 0.0
        return design

    monkeypatch.setattr(ErrorModel, "_design", straight)
    assert gate(inspect_campaign(tmp_path / "ramp")) == {"thermometers_exchanged"}


@pytest.mark.slow
def test_a_dead_zone_that_swallows_the_earth_rate_is_no_latitude(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = random_campaign(tmp_path / "zone", 310009, "large")
    assert [each.effect for each in drawn.planted] == ["gyro_dead_zone"]
    assert not gate(inspect_campaign(tmp_path / "zone"))
    # The planted fault: a gate to which a latitude may lie beyond the poles.
    monkeypatch.setattr(LatitudeValue, "possible", lambda self, size: True)
    assert gate(inspect_campaign(tmp_path / "zone")) == {"latitude_value"}
