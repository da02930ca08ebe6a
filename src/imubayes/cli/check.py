"""`imubayes check`: what is there, and what is wrong."""

from pathlib import Path

from imubayes.cli.options import Flag, Json, print_json


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
    from imubayes.campaign import inspect_campaign
    from imubayes.cli.session import progress
    from imubayes.display.check_report import CheckedModel, check_record, check_report
    from imubayes.display.report_layout import print_report

    with progress("reading the campaign"):
        inspection = inspect_campaign(campaign)
    size = None
    if model is not None and inspection.campaign is not None:
        from imubayes.cli.session import start_jax

        with progress("binding the model"):
            start_jax()
            from imubayes.model.bind import bind
            from imubayes.model.model_file import read_model

            declared = bind(read_model(model), inspection.campaign)
        size = CheckedModel(
            name=declared.spec.name,
            parameters=len(declared.layout),
            noise_parameters=len(declared.hyper_layout),
            measured_values=len(declared.entries),
        )
    if as_json:
        print_json(check_record(inspection, size).model_dump(mode="json"))
    else:
        print_report(check_report(inspection, size, _next(campaign, model), verbose))
    return 0


def _next(campaign: Path, model: Path | None) -> str:
    """Return the command to run next."""
    if model is None:
        return f"imubayes check {campaign} --model MODEL"
    return f"imubayes fit {campaign} --model {model} --out results/{campaign.resolve().name}"
