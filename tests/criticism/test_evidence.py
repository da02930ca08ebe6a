"""The evidence of hypotheses against dense normal distributions, and the search on data drawn from its own model."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg, stats

from imubayes.criticism.evidence.effect_variants import effect_variants, gain_of_coefficients, summed_over_widths
from imubayes.criticism.evidence.free_forms import FormColumns, FormHypothesis, free_forms
from imubayes.criticism.evidence.hypothesis_evidence import EvidenceOf, Hypothesis
from imubayes.criticism.evidence.linear_problem import ChannelRows, LinearProblem
from imubayes.criticism.evidence.model_search import ModelSearch
from imubayes.criticism.evidence.noise_structures import KNOWN, StateNoise, correlated, random_walk
from imubayes.criticism.evidence.posterior_summary import ExplanationPosterior
from imubayes.criticism.evidence.row_correlation import RowCorrelation
from imubayes.criticism.explanation_records import Evidence
from imubayes.inference.fitted_model import Fit
from imubayes.model.noise_covariance import Series
from imubayes.parameters.declarations import Parameter
from imubayes.parameters.priors import Normal
from imubayes.responses.candidate_effects import Coefficient, Response, ShapeScan
from imubayes.responses.residual_covariates import ResidualCovariate
from imubayes.responses.wrong_inputs import Form, WrongInput

RUNS, ROWS = 6, 20
RATE = np.tile(np.linspace(-1.0, 1.0, ROWS), RUNS)
TEMPERATURE = np.repeat(np.linspace(-1.0, 1.0, RUNS), ROWS)
EFFECTS = {
    "scale_asymmetry": np.abs(RATE), "scale_cubic": RATE**3, "bias_temperature": TEMPERATURE,
    "bias_temperature_quadratic": TEMPERATURE**2, "scale_temperature": RATE * TEMPERATURE,
}  # fmt: skip
"""Responses to the largest typical size of each effect, in units of noise times `LARGEST`."""
LARGEST = 8.0
CHANNELS = ("gx", "gy")
SCALE_SD = 0.03
NODES, WEIGHTS = np.polynomial.hermite_e.hermegauss(9)


def coefficient(effect: str, channel: str) -> Coefficient:
    prior = Normal(0.0, 10.0)
    return Coefficient(Parameter(effect, "k", (channel,), "1", 1.0, prior, typical=(0.05, 1.0)), channel, (0.05, 1.0))


def problem(residual: np.ndarray, scatter: tuple[tuple[float, float], ...] = ()) -> LinearProblem:
    """Return a model with bias and scale of two channels that lacks `EFFECTS`; `residual` is (2, RUNS × ROWS)."""
    count = RUNS * ROWS
    own = 2 * len(CHANNELS)
    names = list(itertools.product(EFFECTS, CHANNELS))
    candidates = tuple(
        Response(ShapeScan(effect, {}), tuple(coefficient(effect, c) for c in CHANNELS), np.zeros((2 * count, 2)))
        for effect in EFFECTS
    )
    rows = []
    for k, channel in enumerate(CHANNELS):
        columns = [np.full(count, 3.0), 50 * RATE]
        columns += [LARGEST * EFFECTS[effect] for effect, c in names if c == channel]
        live = [2 * k, 2 * k + 1, *(own + n for n, (_, c) in enumerate(names) if c == channel)]
        rows.append(
            ChannelRows(
                channel, "gyro", np.array(live), np.column_stack([*columns, residual[k]]), np.arange(count) + k * count,
                tuple((n * ROWS, ROWS) for n in range(RUNS)), np.ones(count), RATE, SCALE_SD, scatter,
            )
        )  # fmt: skip
    run = np.tile(np.repeat(np.arange(RUNS), ROWS), 2)
    runs = tuple(f"run{n}" for n in range(RUNS))
    return LinearProblem(candidates, runs, run, np.ones(own), np.zeros(own), np.ones(2 * count), tuple(rows))


def covariates() -> list[ResidualCovariate]:
    return [
        ResidualCovariate("rate_i", "deg/s", np.tile(RATE, 2), "rate"),
        ResidualCovariate("temperature_degC", "degC", np.tile(TEMPERATURE, 2), "temperature"),
    ]


def drawn(seed: int, planted: dict[tuple[str, int], float] | None = None) -> np.ndarray:
    """Return residuals of the model's own parameters from their priors, white noise, and effects of given sizes."""
    random = np.random.default_rng(seed)
    found = random.normal(size=(2, RUNS * ROWS))
    for k in range(2):
        found[k] += 3.0 * random.normal() + 50 * RATE * random.normal()
        for effect, shape in EFFECTS.items():
            found[k] += (planted or {}).get((effect, k), 0.0) * LARGEST * shape
    return found


def searched(residual: np.ndarray, forms: bool = True) -> ModelSearch:
    made = problem(residual)
    return ModelSearch(made).run(free_forms(made, covariates()) if forms else ())


def posterior_of(search: ModelSearch) -> ExplanationPosterior:
    """Return the posterior of a search that belongs to no fit."""
    return ExplanationPosterior(search, object.__new__(Fit))


def evidence_of(search: ModelSearch) -> Evidence:
    return posterior_of(search).evidence


def dense_log_evidence(of: EvidenceOf, hypothesis: Hypothesis) -> float:
    """Return the log evidence by whole covariances, widths summed and scales by quadrature; channels apart."""
    made = of.problem
    widths = [of.variants[n].widths for n in hypothesis.variants]
    parts = []
    for choice in itertools.product(*widths):
        log_p = -sum(math.log(len(each)) for each in widths)
        for k, rows in enumerate(made.rows):
            noise = hypothesis.noise[of.unit_of[k]]
            runs = made.run[rows.entry]
            covariance = np.zeros((len(runs), len(runs)))
            for column, place in zip(rows.columns.T, rows.live, strict=False):
                variance = 1.0 if place < made.own else 0.0
                for n, width in zip(hypothesis.variants, choice, strict=True):
                    variance += width**2 * (int(place) - made.own in of.variants[n].places)
                covariance += variance * np.outer(column, column)
            white = np.eye(len(runs)) + noise.scatter**2 * (runs[:, None] == runs[None, :])
            residual = rows.columns[:, -1]

            each = [
                math.log(w) + stats.multivariate_normal.logpdf(residual, cov=covariance + math.exp(2 * x) * white)
                for x, w in zip(SCALE_SD * NODES, WEIGHTS / WEIGHTS.sum(), strict=True)
            ]
            log_p += float(np.logaddexp.reduce(each))
        parts.append(log_p)
    return float(np.logaddexp.reduce(parts))


@pytest.mark.parametrize("scatter", [0.0, 0.8])
def test_evidence_of_effects_is_that_of_whole_covariances(scatter: float) -> None:
    of = EvidenceOf(problem(drawn(1, {("scale_asymmetry", 0): 0.2}), ((0.0, math.log(0.5)), (0.8, math.log(0.5)))))
    noise = tuple(next(each for each in unit.stated if each.scatter == scatter) for unit in of.units)
    single = [n for n, each in enumerate(of.variants) if each.owners == ("gx",)]
    empty = Hypothesis((), noise)
    reference = dense_log_evidence(of, empty) - of.evaluate(empty).log_evidence
    for variants in [(single[0],), (single[1],), (single[2],)]:
        hypothesis = Hypothesis(variants, noise)
        assert of.evaluate(hypothesis).log_evidence + reference == pytest.approx(
            dense_log_evidence(of, hypothesis), abs=0.02
        )


def test_two_scatters_between_runs_differ_as_whole_covariances_do() -> None:
    of = EvidenceOf(problem(drawn(2), ((0.0, math.log(0.5)), (0.8, math.log(0.5)))))
    found, dense = [], []
    for scatter in (0.0, 0.8):
        noise = tuple(next(each for each in unit.stated if each.scatter == scatter) for unit in of.units)
        found.append(of.evaluate(Hypothesis((), noise)).log_evidence)
        dense.append(dense_log_evidence(of, Hypothesis((), noise)))
    assert found[1] - found[0] == pytest.approx(dense[1] - dense[0], abs=0.02)


@pytest.mark.parametrize("structure", [correlated(0.6, 1.0), correlated(0.9, 0.4), random_walk(0.2)])
def test_a_state_beside_white_noise_whitens_as_its_covariance_does(structure: StateNoise) -> None:
    rows = problem(drawn(3)).rows[0]
    k = np.arange(ROWS)
    if structure.family == "wander":
        own = np.eye(ROWS) + structure.drive * (np.minimum(k[:, None], k) + 1)
    else:
        own = structure.white * np.eye(ROWS) + structure.start * structure.phi ** np.abs(k[:, None] - k)
    white, log_det = structure.whiten(rows, rows.columns)
    inverse = linalg.block_diag(*[np.linalg.inv(own)] * RUNS)
    np.testing.assert_allclose(white.T @ white, rows.columns.T @ inverse @ rows.columns, rtol=1e-9, atol=1e-9)
    assert log_det == pytest.approx(-0.5 * RUNS * np.linalg.slogdet(own)[1])


def of_two_parameters(residual: np.ndarray) -> LinearProblem:
    """Return the same problem in which the first two effects are two parameters of one."""
    made = problem(residual)
    one, other, *rest = made.candidates
    second = [replace(each, parameter=replace(each.parameter, field="m")) for each in other.coefficients]
    both = replace(one, coefficients=(*one.coefficients, *second))
    return replace(made, candidates=(both, *rest))


@pytest.mark.parametrize("make", [problem, of_two_parameters])
def test_variants_share_the_prior_of_their_effect(make) -> None:
    of_effect: dict[str, float] = {}
    for each in effect_variants(made := make(drawn(1))):
        of_effect[each.effect] = of_effect.get(each.effect, 0.0) + math.exp(each.log_odds)
    assert list(of_effect.values()) == pytest.approx([1 / len(made.candidates)] * len(made.candidates))


def test_one_parameter_on_one_channel_is_named_by_itself() -> None:
    search = ModelSearch(of_two_parameters(drawn(3, {("scale_cubic", 1): 0.5}))).run()
    [variant] = search.best().hypothesis.variants
    [place] = search.of.variants[variant].places
    assert (search.of.problem.coefficients[place].parameter.field, search.of.variants[variant].owners) == ("m", ("gy",))


@pytest.mark.parametrize("signed", [False, True])
def test_many_coefficients_have_the_evidence_of_one_solution_for_each_width(signed: bool) -> None:
    """Three effects of some hundred runs, far more than what is diagonalised once for all widths."""
    random, owner = np.random.default_rng(3), np.arange(90) % 3
    design = random.normal(size=(200, 90))
    own, right = design.T @ design, 3 * design.T @ random.normal(size=200)
    sign = random.integers(-1, 2, 90) if signed else np.zeros(90, int)
    grid = tuple(np.geomspace(1e-3, 10, 9).tolist())
    best, total = summed_over_widths(own, right, owner, [grid] * 3, sign, [1.0] * 3)
    expected = []
    for n in range(3):
        widths = np.where(owner == n, np.array(grid)[:, None], np.array(best)[owner])
        expected.append(gain_of_coefficients(own, right, widths, sign))
        assert best[n] == grid[int(np.argmax(expected[n]))]
    means = [float(np.logaddexp.reduce(one)) - np.log(len(grid)) for one in expected]
    assert total == pytest.approx(sum(means) - sum(one.max() for one in expected[1:]), rel=1e-9)


def test_a_missing_effect_is_named_on_its_channel_with_its_coefficient() -> None:
    posterior = posterior_of(searched(drawn(4, {("scale_asymmetry", 1): 0.3})))
    found, [own] = posterior.evidence, posterior.slots
    [slot] = found.slots
    assert found.of("effects").probability > 0.95
    assert slot.candidates[0].effect == "scale_asymmetry"
    assert slot.channels == ("gy",)
    [size] = posterior.coefficients(own.members[0].variant, own.members[0].found)
    assert size.value is not None
    assert size.sd is not None
    assert abs(size.value - 0.3) < 3 * size.sd < 0.2


def test_two_missing_effects_are_named_at_once() -> None:
    found = evidence_of(searched(drawn(5, {("scale_cubic", 0): 0.3, ("bias_temperature_quadratic", 1): 0.2})))
    assert {slot.candidates[0].effect for slot in found.slots} == {"scale_cubic", "bias_temperature_quadratic"}


def test_what_the_catalogue_lacks_is_a_form_of_its_covariate() -> None:
    residual = drawn(6)
    residual[0] += 3.0 * np.sin(12 * RATE)
    found = evidence_of(searched(residual))
    assert found.leading.kind == "outside"
    assert found.form is not None
    assert found.form.covariates == ("rate_i",)
    assert found.form.channels == ("gx",)


def test_without_forms_the_same_would_get_a_wrong_name() -> None:
    """Shows that the test above can fail: the list of forms carries it."""
    residual = drawn(6)
    residual[0] += 3.0 * np.sin(12 * RATE)
    assert evidence_of(searched(residual, forms=False)).leading.kind != "outside"


def wrong_record(form: Form, shape: np.ndarray, most: float) -> FormHypothesis:
    """Return a wrong record to which both channels respond, whose size is `most` at a coefficient of 1."""
    columns = {k: FormColumns(1, lambda: shape[:, None]) for k in range(2)}
    wrong = WrongInput(RUNS - 1, form, "temperature", other=0, apart=(30.0,))
    return FormHypothesis("input", form, (), columns, (64.0,), -5.0, RUNS - 1, None, wrong, most)


def test_a_record_that_cannot_be_so_wrong_leads_no_search() -> None:
    """Columns that two runs exchanged are exchanged as a whole."""
    shape = np.where(TEMPERATURE == 1.0, 1.0, 0.0)
    residual = drawn(41) + 40 * shape
    forms = [wrong_record("exchange", shape, 0.5 / 40), wrong_record("offset", shape + 0.02 * RATE, 1.0)]
    search = ModelSearch(problem(residual)).run(forms)
    best = search.best().hypothesis.form
    assert best is not None
    assert best.form.name == "offset"
    likeliest = max(search.known, key=lambda each: each.log_posterior).hypothesis.form
    assert likeliest is not None
    assert likeliest.form.name == "exchange"


def test_a_record_that_scatter_between_runs_absorbs_is_looked_for_beside_the_least_scatter() -> None:
    shape = np.where(TEMPERATURE == 1.0, 1.0, 0.0)
    made = problem(drawn(42) + 40 * shape, scatter=((0.3, math.log(0.5)), (20.0, math.log(0.5))))
    best = ModelSearch(made).run([wrong_record("offset", shape, 1.0)]).best().hypothesis
    assert best.form is not None
    assert all(noise.scatter == 0.3 for noise in best.noise)


def test_rows_quieter_than_their_samples_lack_nothing() -> None:
    """A vibration averages out within a row; no effect takes noise away."""
    found = evidence_of(searched(0.5 * drawn(7), forms=False))
    assert found.leading.kind == "nothing"
    assert found.leading.probability > 0.8
    [noise] = found.noise
    assert noise.scale < 0.6


def test_noise_of_another_size_is_noise_and_no_effect() -> None:
    found = evidence_of(searched(2.5 * drawn(7)))
    assert found.leading.kind == "noise"
    assert found.of("effects").probability < 0.3
    assert {each.family for each in found.noise} == {"scale"}
    assert [each.scale for each in found.noise] == pytest.approx([2.5], rel=0.2)


def test_correlated_noise_is_noise_and_no_effect() -> None:
    random = np.random.default_rng(8)
    shock = random.normal(size=(2, RUNS, ROWS))
    for k in range(1, ROWS):
        shock[:, :, k] = 0.8 * shock[:, :, k - 1] + 0.6 * shock[:, :, k]
    found = evidence_of(searched(shock.reshape(2, -1)))
    assert found.leading.kind == "noise"
    assert found.of("effects").probability < 0.3
    assert found.noise[0].family in ("correlated", "wander")


@pytest.mark.slow
def test_wrong_effects_have_no_more_odds_than_before_where_nothing_is_missing() -> None:
    """E[posterior odds of a wrong effect | nothing missing] ≤ prior odds, which holds for a right evidence."""
    odds, nothing = [], []
    for seed in range(100, 160):
        search = searched(drawn(seed))
        found = evidence_of(search)
        nothing.append(found.of("nothing").probability)
        of = search.of
        none = of.known[Hypothesis((), of.stated)].log_evidence
        for n in range(len(of.variants)):
            one = of.evaluate(Hypothesis((n,), of.stated)).log_evidence
            odds.append(math.exp(one - none))
    assert np.mean(odds) < 1 + 4 * np.std(odds) / math.sqrt(60)
    assert np.mean(np.array(nothing) < 0.5) <= 0.05


@pytest.mark.slow
def test_inclusion_probabilities_are_calibrated() -> None:
    """Effects are drawn from their prior widths: of statements with probability p a share p is right."""
    told: list[tuple[float, bool]] = []
    names = list(EFFECTS)
    for seed in range(200, 260):
        random = np.random.default_rng(seed)
        planted, effect = {}, names[int(random.integers(len(names)))]
        if random.random() < 0.6:
            width = float(np.exp(random.uniform(math.log(0.05), math.log(0.5))))
            planted = {(effect, k): width * random.normal() for k in range(2)}
        found = evidence_of(searched(drawn(seed, planted)))
        there = {name for name, _ in planted}
        told += [(each.probability, each.effect in there) for each in found.inclusion]
    for low, high in [(0.0, 0.1), (0.1, 0.5), (0.5, 0.9), (0.9, 1.0001)]:
        own = [(p, right) for p, right in told if low <= p < high]
        if len(own) < 5:
            continue
        expected, right = float(np.mean([p for p, _ in own])), sum(right for _, right in own)
        chance = stats.binomtest(right, len(own), min(max(expected, 0.003), 0.997)).pvalue
        assert chance > 0.003, (low, high, right, len(own), expected)


def test_free_forms_are_of_one_kind_and_have_the_prior_of_all() -> None:
    made = problem(drawn(1))
    forms: list[FormHypothesis] = list(free_forms(made, covariates()))
    assert sum(math.exp(each.log_prior) for each in forms) == pytest.approx(0.05)
    assert all(set(each.columns) <= {0, 1} for each in forms)
    assert replace(forms[0], log_prior=0.0).family == forms[0].family
    assert KNOWN.family == "known"


def in_time(correlation: float, factor: float, log_prior: float) -> RowCorrelation:
    """Return AR(1) from row to row of each run of a channel."""
    place = np.arange(RUNS * ROWS)
    first = place % ROWS == 0
    rho = np.where(first, 0.0, correlation)
    series = Series(np.where(first, len(place), place - 1), rho)
    log_variance = np.log1p(-(rho**2))
    return RowCorrelation(factor, log_prior, -0.5 * float(log_variance.sum()), np.exp(-0.5 * log_variance), series)


def autocorrelated(seed: int, correlation: float, sizes: tuple[RowCorrelation, ...]) -> LinearProblem:
    """Return the problem with AR(1) noise, and a model that states it at some sizes."""
    white = np.random.default_rng(seed).normal(size=(2, RUNS, ROWS))
    for k in range(1, ROWS):
        white[:, :, k] = correlation * white[:, :, k - 1] + math.sqrt(1 - correlation**2) * white[:, :, k]
    made = problem(white.reshape(2, -1))
    return replace(made, rows=tuple(replace(rows, correlations=sizes) for rows in made.rows))


def test_correlation_that_the_model_states_is_no_other_noise() -> None:
    sizes = (in_time(0.8, 1.0, math.log(0.5)), in_time(0.2, 0.25, math.log(0.5)))
    made = autocorrelated(8, 0.8, sizes)
    found = evidence_of(ModelSearch(made).run(free_forms(made, covariates())))
    assert found.leading.kind == "nothing"
    assert found.of("effects").probability < 0.3


def test_correlation_in_time_whitens_as_its_covariance_does() -> None:
    made = autocorrelated(9, 0.8, (in_time(0.8, 1.0, 0.0),))
    rows = made.rows[0]
    apart = np.abs(np.subtract.outer(np.arange(ROWS), np.arange(ROWS)))
    own = np.asarray(linalg.block_diag(*[0.8**apart] * RUNS))
    of = EvidenceOf(made)
    gram = of.gram(Hypothesis((), of.stated), 0)
    np.testing.assert_allclose(gram.products, rows.columns.T @ np.linalg.solve(own, rows.columns), rtol=1e-4, atol=0.1)
    assert gram.log_det == pytest.approx(-0.5 * np.linalg.slogdet(own)[1], rel=1e-4)


def test_a_search_is_heard_after_each_hypothesis() -> None:
    """What leads is reported long before the search ends, and is not taken back."""
    counts, told = list[int](), list[str]()

    def heard(search: ModelSearch) -> None:
        counts.append(len(search.known))
        told.extend(each.effect for each in posterior_of(search).inclusion[:1])

    found = ModelSearch(problem(drawn(1, {("scale_asymmetry", 0): 1.0})), heard).run()
    assert counts == sorted(counts)
    assert counts[-1] == len(found.known)
    last = posterior_of(found).inclusion[0].effect
    assert told.index(last) < len(told) / 2
    assert set(told[len(told) // 2 :]) == {last}


@pytest.mark.slow
def test_gross_outliers_of_a_model_with_heavy_tails_are_no_cause() -> None:
    residual = drawn(10)
    residual[0, [7, 50]] = 1e4
    made = problem(residual)
    rows = tuple(replace(each, tails=((4.0, math.log(0.5)), (8.0, math.log(0.5)))) for each in made.rows)
    made = replace(made, rows=rows)
    found = evidence_of(ModelSearch(made).run(free_forms(made, covariates())))
    assert found.of("nothing").probability + found.of("noise").probability > 0.5
