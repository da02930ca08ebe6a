"""`imubayes classical`: the classical evaluation of each run."""

from pathlib import Path

from imubayes.cli.options import Json, Trust, print_json
from imubayes.errors import input_error


def classical(
    campaign: Path,
    *,
    result: Path | None = None,
    delta_k_threshold: float | None = None,
    as_json: Json = False,
    trust: Trust = False,
) -> int:
    """Evaluate each run by the classical method of its procedure, and compare with the joint fit.

    Example: imubayes classical data/trihedral-imu --result results/trihedral-imu

    Parameters
    ----------
    campaign
        Folder with campaign.toml.
    result
        Result folder of a fit of the same campaign, to compare with.
    delta_k_threshold
        Largest Δk in percent at which the 1 g line of a converter applies to another input; by default that of the
        fitted model, then that of the campaign, then 10.
    as_json
        Print one JSON object on standard output.
    trust
        Trust the effect files that come along: they are code, and run, now and later, only where they are trusted.
    """
    from imubayes.cli.session import progress, trusting

    with progress() as tell:
        trusting(result, trust)
        from imubayes.campaign import load_campaign
        from imubayes.display.classical_comparison import classical_json, compare_classical
        from imubayes.display.classical_of_prediction import of_prediction
        from imubayes.display.effects_behind import effects_behind
        from imubayes.display.fit_report import classical_report
        from imubayes.display.report_layout import print_report
        from imubayes.procedures.classical import classical as evaluate
        from imubayes.results.fit_file import read_fit
        from imubayes.results.fit_record import refuse_other_data
        from imubayes.results.read_folder import read_summary_and_residuals

        tell("reading the campaign")
        loaded = load_campaign(campaign)
    _refuse_threshold(delta_k_threshold)
    summary = predicted = None
    if result is not None:
        refuse_other_data(result, loaded)
        summary, read = read_summary_and_residuals(result)
        predicted = of_prediction(loaded, read.table, summary)
    fitted = None if summary is None else summary.delta_k_threshold
    percent = fitted if delta_k_threshold is None else delta_k_threshold
    comparison = compare_classical(evaluate(loaded, None if percent is None else percent / 100), summary, predicted)
    if result is not None and summary is not None and comparison.beyond:
        behind = effects_behind(read_fit(result), read_summary_and_residuals(result)[1].table, summary)
        comparison = comparison.with_causes(behind)
    if as_json:
        print_json(classical_json(comparison))
    else:
        print_report(classical_report(comparison))
    return 0 if comparison.estimates else 1


def _refuse_threshold(percent: float | None) -> None:
    if percent is not None and not percent > 0:
        raise input_error(f"a threshold of {percent:g} %", "--delta-k-threshold", "a percentage above 0", "correct it")
