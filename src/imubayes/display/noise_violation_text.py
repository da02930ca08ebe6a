"""How the noise departs from its model, in words."""

from collections.abc import Sequence

from imubayes.criticism.noise_violation import NoiseViolation
from imubayes.display.rounding import relation, significant

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
