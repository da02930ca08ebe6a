"""A run that does not agree with the others, and what would make it agree, in sentences."""

from collections.abc import Sequence

from imubayes.criticism.disagreement_record import AgreeingInput, Disagreement
from imubayes.display.evidence_text import likely
from imubayes.display.labels import listed, pretty
from imubayes.display.rounding import significant, value_and_sd

_MOST = 3


def disagreement_text(found: Sequence[Disagreement], probability: float) -> str:
    """Return which run or row does not agree with the others, how probable that is, and what would make it agree."""
    return " ".join(_sentence(each, probability) for each in found)


def place_text(found: Disagreement) -> str:
    """Return a run, or a row of one, as it is named in a sentence."""
    return f"run {found.run}" if found.row is None else f"row {found.row} of run {found.run}"


def _sentence(found: Disagreement, probability: float) -> str:
    place, (adverb, chance) = place_text(found), likely(probability)
    said = (
        f"{place[0].upper()}{place[1:]}{adverb} does not agree with "
        f"{'the other runs' if found.row is None else 'the other rows'}{chance}."
    )
    best, *others = found.causes
    said += f" It would agree with {_cause(best, found)}."
    if others:
        said += f" It would agree as well with {'; or '.join(_cause(each, found) for each in others[:_MOST])}."
    if found.instead:
        said += f" Alternatively the record of {listed(list(found.instead), _MOST)} is wrong."
    return f"{said} Correct the record, or leave the {'run' if found.row is None else 'row'} out, and fit again."


def _cause(each: AgreeingInput, found: Disagreement) -> str:
    """Return what would make a run agree."""
    unit = f" {pretty(each.unit)}" if each.unit not in ("", "1") else ""
    pairs = [value_and_sd(value, sd) for value, sd in zip(each.agreeing, each.sd, strict=True)]
    sizes = ", ".join(f"{value} ± {sd}" for value, sd in pairs)
    if each.form == "seat":
        return f"the unit turned in its mounting by ({sizes}){unit} about its axes"
    if each.form == "output_offset":
        which = "outputs of every channel" if len(pairs) > 1 else f"output of {each.quantity}"
        return f"its {which} changed by ({sizes}){unit}"
    if each.form == "factor":
        return f"{each.quantity} times {sizes}, all rows alike"
    if each.form == "output_factor":
        return f"its outputs times {sizes}"
    recorded = significant(each.recorded, 5)
    if found.row is not None:
        return f"{each.quantity} = {sizes}{unit} (recorded: {recorded})"
    return f"{each.quantity} about {sizes}{unit} on average (recorded: {recorded})"
