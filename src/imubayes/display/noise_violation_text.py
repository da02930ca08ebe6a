"""How the noise departs from its model, and from what is known of it beforehand, in words."""

from collections.abc import Sequence

from imubayes.adequacy.adequacy_record import NoiseComparison, NoiseViolation
from imubayes.display.labels import listed, pretty
from imubayes.display.rounding import relation, significant, value_and_sd

_WORDS = {
    "autocorrelation": "the residuals are autocorrelated",
    "low_frequency": "the residuals drift within runs",
    "scatter_between_runs": "runs scatter more than the noise within them",
    "grows_with_input": "the noise grows with the input",
    "heavy_tails": "the noise has heavy tails or outliers",
    "quantisation": "the output is quantised too coarsely for its noise",
}
_MOST_NAMED = 3


def violation_text(violations: Sequence[NoiseViolation]) -> str:
    """Return each kind of violation with its channels and evidence, separated by semicolons."""
    kinds = dict.fromkeys(violation.kind for violation in violations)
    return "; ".join(_one_kind([each for each in violations if each.kind == kind]) for kind in kinds)


def _one_kind(violations: Sequence[NoiseViolation]) -> str:
    first, said = violations[0], _WORDS[violations[0].kind]
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
    meaning = f"scatter {where} stands in for something that the model lacks"
    if own[0].source == "samples":
        meaning += ", an effect or noise slower than a row"
    elif not any(each.excessive and each.source == "sisters" for each in own):
        meaning += ", or the prior is too narrow for this unit"
    more = f"; {listed(others, _MOST_NAMED)} likewise" if others else ""
    return f"{worst}, {significant(own[0].fitted)} {pretty(own[0].unit)}, is {factors}: {meaning}{more}"


def _factor(each: NoiseComparison) -> str:
    if each.source == "samples":
        return f"{noise_ratio(each)} times what the raw samples of the same rows say"
    if each.source == "sisters":
        # Not the scales are compared: that of a sister may be zero.
        by = "means of their runs" if each.between_runs else "scatter of their rows"
        return f"{significant(each.ratio, 2)} times that of {' and '.join(each.sisters)} by the {by}"
    return f"{significant(each.ratio, 2)} times the scale of its prior"


def noise_ratio(each: NoiseComparison) -> str:
    """Return fitted over known noise with its standard uncertainty."""
    value, sd = value_and_sd(each.ratio, each.ratio_sd)
    return f"{value} ± {sd}"
