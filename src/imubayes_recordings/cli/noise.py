"""`imubayes noise`: Allan deviation and noise terms of static records."""

from pathlib import Path
from typing import TYPE_CHECKING

from imubayes.cli.session import Flag, Json, Names, progress, show, split
from imubayes.foundations.errors import input_error

if TYPE_CHECKING:
    from imubayes.display.layout import Report


def noise(
    campaign: Path,
    *,
    runs: Names = None,
    out: Path | None = None,
    shortest_tau: float = 0.0,
    sample_rate: float | None = None,
    robust: Flag = False,
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
        Folder to write: noise.json, the Allan deviation of every run as a figure, imu.yaml for kalibr, and
        noise-priors.toml, the terms as priors for models of other campaigns of the unit (key `noise_priors`).
    shortest_tau
        Shortest averaging time in s that the terms have to describe; above 0 if a filter shapes the noise of
        single samples.
    sample_rate
        Sampling rate in Hz of the campaigns that will use noise-priors.toml; by default that of the record.
    robust
        Leave out stretches in which the unit did not rest: steps on the floor, a hand on the bench.
    as_json
        Print one JSON object on standard output.
    """
    from imubayes import load_campaign
    from imubayes_recordings.noise_analysis.noise_record import static_noise

    for name, value in (("--shortest-tau", shortest_tau), ("--sample-rate", sample_rate or 0.0)):
        if not 0 <= value < float("inf"):
            raise input_error(f"a value of {value:g}", name, "a number above 0", "correct it")
    written: list[Path] = []
    with progress("reading the campaign") as tell:
        read = load_campaign(campaign)
        found = static_noise(read, split(runs) or (), shortest_tau, tell, robust)
        if out is not None:
            from imubayes_recordings.display.noise_report import write_noise
            from imubayes_recordings.noise_analysis.noise_record import of_record

            tell("drawing")
            out.mkdir(parents=True, exist_ok=True)
            written = write_noise(out, found, sample_rate, of_record(found, read))

    def report() -> "Report":
        from imubayes_recordings.display.noise_report import noise_report  # it brings Matplotlib

        return noise_report(found)

    show(lambda: found, report, as_json)
    for file in written if not as_json else ():
        print(f"wrote {file}")
    return 0 if all(channel.converged for channel in found.channels) else 1
