"""A shape for what has no name: the simplest formula in the covariates that explains a channel's residual.

Orthogonal matching pursuit over the library of simple terms, all sent through the projection: the term with the
strongest evidence is taken, taken out, and the next looked for, until chance alone would do as well.  How often each
term comes first when whole runs are drawn anew says how much to trust it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.criticism import thresholds
from imubayes.criticism.projection import Projection
from imubayes.criticism.residual_covariates import ResidualCovariate
from imubayes.criticism.score_test import score_test
from imubayes.criticism.term_library import Term, library

# Sorts of terms that are chosen from many: penalised against plain ones.
_ELABORATE = ("product", "wave")


@dataclass(frozen=True)
class Formula:
    """What was found for one channel.

    Attributes
    ----------
    channel : name.
    terms : the terms, in the order in which they were taken.
    value, sd : coefficients at the input, in `unit` of each.
    unit : one per term.
    delta_chi2 : Δχ² of each term when it was taken.
    p : chance of each, with all looks at the library counted.
    inclusion : how often the first term comes first when runs are drawn anew.
    near : texts of terms that would do almost as well as the first.
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
        """The sum of the terms, in words."""
        return " + ".join(term.text for term in self.terms)


def find_formula(projection: Projection, known: Sequence[ResidualCovariate], channel: str) -> Formula | None:
    """Return the simplest formula for the residual of a channel; None where no term is beyond chance."""
    model = projection.fitted.model
    place = [one.name for one in model.campaign.channels].index(channel)
    constants = model.campaign.channels[place]
    rows = (model.entries.channel == place) & ~model.entries.closing
    terms = library(known, rows, model.campaign.site.gravity)
    if not terms:
        return None
    factor, base = coefficient_unit(constants.kind, constants.scale_si, model.campaign.site.gravity)
    columns = np.stack([np.where(rows, term.values, 0.0) for term in terms], axis=1) * factor
    size = np.abs(columns).max(axis=0)
    whitened = projection.whitened(columns / size)
    at, taken = projection, []
    first: tuple[float, tuple[str, ...]] = (0.0, ())
    for step in range(thresholds.MAX_TERMS):
        found = [
            score_test(at, projected[:, None], np.linalg.norm(column, keepdims=True), thresholds.FORM_RETAINED_MIN)
            for projected, column in zip(at.project(whitened).T, whitened.T, strict=True)
        ]
        worth = [
            one.delta_chi2 - thresholds.ELABORATE_PENALTY * (term.sort in _ELABORATE) if one.span.shape[1] else -np.inf
            for term, one in zip(terms, found, strict=True)
        ]
        best = int(np.argmax(worth))
        p = min(1.0, found[best].p * len(terms))
        if p >= thresholds.TERM_P:
            break
        if step == 0:
            near = [
                term.text
                for term, one in zip(terms, found, strict=True)
                if one.delta_chi2 > found[best].delta_chi2 - thresholds.NEAR_CHI2 and term is not terms[best]
            ]
            first = (_inclusion(at, at.project(whitened), best), tuple(near))
        taken.append((best, found[best].delta_chi2, p, found[best].variance))
        at = at.without(found[best].span)
    if not taken:
        return None
    chosen = [best for best, *_ in taken]
    value, sd = _solve(projection, whitened[:, chosen], taken[-1][3])
    units = tuple(f"{base}/{terms[best].divisor}" if terms[best].divisor else base for best in chosen)
    value, sd = value / size[chosen], sd / size[chosen]
    return Formula(
        channel=channel,
        terms=tuple(terms[best] for best in chosen),
        value=tuple(value.tolist()),
        sd=tuple(sd.tolist()),
        unit=units,
        delta_chi2=tuple(drop for _, drop, _, _ in taken),
        p=tuple(p for _, _, p, _ in taken),
        inclusion=first[0],
        near=first[1],
        python=_python(constants.kind, [terms[best] for best in chosen], units, value),
    )


def coefficient_unit(kind: str, scale: float, gravity: float) -> tuple[float, str]:
    """Return output units per unit of the coefficient, and that unit."""
    return (scale * np.pi / 180 / 3600, "deg/h") if kind == "gyro" else (scale * 1e-6 * gravity, "ug")


def _solve(projection: Projection, whitened: np.ndarray, variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    projected = projection.project(whitened)
    weight = projection.strata.at_rows(variance)
    inverse = np.linalg.pinv(projected)
    return inverse @ projection.residual, np.sqrt(np.diag((inverse * weight) @ inverse.T))


def _inclusion(projection: Projection, projected: np.ndarray, best: int) -> float:
    """Return how often the same term comes first when whole runs are drawn anew."""
    model = projection.fitted.model
    count = len(model.entries)
    runs = len(model.campaign.runs)
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
