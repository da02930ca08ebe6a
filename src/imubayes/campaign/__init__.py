"""Campaign folders in, SI records out: the only place where units come in.

`load_campaign` reads a folder, `read_model_file` a model, and `check_campaign` says what is odd about the data.
"""

from imubayes.campaign.campaign_in_memory import build_campaign
from imubayes.campaign.campaign_reader import (
    Inspection,
    check_campaign,
    inspect_campaign,
    load_campaign,
    read_model_file,
)
from imubayes.campaign.file_schemas import CampaignFile, EffectEntry, ModelFile
from imubayes.campaign.stream_checks import FINDINGS, Finding

__all__ = [
    "FINDINGS",
    "CampaignFile",
    "EffectEntry",
    "Finding",
    "Inspection",
    "ModelFile",
    "build_campaign",
    "check_campaign",
    "inspect_campaign",
    "load_campaign",
    "read_model_file",
]
