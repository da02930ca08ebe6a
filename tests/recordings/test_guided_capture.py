"""`imubayes capture`: lines that come one after the other, guided until the rests determine the requested "
"quantities."""

import io
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tumble_recordings import GRAVITY, Recording, random_attitudes

import imubayes
from imubayes.cli.main import run
from imubayes_recordings.display.capture_lines import now_line, rest_line
from imubayes_recordings.guided_capture import UNTIL, Guidance, GuidedCapture, Wanted, growing_lines
from imubayes_recordings.guided_capture.pose_design import COEFFICIENTS, DIRECTIONS, design_of

OPTIONS: dict[str, Any] = {"gravity_m_s2": GRAVITY}
RESTS = 20


def text_of(made: Recording, pause: float = 0.0) -> str:
    """Return the recording as lines, with a pause of the port at half of it."""
    columns = {name: values.copy() for name, values in made.columns().items()}
    columns["time_s"][len(columns["time_s"]) // 2 :] += pause
    lines = [",".join(columns), *(",".join(f"{cell:.6f}" for cell in row) for row in np.stack([*columns.values()], 1))]
    return "\n".join(lines) + "\n"


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> Path:
    """A recording of 20 rests, with a pause of the port and a last line that is torn."""
    file = tmp_path_factory.mktemp("capture") / "port.csv"
    file.write_text(text_of(random_attitudes(3, RESTS), pause=7.0)[:-30])
    return file


def steps_of(file: Path, until: Sequence[str] = UNTIL["poses"], **options) -> list[Guidance]:
    return list(GuidedCapture(file, until, OPTIONS | options).follow(lambda: True, 0.0))


def test_a_replayed_file_is_guided_to_what_was_asked_for(log, tmp_path, capsys):
    folder = tmp_path / "desk"
    assert run(["capture", str(folder), "--from", str(log), "--patience", "0", "--gravity-m-s2", str(GRAVITY)]) == 0
    said = capsys.readouterr().out
    assert "rest 4: enough; undetermined: accel_bias" in said
    assert "point up" in said
    assert "all requested uncertainties are reached" in said
    assert "next: imubayes new" in said
    campaign = imubayes.load_campaign(folder)
    assert campaign.runs[0].tumble is not None
    assert campaign.runs[0].rows == RESTS  # with all that came after it was reached


@pytest.mark.slow
def test_what_is_shown_as_reached_is_what_the_poses_determine(log):
    steps = steps_of(log)
    assert steps[-1].state == "done"
    assert 12 <= steps[-1].poses < RESTS
    wanted = {each.effect: each.value for each in GuidedCapture(log, UNTIL["poses"], OPTIONS).wanted}
    largest = steps[-1].largest or {}
    assert all(largest[effect] <= value for effect, value in wanted.items())
    open_ones = [step.open for step in steps if step.state == "enough" and step.largest]
    assert set(open_ones[0]) >= {"accel_bias", "gyro_scale_factor"}
    # More is asked for than the recording can tell: said with what is open.
    more = steps_of(log, ("accel_bias=1ug", "gyro_scale_factor=5%"))
    assert more[-1].state == "ended"
    assert more[-1].open == ("accel_bias",)
    assert more[-1].poses == RESTS


def test_the_design_has_the_scatter_of_calibrations(tmp_path):
    """Least squares of |f| = g over draws of the noise have the deviations that the design states."""
    from imubayes.campaign.reduction.magnitude_calibration import fit_magnitude

    made = random_attitudes(5, 20)
    log = tmp_path / "log.csv"
    log.write_text(text_of(made))
    imubayes_campaign = tmp_path / "campaign"
    assert run(["convert", str(log), "--out", str(imubayes_campaign), "--gravity-m-s2", str(GRAVITY)]) == 0
    design = design_of(imubayes.load_campaign(imubayes_campaign), 0.01)
    rng, ups = np.random.default_rng(1), Rotation.random(20, rng=np.random.default_rng(5)).inv().apply([0, 0, GRAVITY])
    draws = [fit_magnitude(ups + rng.normal(0, design.force_sd, ups.shape), GRAVITY).offset for _ in range(60)]
    stated = design.deviations("accel_bias")
    assert stated == pytest.approx(np.std(draws, axis=0), rel=0.4), "of 60 draws, each known to 9 %"
    assert (design.deviations("gyro_scale_factor") < 1e-3).all()


@pytest.fixture(scope="module")
def one_axis(tmp_path_factory) -> Path:
    """Rests at attitudes that differ by turns about x alone."""
    made = Recording(2, Rotation.identity())
    for _ in range(12):
        made.turn(np.array([0.7, 0.0, 0.0]))
        made.rest()
    file = tmp_path_factory.mktemp("capture") / "one-axis.csv"
    file.write_text(text_of(made))
    return file


@pytest.mark.slow
def test_what_is_not_turned_stays_open(one_axis):
    """Turns about one axis leave the gyros across it undetermined, and the next attitude is off that axis."""
    last = steps_of(one_axis)[-1]
    assert last.state == "ended"
    assert {"accel_bias", "gyro_scale_factor"} <= set(last.open)
    assert last.up is not None
    assert last.up[0] != 0


@pytest.mark.slow
def test_standard_input_is_kept_until_the_campaign_is_written(log, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(log.read_bytes())))
    made = imubayes.capture(tmp_path / "desk", "-", **OPTIONS)
    assert made.last.state == "done"
    assert not (tmp_path / "desk.log").exists()
    # What makes no campaign stays in the file that was named.
    few = "".join(log.read_text().splitlines(keepends=True)[:1500])
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(few.encode())))
    with pytest.raises(imubayes.InputError, match="static poses"):
        imubayes.capture(tmp_path / "short", "-", **OPTIONS)
    assert (tmp_path / "short.log").read_text() == few
    assert not (tmp_path / "short").exists()


def test_an_interrupt_writes_what_there_is(log, tmp_path):
    def stop(step: Guidance, wanted: Sequence[Wanted]) -> None:
        if step.state == "enough" and step.poses == 8:
            raise KeyboardInterrupt

    made = imubayes.capture(tmp_path / "desk", log, patience=0.0, show=stop, **OPTIONS)
    assert made.last.state == "enough"
    assert imubayes.load_campaign(made.folder).runs[0].rows >= 8


def test_a_line_in_the_making_waits_for_its_end(tmp_path):
    file, over = tmp_path / "log", threading.Event()
    file.write_text("1,2\n3,")
    found = growing_lines(file, over.is_set, 10.0)
    assert next(found) == ["1,2"]
    with file.open("a") as stream:
        stream.write("4\n5")
    assert next(found) == ["3,4"]
    over.set()
    assert list(found) == []


@pytest.mark.slow
def test_accelerometers_alone_are_asked_for_accelerometers(tmp_path):
    columns = random_attitudes(4, 24).columns()
    names = ("time_s", "ax", "ay", "az")
    rows = np.stack([columns[name] for name in names], axis=1)
    np.savetxt(tmp_path / "acc.csv", rows, fmt="%.6f", delimiter=",", header=",".join(names), comments="")
    steps = steps_of(tmp_path / "acc.csv")
    assert steps[-1].state == "done"
    assert all(effect.startswith("accel") for effect in steps[-1].largest or {"none": 0.0})


@pytest.mark.parametrize("word", ["accel_bais=1mg", "accel_bias=1", "accel_bias=0mg", "gyro_bias=1mg", "accel_bias"])
def test_what_cannot_be_asked_for_is_refused(log, tmp_path, capsys, word):
    assert run(["capture", str(tmp_path / "x"), "--from", str(log), "--until", word]) == 2
    assert "option until" in capsys.readouterr().err


def test_every_direction_has_words():
    said = {now_line(Guidance("turn", up=up)) for up in DIRECTIONS}
    assert len(said) == len(DIRECTIONS) == 26
    assert "turn until +x points up, then let go" in said
    assert all(COEFFICIENTS[word.partition("=")[0]] for words in UNTIL.values() for word in words)
    assert "no campaign yet: too little" in rest_line(Guidance("enough", trouble="too little"), ())


def test_turns_about_one_axis_are_told_with_what_they_leave_open(one_axis, tmp_path):
    """The fit of |f| = g does not run away along what the poses do not determine."""
    assert run(["convert", str(one_axis), "--out", str(tmp_path / "c"), "--gravity-m-s2", str(GRAVITY)]) == 0
    notes = imubayes.load_campaign(tmp_path / "c").runs[0].notes
    assert any("about one axis of the body, (1.00, 0.00, " in note for note in notes), notes
    scatter = next(float(note.split()[-2]) for note in notes if "scatter" in note)
    assert scatter < 0.01
