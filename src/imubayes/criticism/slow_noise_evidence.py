"""Evidence for effects of a slow course in records whose model has correlated noise, the noise refitted beside each.

Correlated noise takes a drift up: at the noise that the fit reached without it, the drift is one of the wanderings to
be expected.  Whether the drift explains the record better is told by the likelihood ratio with the noise at its best on
either side,

    T = 2 max_θ ℓ(θ; effect) − 2 max_θ ℓ(θ),

ℓ the restricted log likelihood of a channel, its scale at its best, θ the shape of the noise.  It ranges over more than
the model has, since one family of noise passes a wandering of another on to the effect: white noise with Gauss–Markov
noise, or with flicker noise and random walk (IEEE Std 952, where a ramp is a term beside these).  The law of the
smallest p-value of all candidates without an effect is simulated with the noise fitted to the record without one
(parametric bootstrap): a random walk makes large T likelier than chi-square does.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.criticism import thresholds
from imubayes.criticism.multiple_testing import LookElsewhere
from imubayes.criticism.slow_noise_records import SlowRecords
from imubayes.tail_probabilities import chi2_survival


@dataclass(frozen=True)
class SlowEvidence:
    """Evidence for the candidates in records with correlated noise.

    Attributes
    ----------
    p : p-value of each candidate alone by chi-square, by its place; only of those that act in such records.
    corrected : of the smallest one.
    """

    p: dict[int, float]
    corrected: float


def slow_noise_evidence(
    records: Mapping[int, SlowRecords], columns: Sequence[np.ndarray], seed: int = 0
) -> SlowEvidence | None:
    """Return the evidence for candidates in records with correlated noise; None where none acts there.

    Parameters
    ----------
    records : of each channel, by its place.
    columns : responses to each candidate, (E, C).
    seed : of the simulated noise.
    """
    random = np.random.default_rng(seed)
    ratios, dof = np.zeros((len(columns), 1 + thresholds.SLOW_DRAWS)), np.zeros(len(columns))
    for own in records.values():
        directions = [own.directions(each) for each in columns]
        ratios += _likelihood_ratios(own, directions, random)
        dof += [each.shape[1] for each in directions]
    acting = np.flatnonzero(dof)
    if not len(acting):
        return None
    p = chi2_survival(ratios[acting], dof[acting, None])
    smallest = p.min(axis=0)
    corrected = LookElsewhere(np.sort(smallest[1:]), 0.0)(float(smallest[0]))
    return SlowEvidence(dict(zip(acting.tolist(), p[:, 0].tolist(), strict=True)), corrected)


def _likelihood_ratios(
    records: SlowRecords, directions: Sequence[np.ndarray], random: np.random.Generator
) -> np.ndarray:
    """Return T of each effect in one channel, of the record and of simulated ones without effect, (effects, 1 + draws).

    Parameters
    ----------
    directions : of each effect, (N, d).
    """
    draws = records.split(random.normal(size=(len(records.misfit), thresholds.SLOW_DRAWS)))
    simulated = np.concatenate([lower @ own for lower, own in zip(records.likeliest(), draws, strict=True)])
    columns = np.concatenate([records.misfit[:, None], simulated], axis=1)
    without = np.full(columns.shape[1], -np.inf)
    # Many effects have the same course in a record at rest.
    keys = [np.round(np.abs(each), 6).tobytes() for each in directions]
    unique = {key: each for key, each in zip(keys, directions, strict=True) if each.shape[1]}
    best = dict.fromkeys(unique, without)
    for noise in records.noises():
        left = noise.left(columns)
        square = np.sum(left**2, axis=0)
        without = np.maximum(without, noise.log_likelihood(square))
        for key, each in unique.items():
            span, _ = np.linalg.qr(noise.left(each))
            explained = np.sum((span.T @ left) ** 2, axis=0)
            best[key] = np.maximum(best[key], noise.log_likelihood(square - explained))
    nothing = np.zeros(columns.shape[1])
    return np.array([2 * (best[key] - without) if key in best else nothing for key in keys])
