"""`imubayes report`: the uncertainty report for qualification."""

from pathlib import Path
from typing import Annotated

import cyclopts

from imubayes.cli.options import Trust

Out = Annotated[list[Path], cyclopts.Parameter(consume_multiple=True, negative="")]


def report(result: Path, *, out: Out, spec: Path | None = None, trust: Trust = False) -> int:
    """Write the uncertainty report of a unit as a page, a PDF file or a JSON record.

    Example: imubayes report results/full --spec models/qualification-spec.toml --out report.html report.pdf

    The exit status is 1 where the unit does not pass the specification, or where the fit did not converge.

    Parameters
    ----------
    result
        Result folder of a fit; `imubayes diagnose` should have seen it.
    out
        Files to write, by their endings: .html, .pdf, .json.
    spec
        Specification: limits and decision rules. Without one nothing is decided.
    trust
        Trust the effect files that come along: they are code, and run, now and later, only where they are trusted.
    """
    from imubayes.cli.session import progress, start_jax, trusting

    with progress() as tell:
        start_jax()
        trusting(result, trust)
        from imubayes.api import report as make_report
        from imubayes.display.qualification.report_files import places_held, write_report

        with places_held(out):
            tell("evaluating the posterior")
            found = make_report(result, spec)
            tell("drawing")
            write_report(found, out)
    from imubayes.display.qualification.first_page import alarms, banner

    said = banner(found)
    print(f"{said.word}: {said.sentence}")
    for line in alarms(found):
        print(line)
    for file in out:
        print(f"written: {file}")
    return 0 if found.accepted else 1
