"""Campaigns of a servo table with an effect that the model lacks, drawn at random as in `hidden`.

What is read is the angle of the table, so S is that of the shift of the angle over a day, past what the parameters of
the model and the angle at the start absorb.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

import hidden
import servo_table
from detectability import STEP, Sight, baseline_widths
from plan import Plan
from sensor import ARCSEC, Values

MODEL = "servo-table"
EFFECTS = ("gyro_g_sensitivity", "gyro_g2_sensitivity", "gyro_bias_drift")
EVERY = 12
"""Readings of the angle are averaged over so many for S."""
START_ARCSEC = 10.0
LEAST_SHOWN = 1e-12
"""A drift turns the table by far more than its noise, and the model absorbs nearly all of that."""
PROPORTIONAL = 0.2
"""Largest relative difference between S and what it is in proportion to size² with which derivatives are trusted."""
MOST_STEPS = 12
"""Steps of a refit: each one costs fifteen integrations."""
LONGEST_STEP = 5400.0
"""s; with steps of an hour the angle is off by 4e-9 arcsec."""


class Angle:
    """The angle of the table in deg at the middle of averaged readings, as `detectability` asks for outputs."""

    def __init__(self, plan: Plan, hours: float, start: float):
        self.plan, self.hours, self.start = plan, hours, start
        self.run_of_row = np.zeros(len(self.outputs({})), dtype=int)

    def outputs(self, values: Values) -> np.ndarray:
        """Angles (rows, 1), followed from the start with the errors of the gyro."""
        rate = servo_table.turning(values, 0.0)
        seconds = EVERY * servo_table.SECONDS
        middle = np.arange(seconds / 2, self.hours * 3600, seconds)
        start = self.start + values.get("start", 0.0) * ARCSEC
        solved = solve_ivp(
            lambda t, y: [rate(t, y[0])], (0.0, middle[-1]), [start], "DOP853", middle, rtol=1e-9, atol=1e-12,
            max_step=LONGEST_STEP,
        )  # fmt: skip
        return np.degrees(solved.y[0])[:, None]

    def means(self, outputs: np.ndarray) -> np.ndarray:
        return outputs


def look(plan: Plan, values: Values, hours: float, start: float) -> Sight:
    """Set up S for a record and the truth of its baseline."""
    angle = Angle(plan, hours, start)
    exact, widths = angle.outputs(values), baseline_widths(plan) | {"start": START_ARCSEC}
    sigma = values["white_noise.sigma[table_angle]"] / np.sqrt(EVERY)
    slopes = [
        (angle.outputs({**values, name: values.get(name, 0.0) + STEP * width}) - exact) / STEP
        for name, width in widths.items()
    ]
    columns = np.array(slopes)[:, :, 0].T / sigma
    basis, _ = np.linalg.qr(np.concatenate([columns, np.eye(columns.shape[1])]))
    return Sight(angle, values, exact, np.stack(slopes, axis=-1), ((np.eye(len(exact)) / sigma,),), basis)


def past_refit(sight: Sight, plan: Plan, planted: Values) -> float:
    """Return S past a refit of the baseline by least squares from the truth: an upper bound of that past the best fit.

    A drift of a degree per hour and g turns the table by tens of degrees.  Terms quadratic in g absorb far more of that
    than their derivatives at the truth say.
    """
    widths, whole = baseline_widths(plan) | {"start": START_ARCSEC}, sight.shift(planted)

    def residual(moved: np.ndarray) -> np.ndarray:
        values = {
            name: sight.values.get(name, 0.0) + one * width
            for one, (name, width) in zip(moved.tolist(), widths.items(), strict=True)
        }
        return np.concatenate([sight.shift(values) - whole, moved])

    return 2 * float(least_squares(residual, np.zeros(len(widths)), max_nfev=MOST_STEPS).cost)


def random_campaign(folder: str | Path, seed: int, kind: str = "hidden") -> hidden.Campaign:
    """Draw a record of a day and a half at most and write it into `folder`, with `model.toml`.

    Parameters
    ----------
    kind : `hidden`, or any kind without an effect.
    """
    folder, generator = Path(folder), np.random.default_rng([seed, hidden.KINDS.index(kind), 77])
    folder.mkdir(parents=True, exist_ok=True)
    passed_over: list[str] = []
    for attempt in range(20):
        names = (str(generator.choice(EFFECTS)),) if kind == "hidden" else ()
        model, hours = folder / "model.toml", {"day": float(np.round(generator.uniform(24, 36), 1))}
        model.write_text(hidden.without(MODEL, names), encoding="utf-8")
        plan, drawn = servo_table.plan(seed, hours, model), int(generator.integers(2**31))
        values = plan.draw(drawn) | {"white_noise.sigma[table_angle]": 1.0 / 3600}
        found: tuple[hidden.Planted, ...] = ()
        try:
            if names:
                sight = look(plan, values, hours["day"], 1.0)
                found = (_planted(sight, plan, names[0], generator),)
        except hidden.CannotShowError:
            passed_over.append(names[0])
            continue
        whole = {**values, **{name: value for each in found for name, value in each.parameters.items()}}
        servo_table.write_records(folder, replace(plan, script="hidden_servo"), seed, hours, whole)
        return hidden.Campaign(
            folder, model, kind, f"servo_table, attempt {attempt + 1}", seed,
            round(hours["day"] * 3600 / servo_table.SECONDS), found, tuple(passed_over),
        )  # fmt: skip
    raise hidden.CannotShowError(f"nothing that could be shown in 20 records: {passed_over}")


def _planted(sight: Sight, plan: Plan, effect: str, generator: np.random.Generator) -> hidden.Planted:
    """Scale an effect of the gyro until it shows with a drawn S."""
    unit = hidden.unit_effect(plan, effect, ("g",), generator)
    aim = hidden.between(hidden.SMALLEST, hidden.LARGEST)(generator)
    # Effects so small shift the angle in proportion to their size.
    small = hidden.scaled(unit, 1e-4)
    found = sight.detectability(small)
    if found <= 0:
        raise hidden.CannotShowError
    values = hidden.scaled(small, np.sqrt(aim / found))
    s, shift = sight.detectability(values), sight.shift(values)
    seen = sight.seen(values)
    if not np.isclose(s, aim, rtol=PROPORTIONAL):
        seen = min(seen, past_refit(sight, plan, values))
    if seen < hidden.SMALLEST or s / np.sum(shift**2) < LEAST_SHOWN:
        raise hidden.CannotShowError
    return hidden.Planted(effect, ("g",), values, s, s, seen, s, float(s / np.sum(shift**2)))
