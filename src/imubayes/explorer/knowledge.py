"""What the runs determined, what they did not, and the run that would: the tables of a fit, and any one quantity."""

import numpy as np

from imubayes.display.fit_quality_tables import combination_sheet, contribution_sheet, next_run_sheet, weak_sheet
from imubayes.display.numbers_and_labels import pretty
from imubayes.display.quantity_tables import derived_sheet, parameter_sheet
from imubayes.explorer.edited_model import prior_text
from imubayes.explorer.geometry import AxisFrame, axis_frames
from imubayes.explorer.messages import ShownTable, shown_table
from imubayes.foundations.errors import closest_first, input_error
from imubayes.foundations.records import Record
from imubayes.results.result import Result
from imubayes.results.stored_tables import draws_of
from imubayes.results.summary import in_output_units

_PLACES, _REACH, _KERNEL = 81, 5.0, 0.25


class KnownTables(Record):
    """The tables of what is known, the names of the quantities that can be asked for, and the sensor axes."""

    tables: tuple[ShownTable, ...]
    quantities: tuple[str, ...]
    frames: tuple[AxisFrame, ...]


class QuantityFacts(Record):
    """One quantity: densities of posterior and prior at places `x` in `unit`, each over its highest value.

    `written` is the prior of a parameter as a model file has it; empty of a derived quantity.
    """

    name: str
    unit: str
    written: str
    x: tuple[float, ...]
    posterior: tuple[float, ...]
    prior: tuple[float, ...]


def known_tables(result: Result) -> KnownTables:
    """Return what the runs of a result determined, and what they did not."""
    summary = result.summary
    sheets = (
        weak_sheet(summary), next_run_sheet(summary), combination_sheet(summary), derived_sheet(summary),
        parameter_sheet(summary), contribution_sheet(summary),
    )  # fmt: skip
    shown, names = tuple(map(shown_table, sheets)), tuple(result.quantities)
    return KnownTables(tables=shown, quantities=names, frames=axis_frames(result))


def quantity_facts(result: Result, name: str) -> QuantityFacts:
    """Return prior and posterior of a quantity; raises InputError for one that the result does not have."""
    if name not in result.quantities:
        allowed = closest_first(name, result.quantities)
        raise input_error(f"no quantity '{name}'", "quantity", allowed, "choose one of these")
    posterior = result.draws.get(name, np.zeros(0))
    prior = draws_of(result.posterior["prior"].to_dataset(), [name]).get(name, np.zeros(0))
    found = posterior[np.isfinite(posterior)]
    if len(found) < 2:
        raise input_error(f"'{name}' has no draws", "quantity", "a quantity with draws", "choose another one")
    middle, reach = float(np.median(found)), _REACH * max(float(found.std()), 1e-300)
    x = np.linspace(middle - reach, middle + reach, _PLACES)
    shown = {each.name: each for each in (*in_output_units(result.summary).parameters, *result.summary.derived)}
    return QuantityFacts(
        name=name, unit=pretty(shown[name].unit), written=prior_text(result.fit.model, name), x=tuple(x.tolist()),
        posterior=_density(found, x), prior=_density(prior, x),
    )  # fmt: skip


def _density(draws: np.ndarray, x: np.ndarray) -> tuple[float, ...]:
    """Return a kernel density of draws at places, over its highest value; 0 without draws."""
    known = draws[np.isfinite(draws)]
    width = _KERNEL * max(float(known.std()) if len(known) else 0.0, 1e-300)
    found = np.sum(np.exp(-0.5 * ((x[:, None] - known) / width) ** 2), axis=1)
    return tuple((found / max(float(found.max()), 1e-300)).tolist())
