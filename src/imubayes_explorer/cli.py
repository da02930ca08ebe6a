"""Command `imubayes explore`: the loop on a page of this machine, in the browser."""

from contextlib import suppress
from pathlib import Path

from imubayes.cli.registration import Command
from imubayes.cli.session import Flag, Trust, progress, start_jax, trusting

_STEP = 5.0
"""Seconds that a fit at work has to end at its next step; what is left of it goes when the page is opened again."""


def explore(
    place: Path | None = None,
    *,
    model: Path | None = None,
    out: Path | None = None,
    port: int = 0,
    no_browser: Flag = False,
    trust: Trust = False,
) -> None:
    """Run the loop in the browser: brush residuals, see ranked causes, preview them, add one.

    Each accepted model is an ordinary result folder. The page shows the command of every click. The server listens on
    this machine alone. Stop it with Ctrl-C; accepted results are kept.

    Example: imubayes explore results/first

    Parameters
    ----------
    place
        Result folder, campaign folder with --model, or results folder of a batch, whose units are shown with their
        population. Without it, the example hidden-gyro is shown.
    model
        Model file, or the name of a shipped model; fitted first.
    out
        Result folder of that fit; by default results/CAMPAIGN-MODEL, which is opened if it exists.
    port
        Port of the server; 0 for any free one.
    no_browser
        Print the address only, and open no browser.
    trust
        Trust the effect files that come with the input. They are code, which runs only if trusted.
    """
    with progress() as tell:
        trusting(model or place, trust)
        start_jax("explore")
        from imubayes_explorer.start import explore as begin
        from imubayes_explorer.start import explore_units

        units = (
            None if place is None or model else explore_units(place, port=port, browser=not no_browser, progress=tell)
        )
        begun = units or begin(place, model, out, port=port, browser=not no_browser)
    print(f"{begun.address}\nStop with Ctrl-C. Accepted results are kept.", flush=True)
    try:
        with suppress(KeyboardInterrupt):
            begun.wait()
    finally:
        begun.stop(_STEP)


COMMANDS = (Command("imubayes_explorer.cli:explore", "The loop", 9),)
