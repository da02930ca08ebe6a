"""First lines of `check`, `diagnose` and `add`: verdict, evidence and one next command on a screen of 24 lines."""

import io
from dataclasses import replace

import pytest
from rich.console import Console

from display.made_diagnoses import diagnosis
from imubayes.campaign import Inspection, inspect_campaign
from imubayes.criticism.explanation_records import CoefficientEstimate, EffectChoice, RmsChange
from imubayes.display.check_report import check_report, grouped
from imubayes.display.layout import Report, print_report
from imubayes.display.loop.change_report import change_lines, change_report, next_command
from imubayes.display.loop.diagnosis_report import diagnosis_report
from imubayes.loop.model_history import CrossValidation
from imubayes.loop.refit import Prediction
from imubayes.results.change_records import BeforeAfter, ModelChange, Observation, RunRmsChange


def screen(report: Report) -> list[str]:
    """Return the lines of a terminal of 80 columns."""
    buffer = io.StringIO()
    print_report(report, Console(file=buffer, width=80, color_system=None))
    lines = []
    for line in buffer.getvalue().splitlines():
        lines += [line[start : start + 80] for start in range(0, max(len(line), 1), 80)]
    return lines


def test_notes_of_one_form_are_one_line():
    notes = [(f"run{place}", f"{place} of 390 raw rows kept; left out: {3 * place} settling") for place in range(1, 7)]
    notes += [("", "noise of channel 'gx': 2.5 pulse/s"), ("", "noise of channel 'gy': 3.5 pulse/s")]
    notes += [("run2", "no angle column: table angle 0 is assumed at rest")]
    assert grouped(notes) == [
        "6 runs (run1, run2, run3, run4 and 2 more): 1 … 6 of 390 raw rows kept; left out: 3 … 18 settling",
        "noise of channel 'gx', 'gy': 2.5 … 3.5 pulse/s",
        "run2: no angle column: table angle 0 is assumed at rest",
    ]


@pytest.fixture(scope="module")
def noted() -> Inspection:
    """A campaign of 23 runs, each with a note of the reduction."""
    read = inspect_campaign("data/full-qualification")
    assert read.campaign is not None
    runs = [replace(run, notes=(f"{run.rows} of 400 raw rows kept in means",)) for run in read.campaign.runs]
    return replace(read, campaign=replace(read.campaign, runs=tuple(runs)))


def test_check_fits_on_a_screen(noted):
    brief, whole = (screen(check_report(noted, None, "imubayes fit X", verbose)) for verbose in (False, True))
    assert brief[0] == "full-qualification: no findings"
    assert "next: imubayes fit X" in brief[:5]
    assert sum(line.startswith("note:") for line in brief) == 1
    assert sum(line.startswith("note:") for line in whole) == 23
    assert sum("ramp-x-up" in line for line in whole) == 2  # its row in the table, and its note


def test_diagnose_fits_on_a_screen():
    long = diagnosis().model_copy(update={"ranking": diagnosis().ranking * 40})
    lines = screen(diagnosis_report(long))
    assert len(lines) <= 24
    assert lines[0].startswith("gyro_scale_asymmetry is missing")
    assert any(line.startswith(" gyro_scale_quadratic") for line in lines)
    assert sum(line.startswith("next: imubayes add gyro_scale_asymmetry") for line in lines) == 1
    assert "All tables (120 ranked effects, 2 undetectable): imubayes diagnose R --verbose" in lines
    assert "Undetectable in these runs" in " ".join(screen(diagnosis_report(long, verbose=True)))


@pytest.fixture(scope="module")
def addition() -> ModelChange:
    """An addition after which 14 of 84 residual rms have changed."""
    names = [f"run-{place}" for place in range(14)]
    runs = [
        RunRmsChange(
            name=name, channel=channel, n=20, before=2e-4, unit="deg/s", after=1e-4 if channel == "gx" else 2e-4
        )
        for name in names
        for channel in ("gx", "gy", "gz", "ax", "ay", "az")
    ]
    channels = [
        RmsChange(channel=name, before=2e-4, after=1e-4 if name == "gx" else 2e-4, unit="deg/s")
        for name in ("gx", "gy", "gz")
    ]
    estimates = tuple(
        CoefficientEstimate(name=f"gyro_scale_asymmetry.asymmetry[{name}]", value=value, sd=1.0, unit="ppm")
        for name, value in (("gx", 9.3), ("gy", -5.2), ("gz", 12.4))
    )
    known = BeforeAfter(before=1.0, after=1.0)
    return ModelChange(
        added=(EffectChoice(effect="gyro_scale_asymmetry", channels=("gx",)),), widened={}, taken=True, message="",
        predicted=Prediction(delta_chi2=173.0, coefficients=estimates),
        observed=Observation(delta_chi2=172.0, coefficients=estimates),
        held_out=CrossValidation(by="run", delta=303.1, se=88.0, helped=7, of=7, verdict="helps"),
        runs=tuple(runs), channels=tuple(channels), chi2=known, dof=known, log_evidence=known, parent="results/hidden",
        folder="results/second",
    )  # fmt: skip


def test_several_effects_that_were_not_taken_are_followed_by_the_first_alone(addition):
    both = (EffectChoice(effect="gyro_dead_zone", channels=("gx",)), EffectChoice(effect="encoder_zero", channels=None))
    refused = addition.model_copy(update={"added": both, "taken": False, "message": "The refit did not converge."})
    lines = change_lines(refused)
    assert (
        "The posterior with the first of them alone ignores that the others may explain the residual instead." in lines
    )
    assert next_command(refused) == (
        "imubayes add gyro_dead_zone --to results/hidden --out results/second-alone --channels gx"
    )
    single = refused.model_copy(update={"added": both[:1]})
    assert next_command(single) == "imubayes diagnose results/hidden"


def test_add_shows_what_changed(addition):
    brief, whole = (screen(change_report(addition, verbose)) for verbose in (False, True))
    assert len(brief) <= 24
    said = " ".join(line.strip() for line in brief)
    assert "Δχ² at the noise known beforehand: predicted 173, observed 172." in "".join(brief)
    assert "14 of 84 residual rms values by run and channel changed by 5 % or more: run-0 gx −50 %" in said
    assert not any(line.startswith(" gy ") for line in brief)
    assert any("asymmetry[gx]" in line for line in brief)  # names are not broken
    assert brief[-1] == "next: imubayes diagnose results/second"
    assert sum("deg/h" in line for line in whole) == 3 + 84


def test_add_says_where_nothing_changed(addition):
    same = tuple(each.model_copy(update={"after": each.before}) for each in addition.runs)
    assert "None of the 84 residual rms values" in " ".join(
        screen(change_report(addition.model_copy(update={"runs": same})))
    )
