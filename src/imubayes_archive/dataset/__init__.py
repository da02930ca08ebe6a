"""Archives of campaigns: a Parquet dataset, one file per campaign, partitioned by unit."""

from imubayes_archive.dataset.campaign_file import ArchivedCampaign
from imubayes_archive.dataset.store import Archive, Packed, Refusal, campaign_folders, pack

__all__ = ["Archive", "ArchivedCampaign", "Packed", "Refusal", "campaign_folders", "pack"]
