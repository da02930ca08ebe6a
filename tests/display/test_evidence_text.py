"""How probable each explanation is, in words."""

import pytest

from imubayes.criticism.evidence.evidence_record import (
    EffectSlot,
    Evidence,
    Explanation,
    FoundForm,
    FoundNoise,
    ProbableEffect,
    ProbableExplanation,
)
from imubayes.display.evidence_text import evidence_text, probability

KINDS: tuple[Explanation, ...] = ("nothing", "noise", "effects", "input", "outside")


def slot(*names: tuple[str, float]) -> EffectSlot:
    candidates = tuple(ProbableEffect(effect=name, channels=("gx",), probability=p) for name, p in names)
    return EffectSlot(candidates=candidates, channels=("gx",), gain=6.6, coefficients=(), shape={})


def evidence(
    shares: dict[Explanation, float],
    slots: tuple[EffectSlot, ...] = (),
    form: FoundForm | None = None,
    noise: tuple[FoundNoise, ...] = (),
    known: float = 0.03,
) -> Evidence:
    explanations = tuple(
        ProbableExplanation(kind=kind, probability=shares.get(kind, 0.0), log_odds=0.0 if kind in shares else -20.0)
        for kind in KINDS
    )
    inclusion = (ProbableEffect(effect="accel_cubic", channels=("ax",), probability=0.04),)
    return Evidence(
        explanations=explanations, slots=slots, inclusion=inclusion, form=form, noise=noise, noise_known=known,
        hypotheses=100,
    )  # fmt: skip


def test_effects_that_cannot_be_told_apart_have_their_shares() -> None:
    shared = slot(("gyro_scale_asymmetry", 0.537), ("gyro_scale_quadratic", 0.463))
    said = evidence_text(evidence({"effects": 0.998}, (shared,), known=0.5))
    assert said == (
        "Probability: an effect missing 0.998 (gyro_scale_asymmetry 0.54 or gyro_scale_quadratic 0.46 on gx); nothing "
        "missing < 0.001. No raw samples tell the noise: it is taken to be known to 65 %."
    )


def test_nothing_missing_is_told_with_the_nearest_effect() -> None:
    said = evidence_text(evidence({"nothing": 0.95, "effects": 0.05}))
    assert said.startswith("Probability: nothing missing 0.95; an effect missing 0.05 (accel_cubic 0.04).")
    assert said.endswith("Prior odds of 7 to 1 would change which is likeliest.")


def test_a_wrong_record_names_run_and_row_and_noise_its_channels() -> None:
    form = FoundForm(name="offset of table_angle", channels=("ax",), run="A1", row=10, log_odds=80.0, wrong=True)
    noise = (FoundNoise(channels=("az",), family="tails", scale=1.2),)
    said = evidence_text(evidence({"input": 0.99, "noise": 0.01}, (), form, noise))
    assert "a wrong record 0.990 (offset of table_angle on ax in run A1, row 10)" in said
    assert "noise not as stated 0.01 (heavy tails on az)" in said


def test_effects_beside_a_cause_outside_the_catalogue_are_named() -> None:
    form = FoundForm(name="function of temperature_degC", channels=("ax",), log_odds=80.0)
    said = evidence_text(evidence({"outside": 1.0}, (slot(("accel_bias_temperature", 1.0)),), form))
    assert "(function of temperature_degC on ax, beside accel_bias_temperature on gx)" in said


@pytest.mark.parametrize(("value", "shown"), [(1.0, "> 0.999"), (0.0, "< 0.001"), (0.998, "0.998"), (0.5, "0.50")])
def test_a_probability_is_never_nought_or_one(value: float, shown: str) -> None:
    assert probability(value) == shown
