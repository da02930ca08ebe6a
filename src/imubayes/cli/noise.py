"""`imubayes noise`: Allan deviation and noise terms of static records."""

from pathlib import Path

from imubayes.cli.options import Json, Names, print_json, split


def noise(
    campaign: Path,
    *,
    runs: Names = None,
    out: Path | None = None,
    shortest_tau: float = 0.0,
    sample_rate: float | None = None,
    as_json: Json = False,
) -> int:
    """Estimate the noise terms of static records by likelihood, and their Allan deviations.

    Example: imubayes noise data/static-record --out results/noise

    Parameters
    ----------
    campaign
        Folder with campaign.toml.
    runs
        Runs of procedure static_record; by default all of them.
    out
        Folder to write: noise.json, the Allan deviation of every run as a figure, and noise-priors.toml, the
        terms as priors for models of other campaigns of the unit (key `noise_priors` of a model file).
    shortest_tau
        Shortest averaging time in s that the terms have to describe; above 0 where a filter shapes the noise of
        single samples.
    sample_rate
        Sampling rate in Hz of the raw data of those campaigns, for the priors; by default that of the record.
    as_json
        Print one JSON object on standard output.
    """
    from imubayes.campaign import load_campaign
    from imubayes.cli.session import progress
    from imubayes.errors import input_error
    from imubayes.noise_analysis.noise_record import static_noise

    for name, value in (("--shortest-tau", shortest_tau), ("--sample-rate", sample_rate or 0.0)):
        if not 0 <= value < float("inf"):
            raise input_error(f"a value of {value:g}", name, "a number above 0", "correct it")
    written: list[Path] = []
    with progress("reading the campaign") as tell:
        found = static_noise(load_campaign(campaign), split(runs) or (), shortest_tau, tell)
        if out is not None:
            from imubayes.display.noise_report import write_noise

            tell("drawing")
            out.mkdir(parents=True, exist_ok=True)
            written = write_noise(out, found, sample_rate)
    if as_json:
        print_json(found.model_dump(mode="json"))
    else:
        from imubayes.display.noise_report import noise_report
        from imubayes.display.report_layout import print_report

        print_report(noise_report(found))
        for file in written:
            print(f"wrote {file}")
    return 0 if all(channel.converged for channel in found.channels) else 1
