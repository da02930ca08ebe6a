"""A low-cost unit turned by hand: what is diagnosed is reached by a refit; turns beyond the range are left out."""

import sys
from pathlib import Path

import numpy as np
import polars
import pytest

from imubayes.api import add, diagnose, fit
from imubayes.campaign import load_campaign

sys.path.insert(0, str(Path(__file__).parents[2] / "data" / "generators"))
import desk_imu  # pyright: ignore[reportMissingImports]

ROOT = Path(__file__).parents[2]
MODEL = ROOT / "models" / "desk-imu.toml"


def cubic_of(seed: int) -> dict[str, float]:
    """Return true cubic scale factor terms of some ppm/(deg/s)², a hundred times those of a navigation-grade gyro."""
    rng = np.random.default_rng(seed)
    return {
        f"gyro_scale_cubic.cubic[g{axis}]": float(1.3 * rng.choice([-1, 1]) * rng.uniform(0.7, 1.5)) for axis in "xyz"
    }


def declared(folder: Path, grade: str) -> None:
    """State the grade of the unit in its campaign file."""
    file = folder / "campaign.toml"
    file.write_text(file.read_text().replace("[unit]\n", f'[unit]\ngrade = "{grade}"\n', 1))


@pytest.mark.slow
@pytest.mark.parametrize("grade", ["", "navigation"])
def test_a_cubic_term_of_a_coarse_unit_is_reached(tmp_path, grade):
    """By the prior of the grade that the noise tells; and past the prior of a grade that is stated wrongly."""
    scores, right = [], 0
    for seed in range(200, 220):
        truth = cubic_of(seed)
        folder = tmp_path / str(seed)
        desk_imu.generate(folder, seed, truth)
        if grade:
            declared(folder, grade)
        first = fit(folder, MODEL, sample=False)
        found = diagnose(first)
        right += bool(found.groups) and "gyro_scale_cubic" in found.groups[0].effects
        addition = add(first, ["gyro_scale_cubic"], diagnosis=found)
        assert addition.taken
        assert not addition.prior_conflicts
        assert bool(addition.widened) == bool(grade)
        scores += [(one.value - truth[one.name]) / one.sd for one in addition.observed.coefficients]
    print(
        f"grade {grade or 'derived'}: right {right} of 20, "
        f"rms z {np.sqrt(np.mean(np.square(scores))):.2f}, largest {np.abs(scores).max():.2f}"
    )
    assert np.sqrt(np.mean(np.square(scores))) < 1.3
    assert np.abs(scores).max() < 4


@pytest.mark.slow
def test_turns_beyond_the_range_are_left_out(tmp_path):
    """The fastest turns are clipped: the fit of the others is as good as that of a unit with range to spare."""
    scores, left_out = [], 0
    for seed in range(300, 320):
        whole = tmp_path / f"{seed}-whole"
        desk_imu.generate(whole, seed)
        rates = polars.read_parquet(whole / "runs" / "tumble.parquet").select("gx", "gy", "gz").to_numpy()
        limit = round(0.9 * float(np.abs(rates).max()), 4)
        folder = tmp_path / str(seed)
        truth = desk_imu.generate(folder, seed, full_scale={"gyro": limit})
        run = load_campaign(folder).runs[0]
        left_out += sum("transitions left out" in note for note in run.notes)
        assert len(run.tumble.start) < len(load_campaign(whole).runs[0].tumble.start)
        result = fit(folder, MODEL, sample=False)
        assert result.summary.converged
        scores += [
            (one.mean - truth[one.name]) / one.sd
            for one in result.summary.parameters
            if one.name in truth and one.name.startswith("gyro_") and not one.nuisance
        ]
    print(f"notes {left_out}, rms z {np.sqrt(np.mean(np.square(scores))):.2f}, largest {np.abs(scores).max():.2f}")
    assert left_out >= 20
    assert np.sqrt(np.mean(np.square(scores))) < 1.25
    assert np.abs(scores).max() < 4.5
