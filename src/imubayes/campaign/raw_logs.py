"""The raw log behind a run that was read: what an evaluation of single samples streams again."""

from pathlib import Path

from imubayes.campaign.campaign_reader import CAMPAIGN_FILE
from imubayes.campaign.file_schemas import CampaignFile
from imubayes.campaign.run_columns import lay_out
from imubayes.campaign.run_tables import TableSource, read_header
from imubayes.campaign.toml_documents import read_document
from imubayes.campaign_data import Campaign, Run
from imubayes.errors import InputError, input_error
from imubayes.procedures import PROCEDURES


def raw_log(campaign: Campaign, run: Run) -> TableSource:
    """Return the table of a run as a stream.

    Raises
    ------
    InputError
        where the campaign was not read from a folder, or its files are gone.
    """
    if not campaign.folder:
        raise input_error(
            "the campaign has no files", f"campaign '{campaign.name}'", "a campaign folder", "give the folder"
        )
    file = Path(campaign.folder) / CAMPAIGN_FILE
    document = read_document(file, CampaignFile)
    document.ledger.stop_if_any()
    assert document.entry is not None
    entry = next(entry for entry in document.entry.run if entry.name == run.name)
    table = file.parent / entry.file
    names = [channel.name for channel in campaign.channels]
    layout, issues = lay_out(read_header(table), names, entry.ignore, PROCEDURES[run.procedure], str(table))
    if issues:
        raise InputError(issues)
    return TableSource(table, layout)
