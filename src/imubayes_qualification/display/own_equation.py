"""Results of `propagate`, `budget`, `conformity` and `selftest`, as tables."""

import math
import platform
from collections.abc import Sequence
from datetime import UTC, datetime

from imubayes.display.layout import Cell, Report, Sheet, cells
from imubayes.display.numbers_and_labels import percent, rounded, significant
from imubayes.foundations.records import Record
from imubayes.results.fit_file import software
from imubayes.results.summary import SoftwareVersion
from imubayes_qualification.certificate.value_conformity import ConformityStatement
from imubayes_qualification.evaluation.known_answers import KnownAnswer
from imubayes_qualification.evaluation.law_of_propagation import GumBudget
from imubayes_qualification.evaluation.propagation import OutputQuantity, Propagated


def propagated_report(found: Propagated) -> Report:
    """Return the outputs by both methods, with the budget of each."""
    rows = []
    for each in found.outputs:
        rows += [cells(*_by_draws(each)), cells(*_by_law(each.gum))]
    p = f"{100 * found.probability:g} %"
    head = ("output", "method", "y", "u", f"{p} interval", f"shortest {p} interval")
    agrees = [each.name for each in found.outputs if each.gum_agrees]
    note = f"{len(found.draws)} draws" + ("" if found.stable else ", TOO FEW for these digits")
    note += f". The law of propagation is valid for {', '.join(agrees) or 'no output'} (JCGM 101, 8)."
    sheets = [Sheet("Propagation of uncertainty", head, rows, (0, 1), note=note)]
    return Report((), [*sheets, *(budget_sheet(each.gum) for each in found.outputs)])


def _by_draws(found: OutputQuantity) -> Sequence[str]:
    low, high = found.interval
    y, u, *ends = rounded((found.value, found.uncertainty, low, high, *found.shortest), found.uncertainty)
    return found.name, "Monte Carlo", y, u, f"{ends[0]} … {ends[1]}", f"{ends[2]} … {ends[3]}"


def _by_law(gum: GumBudget) -> Sequence[str]:
    u, half = gum.uncertainty, gum.expanded_uncertainty
    y, sd, low, high = rounded((gum.value, u, gum.value - half, gum.value + half), u)
    return "", "GUM", y, sd, f"{low} … {high}", ""


def budget_sheet(found: GumBudget) -> Sheet:
    """Return the uncertainty budget of an output."""
    rows = [
        cells(
            each.input, *rounded((each.value, each.uncertainty), each.uncertainty or None), each.distribution,
            each.type, _degrees(each.degrees_of_freedom), significant(each.sensitivity),
            significant(each.contribution, 2), percent(each.share)
        )
        for each in found.lines
    ]  # fmt: skip
    head = ("input", "x", "u(x)", "distribution", "type", "ν", "∂f/∂x", "|∂f/∂x| u(x)", "share")
    y, u, half = rounded((found.value, found.uncertainty, found.expanded_uncertainty), found.uncertainty)
    second = "the series of second order does not converge"
    if found.second_order_value is not None and found.second_order_uncertainty is not None:
        with_it = rounded((found.second_order_value, found.second_order_uncertainty), found.second_order_uncertainty)
        second = f"with the terms of second order {found.name} = {with_it[0]}, u = {with_it[1]}"
    note = (
        f"{found.name} = {y}, u = {u}, ν = {_degrees(found.degrees_of_freedom)}, k = {found.coverage_factor:.3g}, "
        f"U = {half} ({100 * found.probability:g} %); {second}."
    )
    return Sheet(f"Budget of {found.name}", head, rows, (0, 3, 4), note=note)


def _degrees(value: float) -> str:
    return "∞" if math.isinf(value) else f"{value:.3g}"


def conformity_report(found: ConformityStatement) -> Report:
    """Return the decision, with what it rests on."""
    low, high = (None if math.isinf(end) else end for end in found.limits)
    listed = [
        ("y ± U", " ± ".join(rounded((found.value, found.expanded), found.expanded))),
        ("limits", f"{significant(low, 6)} … {significant(high, 6)}"),
        ("rule", found.rule.name.replace("_", " ")),
        ("guard band w", significant(found.guard_band)),
        ("conformance probability", significant(found.conformance, 4)),
        ("consumer's risk", significant(found.consumer_risk, 2)),
        ("producer's risk", significant(found.producer_risk, 2)),
        ("global consumer's risk", significant(found.global_consumer_risk, 2)),
        ("global producer's risk", significant(found.global_producer_risk, 2)),
    ]
    sheet = Sheet(found.outcome.replace("_", " ").upper(), ("", ""), [cells(*line) for line in listed], (0,))
    return Report((), [sheet])


def propagated_headline(found: Propagated) -> str:
    """Return the outputs in one line."""
    listed = [
        " ± ".join((f"{each.name} = {y}", u))
        for each in found.outputs
        for y, u in (rounded((each.value, each.uncertainty), each.uncertainty),)
    ]
    return f"<Propagated {', '.join(listed)}>"


def budget_headline(found: GumBudget) -> str:
    """Return the output with its expanded uncertainty."""
    y, half = rounded((found.value, found.expanded_uncertainty), found.expanded_uncertainty)
    return f"<GumBudget {found.name} = {y} ± {half}, k = {found.coverage_factor:.3g}>"


def conformity_headline(found: ConformityStatement) -> str:
    """Return the decision in one line."""
    return f"<ConformityStatement {found.outcome.replace('_', ' ')}, p_c {significant(found.conformance, 3)}>"


def selftest_report(record: "Selftest") -> Report:
    """Return every known answer beside the value of this installation."""
    answers, rows = record.answers, []
    for each in answers:
        known, found = f"{each.known:.7g}", f"{each.found:.7g}"
        verdict = Cell("agrees") if each.agrees else Cell("DIFFERS", "bad")
        rows.append(cells(each.subject, each.source, known, found, f"{each.allowed:.1g}", verdict))
    wrong = sum(not each.agrees for each in answers)
    alarm = f"{wrong} of {len(answers)} values DIFFER: do not use this installation for measurements" if wrong else ""
    head = ("quantity", "source", "known", "found", "allowed", "")
    note = "Allowed: half of the last published digit, or the error that the number of draws and the optimiser allow."
    versions = ", ".join(f"{each.package} {each.version}" for each in record.software)
    lines = [f"{record.date:%Y-%m-%d %H:%M} UTC, {record.machine}: {versions}."]
    return Report(lines, [Sheet("Known answers", head, rows, (0, 1, 5), note=note).with_few(0, 2, 3, 5)], alarm=alarm)


class Selftest(Record):
    """The known answers with what computed them, where and when: what `imubayes selftest --json` prints."""

    software: tuple[SoftwareVersion, ...]
    machine: str
    date: datetime
    answers: tuple[KnownAnswer, ...]


def selftest_record(answers: Sequence[KnownAnswer]) -> Selftest:
    """Return the known answers with versions, machine and date."""
    machine, now = f"{platform.system()} {platform.machine()}", datetime.now(UTC)
    return Selftest(software=software(), machine=machine, date=now, answers=tuple(answers))
