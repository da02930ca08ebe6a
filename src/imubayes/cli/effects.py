"""`imubayes effects`: the catalogue."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def effects(name: str | None = None, *, campaign: Annotated[Path | None, Parameter(name="--for")] = None) -> int:
    """List the catalogue of effects, explain one, or say which a campaign could show.

    Example: imubayes effects gyro_g_sensitivity

    Parameters
    ----------
    name
        The effect to explain.
    campaign
        Folder with campaign.toml: which effects its runs could show, and what is missing for the others.
    """
    from imubayes.cli.session import progress, start_jax

    with progress():
        start_jax()
        from imubayes.display.effect_catalogue import print_catalogue, print_effect, print_observable

    if campaign is not None:
        from imubayes.campaign import load_campaign

        print_observable(load_campaign(campaign))
    if name is not None:
        print_effect(name)
    elif campaign is None:
        print_catalogue()
    return 0
