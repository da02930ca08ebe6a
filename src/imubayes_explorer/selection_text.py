"""Sentences on selected readings, previewed causes and a first fit."""

from collections.abc import Sequence

from imubayes.criticism.explanation_records import ResidualFormula
from imubayes.display.loop.diagnosis_sentences import probability
from imubayes.display.numbers_and_labels import listed, percent, relation, significant
from imubayes.foundations.wording import counted
from imubayes_explorer.drawn_shape import DrawnFormula

_EXPLAINS = 0.5


def selection_text(
    n: int, chi2: float, p: float | None, rms: tuple[float | None, str], best: tuple[str, float] | None,
    nothing: float | None, offset: float | None,
) -> str:  # fmt: skip
    """Return what selected readings say.

    Parameters
    ----------
    n, chi2, p : of the readings, at the noise known beforehand; the probability of such a χ² by chance.
    rms : of the residual, and its unit; None of readings of several units.
    best : the most probable cause with its probability; None if there is none.
    nothing, offset : probability of noise alone, and of an offset of these readings alone; None before they are known.
    """
    if not n:
        return "No reading is selected."
    chance = "" if p is None else f" (p {relation(p)})"
    size = "" if rms[0] is None else f", {significant(rms[0])} {rms[1]} rms"
    said = f"{counted(n, 'reading')}: χ² {significant(chi2, 4)}{chance}{size}."
    if nothing is None:
        return f"{said} The explanations are still being weighed."
    them = "it" if n == 1 else "them"
    if nothing >= _EXPLAINS:
        return f"{said} Noise alone explains {them} with probability {probability(nothing)}."
    if offset is not None and offset >= max(_EXPLAINS, best[1] if best is not None else 0.0):
        deviate = (
            "An offset of this reading alone explains it"
            if n == 1
            else "An offset of these readings alone explains them"
        )
        return f"{said} {deviate}, with probability {probability(offset)}."
    if best is not None and best[1] >= _EXPLAINS:
        return f"{said} {best[0]} explains {them} with probability {probability(best[1])}."
    return f"{said} No single cause is dominant."


def refitted_text(what: str, predicted: float | None, observed: float, largest: tuple[str, float] | None) -> str:
    """Return what a change did, its refit at the noise known beforehand (see `preview_text`)."""
    told = "" if predicted is None else f" predicted {significant(predicted)}, observed"
    moved = "" if largest is None else f" {largest[0]} moved by {significant(largest[1], 2)} sd."
    return (
        f"Refitted ({what}): Δχ²{told} {significant(observed)} at the noise known beforehand.{moved} "
        "Noise scales, uncertainties and verdict follow."
    )


def preview_text(effects: Sequence[str], predicted: float, largest: tuple[str, float] | None) -> str:
    """Return what previewed causes would do.

    Parameters
    ----------
    predicted : drop of χ² at the noise known beforehand.
    largest : the estimate that moves most, and by how many of its standard deviations.
    """
    drop = f"Δχ² {significant(predicted)} at the noise known beforehand"
    moved = "" if largest is None else f" {largest[0]} would move by {significant(largest[1], 2)} sd."
    return f"Predicted with {listed(effects)}: {drop}.{moved}"


def formula_text(found: ResidualFormula | None, channel: str) -> str:
    """Return the formula of what a model leaves of a channel, and how sure its first term is."""
    if found is None:
        return f"No term improves the formula enough for the residual of {channel}."
    near = f" Almost as well fit: {listed(found.near, 3)}." if found.near else ""
    return (
        f"The residual of {channel} is {found.shape}; its first term leads in {percent(found.inclusion)} of resampled "
        f"runs.{near}"
    )


def drawn_text(found: DrawnFormula) -> str:
    """Return the formula that is like a drawing, what the data say of it, and how it predicts runs left out."""
    like = "no formula is like it" if found.free_form else f"{percent(found.likeness)} of its variance explained"
    drop, odds = (sum(each) for each in zip(*((t.delta_chi2, t.log_odds) for t in found.terms), strict=True))
    runs = (
        "Only one run shows it, so that none can be left out." if found.held_out is None
        else f"Each run predicted from the others: {found.better} of {counted(found.runs, 'run')} "
        f"{'is' if found.better == 1 else 'are'} predicted better, Δχ² {significant(found.held_out)} in all."
    )  # fmt: skip
    return f"Drawn: {found.shape} ({like}). Δχ² {significant(drop)}, log odds {significant(odds)}. {runs}"


def fitted_text(place: str) -> str:
    """Return that a first model was fitted, and where its result is."""
    return f"Fitted; the result is in {place}."
