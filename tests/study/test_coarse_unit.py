"""Coarse units: what is diagnosed is reached by the refit whatever the grade; turns beyond the range are left out."""

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import numpy as np
import polars
import pytest

from imubayes.api import fit
from imubayes.campaign import load_campaign
from imubayes.criticism.diagnose import judge
from imubayes.inference.plausibility import PriorConflict, prior_conflicts
from imubayes.inference.posterior_mode import find_mode
from imubayes.loop.warm_start import extend
from imubayes.model.bind import bind

sys.path.insert(0, str(Path(__file__).parent))
import blind
import desk_imu
import hidden
from random_plans import random_plan
from simulate import write_simulated

from imubayes.inference.nested_laplace import posterior_precision

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Case:
    """An effect of a coarse unit: coefficients, size in their unit, noise of a sample in pulse/s at 1000 per deg/s."""

    effect: str
    fields: tuple[str, ...]
    size: float
    noise: float


CASES = (
    Case("gyro_scale_cubic", ("cubic",), 0.08, 1500.0),
    Case("gyro_magnetic_sensitivity", ("m_i", "m_o", "m_s"), 400.0, 300.0),
)
"""Sixteen and twenty times the standard deviation of the default prior."""


@dataclass(frozen=True)
class Outcome:
    """What became of a hidden cubic term.

    Attributes
    ----------
    first : effects of the first group of the diagnosis.
    widened : priors widened for the refit.
    z : (mode − truth)/sd of the refit.
    conflicts : priors that disagree with the data after the refit.
    pinned : the same if the default prior is kept.
    """

    first: tuple[str, ...]
    widened: dict[str, str]
    z: np.ndarray
    conflicts: tuple[PriorConflict, ...]
    pinned: tuple[PriorConflict, ...]


def outcome(folder: Path, seed: int, grade: str, case: Case) -> Outcome:
    """Plant an effect into coarse gyros on a rate table of a unit of some stated grade; diagnose and refit."""
    rng = np.random.default_rng(seed)
    plan = random_plan("table", rng, folder / "model.toml")
    coarse = tuple(replace(one, noise=case.noise) if one.kind == "gyro" else one for one in plan.channels)
    plan = replace(plan, channels=coarse)
    folder.mkdir(parents=True)
    (folder / "model.toml").write_text(hidden.without("hidden-effects", [case.effect]), encoding="utf-8")
    gyros = [channel.name for channel in coarse if channel.kind == "gyro"]
    names = [f"{case.effect}.{field}[{name}]" for name in gyros for field in case.fields]
    truth = {name: case.size * rng.choice([-1, 1]) * rng.uniform(0.7, 1.5) for name in names}
    write_simulated(folder, plan, seed, values=plan.draw(seed) | truth)
    file = folder / "campaign.toml"
    file.write_text(file.read_text().replace("[unit]\n", f'[unit]\ngrade = "{grade}"\n', 1))
    before = blind.mode_of(folder, folder / "model.toml")
    found = judge(before)
    line = found.estimate(case.effect)
    extension = extend(before, [case.effect], estimates=line.coefficients if line is not None else ())
    z, conflicts = refitted(extension.model, extension.z, extension.h, truth)
    spec = extension.model.spec
    default = replace(spec, effects=(*spec.effects[:-1], replace(spec.effects[-1], prior={})))
    _, pinned = refitted(bind(default, extension.model.campaign), extension.null, extension.h, truth)
    first = found.groups[0].effects if found.groups else ()
    return Outcome(first, dict(extension.widened), z, conflicts, pinned)


def refitted(model, z, h, truth) -> tuple[np.ndarray, tuple[PriorConflict, ...]]:
    mode = find_mode(model.problem, jax.numpy.asarray(z), jax.numpy.asarray(h))
    precision = np.asarray(jax.jit(posterior_precision)(model.problem, mode))
    sd, at = np.sqrt(np.diag(np.linalg.inv(precision))), np.asarray(mode.z)
    new = [(place, one) for place, one in enumerate(model.layout.parameters) if one.name in truth]
    scores = np.array([(at[place] - one.z_at(truth[one.name])) / sd[place] for place, one in new])
    named = tuple(each for each in prior_conflicts(model, at, precision) if each.name in truth)
    return scores, named


@pytest.mark.slow
@pytest.mark.parametrize("grade", ["navigation", "consumer"])
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.effect)
def test_what_is_diagnosed_is_reached(tmp_path, grade, case):
    found = [outcome(tmp_path / str(seed), seed, grade, case) for seed in range(200, 220)]
    z = np.concatenate([each.z for each in found])
    right = sum(case.effect in each.first for each in found)
    widened, pinned = (sum(bool(getattr(each, name)) for each in found) for name in ("widened", "pinned"))
    print(
        f"{case.effect}, {grade}: right first {right}, widened {widened}, "
        f"prior named where it is kept {pinned}, of {len(found)}; "
        f"rms z {np.sqrt(np.mean(z**2)):.2f}, largest |z| {np.abs(z).max():.2f}"
    )
    assert not any(each.conflicts for each in found)
    assert widened == pinned == (len(found) if grade == "navigation" else 0)
    assert np.sqrt(np.mean(z**2)) < 1.3
    assert np.abs(z).max() < 4


@pytest.mark.slow
def test_turns_beyond_the_range_are_left_out(tmp_path):
    """The fastest turns are clipped: the fit of the others is as good as that of a unit with range to spare."""
    z, left_out = [], 0
    for seed in range(300, 320):
        whole, folder = tmp_path / f"{seed}-whole", tmp_path / str(seed)
        desk_imu.generate(whole, seed)
        rates = polars.read_parquet(whole / "runs" / "tumble.parquet").select("gx", "gy", "gz").to_numpy()
        limit = round(0.9 * float(np.abs(rates).max()), 4)
        truth = desk_imu.generate(folder, seed, full_scale={"gyro": limit})
        run = load_campaign(folder).runs[0]
        left_out += any("transitions left out" in note for note in run.notes)
        result = fit(folder, ROOT / "models" / "desk-imu.toml", sample=False)
        assert result.summary.converged
        gyros = [one for one in result.summary.parameters if one.name in truth and one.name.startswith("gyro_")]
        z += [(one.mean - truth[one.name]) / one.sd for one in gyros]
    rms, largest = np.sqrt(np.mean(np.square(z))), np.abs(z).max()
    print(f"left out in {left_out} of 20; rms z {rms:.2f}, largest |z| {largest:.2f}")
    assert left_out == 20
    assert rms < 1.2
    assert largest < 4.5
