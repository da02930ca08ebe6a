"""`imubayes check`: what is there, and what is wrong."""

from pathlib import Path
from typing import TYPE_CHECKING

from imubayes.cli.options import Flag, Json, print_json

if TYPE_CHECKING:
    from imubayes.campaign import Inspection
    from imubayes.display.check_report import CheckedModel


def check(campaign: Path, *, model: Path | None = None, as_json: Json = False, verbose: Flag = False) -> int:
    """Read everything, say what is there and what is wrong.

    The outputs are compared with the stated set-up: zero, sense, azimuth and elevation of tables, mountings, units,
    channels, files, latitude, thermometers. The zero of a table: table x is horizontal, 90 deg clockwise from
    azimuth_deg, y = z x x, and angles are right-handed about z (picture in data/README.md).

    Example: imubayes check data/trihedral-imu --model models/trihedral-imu.toml

    Parameters
    ----------
    campaign
        Folder with campaign.toml.
    model
        Model file to check against the campaign.
    as_json
        Print one JSON object on standard output.
    verbose
        List every run and every note; otherwise those of one kind are one line.
    """
    from imubayes.cli.session import progress
    from imubayes.display.check_report import check_record, check_report
    from imubayes.display.report_layout import print_report

    if model is None:
        from imubayes.campaign import inspect_campaign

        with progress("reading the campaign"):
            inspection, size = inspect_campaign(campaign), None
    else:
        inspection, size = _with_model(campaign, model)
    if as_json:
        print_json(check_record(inspection, size).model_dump(mode="json"))
    else:
        print_report(check_report(inspection, size, _next(campaign, model), verbose))
    return 0


def _with_model(campaign: Path, model: Path) -> "tuple[Inspection, CheckedModel | None]":
    """Return the inspection of a campaign and the size of the model bound to it; None where it cannot be used."""
    from imubayes.cli.beside import inspecting
    from imubayes.cli.session import progress, start_jax
    from imubayes.display.check_report import CheckedModel

    with progress("reading the campaign") as tell, inspecting(campaign) as inspected:
        start_jax()
        from imubayes.model.bind import bind
        from imubayes.model.model_file import read_model

        inspection = inspected()
        if inspection.campaign is None:
            return inspection, None
        tell("binding the model")
        declared = bind(read_model(model), inspection.campaign)
    return inspection, CheckedModel(
        name=declared.spec.name,
        parameters=len(declared.layout),
        noise_parameters=len(declared.hyper_layout),
        measured_values=len(declared.entries),
        left_out=declared.left_out,
    )


def _next(campaign: Path, model: Path | None) -> str:
    """Return the command to run next."""
    if model is None:
        return f"imubayes check {campaign} --model MODEL"
    return f"imubayes fit {campaign} --model {model} --out results/{campaign.resolve().name}"
