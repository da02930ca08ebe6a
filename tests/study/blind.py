"""Blind campaigns: drawn by a generator that shares no line of code with the models, and fitted without their effect.

Campaigns are drawn by `data/generators/hidden.py`: plan, unit, noise, effect, channel, size and sign.
"""

import os
import sys
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[2]
PROCEDURES = (
    "rate_table", "dividing_head", "thermal_ramp", "polar_tumble", "geographic_tumble", "rotation_modulation",
    "reference_gyro", "servo_table", "free_tumble", "static_record", "multi_axis_table", "centrifuge",
)  # fmt: skip
ONE_RUN = ("servo_table", "free_tumble", "static_record")
"""Procedures of one run, which has no scatter between runs."""


def draw(place: Path, seed: int, kind: str, procedure: str) -> Any:
    """Draw one campaign into a folder, of one procedure alone if it is named."""
    import hidden  # pyright: ignore[reportMissingImports]
    import hidden_servo  # pyright: ignore[reportMissingImports]

    if procedure == "servo_table":
        return hidden_servo.random_campaign(place, seed, kind)
    return hidden.random_campaign(place, seed, kind, {"dividing_head": "head"}.get(procedure, procedure) or None)


def mode_of(campaign: Path, model: Path) -> Any:
    """Return the fit alone, without what else is reported of one: that is compiled anew for many plans."""
    from imubayes.campaign import load_campaign
    from imubayes.model.bind import bind
    from imubayes.model.model_file import read_model

    declared = bind(read_model(model), load_campaign(campaign))
    return mode_from(declared, *(np.zeros(size) for size in declared.problem.size))


def mode_from(declared: Any, z: np.ndarray, h: np.ndarray) -> Any:
    """Return the fit of a declared model, started from a point."""
    import jax.numpy as jnp

    from imubayes.inference.fitted_model import Fit
    from imubayes.inference.posterior_mode import find_mode, message

    mode = find_mode(declared.problem, jnp.asarray(z), jnp.asarray(h))
    return Fit(declared, np.asarray(mode.z), np.asarray(mode.h), bool(mode.converged), message(mode))


def start_worker() -> None:
    """Make a worker ready: one thread, double precision, everything compiled kept on disk.

    Which run to make next is left out: it plays no part in what is judged, and is compiled anew for every plan.
    """
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
    sys.path.insert(0, str(ROOT / "data" / "generators"))
    import jax

    import imubayes.criticism.diagnose
    import imubayes.results.summarise

    imubayes.results.summarise.next_runs = lambda *_: ()
    imubayes.criticism.diagnose.discriminating_run = lambda *_: None
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_compilation_cache_dir", str(ROOT / ".cache" / "jax-study"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
