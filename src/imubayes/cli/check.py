"""`imubayes check`: what is there, and what is wrong."""

from pathlib import Path

from imubayes.cli.options import Json, print_json


def check(campaign: Path, *, model: Path | None = None, as_json: Json = False) -> int:
    """Read everything, say what is there and what is wrong.

    Example: imubayes check data/trihedral-imu --model models/trihedral-imu.toml

    Parameters
    ----------
    campaign
        Folder with campaign.toml.
    model
        Model file to check against the campaign.
    as_json
        Print one JSON object on standard output.
    """
    from imubayes.campaign import inspect_campaign
    from imubayes.display.check_report import check_record, check_report
    from imubayes.display.report_layout import print_report

    inspection = inspect_campaign(campaign)
    declared = None
    if model is not None and inspection.campaign is not None:
        from imubayes.cli.session import start_jax

        start_jax()
        from imubayes.model.bind import bind
        from imubayes.model.model_file import read_model

        declared = bind(read_model(model), inspection.campaign)
    if as_json:
        print_json(check_record(inspection, declared).model_dump(mode="json"))
    else:
        print_report(check_report(inspection, declared))
    return 0
