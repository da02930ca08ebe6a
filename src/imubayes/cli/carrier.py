"""`imubayes carrier`: what carries a rotating unit, with the rotation taken out."""

from pathlib import Path


def carrier(campaign: Path, run: str, *, out: Path, result: Path | None = None) -> int:
    """Write the carrier's rate and specific force, the table's measured rotation taken out, and a picture.

    Example: imubayes carrier data/rotation-modulation pyramid-forward --out carrier.csv

    Parameters
    ----------
    campaign
        Folder with campaign.toml.
    run
        A run in which the unit turns, with the table angle recorded.
    out
        The table to write (CSV); a picture of the turning bias goes beside it.
    result
        Result folder of a fit of the same campaign, whose fitted errors are taken out first.
    """
    from imubayes.cli.session import progress

    with progress() as tell:
        from imubayes.campaign import load_campaign
        from imubayes.display.carrier_motion import carrier_sheet, rotating_run, write_carrier
        from imubayes.display.report_layout import Report, print_report
        from imubayes.results.carrier_estimate import estimate_carrier
        from imubayes.results.corrected_outputs import corrected_run
        from imubayes.results.fit_record import refuse_other_data
        from imubayes.results.result import read_result

        tell("reading the campaign")
        loaded = load_campaign(campaign)
        chosen = rotating_run(loaded, run)
        corrected = None
        if result is not None:
            refuse_other_data(result, loaded)
            fitted = read_result(result)
            corrected = corrected_run(loaded, chosen, fitted.residuals, fitted.summary)
        tell("turning")
        found = estimate_carrier(loaded, chosen, corrected)
        written = write_carrier(out, loaded, chosen, found)
    for file in written:
        print(f"wrote {file}")
    print_report(Report((), [carrier_sheet(found, loaded, chosen)]))
    return 0
