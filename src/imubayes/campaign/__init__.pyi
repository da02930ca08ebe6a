from .campaign_in_memory import build_campaign
from .campaign_reader import (
    Inspection,
    check_campaign,
    inspect_campaign,
    load_campaign,
    read_model_file,
)
from .file_schemas import CampaignFile, EffectEntry, ModelFile
from .stream_checks import FINDINGS, Finding

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
