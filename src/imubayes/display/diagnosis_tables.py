"""The evidence of a diagnosis in tables: candidates, noise, outliers, structure, and what cannot be detected."""

from collections.abc import Sequence

from imubayes.criticism import thresholds
from imubayes.criticism.detectability import ParameterBias
from imubayes.criticism.diagnosis_record import Diagnosis, RankedEffect
from imubayes.display.diagnosis_sentences import why_undetectable
from imubayes.display.labels import listed, pretty
from imubayes.display.noise_violation_text import noise_ratio
from imubayes.display.rounding import chance_text, percent, significant, value_and_sd
from imubayes.display.structure_words import structure_shape
from imubayes.display.table_layout import Cell, Sheet

_MOST_RANKED, _MOST_STRUCTURES, _MOST_OUTLIERS = 10, 6, 8
# A bias below this share of a posterior standard deviation is not worth a word.
_SMALL_BIAS = 0.1


def ranking_sheet(found: Diagnosis) -> Sheet:
    """Return the candidates in order of evidence, each with its equivalence group.

    One line per effect, on the channels with the strongest evidence; all lines of an effect that was asked about.
    """
    ranking: Sequence[RankedEffect] = found.ranking
    if found.asked is None:
        best: dict[str, RankedEffect] = {}
        for line in found.ranking:
            best.setdefault(line.effect, line)
        ranking = list(best.values())[:_MOST_RANKED]
    group = {
        (member.effect, member.channels): str(place)
        for place, each in reversed(list(enumerate(found.groups, 1)))
        for member in each.candidates
    }
    rows, slim = [], []
    for line in ranking:
        name, drop = Cell(line.effect), Cell(significant(line.evidence))
        p = Cell(chance_text(line.p_global), "bad" if line.p_global < found.threshold else "dim")
        mark = Cell(group.get((line.effect, line.channels), ""))
        on, size = Cell(listed(line.channels, 3)), Cell(_coefficient(line))
        rows.append((name, on, size, drop, Cell(str(line.dof)), p, mark))
        slim.append((name, Cell(_coefficient(line, short=True)), drop, p, mark))
    note = _more(len(found.ranking) - len(rows)) + (
        "2 ln Λ: likelihood ratio on dof degrees of freedom, with the noise scales estimated anew; p: "
        "probability that the best of all candidates does so well where nothing is missing. These runs cannot "
        "distinguish the candidates of one group."
    )
    head = ("effect", "on", "coefficient", "2 ln Λ", "dof", "p", "group")
    title = "Candidates in order of evidence"
    narrow = Sheet(title, ("effect", "coefficient", "2 ln Λ", "p", "group"), slim, (0, 1), "", note)
    return Sheet(title, head, rows, (0, 1, 2), "", note, narrow=narrow)


def _more(count: int) -> str:
    return f"{count} more in diagnosis.json. " if count > 0 else ""


def _coefficient(line: RankedEffect, short: bool = False) -> str:
    """Return the most significant coefficient, and the shape that was scanned."""
    known = [(each, each.value) for each in line.coefficients if each.value is not None]
    if not known:
        return "–"
    best, _ = max(known, key=lambda pair: abs(pair[1]) / (pair[0].sd or float("inf")))
    value, sd = value_and_sd(best.value, best.sd)
    text = f"{value} ± {sd} {pretty(best.unit)}"
    if short:
        return text
    shape = ", ".join(f"{key.rpartition('.')[2]} {significant(size)}" for key, size in line.shape.items())
    text = f"{best.name.partition('.')[2] or best.name} {text}" + (f" at {shape}" if shape else "")
    return text + (f", {len(known) - 1} more" if len(known) > 1 else "")


def undetectable_sheet(found: Diagnosis) -> Sheet:
    """Return the effects that these runs cannot show, and what absorbs them."""
    hidden = [each for each in found.undetectable if each.reason != "not_supplied"]
    absent = [each for each in found.undetectable if each.reason == "not_supplied"]
    without = [f"{each.effect} ({', '.join(each.needs) or 'response zero'})" for each in absent]
    rows = []
    for each in hidden:
        absorbed = ", ".join(f"{percent(part.share)} {part.parameter}" for part in each.absorbed_by[:2])
        smallest = each.smallest_detectable
        size = f"{significant(smallest)} {pretty(each.unit)}" if smallest is not None else "–"
        rows.append((Cell(each.effect), Cell(absorbed or why_undetectable(each)), Cell(size), Cell(_bias(each.bias))))
    note = ""
    if rows:
        note = (
            "Undetectable is not absent: no statement is made about these effects. The last column is the bias of the "
            "most affected parameter where an effect is present at its largest typical size."
        )
    note += f" The runs do not all supply what these need: {', '.join(without)}." if without else ""
    head = ("effect", "absorbed by", "smallest detectable", "would bias")
    return Sheet("Undetectable in these runs", head, rows, (0, 1, 3), "", note.strip())


def _bias(bias: ParameterBias | None) -> str:
    if bias is None or abs(bias.in_sd) < _SMALL_BIAS:
        return "–"
    size = f"{significant(abs(bias.value))} {pretty(bias.unit)}"
    return f"{bias.parameter} by {size}, {significant(abs(bias.in_sd))} sd"


def structure_sheet(found: Diagnosis) -> Sheet:
    """Return the significant structure of the residuals, whatever its cause."""
    rows = []
    for each in found.structure[:_MOST_STRUCTURES]:
        size = each.coefficient
        height = f"{significant(size.value)} {pretty(size.unit)}" if size is not None else ""
        form = Cell(" ".join(part for part in (structure_shape(each), height) if part))
        rows.append((Cell(each.channel), Cell(each.covariate), Cell(each.test), Cell(chance_text(each.p), "bad"), form))
    head = ("channel", "depends on", "test", "p", "form")
    angle = any("φ" in structure_shape(each) for each in found.structure[:_MOST_STRUCTURES])
    counted = " φ is counted from the zero of the table, not from that of its scale." if angle else ""
    note = f"{_more(len(found.structure) - len(rows))}{counted}".strip()
    return Sheet("Structure in the residuals, whatever its cause", head, rows, (0, 1, 2, 4), "", note)


def noise_sheet(found: Diagnosis) -> Sheet:
    """Return the noise that the model lacks."""
    rows = [
        (Cell(noise.effect), Cell(listed(noise.channels, 4)), Cell(significant(noise.delta_chi2)), Cell(p))
        for noise, p in ((noise, chance_text(noise.p)) for noise in found.noise if noise.adopted)
    ]
    return Sheet("Noise that the model lacks", ("noise", "on", "Δχ²", "p"), rows, (0, 1))


def recorded_noise_sheet(found: Diagnosis) -> Sheet:
    """Return fitted against recorded noise of the channels where they do not agree."""
    sources = {"samples": "samples within rows", "prior": "the prior", "channel": "'noise' of the channel"}
    rows = [
        (
            Cell(each.channel),
            Cell(significant(each.fitted)),
            Cell(significant(each.recorded)),
            Cell(sources[each.source]),
            Cell(noise_ratio(each)),
            Cell(chance_text(each.p), "bad" if each.excessive else ""),
        )
        for each in found.disagreeing_noise
    ]
    note = (
        "Standard deviation of one raw sample: fitted from the scatter of the rows, after the groups above, and as the "
        "campaign records it. A ratio above 1 is scatter from row to row that the samples do not show; p: its excess "
        f"over {thresholds.NOISE_AGREES:.2f} by chance."
    )
    head = ("channel", "fitted", "recorded", "from", "ratio", "p")
    return Sheet("Fitted and recorded noise disagree", head, rows, (0, 3), "", note)


def outlier_sheet(found: Diagnosis) -> Sheet:
    """Return the outliers, the farthest first."""
    rows = [
        (
            *(Cell(each.run), Cell(each.channel), Cell(str(each.row))),
            *(Cell("–" if value is None else f"{value:.6g}") for value in (each.time_s, each.table_angle_deg)),
            Cell(f"{each.distance:+.1f}"),
        )
        for each in found.outliers[:_MOST_OUTLIERS]
    ]
    note = _more(len(found.outliers) - len(rows)) + (
        "Deletion residuals, in standard deviations of the other samples. The search excludes outliers."
    )
    head = ("run", "channel", "row", "time / s", "table angle / °", "residual / sd")
    return Sheet("Outliers", head, rows, (0, 1), "", note)
