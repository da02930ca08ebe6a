"""How probable each explanation is, in words."""

import pytest

from display.made_diagnoses import evidence, slot
from imubayes.criticism.explanation_records import FoundForm, FoundNoise
from imubayes.display.loop.diagnosis_sentences import evidence_text, likely, noise_text, probability


def test_effects_that_cannot_be_told_apart_have_their_shares() -> None:
    shared = slot(("gyro_scale_asymmetry", 0.537), ("gyro_scale_quadratic", 0.463))
    said = evidence_text(evidence({"effects": 0.998}, (shared,), known=0.5))
    assert said == (
        "Probability: an effect missing 0.998 (gyro_scale_asymmetry or gyro_scale_quadratic on gx, shares 0.54, 0.46); "
        "nothing missing < 0.001. The noise is known beforehand only to within a factor of 1.6."
    )


def test_nothing_missing_is_told_with_the_nearest_effect() -> None:
    said = evidence_text(evidence({"nothing": 0.95, "effects": 0.05}))
    assert said.startswith("Probability: nothing missing 0.95; an effect missing 0.05 (accel_cubic 0.04).")
    assert said.endswith("prior odds of 7 to 1 in favour of the second would reverse their order.")


def test_a_wrong_record_names_run_and_row_and_noise_its_channels() -> None:
    form = FoundForm(name="offset of table_angle", channels=("ax",), run="A1", row=10, log_odds=80.0, wrong=True)
    noise = (FoundNoise(channels=("az",), family="tails", scale=1.2),)
    said = evidence_text(evidence({"input": 0.99, "noise": 0.01}, (), form, noise))
    assert (
        "a wrong record or prior 0.990 (offset of table_angle on ax in run A1, row 10, beside heavy tails on az)"
        in said
    )
    assert "other noise 0.01;" in said
    said = evidence_text(evidence({"input": 0.01, "noise": 0.99}, (), form, noise))
    assert "other noise 0.990 (heavy tails on az)" in said
    assert "a wrong record or prior 0.01 (offset of table_angle on ax in run A1, row 10)" in said


def test_effects_beside_a_cause_outside_the_catalogue_are_named() -> None:
    form = FoundForm(name="function of temperature_degC", channels=("ax",), log_odds=80.0)
    said = evidence_text(evidence({"outside": 1.0}, (slot(("accel_bias_temperature", 1.0)),), form))
    assert "(function of temperature_degC on ax, beside accel_bias_temperature on gx)" in said


@pytest.mark.parametrize(("value", "shown"), [(1.0, "> 0.999"), (0.0, "< 0.001"), (0.998, "0.998"), (0.5, "0.50")])
def test_a_probability_is_never_nought_or_one(value: float, shown: str) -> None:
    assert probability(value) == shown


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (0.95, ("", "")),
        (0.62, (" probably", " (probability 0.62)")),
        (0.42, (" possibly", " (probability 0.42)")),
    ],
)
def test_doubt_is_told_with_its_probability(value: float, said: tuple[str, str]) -> None:
    assert likely(value) == said


def test_noise_of_another_size_has_its_factor() -> None:
    noise = (
        FoundNoise(channels=("gx", "gy"), family="scale", scale=2.74),
        FoundNoise(channels=("ax",), family="runs", scale=1.0),
    )
    assert noise_text(noise) == "white noise on gx, gy 2.7 times as large as known, scatter between runs on ax"
