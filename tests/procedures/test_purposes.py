"""The effects that a procedure is made for are in the first model of its runs, if determined, and that model fits."""

import shutil
from pathlib import Path

import pytest

import imubayes
from imubayes.model.effect_registry import Registry
from imubayes.procedures import PROCEDURES

DATA = Path(__file__).parents[2] / "data"


@pytest.mark.parametrize("procedure", PROCEDURES.values(), ids=lambda each: each.name)
def test_purposes_are_effects_of_the_catalogue(procedure) -> None:
    assert set(procedure.purposes) <= set(Registry().effects)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("polar-tumble", {"gyro_g_sensitivity", "gyro_g2_sensitivity"}),
        pytest.param("geographic-tumble", {"gyro_g_sensitivity", "gyro_g2_sensitivity"}, marks=pytest.mark.slow),
        pytest.param(
            "centrifuge",
            {"lever_arm", "accel_quadratic", "accel_cubic", "gyro_g2_sensitivity"},
            marks=pytest.mark.slow,
        ),
    ],
)
def test_the_first_model_of_a_procedure_has_what_it_is_for_and_fits(tmp_path: Path, name: str, expected) -> None:
    shutil.copytree(DATA / name, tmp_path / name)
    made = imubayes.new(tmp_path / name)
    assert expected <= {each.spec.name for each in made.proposal.effects}
    fitted = imubayes.fit(tmp_path / name, made.model, sample=False)
    assert fitted.converged
    # χ² at the noise known beforehand: without the effect the noise would be several times as large.
    quality = fitted.summary.known_noise
    assert quality is not None
    assert quality.chi2 < 1.6 * quality.dof
