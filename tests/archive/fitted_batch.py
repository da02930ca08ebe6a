"""A batch of real fits as a process of its own, to be killed: `fitted_batch.py CAMPAIGNS MODEL OUT`."""

import sys

from imubayes_archive.unit_fits.fit_chunk import in_process
from imubayes_archive.unit_fits.run_batch import run_batch


def announced(tasks):
    """Say of each chunk that it is fitted."""
    for chunk in in_process(tasks):
        print("fitted", flush=True)
        yield chunk


if __name__ == "__main__":
    campaigns, model, out = sys.argv[1:]
    run_batch(campaigns, model, out, announced, chunk=4)
