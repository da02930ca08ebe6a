"""Schema of plan files: a campaign to be simulated, with the model that generates it.

A plan has the sections of `campaign.toml`; its runs give the steps of the procedure instead of a file:

    model = "../models/trihedral-imu.toml"     # relative to the plan
    seed = 1

    [truth]                                    # optional; other values are drawn from the priors
    "gyro_scale_factor.scale[gx]" = 250.0

    [[run]]
    name = "pyramid"
    procedure = "rate_table"
    table = "rate"
    mounting = "pyramid"
    temperature_degC = 25.0
    rates_deg_s = [0, 100, -100, 0]
"""

from datetime import date, datetime
from typing import Literal

from pydantic import BaseModel, Field

from imubayes.campaign.file_schemas import (
    CampaignFile,
    ChannelEntry,
    MountingEntry,
    Name,
    SiteEntry,
    TableEntry,
    UnitEntry,
)
from imubayes.procedures.planned_steps import PlannedSteps, Temperature


class PlannedRun(PlannedSteps):
    """One run of a plan; the steps that a procedure accepts are in its `PlanRules`."""

    name: Name
    procedure: str
    table: str | None = None
    mounting: str | None = None
    temperature_degC: Temperature | None = None
    start: datetime | date | None = None


class PlanFile(BaseModel):
    """A plan file."""

    model_config = CampaignFile.model_config

    format: Literal[1]
    name: Name
    notes: list[str] = []
    model: str = Field(min_length=1)
    seed: int = Field(default=1, ge=0)
    truth: dict[str, float] = {}
    site: SiteEntry
    unit: UnitEntry = UnitEntry()
    channel: list[ChannelEntry] = Field(min_length=1)
    table: list[TableEntry] = []
    mounting: list[MountingEntry] = []
    run: list[PlannedRun] = Field(min_length=1)
