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
    TemperatureUncertainty,
    UnitEntry,
)
from imubayes.procedures.planned_steps import PlannedSteps, Temperature


class PlannedRun(PlannedSteps):
    """One run of a plan; the steps that a procedure accepts are in its `PlanRules`."""

    name: Name = Field(description="of the run, unique in the plan")
    procedure: str = Field(description="test procedure, as in campaign.toml")
    table: str | None = Field(default=None, description="name of a [[table]]")
    mounting: str | None = Field(default=None, description="name of a [[mounting]]")
    temperature_degC: Temperature | None = Field(default=None, description="of all rows")
    temperature_uncertainty_degC: TemperatureUncertainty | None = Field(
        default=None, description="as in campaign.toml; the truth has an error of this size"
    )
    converter_temperature_uncertainty_degC: TemperatureUncertainty | None = Field(
        default=None, description="as in campaign.toml; the truth has an error of this size"
    )
    start: datetime | date | None = Field(default=None, description="when the run begins")


class PlanFile(BaseModel):
    """A plan file."""

    model_config = CampaignFile.model_config

    format: Literal[1] = Field(description="of this file")
    name: Name = Field(description="of the campaign")
    notes: list[str] = Field(default=[], description="remarks, copied into the campaign")
    model: str = Field(min_length=1, description="model file that generates the data, relative to the plan")
    seed: int = Field(default=1, ge=0, description="of truth and noise")
    truth: dict[str, float] = Field(
        default={}, description="true values by parameter; others are drawn from the priors"
    )
    site: SiteEntry = Field(description="where the runs are made")
    unit: UnitEntry = Field(default=UnitEntry(), description="what is tested")
    channel: list[ChannelEntry] = Field(min_length=1, description="one for each sensitive axis")
    table: list[TableEntry] = Field(default=[], description="as in campaign.toml")
    mounting: list[MountingEntry] = Field(default=[], description="as in campaign.toml")
    run: list[PlannedRun] = Field(min_length=1, description="the steps of each run")
