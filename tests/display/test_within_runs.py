"""Where runs have offsets the error that an effect explains is that within runs; the rms as a whole may even rise."""

from dataclasses import replace

import numpy as np
import polars as pl
import pytest

from display.test_diagnosis_report import diagnosis, residual_table, tree
from display.test_first_screen import addition, screen
from imubayes.criticism.model_history import Tree
from imubayes.criticism.residual_evidence import ResidualEvidence, of_runs
from imubayes.display.addition_report import addition_report
from imubayes.display.diagnosis_report import diagnosis_lines
from imubayes.display.figures.evidence_pictures import before_after
from imubayes.display.figures.residual_evidence import evidence_figure
from imubayes.display.history_table import history_sheet
from imubayes.results.addition import Addition
from imubayes.results.residual_table import Residuals

__all__ = ["addition"]

OFFSETS = np.repeat([3e-3, -1e-3, -2e-3], 20)


def test_the_rms_within_runs_is_about_their_means():
    table = residual_table(0.0).with_columns(
        input_residual=pl.col("input_residual") + pl.Series(OFFSETS), whitened=pl.lit(1.0)
    )
    runs = Residuals(table).by_run_and_channel()
    for run, (_, own) in zip(runs, table.group_by("run", maintain_order=True), strict=True):
        values = own["input_residual"].to_numpy()
        assert run.within == pytest.approx(np.sqrt(np.mean((values - values.mean()) ** 2)))
        assert run.rms == pytest.approx(np.hypot(run.within, values.mean()))


def slope(evidence: ResidualEvidence) -> float:
    """Return the slope that the right panel states."""
    return float(evidence_figure(evidence, "x").axes[1].get_title(loc="left").split("slope ")[1])


def test_what_an_effect_explains_is_compared_without_the_offsets_of_runs():
    runs, x = np.repeat(["a", "b", "c"], 20), np.tile(np.linspace(-1, 1, 20), 3)
    explained = 1e-3 * x + OFFSETS / 2
    noise = 1e-4 * np.random.default_rng(0).normal(size=60)
    noise -= of_runs(noise, runs)
    shown = ResidualEvidence("gx", "effect", None, x, runs, explained + noise, explained, "deg/s", None, True)
    before, after, unit = shown.rms
    assert (unit, after) == ("deg/h", pytest.approx(3600 * np.sqrt(np.mean(noise**2))))
    assert before == pytest.approx(3600 * np.sqrt(np.mean((1e-3 * x + noise) ** 2)))
    assert slope(shown) == pytest.approx(1, abs=0.05)
    # Planted fault: with the offsets left in, the slope says nothing of the effect.
    plain = replace(shown, residual=shown.residual - 2 * OFFSETS, within=False)
    assert abs(slope(plain) - 1) > 0.5
    assert plain.rms[1] > 10 * after


def test_a_prediction_says_that_it_is_within_runs():
    found = diagnosis()
    group = found.groups[0]
    within = group.model_copy(update={"residual": group.residual.model_copy(update={"within": True})})
    said = [" ".join(diagnosis_lines(found.model_copy(update={"groups": (each,)}))) for each in (group, within)]
    assert ["within runs" in each for each in said] == [False, True]


def test_an_addition_tells_the_rms_within_runs_where_their_means_count(addition: Addition):
    """The rms as a whole may rise, and that within runs fall."""
    first, *others = addition.channels
    risen = first.model_copy(update={"after": 1.2 * first.before})
    fallen = first.model_copy(update={"before": 0.7 * first.before, "after": 0.4 * first.before, "within": True})
    told = addition.model_copy(update={"channels": (risen, *others), "within_runs": (fallen,)})
    said = " ".join(" ".join(screen(addition_report(told))).split())
    assert "gx 0.720 0.864 deg/h +20 % 0.504 → 0.288 deg/h (−43 %)" in said
    # A channel is shown although it changed within runs alone; without means that count there is no column.
    same = told.model_copy(update={"channels": (first.model_copy(update={"after": first.before}), *others)})
    assert "0.504 → 0.288 deg/h" in " ".join(" ".join(screen(addition_report(same))).split())
    whole = addition.model_copy(update={"within_runs": addition.channels})
    assert "within runs" not in " ".join(screen(addition_report(whole)))


def test_the_history_has_a_column_where_the_means_of_runs_count():
    made = tree()
    assert not any("within" in name for name in history_sheet(made).head)
    apart = {
        place: node.model_copy(
            update={"rms": tuple(each.model_copy(update={"within": 0.5 * each.rms}) for each in node.rms[:1])}
        )
        for place, node in made.nodes.items()
    }
    sheet = history_sheet(Tree(apart, made.parents))
    assert "within runs / deg/h" in sheet.head
    assert [row[sheet.head.index("within runs / deg/h")].text for row in sheet.rows][:2] == ["0.900", "0.360"]


def test_before_and_after_are_about_the_means_of_runs_where_the_diagnosis_was():
    group = diagnosis().groups[0]
    within = group.model_copy(update={"residual": group.residual.model_copy(update={"channel": "gx", "within": True})})
    offsets = pl.Series(OFFSETS)
    before, after = (
        residual_table(size).with_columns(input_residual=pl.col("input_residual") + offset)
        for size, offset in ((1e-5, offsets), (0.0, 3 * offsets))
    )
    drawn = before_after(before, after, "gyro_bias_temperature", group=within)
    assert drawn is not None
    rms = [float(axes.get_title(loc="left").split("rms ")[1].split()[0]) for axes in drawn.axes]
    assert rms[1] < 0.9 * rms[0]
    # What follows the input is drawn against the input where the table of residuals has it.
    known = before.with_columns(input_observed=pl.lit(1.0) * pl.int_range(60))
    against = before_after(known, after, "gyro_scale_asymmetry", group=within)
    assert against is not None
    labels = [each.axes[0].get_xlabel() for each in (drawn, against)]
    assert ["rate along the input axis" in label for label in labels] == [False, True]
