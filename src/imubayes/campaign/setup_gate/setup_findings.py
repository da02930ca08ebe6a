"""The judgement of the set-up as findings: what is wrong, by how much, and what to correct."""

import math

from imubayes.campaign.findings import Finding, Severity
from imubayes.campaign.setup_gate.judgement import judge_setup
from imubayes.campaign.setup_gate.remedies import REMEDIES, Places, Words
from imubayes.campaign.setup_gate.search import Explanation
from imubayes.campaign.setup_gate.temperature_mistakes import TEMPERATURE_MISTAKES, TemperatureReversed
from imubayes.campaign.setup_gate.wrong_rows import WrongRow, with_rows, wrong_rows
from imubayes.campaign_data import Campaign
from imubayes.covariates import COVARIATES

_MOST_RUNS = 5
_MOST_ALTERNATIVES = 5


def setup_findings(campaign: Campaign, places: Places, accepted: tuple[str, ...]) -> list[Finding]:
    """Return what the outputs say against the set-up of a campaign.

    Parameters
    ----------
    places : where what is said stands in the files.
    accepted : names of findings that the campaign accepts; they are warnings.
    """
    rows = wrong_rows(campaign)
    said = [_of_row(campaign, each, places) for each in rows]
    judged = judge_setup(with_rows(campaign, rows))
    if judged.mistakes:
        return [*said, *(_explained(campaign, equal, places, accepted) for equal in judged.mistakes)]
    return [
        *said,
        *(_unexplained(name, misfit, places.table(name)) for name, misfit in judged.unexplained[:_MOST_RUNS]),
    ]


def _of_row(campaign: Campaign, found: WrongRow, places: Places) -> Finding:
    covariate = COVARIATES[f"table_{found.column}"]
    table = next(run.table for run in campaign.runs if run.name == found.run)
    zero = campaign.tables[table or ""].zero_angle if found.column == "angle" else 0.0
    recorded, agreeing = ((value + zero) / covariate.factor() for value in (found.recorded, found.agreeing))
    sd, unit = found.sd / covariate.factor(), covariate.unit
    what = (
        f"all outputs of row {found.row + 1} are as at '{covariate.column}' = {agreeing:.4g} ± {sd:.1g} {unit}, not "
        f"{recorded:.6g}: {found.distance:.2g} standard deviations of the other rows"
    )
    where = f"{places.table(found.run)}, row {found.row + 1}, column '{covariate.column}'"
    remedy = "correct the value from the record of the test, or take the row out"
    return Finding("row_disagrees", "warning", found.run, what, where, "what the table did in that row", remedy)


def _explained(
    campaign: Campaign, equal: tuple[Explanation, ...], places: Places, accepted: tuple[str, ...]
) -> Finding:
    found: list[tuple[str, Words]] = [
        (each.mistake.kind, REMEDIES[each.mistake.kind](campaign, each, places)) for each in equal
    ]
    run = equal[0].mistake.scope.name if equal[0].mistake.scope.section == "run" else ""
    first, words, others = equal[0], found[0][1], [each for _, each in found[1:]]
    others = others[:_MOST_ALTERNATIVES]
    what = ", or ".join([words.what, *(each.what for each in others)])
    evidence = f"the outputs fit {'each' if others else 'that'} far better (Δχ² {first.gain:.3g})"
    if first.rivalled:
        evidence += f", but cannot tell it from {_rival(first)}"
    remedy = words.remedy
    if others:
        what = f"the data cannot tell whether {what}"
        remedy += " (or: " + "; or: ".join(each.remedy for each in others) + ")"
    # Weaker evidence is said and stops nothing.
    sure = _stops(equal) and not {kind for kind, _ in found} & {*accepted}
    severity: Severity = "error" if sure else "warning"
    if sure:
        remedy += f'; accepted = ["{first.mistake.kind}"] in campaign.toml lets the campaign pass as it is'
    return Finding(
        first.mistake.kind, severity, run, f"{what}: {evidence}", words.where, words.allowed, remedy
    )  # fmt: skip


def _stops(equal: tuple[Explanation, ...]) -> bool:
    """Whether a mistake is supported well enough to stop a fit, and no explanation is one of a poor unit."""
    first = equal[0]
    sure = first.support > first.stopping and not first.rivalled
    return sure and all(each.mistake.stops(each.size) for each in equal)


def _rival(found: Explanation) -> str:
    """Return what passes for a mistake in a valid set-up."""
    if not isinstance(found.mistake, TEMPERATURE_MISTAKES):
        return "a bias that changes from run to run"
    if isinstance(found.mistake, TemperatureReversed):
        return "biases that drift, or unlike those of other runs"
    if found.mistake.scope.section == "run":
        return "biases and scale factors unlike those of other runs"
    return "outputs that ignore the temperature"


def _unexplained(run: str, misfit: float, where: str) -> Finding:
    what = (
        f"the outputs differ from what the set-up says by about {math.sqrt(misfit):.2g} times as much as errors of "
        "unit and equipment allow; no single mistake in the set-up explains it"
    )
    remedy = "check mounting, table, units and files of the run"
    return Finding("setup_disagrees", "warning", run, what, where, "outputs that follow the nominal input", remedy)


SETUP_FINDINGS = tuple(REMEDIES)
"""Names of the findings about the set-up that a campaign can accept."""
