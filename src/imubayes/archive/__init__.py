"""Archives of campaigns: a Parquet dataset, one file per campaign, partitioned by unit."""

from imubayes.archive.campaign_file import ArchivedCampaign
from imubayes.archive.store import Archive, Packed, Refusal, campaign_folders, pack

__all__ = ["Archive", "ArchivedCampaign", "Packed", "Refusal", "campaign_folders", "pack"]
