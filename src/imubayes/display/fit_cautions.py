"""Cautions of a fit in sentences: noise that departs from its model, χ², and priors in conflict with the data.

They are what has to be known before the numbers of a fit are used.  The noise may depart from its model, or from what
is known of it beforehand.  χ² is given with its p-values per run and channel.  Parameters take up their share of the
degrees of freedom: of its n values a run and channel has n·dof/N in proportion.  Parameters whose prior disagrees with
the data are named in words and in a table, with the line of the file to change.
"""

import math
from collections.abc import Sequence

from imubayes.adequacy.adequacy_record import NoiseComparison, NoiseViolation
from imubayes.display.layout import Cell, Sheet, cells
from imubayes.display.numbers_and_labels import (
    command_line,
    listed,
    percent,
    pretty,
    relation,
    significant,
    value_and_sd,
)
from imubayes.foundations.campaign_data import SetAside
from imubayes.foundations.quantity_names import SCALE_FACTOR, QuantityName, family_of
from imubayes.foundations.tail_probabilities import chi2_cdf, chi2_survival
from imubayes.foundations.wrong_records import agreement_text, record_remedy
from imubayes.inference.identifiability import ImplausibleEstimate, PriorConflict, UnexplainedOutput
from imubayes.model.model_file import GRAVITY, SingleRunEffect, UncertainEquipment
from imubayes.results.summary import PriorScatter, RunSummary, Summary

NOISE_WORDS = {
    "autocorrelation": "the residuals are autocorrelated",
    "low_frequency": "the residuals drift within runs",
    "scatter_between_runs": "runs scatter more than the noise within them",
    "grows_with_input": "the noise grows with the input",
    "heavy_tails": "the noise has heavy tails or outliers",
    "quantisation": "the output is quantised too coarsely for its noise",
}
"""Kind of a violation of the noise model → what it is, in words."""
_MOST_NAMED = 3
# Ratio of uncertainties from which on what is taken as exact is reported.
_MATTERS = 1.1
_PER_FORCE = (" per g", " per m/s^2")


def violation_text(violations: Sequence[NoiseViolation]) -> str:
    """Return each kind of violation with its channels and evidence, separated by semicolons."""
    kinds = dict.fromkeys(violation.kind for violation in violations)
    return "; ".join(_one_kind([each for each in violations if each.kind == kind]) for kind in kinds)


def _one_kind(violations: Sequence[NoiseViolation]) -> str:
    first, said = violations[0], NOISE_WORDS[violations[0].kind]
    channels = list(dict.fromkeys(channel for violation in violations for channel in violation.channels))
    named = ", ".join(channels[:_MOST_NAMED]) + (" …" if len(channels) > _MOST_NAMED else "")
    if first.step is not None:
        return f"{said} ({named}: a step is {significant(first.step)} times the noise)"
    chance = min(violation.p for violation in violations if violation.p is not None)
    return f"{said} ({named}, p {relation(chance)})"


def contradiction_text(contradicted: Sequence[NoiseComparison]) -> str:
    """Return which noise scale contradicts what is known of it, by what factor, and what that means."""
    worst, *others = dict.fromkeys(each.parameter for each in contradicted)
    own = [each for each in contradicted if each.parameter == worst]
    factors = " and ".join(_factor(each) for each in own if each.excessive or each.ratio > 1)
    where = "between runs" if own[0].between_runs else "from row to row"
    meaning = f"this scatter {where} absorbs something that the model lacks"
    if own[0].source == "samples":
        meaning += " (an effect, or noise with a correlation time longer than a row)"
    elif not any(each.excessive and each.source == "sisters" for each in own):
        meaning += ", or the prior is too narrow for this unit"
    more = f". The same holds for {listed(others, _MOST_NAMED)}" if others else ""
    return f"{worst} is {factors}. {meaning[0].upper()}{meaning[1:]}{more}"


def _factor(each: NoiseComparison) -> str:
    if each.source == "samples":
        return f"{noise_ratio(each)} times the noise of the raw samples of the same rows"
    if each.source == "sisters":
        # Not the scales are compared: that of a sister may be zero.
        by = "means of their runs" if each.between_runs else "scatter of their rows"
        return f"{significant(each.ratio, 2)} times that of {' and '.join(each.sisters)} by the {by}"
    return f"{significant(each.ratio, 2)} times the scale of its prior"


def noise_ratio(each: NoiseComparison) -> str:
    """Return fitted over known noise with its standard uncertainty."""
    value, sd = value_and_sd(each.ratio, each.ratio_sd)
    return f"{value} ± {sd}"


_FAILED, _NOT_CONVERGED, _DOUBTED = "FIT FAILED", "NOT CONVERGED", "DO NOT TRUST THE INTERVALS"
_SHORT = 100
"""Characters of a warning that a picture has room for."""


def alarm_in_picture(summary: Summary) -> str:
    """Return the warning as it stands in a picture; of a long one the reason is said once, at the head of the page."""
    alarm = alarm_of(summary)
    word = next((word for word in (_FAILED, _NOT_CONVERGED, _DOUBTED) if alarm.startswith(word)), "")
    return alarm if len(alarm) <= _SHORT else f"{word}. The reason is given at the head of the comparison."


def alarm_of(summary: Summary) -> str:
    """Return the warning that precedes everything else; empty if the intervals of the fit can be trusted."""
    if summary.implausible or summary.unexplained:
        return " ".join((f"{_FAILED}.", *failures(summary), _FAILED_REMEDY))
    if not summary.converged:
        said = f"{_NOT_CONVERGED}. {summary.message.strip() or 'The numbers below must not be used.'}"
        return f"{said} {_SAMPLING_REMEDY}" if summary.sampled else said
    contradicted = f"{contradiction_text(summary.noise_contradicted)}. " if summary.noise_contradicted else ""
    violated = violation_text(summary.noise_violations)
    if not (contradicted or violated):
        return ""
    tests = f"{'Tests of the residuals: ' * bool(contradicted)}{violated}. " if violated else ""
    return f"{_DOUBTED}: {contradicted}{tests}`imubayes diagnose` looks for the cause."


def next_command(summary: Summary, campaign: str, folder: str) -> str:
    """Return the command to run after a fit: what looks for the cause of its warning, or the look at the residuals."""
    if summary.implausible or summary.unexplained or not (summary.converged or summary.sampled):
        return command_line("check", campaign)
    doubted = summary.noise_violations or summary.noise_contradicted or not summary.converged
    return command_line("diagnose" if doubted else "compare", folder)


_SAMPLING_REMEDY = (
    "`imubayes diagnose` and `add` need no draws: they use the mode. If weights or ensembles disagree, give the weakly "
    "determined parameters a tighter prior, leave their effects out of the model, or make the run that determines "
    "them. If only the effective sample sizes are too small, continue with `fit --resume`."
)
_FAILED_REMEDY = (
    "The usual cause is a mistake in the set-up: run `imubayes check`, and compare mountings, table angles, units, "
    "channels and files in campaign.toml with how the runs were made. No estimate of this fit can be used."
)


def failures(summary: Summary) -> tuple[str, ...]:
    """Return why a fit that reached a mode failed, a sentence for each reason, the clearest first."""
    estimates = [_implausible(found) for found in summary.implausible[:_MOST_NAMED]]
    channels = [_undescribed(found) for found in summary.unexplained[:_MOST_NAMED]]
    left = len(summary.implausible) + len(summary.unexplained) - len(estimates) - len(channels)
    return (*estimates, *channels, *([f"{left} more in summary.json."] if left else []))


def _implausible(found: ImplausibleEstimate) -> str:
    unit = "" if found.unit == "1" else f" {pretty(found.unit)}"
    estimate = f"{found.name} = {significant(found.value, 4)}{unit}"
    if found.reason == "outside_domain":
        ends = f"{significant(found.lowest)} to {significant(found.highest)}{unit}"
        return f"{estimate} is physically impossible (possible: {ends})."
    return f"{estimate} is {significant(found.distance, 2)} prior standard deviations from its prior" + (
        "." if found.prior_mean is None or found.prior_sd is None
        else f", {significant(found.prior_mean)} ± {significant(found.prior_sd)}{unit}."
    )  # fmt: skip


def _undescribed(found: UnexplainedOutput) -> str:
    unit = pretty(found.unit)
    return (
        f"The residuals of {found.channel} are {significant(found.residual, 2)} {unit} rms, "
        f"{significant(found.residual / found.noise, 2)} times the recorded noise; the outputs are "
        f"{significant(found.output, 2)} {unit} rms."
    )


def notices(summary: Summary) -> tuple[str, ...]:
    """Return what the intervals rest on besides the data."""
    suspected = summary.noise_suspected and not alarm_of(summary)
    noise = (_SUSPECTED.format(violation_text(summary.noise_suspected)),) if suspected else ()
    aside = (f"Set aside: {set_aside_text(each)}." for each in summary.set_aside)
    rests = (*left_out_lines(summary.left_out), *noise, *map(_rests_on_prior, summary.prior_scatter))
    return (*_of_population(summary), *aside, *rests)


def _of_population(summary: Summary) -> tuple[str, ...]:
    """Return where the priors come from if not from the user, after what contradicts them."""
    source = summary.provenance.priors_from if summary.provenance is not None else ""
    if not source:
        return ()
    unlike = [f"{each.name} is {each.distance:.1f} sd from its prior" for each in summary.prior_conflicts]
    conflict = (f"The unit differs from the units that its priors come from: {listed(unlike, 3)}.",) if unlike else ()
    return (*conflict, f"Priors are from {source}.")


def set_aside_text(found: SetAside) -> str:
    """Return which readings a model leaves out, and why."""
    channels = f" {listed(found.channels, 4)}" if found.channels else ""
    rows = f", row{'s' if found.rows[1:] else ''} {listed([str(row) for row in found.rows], 6)}" if found.rows else ""
    return f"run {found.run}{channels}{rows}: {found.reason}"


def left_out_lines(found: Sequence[SingleRunEffect]) -> tuple[str, ...]:
    """Return what a campaign of one run cannot determine of its channels, a line for each effect."""
    return tuple(
        f"{each.effect} is left out, because fewer than two runs contain {listed(each.channels, 4)}. The uncertainties "
        "are those within a run. Repeatability from run to run requires more runs, or a prior in the model."
        for each in found
    )


def exact_text(found: Sequence[UncertainEquipment]) -> str:
    """Return what is taken as exact and is not: each effect with its largest size, and where that comes from."""
    largest = {each.effect: each for each in sorted(found, key=lambda each: each.size)}
    return ", ".join(
        f"{each.effect.replace('_', ' ')} (u = {significant(each.size, 2)} {pretty(each.unit)}, "
        f"{'stated' if each.stated else 'assumed for normal gravity'})"
        for each in largest.values()
    )


def exact_lines(summary: Summary) -> tuple[str, ...]:
    """Return the line that says what the intervals take as exact of site and equipment; none if none matters."""
    effect = _gravity_text(summary)
    known = [each for each in summary.exact if each.stated or effect]
    if not known:
        return ()
    return (
        f"Taken as exact by the model: {exact_text(known)}. The uncertainties above do not include this; those of "
        f"`imubayes report`, `export` and `apply` do.{effect}",
    )


def _gravity_text(summary: Summary) -> str:
    """Return what gravity that nobody measured does to the scale factor that it widens most; empty if little."""
    size = next((each.size for each in summary.exact if each.effect == GRAVITY and not each.stated), 0.0)
    scales = [
        (each.sd / abs(each.mean) * 1e6, each.name)
        for each in summary.derived
        if family_of(each.name) == SCALE_FACTOR and each.unit.endswith(_PER_FORCE) and each.mean and each.sd
    ]
    own, name = min(scales, default=(math.inf, ""))
    whole = math.hypot(own, size)
    if not scales or whole <= _MATTERS * own:
        return ""
    own, whole = (significant(each, 2) for each in (own, whole))
    return f" There, the standard uncertainty of {name} is {whole} ppm instead of {own} ppm, if gravity determines it."


def disagreement_lines(summary: Summary, result: str = "") -> tuple[str, ...]:
    """Return the line that says which runs do not agree with the others; none if all do."""
    doubted = summary.doubted_runs
    if not doubted:
        return ()
    names = listed([f"run {each.run}" for each in doubted], _MOST_NAMED)
    verb, command = "does" if len(doubted) == 1 else "do", command_line("diagnose", *filter(None, [result]))
    said = f"{names[0].upper()}{names[1:]} {verb} not agree with the other runs at the noise known beforehand"
    causes = [agreement_text(each) for each in doubted[0].causes[:_MOST_NAMED]]
    if causes:
        return (
            f"{said}. Run {doubted[0].run} would agree given {'; or given '.join(causes)}: "
            f"{record_remedy(doubted[0].causes[0])}. `{command}` compares this with missing effects.",
        )
    return (
        f"{said} (p {relation(doubted[0].p)}): `{command}` names the entry of the record that would make it agree.",
    )


_SUSPECTED = "Suspected: {}. This may be chance. If it is not, the intervals are too narrow. Longer runs would decide."


def _rests_on_prior(found: PriorScatter) -> str:
    names = ", ".join(found.parameters[:_MOST_NAMED])
    more = " and others" if len(found.parameters) > _MOST_NAMED else ""
    return (
        f"{found.scale} depends on its prior ({percent(found.from_data)} from the data), and so do the "
        f"intervals of {names}{more}: the sd of {found.parameters[0]} is "
        f"{significant(found.factor)} times as large at the upper end of that prior as at the lower end. More runs, or "
        "a prior from earlier units, would determine it."
    )


SIGNIFICANT = 0.001


def share_of_freedom(summary: Summary) -> float:
    """Return the degrees of freedom per residual, between 0.1 and 1; 1 if there are no residuals."""
    count = sum(run.n for run in summary.runs)
    return min(max(summary.dof / count, 0.1), 1.0) if count and summary.dof else 1.0


def chi2_text(summary: Summary) -> str:
    """Return χ² at the noise as fitted, and beside it at the noise known beforehand if that was found."""
    fitted = "–" if summary.chi2 is None else f"{summary.chi2:.1f}"
    said, known = f"χ² {fitted} for {summary.dof:.0f} degrees of freedom", summary.known_noise
    if known is None:
        return said
    return f"{said} at the noise as fitted, {known.chi2:.1f} for {known.dof:.0f} at the noise known beforehand"


def tail(chi2: float, freedom: float) -> float:
    """Return the p-value of a χ²: of its upper tail, or minus that of the lower tail if this is smaller."""
    if not (math.isfinite(chi2) and freedom > 0):
        return math.nan
    above = float(chi2_survival(chi2, freedom))
    below = float(chi2_cdf(chi2, freedom))
    return above if above <= below else -below


def worst_first(summary: Summary) -> list[str]:
    """Return the names of the runs, the one with the least likely excess of χ² in a channel first."""
    share = share_of_freedom(summary)
    chance: dict[str, float] = {}
    for run in summary.runs:
        found = math.nan if run.chi2 is None else tail(run.chi2, share * run.n)
        chance[run.name] = min(chance.get(run.name, 1.0), found if found >= 0 else 1.0)
    return sorted(chance, key=chance.__getitem__)


def worst_channels(runs: Sequence[RunSummary], most: int) -> list[str]:
    """Return at most `most` channels, those of the largest χ²/n, in their own order."""
    channels = list(dict.fromkeys(run.channel for run in runs))

    def ratio(channel: str) -> float:
        own = [run for run in runs if run.channel == channel]
        return sum(run.chi2 or 0.0 for run in own) / max(sum(run.n for run in own), 1)

    ranked = sorted(channels, key=ratio, reverse=True)[:most]
    return [channel for channel in channels if channel in ranked]


def conflict_sheet(conflicts: Sequence[PriorConflict]) -> Sheet:
    """Return a table of priors that disagree with the data, with the lines to change below."""
    rows = []
    for conflict in conflicts:
        prior = value_and_sd(conflict.prior_mean, conflict.prior_sd)
        alone = value_and_sd(conflict.data_value, conflict.data_sd)
        posterior = value_and_sd(conflict.value, conflict.sd)
        texts = [conflict.name, *(" ± ".join(pair) for pair in (prior, alone, posterior)), pretty(conflict.unit)]
        decided = Cell(conflict.decided_by, "bad" if conflict.decided_by == "prior" else "")
        rows.append(cells(*map(Cell, texts), significant(conflict.distance, 2), decided))
    head = ("parameter", "prior", "data alone", "posterior", "unit", "distance, sd", "decided by")
    remedies = dict.fromkeys(map(remedy, conflicts))
    return Sheet("Prior and data disagree", head, rows, (0, 4, 6), note="\n".join(remedies))


def conflict_line(conflict: PriorConflict) -> str:
    """Return a sentence on a prior that disagrees with the data, and what to change."""
    alone, spread = value_and_sd(conflict.data_value, conflict.data_sd)
    mean, sd = value_and_sd(conflict.prior_mean, conflict.prior_sd)
    value, uncertainty = value_and_sd(conflict.value, conflict.sd)
    whose = "The prior decides" if conflict.decided_by == "prior" else "The prior is unusual for"
    return (
        f"{whose} {conflict.name} = {value} ± {uncertainty} {pretty(conflict.unit)}: the data alone give {alone} ± "
        f"{spread}, the prior is {mean} ± {sd}, {significant(conflict.distance, 2)} standard deviations apart. "
        f"{remedy(conflict)}"
    )


def remedy(conflict: PriorConflict) -> str:
    """Return which line of which file to change so that the data decide."""
    if conflict.stated_in == "campaign":
        owner = QuantityName.of(conflict.name).label
        return f"If the data are right, state a larger uncertainty of '{owner}' in campaign.toml."
    wider = conflict.wider or "a wider prior"
    return (
        f'If the data are right, widen the prior in the model file: [[effect]] name = "{conflict.effect}", '
        f'prior = {{ {conflict.parameter} = "{wider}" }}.'
    )
