"""`imubayes convert` and `new`: recordings of other tools into a campaign, and a model to begin with."""

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from imubayes.campaign.campaign_reader import CAMPAIGN_FILE
from imubayes.cli.session import progress, start_jax
from imubayes.display.layout import print_report
from imubayes.foundations.errors import input_error
from imubayes.foundations.files import refuse_occupied
from imubayes_recordings.convert import ConvertOptions, read_recordings
from imubayes_recordings.convert.mapping_file import MAPPING_FILE


@dataclass(frozen=True)
class Options(ConvertOptions):
    """The options of a conversion on the command line, if `--column` takes the place of `columns`."""

    columns: Annotated[Mapping[str, str | int], Parameter(parse=False)] = field(default_factory=dict)


NO_OPTIONS = Options()
_FORMER_KINDS = ("six-column", "imu-tk")


def option_name(name: str) -> str:
    """Return the name of an option on the command line."""
    return name.lower().replace("_", "-")


def convert(
    *files: Path,
    out: Path | None = None,
    mapping: Path | None = None,
    column: Annotated[list[str] | None, Parameter(negative="")] = None,
    options: Annotated[Options, Parameter(name="*", negative="", name_transform=option_name)] = NO_OPTIONS,
) -> None:
    """Convert a recording of any format into a campaign folder; its kind and its columns are found in its content.

    Parameters
    ----------
    files
        The recording: one file, separate files of accelerometers and gyros, the parts of a record, or one file for
        each face.
    out
        Campaign folder to write. Without it, the interpretation is only shown.
    mapping
        mapping.toml of an earlier conversion, for a recording of the same kind.
    column
        COLUMN=SOURCE, once for each column that has a different name; SOURCE is a name or a number from 1, with a
        minus sign before it for an axis that points the other way.
    """
    given = stated(options, column)
    if files and str(files[0]) in _FORMER_KINDS and not files[0].exists():
        print(f"note: '{files[0]}' is not needed: the kind is found in the content")
        files = files[1:]
    if out is not None:
        refuse_occupied(out)  # before a long recording is read
    read = read_recordings(files, out.name if out else "", mapping, **given)
    for note in read.campaign.document["notes"]:
        print(f"note: {note}")
    if out is None:
        print("nothing was written; add --out FOLDER to write the campaign")
        return
    read.write(out)
    print(f"campaign in {out}, with {MAPPING_FILE} for others of its kind; next: imubayes check {out}")


def new(
    folder: Path,
    *files: Path,
    mapping: Path | None = None,
    column: Annotated[list[str] | None, Parameter(negative="")] = None,
    options: Annotated[Options, Parameter(name="*", negative="", name_transform=option_name)] = NO_OPTIONS,
) -> None:
    """Begin: a commented campaign of a recording, and a model with the effects that these runs can determine.

    On a terminal the command asks for facts of the site that neither the recording nor an option states.

    Parameters
    ----------
    folder
        Campaign folder to write. Without files: a folder with a campaign, to which new adds model.toml. Without files
        but with --procedure: new writes a campaign to fill in, with "?" for facts that no option states.
    files
        The recording; see convert.
    mapping
        mapping.toml of an earlier conversion, for a recording of the same kind.
    column
        COLUMN=SOURCE, once for each column that has a different name; see convert.
    """
    given = stated(options, column)
    if files:
        given |= _asked(given)
    with progress() as tell:
        start_jax("new")
        from imubayes_recordings.api.new_campaign import new as begin
        from imubayes_recordings.display.model_writer import proposal_report

        made = begin(folder, files, mapping=mapping, progress=tell, **given)
    for note in made.notes:
        print(f"note: {note}")
    print_report(proposal_report(made.proposal))
    print(f"written: {folder / CAMPAIGN_FILE} and {made.model}")
    if made.to_state:
        print(
            f'to be stated in {CAMPAIGN_FILE}: the {made.to_state} values that are "?"; then the rows of runs/first.csv'
        )
    print(f"next: imubayes check {folder} --model {made.model}")


def stated(options: Options, column: list[str] | None) -> dict[str, Any]:
    """Return the options that were stated."""
    given = {option.name: getattr(options, option.name) for option in fields(ConvertOptions)}
    given = {name: value for name, value in given.items() if value != getattr(NO_OPTIONS, name)}
    return given | ({"columns": dict(_column_source(word) for word in column)} if column else {})


_QUESTIONS = {
    "serial": "serial number of the unit",
    "latitude_deg": "latitude of the site, deg",
    "gravity_m_s2": "measured gravity of the site, m/s^2",
}


def _asked(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the answers on a terminal to what was not stated; an empty line leaves it out."""
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        return {}
    answers: dict[str, Any] = {}
    for key, question in _QUESTIONS.items():
        answer = "" if key in given else input(f"{question} (empty: not known): ").strip()
        if not answer:
            continue
        try:
            answers[key] = answer if key == "serial" else float(answer)
        except ValueError:
            option = f"--{option_name(key)}"
            raise input_error(f"'{answer}' is not a number", option, "a number", "answer again, or state it") from None
    return answers


def _column_source(word: str) -> tuple[str, str | int]:
    key, equals, source = word.partition("=")
    if not (key and equals and source):
        raise input_error(
            f"'{word}' is not COLUMN=SOURCE",
            "option --column",
            "such as gx=imu.gyro.x or gx=4",
            "write the column of the campaign, an equals sign, and the column of the recording",
        )
    return key, int(source) if source.isdigit() else source
