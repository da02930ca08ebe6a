"""`imubayes simulate`: a synthetic campaign from a plan, with a truth file."""

from pathlib import Path

from imubayes.cli.options import Trust


def simulate(plan: Path, *, out: Path, seed: int | None = None, trust: Trust = False) -> int:
    """Simulate a test plan: a campaign folder with a truth file.

    Example: imubayes simulate data/plans/trihedral-example.toml --out campaigns/simulated

    Parameters
    ----------
    plan
        Plan file: site, channels, tables, mountings, model and runs.
    out
        Campaign folder to write.
    seed
        Random seed; by default that of the plan.
    trust
        Trust the effect files that come along: they are code, and run, now and later, only where they are trusted.
    """
    from imubayes.cli.session import progress, start_jax, trusting

    with progress() as tell:
        start_jax()
        from imubayes.simulation.planned_campaign import read_plan
        from imubayes.simulation.simulated_campaign import simulate_plan

        trusting(read_plan(plan).model if trust else None, trust)
        tell("simulating")
        folder = simulate_plan(plan, out, seed)
    print(f"campaign in {folder}, truth in {folder / 'truth.toml'}; next: imubayes check {folder}")
    return 0
