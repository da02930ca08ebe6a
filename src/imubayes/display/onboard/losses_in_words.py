"""Losses of a format, in sentences."""

from collections.abc import Sequence

from imubayes.errors import InputError, Issue
from imubayes.qualification.onboard_losses import Loss
from imubayes.qualification.onboard_record import OnboardConstants
from imubayes.units import BIAS_CONVENTION

PROGRAMS = {"c": "the C header", "kalibr": "kalibr", "px4": "PX4", "ardupilot": "ArduPilot"}
_WORDS = {
    "misalignment": "misalignment of the {triad}s: there is no matrix",
    "scale_factor": "scale factor errors of the {triad}s: there is no scale",
    "g_sensitivity": "g-sensitivity of the {triad}s",
    "gain_temperature": "temperature dependence of the {triad}s' gain",
    "bias_order": "terms of the {triad}s' bias beyond the third order in temperature",
    "converter_temperature": "dependence of the {triad}s' bias on the converter's temperature",
    "effect": "{effect} of the {triad}s",
}


def in_words(loss: Loss) -> str:
    """Return one loss: what it is and how large."""
    what = _WORDS[loss.kind].format(triad=loss.triad, effect=loss.effect)
    return f"{what}; up to {loss.size:.3g} ± {loss.sd:.2g} {loss.unit}"


def refuse_losses(found: Sequence[Loss], target: str, where: str) -> None:
    """Raise InputError with every significant loss."""
    significant = [loss for loss in found if loss.significant]
    if significant:
        raise InputError(
            Issue(
                f"{PROGRAMS[target]} cannot hold the {in_words(loss)}",
                where,
                "an error within its expanded uncertainty (k = 2)",
                "export as json, which holds all terms, or accept the errors with --accept-loss",
            )
            for loss in significant
        )


def heading(constants: OnboardConstants, found: Sequence[Loss]) -> list[str]:
    """Return what stands at the top of every file, one line each."""
    of = f"unit {constants.serial}" if constants.serial else f"campaign {constants.campaign}"
    lines = [
        f"Constants of {of}, model {constants.model}; imubayes {constants.version}.",
        f"Data {constants.data_sha256[:16]}, model {constants.model_sha256[:16]}.",
        "Uncertainties: one standard deviation of the joint posterior.",
        BIAS_CONVENTION,
    ]
    if not constants.intervals_valid:
        lines.append("CAUTION: the noise is not what the model assumes; the uncertainties are not valid.")
    if constants.not_determined:
        lines.append(f"Mostly from the prior, not from the data: {', '.join(constants.not_determined)}.")
    lines += [f"Left out: {in_words(loss)}." for loss in found]
    return lines


def yaml_number(value: float) -> str:
    """Return a number that YAML 1.1 reads as one: with a point, as in 1.0e-05; 1e-05 would be a text."""
    mantissa, mark, exponent = repr(float(value)).partition("e")
    return f"{mantissa}{'' if '.' in mantissa or not mark else '.0'}{mark}{exponent}"


def yaml_row(values: Sequence[float]) -> str:
    """Return a list of numbers for YAML."""
    return f"[{', '.join(map(yaml_number, values))}]"
