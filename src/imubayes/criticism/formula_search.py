"""Formula search: the simplest formula in the covariates that explains a channel's residual, from a library of terms.

The terms show what a dependence without a known cause may look like: powers, absolute values, exponentials, harmonics
of the table angle, bumps (a resonance, a jump of mode), waves (an interference) and products of two covariates.  A
formula is that of one channel.

Orthogonal matching pursuit over the library goes past what the leading explanation fits: the term with the strongest
evidence is selected and projected out, until the odds are against a further one.  The inclusion frequency, how often a
term is selected first when whole runs are resampled, says how far to trust it.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from imubayes.criticism.evidence.free_forms import HARMONICS, HIGHEST_POWER, PLACES
from imubayes.criticism.evidence.hypothesis_evidence import Evaluated, EvidenceOf
from imubayes.criticism.evidence.linear_problem import NEGLIGIBLE, SAME_LEVEL, LinearProblem
from imubayes.criticism.evidence.possible_forms import largest_amplitude
from imubayes.criticism.evidence.proposals import base_columns
from imubayes.criticism.explanation_records import NAMED_ODDS, NEAR, FormulaTerm, ResidualFormula
from imubayes.foundations.campaign_data import Channel
from imubayes.foundations.covariates import Covariate, regressors
from imubayes.foundations.records import finite
from imubayes.inference.fitted_model import Fit
from imubayes.responses.residual_covariates import ResidualCovariate

_TIME_CONSTANTS_MIN = (2.0, 5.0, 10.0, 30.0, 60.0)


@dataclass(frozen=True)
class Term:
    """One term of the library.

    Attributes
    ----------
    text : formula in symbols of the covariates.
    divisor : unit by which that of its coefficient is divided; empty if it is not.
    expression : the same in Python, for `sample`, in SI.
    covariates : columns that the term is formed of.
    needs : covariates that a run has to supply.
    values : shape (E,), in datasheet units, 0 if not known.
    sort : power, harmonic, bump, wave or product; bumps, waves and products are chosen from many.
    """

    text: str
    divisor: str
    expression: str
    covariates: tuple[str, ...]
    needs: tuple[str, ...]
    values: np.ndarray = field(repr=False)
    sort: str


@dataclass(frozen=True)
class _Base:
    """A covariate as formulas use it, with its values less the centre, shape (E,)."""

    entry: Covariate
    values: np.ndarray

    def term(self, text: str, divisor: str, expression: str, values: np.ndarray, sort: str) -> Term:
        return Term(text, divisor, expression, (self.entry.column,), self.entry.needed, _filled(values), sort)


def library(covariates: Sequence[ResidualCovariate], rows: np.ndarray, gravity: float) -> list[Term]:
    """Return the terms that can be formed of the covariates of some rows, shape (E,) bool."""
    terms: list[Term] = []
    bases: list[_Base] = []
    entries = {entry.column: entry for entry in regressors()}
    for covariate in covariates:
        entry = entries.get(covariate.name)
        values = np.where(rows & np.isfinite(covariate.values), covariate.values, np.nan)
        if entry is None or np.isfinite(values).sum() < 4 or np.nanmax(values) - np.nanmin(values) <= 0:
            continue
        base = _Base(entry, values - entry.centre if entry.centre else values)
        if entry.periodic:
            terms.extend(_harmonics(base, gravity))
        elif entry.symbol:
            bases.append(base)
            terms.extend(_of_one(base, gravity))
    for first, second in combinations(bases, 2):
        terms.extend(_of_two(first, second))
    return [term for term in terms if np.any(term.values != 0)]


def levels(values: np.ndarray) -> np.ndarray:
    """Number the levels of a covariate: values closer than a share of the range are one; all differ in a continuum.

    Parameters
    ----------
    values : shape (n,), finite.
    """
    least = SAME_LEVEL * np.ptp(values)
    order = np.argsort(values)
    gaps = np.diff(values[order]) > least
    level = np.empty(len(values), dtype=int)
    level[order] = np.concatenate([[0], np.cumsum(gaps)])
    widths = [np.ptp(values[level == number]) for number in range(level.max() + 1)]
    # A chain of close values is a continuum, not a level.
    return level if max(widths) <= least else np.arange(len(values))


def _filled(values: np.ndarray) -> np.ndarray:
    return np.nan_to_num(values, nan=0.0)


def _harmonics(base: _Base, gravity: float) -> list[Term]:
    symbol, code, angle = base.entry.symbol, base.entry.python, base.values * base.entry.factor(gravity)
    return [
        base.term(f"{name} {k}{symbol}", "", f"jnp.{name}({k} * {code})", f(k * angle), "harmonic")
        for k in range(1, HARMONICS + 1)
        for name, f in (("sin", np.sin), ("cos", np.cos))
    ]


def _of_one(base: _Base, gravity: float) -> list[Term]:
    symbol, expression, unit, values = base.entry.symbol, base.entry.python, base.entry.unit, base.values
    found = [
        base.term(
            _power_text(symbol, power), _power_unit(unit, power), f"{expression} ** {power}", values**power, "power"
        )
        for power in range(1, HIGHEST_POWER + 1)
    ]
    if base.entry.si == "s":
        found += [
            base.term(
                f"exp(−{symbol}/{minutes:g} min)", "", f"jnp.exp(-{expression} / {60 * minutes})",
                np.exp(-values / (60 * minutes)), "power",
            )
            for minutes in _TIME_CONSTANTS_MIN
        ]  # fmt: skip
        return found + list(_waves(base, gravity))
    signed: tuple[tuple[str, str, str, Callable], ...] = (
        (f"|{symbol}|", _power_unit(unit, 1), f"jnp.abs({expression})", np.abs),
        (
            f"{symbol}·|{symbol}|",
            _power_unit(unit, 2),
            f"{expression} * jnp.abs({expression})",
            lambda v: v * np.abs(v),
        ),
        (f"sgn {symbol}", "", f"jnp.sign({expression})", np.sign),
    )
    found += [base.term(text, below, code, f(values), "power") for text, below, code, f in signed]
    return found + list(_bumps(base, gravity)) + list(_waves(base, gravity))


def _bumps(base: _Base, gravity: float) -> Iterator[Term]:
    """Yield bumps, as of a resonance: 1/(1 + ((x − c)/w)²) at centres and widths over the covered range.

    A rate or a force acts alike in both directions, and x is its size; a temperature has no second side.
    """
    text, code, size = base.entry.symbol, base.entry.python, base.values
    if base.entry.symmetric:
        text, code, size = f"|{text}|", f"jnp.abs({code})", np.abs(size)
    low, high = float(np.nanmin(size)), float(np.nanmax(size))
    if not high > low:  # one rate, in both directions
        return
    unit, factor = base.entry.unit, base.entry.factor(gravity)
    for centre in np.linspace(low, high, PLACES + 1)[1:-1].tolist():
        for width in ((high - low) / 16, (high - low) / 8, (high - low) / 4):
            formula = f"1/(1 + (({text} − {centre:.3g})/{width:.3g})²) with {base.entry.symbol} in {unit}"
            python = f"1 / (1 + (({code} - {centre * factor:.6g}) / {width * factor:.6g}) ** 2)"
            yield base.term(formula, "", python, 1 / (1 + ((size - centre) / width) ** 2), "bump")


def _waves(base: _Base, gravity: float) -> Iterator[Term]:
    """Yield waves along a covariate, from one period over its range to as many as its levels resolve."""
    finite = base.values[np.isfinite(base.values)]
    most = min(HARMONICS, len(np.unique(levels(finite))) // 3)
    unit, factor = base.entry.unit, base.entry.factor(gravity)
    for half_turns in range(2, 2 * most + 1):
        period = 2 * float(np.ptp(finite)) / half_turns
        for name, f in (("sin", np.sin), ("cos", np.cos)):
            yield base.term(
                f"{name}(2π {base.entry.symbol}/{period:.3g} {unit})", "",
                f"jnp.{name}({2 * np.pi / (period * factor):.6g} * {base.entry.python})",
                f(2 * np.pi * base.values / period), "wave",
            )  # fmt: skip


def _of_two(one: _Base, other: _Base) -> list[Term]:
    x, y, found = one.entry, other.entry, []
    for a in (1, 2):
        for b in (1, 2):
            text = f"{_power_text(x.symbol, a)}·{_power_text(y.symbol, b)}"
            below = f"{_power_unit(x.unit, a)}/{_power_unit(y.unit, b)}"
            code = f"{x.python} ** {a} * {y.python} ** {b}"
            needs = tuple(dict.fromkeys((*x.needed, *y.needed)))
            values = _filled(one.values**a * other.values**b)
            found.append(Term(text, below, code, (x.column, y.column), needs, values, "product"))
    return found


def _power_text(symbol: str, power: int) -> str:
    return symbol if power == 1 else f"{symbol}{'²³⁴⁵'[power - 2]}"


def _power_unit(unit: str, power: int) -> str:
    """Return a unit to a power, as the unit table writes it."""
    bracketed = f"({unit})" if "/" in unit and not unit.startswith("(") else unit
    return bracketed if power == 1 else f"{bracketed}^{power}"


_MOST_TERMS, _RESAMPLES = 3, 200
"""Terms of a formula at most; times that runs are resampled."""


@dataclass(frozen=True)
class Pursuit:
    """Terms beside an explanation: V (T, T) and u (T,) past what it fits, in units of the noise."""

    own: np.ndarray
    right: np.ndarray

    def coefficients(self, whole: np.ndarray) -> np.ndarray:
        """Return the coefficient of each term alone, (T,), of squared length `whole` at first; 0 if none is left."""
        left = np.diag(self.own)
        shown = left > NEGLIGIBLE * whole
        return np.where(shown, self.right / np.where(shown, left, 1.0), 0.0)

    def drops(self, whole: np.ndarray) -> np.ndarray:
        """Return the drop of χ² by each term, of squared length `whole` at first, (T,)."""
        return self.right * self.coefficients(whole)

    def without(self, place: int) -> "Pursuit":
        """Return the same with a term projected out."""
        along = self.own[:, place] / self.own[place, place]
        return Pursuit(self.own - np.outer(along, self.own[place]), self.right - along * self.right[place])


@dataclass(frozen=True)
class TermsBeside:
    """Terms of a channel beside a hypothesis.

    Attributes
    ----------
    channel : whose rows they are.
    terms : T of them.
    entry, run : shapes (n,), of each row.
    left, residual : shapes (n, T) and (n,), whitened, past what the hypothesis fits.
    whole : shape (T,), squared lengths of the whitened terms.
    size : shape (T,), by which terms are divided.
    first : the terms before any is selected.
    unit : of their coefficients.
    """

    channel: Channel
    terms: tuple[Term, ...]
    entry: np.ndarray
    run: np.ndarray
    left: np.ndarray
    residual: np.ndarray
    whole: np.ndarray
    size: np.ndarray
    first: Pursuit
    unit: str

    def formula(self, selected: Sequence[tuple[int, float, float]]) -> ResidualFormula:
        """Return the formula of terms selected: place, drop of χ² and log odds of each."""
        places = [place for place, _, _ in selected]
        covariance = np.linalg.inv(self.first.own[np.ix_(places, places)])
        values, sds = covariance @ self.first.right[places], np.sqrt(np.diag(covariance))
        drops, size = self.first.drops(self.whole), self.size[places]
        return ResidualFormula(
            channel=self.channel.name,
            kind=self.channel.kind,
            shape=" + ".join(self.terms[place].text for place in places),
            terms=tuple(
                _formula_term(self.terms[place], drop, odds, value, sd, self.unit)
                for (place, drop, odds), value, sd in zip(selected, values / size, sds / size, strict=True)
            ),
            inclusion=_inclusion(self.run, self.left, self.residual, places[0]),
            near=tuple(
                term.text
                for place, (term, drop) in enumerate(zip(self.terms, drops, strict=True))
                if drop > drops[places[0]] - 2 * NEAR and place != places[0]
            ),
        )


def terms_beside(
    of: EvidenceOf, at: Evaluated, scale: np.ndarray, fitted: Fit, terms: Sequence[Term], channel: int
) -> TermsBeside:
    """Return terms of a channel beside a hypothesis.

    Parameters
    ----------
    at : the hypothesis, without a form.
    scale : shape (K,), noise scales with the form that explains the rest.
    """
    constants = fitted.model.campaign.channels[channel]
    factor, base = coefficient_unit(constants.kind, constants.scale_si, fitted.model.campaign.site.gravity)
    rows, solved = of.problem.rows[channel], of.solved(at, scale)
    columns = np.stack([term.values[rows.entry] for term in terms], axis=1) * factor
    size = np.maximum(np.abs(columns).max(axis=0), np.finfo(float).tiny)
    columns = columns / size * of.problem.root[rows.entry][:, None]
    white = of.whiten(at.hypothesis, columns, channel, at.weight.get(channel)) / scale[channel]
    taken = base_columns(of, at, channel) / scale[channel]
    where = of.taking_part(channel, at.columns, None)
    left = white - taken[:, :-1] @ (solved.covariance[np.ix_(where, where)] @ (taken[:, :-1].T @ white))
    residual = taken[:, -1] - taken[:, :-1] @ solved.mean[where]
    first = Pursuit(white.T @ left, white.T @ residual)
    whole, run = np.sum(white**2, axis=0), of.problem.run[rows.entry]
    return TermsBeside(constants, tuple(terms), rows.entry, run, left, residual, whole, size, first, base)


def terms_of(fitted: Fit, covariates: Sequence[ResidualCovariate], channel: int) -> list[Term]:
    """Return the library of a channel."""
    entries = fitted.model.entries
    here = (entries.channel == channel) & ~entries.closing
    return library(covariates, here, fitted.model.campaign.site.gravity)


def find_formula(
    of: EvidenceOf, at: Evaluated, scale: np.ndarray, fitted: Fit, covariates: Sequence[ResidualCovariate], channel: int
) -> ResidualFormula | None:
    """Return the simplest formula for what a hypothesis leaves of a channel; None if no term is worth its odds.

    Parameters
    ----------
    at, scale : the hypothesis, as in `terms_beside`.
    """
    terms = terms_of(fitted, covariates, channel)
    if not terms:
        return None
    beside = terms_beside(of, at, scale, fitted, terms, channel)
    selected = _pursue(beside, _largest_coefficients(of.problem, terms, covariates, channel) * beside.channel.scale_si)
    return beside.formula(selected) if selected else None


def _largest_coefficients(
    problem: LinearProblem, terms: Sequence[Term], covariates: Sequence[ResidualCovariate], channel: int
) -> np.ndarray:
    """Return the largest response that the channel of a sensor can have to each term, SI at the input, (T,).

    It is that to the covariates of the term, as of a form: a cosine of the Earth rate of 6 mg is none of a sensor.
    """
    noise = problem.rows[channel].noise
    bounds = {
        names: largest_amplitude(problem, channel, [each for each in covariates if each.name in names])
        for names in {term.covariates for term in terms}
    }
    return np.array([bounds[term.covariates] * noise if noise else np.inf for term in terms])


def coefficient_unit(kind: str, scale: float, gravity: float) -> tuple[float, str]:
    """Return output units per unit of the coefficient, and that unit."""
    return (scale * np.pi / 180 / 3600, "deg/h") if kind == "gyro" else (scale * 1e-6 * gravity, "ug")


def _pursue(beside: TermsBeside, largest: np.ndarray) -> list[tuple[int, float, float]]:
    """Return the places of the terms selected, with the drop of χ² and log odds of each (Schwarz's criterion).

    Parameters
    ----------
    largest : shape (T,), coefficient of each term of largest value 1 that a sensor can have, output units.
    """
    # Sorts are equally likely, and so are the terms of each: what is chosen from many pays for it.
    terms, at = beside.terms, beside.first
    members = Counter(term.sort for term in terms)
    cost = np.log([len(members) * members[term.sort] for term in terms])
    selected: list[tuple[int, float, float]] = []
    while len(selected) < _MOST_TERMS:
        drops = at.drops(beside.whole)
        odds = 0.5 * drops - 0.5 * math.log(len(beside.residual)) - cost
        odds = np.where(np.abs(at.coefficients(beside.whole)) <= largest, odds, -np.inf)
        best = int(np.argmax(odds))
        if odds[best] < NAMED_ODDS:
            break
        selected.append((best, float(drops[best]), float(odds[best])))
        at = at.without(best)
    return selected


def _formula_term(term: Term, drop: float, odds: float, value: float, sd: float, base: str) -> FormulaTerm:
    return FormulaTerm(
        shape=term.text,
        expression=term.expression,
        needs=term.needs,
        value=float(value),
        sd=finite(sd),
        unit=f"{base}/{term.divisor}" if term.divisor else base,
        delta_chi2=drop,
        log_odds=odds,
    )


def _inclusion(run: np.ndarray, left: np.ndarray, residual: np.ndarray, best: int) -> float:
    """Return how often the same term is selected first when whole runs are resampled."""
    names, place = np.unique(run, return_inverse=True)
    along, square = np.zeros((len(names), left.shape[1])), np.zeros((len(names), left.shape[1]))
    np.add.at(along, place, left * residual[:, None])
    np.add.at(square, place, left**2)
    count = len(names)
    drawn = np.random.default_rng(0).multinomial(count, np.full(count, 1 / count), size=_RESAMPLES)
    whole = drawn @ square
    score = np.where(whole > 1e-12, (drawn @ along) ** 2 / np.where(whole > 1e-12, whole, 1.0), 0.0)
    return float(np.mean(np.argmax(score, axis=1) == best))
