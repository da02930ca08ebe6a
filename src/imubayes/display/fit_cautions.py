"""What has to be known before the numbers of a fit are used, in sentences."""

from collections.abc import Sequence

from imubayes.display.labels import listed, pretty
from imubayes.display.noise_violation_text import contradiction_text, violation_text
from imubayes.display.rounding import percent, relation, significant
from imubayes.inference.implausible_record import ImplausibleEstimate, UnexplainedOutput
from imubayes.model.model_spec import SingleRunEffect
from imubayes.results.summary import PriorScatter, Summary

_MOST_NAMED = 3


def alarm_of(summary: Summary) -> str:
    """Return the warning that precedes everything else; empty where the intervals of the fit can be trusted."""
    if summary.implausible or summary.unexplained:
        return " ".join(("FIT FAILED.", *failures(summary), _FAILED_REMEDY))
    if not summary.converged:
        said = f"NOT CONVERGED. {summary.message.strip() or 'The numbers below must not be used.'}"
        return f"{said} {_SAMPLING_REMEDY}" if summary.sampled else said
    contradicted = [contradiction_text(summary.noise_contradicted)] if summary.noise_contradicted else []
    causes = "; ".join([*contradicted, *([violation_text(summary.noise_violations)] * bool(summary.noise_violations))])
    return f"DO NOT TRUST THE INTERVALS: {causes}. `imubayes diagnose` looks for the cause." if causes else ""


def next_command(summary: Summary, campaign: str, folder: str) -> str:
    """Return the command to run after a fit: what looks for the cause of its warning, or the look at the residuals."""
    if summary.implausible or summary.unexplained or not (summary.converged or summary.sampled):
        return f"imubayes check {campaign}"
    doubted = summary.noise_violations or summary.noise_contradicted or not summary.converged
    return f"imubayes {'diagnose' if doubted else 'compare'} {folder}"


_SAMPLING_REMEDY = (
    "`imubayes diagnose` and `add` need no draws: they work about the mode. Where weights or ensembles disagree, give "
    "what is weakly determined a tighter prior, leave its effect out of the model, or take the run that determines it; "
    "where sizes are small, go on with `fit --resume`."
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
        f"The outputs of {found.channel} differ from the model by {significant(found.residual, 2)} {unit} rms, "
        f"{significant(found.residual / found.noise, 2)} times their recorded noise, of {significant(found.output, 2)} "
        f"{unit} in all."
    )


def notices(summary: Summary) -> tuple[str, ...]:
    """Return what the intervals rest on besides the data."""
    suspected = summary.noise_suspected and not alarm_of(summary)
    noise = (_SUSPECTED.format(violation_text(summary.noise_suspected)),) if suspected else ()
    return (*left_out_lines(summary.left_out), *noise, *map(_rests_on_prior, summary.prior_scatter))


def left_out_lines(found: Sequence[SingleRunEffect]) -> tuple[str, ...]:
    """Return what a campaign of one run cannot tell of its channels, a line for each effect."""
    return tuple(
        f"{each.effect} is left out, with one run of {listed(each.channels, 4)}: uncertainties hold within that run "
        "and do not include repeatability from run to run, which more runs, or a prior of it in the model, would tell."
        for each in found
    )


def disagreement_lines(summary: Summary, result: str = "") -> tuple[str, ...]:
    """Return the line that says which runs do not agree with the others; none where all do."""
    doubted = summary.doubted_runs
    if not doubted:
        return ()
    names = listed([f"run {each.run}" for each in doubted], _MOST_NAMED)
    verb, command = "does" if len(doubted) == 1 else "do", f"imubayes diagnose {result}".rstrip()
    return (
        f"{names[0].upper()}{names[1:]} {verb} not agree with the other runs at the noise known before the fit "
        f"(p {relation(doubted[0].p)}): `{command}` says what in the record would make it agree.",
    )


_SUSPECTED = "Suspected: {}. This may be chance; if it is not, the intervals are too narrow. Longer runs would tell."


def _rests_on_prior(found: PriorScatter) -> str:
    names = ", ".join(found.parameters[:_MOST_NAMED])
    more = " and others" if len(found.parameters) > _MOST_NAMED else ""
    return (
        f"{found.scale} is known mostly from its prior ({percent(found.from_data)} from the data), and the "
        f"intervals of {names}{more} depend on it: the sd is {significant(found.factor)} times larger at the upper end "
        "of that prior than at the lower. More runs, or a prior from experience, would settle it."
    )
