"""The toy batch as a process of its own, to be killed: `toy_executor.py CAMPAIGNS MODEL OUT`."""

import sys

from test_run_batch import toy_executor

from imubayes_archive.unit_fits.run_batch import run_batch


def announced(tasks):
    """Say of each chunk that it is fitted."""
    for chunk in toy_executor(tasks, 0.003):
        print("fitted", flush=True)
        yield chunk


if __name__ == "__main__":
    campaigns, model, out = sys.argv[1:]
    run_batch(campaigns, model, out, announced, chunk=2)
