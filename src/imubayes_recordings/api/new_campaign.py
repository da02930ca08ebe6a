"""A campaign and a model to begin with, from a recording or from nothing."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

import tomlkit

from imubayes import load_campaign
from imubayes.campaign.campaign_reader import CAMPAIGN_FILE
from imubayes.campaign.file_schemas import ChannelEntry
from imubayes.display.progress import progress_of
from imubayes.foundations.errors import input_error
from imubayes.foundations.files import new_folder, refuse_existing, refuse_occupied, write_text
from imubayes.foundations.records import several
from imubayes.procedures import PROCEDURES, procedure_named
from imubayes_recordings.convert import read_recordings
from imubayes_recordings.convert.options import read_options
from imubayes_recordings.convert.proposed_effects import EffectProposal, propose_effects
from imubayes_recordings.convert.shown_grade import ShownGrade, shown_grade
from imubayes_recordings.display.model_writer import OPEN, commented_campaign, commented_model, start_proposal, template

MODEL_FILE = "model.toml"
_UNITS_OF_INPUT = get_args(ChannelEntry.model_fields["per"].annotation)


@dataclass(frozen=True)
class NewCampaign:
    """A campaign and a model that `new` wrote.

    Attributes
    ----------
    folder, model : the campaign folder, and the model file in it.
    proposal : the effects of the model, and why others are not in it.
    notes : facts taken from the recording, and guesses with their evidence.
    to_state : number of values of the campaign that no option states; it is refused until they are.

    Examples
    --------
    >>> import imubayes
    >>> made = imubayes.new("begun", procedure="dividing_head")
    >>> made.model.name, made.notes
    ('model.toml', ())
    """

    folder: Path
    model: Path
    proposal: EffectProposal
    notes: tuple[str, ...]
    to_state: int = 0


def new(
    folder: str | Path,
    recordings: str | Path | Sequence[str | Path] = (),
    *,
    mapping: str | Path | None = None,
    progress: Callable[[str], None] | None = None,
    **options: Any,
) -> NewCampaign:
    """Write a commented campaign of recordings, and a model with the effects that its runs can determine.

    Parameters
    ----------
    folder : to write; without recordings, a campaign folder that lacks a model, or one to be filled in.
    recordings, mapping, options : as of `imubayes convert`.
    progress : called with a short text as the work goes on.

    Raises
    ------
    InputError
        with everything that prevents it.  If a recording was read and the set-up does not pass, the campaign is written
        with its faults at its head; called again without the recording, `new` adds the model.

    Examples
    --------
    >>> import imubayes
    >>> made = imubayes.new("mine", procedure="rate_table", latitude_deg=47.4)
    >>> sorted(path.name for path in made.folder.iterdir())
    ['campaign.toml', 'model.toml', 'runs']
    """
    folder = _to_write(folder)
    model = folder / MODEL_FILE
    with progress_of(progress) as tell:
        if recordings:
            refuse_occupied(folder)
            tell("reading the recording")
            read = read_recordings(several(recordings), folder.name, mapping, **options)
            read.write(folder, to_correct=True)
            file = folder / CAMPAIGN_FILE
            write_text(file, commented_campaign(file.read_text(encoding="utf-8")))
        elif not (folder / CAMPAIGN_FILE).is_file():
            return _from_nothing(folder, options)
        elif options or mapping is not None:
            fault = "options of a recording, and no recording is named"
            raise input_error(fault, "command line", "the files of a recording", "name them, or leave the options out")
        refuse_existing(model)
        tell("reading the campaign")
        campaign = load_campaign(folder)
        tell("determining the effects that the runs show")
        proposal, said = propose_effects(campaign), ()
        tell("determining the grade of the unit")
        shown = shown_grade(campaign, proposal)
        if shown is not None:
            campaign, said = replace(campaign, grade=shown.grade), _graded(folder, shown, written=bool(recordings))
            proposal = propose_effects(campaign)
        write_text(model, commented_model(campaign.name, proposal, len(campaign.runs)))
    notes = (*campaign.notes, *said, *(f"{run.name}: {note}" for run in campaign.runs for note in run.notes))
    return NewCampaign(folder, model, proposal, notes)


def _to_write(folder: str | Path) -> Path:
    folder = Path(folder)
    if folder.is_file():
        remedy = f"imubayes new FOLDER {folder}"
        raise input_error(f"'{folder}' is a file", "folder to write", "a folder, then the recordings", remedy)
    return folder


def _graded(folder: Path, shown: ShownGrade, written: bool) -> tuple[str, ...]:
    """State the grade in a campaign that was written, and return the note on it; of a campaign at hand, advice."""
    grade = shown.grade
    why = f"{shown.parameter} is {shown.distance:.2g} sd from the default prior of a {shown.by_noise} unit"
    if not written:
        return (f'{why}: state grade = "{grade}" in [unit] of {CAMPAIGN_FILE}',)
    file = folder / CAMPAIGN_FILE
    document = tomlkit.parse(file.read_text(encoding="utf-8"))
    unit: Any = document["unit"]
    unit["grade"] = grade
    unit["grade"].comment(f"of default priors; {why}")
    write_text(file, tomlkit.dumps(document))
    return (f"guessed, grade = {grade}: {why}",)


def _from_nothing(folder: Path, options: Mapping[str, Any]) -> NewCampaign:
    refuse_occupied(folder)
    given = read_options(options)
    if not given.procedure:
        raise input_error(
            "no recording is named, and no procedure",
            str(folder),
            ", ".join(PROCEDURES),
            "name the recordings, or --procedure for a campaign to fill in",
        )
    site = {key: getattr(given, key) for key in ("latitude_deg", "height_m", "gravity_m_s2") if key in options}
    known = {key: float(value) for key, value in site.items() if value is not None}
    stated = {"accelerometer": given.accel_unit, "gyro": given.gyro_unit}
    units = {kind: unit for kind, unit in stated.items() if unit in _UNITS_OF_INPUT}
    name, proposal = given.name or folder.name, start_proposal()
    campaign, header = template(name, procedure_named(given.procedure), known, given.serial, units)
    with new_folder(folder) as draft:
        write_text(draft / CAMPAIGN_FILE, campaign)
        write_text(draft / "runs" / "first.csv", header)
        write_text(draft / MODEL_FILE, commented_model(name, proposal, 0))
    return NewCampaign(folder, folder / MODEL_FILE, proposal, (), campaign.count(f'"{OPEN}"'))
