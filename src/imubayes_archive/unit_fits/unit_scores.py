"""Scores of all candidate effects in the fit of each unit, in a form that adds over units, and their files.

With r the residual and g⊥ the response to the coefficients of a candidate, both divided by the noise and less what the
parameters of the model absorb, the score U = g⊥ᵀr and the information V = g⊥ᵀg⊥ are all that is needed of a unit: the
likelihood of its coefficients is exp(Uᵀb − bᵀVb/2), and logarithms add up over units.  All coefficients of all
candidates stand in one U and one V, so that candidates can be compared with and cleared of each other.

Priors give no evidence here.  A population that its prior does not expect would count as evidence for an effect in
every unit, and over a hundred units as strong evidence: what the parameters absorb is projected out as if their priors
were flat.

The noise of a channel is that known beforehand, drawn towards the scatter of its rows as far as it is not known well.
If the rows scatter more than that, it is what they say: a unit with a gross error must not outvote all others.  The
scatter is what the most probable effect leaves over, if one explains the rows of the unit: it would hide itself
otherwise.

Scores are computed for every fitted campaign from the estimates of the batch, a chunk of campaigns at a time, and kept
beside its parts.  Each file appears as a whole or not at all, and a campaign that has scores is not computed again.
"""

import hashlib
import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import polars as pl

from imubayes import Fit
from imubayes.criticism.evidence.effect_variants import EffectVariant
from imubayes.criticism.evidence.hypothesis_evidence import EvidenceOf, Hypothesis, scale_mode
from imubayes.criticism.evidence.linear_problem import LinearProblem, linear_problem
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.errors import InputError, Issue, input_error, kept_if_possible
from imubayes.foundations.files import new_folder
from imubayes.inference.posterior_mode import find_mode
from imubayes.model.model_file import ModelSpec, read_carried_model
from imubayes.responses.candidate_effects import Response, candidate_responses
from imubayes.results.folder_files import seal
from imubayes_archive.unit_fits.batch_folder import UnitSource
from imubayes_archive.unit_fits.fit_unit import bound_to
from imubayes_archive.unit_fits.posterior_table import (
    chosen_model,
    kept_model,
    model_folder,
    packed,
    read_units,
    whole_parts,
)

_RANK = 1e-10
"""Singular values of the model's Jacobian, relative to the largest, below which a direction is rounding."""
_RETAINED = 1e-6
"""Share of a response, squared, that the model must leave over: less is rounding."""
_ROUNDS, _SETTLED, _LEAST_FREEDOM = 10, 1e-3, 2.0

SCORES = pl.Schema(
    {
        "digest": pl.String, "unit": pl.String, "effect": pl.String, "shape": pl.String, "scope": pl.String,
        "part": pl.String, "owners": pl.List(pl.String), "coefficients": pl.List(pl.String), "log_odds": pl.Float64,
        "widths": pl.List(pl.Float64), "measures": pl.List(pl.String), "sizes": pl.List(pl.Float64),
        "signs": pl.List(pl.Int8), "score": pl.List(pl.Float64), "information": pl.List(pl.Float64),
    }
)  # fmt: skip
"""One row per campaign and candidate, up to `widths`; one more per campaign, without an effect, with what follows of
all coefficients: units, largest typical sizes, signs, score, and the lower triangle of the information."""


@dataclass(frozen=True)
class CandidateKey:
    """A candidate over units.

    Attributes
    ----------
    effect, shape : its name, and the values of its shape parameters as text; empty if it has none.
    scope : the kind of channel, or the channel, mounting or table that it acts on alone.
    part : the only parameter that it has; empty for all of them.
    """

    effect: str
    shape: str
    scope: str
    part: str = ""


def unit_scores(fit: Fit, unit: str, digest: str) -> pl.DataFrame:
    """Return the scores of every candidate effect of a converged fit, schema `SCORES`."""
    return scores_of(linear_problem(fit, candidate_responses(fit)), unit, digest)


def scores_of(problem: LinearProblem, unit: str, digest: str) -> pl.DataFrame:
    """Return the scores of the candidates of a linearised fit."""
    of = EvidenceOf(problem)
    score, information = _past_own(of, _likeliest_noise(of))
    shapes = [_shape(each) for each in problem.candidates for _ in each.coefficients]
    names = [
        f"{each.parameter.name}{f' at {shape}' if shape else ''}"
        for each, shape in zip(problem.coefficients, shapes, strict=True)
    ]
    rows = [
        {
            **vars(key), "owners": list(each.owners), "log_odds": each.log_odds, "widths": list(each.widths),
            "coefficients": [names[place] for place in each.places],
        }
        for key, each in _candidates(of, np.diag(information) > 0)
    ]  # fmt: skip
    together = {
        "coefficients": names, "measures": [each.parameter.shown_unit for each in problem.coefficients],
        "sizes": problem.sizes.tolist(), "signs": problem.sign.tolist(), "score": score.tolist(),
        "information": packed(information),
    }  # fmt: skip
    return pl.DataFrame([{"digest": digest, "unit": unit, **each} for each in (*rows, together)], schema=SCORES)


def _likeliest_noise(of: EvidenceOf) -> Hypothesis:
    """Return the hypothesis that nothing is missing, at the most probable scatter between runs of the model."""
    found = Hypothesis((), of.stated)
    for place, unit in enumerate(of.units):
        if len(unit.stated) > 1:
            tried = [of.evaluate(found.with_noise(place, each)) for each in unit.stated]
            found = max(tried, key=lambda each: each.log_posterior).hypothesis
    return found


def _past_own(of: EvidenceOf, noise: Hypothesis) -> tuple[np.ndarray, np.ndarray]:
    """Return score (C,) and information (C, C) of all coefficients past the model's own parameters, no prior on these.

    Coefficients of which nothing is left are 0 in both.
    """
    columns, channel = _whitened_rows(of, noise)
    own, problem = of.problem.own, of.problem
    scale = _scatter(problem, columns[:, :own], columns[:, -1], channel)
    left = _left_over(columns, own, scale[channel])
    explaining = _explaining(of, left, channel)
    if explaining:
        jacobian = columns[:, [*range(own), *(own + place for place in explaining)]]
        scale = _scatter(problem, jacobian, columns[:, -1], channel)
        left = _left_over(columns, own, scale[channel])
    products = left.T @ left
    return products[:-1, -1], products[:-1, :-1]


def _left_over(columns: np.ndarray, own: int, scale: np.ndarray) -> np.ndarray:
    """Return the columns [X r] over the scale (n,) of each row, past the own parameters of the model; rounding is 0."""
    basis, free = _span(columns[:, :own] / scale[:, None]), columns[:, own:] / scale[:, None]
    left = free - basis @ (basis.T @ free)
    kept = np.sum(left**2, axis=0) > _RETAINED * np.sum(free**2, axis=0)
    kept[-1] = True
    return left * kept


def _explaining(of: EvidenceOf, left: np.ndarray, channel: np.ndarray) -> tuple[int, ...]:
    """Return the coefficients of the effect that explains the scatter of a unit best; empty if none does.

    Noise scales are taken as unknown: the evidence is that of the sums of squares before and after (Schwarz 1978).

    Parameters
    ----------
    left : shape (n, C + 1), what the model's own parameters leave of [X r].
    """
    groups = [np.flatnonzero(channel == k) for k in np.unique(channel)]

    def logarithms(rest: np.ndarray) -> float:
        return sum(0.5 * len(rows) * math.log(max(float(rest[rows] @ rest[rows]), 1e-12)) for rows in groups)

    best, found, before = 0.0, tuple[int, ...](), logarithms(left[:, -1])
    for each in of.variants:
        places = list(each.places)
        basis = _span(left[:, places])
        rest = left[:, -1] - basis @ (basis.T @ left[:, -1])
        gain = before - logarithms(rest) - 0.5 * len(places) * math.log(len(rest)) + each.log_odds
        if gain > best:
            best, found = gain, each.places
    return found


def _whitened_rows(of: EvidenceOf, noise: Hypothesis) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of all channels with the columns [J X r], (n, P + C + 1), and the channel of each, (n,)."""
    count = of.problem.own + len(of.problem.coefficients)
    channels = sorted(of.unit_of)
    columns = np.zeros((of.problem.outputs, count + 1))
    channel = np.repeat(channels, [len(of.problem.rows[k].entry) for k in channels]).astype(int)
    for k in channels:
        columns[np.ix_(channel == k, [*of.problem.rows[k].live, count])] = of.whitened(noise, k)
    return columns, channel


def _scatter(problem: LinearProblem, jacobian: np.ndarray, residual: np.ndarray, channel: np.ndarray) -> np.ndarray:
    """Return the noise scale of each channel, (K,), of a residual (n,) past the columns of a Jacobian (n, P)."""
    scale = np.ones(len(problem.rows))
    for _ in range(_ROUNDS):
        basis = _span(jacobian / scale[channel, None])
        misfit = residual / scale[channel]
        rest, left = misfit - basis @ (basis.T @ misfit), 1 - np.sum(basis**2, axis=1)
        before = scale.copy()
        for k in np.unique(channel):
            freedom = max(float(left[channel == k].sum()), _LEAST_FREEDOM)
            square = max(float(np.sum(rest[channel == k] ** 2) * before[k] ** 2), 1e-12)
            mode, _ = scale_mode(square, freedom, problem.rows[k].scale_sd)
            scale[k] = max(math.exp(mode), math.sqrt(square / freedom))
        if np.max(np.abs(np.log(scale / before)), initial=0.0) < _SETTLED:
            break
    return scale


def _span(jacobian: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis of the columns of a Jacobian, (n, rank)."""
    size = np.linalg.norm(jacobian, axis=0)
    left, singular, _ = np.linalg.svd(jacobian / np.where(size > 0, size, 1.0), full_matrices=False)
    return left[:, singular > _RANK * singular.max(initial=0.0)]


def _shape(response: Response) -> str:
    return ", ".join(f"{name}={value:g}" for name, value in response.scan.shape.items())


def _candidates(of: EvidenceOf, left: np.ndarray) -> Iterator[tuple[CandidateKey, EffectVariant]]:
    """Yield the variants of which something is left, left (C,) bool, with what they are called in every unit."""
    problem = of.problem
    kinds = {rows.name: rows.kind for rows in problem.of_channels}
    owners, fields = defaultdict[tuple[int, str], set[str]](set), defaultdict[tuple[int, str], set[str]](set)

    def about(each: EffectVariant) -> tuple[tuple[int, str], set[str]]:
        cause = each.response, kinds.get(each.owners[0], "")
        return cause, {problem.coefficients[k].parameter.field for k in each.places}

    for each in of.variants:
        cause, own = about(each)
        owners[cause].update(each.owners)
        fields[cause].update(own)
    for each in of.variants:
        cause, own = about(each)
        places = tuple(k for k in each.places if left[k])
        if places:
            scope = each.owners[0] if len(each.owners) < len(owners[cause]) else cause[1] or "equipment"
            part = next(iter(own)) if len(own) < len(fields[cause]) else ""
            owned = tuple(dict.fromkeys(problem.coefficients[k].owner for k in places))
            shape = _shape(problem.candidates[each.response])
            yield CandidateKey(each.effect, shape, scope, part), replace(each, owners=owned, places=places)


_PREFIX, _SCORES, _CHUNK, _DIGITS = "scores-", "scores.parquet", 32, 16


def read_unit_scores(results: str | Path, model: str | None = None) -> pl.DataFrame:
    """Return the scores of a batch, schema `SCORES`; raises InputError if they are of another version."""
    folder = model_folder(results, chosen_model(results, model))
    tables = {part: pl.read_parquet(part / _SCORES) for part in whole_parts(folder, _PREFIX)}
    for file, table in tables.items():
        if table.schema != SCORES:
            raise input_error(
                "the scores of the batch were written by another version of imubayes",
                str(file),
                "scores of this version",
                "run imubayes batch again, with --out of another folder",
            )
    return pl.concat([SCORES.to_frame(), *tables.values()])


@dataclass(frozen=True)
class ScoresOfUnits:
    """Scores of a batch, schema `SCORES`, and why some campaigns have none."""

    table: pl.DataFrame
    issues: tuple[Issue, ...]


def complete_scores(
    results: str | Path, model: str | None = None, progress: Callable[[int, int], None] | None = None
) -> ScoresOfUnits:
    """Return the scores of every fitted campaign; those that have none yet are computed, and kept if possible.

    Parameters
    ----------
    results, model : the batch.
    progress : called with the numbers of campaigns done and to do.

    Raises
    ------
    InputError
        for scores of another version, and effect files that are not trusted.
    """
    units = read_units(results, model).filter(pl.col("status") == "fitted")
    key = chosen_model(results, model)
    folder = model_folder(results, key)
    spec, tables = read_carried_model(kept_model(results, key)), [read_unit_scores(results, key)]
    known = set(tables[0]["digest"])
    missing = [row for row in units.iter_rows(named=True) if row["digest"] not in known]
    issues: list[Issue] = []
    for start in range(0, len(missing), _CHUNK):
        rows = missing[start : start + _CHUNK]
        found = pl.concat([SCORES.to_frame(), *_scored(spec, rows, issues)])
        tables.append(found)
        if len(found):
            name = hashlib.sha256("\0".join(row["digest"] for row in rows).encode()).hexdigest()[:_DIGITS]
            with kept_if_possible(folder), new_folder(folder / f"{_PREFIX}{name}", durable=True) as scratch:
                found.write_parquet(scratch / _SCORES)
                seal(scratch)
        if progress is not None:
            progress(min(start + _CHUNK, len(missing)), len(missing))
    return ScoresOfUnits(pl.concat(tables), tuple(issues))


def _scored(spec: ModelSpec, rows: Sequence[dict], issues: list[Issue]) -> Iterator[pl.DataFrame]:
    """Yield the scores of some campaigns; those that cannot be read or fitted again are added to the issues."""
    for row in rows:
        try:
            yield unit_scores(refitted(spec, UnitSource.of_row(row).read(), row), row["unit"], row["digest"])
        except InputError as error:
            issues.extend(error.issues)


def refitted(spec: ModelSpec, campaign: Campaign, row: dict) -> Fit:
    """Return the fit of a campaign from its row in the table of units.

    Raises
    ------
    InputError
        if the campaign is not the one that was fitted.
    """
    model = bound_to(spec, campaign)
    layouts = model.layout, model.hyper_layout
    means = dict(zip(row["names"], row["mean"], strict=True))
    start = [
        np.array([_start(parameter.z_at(means.get(parameter.name, np.nan))) for parameter in layout.parameters])
        for layout in layouts
    ]
    mode = find_mode(model.problem, *start)
    if not bool(mode.converged):
        raise input_error(
            f"unit {row['unit']}: the optimiser does not find the mode again",
            row["file"],
            "the campaign that was fitted",
            "run the batch again with --retry",
        )
    return Fit(model, np.asarray(mode.z), np.asarray(mode.h), True)


def _start(z: float | None) -> float:
    return z if z is not None and np.isfinite(z) else 0.0
