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
        Result folder of a fit of the same campaign, whose biases are subtracted first.
    """
    from imubayes.campaign import load_campaign
    from imubayes.display.carrier_motion import fitted_biases, rotating_run, write_carrier
    from imubayes.results.result import read_result

    loaded = load_campaign(campaign)
    chosen = rotating_run(loaded, run)
    biases = None if result is None else fitted_biases(loaded, read_result(result).summary)
    for file in write_carrier(out, loaded, chosen, biases):
        print(f"wrote {file}")
    return 0
