"""Which terms are called determined: none that the record does not hold, those that it holds clearly; open cases."""

import numpy as np
import pytest
import static_record as generator

from imubayes_recordings.noise_analysis.cosine_spectra import cosine_statistics
from imubayes_recordings.noise_analysis.likelihood import Maximum, NoiseLikelihood
from imubayes_recordings.noise_analysis.noise_terms import NoiseTerm
from imubayes_recordings.noise_analysis.running_sum import from_samples
from imubayes_recordings.noise_analysis.term_estimates import (
    BASIC,
    LEAST_EVIDENCE,
    TermEvidence,
    highest,
    term_evidence,
)

WALK, FLICKER, QUANTISATION = NoiseTerm.RANDOM_WALK, NoiseTerm.FLICKER, NoiseTerm.QUANTISATION
FAINT_WALK = {"white": 1.0, "random_walk": 5e-3}
RECORDS = 30


def likelihood_of(terms: dict[str, float], seed: list[int], samples: int = 4096) -> NoiseLikelihood:
    x = generator.noise(terms, samples, 1.0, np.random.default_rng(seed))
    return NoiseLikelihood(cosine_statistics(from_samples(x, 1.0)))


def dropped_one_by_one(likelihood: NoiseLikelihood) -> tuple[NoiseTerm, ...]:
    """The planted fault: backward elimination, the least significant term first."""
    best: Maximum = highest(likelihood, BASIC)
    while len(best.terms) > 1:
        smaller = [highest(likelihood, tuple(t for t in best.terms if t is not term)) for term in best.terms]
        nearest = max(smaller, key=lambda maximum: maximum.log_likelihood)
        if 2 * (best.log_likelihood - nearest.log_likelihood) > LEAST_EVIDENCE:
            break
        best = nearest
    return best.terms


@pytest.fixture(scope="module")
def faint_walks() -> list[NoiseLikelihood]:
    """Records of white noise and random walk that no slope of the Allan deviation distinguishes from flicker noise."""
    return [likelihood_of(FAINT_WALK, [41, number]) for number in range(RECORDS)]


@pytest.fixture(scope="module")
def seen(faint_walks: list[NoiseLikelihood]) -> list[TermEvidence]:
    return [term_evidence(likelihood) for likelihood in faint_walks]


@pytest.mark.slow
def test_a_random_walk_is_not_called_flicker_noise(seen: list[TermEvidence]):
    """At 2 % of the records there are three or more in 2 % of such tests."""
    for term in (FLICKER, QUANTISATION, NoiseTerm.MARKOV):
        assert sum(term in found.determined for found in seen) <= 2


def test_dropping_terms_one_by_one_would_call_it_so(faint_walks: list[NoiseLikelihood]):
    """The planted fault of the test above."""
    assert sum(FLICKER in dropped_one_by_one(likelihood) for likelihood in faint_walks) >= 4


def test_what_the_record_needs_without_telling_which_is_named(seen: list[TermEvidence]):
    """Half of these records wander visibly; the walk is among the names unless another slow term is determined."""
    named = [found.undecided for found in seen if found.undecided]
    assert len(named) >= RECORDS / 3
    assert sum(WALK in terms for terms in named) >= 0.8 * len(named)
    for found in seen:
        assert not set(found.undecided) & set(found.determined)


def test_white_noise_alone_needs_nothing():
    found = [term_evidence(likelihood_of({"white": 1.0}, [42, number])) for number in range(10)]
    assert sum(bool(each.undecided) for each in found) <= 1
    assert sum(len(each.determined) - 1 for each in found) <= 1


@pytest.mark.parametrize(
    ("terms", "expected"),
    [
        ({"white": 1.0, "random_walk": 0.1}, {WALK}),
        ({"white": 1.0, "flicker": 0.7}, {FLICKER}),
        ({"white": 1.0, "quantisation": 1.0}, {QUANTISATION}),
    ],
)
def test_terms_of_a_clear_size_are_found(terms: dict[str, float], expected: set[NoiseTerm]):
    found = [set(term_evidence(likelihood_of(terms, [43, number])).determined) for number in range(5)]
    assert sum(expected | {NoiseTerm.WHITE} == each for each in found) >= 4


def test_gauss_markov_noise_is_named_where_it_could_be_flicker_noise():
    """A short record of clear flicker noise: a process of a well chosen correlation time follows it."""
    seen = [term_evidence(likelihood_of({"white": 1.0, "flicker": 0.3}, [44, number])) for number in range(4)]
    assert any(found.alternatives == ((FLICKER, NoiseTerm.MARKOV),) for found in seen)
    assert all(found.alternatives == () for found in seen if FLICKER not in found.determined)


@pytest.mark.parametrize("number", [23, *range(3)])
def test_more_terms_never_describe_a_record_worse(number: int):
    """The first record has a start from which a step, cut short, leads downhill: the search once ended there."""
    likelihood = likelihood_of({"white": 1.0, "flicker": 0.2}, [12, number, sum(map(ord, "w+fl"))])
    full = likelihood.maximise(BASIC, likelihood.start(BASIC))
    assert full.converged
    for term in BASIC:
        terms = tuple(other for other in BASIC if other is not term)
        fewer = likelihood.maximise(terms, likelihood.start(terms))
        assert full.log_likelihood > fewer.log_likelihood - 1e-3
