"""`imubayes capture --motion`: which motion is made, what is wrong with it, and what its campaign determines."""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import imubayes
from imubayes.cli.main import run
from imubayes_recordings.convert.proposed_effects import EffectProposal, ExpectedUncertainty
from imubayes_recordings.display.capture_lines import now_line, plan_lines, rest_line
from imubayes_recordings.guided_capture import Guidance, motion_steps
from imubayes_recordings.guided_capture.motion_steps import DrillSteps, WaveSteps
from imubayes_recordings.guided_capture.motion_watch import DrillWatch, WaveWatch
from imubayes_recordings.guided_capture.planned_motion import TURNS
from imubayes_recordings.guided_capture.steps import read_wanted

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))
from motion_recordings import GRAVITY, NAMES, drilled, random_unit, waved

HZ = 100.0
PIECE = 25


def turned(axis: int, rate: float, seconds: float, upright: bool = False, gain: float = 1.0) -> np.ndarray:
    """Return force and rate, (n, 6), of a perfect unit that turns about one axis; `gain` is that of its gyros."""
    time = np.arange(round(seconds * HZ)) / HZ
    values, others = np.zeros((len(time), 6)), [(axis + 1) % 3, (axis + 2) % 3]
    values[:, 3 + axis] = gain * rate
    if upright:
        values[:, axis] = GRAVITY
    else:
        values[:, others[0]] = GRAVITY * np.cos(rate * time)
        values[:, others[1]] = -GRAVITY * np.sin(rate * time)
    return values + np.random.default_rng(1).normal(0, 1e-3, values.shape)


def pieces(values: np.ndarray) -> list[np.ndarray]:
    return [values[first : first + PIECE] for first in range(0, len(values), PIECE)]


def faults(values: np.ndarray) -> set[str]:
    """Return what a watch finds wrong with a turn, in the order of its pieces."""
    watch, found = DrillWatch(1 / HZ, NAMES), set()
    for piece in pieces(values):
        watch.add(piece)
        found.add(watch.fault)
    return found - {""}


@pytest.mark.parametrize(("axis", "rate", "name"), [(0, 5.0, ("x", "forward")), (2, -4.0, ("z", "reverse"))])
def test_a_turn_is_named_and_counted_by_gyros_and_gravity(axis, rate, name) -> None:
    watch = DrillWatch(1 / HZ, NAMES)
    assert all(watch.add(piece) for piece in pieces(turned(axis, rate, 10.0)))
    assert watch.turn is not None
    assert watch.turn.name == name
    assert watch.turn.seconds == pytest.approx(10.0, abs=0.3)
    by_gyros, by_gravity, across = watch.turn.turns(1 / HZ)
    assert abs(by_gyros) == pytest.approx(abs(rate) * 10 / (2 * np.pi), rel=0.01)
    assert by_gravity == pytest.approx(by_gyros, rel=0.01)
    assert across == pytest.approx(1.0, abs=0.02)
    assert watch.fault == ""


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (turned(0, 5.0, 6.0, upright=True), "the axis is upright"),
        (turned(0, 1.0, 6.0), "57 deg/s is too slow"),
        (turned(0, 25.0, 6.0), "is too fast for the sampling rate: below 1146 deg/s"),
        (np.clip(turned(0, 6.0, 6.0), -50, 5.5), "gx at the end of its range"),
        (turned(0, 6.0, 12.0, gain=1.2), "the gyros count"),
    ],
)
def test_the_fault_of_a_turn_is_named(values, words) -> None:
    found = faults(values)
    assert len(found) > 0
    assert all(words in fault for fault in found if "count" not in fault or words == "the gyros count")
    assert not faults(turned(0, 5.0, 12.0))


def wave_of(columns: dict[str, np.ndarray]) -> WaveWatch:
    watch = WaveWatch(1 / HZ, GRAVITY, NAMES)
    for piece in pieces(np.stack([columns[name] for name in NAMES], axis=1)):
        watch.add(piece)
    return watch


@pytest.fixture(scope="module")
def unit():
    return random_unit(np.random.default_rng(3))


def test_waving_counts_its_seconds_and_its_faces(unit) -> None:
    watch = wave_of(waved(unit, 4, seconds=60.0))
    assert watch.seconds > 50.0
    assert len(watch.faces) == 6
    assert watch.missing() == ""


def test_a_unit_that_is_turned_about_one_axis_alone_lacks_the_others() -> None:
    values = turned(2, 0.6, 40.0)
    watch = wave_of(dict(zip(NAMES, values.T, strict=True)))
    assert watch.missing() == "point +z, −z up once"
    watch.faces |= {"+z", "−z"}
    assert watch.missing() == "turn it about other axes as well"


def test_a_unit_at_rest_does_not_count() -> None:
    watch = wave_of(dict(zip(NAMES, turned(2, 0.0, 10.0).T, strict=True)))
    assert watch.fault == "at rest: keep it moving"
    assert watch.seconds < 2.5


@pytest.mark.parametrize(
    ("values", "words"),
    [(turned(2, 4.0, 3.0), "too fast"), (1.5 * turned(2, 0.6, 3.0), "the hand accelerates by")],
)
def test_the_fault_of_waving_is_named(values, words) -> None:
    assert words in wave_of(dict(zip(NAMES, values.T, strict=True))).fault


@pytest.fixture
def known(monkeypatch):
    """A campaign that determines the scale factors of those gyros about whose axis its parts turned, to 200 ppm."""
    parts: list[str] = []

    def write(own, folder) -> None:
        parts[:] = list(own)

    def proposal(campaign) -> EffectProposal:
        told = {name[0] for name in parts}
        expected = [
            ExpectedUncertainty("gyro_scale_factor", f"g{axis}", 2e-4, "ppm", 1e-6, 1.0 if axis in told else 0.1)
            for axis in "xyz"
        ]
        return EffectProposal((), {}, {}, True, tuple(expected))

    monkeypatch.setattr(motion_steps, "load_campaign", lambda folder, judge_setup: None)
    monkeypatch.setattr(motion_steps, "propose_effects", proposal)
    return write


def drill_steps(write, *turns: np.ndarray) -> tuple[DrillSteps, list[Guidance]]:
    until = tuple(read_wanted(("gyro_scale_factor=0.1%",), GRAVITY))
    steps, seen = DrillSteps(DrillWatch(1 / HZ, NAMES), 6.0, until, write), []
    for values in turns:
        for piece in pieces(np.concatenate([values, turned(0, 0.0, 2.0)])):
            steps.add(piece, [f"{len(seen)}"] * len(piece))
            seen.append(steps.guide())
    return steps, seen


def test_turns_are_guided_axis_by_axis_until_all_gyros_are_determined(known) -> None:
    turns = [turned(axis, sense * 5.0, 7.0) for axis in range(3) for sense in (1, -1)]
    steps, seen = drill_steps(known, *turns)
    assert list(steps.parts) == ["-".join(turn) for turn in TURNS][: len(steps.parts)]
    assert steps.judge().state == "done"
    enough = [step for step in seen if step.state in ("enough", "done")]
    assert enough[0].ask == "turn it about x, reverse, the axis level"
    assert enough[0].open == ("gyro_scale_factor",)
    assert "turns by gravity" in rest_line(enough[0], steps._until)
    assert "undetermined: gyro_scale_factor" in rest_line(enough[0], steps._until)
    assert all(len(lines) >= 600 for lines in steps.parts.values())


def test_a_turn_that_stops_early_is_no_part(known) -> None:
    steps, seen = drill_steps(known, turned(0, 5.0, 4.0))
    assert steps.parts == {}
    assert "stopped after" in now_line(seen[-1])
    assert "turn it about x, forward" in now_line(seen[-1])


def test_a_turn_that_is_recorded_already_is_named(known) -> None:
    steps, seen = drill_steps(known, turned(0, 5.0, 7.0), turned(0, 5.0, 7.0))
    assert list(steps.parts) == ["x-forward"]
    assert any("x forward is recorded already: turn it about x, reverse" in step.fault for step in seen)


def test_another_axis_ends_the_turn(known) -> None:
    values = np.concatenate([turned(0, 5.0, 7.0), turned(1, 5.0, 7.0)])
    steps, _ = drill_steps(known, values)
    assert list(steps.parts) == ["x-forward", "y-forward"]


def test_a_wave_goes_on_until_it_determines_what_was_asked_for(known, unit) -> None:
    until = tuple(read_wanted(("gyro_scale_factor=0.1%",), GRAVITY))
    steps = WaveSteps(WaveWatch(1 / HZ, GRAVITY, NAMES), 40.0, until, known)
    columns = waved(unit, 4, seconds=90.0)
    states: list[str] = []
    for piece in pieces(np.stack([columns[name] for name in NAMES], axis=1)):
        steps.add(piece, ["line"] * len(piece))
        states.append(steps.guide().state)
    assert "enough" in states
    assert steps.next_motion() == "go on waving"
    assert len(steps.parts["waved"]) == 9000


def test_what_is_planned_is_said_with_the_first_motion() -> None:
    expected = ExpectedUncertainty("gyro_scale_factor", "gx", 2.34e-4, "ppm", 1e-6, 1.0)
    lines = plan_lines(Guidance("plan", of=20.0, expected=(expected,), ask="turn it"))
    assert lines == [
        "Standard uncertainties that the planned motions are expected to give, 20 s each, at 3 mg of hand or drill:",
        "  gyro_scale_factor: 230 ppm or less (gx)",
        "turn it",
    ]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--motion", "drill", "--seconds", "3"], "option seconds"),
        (["--seconds", "30"], "option seconds"),
        (["--motion", "drill", "--until", "gyro_scale_factor=1"], "option until"),
        (["--motion", "spin"], "spin"),
    ],
)
def test_what_cannot_be_asked_for_is_refused(tmp_path, capsys, options, words) -> None:
    (tmp_path / "log").write_text("time_s,ax,ay,az,gx,gy,gz\n")
    assert run(["capture", str(tmp_path / "c"), "--from", str(tmp_path / "log"), *options]) == 2
    assert words in capsys.readouterr().err


def log_of(parts: Sequence[dict[str, np.ndarray]]) -> str:
    """Return recordings one after the other as lines, with two seconds at rest behind each."""
    rows, begin, rng = [], 0.0, np.random.default_rng(2)
    for columns in parts:
        own = np.stack([columns["time_s"] + begin, *(columns[name] for name in NAMES)], axis=1)
        rest = np.repeat(own[-1:], 200, axis=0) + rng.normal(0, 0.002, (200, 7))
        rest[:, 0], rest[:, 4:] = own[-1, 0] + np.arange(1, 201) / HZ, rng.normal(0, 0.002, (200, 3))
        rows += [own, rest]
        begin = rest[-1, 0] + 1 / HZ
    lines = [",".join(f"{value:.5f}" for value in row) for row in np.concatenate(rows)]
    return "\n".join(["time_s," + ",".join(NAMES), *lines]) + "\n"


@pytest.mark.slow
def test_a_drill_is_captured_into_a_campaign(unit, tmp_path, capsys) -> None:
    """Two turns about z: the campaign has two runs, its expectation is that of the plan, and x and y stay open."""
    turns = [drilled(unit, 5, 2, sense, seconds=7.0) for sense in (1.0, -1.0)]
    log = tmp_path / "drill.log"
    log.write_text(log_of(turns))
    status = run(["capture", str(tmp_path / "c"), "--from", str(log), "--motion", "drill", "--seconds", "6",
                  "--patience", "0", "--gravity-m-s2", str(GRAVITY)])  # fmt: skip
    said = capsys.readouterr().out
    assert status == 1
    assert (
        "Standard uncertainties that the planned motions are expected to give, 6 s each, at 3 mg of hand or drill:"
        in said
    )
    assert "z forward, " in said
    assert "turns by gravity" in said
    campaign = imubayes.load_campaign(tmp_path / "c")
    assert [each.procedure for each in campaign.runs] == ["free_rotation"] * 2
    expected = motion_steps.propose_effects(campaign).expected
    scales = {each.channel: each for each in expected if each.effect == "gyro_scale_factor"}
    assert scales["gz"].sd < 3e-3
    assert scales["gz"].told > 0.9
    assert scales["gx"].told < 0.5


@pytest.mark.slow
def test_turns_on_a_drill_need_gyros(unit, tmp_path, capsys) -> None:
    columns = waved(unit, 4, seconds=5.0)
    rows = np.stack([columns[name] for name in ("time_s", "ax", "ay", "az")], axis=1)
    np.savetxt(tmp_path / "a.csv", rows, fmt="%.5f", delimiter=",", header="time_s,ax,ay,az", comments="")
    status = run(["capture", str(tmp_path / "c"), "--from", str(tmp_path / "a.csv"), "--motion", "drill",
                  "--patience", "0", "--accel-unit", "m/s^2"])  # fmt: skip
    assert status == 2
    assert "need gyros" in capsys.readouterr().err
