"""The batch in lanes against a loop of `scipy.optimize.least_squares` over the same units, residuals and optima.

The units are those of `data/trihedral-imu` with other readings.  SciPy minimises the residual at the noise scales that
the batch has found.  The batch is measured with these noise scales given, which is the same task, and if it finds
them as well.  Times are CPU times, so that other processes do not disturb them.
"""

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from common import Report, in_words, trihedral
from scipy.optimize import least_squares

from imubayes.model.bind import Model
from imubayes.model.likelihood import residuals
from imubayes.model.noise_covariance import whiten, whitener
from imubayes.model.problem import Problem, predict_with_jacobian, prior_widths
from imubayes_archive.unit_fits.batch_folder import BatchSettings
from imubayes_archive.unit_fits.fit_unit import posterior_of, posteriors
from imubayes_archive.unit_fits.group_moments import grouped_misfit, grouped_model, marginal_slope, normal_equations
from imubayes_archive.unit_fits.lanes import (
    LANES,
    Climb,
    LaneMode,
    LaneStructure,
    Stacked,
    along_chord,
    climbed,
    find_modes,
    first_curvature,
)
from imubayes_archive.unit_fits.posterior_table import UnitIdentity

NUMERIC_BAR, EXACT_BAR, UNITS, SAMPLE = 25.0, 5.0, 1000, 20

_residuals = eqx.filter_jit(residuals)


@dataclass(frozen=True)
class Optima:
    """Where units ended: z (LANES, P), noise scales (LANES, H), and whether they converged."""

    z: np.ndarray
    h: np.ndarray
    converged: np.ndarray


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
    chosen = units(model, LANES if quick else UNITS)
    few, groups = chosen[:LANES], [chosen[start : start + LANES] for start in range(0, len(chosen), LANES)]
    structure = LaneStructure.of(model.problem)
    assert structure is not None
    clock = time.perf_counter()
    varying = structure.stacked(few)
    mode = find_modes(structure, varying)
    compiling = time.perf_counter() - clock
    find_modes(structure, varying, mode.h)
    found, free = _in_one_run(structure, groups, [None] * len(groups))
    again, same = _in_one_run(structure, groups, [each.h for each in found])
    apart = max(float(np.max(np.abs(a.z - b.z))) for a, b in zip(found, again, strict=True))
    sample = LANES if quick else SAMPLE
    report.say(f"{len(chosen)} units in one run, stacking in lanes included; SciPy on the first {sample} of them.")
    report.say(f"Mean load of the machine in the last 15 minutes: {os.getloadavg()[2]:.0f}.")
    report.say(f"All converged: {all(bool(each.converged.all()) for each in (*found, *again))}. "
               f"Both optima agree to {apart:.0e} prior standard deviations.\n")  # fmt: skip
    ends = [(z, h) for each in found for z, h in zip(each.z, each.h, strict=True)]
    pairs = list(zip(chosen, ends, strict=True))[:sample]
    loops = [_scipy_loop(pairs, method, exact) for method in ("trf", "lm") for exact in (False, True)]
    rows = [
        ["imubayes batch, noise scales given", "exact, sparse", in_words(same), "1", f"{same / free:.2f}", "0"],
        ["imubayes batch, noise scales found as well", "exact, sparse", in_words(free), f"{free / same:.1f}", "1", ""],
    ]
    for taken, off, method, exact in loops:
        rows.append([f"SciPy {method}, compiled residual", "exact" if exact else "2-point", in_words(taken),
                     f"{taken / same:.1f}", f"{taken / free:.1f}", f"{off:.1e}"])  # fmt: skip
    head = ["optimum of a unit", "Jacobian", "CPU time", "times ours, same task", "times ours, scales found"]
    report.table([*head, "off by at most (posterior sd)"], rows)
    for exact, bar, name in ((False, NUMERIC_BAR, "numeric"), (True, EXACT_BAR, "exact")):
        best = min(taken for taken, _, _, kind in loops if kind == exact)
        report.judge(f"units/s against SciPy's faster method, {name} Jacobian, same task", best / same, bar)
        report.judge("the same where the batch finds the noise scales as well", best / free, bar)
    report.say()
    _shares(report, structure, few, mode, same)
    _whole(report, structure, varying, few, mode)
    report.say(f"First call, compiled code from the cache where it is there: {compiling:.1f} s.")
    return report


def _in_one_run(
    structure: LaneStructure, groups: list[list[Model]], given: Sequence[Any]
) -> tuple[list[Optima], float]:
    """Return the fits of groups of units, one after the other, and the CPU time of a unit."""
    clock, found = time.process_time(), []
    for group, scales in zip(groups, given, strict=True):
        end = find_modes(structure, structure.stacked(group), scales)
        found.append(Optima(np.asarray(end.model.z), np.asarray(end.h), np.asarray(end.converged)))
    return found, (time.process_time() - clock) / sum(map(len, groups))


def _scipy_loop(
    chosen: Sequence[tuple[Model, tuple[np.ndarray, np.ndarray]]], method: str, exact: bool
) -> tuple[float, float, str, bool]:
    """Return CPU time a unit, and the largest distance of the optima in posterior standard deviations."""
    taken, off = 0.0, 0.0
    for model, (best, scales) in chosen:
        problem, h = model.problem, jnp.asarray(scales)

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


def _shares(report: Report, structure: LaneStructure, chosen: list[Model], mode: LaneMode, whole: float) -> None:
    varying, (size, hyper) = structure.stacked(chosen), structure.problem.size
    z, h = np.zeros((LANES, size)), np.zeros((LANES, hyper))
    middle = structure.run(grouped_model, varying, z)
    start = Climb(h, structure.run(first_curvature, varying, middle, h), np.zeros(LANES, dtype=bool))
    parts = {
        "Jacobian and sums over groups": (3, lambda: structure.run(grouped_model, varying, z)),
        "residual": (6, lambda: structure.run(grouped_misfit, varying, z)),
        "linear algebra and residual: two steps with one Jacobian": (
            3, lambda: structure.run(along_chord, varying, mode.model, mode.h, np.full(LANES, 2))),
        "of these, normal equations": (9, lambda: structure.run(normal_equations, varying, mode.model, mode.h)),
        "stacking": (1, lambda: structure.stacked(chosen)),
        "noise scales (where they are found): from the middle of the prior": (
            1, lambda: structure.run(climbed, varying, mode.model, start)),
        "noise scales: value and slope of their marginal": (
            0, lambda: structure.run(marginal_slope, varying, mode.model, mode.h)),
    }  # fmt: skip
    rows = []
    for name, (times, call) in parts.items():
        taken = cpu_seconds(call, 10) / LANES
        given = not name.startswith("noise scales")
        share = f"{100 * times * taken / whole:.0f} %" if given else ""
        rows.append([name, str(times) if given else "", in_words(taken), share])
    report.table(["part", "times", "CPU time a unit, once", "share of the optimum, scales given"], rows)


def _whole(report: Report, structure: LaneStructure, varying: Stacked, chosen: list[Model], mode: LaneMode) -> None:
    identity, settings = UnitIdentity("", "", "", ""), BatchSettings()

    def rows_of_units() -> None:
        for fit in posteriors(structure, varying, mode, chosen):
            assert fit is not None
            posterior_of(fit, settings, identity)

    taken = cpu_seconds(rows_of_units, 3) / LANES
    report.say(f"Posterior, derived quantities and rows of the tables: {in_words(taken)} of CPU time a unit.\n")


if __name__ == "__main__":
    measure().write()
