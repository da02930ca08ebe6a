"""The noise terms of static records as tables, sentences, a figure per record, and a model snippet of priors."""

from pathlib import Path

from imubayes.atomic_files import write_text
from imubayes.display.figures.allan import allan_figure
from imubayes.display.labels import pretty
from imubayes.display.noise_priors_file import priors_text
from imubayes.display.report_layout import Report
from imubayes.display.rounding import rounded, significant
from imubayes.display.table_layout import Cell, Sheet
from imubayes.noise_analysis.noise_record import ChannelNoise, StaticNoise, TermRecord
from imubayes.noise_analysis.noise_spectra import NoiseTerm

NAMES = {
    NoiseTerm.QUANTISATION: ("quantisation Q", "−1"),
    NoiseTerm.WHITE: ("white noise N", "−½"),
    NoiseTerm.FLICKER: ("flicker noise B", "0"),
    NoiseTerm.RANDOM_WALK: ("random walk K", "+½"),
    NoiseTerm.MARKOV: ("Gauss–Markov σ", ""),
    NoiseTerm.RAMP: ("ramp R", "+1"),
}
NOISE_FILE, PRIORS_FILE = "noise.json", "noise-priors.toml"


def noise_report(noise: StaticNoise) -> Report:
    """Return the terms of every channel, and what to know about them."""
    percent = f"{100 * noise.probability:.0f} %"
    sheets = [_sheet(channel, percent) for channel in noise.channels]
    lines = [sentence for channel in noise.channels for sentence in _warnings(channel)]
    closing = (
        f"Intervals and upper limits are of {percent}; a term is determined where chance reaches its evidence in less "
        "than 1 % of records without it. B is the coefficient of IEEE Std 952: the floor of the Allan deviation is "
        "0.664 B.",
    )
    return Report(lines, sheets, closing)


def _sheet(noise: ChannelNoise, percent: str) -> Sheet:
    missing = f", {noise.missing} missing" if noise.missing else ""
    hours = (noise.samples + noise.missing) * noise.interval_s / 3600
    title = f"{noise.channel} in {noise.run}: {noise.samples} samples over {hours:.3g} h{missing}"
    head = ("noise term", "estimate", "sd", f"{percent} interval", "unit", "slope")
    rows = [_row(term) for term in noise.terms]
    if noise.correlation_time_s is not None:
        value, sd = rounded((noise.correlation_time_s, noise.correlation_time_sd_s), noise.correlation_time_sd_s)
        place = next(k for k, term in enumerate(noise.terms) if term.term is NoiseTerm.MARKOV) + 1
        rows.insert(place, tuple(map(Cell, ("Gauss–Markov T", value, sd, "", "s", ""))))
    return Sheet(title, head, rows, (0, 4), "", "")


def _row(term: TermRecord) -> tuple[Cell, ...]:
    name, slope = NAMES[term.term]
    unit = pretty(term.unit).replace("sqrt(h)", "√h").replace("sqrt(Hz)", "√Hz")
    if not term.determined:
        limit = "not determined" if term.upper_limit is None else f"< {significant(term.upper_limit)}"
        return tuple(Cell(text, "dim") for text in (name, "–", "–", limit, unit, slope))
    value, sd, low, high = rounded((term.value, term.sd, term.low, term.high), term.sd)
    return tuple(map(Cell, (name, value, sd, f"{low} … {high}", unit, slope)))


def _warnings(noise: ChannelNoise) -> list[str]:
    found, where = [], f"{noise.channel} in {noise.run}"
    if not noise.converged:
        found.append(f"{where}: the estimate of the noise terms did not converge.")
    if noise.misfit:
        low, high = min(o.low_hz for o in noise.misfit), max(o.high_hz for o in noise.misfit)
        found.append(
            f"{where}: the noise terms do not describe the spectrum between {low:.3g} and {high:.3g} Hz; a filter or a "
            "vibration may shape it. --shortest-tau leaves high frequencies out."
        )
    for term, other in noise.alternatives:
        names = NAMES[term][0], NAMES[other][0]
        found.append(f"{where}: {names[1]} in place of {names[0]} would describe the record as well.")
    return found


def write_noise(folder: Path, noise: StaticNoise, sample_rate: float | None = None) -> list[Path]:
    """Write the record, the priors and a figure of each static record into a folder; return the files."""
    write_text(folder / NOISE_FILE, noise.json_text())
    write_text(folder / PRIORS_FILE, priors_text(noise, sample_rate))
    written = [folder / NOISE_FILE, folder / PRIORS_FILE]
    for run in dict.fromkeys(channel.run for channel in noise.channels):
        drawn = allan_figure([channel for channel in noise.channels if channel.run == run])
        plain = "".join(letter if letter.isalnum() or letter in "-_." else "_" for letter in run)
        written.append(drawn.save(folder / f"allan-{plain}.png"))
    return written
