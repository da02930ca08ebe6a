"""The population of an archive: cost over the number of units, beside emcee on the same hierarchical model.

Tables of posteriors are simulated: six parameters of which two are determined as a sum alone, in units of three lots.
All units have one design, which makes the density of emcee cheap.  It samples the marginal of means and spreads, from
which the units would follow; a thousand independent draws are what a user needs of it.
"""

import datetime
import time

import emcee
import numpy as np
from common import Report

from imubayes_archive.population.parameter_population import populations
from imubayes_archive.unit_fits.posterior_table import (
    Outcome,
    Quantities,
    UnitIdentity,
    UnitPosterior,
    parameter_table,
    unit_table,
)

PARAMETERS, NOISE, PRIOR, UNITS, BAR = 6, 0.5, 50.0, (30, 100, 300, 1000), 1.2
_DRAWS, _WALKERS, _AUTOCORRELATION, _WIDEST = 1000, 40, 60.0, 8.0


def simulated(count: int, seed: int = 0) -> tuple[list[UnitPosterior], np.ndarray, np.ndarray]:
    """Return posteriors of units, their information (P, P) and linear terms (n, P)."""
    random = np.random.default_rng(seed)
    rows = np.eye(PARAMETERS)[1:]
    rows[0, 0] = 1.0
    information = rows.T @ rows / NOISE**2
    covariance = np.linalg.inv(information + np.eye(PARAMETERS) / PRIOR**2)
    lots = random.choice(["A", "B", "C"], count)
    names = tuple(f"effect_{place}.value[ax]" for place in range(PARAMETERS))
    units, linear = [], []
    for place in range(count):
        truth = random.normal(0.0, 2.0, PARAMETERS)
        truth[2] += 15.0 * (lots[place] == "B")
        pulled = rows.T @ (rows @ truth + random.normal(0.0, NOISE, len(rows))) / NOISE**2
        mean, sd = covariance @ pulled, np.sqrt(np.diag(covariance))
        quantiles = mean + sd * np.array([-1.96, -0.674, 0.0, 0.674, 1.96])[:, None]
        width = np.full(PARAMETERS, PRIOR)
        of = Quantities(
            "parameter", names, ("ug",) * PARAMETERS, mean, sd, quantiles, 0 * width, width, 1 - (sd / width) ** 2
        )
        day = datetime.date(2020, 1, 1) + datetime.timedelta(days=place)
        identity = UnitIdentity(
            f"U{place:04d}", "c", f"d{place}", "f", day, tables=("t",), labels=(f"lot={lots[place]}",)
        )
        units.append(UnitPosterior(identity, Outcome("fitted"), (of,), covariance))
        linear.append(pulled)
    return units, information, np.array(linear)


def emcee_seconds(information: np.ndarray, linear: np.ndarray, steps: int) -> float:
    """Return CPU seconds that emcee takes for `_DRAWS` independent draws of means and spreads."""

    def log_density(point: np.ndarray) -> float:
        if np.max(np.abs(point[PARAMETERS:])) > _WIDEST:
            return -np.inf
        precision = np.diag(np.exp(-2 * point[PARAMETERS:]))
        inner = np.linalg.inv(information + precision)
        gain, mean = precision - precision @ inner @ precision, point[:PARAMETERS]
        pulled = linear @ inner
        value = 0.5 * np.sum(pulled * linear) + np.sum(pulled @ precision @ mean)
        value -= 0.5 * len(linear) * (mean @ gain @ mean + np.linalg.slogdet(information + precision)[1])
        value -= len(linear) * np.sum(point[PARAMETERS:]) - np.sum(point[PARAMETERS:])
        return float(value - 0.5 * np.sum((mean / PRIOR) ** 2))

    start = np.random.default_rng(1).normal(0.0, 0.1, (_WALKERS, 2 * PARAMETERS))
    sampler = emcee.EnsembleSampler(_WALKERS, 2 * PARAMETERS, log_density)
    clock = time.process_time()
    sampler.run_mcmc(start, steps)
    return (time.process_time() - clock) * _DRAWS * _AUTOCORRELATION / (steps * _WALKERS)


def measure(quick: bool = False) -> Report:
    """Return the cost of populations over the number of units."""
    report = Report("population", "Populations of an archive")
    rows, cost = [], []
    for count in UNITS[:2] if quick else UNITS:
        units, information, linear = simulated(count)
        tables = parameter_table("m", units), unit_table("m", "code", units)
        clock = time.process_time()
        record, _ = populations(*tables)
        cost.append((time.process_time() - clock) / count)
        found = [each.parameter for each in record.parameters if each.laws is not None and each.laws.findings]
        sampled = emcee_seconds(information, linear, 100 if quick else 1000)
        rows.append(
            [str(count), f"{cost[-1] * count:.1f}", f"{1000 * cost[-1]:.1f}", f"{sampled:.1f}", ", ".join(found)]
        )
    head = ["units", "CPU s", "CPU ms a unit", "emcee, means and spreads alone, CPU s", "structure found in"]
    report.table(head, rows)
    report.judge(
        "CPU time of a unit of the largest archive over that of the smallest", cost[-1] / cost[0], BAR, least=False
    )
    return report
