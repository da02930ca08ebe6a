"""How far the estimates of a result moved with a change of its model."""

from imubayes.json_record import Record
from imubayes.results.output_units import in_output_units
from imubayes.results.summary import ParameterSummary, Quantity, Summary


class EstimateChange(Record):
    """An estimate before and after a change of the model.

    Attributes
    ----------
    name, unit : of the quantity.
    before, sd_before, after, sd_after : estimate and standard uncertainty.
    in_sd : after less before, in the smaller of the two standard uncertainties.
    """

    name: str
    unit: str
    before: float
    sd_before: float
    after: float
    sd_after: float
    in_sd: float


def estimate_changes(before: Summary, after: Summary) -> tuple[EstimateChange, ...]:
    """Return the estimates that both results have, those that moved most first; nuisance parameters are left out."""
    known = {each.name: each for each in _of_interest(before)}
    pairs = [(known[each.name], each) for each in _of_interest(after) if each.name in known]
    moved = [change for was, now in pairs if (change := _change(was, now)) is not None]
    return tuple(sorted(moved, key=lambda change: -abs(change.in_sd)))


def _of_interest(summary: Summary) -> list[Quantity]:
    shown = in_output_units(summary)
    every = (*shown.parameters, *shown.derived)
    return [
        each
        for each in every
        if not (isinstance(each, ParameterSummary) and each.nuisance) and not each.repeats_misalignments
    ]


def _change(was: Quantity, now: Quantity) -> EstimateChange | None:
    """Return the change of one estimate; None of one that is exact or unknown."""
    if was.mean is None or now.mean is None or not was.sd or not now.sd:
        return None
    return EstimateChange(
        name=now.name,
        unit=now.unit,
        before=was.mean,
        sd_before=was.sd,
        after=now.mean,
        sd_after=now.sd,
        in_sd=(now.mean - was.mean) / min(was.sd, now.sd),
    )
