"""The judgement of a set-up: the mistakes that explain its outputs, or the runs that nothing explains, as findings.

The misfit of the linear model of plausible errors identifies a campaign without gross mistakes.  There only those
mistakes are tried that such errors could conceal.  The findings say what is wrong, by how much, and what to correct.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from imubayes.campaign.setup_gate.catalogue import MISTAKES
from imubayes.campaign.setup_gate.equipment_mistakes import DECISIVE, TableZero
from imubayes.campaign.setup_gate.explanations import Explanation, equally_good
from imubayes.campaign.setup_gate.places import Places
from imubayes.campaign.setup_gate.rate_records import RatesMissing
from imubayes.campaign.setup_gate.rows_in_motion import steady_rows, without_motion
from imubayes.campaign.setup_gate.search import MOST_MISTAKES, Search
from imubayes.campaign.setup_gate.setup_view import feels_the_earth_alone
from imubayes.campaign.setup_gate.steadiness import hidden_mistakes, noise_as_rival, sized
from imubayes.campaign.setup_gate.wrong_rows import WrongRow, with_rows, wrong_rows
from imubayes.campaign.stream_checks import Finding, Severity
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.deferred_modules import DeferredModule
from imubayes.foundations.errors import Issue
from imubayes.foundations.wrong_records import WrongRecord, agreement_text, record_remedy

if TYPE_CHECKING:
    from imubayes.campaign.setup_gate import record_remedies, remedies
else:  # words for mistakes that are found
    record_remedies = DeferredModule("imubayes.campaign.setup_gate.record_remedies")
    remedies = DeferredModule("imubayes.campaign.setup_gate.remedies")


@dataclass(frozen=True)
class Judgement:
    """Outcome of the search.

    Attributes
    ----------
    mistakes : each with its equally good explanations, the best first; empty if there is none.
    misfit : of the set-up as stated, per output.
    unexplained : run → misfit per output of the runs that disagree, if no mistake explains it.
    nearest : a mistake whose correction takes most of the misfit away, and does not let the campaign agree.
    """

    mistakes: tuple[tuple[Explanation, ...], ...] = ()
    misfit: float = 0.0
    unexplained: tuple[tuple[str, float], ...] = ()
    nearest: Explanation | None = None


def judge_setup(campaign: Campaign) -> Judgement:
    """Return the mistakes in the set-up of a campaign, if its outputs show any."""
    search = Search(campaign)
    if not search.views or not search.total.values:
        return Judgement()
    # Of tumbles a steady gyro distinguishes one mistake from another if a poor one does not.
    tumbled = feels_the_earth_alone(campaign, search.views)
    tumbled = tumbled and not list(RatesMissing.suspected(campaign, search.views))
    ordinary = search.agrees
    single = [] if ordinary or tumbled else search.several_mistakes(1)
    noisy = bool(single) and not _more_than_noise(search, single)
    if single and not noisy and (possible := _sized(campaign, single[0])):
        return Judgement((possible,), search.misfit)
    if (hidden := hidden_mistakes(campaign)) and (possible := _sized(campaign, equally_good(hidden, DECISIVE))):
        return Judgement((possible,), search.misfit)
    if ordinary:
        return Judgement((), search.misfit)
    if not noisy and (found := _several(search)):
        return Judgement(found, search.misfit)
    return Judgement(misfit=search.misfit, unexplained=tuple(search.disagreements()), nearest=search.nearest)


def _several(search: Search) -> tuple[tuple[Explanation, ...], ...]:
    """Return the mistakes that explain the outputs together, and more than larger noise would; empty without any."""
    found = search.several_mistakes(MOST_MISTAKES)
    return tuple(found) if found and _more_than_noise(search, found) else ()


def _more_than_noise(search: Search, found: Sequence[tuple[Explanation, ...]]) -> bool:
    """Whether mistakes explain more than larger noise would."""
    noise = noise_as_rival(search.model, search.views, search.model.estimates(search.total))
    noisy = Search(search.campaign, noise, search.views)
    return sum(equal[0].gain for equal in found) > search.stated - noisy.stated + DECISIVE


def _sized(campaign: Campaign, equal: tuple[Explanation, ...]) -> tuple[Explanation, ...]:
    """Return explanations with their sizes, without those of sizes that cannot be."""
    found = [sized(campaign, each) for each in equal]
    return tuple(each for each in found if each.mistake.possible(each.size))


_FOLLOWING = "outputs that follow the nominal input"
_MOST_RUNS = 5
_MOST_ALTERNATIVES = 5


def setup_findings(campaign: Campaign, places: Places, accepted: tuple[str, ...]) -> list[Finding]:
    """Return what the outputs say against the set-up of a campaign.

    Parameters
    ----------
    places : where what is said stands in the files.
    accepted : names of findings that the campaign accepts; they are warnings.
    """
    rows = wrong_rows(without_motion(campaign))
    campaign = steady_rows(campaign)
    said = [_of_row(campaign, each, places) for each in rows]
    judged = judge_setup(with_rows(campaign, rows))
    for equal in judged.mistakes:
        said.append(_explained(campaign, equal, places, accepted))
        campaign = remedies.with_scale(campaign, equal[0])
    if judged.mistakes:
        return said
    return [
        *said,
        *([] if judged.nearest is None else [_not_explained(campaign, judged.nearest, places)]),
        *(_unexplained(name, misfit, places.table(name)) for name, misfit in judged.unexplained[:_MOST_RUNS]),
    ]


def _of_row(campaign: Campaign, found: WrongRow, places: Places) -> Finding:
    """Return a row whose record is wrong, with what else would agree."""
    records = [each.wrong_record(campaign) for each in (found, *found.rivals)]
    best = records[0]
    given = ", or given ".join(map(agreement_text, records))
    what = f"row {best.row} of run '{best.run}' would agree with the other rows given {given}: "
    what += f"as recorded, it is off by {found.distance:.2g} standard deviations of the other rows"
    where = f"{places.table(found.run)}, row {best.row}, column '{best.quantity}'"
    return Finding(
        "row_disagrees", "warning", found.run, what, where, "the entries of that row", record_remedy(best), best
    )


def _explained(
    campaign: Campaign, equal: tuple[Explanation, ...], places: Places, accepted: tuple[str, ...]
) -> Finding:
    records = [each.mistake.wrong_record(campaign, each.size, each.uncertainty) for each in equal]
    found = [
        (each.mistake.kind, _words(campaign, each, record, places)) for each, record in zip(equal, records, strict=True)
    ]
    run = equal[0].mistake.scope.name if equal[0].mistake.scope.section == "run" else ""
    first, words, others = equal[0], found[0][1], [each for _, each in found[1:]]
    others = others[:_MOST_ALTERNATIVES]
    what = ", or ".join([words.what, *(each.what for each in others)])
    evidence = f"{'each of them' if others else 'this'} fits the outputs far better (Δχ² {first.gain:.3g})"
    if first.rivalled:
        evidence += f", but the outputs do not distinguish it from {first.mistake.passes_for}"
    remedy = words.remedy
    if others:
        what = f"the data cannot determine which of these is the mistake: {what}"
        remedy += " (or: " + "; or: ".join(each.remedy for each in others) + ")"
    what += f"{';' if others else ':'} {evidence}"
    # Weaker evidence is said and stops nothing.
    sure = _stops(equal) and not {kind for kind, _ in found} & {*accepted}
    severity: Severity = "error" if sure else "warning"
    if sure:
        remedy += f'; if the record is right, write accepted = ["{first.mistake.kind}"] in campaign.toml'
    return Finding(
        first.mistake.kind, severity, run, what, words.where, words.allowed, remedy, records[0]
    )  # fmt: skip


def _words(campaign: Campaign, found: Explanation, record: WrongRecord | None, places: Places) -> Issue:
    """Return a mistake in words: those of a wrong record, or of its kind; angles of a run are off by their zero."""
    if record is None or found.mistake.kind == TableZero.kind:
        return remedies.REMEDIES[found.mistake.kind](campaign, found, places)
    return record_remedies.issue_of(found, record, places)


def _stops(equal: tuple[Explanation, ...]) -> bool:
    """Whether a mistake is supported well enough to stop a fit, and no explanation is one of a poor unit."""
    first = equal[0]
    sure = first.support > first.stopping and not first.rivalled
    return sure and all(each.mistake.stops(each.size) for each in equal)


def _not_explained(campaign: Campaign, nearest: Explanation, places: Places) -> Finding:
    """Return that the mistake that comes nearest was corrected, and the campaign does not agree with that."""
    record = nearest.mistake.wrong_record(campaign, nearest.size, nearest.uncertainty)
    words = _words(campaign, nearest, record, places)
    what = (
        f"the nearest mistake does not explain the outputs: {words.what}.  With that corrected they differ by about "
        f"{math.sqrt(nearest.misfit):.2g} times the amount that errors of unit and equipment allow"
    )
    run = nearest.mistake.scope.name if nearest.mistake.scope.section == "run" else ""
    remedy = "check mounting, table, units and files: several of them may be wrong"
    return Finding(
        "setup_disagrees", "warning", run, what, words.where, "outputs that follow the nominal input", remedy
    )


def _unexplained(run: str, misfit: float, where: str) -> Finding:
    what = (
        f"the outputs differ from the prediction of the set-up by about {math.sqrt(misfit):.2g} times the amount that "
        "errors of unit and equipment allow, and no single mistake in the set-up explains this"
    )
    remedy = "check mounting, table, units and files of the run"
    return Finding("setup_disagrees", "warning", run, what, where, _FOLLOWING, remedy)


SETUP_FINDINGS = tuple(dict.fromkeys(each.kind for each in MISTAKES))
"""Names of the findings about the set-up that a campaign can accept."""
