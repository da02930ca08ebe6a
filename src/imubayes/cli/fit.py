"""Commands `imubayes fit`, `classical`, `compare` and `predict`.

`fit`, the main job, fits all runs of a campaign jointly.  `classical` gives the classical evaluation of each run.
`compare` compares the model with the measurements, `predict` against others that were not fitted.
"""

import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from imubayes.cli.session import Flag, Json, Names, Repeated, Trust, progress, show, split, start_jax, trusting
from imubayes.foundations.errors import input_error

if TYPE_CHECKING:
    from imubayes.foundations.campaign_data import Campaign
    from imubayes.results.result import Result


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
        Trust the effect files that come with the input, and remember them. They are code, which runs only if trusted.
    """
    with progress() as tell:
        trusting(result, trust)
        from imubayes.campaign import load_campaign
        from imubayes.display.classical_comparison import classical_json, compare_classical, of_prediction
        from imubayes.display.classical_report import classical_report
        from imubayes.display.loop.kept_causes import causes_of
        from imubayes.procedures import classical as evaluate
        from imubayes.results.history_tree import refuse_other_data
        from imubayes.results.stored_tables import read_summary_and_residuals

        tell("reading the campaign")
        loaded = load_campaign(campaign)
    if delta_k_threshold is not None and not delta_k_threshold > 0:
        what = f"a threshold of {delta_k_threshold:g} %"
        raise input_error(what, "--delta-k-threshold", "a percentage above 0", "correct it")
    summary = predicted = residuals = None
    if result is not None:
        refuse_other_data(result, loaded)
        summary, read = read_summary_and_residuals(result)
        residuals = read.table
        predicted = of_prediction(loaded, residuals, summary)
    fitted = None if summary is None else summary.delta_k_threshold
    percent = fitted if delta_k_threshold is None else delta_k_threshold
    comparison = compare_classical(evaluate(loaded, None if percent is None else percent / 100), summary, predicted)
    if result is not None and summary is not None and residuals is not None and comparison.beyond:
        comparison = comparison.with_causes(causes_of(result, residuals, summary))
    show(lambda: classical_json(comparison), lambda: classical_report(comparison), as_json)
    return 0 if comparison.estimates else 1


_FOR_ONE = "these options draw pictures of one result, but two are named"
_FOR_TWO = "these options compare two results, but only one is named"


def compare(
    result: Path,
    other: Path | None = None,
    *,
    parameters: Repeated = None,
    runs: Repeated = None,
    every: Flag = False,
    changed: Names = None,
    any_unit: Flag = False,
    limits: Path | None = None,
    as_json: Json = False,
    verbose: Flag = False,
    trust: Trust = False,
) -> int:
    """Compare the model with the measurements: figures, goodness of fit per run and channel. Or two calibrations.

    Example: imubayes compare results/trihedral-imu

    Example: imubayes compare results/2026 results/2027 --changed seat

    Parameters
    ----------
    result
        Result folder of a fit.
    other
        Result folder of a later calibration of the same unit, with which to compare the first.
    parameters
        Quantities of a corner plot. With --every, the default is the least determined angles and scale factors.
    runs
        Runs to draw in separate figures, or 'all'. With --every, the default is the six that fit worst.
    every
        Draw all figures. By default the five most important ones are drawn, and those requested.
    changed
        For two calibrations: tables and mountings that have the same name in both but are different equipment.
    any_unit
        For two calibrations: compare them even if their serial numbers differ.
    limits
        For two calibrations: a specification, as for report; shows when the next calibration is due.
    as_json
        For two calibrations: print one JSON object on standard output.
    verbose
        For two calibrations: print every quantity.
    trust
        Trust the effect files that come with the input, and remember them. They are code, which runs only if trusted.
    """
    of_one, of_two = parameters or runs or every, changed or any_unit or limits or as_json or verbose
    if of_one if other is not None else of_two:
        fault = _FOR_ONE if other is not None else _FOR_TWO
        raise input_error(fault, "command line", "the options that --help lists for it", "leave them out")
    if other is not None:
        given = {"changed": split(changed) or [], "any_unit": any_unit, "limits": limits}
        return _compare_two(result, other, given, as_json, verbose, trust)
    with progress() as tell:
        trusting(result, trust)
        from imubayes.display.compare_report import compare as compare_result
        from imubayes.display.compare_report import print_comparison

        comparison = compare_result(result, parameters=parameters, runs=runs, every=every, progress=tell)
    print_comparison(comparison)
    return 0


def _compare_two(first: Path, second: Path, given: dict[str, Any], as_json: bool, verbose: bool, trust: bool) -> int:
    with progress() as tell:
        start_jax("compare")
        for result in (first, second):
            trusting(result, trust)
        from imubayes.api import repeatability
        from imubayes.display.loop.prediction_report import repeatability_report

        found = repeatability(first, second, **given, progress=tell)
    show(lambda: found, lambda: repeatability_report(found, verbose), as_json)
    return 0 if found.agree else 1


def predict(
    result: Path,
    campaign: Path,
    *,
    out: Path | None = None,
    changed: Names = None,
    any_unit: Flag = False,
    as_json: Json = False,
    verbose: Flag = False,
    trust: Trust = False,
) -> int:
    """Test whether a fitted model predicts, within its uncertainty, runs that it has not seen.

    Example: imubayes predict results/spring campaigns/autumn --out results/autumn-predicted

    Parameters
    ----------
    result
        Result folder of a fit.
    campaign
        Folder with campaign.toml, of the same unit; runs that were fitted are left out.
    out
        Folder to write: the pictures and page of compare, residuals, and the result as JSON.
    changed
        Tables and mountings that have the name of one of the fit but are different equipment, such as a seat on which
        the unit was mounted anew.
    any_unit
        Predict runs of another unit as well.
    as_json
        Print one JSON object on standard output.
    verbose
        Print a line for each run and channel, and every estimate.
    trust
        Trust the effect files that come with the input, and remember them. They are code, which runs only if trusted.
    """
    with progress() as tell:
        start_jax("predict")
        trusting(result, trust)
        from imubayes.api import predict as predict_runs
        from imubayes.display.loop.prediction_report import prediction_report, save_prediction

        found = predict_runs(result, campaign, changed=split(changed) or (), any_unit=any_unit, progress=tell)
        page = None if out is None else save_prediction(found, out, tell)
    show(lambda: found.summary, lambda: prediction_report(found, verbose), as_json)
    if page is not None and not as_json:
        print(f"look at this: {page}")
    return 0 if found.holds else 1


def fit(
    campaign: Path,
    *,
    model: Path,
    out: Path,
    sample: bool = True,
    seed: int = 0,
    resume: bool = False,
    replace: Flag = False,
    until_digits: Literal[1, 2] | None = None,
    population: Path | None = None,
    as_json: Json = False,
    verbose: bool = False,
    trust: Trust = False,
) -> int:
    """Fit all runs of a campaign jointly, sample the posterior, and write the result folder.

    Example: imubayes fit data/trihedral-imu --model models/trihedral-imu.toml --out results/trihedral-imu

    Parameters
    ----------
    campaign
        Folder with campaign.toml.
    model
        Model file, or the name of a shipped model.
    out
        Result folder to write.
    sample
        Sample the posterior; with --no-sample the Laplace approximation is used.
    seed
        Seed of the sampler.
    resume
        Continue a sampling that was interrupted.
    replace
        Replace a sampled result in the result folder.
    until_digits
        Sample until the draws support this many significant digits of every standard uncertainty (JCGM 101, 7.9.4).
    population
        Results folder of `imubayes batch`: the population of its units is the prior of this one.
    as_json
        Print summary.json on standard output.
    verbose
        Print every table: all parameters with intervals, runs, combinations, contributions of procedures.
    trust
        Trust the effect files that come with the input, and remember them. They are code, which runs only if trusted.
    """
    with ExitStack() as held:
        recorded = _read(campaign, held, out, resume, replace)
        trusting(model, trust)
        from imubayes.api import fit as fit_campaign

        with progress("compiling") as tell:
            result = fit_campaign(
                recorded, model, out, sample=sample, seed=seed, resume=resume, replace=replace,
                until_digits=until_digits, population=population, progress=tell,
            )  # fmt: skip
    return _shown(result, campaign, out, as_json, verbose)


def _shown(result: "Result", campaign: Path, out: Path, as_json: bool, verbose: bool) -> int:
    """Print a fit, and return the exit status."""
    from imubayes.display.fit_cautions import next_command
    from imubayes.display.fit_report import summary_report

    show(lambda: result.summary, lambda: summary_report(result.summary, verbose=verbose), as_json)
    if not as_json:
        print(f"\nresult in {out}; next: {next_command(result.summary, str(campaign), str(out))}")
    return 0 if result.converged else 1


def _read(campaign: Path, held: ExitStack, out: Path, resume: bool, replace: bool) -> "Campaign":
    """Return the campaign, after its warnings are printed; the folder of the result is held before, in `held`."""
    with progress() as tell:
        from imubayes.results.folder_state import claimed

        held.enter_context(claimed(out, resume, replace))
        from imubayes.campaign import inspect_campaign
        from imubayes.display.check_report import usable, warning_lines

        tell("reading the campaign")
        recorded = usable(inspection := inspect_campaign(campaign))
        tell("loading")
        start_jax()
    print("".join(f"{line}\n" for line in warning_lines(inspection)), end="", file=sys.stderr)
    return recorded
