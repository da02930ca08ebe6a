"""Formula search: the simplest formula in the covariates that explains a channel's residual.

Orthogonal matching pursuit over the library of simple terms, all projected: the term with the strongest evidence is
selected and projected out, until no further term is significant.  The inclusion frequency, how often a term is selected
first when whole runs are resampled, says how far to trust it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.criticism import thresholds
from imubayes.criticism.projection import Projection
from imubayes.criticism.residual_covariates import ResidualCovariate
from imubayes.criticism.score_test import ScoreTest, score_test
from imubayes.criticism.term_library import Term, library

# Sorts of terms that are chosen from many: penalised against plain ones.
_ELABORATE = ("product", "wave")


@dataclass(frozen=True)
class Formula:
    """The formula found for one channel.

    Attributes
    ----------
    channel : name.
    terms : in the order of selection.
    value, sd : coefficients at the input, in `unit` of each.
    unit : one per term.
    delta_chi2 : drop of χ² of each term when it was selected.
    p : p-value of each, all terms of the library counted.
    inclusion : inclusion frequency of the first term.
    near : texts of terms that explain almost as much as the first.
    python : an effect class, ready to paste into a file beside the model.
    """

    channel: str
    terms: tuple[Term, ...]
    value: tuple[float, ...]
    sd: tuple[float, ...]
    unit: tuple[str, ...]
    delta_chi2: tuple[float, ...]
    p: tuple[float, ...]
    inclusion: float
    near: tuple[str, ...]
    python: str

    @property
    def text(self) -> str:
        """The sum of the terms, in symbols."""
        return " + ".join(term.text for term in self.terms)


@dataclass(frozen=True)
class _Selected:
    """A selected term: its place in the library, its score test and its corrected p-value."""

    place: int
    score: ScoreTest
    p: float


def find_formula(projection: Projection, covariates: Sequence[ResidualCovariate], channel: str) -> Formula | None:
    """Return the simplest formula for the residual of a channel; None where no term is significant."""
    model = projection.fitted.model
    gravity = model.campaign.site.gravity
    index = [other.name for other in model.campaign.channels].index(channel)
    constants = model.campaign.channels[index]
    rows = (model.entries.channel == index) & ~model.entries.closing
    terms = library(covariates, rows, gravity)
    if not terms:
        return None
    factor, base = coefficient_unit(constants.kind, constants.scale_si, gravity)
    columns = np.stack([np.where(rows, term.values, 0.0) for term in terms], axis=1) * factor
    size = np.abs(columns).max(axis=0)
    whitened = projection.whitened(columns / size)
    first = _scores(projection, whitened)
    selected = _pursue(projection, terms, whitened, first)
    if not selected:
        return None
    places = [choice.place for choice in selected]
    values, sds = _solve(projection, whitened[:, places], selected[-1].score.variance)
    best = selected[0]
    chosen = [terms[place] for place in places]
    units = tuple(f"{base}/{term.divisor}" if term.divisor else base for term in chosen)
    values, sds = values / size[places], sds / size[places]
    best = selected[0]
    return Formula(
        channel=channel,
        terms=tuple(chosen),
        value=tuple(values.tolist()),
        sd=tuple(sds.tolist()),
        unit=units,
        delta_chi2=tuple(choice.score.delta_chi2 for choice in selected),
        p=tuple(choice.p for choice in selected),
        inclusion=_inclusion(projection, projection.project(whitened), best.place),
        near=tuple(
            term.text
            for place, (term, score) in enumerate(zip(terms, first, strict=True))
            if score.delta_chi2 > best.score.delta_chi2 - thresholds.NEAR_CHI2 and place != best.place
        ),
        python=_python(constants.kind, chosen, units, values),
    )


def coefficient_unit(kind: str, scale: float, gravity: float) -> tuple[float, str]:
    """Return output units per unit of the coefficient, and that unit."""
    return (scale * np.pi / 180 / 3600, "deg/h") if kind == "gyro" else (scale * 1e-6 * gravity, "ug")


def _scores(projection: Projection, whitened: np.ndarray) -> list[ScoreTest]:
    """Return the score test of every whitened column, (R, terms), by itself."""
    lengths = np.linalg.norm(whitened, axis=0)
    return [
        score_test(projection, column[:, None], lengths[place, None], thresholds.FORM_RETAINED_MIN)
        for place, column in enumerate(projection.project(whitened).T)
    ]


def _pursue(
    projection: Projection, terms: Sequence[Term], whitened: np.ndarray, scores: Sequence[ScoreTest]
) -> list[_Selected]:
    """Select terms one by one; `scores` are those before any was selected."""
    selected: list[_Selected] = []
    penalty = [thresholds.ELABORATE_PENALTY * (term.sort in _ELABORATE) for term in terms]
    while len(selected) < thresholds.MAX_TERMS:
        if selected:
            projection = projection.without(selected[-1].score.span)
            scores = _scores(projection, whitened)
        worth = [
            score.delta_chi2 - less if score.span.shape[1] else -np.inf
            for score, less in zip(scores, penalty, strict=True)
        ]
        best = int(np.argmax(worth))
        p = min(1.0, scores[best].p * len(terms))
        if p >= thresholds.TERM_P:
            break
        selected.append(_Selected(best, scores[best], p))
    return selected


def _solve(projection: Projection, whitened: np.ndarray, variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return least-squares coefficients of whitened columns, and their standard deviations."""
    inverse = np.linalg.pinv(projection.project(whitened))
    weight = projection.strata.at_rows(variance)
    return inverse @ projection.residual, np.sqrt(np.diag((inverse * weight) @ inverse.T))


def _inclusion(projection: Projection, projected: np.ndarray, best: int) -> float:
    """Return how often the same term is selected first when whole runs are resampled."""
    model = projection.fitted.model
    count, runs = len(model.entries), len(model.campaign.runs)
    along, square = np.zeros((runs, projected.shape[1])), np.zeros((runs, projected.shape[1]))
    np.add.at(along, model.entries.run, projected[:count] * projection.residual[:count, None])
    np.add.at(square, model.entries.run, projected[:count] ** 2)
    drawn = np.random.default_rng(0).multinomial(runs, np.full(runs, 1 / runs), size=thresholds.RESAMPLES)
    whole = drawn @ square
    score = np.where(whole > 1e-12, (drawn @ along) ** 2 / np.where(whole > 1e-12, whole, 1.0), 0.0)
    return float(np.mean(np.argmax(score, axis=1) == best))


def _python(kind: str, terms: Sequence[Term], units: Sequence[str], value: np.ndarray) -> str:
    """Return the text of an effect class with these terms."""
    names = ["coefficient", "second", "third"][: len(terms)]
    needs = tuple(dict.fromkeys(need for term in terms for need in term.needs))
    formula = " + ".join(f"{name}·{term.text}" for name, term in zip(names, terms, strict=True))
    lines = [
        f'"""Found in the residuals: {formula}."""',
        "",
        "import jax.numpy as jnp",
        "",
        "from imubayes import Order, Scalar, SignalEffect, Stage, parameter",
        "",
        "",
        "class FoundShape(SignalEffect):",
        f'    """Signal + {formula}."""',
        "",
        f'    name = "found_{kind}_shape"',
        f'    stage, order, kinds = Stage.SENSOR, Order.BIAS, ("{kind}",)',
        f"    needs = {needs!r}",
    ]
    for name, unit, found in zip(names, units, value.tolist(), strict=True):
        wide = float(f"{3 * abs(found):.1g}") or 1.0
        low, high = float(f"{abs(found) / 10:.1g}"), wide
        prior = f"normal(0, {wide:g} {unit})"
        lines.append(f'    {name}: Scalar = parameter("{unit}", "{prior}", ({low:g}, {high:g}), "the coefficient")')
    total = " + ".join(f"self.{name} * {term.expression}" for name, term in zip(names, terms, strict=True))
    lines += ["", "    def apply(self, signal, sample):", f"        return signal + {total}", ""]
    text = "\n".join(lines)
    return text if "jnp." in total else text.replace("import jax.numpy as jnp\n\n", "")
