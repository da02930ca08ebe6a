"""Mistakes in the record of a run, a row or two runs, planted into fresh campaigns as text.

Beside mistakes with a name there are those of any value.  None shares code with the package.
"""

from collections.abc import Callable

import numpy as np
from campaign_files import Files

Cells = dict[str, list[str]]
Planter = Callable[[Files, np.random.Generator], tuple[str, ...] | None]
"""Plants a mistake, and returns what a message has to contain; None if the campaign cannot have it."""


def changed(files: Files, run: dict, column: str, change: Callable[[np.ndarray], np.ndarray]) -> None:
    """Change a column of a run; empty cells stay empty."""

    def edit(columns: Cells) -> None:
        values = np.array([float(cell) if cell else np.nan for cell in columns[column]])
        columns[column] = ["" if np.isnan(each) else f"{each:.9g}" for each in change(values)]

    files.edit(run, edit)


def temperatures(files: Files, run: dict) -> np.ndarray:
    """Return the temperatures of a run."""
    found: list[np.ndarray] = []

    def look(values: np.ndarray) -> np.ndarray:
        found.append(values)
        return values

    changed(files, run, "temperature_degC", look)
    return found[0]


def heater_off(files: Files, draw: np.random.Generator) -> tuple[str, ...] | None:
    """Record the set point of a chamber whose heater was off: any value far from the true one."""
    run = files.runs[draw.integers(len(files.runs))]
    true = temperatures(files, run)
    others = np.concatenate([temperatures(files, each) for each in files.runs if each is not run])
    if not others.min() - 5 < true.mean() < others.max() + 5:
        return None
    recorded = true + draw.choice([-1, 1]) * draw.uniform(25, 40)
    changed(files, run, "temperature_degC", lambda _: recorded)
    return (f"run '{run['name']}'", "would agree with the other runs given temperature_degC about")


def temperatures_exchanged(files: Files, draw: np.random.Generator) -> tuple[str, ...] | None:
    """Exchange the temperatures of two runs."""
    known = {each["name"]: temperatures(files, each) for each in files.runs}
    alike = [(a, b) for a in files.runs for b in files.runs if len(known[a["name"]]) == len(known[b["name"]])]
    pairs = [(a, b) for a, b in alike if known[a["name"]].mean() < known[b["name"]].mean() - 15]
    if not pairs:
        return None
    one, other = pairs[draw.integers(len(pairs))]
    held = [known[each["name"]] for each in (one, other)]
    changed(files, one, "temperature_degC", lambda _: held[1])
    changed(files, other, "temperature_degC", lambda _: held[0])
    return (f"'{one['name']}'", f"'{other['name']}'", "temperature_degC exchanged with")


def other_unit(files: Files, draw: np.random.Generator) -> tuple[str, ...] | None:
    """Give one run the scale factors and biases of another unit."""
    run = files.runs[draw.integers(len(files.runs))]
    channels = list(files.document["channel"])
    if len(channels) < 3 or len(files.runs) < 4:
        return None
    for channel in channels:
        scale, ppm = float(channel["scale"]), draw.normal(0, 3e-3)
        bias = draw.choice([-1, 1]) * draw.uniform(0.02, 0.05) * scale
        bias *= 1.0 if channel["kind"] == "accelerometer" else 20.0
        changed(files, run, str(channel["name"]), lambda x, ppm=ppm, bias=bias: (1 + ppm) * x + bias)
    return (f"run '{run['name']}' would agree with the other runs given errors of its own in all channels",)


def rate_without_sign(files: Files, draw: np.random.Generator) -> tuple[str, ...] | None:
    """Record the speed of the table in one run, and not its direction."""
    runs = files.of("rate_table")
    if not runs:
        return None
    run = runs[draw.integers(len(runs))]
    changed(files, run, "table_rate_deg_s", np.abs)
    return (f"in run '{run['name']}'", "without their sign")


def rates_missing(files: Files, draw: np.random.Generator) -> tuple[str, ...] | None:
    """Record a rate of zero in all runs of a rate table."""
    runs = files.of("rate_table")
    for run in runs:
        changed(files, run, "table_rate_deg_s", np.zeros_like)
    return ("'table_rate_deg_s' is zero",) if runs else None


def sign_in_one_row(files: Files, draw: np.random.Generator) -> tuple[str, ...] | None:
    """Write one output of one row with the wrong sign: of the channel whose output is largest there."""
    run = files.runs[draw.integers(len(files.runs))]
    kind = "gyro" if run["procedure"] == "rate_table" else "accelerometer"
    names = files.channels(kind)
    if len(names) < 2:
        return None
    place: list[tuple[str, int]] = []

    def edit(columns: Cells) -> None:
        row = int(draw.integers(2, len(columns[names[0]]) - 2))
        name = max(names, key=lambda each: abs(float(columns[each][row])))
        columns[name][row] = f"{-float(columns[name][row]):.9g}"
        place.append((name, row + 1))

    files.edit(run, edit)
    ((name, row),) = place
    return (f"row {row} of run '{run['name']}'", f"its output of {name} times -1")


def scale_ten_times(files: Files, draw: np.random.Generator) -> tuple[str, ...] | None:
    """State the scale of one channel or of all of a kind ten times too small or too large."""
    kind = str(draw.choice(sorted({str(each["kind"]) for each in files.document["channel"]})))
    channels = [each for each in files.document["channel"] if each["kind"] == kind]
    factor = float(draw.choice([0.1, 10.0]))
    chosen = channels if draw.random() < 0.5 else [channels[draw.integers(len(channels))]]
    right = [f"scale = {float(each['scale']):.6g} for '{each['name']}'" for each in chosen]
    for each in chosen:
        each["scale"] = float(each["scale"]) * factor
    files.save()
    return tuple(right)


def _one_output(files: Files, draw: np.random.Generator) -> tuple[dict, list[str]]:
    """A run, and the channels of the kind that it moves, one of them first."""
    run = files.runs[draw.integers(len(files.runs))]
    names = files.channels("gyro" if run["procedure"] == "rate_table" else "accelerometer")
    moved = max(names, key=lambda name: np.ptp(_values(files, run, name)))
    return run, [moved, *(each for each in names if each != moved)]


def _values(files: Files, run: dict, column: str) -> np.ndarray:
    found: list[np.ndarray] = []
    changed(files, run, column, lambda values: found.append(values) or values)
    return found[0]


def output_off(files: Files, draw: np.random.Generator) -> tuple[str, ...] | None:
    """Move all outputs of one channel in one run by a tenth of their range."""
    run, (name, *_) = _one_output(files, draw)
    off = 0.1 * float(np.ptp(_values(files, run, name)))
    changed(files, run, name, lambda values: values + off)
    return (f"in run '{run['name']}'", f"its output of {name} changed by (")


def output_stuck(files: Files, draw: np.random.Generator) -> tuple[str, ...] | None:
    """Let one channel hold its fourth output in all of a run but for its last digit."""
    run, (name, *_) = _one_output(files, draw)
    changed(files, run, name, lambda values: values[3] * (1 + 1e-6 * draw.uniform(-1, 1, len(values))))
    return (f"the outputs of channel '{name}' hold one value in run '{run['name']}'",)


def output_copied(files: Files, draw: np.random.Generator) -> tuple[str, ...] | None:
    """Paste the outputs of one channel over those of another in one run."""
    run, (name, other, *_) = _one_output(files, draw)
    values = _values(files, run, name)
    changed(files, run, other, lambda _: values)
    return (f"the outputs of channel '{other}' repeat those of channel '{name}' in run '{run['name']}'",)


def rate_times(files: Files, draw: np.random.Generator) -> tuple[str, ...] | None:
    """Write the rates of one run two or three times as large."""
    runs = files.of("rate_table")
    run, factor = runs[draw.integers(len(runs))], float(draw.choice([2.0, 3.0]))
    changed(files, run, "table_rate_deg_s", lambda rate: factor * rate)
    return (
        f"run '{run['name']}' would agree with the other runs given table_rate_deg_s times {1 / factor:.2g}",
        "its output of",
    )


def decimal_of_a_rate(files: Files, draw: np.random.Generator) -> tuple[str, ...] | None:
    """Write one rate of a run ten times too small."""
    runs = files.of("rate_table")
    run, row = runs[draw.integers(len(runs))], 2
    changed(files, run, "table_rate_deg_s", lambda rate: np.where(np.arange(len(rate)) == row, rate / 10, rate))
    return (f"row {row + 1} of run '{run['name']}'", "table_rate_deg_s = ")


def rates_in_reverse(files: Files, draw: np.random.Generator) -> tuple[str, ...] | None:
    """Write the rates of one run from the last row to the first."""
    runs = files.of("rate_table")
    run = runs[draw.integers(len(runs))]
    changed(files, run, "table_rate_deg_s", lambda rate: rate[::-1])
    return (f"the rates of all rows are in reverse order in run '{run['name']}'",)


def rates_of_five_rows(files: Files, draw: np.random.Generator) -> tuple[str, ...] | None:
    """Write the rates of five rows of one run each in the row before: more than are judged as single rows."""
    runs = files.of("rate_table")
    run, rows = runs[draw.integers(len(runs))], [2, 4, 5, 7, 9]

    def turn(rate: np.ndarray) -> np.ndarray:
        rate = rate.copy()
        rate[rows] = rate[np.roll(rows, -1)]
        return rate

    changed(files, run, "table_rate_deg_s", turn)
    return (f"in run '{run['name']}'", "'table_rate_deg_s' of rows 10, 3, 5, 6, 8 in rows 3, 5, 6, 8, 10")


def all_of_a_kind_in_a_run(files: Files, draw: np.random.Generator) -> tuple[str, ...] | None:
    """Write the outputs of all gyros of one run in mdeg/s; the table moves one of them."""
    names, runs = files.channels("gyro"), files.of("rate_table")
    run = runs[draw.integers(len(runs))]
    if len(names) < 3:
        return None
    for name in names:
        changed(files, run, name, lambda values: 1000 * values)
    return (f"'gx', 'gy', 'gz' are 1000 times too large in run '{run['name']}'",)


def column_in_volt(files: Files, draw: np.random.Generator) -> tuple[str, ...] | None:
    """Write the column of a channel of which an offset is stated in V, not mV, in one run."""
    run = files.runs[draw.integers(len(files.runs))]
    changed(files, run, "g1", lambda values: values / 1000)
    return (
        f"run '{run['name']}' would agree with the other runs given its output of g1 times 1000",
        "multiply column 'g1'",
    )


def sign_about_an_offset(files: Files, draw: np.random.Generator) -> tuple[str, ...] | None:
    """Reverse the sign of a channel about its offset in one run."""
    run = files.of("rate_table")[0]
    changed(files, run, "g1", lambda values: 5000 - values)
    return (f"'{run['name']}'", "replace y by 5000 - y in column 'g1'")


def offset_not_stated(files: Files, draw: np.random.Generator) -> tuple[str, ...] | None:
    """Leave out the offset of a channel, which no run contradicts: all have it."""
    files.document["channel"][0].pop("offset")
    files.save()
    return ("outputs of channel 'g1' lie about 2", "not about its offset, 0", "write offset = ")


def kinds_exchanged(files: Files, draw: np.random.Generator) -> tuple[str, ...] | None:
    """Exchange the columns of a gyro and of an accelerometer in all runs."""
    for run in files.runs:

        def edit(columns: Cells) -> None:
            columns["gy"], columns["az"] = columns["az"], columns["gy"]

        files.edit(run, edit)
    return ("channels 'gy', 'az' are exchanged in all runs",)


def samples_times_hundred(files: Files, draw: np.random.Generator) -> tuple[str, ...] | None:
    """State a hundred times as many samples as the means of a run were made of."""
    run = files.runs[draw.integers(len(files.runs))]
    changed(files, run, "samples", lambda count: 100 * count)
    return (f"run '{run['name']}'", "'samples'")


RECORD_MISTAKES: dict[str, Planter] = {
    each.__name__: each
    for each in (
        heater_off, temperatures_exchanged, other_unit, rate_without_sign, rates_missing, sign_in_one_row,
        scale_ten_times, output_off, output_stuck, output_copied, rate_times, decimal_of_a_rate,
        rates_in_reverse, rates_of_five_rows, all_of_a_kind_in_a_run, column_in_volt, sign_about_an_offset,
        offset_not_stated, kinds_exchanged, samples_times_hundred,
    )
}  # fmt: skip
