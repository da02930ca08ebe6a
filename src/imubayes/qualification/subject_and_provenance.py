"""Unit, campaign, site and equipment of a result, and what its numbers come from, as records of the report."""

import math

import numpy as np
import polars as pl

from imubayes.campaign_data import Campaign
from imubayes.qualification.report_record import OmittedChannel
from imubayes.qualification.report_subject import (
    Provenance,
    ReportedChannel,
    ReportedEffect,
    ReportedMounting,
    ReportedRun,
    ReportedTable,
    Subject,
)
from imubayes.results.fit_record import read_fit_record
from imubayes.results.provenance import software
from imubayes.results.result import Result


def _triple(values: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z


def subject_of(campaign: Campaign, result: Result) -> Subject:
    """Return unit, campaign, site and equipment."""
    site = campaign.site
    counted = result.residuals.table.filter(pl.col("kind") != "closure").group_by("run").len()
    used = dict(zip(counted["run"].to_list(), counted["len"].to_list(), strict=True))
    missing = {
        run.name: sum(each.values for each in omitted_values(campaign) if each.run == run.name) for run in campaign.runs
    }
    return Subject(
        serial=campaign.serial,
        grade=campaign.grade,
        campaign=campaign.name,
        latitude_deg=math.degrees(site.latitude),
        height_m=site.height,
        gravity_m_s2=site.gravity,
        channels=tuple(
            ReportedChannel(
                name=channel.name,
                kind=channel.kind,
                input_axis=_triple(channel.axes[0]),
                output_axis=_triple(channel.axes[1]),
                output_unit=channel.output_unit,
                nominal_scale=channel.scale,
                per=channel.per,
                nominal_offset=channel.offset,
            )
            for channel in campaign.channels
        ),
        tables=tuple(
            ReportedTable(
                name=table.name,
                azimuth_deg=math.degrees(table.azimuth),
                elevation_deg=math.degrees(table.elevation),
                axis_uncertainty_arcsec=_in(table.axis_uncertainty, math.radians(1 / 3600)),
                rate_uncertainty_ppm=_in(table.rate_uncertainty, 1e-6),
                angle_uncertainty_arcsec=_in(table.angle_uncertainty, math.radians(1 / 3600)),
                azimuth_uncertainty_arcsec=_in(table.azimuth_uncertainty, math.radians(1 / 3600)),
                elevation_uncertainty_arcsec=_in(table.elevation_uncertainty, math.radians(1 / 3600)),
            )
            for table in campaign.tables.values()
        ),
        mountings=tuple(
            ReportedMounting(
                name=mounting.name,
                body_to_table=tuple(_triple(row) for row in mounting.body_to_table),
                uncertainty_arcmin=_in(mounting.uncertainty, math.radians(1 / 60)),
            )
            for mounting in campaign.mountings.values()
        ),
        runs=tuple(
            ReportedRun(
                name=run.name, procedure=run.procedure, table=run.table, mounting=run.mounting, start=run.start,
                rows=run.rows, values_used=used.get(run.name, 0), values_missing=missing[run.name],
            )
            for run in campaign.runs
        ),
    )  # fmt: skip


def _in(value: float | None, unit: float) -> float | None:
    return None if value is None else value / unit


def omitted_values(campaign: Campaign) -> tuple[OmittedChannel, ...]:
    """Return missing values of channels that the run recorded at all."""
    found = []
    for run in campaign.runs:
        gone = np.isnan(run.observed)
        for channel, missing in zip(campaign.channels, gone.T, strict=True):
            if missing.any() and not missing.all():
                found.append(OmittedChannel(run=run.name, channel=channel.name, values=int(missing.sum())))
    return tuple(found)


def provenance_of(result: Result) -> Provenance:
    """Return model, hashes, seed and software."""
    assert result.folder is not None
    record, spec = read_fit_record(result.folder), result.fit.model.spec
    fitted = result.summary.provenance
    return Provenance(
        model=spec.name,
        effects=tuple(
            ReportedEffect(
                name=effect.name, channels=effect.channels, prior=dict(effect.prior), options=dict(effect.options)
            )
            for effect in spec.effects
        ),
        data_sha256=record.data_hash,
        model_sha256=record.model_hash,
        seed=record.seed,
        sampled=result.summary.sampled,
        software=software(),
        fitted=None if fitted is None else fitted.fitted,
        fit_software=() if fitted is None else fitted.software,
    )
