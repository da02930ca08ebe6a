"""What `imubayes check` says: what is there, what is odd, and what a model would make of it."""

from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table as Grid

from imubayes.campaign import Inspection
from imubayes.campaign_data import Campaign
from imubayes.errors import InputError
from imubayes.model.bind import Model


def inspection_json(inspection: Inspection, model: Model | None) -> dict[str, Any]:
    """Return the outcome of a check as one object; raises InputError where the campaign cannot be used."""
    campaign = _usable(inspection)
    found: dict[str, Any] = {
        "format": 1,
        "campaign": campaign.name,
        "channels": [channel.name for channel in campaign.channels],
        "runs": [
            {"name": run.name, "procedure": run.procedure, "rows": run.rows, "notes": list(run.notes)}
            for run in campaign.runs
        ],
        "findings": [
            {"name": finding.name, "severity": finding.severity, "text": str(finding)}
            for finding in inspection.findings
        ],
        "notes": list(campaign.notes),
    }
    if model is not None:
        found["model"] = {
            "name": model.spec.name,
            "parameters": len(model.layout),
            "noise_parameters": len(model.hyper_layout),
            "measured_values": len(model.entries),
        }
    return found


def print_inspection(inspection: Inspection, model: Model | None) -> None:
    """Print the outcome of a check; raises InputError where the campaign cannot be used."""
    campaign = _usable(inspection)
    console = Console()
    site = campaign.site
    console.print(
        f"[bold]{campaign.name}[/bold]  {len(campaign.channels)} channels, {len(campaign.runs)} runs, "
        f"latitude {np.degrees(site.latitude):.4f} deg, gravity {site.gravity:.5f} m/s²"
    )
    grid = Grid("run", "procedure", "table", "mounting", "rows", "samples", "temperature °C", box=None)
    for run in campaign.runs:
        warmth = run.covariates.get("temperature")
        span = "–" if warmth is None else f"{np.min(warmth):.1f} … {np.max(warmth):.1f}"
        grid.add_row(
            run.name, run.procedure, run.table or "–", run.mounting or "–", str(run.rows),
            f"{np.sum(run.samples):.0f}", span,
        )  # fmt: skip
    console.print(grid)
    for note in campaign.notes:
        console.print(f"note: {note}", highlight=False, markup=False)
    for run in campaign.runs:
        for note in run.notes:
            console.print(f"note: {run.name}: {note}", highlight=False, markup=False)
    if model is not None:
        console.print(
            f"model '{model.spec.name}' fits this campaign: {len(model.layout)} parameters, "
            f"{len(model.hyper_layout)} of noise, {len(model.entries)} measured values"
        )
    warnings = [finding for finding in inspection.findings if finding.severity == "warning"]
    console.print(f"{len(warnings)} warnings" if warnings else "nothing odd found")


def _usable(inspection: Inspection) -> Campaign:
    if inspection.campaign is None:
        raise InputError(inspection.issues)
    return inspection.campaign
