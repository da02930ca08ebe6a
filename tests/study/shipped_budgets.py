"""Uncertainty budgets of the shipped campaigns: they add up, and agree with refits in which one prior is exact.

    python tests/study/shipped_budgets.py             writes the first table of benchmarks/results/budgets.md
    python tests/study/shipped_budgets.py CAMPAIGN …  prints a line a campaign and one a refit

Each campaign is fitted with its own model, as `imubayes fit --no-sample` does, and its budgets are those of a report.
The priors whose exactness would narrow some other quantity most are made exact one after the other, at the value at the
mode, and the campaign is fitted again.
"""

import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from imubayes.api import fit
from imubayes.campaign import load_campaign
from imubayes.inference.fitted_model import Fit
from imubayes.inference.run_fit import joint_fit
from imubayes.model.bind import bind
from imubayes.model.model_file import read_model
from imubayes.parameters.declarations import Layout, Priors
from imubayes.parameters.priors import Normal
from imubayes.results.result import Result, read_result, result_of
from imubayes.results.stored_tables import draws_of
from imubayes.results.summary import is_constant
from imubayes_qualification.budgets.report_budgets import functions_of_quantities, unit_with_budgets
from imubayes_qualification.budgets.uncertainty_budget import BudgetArrays, budget_of
from imubayes_qualification.budgets.unit_under_test import unit_under_test
from imubayes_qualification.evaluation.decision_rules import ADDS_UP

ROOT = Path(__file__).parents[2]
CAMPAIGNS = sorted(file.parent.name for file in (ROOT / "data").glob("*/campaign.toml"))
TABLE = ROOT / "benchmarks" / "results" / "budgets.md"
REFITS = 2
# Draws of each fit: the scatter of few runs has heavy tails, and 10 000 draws of kurtosis 20 give an sd to 2 %.
DRAWS = 10_000
# Width of a prior that counts as exact, of its own; the least narrowing worth a look; what counts as nothing left.
EXACT, VISIBLE, VANISHES = 1e-4, 0.1, 0.01


@dataclass(frozen=True)
class Narrowing:
    """A quantity with one prior exact: ratio of its standard uncertainty to that before, in the budget and refitted.

    `error` is the relative Monte Carlo error of the refitted one.
    """

    prior: str
    quantity: str
    in_budget: float
    refitted: float
    error: float

    @property
    def difference(self) -> float:
        """Relative difference of the two."""
        return self.refitted / self.in_budget - 1


def model_file(campaign: str) -> Path:
    """Return the model of a shipped campaign."""
    truth = tomllib.loads((ROOT / "data" / campaign / "truth.toml").read_text())
    return ROOT / truth["hidden"]["model"] if "hidden" in truth else ROOT / "models" / f"{campaign}.toml"


@dataclass(frozen=True)
class Closing:
    """How the budgets of the report of a campaign add up: remainders as shares of the posterior variance.

    `scaled` is the number of quantities whose contributions are scaled to their draws.
    """

    campaign: str
    quantities: int
    largest: float
    of: str
    beyond: int
    scaled: int

    @property
    def row(self) -> str:
        """The row of the table."""
        largest = f"{round(100 * self.largest, 1) + 0.0:.1f} %".replace("-", "−")
        return f"| {self.campaign} | {self.quantities} | {largest} | `{self.of}` | {self.beyond} | {self.scaled} |"


def closing(campaign: str, folder: Path) -> Closing:
    """Return how the budgets of a shipped campaign close, through a result folder as a user has it."""
    fit(ROOT / "data" / campaign, model_file(campaign), folder, sample=False)
    quantities = unit_with_budgets(read_result(folder)).budgets.quantities
    worst = max(quantities, key=lambda each: abs(each.remainder))
    beyond = sum(abs(each.remainder) > ADDS_UP for each in quantities)
    scaled = sum(each.scaled != 1 for each in quantities)
    return Closing(campaign, len(quantities), worst.remainder, worst.name, beyond, scaled)


def fitted(campaign: str) -> Result:
    """Return the fit of a shipped campaign, without sampling."""
    model = bind(read_model(model_file(campaign)), load_campaign(ROOT / "data" / campaign))
    return result_of(joint_fit(model, None, laplace_draws=DRAWS))


def budget(result: Result) -> BudgetArrays:
    """Return the budgets of all quantities, as the report has them."""
    unit = unit_under_test(result)
    draws = unit.quantities.draws
    names = [line.name for line in (*result.summary.parameters, *result.summary.derived)]
    known = [name for name in names if name in draws and not is_constant(draws[name])]
    return budget_of(result, known, functions_of_quantities(result, unit))


def with_exact_prior(fit: Fit, name: str) -> Fit:
    """Return the fit with one parameter known to be what it is at the mode."""
    model = fit.model
    chosen = model.layout.index(name)
    value = np.asarray(model.problem.priors.values(jnp.asarray(fit.z)))[chosen]
    parameters = list(model.layout.parameters)
    width = EXACT * float(parameters[chosen].prior.sd())
    parameters[chosen] = replace(parameters[chosen], prior=Normal(value, np.asarray(width)))
    layout = Layout(tuple(parameters))
    priors = Priors.stack([parameter.prior for parameter in parameters])
    problem = eqx.tree_at(lambda p: p.priors, model.problem, priors)
    return joint_fit(replace(model, layout=layout, problem=problem), None, laplace_draws=DRAWS)


def narrowings(result: Result, arrays: BudgetArrays) -> Iterator[Narrowing]:
    """Yield what making the most telling priors exact does to the quantities that they narrow visibly."""
    left = arrays.improved.exact_prior / np.maximum(arrays.improved.at_mode, np.finfo(float).tiny)[:, None]
    fixed = np.asarray(result.fit.model.problem.spread_of) == len(result.fit.h)
    for column, parameter in enumerate(arrays.priors):
        own = np.array([name.endswith(parameter.name) for name in arrays.names])
        left[own, column] = 1.0
        if parameter.nuisance or not fixed[column] or not np.isfinite(parameter.prior_sd):
            left[:, column] = 1.0
    # Functions of the parameter alone vanish with it.
    left[left < VANISHES] = 1.0
    # Only what is linear about the mode: elsewhere a ratio at the mode is not one of posterior deviations.
    linear = np.abs(arrays.second_order) < 0.01 * arrays.posterior
    linear &= ~np.isin(arrays.names, arrays.at_zero)
    left[~linear] = 1.0
    before = draws_of(result.posterior, arrays.names)
    for column in np.argsort(left.min(axis=0))[:REFITS]:
        prior = arrays.priors[column].name
        rows = np.flatnonzero(left[:, column] < 1 - VISIBLE)
        rows = [row for row in rows if arrays.names[row] in before]
        if not rows:
            continue
        exact = result_of(with_exact_prior(result.fit, prior))
        assert exact.summary.converged, exact.summary.message
        after = draws_of(exact.posterior, [arrays.names[row] for row in rows])
        for row in rows:
            name = arrays.names[row]
            ratio = float(np.nanstd(after[name]) / np.nanstd(before[name]))
            error = float(np.hypot(error_of_deviation(after[name]), error_of_deviation(before[name])))
            yield Narrowing(prior, name, float(left[row, column]), ratio, error)


def error_of_deviation(draws: np.ndarray) -> float:
    """Return the relative Monte Carlo error of the standard deviation of independent draws, by their kurtosis."""
    known = draws[np.isfinite(draws)]
    about = (known - known.mean()) / known.std()
    return float(np.sqrt((np.mean(about**4) - 1) / (4 * len(known))))


def main(campaigns: list[str]) -> None:
    """Print what each campaign shows."""
    for campaign in campaigns:
        clock = time.process_time()
        result = fitted(campaign)
        arrays = budget(result)
        share, error = arrays.remainder / arrays.posterior, arrays.posterior_error / arrays.posterior
        worst = int(np.argmax(np.abs(share)))
        print(
            f"{campaign}: {len(arrays.names)} quantities, largest remainder {share[worst]:+.4f} "
            f"({arrays.names[worst]}, Monte Carlo error {error[worst]:.4f}), beyond 2 %: {np.sum(np.abs(share) > 0.02)}"
        )
        found = list(narrowings(result, arrays))
        for each in sorted(found, key=lambda each: -abs(each.difference))[:4]:
            print(
                f"  {each.prior} exact: {each.quantity} × {each.in_budget:.4f}, "
                f"refitted {each.refitted:.4f} ± {100 * each.error:.1f} %"
            )
        print(
            f"  {len(found)} quantities of {len({e.prior for e in found})} refits, {time.process_time() - clock:.0f} s"
        )
        sys.stdout.flush()


BEGIN, END = "| campaign | quantities | largest remainder |", "## Refits"


def write_table() -> None:
    """Write the table of how budgets close."""
    head = f"{BEGIN} of | beyond 2 % | scaled to draws |\n| --- | ---: | ---: | --- | ---: | ---: |"
    with tempfile.TemporaryDirectory() as scratch:
        rows = []
        for campaign in CAMPAIGNS:
            rows.append(closing(campaign, Path(scratch) / campaign).row)
            print(rows[-1], flush=True)
    before, _, rest = TABLE.read_text(encoding="utf-8").partition(BEGIN)
    after = rest[rest.index(END) :]
    TABLE.write_text("\n".join([before + head, *rows, "", after]), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:]) if sys.argv[1:] else write_table()
