"""The noise terms of static records as tables, sentences, a figure per record, and a model snippet of priors."""

from pathlib import Path

from imubayes.atomic_files import write_text
from imubayes.display.figures.allan import allan_figure
from imubayes.display.noise_findings import beside_noise, density_unit, withheld_because
from imubayes.display.noise_priors_file import has_priors, priors_text
from imubayes.display.report_layout import Report
from imubayes.display.rounding import rounded, significant
from imubayes.display.table_layout import Cell, Sheet
from imubayes.noise_analysis.noise_record import ChannelNoise, StaticNoise, TermRecord
from imubayes.noise_analysis.noise_spectra import NoiseTerm

_NAMES = {
    NoiseTerm.QUANTISATION: "quantisation Q",
    NoiseTerm.FLICKER: "bias instability B",
    NoiseTerm.MARKOV: "Gauss–Markov σ",
}
# The names of IEEE Std 952 and 1293: white noise of a rate is a random walk of the angle.
_NAMES_BY_KIND = {
    NoiseTerm.WHITE: ("angle random walk N", "velocity random walk N"),
    NoiseTerm.RANDOM_WALK: ("rate random walk K", "accel. random walk K"),
    NoiseTerm.RAMP: ("rate ramp R", "acceleration ramp R"),
}
_REASONS = {"empty": "without a sample", "constant": "constant, dead or coarser than its noise"}
NOISE_FILE, PRIORS_FILE = "noise.json", "noise-priors.toml"


def noise_report(noise: StaticNoise) -> Report:
    """Return the terms of every channel, and what to know about them."""
    percent = f"{100 * noise.probability:.0f} %"
    sheets = [_sheet(channel, percent) for channel in noise.channels]
    lines = [f"{each.channel} in {each.run} is {_REASONS[each.reason]}: left out." for each in noise.left_out]
    lines += [
        f"{channel.channel} in {channel.run}: {told}" for channel in noise.channels for told in _warnings(channel)
    ]
    closing = (
        f"Intervals are {percent} profile-likelihood intervals, of a ramp posterior intervals; upper limits are "
        f"one-sided {percent} limits, of a ramp the farther end of its interval. A term is "
        "determined where the record needs it beside all other terms; of records without a term, 1 to 2 % show as much "
        "evidence for it. As in IEEE Std 952 and 1293, N is white noise of the output, B flicker noise (the floor "
        "of its Allan deviation is 0.664 B) and K a random walk; Gauss–Markov noise of a correlation time beyond "
        "the record looks the same.",
    )
    return Report(lines, sheets, closing)


def _name(term: NoiseTerm, kind: str) -> str:
    return _NAMES[term] if term in _NAMES else _NAMES_BY_KIND[term][kind != "gyro"]


def _sheet(noise: ChannelNoise, percent: str) -> Sheet:
    missing = f", {noise.missing} missing" if noise.missing else ""
    hours = (noise.samples + noise.missing) * noise.interval_s / 3600
    title = f"{noise.channel} in {noise.run}: {noise.samples} samples over {hours:.3g} h{missing}"
    head = ("noise term", "estimate", "sd", f"{percent} interval", "unit")
    rows = [_row(term, noise.kind) for term in noise.terms]
    if noise.correlation_time_s is not None and noise.of(NoiseTerm.MARKOV).determined:
        value, sd = rounded((noise.correlation_time_s, noise.correlation_time_sd_s), noise.correlation_time_sd_s)
        place = next(k for k, term in enumerate(noise.terms) if term.term is NoiseTerm.MARKOV) + 1
        rows.insert(place, tuple(map(Cell, ("Gauss–Markov T", value, sd, "", "s"))))
    return Sheet(title, head, rows, (0, 4), "", "")


def _row(term: TermRecord, kind: str) -> tuple[Cell, ...]:
    name = _name(term.term, kind)
    unit = density_unit(term.unit)
    if not term.determined:
        limit = "not determined" if term.upper_limit is None or term.withheld else f"< {significant(term.upper_limit)}"
        return tuple(Cell(text, "dim") for text in (name, "–", "–", limit, unit))
    value, sd, low, high = rounded((term.value, term.sd, term.low, term.high), term.sd)
    return tuple(map(Cell, (name, value, sd, f"{low} … {high}", unit)))


def _warnings(noise: ChannelNoise) -> list[str]:
    return [*beside_noise(noise), *_withheld(noise), *_of_ambiguity(noise)]


def _withheld(noise: ChannelNoise) -> list[str]:
    """Return each cause for which terms are withheld, with their names."""
    found = []
    for cause in dict.fromkeys(term.withheld for term in noise.terms if term.withheld):
        names = [_name(term.term, noise.kind) for term in noise.terms if term.withheld is cause]
        named = (
            "no term is" if len(names) == len(noise.terms) else f"{', '.join(names)} {'are' if names[1:] else 'is'} not"
        )
        found.append(f"{named} determined: {withheld_because(noise, cause)}")
    return found


def _of_ambiguity(noise: ChannelNoise) -> list[str]:
    found = []
    if noise.undecided:
        names = " or ".join(_name(term, noise.kind) for term in noise.undecided)
        found.append(f"the record needs {names}, but does not tell which. A longer record does.")
    for term, other in noise.alternatives:
        names = _name(other, noise.kind), _name(term, noise.kind)
        found.append(f"{names[0]} in place of {names[1]} would describe the record as well.")
    return found


def write_noise(folder: Path, noise: StaticNoise, sample_rate: float | None = None) -> list[Path]:
    """Write the record, the priors if there are any, and a figure of each record into a folder; return the files."""
    write_text(folder / NOISE_FILE, noise.json_text())
    written = [folder / NOISE_FILE]
    if any(has_priors(channel) for channel in noise.channels):
        write_text(folder / PRIORS_FILE, priors_text(noise, sample_rate))
        written.append(folder / PRIORS_FILE)
    else:
        (folder / PRIORS_FILE).unlink(missing_ok=True)  # of an earlier call: it would be taken for this one's
    for run in dict.fromkeys(channel.run for channel in noise.channels):
        drawn = allan_figure([channel for channel in noise.channels if channel.run == run])
        plain = "".join(letter if letter.isalnum() or letter in "-_." else "_" for letter in run)
        written.append(drawn.save(folder / f"allan-{plain}.png"))
    return written
