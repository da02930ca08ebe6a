"""The first page: outcome, what stands against it, the facts of the test, and the limits at a glance."""

from collections.abc import Iterator, Mapping, Sequence

from imubayes.display.layout import Cell, Sheet, cells
from imubayes.display.numbers_and_labels import pretty, significant
from imubayes.foundations.quantity_names import family_of
from imubayes.foundations.wording import agreeing, counted
from imubayes_qualification.certificate import report_record as record
from imubayes_qualification.display.report import words
from imubayes_qualification.display.report.document import Banner, without_empty_columns
from imubayes_qualification.display.report.exact_tables import BESIDE, omitted_factor


def banner(report: record.QualificationReport) -> Banner:
    """Return the outcome in words and colour."""
    found, approximate = report.conformity, _approximate(report.convergence)
    if found is None:
        sentence = "This report states estimates with their uncertainty and contains no decision."
        return Banner("NO SPECIFICATION", sentence + approximate, "")
    word, mood = words.OUTCOMES[found.outcome]
    return Banner(word, _sentence(found) + approximate, mood)


def _approximate(convergence: record.ReportedConvergence) -> str:
    """Return that the numbers are of an approximation; nothing of a posterior that was sampled or is none."""
    if convergence.sampled or not convergence.converged:
        return ""
    return (
        " The posterior was not sampled: this report is based on its Laplace approximation. Confirm the "
        "numbers by sampling (`imubayes fit` without `--no-sample`)."
    )


def _sentence(found: record.Conformity) -> str:
    met = sum(limit.outcome in ("pass", "conditional_pass") for limit in found.limits)
    of = len(found.limits)
    those = f"{counted(of, 'limit')} of the specification “{found.specification}” {'is' if of == 1 else 'are'}"
    limits = f"{met} of {those} met under the decision rule."
    if not found.limits:
        return f"The limits of the specification “{found.specification}” could not be judged: the fit did not converge."
    if found.outcome == "withheld" and found.obstacles:
        return f"None of the limits of the specification “{found.specification}” can be met, for the reasons below."
    for reason, why in words.NO_DECISION.items():
        if undecided := [limit.name for limit in found.limits if limit.withheld == reason]:
            limits += f" There is no decision on {words.enumerated(undecided, 4)}: {why}."
    conditional = sum(limit.outcome.startswith("conditional") for limit in found.limits)
    if conditional:
        verb = agreeing(conditional, "is", "are")
        limits += f" {counted(conditional, 'result')} {verb} conditional: within U of the limit."
    return limits


def alarms(report: record.QualificationReport) -> list[str]:
    """Return what stands against the use of the numbers, most serious first; also if there is no specification."""
    convergence, adequacy = report.convergence, report.adequacy
    if not convergence.converged:
        return [words.OBSTACLES["not_converged"] + f" {convergence.message}", *_incomplete(report)]
    found = []
    if adequacy.verdict is None:
        found.append(words.OBSTACLES["not_diagnosed"])
    elif adequacy.verdict != "adequate":
        found.append(f"{words.OBSTACLES['inadequate_model']} Diagnosis: {words.VERDICTS[adequacy.verdict]}.")
    if not adequacy.intervals_valid:
        found.append(words.OBSTACLES["invalid_intervals"])
    if adequacy.prior_conflicts:
        names = words.enumerated([conflict.name for conflict in adequacy.prior_conflicts], 4)
        found.append(f"Priors and data disagree for {names}: see model adequacy.")
    if adequacy.set_aside:
        runs = words.enumerated(list(dict.fromkeys(each.run for each in adequacy.set_aside)), 4)
        found.append(f"Readings of {runs} are set aside: see model adequacy.")
    if any(each.item == "expired" for each in report.missing):
        found.append(words.OBSTACLES["expired_standard"])
    empty = [limit.name for limit in (report.conformity.limits if report.conformity else ()) if limit.accepts_nothing]
    if empty:
        found.append(f"No result could be accepted for {words.enumerated(empty, 4)}: {NO_ZONE} between the limits.")
    return [*found, *_incomplete(report)]


def _incomplete(report: record.QualificationReport) -> list[str]:
    """Return that what ISO/IEC 17025 requires of a certificate is missing, and that more is not in order."""
    if report.certificate is None:
        return []
    required = sum(each.required for each in report.missing)
    others = len(report.missing) - required
    found = []
    if required:
        named = counted(required, "more item")
        found.append(f"No certificate of an accredited laboratory: ISO/IEC 17025 requires {named}, listed at the end.")
    if others:
        found.append(f"Not in order: {counted(others, 'item')}, listed at the end.")
    return found


def facts(report: record.QualificationReport) -> list[tuple[str, str]]:
    """Return the facts of the first page."""
    subject, scope = report.subject, report.scope
    procedures = list(dict.fromkeys(run.procedure for run in subject.runs))
    when = "not recorded"
    if scope.first_start is not None and scope.last_start is not None:
        when = f"{_day(scope.first_start)} to {_day(scope.last_start)}"
    method = "sampled posterior" if report.convergence.sampled else "Laplace approximation of the posterior"
    versions = [f"; imubayes {each.version}" for each in report.provenance.software if each.package == "imubayes"]
    verdict = report.adequacy.verdict
    return [
        ("Unit", (subject.serial or "no serial number") + (f", {subject.grade} grade" if subject.grade else "")),
        ("Campaign", f"{subject.campaign}: {counted(len(subject.runs), 'run')}, {when}"),
        ("Procedures", ", ".join(name.replace("_", " ") for name in procedures)),
        ("Channels", ", ".join(f"{channel.name} ({channel.kind})" for channel in subject.channels)),
        ("Model", f"{report.provenance.model}, {counted(len(report.provenance.effects), 'effect')}"),
        ("Evaluation", "".join([_evaluation(report.convergence, method), *versions])),
        ("Converged", "yes" if report.convergence.converged else "NO"),
        ("Model adequacy", words.VERDICTS[verdict] if verdict is not None else "NOT DIAGNOSED"),
    ]


def _evaluation(convergence: record.ReportedConvergence, method: str) -> str:
    return f"{method}, {convergence.draws} draws" if convergence.draws else "none: there are no draws"


def _day(start: str) -> str:
    return start.partition("T")[0].partition(" ")[0]


def limits_table(
    limits: Sequence[record.LimitOutcome],
    components: Mapping[str, str] | None = None,
    reference: str = "",
) -> Sheet:
    """Return every limit with y ± U, conformance probability and decision.

    Parameters
    ----------
    components : quantity that is the length of a vector → its components as text.
    reference : T_ref, which holds if a limit has no range of temperatures.
    """
    rows = []
    for limit in limits:
        word, mood = words.OUTCOMES[limit.outcome]
        along = (components or {}).get(limit.name)
        rows.append(
            cells(
                _symbol(limit),
                limit.label,
                words.limits_text(limit),
                Cell(_where(limit, reference), formula=True),
                words.value_text(limit) + (f" ({along})" if along else ""),
                omitted_factor(limit.omitted_ratio),
                words.factor_text(limit),
                pretty(limit.unit),
                words.probability_text(limit.conformance),
                Cell(": ".join([word, *_why(limit)]), mood),
            )
        )
    sheet = Sheet(
        "Limits of the specification",
        ("quantity", "channel", "limits", "temperature / °C", "y ± U", BESIDE, "k", "unit", "p_c", "decision"),
        rows,
        (0, 1, 2, 3, 5, 7, 9),
        note="y ± U: estimate with expanded uncertainty U = k u of 95 % coverage, at the temperature of the range at "
        "which the quantity is worst; if the posterior is not symmetric, estimate [95 % interval]. For a direction "
        "error Θ or δ: the length of the mean vector, its shortest 95 % interval, and the two components. Over a "
        "range, y contains hysteresis and lag, and U contains the scatter between runs. At T_ref, y and U are those of "
        f"the mean over the runs. {BESIDE}: the factor by which contributions that it omits would multiply it, at the "
        "same temperature. "
        "p_c: conformance probability over the whole range (JCGM 106). "
        f"{words.digits_text(limits)}",
    )
    return without_empty_columns(sheet, BESIDE)


def _why(limit: record.LimitOutcome) -> Iterator[str]:
    """Yield why there is no decision, or why no result could be accepted."""
    if limit.withheld is not None:
        yield words.NO_DECISION[limit.withheld]
    if limit.accepts_nothing:
        yield NO_ZONE


NO_ZONE = "the guard band leaves no acceptance zone"


def _symbol(limit: record.LimitOutcome) -> Cell:
    return Cell(limit.symbol or limit.name, formula=limit.symbol not in ("", family_of(limit.name)))


def components_of(report: record.QualificationReport) -> dict[str, str]:
    """Return the components of the quantities of the standards that are lengths of vectors, as text."""
    own = {each.members[0]: each for each in report.standards if len(each.members) == 1}
    return {
        each.name: ", ".join(
            f"{own[member].symbol} {words.value_text(own[member])}" if member in own else f"{member} not measured"
            for member in each.members
        )
        for each in report.standards
        if each.vector
    }


def _where(limit: record.LimitOutcome, reference: str) -> str:
    if limit.temperature_range is None:
        return f"{reference.removesuffix(' °C')} (T_ref)" if reference.count("°C") == 1 else "T_ref"
    low, high = limit.temperature_range
    worst = "" if limit.temperature is None else f", worst {limit.temperature:g}"
    return f"{low:g} … {high:g}{worst}"


def rules_text(limits: Sequence[record.LimitOutcome]) -> list[str]:
    """Return each decision rule with the limits that it was applied to, a sentence each."""
    groups: dict[str, list[str]] = {}
    for limit in limits:
        symbol = limit.symbol or family_of(limit.name)
        groups.setdefault(f"{words.rule_text(limit)} ({words.RULE_MEANS[limit.rule]})", []).append(symbol)
    return [
        f"Decision rule: {rule}, for {', '.join(dict.fromkeys(symbols))} ({counted(len(symbols), 'limit')})."
        for rule, symbols in groups.items()
    ]


def _guard_text(limit: record.LimitOutcome, width: float) -> str:
    nothing = ", no acceptance zone" if limit.accepts_nothing else ""
    return f"{significant(width)} {pretty(limit.unit)}{nothing}"


def risk_table(limits: Sequence[record.LimitOutcome]) -> Sheet:
    """Return rule, guard band and risks of every limit, with the second method of each probability."""
    known = any(limit.global_consumer_risk is not None for limit in limits)
    rows = [
        cells(
            _symbol(limit),
            limit.label,
            words.rule_text(limit),
            "–" if limit.guard_band is None else _guard_text(limit, limit.guard_band),
            words.chance(limit.conformance.from_draws, limit.conformance.monte_carlo_error),
            words.chance(limit.conformance.from_quadrature, limit.conformance.monte_carlo_error),
            words.risk_text(limit.consumer_risk),
            words.risk_text(limit.producer_risk),
            *(map(words.probability_text, (limit.global_consumer_risk, limit.global_producer_risk)) if known else ()),
        )
        for limit in limits
    ]
    head = ["quantity", "channel", "rule", "guard band w", "conformance, draws", "conformance, quadrature"]
    head += ["consumer’s risk", "producer’s risk"]
    head += ["global consumer’s risk", "global producer’s risk"] if known else []
    return Sheet(
        "Decision rules and risks",
        head,
        rows,
        (0, 1, 2),
        note="Specific risks (JCGM 106, 9.3): of delivering a unit that is accepted and does not conform, and of "
        "rejecting one that conforms. Every probability is found twice, from the posterior draws and by "
        "quadrature over a distribution fitted to them; if the two differ by more than their errors allow, it is "
        "withheld. w = 0 is simple acceptance; U is half the length of the 95 % coverage interval.",
    )
