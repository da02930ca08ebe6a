"""From a plan and a seed to a campaign folder: draw the truth, simulate every run, write it all."""

from collections.abc import Callable
from pathlib import Path

import truth
import write
from plan import Plan, read_out
from sensor import Values


def write_simulated(
    folder: Path,
    plan: Plan,
    seed: int,
    more_derived: Callable[[Values], dict[str, float]] = lambda values: {},
    values: Values | None = None,
    hidden: dict | None = None,
) -> dict[str, float]:
    """Write `plan` into `folder`; return true parameters and derived quantities, one flat dictionary.

    Parameters
    ----------
    more_derived : further derived quantities of the true values.
    values : the true values; None to draw them.
    hidden : what is said in the truth file of effects that the model lacks.
    """
    values = dict(plan.draw(seed) if values is None else values)
    derived = truth.mounting_angles(plan.channels, plan.mountings, values)
    derived |= truth.scale_factors(plan.channels, values)
    derived |= more_derived(values)
    nuisance = {}
    write.write_campaign_file(folder, plan, seed, write.run_entries(plan.runs))
    for run, readings in zip(plan.runs, read_out(plan, values, seed), strict=True):
        write.write_run(folder, plan, run, readings)
        for channel, offset in zip(plan.channels, readings.run_offset, strict=True):
            nuisance[f"run_offset[{channel.name},{run.name}]"] = float(offset)
    write.write_truth(folder, plan, seed, values, derived, nuisance, hidden)
    return values | derived
