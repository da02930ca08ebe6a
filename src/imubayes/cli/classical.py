"""`imubayes classical`: the classical evaluation of each run."""

from pathlib import Path

from imubayes.cli.options import Json, print_json


def classical(campaign: Path, *, result: Path | None = None, as_json: Json = False) -> int:
    """Evaluate each run by the classical method of its procedure, and compare with the joint fit.

    Example: imubayes classical data/trihedral-imu --result results/trihedral-imu

    Parameters
    ----------
    campaign
        Folder with campaign.toml.
    result
        Result folder of a fit of the same campaign, to compare with.
    as_json
        Print one JSON object on standard output.
    """
    from imubayes.campaign import load_campaign
    from imubayes.display.classical_comparison import classical_json, compare_classical
    from imubayes.display.fit_report import classical_report
    from imubayes.display.report_layout import print_report
    from imubayes.procedures.classical import classical as evaluate
    from imubayes.results.fit_file import refuse_other_data
    from imubayes.results.result import read_result

    loaded = load_campaign(campaign)
    if result is not None:
        refuse_other_data(result, loaded)
    comparison = compare_classical(evaluate(loaded), None if result is None else read_result(result).summary)
    if as_json:
        print_json(classical_json(comparison))
    else:
        print_report(classical_report(comparison))
    return 0 if comparison.estimates else 1
