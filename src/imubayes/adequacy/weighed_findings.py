"""Findings of the set-up check in the record of runs, weighed against the model of the user as well.

The check weighs a wrong record against plausible errors of a unit, a fit against its model.  Both weigh the same
hypotheses (`foundations.wrong_records`): if they name the same, one finding says so, and if they do not, it says
both.
"""

from collections.abc import Sequence
from dataclasses import replace

from imubayes.adequacy.adequacy_record import DoubtedRun
from imubayes.adequacy.weighed_records import doubted_runs
from imubayes.campaign import Inspection
from imubayes.campaign.stream_checks import Finding
from imubayes.foundations.wrong_records import WrongRecord, agreement_text, record_remedy
from imubayes.inference.fitted_model import Fit

_DOUBTED = "run_disagrees"


def weighed(inspection: Inspection, fitted: Fit) -> Inspection:
    """Return an inspection with its findings about the record of runs weighed against a model.

    Parameters
    ----------
    fitted : of the campaign as recorded, at its mode at least; nothing is weighed about a fit that stands nowhere.
    """
    if not fitted.optimised:
        return inspection
    doubted = {each.run: each for each in doubted_runs(fitted)}
    known = [run for finding in inspection.findings for run in _runs_of(finding)]
    said = [_beside(finding, doubted) for finding in inspection.findings]
    said += [_found(each) for each in doubted.values() if each.run not in known]
    issues, errors = inspection.issues, tuple(each for each in said if each.severity == "error")
    return replace(inspection, findings=tuple(said), issues=tuple(each.problem() for each in errors) or issues)


def _runs_of(finding: Finding) -> tuple[str, ...]:
    """Return the runs whose record a finding says is wrong."""
    record = finding.record
    return () if record is None else (record.run, *([record.other] if record.other else []))


def _beside(finding: Finding, doubted: dict[str, DoubtedRun]) -> Finding:
    """Return a finding about the record of a run with what the model says of the same run."""
    record = finding.record
    if record is None or record.row is not None:
        return finding
    own = next((doubted[run] for run in _runs_of(finding) if run in doubted), None)
    return replace(finding, what=f"{finding.what}; {_said(record, own, [*doubted])}")


def _said(record: WrongRecord, own: DoubtedRun | None, others: Sequence[str]) -> str:
    """Return what the model says of a run that the check doubts."""
    if own is None and others:
        return f"weighed against the model, run '{others[0]}' disagrees instead"
    if own is None:
        return "weighed against the model, the run agrees with the others as recorded"
    if not own.causes:
        return "weighed against the model, the run disagrees as well, and none of its entries explains this"
    best = own.causes[0]
    if any(record.agrees_with(each) for each in own.causes[1:]):
        return "weighed against the model, this agrees as well"
    if agreement_text(record) == agreement_text(best):
        return "a fit of the model gives the same"
    same = record.agrees_with(best)
    return f"a fit of the model gives {'' if same else 'instead '}{agreement_text(best)}"


def _found(doubted: DoubtedRun) -> Finding:
    """Return a run that only the model shows to disagree with the others."""
    causes = doubted.causes
    what = f"the other runs do not predict run '{doubted.run}' at the noise known beforehand"
    remedy = "`imubayes diagnose` weighs missing effects as well as wrong records, after a fit"
    if causes:
        given = ", or given ".join(agreement_text(each) for each in causes)
        what = f"run '{doubted.run}' would agree with the other runs given {given}"
        what += ", weighed against the model"
        remedy = f"{record_remedy(causes[0])}; {remedy}"
    return Finding(
        _DOUBTED, "warning", doubted.run, what, f"run '{doubted.run}'", "runs that agree under the model", remedy,
        causes[0] if causes else None,
    )  # fmt: skip
