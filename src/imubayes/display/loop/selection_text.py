"""What is said of selected readings, of previewed causes and of a first fit, in a sentence."""

from collections.abc import Sequence

from imubayes.criticism.formula_search import ResidualFormula
from imubayes.display.loop.diagnosis_sentences import probability
from imubayes.display.numbers_and_labels import counted, listed, percent, relation, significant

_EXPLAINS = 0.5


def selection_text(
    n: int, chi2: float, p: float | None, rms: tuple[float | None, str], best: tuple[str, float] | None,
    nothing: float, offset: float | None,
) -> str:  # fmt: skip
    """Return what selected readings say.

    Parameters
    ----------
    n, chi2, p : of the readings, at the noise known beforehand; the probability of such a χ² by chance.
    rms : of the residual, and its unit; None of readings of several units.
    best : the likeliest cause with its probability; None where there is none.
    nothing, offset : probability of noise alone, and of an offset of these readings alone.
    """
    if not n:
        return "No reading is selected."
    chance = "" if p is None else f" (p {relation(p)})"
    size = "" if rms[0] is None else f", {significant(rms[0])} {rms[1]} rms"
    said = f"{counted(n, 'reading')}: χ² {significant(chi2, 4)}{chance}{size}."
    if nothing >= _EXPLAINS:
        return f"{said} Noise alone explains them with probability {probability(nothing)}."
    if offset is not None and offset >= max(_EXPLAINS, best[1] if best is not None else 0.0):
        return f"{said} They are off by something of their own, with probability {probability(offset)}."
    if best is not None and best[1] >= _EXPLAINS:
        return f"{said} {best[0]} explains them with probability {probability(best[1])}."
    return f"{said} No single cause stands out."


def preview_text(
    effects: Sequence[str], predicted: float, largest: tuple[str, float] | None, observed: float | None = None
) -> str:
    """Return what previewed causes would do, or what their refit did.

    Parameters
    ----------
    predicted, observed : drop of χ² at the noise known beforehand, by the linear model and by the refit.
    largest : the estimate that moves most, and by how many of its standard deviations.
    """
    drop = f"Δχ² {significant(predicted)} at the noise known beforehand"
    if observed is not None:
        moved = "" if largest is None else f" {largest[0]} moved by {significant(largest[1], 2)} sd."
        return (
            f"Refitted with {listed(effects)}: predicted {drop}, observed {significant(observed)}.{moved} "
            "Noise scales, uncertainties and verdict follow."
        )
    moved = "" if largest is None else f" {largest[0]} would move by {significant(largest[1], 2)} sd."
    return f"Predicted with {listed(effects)}: {drop}.{moved}"


def formula_text(found: ResidualFormula | None, channel: str) -> str:
    """Return the formula of what a model leaves of a channel, and how sure its first term is."""
    if found is None:
        return f"No term is worth its odds for the residual of {channel}."
    near = f" Almost as well fit: {listed(found.near, 3)}." if found.near else ""
    return (
        f"The residual of {channel} is {found.shape}; its first term leads in {percent(found.inclusion)} of resampled "
        f"runs.{near}"
    )


def fitted_text(place: str) -> str:
    """Return that a first model was fitted, and where its result is."""
    return f"Fitted; the result is in {place}."
