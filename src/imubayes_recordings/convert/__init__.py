"""Conversion of recordings into campaign folders, written atomically.

`formats` opens a file by its content; `column_choice` finds the channels by name; `clock` and `unit_evidence` say what
times and units are and how that is known; `recorded_runs` makes runs of the tables, `campaign_document` the campaign.
Options state the facts that neither the recording nor its numbers give.  A campaign folder is written to a
temporary folder, which is renamed at the end.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from imubayes.campaign.campaign_writer import write_campaign
from imubayes.foundations.errors import input_error
from imubayes.foundations.files import refuse_occupied
from imubayes_recordings.convert.campaign_document import ConvertedCampaign, make_campaign
from imubayes_recordings.convert.column_choice import ChosenTable
from imubayes_recordings.convert.formats import open_recording
from imubayes_recordings.convert.mapping_file import MAPPING_FILE, mapping_text, read_mapping
from imubayes_recordings.convert.options import ConvertOptions, read_options
from imubayes_recordings.convert.recorded_runs import recorded_runs
from imubayes_recordings.convert.table_choice import choose_tables

__all__ = ["ConvertOptions", "convert", "read_recordings"]


@dataclass(frozen=True)
class ReadRecordings:
    """Recordings as they were understood: the tables that were read, and the campaign that they make."""

    files: tuple[Path, ...]
    tables: tuple[ChosenTable, ...]
    campaign: ConvertedCampaign

    def write(self, out: str | Path, *, to_correct: bool = False) -> Path:
        """Write the campaign into a new folder, with the mapping that reads others of its kind.

        Parameters
        ----------
        to_correct : whether a campaign that would not load is written all the same, with its faults at its head.

        Raises
        ------
        InputError
            if the folder is not empty, or the campaign would not load.
        """
        made, recording, folder = self.campaign, " and ".join(map(str, self.files)), Path(out)
        write_campaign(
            folder, made.document, made.tables, came_from=lambda where: _came_from(where, recording),
            beside={MAPPING_FILE: mapping_text(self.tables, made.options, made.guesses)}, to_correct=to_correct,
        )  # fmt: skip
        return folder


def read_recordings(
    files: Sequence[str | Path], name: str = "", mapping: str | Path | None = None, **options: Any
) -> ReadRecordings:
    """Read recordings, and write nothing.

    Parameters
    ----------
    files, mapping, options : as of `convert`.
    name : of the campaign, if the options do not give it.

    Raises
    ------
    InputError
        with everything that prevents the conversion.
    """
    given = {**(read_mapping(Path(mapping)) if mapping is not None else {}), **options}
    chosen = read_options(given)
    if not files:
        raise input_error("no file was given", "command line", "one recording or more", "give the files")
    recordings = [open_recording(Path(file), chosen.delimiter) for file in files]
    tables = choose_tables(recordings, chosen)
    runs = recorded_runs(tables, chosen)
    source = ", ".join(Path(file).name for file in files)
    paths = tuple(Path(file) for file in files)
    return ReadRecordings(paths, tables, make_campaign(runs, chosen, name or paths[0].stem, source))


def convert(files: Sequence[str | Path], out: str | Path, mapping: str | Path | None = None, **options: Any) -> Path:
    """Convert recordings of one unit into a campaign folder.

    Parameters
    ----------
    files : one recording, accelerometers and gyros apart, the parts of a record, or one file a face.
    out : the campaign folder to write; must not exist, or be empty.
    mapping : `mapping.toml` of an earlier conversion; options go before it.
    options : see `ConvertOptions`.

    Raises
    ------
    InputError
        with everything that prevents the conversion.
    """
    folder = Path(out)
    refuse_occupied(folder)
    return read_recordings(files, folder.name, mapping, **options).write(folder)


def _came_from(where: str, recording: str) -> str:
    """Return the place in the recording, or the option, that a place in the campaign was written from."""
    if found := re.search(r"\bruns/recording(?:-\d+)?\.csv(?::(\d+))?(.*)", where):
        # The first line of the table is its header.
        reading = f", sample {int(found[1]) - 1}" if found[1] else ""
        return f"{recording}{reading}{found[2]}"
    key = where.rpartition(".")[2].rpartition(" ")[2]
    return f"option {key}" if key in {option.name for option in fields(ConvertOptions)} else where
