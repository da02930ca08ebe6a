"""The files of a report, by their endings."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path

from imubayes.atomic_files import refuse_existing, replacing
from imubayes.display.qualification.html_page import html_page
from imubayes.display.qualification.pdf_file import pdf_file
from imubayes.display.qualification.report_document import report_document
from imubayes.errors import InputError, Issue, closest_first
from imubayes.process_lock import only_writer
from imubayes.qualification.report_record import QualificationReport


def _html(report: QualificationReport) -> bytes:
    return html_page(report_document(report)).encode()


def _pdf(report: QualificationReport) -> bytes:
    return pdf_file(report_document(report), report.json_text())


def _json(report: QualificationReport) -> bytes:
    return report.json_text().encode()


_WRITERS: dict[str, tuple[Callable[[QualificationReport], bytes], bytes]] = {
    ".html": (_html, b"<!doctype html>"),
    ".pdf": (_pdf, b"%PDF"),
    ".json": (_json, b'{\n "format": 1,\n "interval":'),
}
"""Ending → what makes the file, and how such a file begins."""


@contextmanager
def places_held(files: Sequence[Path]) -> Iterator[None]:
    """Hold files for a report until the block ends, before anything is computed.

    Raises
    ------
    InputError
        for an ending that is unknown, a file that exists and is no report, and one that another process writes.
    """
    _check_places(files)
    with ExitStack() as held:
        for file in dict.fromkeys(file.resolve() for file in files):
            held.enter_context(only_writer(file))
        yield


def _check_places(files: Sequence[Path]) -> None:
    issues = []
    for file in files:
        if file.suffix.lower() not in _WRITERS:
            allowed = closest_first(file.suffix, _WRITERS)
            issues.append(
                Issue(f"'{file.name}' has no ending of a report", "option --out", allowed, "choose one of these")
            )
    if issues:
        raise InputError(issues)
    for file in files:
        refuse_existing(file, but=partial(_begins, _WRITERS[file.suffix.lower()][1]))


def _begins(start: bytes, content: bytes) -> bool:
    return content.startswith(start)


def write_report(report: QualificationReport, files: Sequence[Path]) -> None:
    """Write a report to files, each replaced atomically."""
    for file in files:
        content = _WRITERS[file.suffix.lower()][0](report)
        file.parent.mkdir(parents=True, exist_ok=True)
        with replacing(file) as scratch:
            scratch.write_bytes(content)
