"""`imubayes convert`: recordings of other tools into a campaign."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from imubayes.campaign.campaign_reader import CAMPAIGN_FILE
from imubayes.campaign.convert import ConvertOptions
from imubayes.campaign.convert import convert as convert_recording
from imubayes.campaign.file_schemas import CampaignFile
from imubayes.campaign.toml_documents import read_document
from imubayes.foundations.errors import input_error


@dataclass(frozen=True)
class _Options(ConvertOptions):
    """The options of a conversion on the command line, where `--column` takes the place of `columns`."""

    columns: Annotated[Mapping[str, str | int], Parameter(parse=False)] = field(default_factory=dict)


_NO_OPTIONS = _Options()


def _option_name(name: str) -> str:
    return name.lower().replace("_", "-")


def convert(
    kind: str,
    *files: Path,
    out: Path,
    column: Annotated[list[str] | None, Parameter(negative="")] = None,
    options: Annotated[_Options, Parameter(name="*", negative="", name_transform=_option_name)] = _NO_OPTIONS,
) -> None:
    """Convert a recording of another tool into a campaign folder.

    Parameters
    ----------
    kind
        imu-tk (two text files, accelerometers and gyros, each time x y z) or six-column (columns named ax ay az gx gy
        gz, or these six without names).
    files
        The recording.
    out
        Campaign folder to write.
    column
        COLUMN=SOURCE, once for each column whose name is another; SOURCE is a name or a number from 1.
    """
    chosen = replace(options, columns=dict(_column_source(word) for word in column or []))
    folder = convert_recording(kind, files, out, **vars(chosen))
    entry = read_document(folder / CAMPAIGN_FILE, CampaignFile).entry
    for note in entry.notes if entry else ():
        print(f"note: {note}")
    print(f"campaign in {folder}; next: imubayes check {folder}")


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
