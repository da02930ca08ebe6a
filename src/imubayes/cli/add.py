"""`imubayes add`: a step forward, with what it brought."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import cyclopts

from imubayes.cli.options import Flag, Json, Names, Trust, print_json, split

if TYPE_CHECKING:
    from imubayes.results.model_change import ModelChange


def add(
    *effects: str,
    to: Path,
    out: Path,
    channels: Names = None,
    sample: Annotated[bool, cyclopts.Parameter(negative="--no-sample")] = False,
    seed: int = 0,
    as_json: Json = False,
    verbose: Flag = False,
    trust: Trust = False,
) -> int:
    """Add effects to the model of a result, fit again from there, and show what that brought.

    Example: imubayes add gyro_g_sensitivity --to results/first --out results/second

    Parameters
    ----------
    effects
        Names of effects or noise members; `imubayes effects` lists them. A Python file, as `imubayes diagnose --python`
        prints one, stands for the effects that it defines. Without any, the simplest explanation of the diagnosis.
    to
        Result folder of the model to go on from; it stays as it is.
    out
        Result folder to write.
    channels
        Channels that the effects act on; by default those the diagnosis named, or all they can act on.
    sample
        Sample the posterior; by default the Laplace approximation is used.
    seed
        Seed of the sampler.
    as_json
        Print one JSON object on standard output.
    verbose
        List the residual rms of every channel and run, also where it did not change.
    trust
        Trust the effect files that come along: they are code, and run, now and later, only where they are trusted.
    """
    from imubayes.cli.session import progress, start_jax, trusting

    with progress() as tell:
        start_jax("add")
        trusting(to, trust)
        from imubayes.api import add as add_effects

        change = add_effects(to, effects, out, split(channels), sample=sample, seed=seed, progress=tell)
    return print_change(change, as_json, verbose)


def print_change(change: "ModelChange", as_json: bool, verbose: bool) -> int:
    """Print what a change of a model brought; return the exit status: 0 where the refit is taken, else 1."""
    from imubayes.display.change_report import change_report, next_command
    from imubayes.display.report_layout import print_report

    if as_json:
        print_json(change.model_dump(mode="json") | {"next": next_command(change)})
    else:
        print_report(change_report(change, verbose))
    if not change.taken:
        print(change.message, file=sys.stderr)
    return 0 if change.taken else 1
