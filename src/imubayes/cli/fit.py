"""`imubayes fit`: the main job."""

import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from imubayes.cli.options import Flag, Json, Trust, print_json
from imubayes.cli.session import progress, start_jax, trusting

if TYPE_CHECKING:
    from imubayes.campaign_data import Campaign
    from imubayes.results.summary import Summary


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
        Model file.
    out
        Result folder to write.
    sample
        Sample the posterior; with --no-sample the Laplace approximation is used.
    seed
        Seed of the sampler.
    resume
        Continue the sampling that was interrupted.
    replace
        Replace a sampled result in the result folder.
    until_digits
        Sample until every standard uncertainty deserves so many significant digits (JCGM 101, 7.9.4).
    as_json
        Print summary.json on standard output.
    verbose
        Print every table: all parameters with intervals, runs, combinations, contributions of procedures.
    trust
        Trust the effect files that come along: they are code, and run, now and later, only where they are trusted.
    """
    with ExitStack() as held:
        recorded = _read(campaign, held, out, resume, replace)
        trusting(model, trust)
        from imubayes.api import fit as fit_campaign

        with progress("compiling") as tell:
            result = fit_campaign(
                recorded, model, out, sample=sample, seed=seed, resume=resume, replace=replace,
                until_digits=until_digits, progress=tell,
            )  # fmt: skip
    if as_json:
        print_json(result.summary.model_dump(mode="json"))
    else:
        _print_summary(result.summary, verbose, campaign, out)
    return 0 if result.converged else 1


def _read(campaign: Path, held: ExitStack, out: Path, resume: bool, replace: bool) -> "Campaign":
    """Return the campaign, after its warnings are printed; the folder of the result is held before, in `held`."""
    from imubayes.cli.beside import inspecting

    with progress() as tell, inspecting(campaign) as inspected:
        from imubayes.results.folder_state import claimed

        held.enter_context(claimed(out, resume, replace))
        start_jax()
        from imubayes.display.check_report import usable, warning_lines

        tell("reading the campaign")
        recorded = usable(inspection := inspected())
    print("".join(f"{line}\n" for line in warning_lines(inspection)), end="", file=sys.stderr)
    return recorded


def _print_summary(summary: "Summary", verbose: bool, campaign: Path, out: Path) -> None:
    from imubayes.display.fit_cautions import next_command
    from imubayes.display.fit_report import summary_report
    from imubayes.display.report_layout import print_report

    print_report(summary_report(summary, verbose=verbose))
    print(f"\nresult in {out}; next: {next_command(summary, str(campaign), str(out))}")
