"""`imubayes remove`: a step back, with what it costs."""

from pathlib import Path
from typing import Annotated

import cyclopts

from imubayes.cli.add import print_change
from imubayes.cli.options import Flag, Json, Trust


def remove(
    *effects: str,
    source: Annotated[Path, cyclopts.Parameter(name="--from")],
    out: Path,
    sample: Annotated[bool, cyclopts.Parameter(negative="--no-sample")] = False,
    seed: int = 0,
    as_json: Json = False,
    verbose: Flag = False,
    trust: Trust = False,
) -> int:
    """Remove effects from the model of a result, fit again from there, and show what that costs.

    Example: imubayes remove gyro_g_sensitivity --from results/second --out results/without

    Parameters
    ----------
    effects
        Names of effects or noise members of the model, or a Python file that defines some of them.
    source
        Result folder of the model to go on from; it stays as it is.
    out
        Result folder to write.
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
    from imubayes.errors import input_error

    if not effects:
        raise input_error("no effect is named", "command line", "effects of the model", "name one")
    with progress() as tell:
        start_jax("remove")
        trusting(source, trust)
        from imubayes.api import remove as remove_effects

        change = remove_effects(source, effects, out, sample=sample, seed=seed, progress=tell)
    return print_change(change, as_json, verbose)
