"""The batch in lanes against a loop of `scipy.optimize.least_squares` over the same units, residuals and optima.

The units are those of `data/trihedral-imu` with other readings.  SciPy minimises the residual at the noise scales that
the batch has found; the batch finds these as well.  Times are CPU times, so that other processes do not disturb them.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from common import Report, in_words, trihedral
from scipy.optimize import least_squares

from imubayes.batch.batch_settings import BatchSettings
from imubayes.batch.fit_unit import posterior_of
from imubayes.batch.group_moments import grouped_misfit, grouped_model
from imubayes.batch.lane_mode import LaneMode, advance, find_modes, first_curvature
from imubayes.batch.lane_posterior import posteriors
from imubayes.batch.lanes import LANES, LaneStructure
from imubayes.batch.posterior_table import UnitIdentity
from imubayes.model.bind import Model
from imubayes.model.likelihood import residuals
from imubayes.model.noise_covariance import whiten, whitener
from imubayes.model.problem import Problem, predict_with_jacobian, prior_widths

NUMERIC_BAR, EXACT_BAR, SAME_WITHIN = 25.0, 5.0, 0.05

_residuals = eqx.filter_jit(residuals)


@eqx.filter_jit
def _jacobian(problem: Problem, z: jax.Array, h: jax.Array) -> jax.Array:
    whitened = whiten(problem, whitener(problem, h), predict_with_jacobian(problem, z)[1])
    return jnp.concatenate([-whitened, jnp.diag(1 / prior_widths(problem, h))])


def units(model: Model, count: int) -> list[Model]:
    """Return units whose readings differ from those of a model by a part in a million."""
    random, observations = np.random.default_rng(0), model.problem.observations
    value = np.asarray(observations.value)
    made = []
    for _ in range(count):
        other = value * (1 + random.normal(0, 1e-6, len(value)))
        problem = eqx.tree_at(lambda p: p.observations.value, model.problem, jnp.asarray(other))
        made.append(replace(model, problem=problem))
    return made


def cpu_seconds(call: Callable, times: int) -> float:
    """Return the CPU time of a call whose outcome is waited for; the first, which compiles, is left out."""
    jax.block_until_ready(jax.tree.leaves(eqx.filter(call(), eqx.is_array)))
    clock = time.process_time()
    for _ in range(times):
        jax.block_until_ready(jax.tree.leaves(eqx.filter(call(), eqx.is_array)))
    return (time.process_time() - clock) / times


def measure(quick: bool = False) -> Report:
    report = Report("batch", "Units fitted in lanes: `data/trihedral-imu`, full baseline model")
    model = trihedral()
    size, hyper = model.problem.size
    report.say(f"{size} parameters, {hyper} noise scales, {len(model.problem.observations.value)} readings a unit.\n")
    chosen = units(model, LANES)
    structure = LaneStructure.of(model.problem)
    assert structure is not None
    clock = time.perf_counter()
    varying = structure.stacked(chosen)
    mode = find_modes(structure, varying)
    compiling = time.perf_counter() - clock
    ours = cpu_seconds(lambda: find_modes(structure, varying), 3 if quick else 20) / LANES
    loops = [_scipy_loop(chosen, mode, method, exact) for method in ("trf", "lm") for exact in (False, True)]
    rows = [["imubayes batch, noise scales found as well", "exact, sparse", in_words(ours), "1", "0"]]
    for taken, off, method, exact in loops:
        rows.append([f"SciPy {method}, compiled residual", "exact" if exact else "2-point", in_words(taken),
                     f"{taken / ours:.1f}", f"{off:.1e}"])  # fmt: skip
    report.table(["optimum of a unit", "Jacobian", "CPU time", "times ours", "off by at most (posterior sd)"], rows)
    for exact, bar, name in ((False, NUMERIC_BAR, "numeric"), (True, EXACT_BAR, "exact")):
        best = min(taken for taken, _, _, kind in loops if kind == exact)
        report.judge(f"units/s against SciPy's faster method with the {name} Jacobian", best / ours, bar)
    report.say()
    _shares(report, structure, varying, ours)
    _whole(report, structure, varying, chosen, mode)
    report.say(f"First call, compiled code from the cache where it is there: {compiling:.1f} s.")
    return report


def _scipy_loop(chosen: list[Model], mode: LaneMode, method: str, exact: bool) -> tuple[float, float, str, bool]:
    """Return CPU time a unit, and the largest distance of the optima in posterior standard deviations."""
    taken, off = 0.0, 0.0
    for lane, model in enumerate(chosen):
        problem, h, best = model.problem, mode.h[lane], np.asarray(mode.model.z[lane])

        def residual(z: np.ndarray, problem=problem, h=h) -> np.ndarray:
            return np.asarray(_residuals(problem, jnp.asarray(z), h))

        def slope(z: np.ndarray, problem=problem, h=h) -> np.ndarray:
            return np.asarray(_jacobian(problem, jnp.asarray(z), h))

        for warm in (residual, slope):
            warm(best)
        jac: Any = slope if exact else "2-point"
        start, clock = np.zeros(len(best)), time.process_time()
        found = least_squares(residual, start, jac=jac, method=method)
        taken += time.process_time() - clock
        jacobian = slope(best)
        deviation = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
        off = max(off, float(np.max(np.abs(found.x - best) / deviation)))
    return taken / len(chosen), off, method, exact


def _shares(report: Report, structure: LaneStructure, varying: Problem, whole: float) -> None:
    size, hyper = structure.problem.size
    z, h = jnp.zeros((LANES, size)), jnp.zeros((LANES, hyper))
    linear = structure.run(grouped_model, varying, z)
    curvature = structure.run(first_curvature, varying, linear, h)
    parts = {
        "Jacobian and sums over groups, each of two": lambda: structure.run(grouped_model, varying, z),
        "residual": lambda: structure.run(grouped_misfit, varying, z),
        "linear algebra: noise scales and step, from the middle of the prior": lambda: structure.run(
            advance, varying, linear, h, curvature
        ),
    }
    rows = []
    for name, call in parts.items():
        taken = cpu_seconds(call, 10) / LANES
        rows.append([name, in_words(taken), f"{100 * taken / whole:.0f} %"])
    report.table(["part, called once", "CPU time a unit", "share of the optimum"], rows)


def _whole(report: Report, structure: LaneStructure, varying: Problem, chosen: list[Model], mode: LaneMode) -> None:
    identity, settings = UnitIdentity("", "", "", ""), BatchSettings()

    def rows_of_units() -> None:
        for fit in posteriors(structure, varying, mode, chosen):
            assert fit is not None
            posterior_of(fit, settings, identity)

    taken = cpu_seconds(rows_of_units, 3) / LANES
    report.say(f"Posterior, derived quantities and rows of the tables: {in_words(taken)} of CPU time a unit.\n")


if __name__ == "__main__":
    measure().write()
