"""`imubayes classical`: what the textbook makes of each run."""

from pathlib import Path

from imubayes.cli.options import Json, print_json


def classical(campaign: Path, *, result: Path | None = None, as_json: Json = False) -> int:
    """Evaluate each run by the textbook, and compare with the joint fit.

    Example: imubayes classical data/trihedral-imu --result results/trihedral-imu

    Parameters
    ----------
    campaign
        Folder with campaign.toml.
    result
        Result folder of a fit of the same campaign, to stand beside the textbook.
    as_json
        Print one JSON object on standard output.
    """
    from imubayes.campaign import load_campaign
    from imubayes.display.classical_comparison import textbook_json
    from imubayes.display.terminal import print_textbook
    from imubayes.errors import InputError, Issue
    from imubayes.procedures.classical import classical as evaluate
    from imubayes.results.fit_file import read_record
    from imubayes.results.result import read_result

    loaded = load_campaign(campaign)
    if result is not None and read_record(result)["data_hash"] != loaded.digest:
        raise InputError(
            Issue(
                f"the result is not of the campaign '{loaded.name}' as it is now",
                str(result),
                f"the result of a fit of {campaign}",
                "name the result that belongs to it, or fit the campaign as it is now",
            )
        )
    facts = textbook_json(evaluate(loaded), None if result is None else read_result(result).summary.model_dump())
    if as_json:
        print_json(facts)
    else:
        print_textbook(facts)
    return 0 if facts["estimates"] else 1
