"""The odds of effects that are removed, from the diagnosis that found them: the reverse of adding them."""

import math
from collections.abc import Collection

from imubayes.criticism.evidence.evidence_record import EffectSlot, Evidence


def removal_log_odds(found: Evidence, removed: Collection[str], kept: Collection[str]) -> float | None:
    """Return the natural logarithm of the odds of a model with effects against the one without them.

    Where an effect that stays may stand in the place of one that goes, the odds are those between the two.

    Parameters
    ----------
    found : of the diagnosis of a model that had none of the effects.
    removed, kept : effects that go, and that the model keeps.

    Returns
    -------
    None where the likeliest explanation does not name them all.
    """
    total, told = 0.0, set()
    for slot in found.slots:
        names = {each.effect for each in slot.candidates}
        if names & set(removed):
            told |= names & set(removed)
            total += _slot_log_odds(slot, removed, kept)
    return total if told and told == set(removed) and math.isfinite(total) else None


def _slot_log_odds(slot: EffectSlot, removed: Collection[str], kept: Collection[str]) -> float:
    gone, stay = (
        sum(each.probability for each in slot.candidates if each.effect in names) for names in (removed, kept)
    )
    if not stay:
        return slot.gain
    return math.log(gone / stay) if gone else -math.inf
