"""U of each quantity as every form of a report gives it, read as a user of that form would."""

import csv
import io
import re
from collections import defaultdict
from collections.abc import Iterator
from xml.etree import ElementTree

from scipy import stats

from imubayes_qualification.certificate.report_record import QualificationReport, ReportedEstimate, StandardEstimate
from imubayes_qualification.display.report.calibration_xml import DCC, SI, covariance_file, dcc_file
from imubayes_qualification.display.report.words import value_text


def of_table(report: QualificationReport) -> Iterator[tuple[str, str, float]]:
    """Yield name, column and U from the table of covariances: as stated, by k, by Student's t as GTC, by the ends."""
    for row in csv.DictReader(io.StringIO(covariance_file(report).decode())):
        u, value = float(row["standard_uncertainty"]), float(row["value"])
        one_sided = (1 + float(row["coverage_probability"])) / 2
        if row["interval"] != "symmetric":
            assert not row["coverage_factor"] + row["expanded_uncertainty"] + row["degrees_of_freedom"]
            continue
        yield row["name"], "U", float(row["expanded_uncertainty"])
        yield row["name"], "k u", float(row["coverage_factor"]) * u
        yield row["name"], "t u", float(stats.t.ppf(one_sided, float(row["degrees_of_freedom"]))) * u
        yield row["name"], "high − y", float(row["high"]) - value
        yield row["name"], "variance", float(row["coverage_factor"]) * float(row[row["name"]]) ** 0.5


def of_dcc(report: QualificationReport) -> Iterator[tuple[str, str, float]]:
    """Yield name and U from the digital calibration certificate."""
    named = {f"{each.quantity} {each.symbol} of {each.label}": each.name for each in report.standards}
    for quantity in ElementTree.fromstring(dcc_file(report)).iter(f"{{{DCC}}}quantity"):
        name = named.get(quantity.findtext(f"{{{DCC}}}name/{{{DCC}}}content") or "")
        found = quantity.find(f".//{{{SI}}}expandedMU")
        if name is not None and found is not None:
            assert found.findtext(f"{{{SI}}}coverageProbability") == "0.95"
            yield name, "DCC", float(found.findtext(f"{{{SI}}}valueExpandedMU") or "nan")


def of_record(report: QualificationReport) -> Iterator[tuple[str, str, float]]:
    """Yield name and U, in D-SI units, from tables and budgets of the record, as stated and by k u."""
    budgets = {} if report.budgets is None else {each.name: each for each in report.budgets.quantities}
    for each in stated(report):
        factor, u = _factor(each), each.standard_uncertainty or 0.0
        yield each.name, "JSON", (each.expanded_uncertainty or 0.0) * factor
        yield each.name, "JSON k u", (each.coverage_factor or 0.0) * u * factor
        yield each.name, "JSON interval", ((each.high or 0.0) - (each.low or 0.0)) / 2 * factor
        budget = budgets.get(each.name) or budgets.get(each.members[0] if isinstance(each, StandardEstimate) else "")
        if budget is not None:
            assert budget.interval == "symmetric"
            yield each.name, "budget", budget.expanded_uncertainty * factor
            yield each.name, "budget k u", budget.coverage_factor * budget.standard_uncertainty * factor


def _factor(each: ReportedEstimate) -> float:
    return 1.0 if each.d_si is None else abs(each.d_si.factor)


def stated(report: QualificationReport) -> list[ReportedEstimate]:
    """Return the quantities that the page states as y ± U."""
    known = (*report.standards, *report.mounting_angles, *report.combinations, *report.results)
    return [each for each in known if each.interval == "symmetric" and each.withheld is None]


def disagreements(report: QualificationReport, relative: float = 1e-6) -> list[str]:
    """Return the quantities that two forms of a report give another U."""
    found: defaultdict[str, dict[str, float]] = defaultdict(dict)
    for name, where, expanded in (*of_record(report), *of_table(report), *of_dcc(report)):
        found[name][where] = expanded
    assert {each.name for each in stated(report)} <= found.keys()
    return [
        f"{name}: {known}"
        for name, known in found.items()
        if max(known.values()) - min(known.values()) > relative * max(known.values())
    ]


def rounded_otherwise(report: QualificationReport, page: str) -> list[str]:
    """Return the quantities whose U in the caption of the budget is not that of the table, on the visible page."""
    found, seen = [], 0
    for each in stated(report):
        caption = re.search(rf"(?<!\S){re.escape(each.name)}: u = \S+ \S+, k = \S+, U = (\S+)", page)
        seen += caption is not None
        if caption is not None and f"± {caption[1]} " not in f"{value_text(each)} ":
            found.append(f"{each.name}: {caption[1]}, {value_text(each)}")
    assert seen, "no budget of a quantity with y ± U is on the page"
    return found
