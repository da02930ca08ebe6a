"""No rest that was still is excluded; one that was not is, if there are degrees of freedom for it."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tumble_files import HZ, channels
from tumble_recordings import GRAVITY, Recording, random_attitudes, six_faces_and_turns

from imubayes.campaign.reduction import magnitude_calibration
from imubayes.campaign.reduction.free_tumble import ReducedTumble, reduce_tumble
from imubayes.campaign.reduction.magnitude_calibration import LEAST_TO_JUDGE, fit_magnitude
from imubayes.campaign.reduction.static_poses import rotation_over


def reduced(made: Recording, columns: dict[str, np.ndarray] | None = None) -> ReducedTumble:
    return reduce_tumble(columns or made.columns(), channels(), GRAVITY, None, "log.csv")


def excluded(rests: int, seeds: range) -> list[int]:
    """Return the number of rests excluded from each recording; all rests must have been found."""
    found = [reduced(random_attitudes(1000 * rests + seed, rests)).tumble.flagged for seed in seeds]
    assert [len(flagged) for flagged in found] == [rests] * len(seeds)
    return [int(flagged.sum()) for flagged in found]


@pytest.mark.parametrize("rests", [*(pytest.param(rests, marks=pytest.mark.slow) for rests in (8, 9)), 10])
def test_no_still_rest_of_few_is_excluded(rests: int) -> None:
    assert sum(excluded(rests, range(14))) == 0


@pytest.mark.parametrize("rests", [12, *(pytest.param(rests, marks=pytest.mark.slow) for rests in (13, 16))])
def test_no_still_rest_of_just_enough_is_excluded(monkeypatch: pytest.MonkeyPatch, rests: int) -> None:
    assert sum(excluded(rests, range(8))) == 0
    # Fault planted: a level at which anything is excluded.
    monkeypatch.setattr(magnitude_calibration, "FALSE_ALARM", 20.0)
    assert sum(excluded(rests, range(4))) > 0


def magnitudes(poses: int, disturbed: dict[int, float], seed: int) -> np.ndarray:
    """Return mean forces, shape (poses, 3), with a scatter of 1 mm/s² and errors of scale, axes and offset."""
    rng = np.random.default_rng(seed)
    force = GRAVITY * Rotation.random(poses, rng=rng).apply([0, 0, 1.0])
    for pose, amount in disturbed.items():
        force[pose] *= 1 + amount / GRAVITY
    skew = np.diag(rng.normal(1, 0.01, 3)) + np.tril(rng.normal(0, 0.005, (3, 3)), -1)
    return force @ skew.T + rng.normal(0, 0.2, 3) + rng.normal(0, 1e-3, force.shape)


@pytest.mark.parametrize(
    ("poses", "disturbed"),
    [(16, {4: 0.5}), (20, {4: 0.05}), (24, {3: 0.2, 11: -0.1, 12: 0.1}), (40, dict.fromkeys(range(0, 40, 10), 0.3))],
)
def test_disturbed_rests_are_excluded(poses: int, disturbed: dict[int, float]) -> None:
    for seed in range(10):
        found = np.flatnonzero(fit_magnitude(magnitudes(poses, disturbed, seed), GRAVITY, 1e-3).outliers)
        assert list(found) == list(disturbed), seed
        # Whatever the others say, no rest is excluded for less than the scatter within.
        assert not fit_magnitude(magnitudes(poses, {4: 0.05}, seed), GRAVITY, 0.05).outliers.any()


def test_an_accelerated_rest_is_excluded_from_a_recording() -> None:
    for seed in range(3):
        result = reduced(random_attitudes(500 + seed, 18, acceleration=(0.3, 0.3, 0.3)))
        assert list(np.flatnonzero(result.tumble.flagged)) == [9]
        assert "excluded as disturbed: |f| − g" in result.notes[-1]


def test_with_few_rests_it_is_said_that_none_is_judged() -> None:
    [note] = [note for note in reduced(random_attitudes(1, 9)).notes if "too few" in note]
    assert note.startswith("too few poses (9)")
    assert f"{LEAST_TO_JUDGE} are needed" in note


@pytest.mark.parametrize("seconds", [3.0, 6.0, 12.0])
def test_full_turns_are_transitions(seconds: float) -> None:
    """The accelerometers do not see the last turn, about the vertical, and no change of attitude by any."""
    result = reduced(six_faces_and_turns(2, seconds))
    tumble = result.tumble
    assert len(tumble.flagged) == 10
    assert not tumble.flagged.any()
    assert list(zip(tumble.start, tumble.stop, strict=True)) == [(k, k + 1) for k in range(9)]
    bias = np.mean([result.numbers[f"g{axis}"] for axis in "xyz"], axis=1)
    for axis, index in enumerate((6, 7, 8)):
        step, rate = tumble.step[index], tumble.readings[index][:, 3:] - bias
        assert rate[:, axis] @ step == pytest.approx(2 * np.pi, rel=0.03)
        turned = Rotation.from_matrix(rotation_over(rate, step, tumble.coning[index])).magnitude()
        assert turned < 0.03 * 2 * np.pi


def test_a_first_turn_about_the_vertical_ends_the_initial_rest() -> None:
    made = Recording(5, Rotation.identity())
    made.turn(np.array([0.0, 0.0, 2 * np.pi]), 5.0)
    made.rest()
    for _ in range(7):
        made.to(Rotation.random(rng=made.rng))
        made.rest()
    columns = made.columns(errors=False)
    result = reduced(made, columns)
    assert len(result.tumble.flagged) == 9
    assert not result.tumble.flagged.any()
    assert "first 11." in result.notes[0]
    assert np.abs(result.numbers["gz"]).max() < 3e-4


def test_a_drift_of_the_bias_is_no_rotation() -> None:
    made = Recording(6, first=250.0)
    for _ in range(8):
        made.to(Rotation.random(rng=made.rng))
        made.rest()
    columns = made.columns()
    columns["gx"] += np.interp(columns["time_s"], [0, 250], [0, np.deg2rad(0.2)])
    assert not reduced(made, columns).tumble.flagged.any()
    # The same rotation within a second is one: a twist about the vertical, which the accelerometers do not see.
    start, spell = round(100 * HZ), round(HZ)
    columns["gz"][start : start + spell] += np.deg2rad(8.0)
    assert list(np.flatnonzero(reduced(made, columns).tumble.flagged)) == [0]


@pytest.mark.parametrize(("poses", "disturbed"), [(40, 2), (300, 3), (3000, 30), (3000, 0)])
def test_disturbed_poses_are_told_among_any_number(poses: int, disturbed: int) -> None:
    random = np.random.default_rng(poses)
    force = random.normal(size=(poses, 3))
    force *= GRAVITY / np.linalg.norm(force, axis=1, keepdims=True)
    force = force * [1.003, 0.998, 1.001] + [0.2, -0.1, 0.15] + random.normal(0, 0.01, force.shape)
    wrong = random.choice(poses, disturbed, replace=False)
    force[wrong] *= 1.05
    found = fit_magnitude(force, GRAVITY, 0.01)
    assert np.flatnonzero(found.outliers).tolist() == sorted(wrong.tolist())
    np.testing.assert_allclose(found.offset, [0.2, -0.1, 0.15], atol=0.05 / np.sqrt(poses))
