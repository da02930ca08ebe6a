"""A fit as a report: for the terminal, and as self-contained HTML for a notebook.

The HTML has no scripts, links or external styles; all text is escaped.
"""

from imubayes.display import fit_cautions as cautions
from imubayes.display import fit_quality_tables as quality
from imubayes.display import quantity_tables as quantities
from imubayes.display.layout import Report, Sheet, render
from imubayes.display.numbers_and_labels import listed, percent
from imubayes.foundations.wording import counted
from imubayes.results.summary import FitProvenance, Summary

_FEW_COMBINATIONS = 8
_MOST_DIGITS = 12  # of a hash


def summary_report(summary: Summary, verbose: bool = False) -> Report:
    """Return the calibration of each channel and the mounting angles; every table if `verbose`."""
    of_channels = quantities.calibration_sheets(summary)
    sheets: list[Sheet | quantities.CalibrationSheet] = [*of_channels, quantities.axis_sheet(summary)]
    in_sheets = {entry.name for sheet in of_channels for *_, own in sheet.rows for entry in own.values()}
    equipment = quantities.equipment_sheet(summary, in_sheets)
    brief = (
        equipment,
        quantities.scale_and_angle_sheet(summary),
        quality.combination_sheet(summary, _FEW_COMBINATIONS, standard=True),
    )
    sheets += every_table(summary, nuisance=True) if verbose else brief
    sheets += [cautions.conflict_sheet(summary.prior_conflicts)]
    weak = () if verbose else weak_lines(summary)
    meaning = f"Intervals are {summary.interval}. " if verbose else ""
    drawing = "sampling" if summary.sampled else "draws"
    closing = (
        f"{_outcome(summary)} {cautions.chi2_text(summary)}. "
        f"Fit {summary.seconds.fit:.1f} s, {drawing} {summary.seconds.sample:.1f} s. "
        f"{meaning}Uncertainty: {summary.uncertainty if verbose else 'posterior standard deviation'}."
    )
    # A warning stands on the first line, above the first table; nothing comes before it.
    said, alarm = cautions.notices(summary), cautions.alarm_of(summary)
    closings = (*weak, *cautions.disagreement_lines(summary), *cautions.exact_lines(summary), closing)
    if not alarm:
        return Report(said, sheets, closings)
    quiet = [sheet.changed(alarm="") if isinstance(sheet, Sheet) else sheet for sheet in sheets]
    return Report((), quiet, (*said, *closings), alarm)


def every_table(summary: Summary, nuisance: bool) -> list[Sheet]:
    """Return every table of a fit, the parameters first, with the nuisance parameters if asked for."""
    return [
        quantities.parameter_sheet(summary, nuisance=nuisance),
        quantities.derived_sheet(summary),
        quality.run_sheet(summary),
        quality.combination_sheet(summary),
        quality.weak_sheet(summary),
        quality.next_run_sheet(summary),
        quality.contribution_sheet(summary),
    ]


def weak_lines(summary: Summary) -> tuple[str, ...]:
    """Return what is not or weakly determined, the run that would determine most of it, and where the tables are."""
    loose = [
        entry.name
        for entry in summary.parameters
        if quantities.is_undetermined(entry) and not quantities.is_nuisance(entry)
    ]
    confused = [quality.weak_text(found) for found in summary.weak_directions if found.kind == "confusion"]
    weak = len(summary.weak_directions) - len(confused)
    least = percent(quality.NOT_DETERMINED)
    said = [f"{quantities.MARK} Not determined (less than {least} from the data): {listed(loose)}."] * bool(loose)
    said += [f"Not separated: {listed(confused, 2)}."] * bool(confused)
    sums = len(summary.combinations)
    determined = f" They determine {counted(sums, 'sum')} much better than the single parameters." if sums else ""
    said += [f"The data determine {counted(weak, 'combination')} of parameters weakly.{determined}"] * bool(weak)
    if summary.next_runs:
        first = summary.next_runs[0]
        said.append(
            f"Next run: {quality.run_design_text(first.run)} ({first.quantity}: sd {quality.narrowing_text(first)})."
        )
    said += [quantities.sampling_note(summary.parameters).strip()] if summary.sampled else []
    where = f"--verbose prints all tables, with {counted(len(summary.parameters), 'parameter')}."
    return (" ".join([*filter(None, said), where]),)


def _outcome(summary: Summary) -> str:
    """Return what the first line said, for a reader who sees only the last ones."""
    if summary.implausible or summary.unexplained:
        return "The fit failed. The first line gives the reason."
    if not summary.converged:
        return "The fit did not converge. The first line gives the reason."
    if cautions.alarm_of(summary):
        return "Converged, but the intervals cannot be trusted. The first line gives the reason."
    count = len(summary.parameters)
    determined = count - sum(map(quantities.is_undetermined, summary.parameters))
    share = "every parameter" if determined == count else f"{determined} of {counted(count, 'parameter')}"
    return f"Converged. The data determined {share}."


def summary_html(summary: Summary, alarm: bool = True) -> str:
    """Return the whole result: convergence and calibration; folded, every table of the fit.

    Parameters
    ----------
    alarm : whether the warning of the fit stands above; without it the page says it elsewhere.
    """
    at_a_glance = [
        *quantities.calibration_sheets(summary),
        quantities.axis_sheet(summary),
        quantities.scale_and_angle_sheet(summary),
    ]
    tables = (at_a_glance, every_table(summary, nuisance=False))
    shown, folded = ([block for sheet in sheets for block in sheet.blocks()] for sheets in tables)
    return render(
        "summary",
        summary=summary,
        alarm=cautions.alarm_of(summary) if alarm else "",
        notices=cautions.notices(summary),
        chi2=cautions.chi2_text(summary),
        # Without a channel of its own, such as a result of equipment alone, the parameters stand open.
        shown=shown or folded[:1],
        weak=weak_lines(summary),
        folded=folded if shown else folded[1:],
        origin=provenance_line(summary.provenance),
    )


def provenance_line(found: FitProvenance | None) -> str:
    """Return serial, dates, hashes, seed and the version of imubayes; empty for a result of an earlier version."""
    if found is None:
        return ""
    first, last = found.first_run, found.last_run
    days = list(dict.fromkeys(day[:10] for day in (first, last) if day is not None))
    versions = {each.package: each.version for each in found.software}
    parts = (
        f"unit {found.serial}" if found.serial else "unit without serial number",
        f"recorded {' to '.join(days)}" if days else "",
        f"fitted {found.fitted[:16].replace('T', ' ')} UTC",
        f"data SHA-256 {found.data_sha256[:_MOST_DIGITS]}…",
        f"model SHA-256 {found.model_sha256[:_MOST_DIGITS]}…",
        f"seed {found.seed}",
        f"imubayes {versions.get('imubayes', '?')}, JAX {versions.get('jax', '?')}",
    )
    return "; ".join(part for part in parts if part)
