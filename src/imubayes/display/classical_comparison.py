"""Classical estimates beside the joint fit, and how far classical assumptions explain their difference.

A classical estimate takes seat and table as exact and each run at its own temperature.  What these assumptions do to it
is found by evaluating the outputs that the fit predicts in the same way, which gives what the classical evaluation
would find if the fit is right.  If the estimate from the measured outputs agrees with that from the predicted
ones, the assumptions that the fit gives up explain its difference from the fit.  The mounting angle has its own part of
the difference.
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import polars as pl

from imubayes.display.layout import Cell, Sheet, cells
from imubayes.display.numbers_and_labels import listed, pretty, significant, value_and_sd
from imubayes.foundations.campaign_data import Campaign, Run
from imubayes.foundations.covariates import REFERENCE_TEMPERATURE
from imubayes.foundations.quantity_names import SCALE_FACTOR, QuantityName, family_of, name_of
from imubayes.foundations.records import finite
from imubayes.procedures import classical
from imubayes.procedures.textbook import Estimate, TextbookResult, Undetermined, compared_probability
from imubayes.results.summary import Conformance, DerivedSummary, Quantity, Summary

# Runs closer to the reference temperature differ by less than a test at one temperature does.
_SAME_TEMPERATURE = 5.0


@dataclass(frozen=True)
class OfPrediction:
    """Classical estimates of predicted outputs.

    Attributes
    ----------
    value : (name, run) → estimate.
    of_offset : (name, run) → its change by run offsets of one standard deviation.
    temperature : run → mean temperature, °C, if it differs from that of the joint values and the model has
        parameters for it.
    """

    value: Mapping[tuple[str, str], float]
    of_offset: Mapping[tuple[str, str], float]
    temperature: Mapping[str, float]


def of_prediction(campaign: Campaign, residuals: pl.DataFrame, summary: Summary) -> OfPrediction:
    """Return the classical estimates of the outputs that a fit predicts."""
    offsets = {
        channel.name: next(
            (p.mean or 0.0 for p in summary.parameters if p.name == name_of("run_scatter.tau", channel.name)), 0.0
        )
        for channel in campaign.channels
    }
    plain = classical_values(with_outputs(campaign, residuals, {}))
    shifted = classical_values(with_outputs(campaign, residuals, offsets))
    effects = {QuantityName.of(p.name).effect for p in summary.parameters}
    thermal = any("temperature" in name or "converter" in name for name in effects)
    return OfPrediction(
        plain,
        {key: abs(shifted[key] - value) for key, value in plain.items() if key in shifted},
        {run.name: at for run in campaign.runs if thermal and (at := _temperature(run)) is not None},
    )


def classical_values(campaign: Campaign) -> dict[tuple[str, str], float]:
    """Return the classical estimates of a campaign by (name, run)."""
    return {(each.name, each.run): each.value for each in classical(campaign) if isinstance(each, Estimate)}


def _temperature(run: Run) -> float | None:
    known = run.covariates.get("temperature")
    if known is None:
        return None
    mean = float(np.mean(known))
    return mean if abs(mean - REFERENCE_TEMPERATURE) > _SAME_TEMPERATURE else None


def with_outputs(campaign: Campaign, residuals: pl.DataFrame, offsets: Mapping[str, float]) -> Campaign:
    """Return the campaign with the outputs of its channels as predicted, and an offset of each run added."""
    found = {name[0]: own for name, own in residuals.group_by("run")}
    runs = []
    for run in campaign.runs:
        observed = run.observed.copy()
        for place, channel in enumerate(campaign.channels):
            if channel.kind == "angle" or run.name not in found:
                continue
            own = found[run.name].filter(pl.col("channel") == channel.name)
            observed[own["row"].to_numpy(), place] = own["predicted"].to_numpy() + offsets.get(channel.name, 0.0)
        runs.append(replace(run, observed=observed))
    return replace(campaign, runs=tuple(runs))


# A difference beyond so many combined standard deviations is one that the classical uncertainty does not cover.
_BEYOND = 3.0
_MOST_BESIDE = 8
# An effect is named if it adds at least this share of a difference.
_LEAST_SHARE, _MOST_CAUSES = 0.25, 3


@dataclass(frozen=True)
class AngleError:
    """Error of the mounting angle that the classical evaluation assumes, and its effect on the estimate."""

    arcsec: float
    ppm: float


@dataclass(frozen=True)
class ComparedEstimate:
    """A classical estimate with the same quantity of the joint fit, None if that does not have it.

    Attributes
    ----------
    of_prediction : the classical estimate from the outputs that the joint fit predicts; None if not evaluated.
    of_offset : what a run offset of one standard deviation does to it.
    temperature : of the run, °C, if it is not that of the joint values.
    causes : effects of the model that make the difference, each with what it adds, the largest first.
    """

    classical: Estimate
    joint: Quantity | None
    of_angle: AngleError | None
    of_prediction: float | None = None
    of_offset: float = 0.0
    temperature: float | None = None
    causes: tuple[tuple[str, float], ...] = ()

    @property
    def difference(self) -> float:
        """Classical less joint estimate; NaN without the latter."""
        if self.joint is None or self.joint.mean is None:
            return math.nan
        return self.classical.value - self.joint.mean

    @property
    def normalised_difference(self) -> float:
        """Difference in combined standard deviations; NaN where either has none."""
        if self.joint is None or self.joint.sd is None:
            return math.nan
        return abs(self.difference) / math.hypot(self.classical.sd, self.joint.sd)

    @property
    def beyond(self) -> bool:
        """Whether it differs from the joint fit by more than both uncertainties."""
        return self.normalised_difference > _BEYOND

    @property
    def explained(self) -> bool:
        """Whether the outputs that the joint fit predicts give the same classical estimate."""
        if self.of_prediction is None or not math.isfinite(self.of_prediction):
            return False
        apart = abs(self.classical.value - self.of_prediction)
        return bool(apart <= _BEYOND * math.hypot(self.classical.sd, self.of_offset))

    @property
    def conformance(self) -> Conformance | None:
        """Probability from the joint fit that the quantity does not exceed its threshold."""
        return self.joint.within if isinstance(self.joint, DerivedSummary) else None


@dataclass(frozen=True)
class ClassicalComparison:
    """All classical estimates of a campaign, and what could not be determined classically."""

    estimates: tuple[ComparedEstimate, ...]
    undetermined: tuple[Undetermined, ...]

    @property
    def beyond(self) -> bool:
        """Whether any estimate differs from the joint fit by more than both uncertainties."""
        return any(each.beyond for each in self.estimates)

    def with_causes(self, behind: Mapping[tuple[str, str], Sequence[tuple[str, float]]]) -> "ClassicalComparison":
        """Return the comparison with the effects behind each difference that the joint fit explains."""
        estimates = [
            replace(each, causes=_causes(each.difference, behind.get((each.classical.name, each.classical.run), ())))
            if each.beyond and each.explained
            else each
            for each in self.estimates
        ]
        return replace(self, estimates=tuple(estimates))


def _causes(difference: float, added: Sequence[tuple[str, float]]) -> tuple[tuple[str, float], ...]:
    """Return the effects that add most to a difference, in its direction."""
    named = [(name, size) for name, size in added if size * np.sign(difference) >= _LEAST_SHARE * abs(difference)]
    return tuple(sorted(named, key=lambda pair: -abs(pair[1]))[:_MOST_CAUSES])


def compare_classical(
    findings: Sequence[TextbookResult], summary: Summary | None = None, predicted: OfPrediction | None = None
) -> ClassicalComparison:
    """Return classical estimates beside those of a fit of the same campaign, if there is one.

    Parameters
    ----------
    findings : of the classical evaluation.
    summary : of the fit.
    predicted : the classical evaluation of what the fit predicts.
    """
    known = () if summary is None else (*summary.combinations, *summary.derived, *summary.parameters)
    joint = {entry.name: entry for entry in known}
    return ClassicalComparison(
        tuple(_with_prediction(_compared(each, joint), predicted) for each in findings if isinstance(each, Estimate)),
        tuple(finding for finding in findings if isinstance(finding, Undetermined)),
    )


def _with_prediction(compared: ComparedEstimate, predicted: OfPrediction | None) -> ComparedEstimate:
    if predicted is None:
        return compared
    key = (compared.classical.name, compared.classical.run)
    return replace(
        compared,
        of_prediction=predicted.value.get(key),
        of_offset=predicted.of_offset.get(key, 0.0),
        temperature=predicted.temperature.get(key[1]),
    )


def _compared(estimate: Estimate, joint: Mapping[str, Quantity]) -> ComparedEstimate:
    found = joint.get(estimate.name)
    if found is None or found.unit != estimate.unit or found.mean is None:
        return ComparedEstimate(estimate, None, None)
    return ComparedEstimate(estimate, found, _angle_error(estimate, joint))


def _angle_error(estimate: Estimate, joint: Mapping[str, Quantity]) -> AngleError | None:
    """Return the error of the nominal angle θ; the classical scale factor is k′/cos θ."""
    angle = joint.get(estimate.angle)
    if angle is None or angle.mean is None or not estimate.value:
        return None
    ratio = math.cos(math.radians(angle.mean)) / math.cos(math.radians(estimate.nominal))
    return AngleError((angle.mean - estimate.nominal) * 3600, (ratio - 1) * 1e6)


def classical_json(comparison: ClassicalComparison) -> dict[str, Any]:
    """Return a comparison as `imubayes classical --json` prints it."""
    return {
        "format": 1,
        "estimates": [_json(compared) for compared in comparison.estimates],
        "undetermined": [asdict(finding) for finding in comparison.undetermined],
    }


def _json(compared: ComparedEstimate) -> dict[str, Any]:
    estimate, joint, within = compared.classical, compared.joint, compared.conformance
    fit = {"value": joint.mean, "sd": joint.sd, "within": within and within.model_dump()} if joint else None
    return {
        "name": estimate.name,
        "run": estimate.run,
        "value": estimate.value,
        "sd": finite(estimate.sd),
        "uncertainty": estimate.uncertainty if math.isfinite(estimate.sd) else "",
        "unit": estimate.unit,
        "method": estimate.method,
        "decision": estimate.decision,
        "joint": fit,
        "difference": finite(compared.difference),
        "of_angle": asdict(compared.of_angle) if compared.of_angle else None,
        "of_prediction": None if compared.of_prediction is None else finite(compared.of_prediction),
        "explained": compared.explained,
        "causes": [{"effect": name, "adds": size} for name, size in compared.causes],
    }


def classical_sheet(estimates: Sequence[ComparedEstimate]) -> Sheet:
    """Return a line per estimate: classical, joint fit, their difference and the part of it from the angle."""
    with_joint = any(compared.joint for compared in estimates)
    rows, few = [], []
    for compared in estimates:
        estimate, unit = compared.classical, pretty(compared.classical.unit)
        value, sd = value_and_sd(estimate.value, estimate.sd)
        names, joint = cells(estimate.name, estimate.run), _joint_cells(compared)
        rows.append(cells(*names, value, sd, *(joint if with_joint else ()), unit))
        few.append(cells(*names, f"{_with_sd(value, sd)} {unit}", _with_sd(joint[0].text, joint[1].text)))
    columns = ("joint", "sd", "difference", "explained by") if with_joint else ()
    head, title = ("quantity", "run", "classical", "sd", *columns, "unit"), "Classical estimates, run by run"
    note = "The classical sd is the scatter about the fitted curve. It does not include errors of the assumptions."
    sheet = Sheet(title, head, rows, (0, 1, 7) if with_joint else (0, 1), "", note)
    if not with_joint:
        return sheet.with_narrow(("quantity", "run", "classical ± sd"), [row[:3] for row in few], (0, 1))
    return sheet.with_narrow(("quantity", "run", "classical ± sd", "joint ± sd"), few, (0, 1))


def _with_sd(value: str, sd: str) -> str:
    return f"{value} ± {sd}" if sd not in ("", "–") else value


def _joint_cells(compared: ComparedEstimate) -> tuple[Cell, Cell, Cell, Cell]:
    joint, angle = compared.joint, compared.of_angle
    if joint is None or joint.mean is None:
        return Cell(""), Cell(""), Cell(""), Cell("")
    value, sd = value_and_sd(joint.mean, joint.sd)
    relative = family_of(joint.name) == SCALE_FACTOR
    text = _size(compared.difference, joint, relative)
    because = [f"{name}: {_size(added, joint, relative)}" for name, added in compared.causes]
    if angle is not None and abs(angle.ppm) >= 1:
        because.append(f"angle error {significant(angle.arcsec)} arcsec: {significant(angle.ppm)} ppm")
    if compared.temperature is not None:
        because.append(f"run at {compared.temperature:.0f} °C")
    mood = "bad" if compared.beyond and not compared.explained else ""
    return Cell(value), Cell(sd), Cell(text, mood), Cell("; ".join(because))


def _size(difference: float, joint: Quantity, relative: bool) -> str:
    """Return a difference; of a scale factor in ppm of it."""
    return f"{significant(difference / (joint.mean or 1.0) * 1e6)} ppm" if relative else significant(difference)


def discrepancy_sheet(comparison: ClassicalComparison) -> Sheet:
    """Return the estimates that differ from the joint fit, those first that its assumptions do not explain."""
    known = [compared for compared in comparison.estimates if math.isfinite(compared.normalised_difference)]
    ranked = sorted(known, key=lambda compared: (compared.explained, -compared.normalised_difference))
    beyond = [compared for compared in ranked if compared.beyond]
    open_ones = [compared for compared in beyond if not compared.explained]
    sheet = classical_sheet((open_ones or beyond)[:_MOST_BESIDE])
    first = (
        f"{len(beyond)} of {len(known)} classical estimates differ from the joint fit by more than {_BEYOND:g} "
        f"combined standard uncertainties. {_explanation(beyond, len(open_ones))}"
    )
    note = f"{first} All estimates: imubayes classical CAMPAIGN --result RESULT."
    title = "Classical estimates that disagree with the joint fit"
    if not open_ones:
        title = "Classical estimates whose difference the joint fit explains"
    return sheet.changed(title=title, note=note)


def _explanation(beyond: Sequence[ComparedEstimate], unexplained: int) -> str:
    """Return which assumptions of the classical evaluation explain differences, and whether all of them."""
    explained = len(beyond) - unexplained
    if not explained:
        return "The assumptions of the classical evaluation do not hold."
    leading = Counter(each.causes[0][0] for each in beyond if each.causes)
    named = listed([name for name, _ in leading.most_common()]) if leading else "effects of the model"
    gives = " and ".join([f"neglects {named}", *_at_own_temperature(beyond)])
    how_many = f"{explained} are" if unexplained else "All are"
    said = (
        f"{how_many} explained: the classical evaluation {gives}. Applied to the outputs that the joint fit "
        "predicts, it gives the same values within noise and run offsets."
    )
    rest = (
        f" {unexplained} are not: the measured outputs of these runs deviate from the fit (imubayes diagnose RESULT)."
    )
    return said + (rest if unexplained else "")


def _at_own_temperature(beyond: Sequence[ComparedEstimate]) -> list[str]:
    warm = [each.temperature for each in beyond if each.explained and each.temperature is not None]
    if not warm:
        return []
    ends = dict.fromkeys(f"{at:.0f}" for at in (min(warm), max(warm)))
    at = f"{' … '.join(ends).replace('-', '−')} °C; joint values are at {REFERENCE_TEMPERATURE:g} °C"
    return [f"evaluates runs at their own temperature ({at})"]


def decision_sheet(comparison: ClassicalComparison) -> Sheet:
    """Return the decisions of the classical evaluation beside their probability."""
    rows = [
        cells(compared.classical.name, compared.classical.decision, _probability(compared.conformance))
        for compared in comparison.estimates
        if compared.classical.decision
    ]
    note = "Joint: probability, from all runs and effects together, that the quantity does not exceed the threshold."
    return Sheet("Classical decisions", ("quantity", "decision", "joint"), rows, (0, 1, 2), "", note)


def _probability(within: Conformance | None) -> str:
    if within is None or within.probability is None:
        return ""
    return f"P(≤ {within.threshold:g} {pretty(within.unit)}) {compared_probability(within.probability)}"


def undetermined_sheet(comparison: ClassicalComparison) -> Sheet:
    """Return what cannot be determined classically from these runs."""
    runs: dict[str, list[str]] = {}
    for finding in comparison.undetermined:
        runs.setdefault(finding.sentence, []).append(finding.run)
    rows = [cells(", ".join(dict.fromkeys(names)), sentence) for sentence, names in runs.items()]
    return Sheet("Not determined classically", ("run", "reason"), rows, (0, 1))
