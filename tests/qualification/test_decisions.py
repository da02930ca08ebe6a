"""Marginals, digits, decision rules and risks against published values and closed forms."""

import math

import numpy as np
import pytest
from scipy import stats

from imubayes.results.marginal import Marginal, last_digit, numerical_tolerance
from imubayes_qualification.evaluation.decision_rules import (
    ACCEPTED,
    DecisionRule,
    MeasuredValue,
    Production,
    ToleranceInterval,
    acceptance_interval,
    compared,
    conformance_probability,
    decide,
    global_risks,
    guard_for_risk,
)
from imubayes_qualification.evaluation.fitted_marginal import FittedMarginal, fitted_to
from imubayes_qualification.evaluation.stated_digits import digits_deserved


def marginal_of(law, size: int = 20_000) -> Marginal:
    return Marginal(law.rvs(size, random_state=np.random.default_rng(5)), float(size))


def estimate_of(value: float, u: float, conformance: float = 0.9) -> MeasuredValue:
    return MeasuredValue(value, u, 2 * u, compared(conformance, conformance, 1e-3))


# JCGM 106, 7.3.2: breakdown voltage of a Zener diode, V ≤ −5.40 V, estimate −5.47 V, u = 0.05 V: p_c = 0.92.
def test_zener_diode_of_jcgm_106():
    found = conformance_probability(marginal_of(stats.norm(-5.47, 0.05), 100_000), ToleranceInterval(upper=-5.40))
    assert f"{found.from_quadrature:.2f}" == "0.92"
    assert found.value == pytest.approx(stats.norm.cdf(1.4), abs=4 * found.monte_carlo_error)


# JCGM 101, 9.2.2: the sum of four rectangular quantities of unit sd is within ± 3.88 with 95 %; of normal ones ± 3.92.
def test_sum_of_four_rectangular_quantities():
    root = math.sqrt(3)
    # Scrambled Sobol points: the published digits stand at a hundredth of the error of as many random draws.
    rectangular = (root * (2 * stats.qmc.Sobol(4, seed=1).random(2**18) - 1)).sum(axis=1)
    marginal = Marginal(rectangular, float(len(rectangular)))
    assert [f"{abs(end):.2f}" for end in marginal.interval] == ["3.88", "3.88"]
    assert f"{marginal.sd:.2f}" == "2.00"
    assert fitted_to(np.sort(rectangular)).probability(-3.88, 3.88) == pytest.approx(0.95, abs=0.003)
    normal = Marginal(stats.norm(0, 2).ppf((np.arange(100_000) + 0.5) / 100_000), 100_000.0)
    assert [f"{abs(end):.2f}" for end in normal.interval] == ["3.92", "3.92"]


# JCGM 101, 7.9.2: u = 0.000 35 g to two digits is 35 × 10⁻⁵ g, δ = 0.000 005 g; u = 2 K to one digit, δ = 0.5 K.
@pytest.mark.parametrize(
    ("u", "digits", "power", "tolerance"),
    [(0.00035, 2, -5, 5e-6), (2.0, 1, 0, 0.5), (0.0996, 2, -2, 5e-3), (0.99, 1, 0, 0.5), (1234.0, 2, 2, 50.0)],
)
def test_numerical_tolerance_of_jcgm_101(u, digits, power, tolerance):
    assert last_digit(u, digits) == power
    assert numerical_tolerance(u, digits) == pytest.approx(tolerance)


def digits_of(marginal: Marginal) -> int:
    return digits_deserved(marginal.errors, marginal.sd).digits


def test_digits_follow_the_number_of_draws():
    by_size = {
        size: digits_of(Marginal(np.random.default_rng(1).normal(5.0, 0.3, size), size))
        for size in (200, 4000, 400_000)
    }
    assert by_size == {200: 0, 4000: 1, 400_000: 2}


def test_dependent_draws_deserve_fewer_digits():
    draws = np.random.default_rng(1).normal(5.0, 0.3, 400_000)
    assert digits_of(Marginal(draws, 4000.0)) == 1


def test_monte_carlo_errors_are_those_of_repetition():
    marginals = [Marginal(np.random.default_rng(seed).standard_t(6, 2000), 2000.0) for seed in range(400)]
    statistics = {
        "mean": [m.mean for m in marginals],
        "sd": [m.sd for m in marginals],
        "low": [m.interval[0] for m in marginals],
        "high": [m.interval[1] for m in marginals],
    }
    for name, values in statistics.items():
        stated = np.mean([getattr(m.errors, name) for m in marginals])
        assert stated == pytest.approx(np.std(values), rel=0.15), name


# ILAC-G8:09/2019, table 1: risk of false acceptance at the acceptance limit for guard bands of r·U, U = 2 u.
@pytest.mark.parametrize(("factor", "risk"), [(1.65, 0.05), (2.0, 0.025), (3.0, 0.0016), (0.0, 0.5)])
def test_guard_bands_of_ilac_g8(factor, risk):
    u, upper = 0.3, 10.0
    at_limit = marginal_of(stats.norm(upper - factor * u, u), 100_000)
    found = conformance_probability(at_limit, ToleranceInterval(upper=upper))
    assert 1 - found.from_quadrature <= risk + 3 * found.monte_carlo_error
    assert 1 - found.from_quadrature >= 0.75 * risk
    rule = DecisionRule("guard_band", guard_factor=factor) if factor else DecisionRule("simple_acceptance")
    inside, beyond = (estimate_of(upper - factor * u + step, u) for step in (-1e-9, 1e-9))
    assert decide(rule, inside, ToleranceInterval(upper=upper)).outcome == "pass"
    assert decide(rule, beyond, ToleranceInterval(upper=upper)).outcome == "fail"


@pytest.mark.parametrize(
    ("value", "outcome"), [(0.0, "pass"), (0.9, "conditional_pass"), (-1.1, "conditional_fail"), (1.3, "fail")]
)
def test_non_binary_rule(value, outcome):
    decision = decide(DecisionRule("ilac_g8_non_binary"), estimate_of(value, 0.1), ToleranceInterval(-1, 1))
    assert (decision.outcome, decision.guard_band) == (outcome, pytest.approx(0.2))


@pytest.mark.parametrize(
    ("rule", "conformance", "outcome"),
    [
        (DecisionRule("conformance_probability", probability=0.95), 0.951, "pass"),
        (DecisionRule("conformance_probability", probability=0.95), 0.949, "fail"),
        (DecisionRule("specific_risk", probability=0.01), 0.991, "pass"),
        (DecisionRule("specific_risk", probability=0.01), 0.989, "fail"),
    ],
)
def test_rules_on_probabilities(rule, conformance, outcome):
    assert decide(rule, estimate_of(0.0, 0.1, conformance), ToleranceInterval(-1, 1)).outcome == outcome


def test_own_guard_band_is_a_width():
    rule = DecisionRule("guard_band", guard_width=0.5)
    assert decide(rule, estimate_of(0.45, 0.3), ToleranceInterval(-1, 1)).outcome == "pass"
    assert decide(rule, estimate_of(0.55, 0.3), ToleranceInterval(-1, 1)).outcome == "fail"


@pytest.mark.parametrize(
    "law",
    [
        stats.norm(3, 0.2),
        stats.gamma(4, scale=0.3),
        stats.t(5),
        stats.uniform(-1, 2),
        stats.foldnorm(0.5),
        stats.rayleigh(),
    ],
    ids=["normal", "gamma", "t5", "uniform", "folded", "rayleigh"],
)
@pytest.mark.parametrize("probability", [0.05, 0.5, 0.95])
def test_the_two_methods_agree(law, probability):
    found = conformance_probability(marginal_of(law), ToleranceInterval(upper=float(law.ppf(probability))))
    assert found.withheld is None
    assert found.value == pytest.approx(probability, abs=4 * found.monte_carlo_error)


def test_quadrature_is_exact_for_a_known_marginal():
    law = FittedMarginal(2.0, 0.5, 0.7, 1.4)
    for lower, upper in ((-math.inf, 3.0), (2.2, math.inf), (2.0, 2.5), (-math.inf, math.inf)):
        ends = [
            math.sinh(1.4 * math.asinh((end - 2) / 0.5) - 0.7) if math.isfinite(end) else end for end in (lower, upper)
        ]
        exact = stats.norm.cdf(ends[1]) - stats.norm.cdf(ends[0])
        assert law.probability(lower, upper) == pytest.approx(exact, abs=1e-9)


def test_a_disagreement_withholds_the_number():
    """Planted fault: two separate modes, which no smooth marginal of four numbers follows."""
    random = np.random.default_rng(3)
    draws = np.concatenate([random.normal(-3, 0.1, 14_000), random.normal(3, 0.1, 6_000)])
    found = conformance_probability(Marginal(draws, 20_000.0), ToleranceInterval(upper=0.0))
    assert (found.withheld, found.value) == ("disagreement", None)
    rule = DecisionRule("conformance_probability", probability=0.5)
    assert decide(rule, MeasuredValue(0.0, 1.0, 2.0, found), ToleranceInterval(upper=0.0)).outcome == "withheld"


def test_few_draws_withhold_the_number():
    draws = np.random.default_rng(3).normal(size=5000)
    assert conformance_probability(Marginal(draws, 150.0), ToleranceInterval(upper=0.0)).withheld == "too_few_draws"


@pytest.mark.parametrize("guard", [0.0, 0.3, 0.825])
@pytest.mark.parametrize("tolerance", [ToleranceInterval(-2, 2), ToleranceInterval(upper=1.5)])
def test_global_risks_by_two_methods(guard, tolerance):
    found = global_risks(Production(0.2, 1.0), 0.5, tolerance, tolerance.guarded(guard))
    for risk in (found.consumer, found.producer):
        assert risk.withheld is None
        assert risk.from_quadrature == pytest.approx(risk.from_draws, abs=4 * risk.monte_carlo_error)
    # The two normals as one bivariate distribution: an independent way to the same number.
    pair = stats.multivariate_normal([0.2, 0.2], [[1.0, 1.0], [1.0, 1.25]])
    limits = np.array([[tolerance.lower, tolerance.upper], [tolerance.lower + guard, tolerance.upper - guard]])
    low, high = np.maximum(limits[:, 0], -30), np.minimum(limits[:, 1], 30)
    both = pair.cdf(high, lower_limit=low)
    accepted = stats.norm(0.2, math.sqrt(1.25)).cdf(high[1]) - stats.norm(0.2, math.sqrt(1.25)).cdf(low[1])
    conform = stats.norm(0.2, 1.0).cdf(high[0]) - stats.norm(0.2, 1.0).cdf(low[0])
    assert found.consumer.from_quadrature == pytest.approx(accepted - both, abs=2e-5)
    assert found.producer.from_quadrature == pytest.approx(conform - both, abs=2e-5)


def test_guard_band_for_a_global_risk():
    production, tolerance = Production(0.0, 1.0), ToleranceInterval(-2, 2)
    guard = guard_for_risk(production, 0.5, tolerance, 0.005)
    assert guard is not None
    accepted = tolerance.guarded(guard)
    assert global_risks(production, 0.5, tolerance, accepted).consumer.from_quadrature == pytest.approx(0.005, rel=1e-3)
    assert guard_for_risk(production, 1e-6, tolerance, 0.01) == 0.0
    assert guard_for_risk(Production(9.0, 1.0), 3.0, ToleranceInterval(-2, 2), 1e-30) is None


RULES = {
    "conditional": DecisionRule("ilac_g8_non_binary"),
    "conformance": DecisionRule("conformance_probability", probability=0.5),
    "strict": DecisionRule("conformance_probability", probability=0.99),
    "specific": DecisionRule("specific_risk", probability=0.05),
    "factor": DecisionRule("guard_band", guard_factor=1.65),
    "simple": DecisionRule("simple_acceptance"),
}


@pytest.mark.parametrize(
    "tolerance", [ToleranceInterval(-160, 160), ToleranceInterval(upper=150), ToleranceInterval(-4, 4)]
)
@pytest.mark.parametrize("name", RULES)
def test_global_risks_are_those_of_the_rule_as_it_is_applied(name, tolerance):
    """By an integral over the estimates that the rule itself delivers a unit with, conditional passes among them."""
    rule, u, production = RULES[name], 3.0, Production(0.0, 100.0)
    width = 0.05
    y = np.arange(-600, 600, width) + width / 2
    inside = stats.norm(y, u).cdf(tolerance.upper) - stats.norm(y, u).cdf(tolerance.lower)
    values = [
        MeasuredValue(a, u, 1.96 * u, compared(p, p, 1e-9)) for a, p in zip(y.tolist(), inside.tolist(), strict=True)
    ]
    taken = np.array([decide(rule, value, tolerance).outcome in ACCEPTED for value in values])
    # Given y the true value is normal about y·s²/(s² + u²).
    share = production.sd**2 / (production.sd**2 + u**2)
    true = stats.norm(y * share, u * math.sqrt(share))
    conform = true.cdf(tolerance.upper) - true.cdf(tolerance.lower)
    density = stats.norm(0.0, math.hypot(production.sd, u)).pdf(y) * width
    accepted = acceptance_interval(rule, u, tolerance, decide(rule, values[0], tolerance))
    assert (accepted is None) == (not taken.any())
    found = global_risks(production, u, tolerance, accepted)
    assert found.consumer.from_quadrature == pytest.approx(float(density @ (taken * (1 - conform))), rel=0.03, abs=1e-8)
    assert found.producer.from_quadrature == pytest.approx(float(density @ (~taken * conform)), rel=0.03, abs=1e-7)
    assert found.consumer.withheld is None
