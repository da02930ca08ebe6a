"""A process that calls a kept function with every routine of LAPACK; `python kept_process.py FOLDER [forbid]`."""

import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from imubayes.compiled import kept_programs, program_identity
from imubayes.compiled.kept_programs import kept

program_identity._KNOWN.add("kept_process")
FORBIDDEN = "forbid" in sys.argv


@kept
def decomposed(matrix, times):
    assert not FORBIDDEN, "traced"
    lower = jnp.linalg.cholesky(matrix)
    return {
        "solved": jax.scipy.linalg.cho_solve((lower, True), jnp.ones(len(matrix))) * times,
        "eigen": jnp.linalg.eigh(matrix)[0],
        "singular": jnp.linalg.svd(matrix, compute_uv=False),
        "orthogonal": jnp.linalg.qr(matrix)[1],
        "lu": jax.scipy.linalg.lu_factor(matrix)[0],
        "named": times,
    }


if __name__ == "__main__":
    from kept_process import decomposed as found  # by its name, and not as of __main__

    jax.config.update("jax_enable_x64", True)
    kept_programs.keep_programs(Path(sys.argv[1]))
    root = np.random.default_rng(0).normal(size=(6, 6))
    for name, value in found(root @ root.T + np.eye(6), 3).items():
        print(name, np.asarray(value, dtype=float).tobytes().hex())
