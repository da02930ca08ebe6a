"""What was going on when an entry was measured: the covariates that residuals are looked at against."""

from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from imubayes.inference.fitted import Fitted
from imubayes.model.problem import Problem, row_means, signal_path, values_of

_STANDARD_GRAVITY = 9.80665
_AXES = ("i", "o", "s")


@dataclass(frozen=True)
class ResidualCovariate:
    """One covariate of every entry.

    Attributes
    ----------
    name : as in run tables, or `rate_i`, `force_i`, … along the channel's own axes.
    unit : of the values.
    values : shape (E,), NaN where the run does not say.
    phrase : for a sentence: "… changes with <phrase>".
    """

    name: str
    unit: str
    values: np.ndarray
    phrase: str


_RECORDED = {
    "temperature": ("temperature_degC", "degC", 1.0, "temperature"),
    "converter_temperature": ("converter_temperature_degC", "degC", 1.0, "converter temperature"),
    "table_angle": ("table_angle_deg", "deg", 180 / np.pi, "table angle"),
    "time": ("time_s", "s", 1.0, "time within the run"),
    "power_on": ("power_on_s", "s", 1.0, "time since power-on"),
    "current": ("current_mA", "mA", 1e3, "injected current"),
}


def covariates(fitted: Fitted) -> list[ResidualCovariate]:
    """Return every covariate that some run has and that takes more than one value."""
    found = [*_experienced(fitted), *_recorded(fitted), *_worked_out(fitted)]
    return [one for one in found if _varies(one.values)]


def _varies(values: np.ndarray) -> bool:
    known = values[np.isfinite(values)]
    return known.size > 2 and float(np.ptp(known)) > 1e-9 * (1 + float(np.abs(known).max()))


def _experienced(fitted: Fitted) -> list[ResidualCovariate]:
    """Return rate and specific force along each channel's own axes, as the fitted model has them."""
    problem = fitted.model.problem
    means = _row_means(problem, fitted.z)
    readout = np.asarray(problem.observations.readout)
    count = len(fitted.model.entries)
    found = []
    for kind, unit, size in (("rate", "deg/s", np.pi / 180), ("force", "g", _STANDARD_GRAVITY)):
        for axis, letter in enumerate(_AXES):
            values = np.full(count, np.nan)
            values[: len(readout)] = np.asarray(means[kind][axis])[readout] / size
            what = "rate" if kind == "rate" else "specific force"
            found.append(
                ResidualCovariate(f"{kind}_{letter}", unit, values, f"{what} along the {_axis_word(axis)} axis")
            )
    return found


@eqx.filter_jit
def _row_means(problem: Problem, z):
    """Return rate and specific force, kind → axis → flattened outputs, as `readout` counts them."""
    path = signal_path(problem, values_of(problem, z))
    return {
        kind: [
            jnp.concatenate(
                [
                    row_means(problem, getattr(path.sample[name], kind)[..., axis]).reshape(-1)
                    for name in sorted(problem.channels)
                ]
            )
            for axis in range(len(_AXES))
        ]
        for kind in ("rate", "force")
    }


def _axis_word(axis: int) -> str:
    return ("input", "output", "third")[axis]


def _recorded(fitted: Fitted) -> list[ResidualCovariate]:
    entries, runs = fitted.model.entries, fitted.model.campaign.runs
    found = []
    for key, (name, unit, factor, phrase) in _RECORDED.items():
        values = np.full(len(entries), np.nan)
        for index, run in enumerate(runs):
            here = (entries.run == index) & ~entries.closing
            if key in run.covariates:
                values[here] = factor * run.covariates[key][entries.row[here]]
        found.append(ResidualCovariate(name, unit, values, phrase))
    return found


_WORKED_OUT = {
    "temperature_rate": ("temperature_rate_degC_min", "degC/min", 60.0, "the rate of change of temperature"),
    "converter_temperature_rate": (
        "converter_temperature_rate_degC_min",
        "degC/min",
        60.0,
        "the rate of change of the converter's temperature",
    ),
    "campaign_time": ("campaign_time_h", "h", 1 / 3600, "time since the first run"),
}


def _worked_out(fitted: Fitted) -> list[ResidualCovariate]:
    """Return what procedures work out from the recorded columns."""
    nodes, entries = fitted.model.nodes, fitted.model.entries
    rows = [run.rows for run in fitted.model.campaign.runs]
    first_row = np.cumsum([0, *rows])
    row_of_entry = first_row[entries.run] + np.where(entries.closing, 0, entries.row)
    supplied = [set(one) for one in nodes.supplies]
    found = []
    node_row = _node_rows(fitted)
    for key, (name, unit, factor, phrase) in _WORKED_OUT.items():
        per_row = np.full(first_row[-1], np.nan)
        per_row[node_row] = getattr(fitted.model.problem.instants.ambient, key)
        known = np.array([key in one for one in supplied])[entries.run] & ~entries.closing
        found.append(ResidualCovariate(name, unit, np.where(known, factor * per_row[row_of_entry], np.nan), phrase))
    return found


def _node_rows(fitted: Fitted) -> np.ndarray:
    """Return the row, counted over all runs, of each node."""
    nodes = fitted.model.nodes
    sizes = np.concatenate([np.full(count, size) for count, size in nodes.turns])
    return nodes.row_of[np.repeat(np.arange(len(sizes)), sizes)]
