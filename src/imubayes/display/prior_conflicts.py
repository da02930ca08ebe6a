"""Parameters whose prior disagrees with the data, in words and as a table, with the line of the file to change."""

from collections.abc import Sequence

from imubayes.display.labels import pretty
from imubayes.display.rounding import significant, value_and_sd
from imubayes.display.table_layout import Cell, Sheet
from imubayes.inference.prior_conflict import PriorConflict


def conflict_sheet(conflicts: Sequence[PriorConflict]) -> Sheet:
    """Return a table of priors that disagree with the data, with the lines to change below."""
    rows = []
    for conflict in conflicts:
        prior = value_and_sd(conflict.prior_mean, conflict.prior_sd)
        alone = value_and_sd(conflict.data_value, conflict.data_sd)
        posterior = value_and_sd(conflict.value, conflict.sd)
        texts = [conflict.name, *(" ± ".join(pair) for pair in (prior, alone, posterior)), pretty(conflict.unit)]
        decided = Cell(conflict.decided_by, "bad" if conflict.decided_by == "prior" else "")
        rows.append((*map(Cell, texts), Cell(significant(conflict.distance, 2)), decided))
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
        f"{whose} {conflict.name} = {value} ± {uncertainty} {pretty(conflict.unit)}: the data alone ask for {alone} ± "
        f"{spread}, the prior is {mean} ± {sd}, {significant(conflict.distance, 2)} standard deviations apart. "
        f"{remedy(conflict)}"
    )


def remedy(conflict: PriorConflict) -> str:
    """Return which line of which file to change so that the data decide."""
    if conflict.stated_in == "campaign":
        owner = conflict.name[conflict.name.index("[") + 1 : -1]
        return f"If the data are right: campaign.toml, a larger uncertainty of '{owner}'."
    wider = conflict.wider or "a wider prior"
    return (
        f'If the data are right: model file, [[effect]] name = "{conflict.effect}", '
        f'prior = {{ {conflict.parameter} = "{wider}" }}.'
    )
