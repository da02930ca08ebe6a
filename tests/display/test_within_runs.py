"""If runs have offsets the error that an effect explains is that within runs; the rms as a whole may even rise."""

from dataclasses import replace

import numpy as np
import polars as pl
import pytest

from display.made_diagnoses import diagnosis
from display.synthetic_results import summary_of, trihedral_residuals
from display.test_diagnosis_report import residual_table, tree
from display.test_first_screen import addition, screen
from imubayes.adequacy.adequacy_record import ChannelRms, KnownNoiseFit
from imubayes.criticism.residual_evidence import ResidualEvidence, of_runs
from imubayes.display.figures.residual_evidence import before_after, evidence_figure
from imubayes.display.loop.change_report import change_report
from imubayes.display.loop.history import history_report
from imubayes.loop.model_history import Tree
from imubayes.results.change_records import ModelChange, offsets_moved
from imubayes.results.stored_tables import Residuals
from imubayes.results.summary import Summary

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
    assert slope(shown) == pytest.approx(1, abs=0.05)
    # Planted fault: with the offsets left in, the slope says nothing of the effect.
    plain = replace(shown, residual=shown.residual - 2 * OFFSETS, within=False)
    assert abs(slope(plain) - 1) > 0.5


def test_a_rise_of_the_residual_is_explained(addition: ModelChange):
    """Offsets that a parameter took up before move into the residual, which then rises although chi-square falls."""
    first, *others = addition.channels
    risen = first.model_copy(update={"after": 1.4 * first.before})
    told = addition.model_copy(update={"channels": (risen, *others), "offsets_moved": ("gx",)})
    reason = "The residual rms of gx rises because it now contains"
    assert reason in " ".join(" ".join(screen(change_report(told))).split())
    assert "rises because" not in " ".join(screen(change_report(addition)))
    made = tree()
    nodes = dict(made.nodes)
    nodes["/r/b"] = nodes["/r/b"].model_copy(update={"offsets_moved": ("gx",)})
    (line, *_) = history_report(Tree(nodes, made.parents)).closing
    assert reason in line


def test_offsets_moved_are_told_from_other_rises():
    def summary(rms: float, within: float) -> Summary:
        channels = (ChannelRms(channel="ay", rms=rms, unit="g", within=within),)
        known = KnownNoiseFit(chi2=300.0, dof=290.0, channels=channels)
        return summary_of(trihedral_residuals()).model_copy(update={"known_noise": known})

    before = summary(15.6e-6, 4e-6)
    assert offsets_moved(before, summary(21.8e-6, 3.9e-6)) == ("ay",)
    assert offsets_moved(before, summary(21.8e-6, 8e-6)) == ()
    assert offsets_moved(before, summary(12e-6, 3e-6)) == ()


def test_before_and_after_are_about_the_means_of_runs_where_the_diagnosis_was():
    group = diagnosis().groups[0]
    within = group.model_copy(update={"within": True})
    offsets = pl.Series(OFFSETS)
    before, after = (
        residual_table(size).with_columns(input_residual=pl.col("input_residual") + offset)
        for size, offset in ((1e-5, offsets), (0.0, 3 * offsets))
    )
    drawn = before_after(before, after, "gyro_bias_temperature", group=within)
    assert drawn is not None
    rms = [float(axes.get_title(loc="left").split("rms ")[1].split()[0]) for axes in drawn.axes]
    assert rms[1] < 0.9 * rms[0]
    # What follows the input is drawn against the input if the table of residuals has it.
    known = before.with_columns(input_observed=pl.lit(1.0) * pl.int_range(60))
    against = before_after(known, after, "gyro_scale_asymmetry", group=within)
    assert against is not None
    labels = [each.axes[0].get_xlabel() for each in (drawn, against)]
    assert ["rate along the input axis" in label for label in labels] == [False, True]
