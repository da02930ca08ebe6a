"""The evidence of a diagnosis in tables: effects, noise, outliers, formulas, and what cannot be detected."""

from imubayes.adequacy.adequacy_record import NOISE_AGREES
from imubayes.criticism.detectability import ParameterBias
from imubayes.criticism.diagnosis_record import Diagnosis, ScreenedEffect
from imubayes.display.diagnosis_sentences import why_undetectable
from imubayes.display.evidence_text import noise_text, probability
from imubayes.display.labels import listed, pretty
from imubayes.display.noise_violation_text import noise_ratio
from imubayes.display.rounding import chance_text, percent, significant, value_and_sd
from imubayes.display.table_layout import Cell, Sheet

_MOST_RANKED, _MOST_OUTLIERS = 10, 8
# A bias below this share of a posterior standard deviation is not worth a word.
_SMALL_BIAS = 0.1


def ranking_sheet(found: Diagnosis) -> Sheet:
    """Return the effects by the probability that they are missing, each with the group it belongs to."""
    ranking = found.ranking if found.asked is not None else found.ranking[:_MOST_RANKED]
    group = {
        member.effect: str(place)
        for place, each in reversed(list(enumerate(found.groups, 1)))
        for member in each.candidates
    }
    rows, slim = [], []
    for line in ranking:
        likely = Cell(probability(line.probability), "bad" if line.probability >= 0.5 else "dim")
        name, drop, odds = Cell(line.effect), Cell(significant(line.delta_chi2)), Cell(significant(line.log_odds))
        shown = found.estimate(line.effect) or line
        mark, on, size = Cell(group.get(line.effect, "")), Cell(listed(shown.channels, 3)), Cell(_coefficient(shown))
        rows.append((name, on, size, drop, odds, likely, mark))
        slim.append((name, Cell(_coefficient(shown, short=True)), drop, likely, mark))
    before = _more(len(found.ranking) - len(rows)) + (
        "Coefficient: the most significant one, at the likeliest shape, such as a time constant; Δχ²: predicted drop "
        "if the effect is added alone, at the noise known beforehand; "
    )
    odds = "log odds: natural logarithm of the odds of the effect alone against nothing missing; "
    after = (
        "probability: that it is missing, of all explanations that contain it. These runs cannot distinguish the "
        "effects of one group."
    )
    head = ("effect", "on", "coefficient", "Δχ²", "log odds", "probability", "group")
    title = "Effects by the probability that they are missing"
    narrow = Sheet(title, ("effect", "coefficient", "Δχ²", "probability", "group"), slim, (0, 1), "", before + after)
    return Sheet(title, head, rows, (0, 1, 2), "", before + odds + after, narrow=narrow)


def _more(count: int) -> str:
    return f"{count} more in diagnosis.json. " if count > 0 else ""


def _coefficient(line: ScreenedEffect, short: bool = False) -> str:
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


def formula_sheet(found: Diagnosis) -> Sheet:
    """Return the simplest formula for what no effect explains, a line for each term."""
    rows = [
        (
            Cell(each.channel),
            Cell(term.shape),
            Cell(f"{' ± '.join(value_and_sd(term.value, term.sd))} {pretty(term.unit)}"),
            Cell(significant(term.delta_chi2)),
            Cell(significant(term.log_odds)),
        )
        for each in found.formulas
        for term in each.terms
    ]
    angle = any("φ" in each.shape for each in found.formulas)
    note = "φ is counted from the zero of the table, not from that of its scale." if angle else ""
    head = ("channel", "term", "coefficient", "Δχ²", "log odds")
    return Sheet("Simplest formula of what no effect explains", head, rows, (0, 1, 2), "", note)


def noise_sheet(found: Diagnosis) -> Sheet:
    """Return the noise of the likeliest explanation where it is not as the model says."""
    noise = found.explanations.noise if found.explanations is not None else ()
    rows = [(Cell(noise_text([each])), Cell(significant(each.scale))) for each in noise]
    return Sheet("Noise that is not as modelled", ("noise", "scale / known"), rows, (0,))


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
        "Standard deviation of one raw sample: fitted from the scatter of the rows, and as the "
        "campaign records it. A ratio above 1 is scatter from row to row that the samples do not show; p: its excess "
        f"over {NOISE_AGREES:.2f} by chance."
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
    note = _more(len(found.outliers) - len(rows)) + ("Deletion residuals, in standard deviations of the other samples.")
    head = ("run", "channel", "row", "time / s", "table angle / °", "residual / sd")
    return Sheet("Outliers", head, rows, (0, 1), "", note)
