"""Published examples of the GUM and its supplements through the public functions; values as printed there."""

import inspect
import math

import numpy as np
import pytest
from scipy import stats

import imubayes
from imubayes import InputQuantity
from imubayes.foundations.errors import InputError

normal, between = InputQuantity.normal, InputQuantity.between
ROOT = math.sqrt(3)
PAIR = [normal("a", 10, 1), normal("b", 20, 1)]


def of_sum(**inputs: np.ndarray) -> np.ndarray:
    return sum(inputs.values(), np.zeros(1))


# JCGM 101, 9.2: the sum of four quantities.
@pytest.mark.parametrize(
    ("inputs", "u", "end", "gum_end"),
    [
        ([normal(f"x{k}", 0, 1) for k in range(4)], 2.0, 3.92, 3.92),
        ([between(f"x{k}", -ROOT, ROOT) for k in range(4)], 2.0, 3.88, 3.92),
        ([*(between(f"x{k}", -ROOT, ROOT) for k in range(3)), between("x3", -10 * ROOT, 10 * ROOT)], 10.1, 17.0, 19.9),
    ],
)
def test_additive_model_of_jcgm_101(inputs, u, end, gum_end):
    found = imubayes.propagate(of_sum, inputs, digits=2)
    assert found.stable
    tolerance = found.outputs[0].tolerance
    assert found.value == pytest.approx(0.0, abs=tolerance)
    assert found.uncertainty == pytest.approx(u, abs=tolerance)
    for ends in (found.interval, found.shortest):
        assert np.abs(ends) == pytest.approx([end, end], abs=2 * tolerance)
    assert found.gum.uncertainty == pytest.approx(u, rel=5e-3)
    assert found.gum.expanded_uncertainty == pytest.approx(gum_end, abs=0.1 if gum_end > 10 else 5e-3)
    assert found.outputs[0].gum_agrees == (abs(end - gum_end) <= tolerance)


# JCGM 101, 9.3: mass calibration; δm in mg, R = rectangular over the density of air and of the weights.
def test_mass_calibration_of_jcgm_101():
    def equation(m_rc, dm_rc, rho_a, rho_w, rho_r):
        mass = (m_rc + dm_rc) * (1 + (rho_a - 1.2) * (1 / rho_w - 1 / rho_r))
        return mass - 100_000.0

    found = imubayes.propagate(
        equation,
        [
            normal("m_rc", 100_000.0, 0.05), normal("dm_rc", 1.234, 0.02), between("rho_a", 1.1, 1.3),
            between("rho_w", 7000, 9000), between("rho_r", 7950, 8050),
        ],
    )  # fmt: skip
    assert found.stable
    assert found.value == pytest.approx(1.2340, abs=5e-4)
    assert found.uncertainty == pytest.approx(0.0754, abs=1e-3)
    assert found.shortest == pytest.approx((1.0834, 1.3825), abs=2e-3)
    # The law of propagation sees none of the product of two rectangular deviations; its second order does.
    assert found.gum.second_order_uncertainty == pytest.approx(0.0750, abs=5e-5)
    assert round(found.gum.uncertainty, 4) == 0.0539
    assert not found.outputs[0].gum_agrees
    assert found.gum.value - found.gum.expanded_uncertainty == pytest.approx(1.1285, abs=2e-4)


# JCGM 101, 9.4: comparison loss in microwave power meter calibration, sd 0.005; y in 1e-6.
@pytest.mark.parametrize(
    ("x1", "r", "mean", "u", "shortest"),
    [
        (0.0, 0.0, 50, 50, (0, 150)),
        (0.010, 0.0, 150, 112, (0, 367)),
        (0.050, 0.0, 2551, 502, (1590, 3543)),
        (0.0, 0.9, 50, 67, (0, 185)),
        (0.010, 0.9, 150, 121, (13, 398)),
        (0.050, 0.9, 2551, 504, (1628, 3555)),
    ],
)
def test_comparison_loss_of_jcgm_101(x1, r, mean, u, shortest):
    inputs = [normal("a", x1, 0.005), normal("b", 0.0, 0.005)]
    found = imubayes.propagate(lambda a, b: 1e6 * (a**2 + b**2), inputs, correlation={("a", "b"): r}, digits=2)
    assert found.value == pytest.approx(mean, abs=1.0 if u < 500 else 5)
    assert found.uncertainty == pytest.approx(u, rel=0.012)
    assert found.shortest == pytest.approx(shortest, abs=0.03 * u)
    # The equation has no slope at zero: the law of propagation says that it is known exactly.
    assert found.gum.uncertainty == pytest.approx(2e6 * x1 * 0.005, abs=1e-3)


# GUM H.1 and JCGM 101, 9.5: gauge block, lengths in nm, temperatures in °C; θ = θ_0 + Δ.
def gauge_block(inexact: float) -> imubayes.Propagated:
    nominal = 50e6

    def equation(l_s, d_0, d_1, d_2, a_s, theta_0, swing, d_a, d_theta):
        return l_s + d_0 + d_1 + d_2 - l_s * (d_a * (theta_0 + swing) + a_s * d_theta) - nominal

    return imubayes.propagate(
        equation,
        [
            normal("l_s", nominal + 623, 25, 18), normal("d_0", 215, 5.8, 24, "A"), normal("d_1", 0, 3.9, 5),
            normal("d_2", 0, 6.7, 8), between("a_s", 9.5e-6, 13.5e-6), normal("theta_0", -0.1, 0.2),
            between("swing", -0.5, 0.5, "arcsine"),
            between("d_a", -1e-6, 1e-6, inexact=0.1e-6 * inexact, degrees_of_freedom=50),
            between("d_theta", -0.050, 0.050, inexact=0.025 * inexact, degrees_of_freedom=2),
        ],
        probability=0.99,
    )  # fmt: skip


def test_gauge_block_of_gum_h1_and_jcgm_101():
    """Limits that are not known exactly are degrees of freedom to the GUM, and a wider distribution to JCGM 101."""
    found = gauge_block(0.0)
    # GUM H.1.6: u_c = 32 nm, ν_eff = 16, U_99 = 2.92 · 32 nm = 93 nm; with the terms of second order 34 nm.
    assert found.gum.value == pytest.approx(838, abs=1)
    assert round(found.gum.uncertainty) == 32
    assert int(found.gum.degrees_of_freedom) == 16
    assert found.gum.coverage_factor == pytest.approx(2.92, abs=0.005)
    assert found.gum.expanded_uncertainty == pytest.approx(93, abs=1)
    assert found.gum.second_order_uncertainty == pytest.approx(34, abs=0.5)
    lines = {line.input: line for line in found.gum.lines}
    assert lines["d_theta"].contribution == pytest.approx(16.6, rel=0.06)
    assert (lines["a_s"].contribution, lines["d_0"].type) == (0.0, "A")
    found = gauge_block(1.0)
    assert found.stable
    # JCGM 101, table 9: 838 nm, 36 nm, [745, 932] nm at 99 %.
    assert found.value == pytest.approx(838, abs=1)
    assert found.uncertainty == pytest.approx(36, abs=1)
    assert found.shortest == pytest.approx((745, 932), abs=4)


# GUM H.2: resistance and reactance of one element from simultaneous readings of V, I and φ.
def test_impedance_of_gum_h2():
    volt = [5.007, 4.994, 5.005, 4.990, 4.999]
    ampere = np.array([19.663, 19.639, 19.640, 19.685, 19.678]) * 1e-3
    phase = [1.0456, 1.0438, 1.0468, 1.0428, 1.0433]
    values = np.array([volt, ampere, phase])
    mean, covariance = values.mean(axis=1), np.cov(values) / 5
    u = np.sqrt(np.diag(covariance))
    r = covariance / np.outer(u, u)
    inputs = [normal(name, m, s, type="A") for name, m, s in zip(("v", "i", "p"), mean, u, strict=True)]
    pairs = {("v", "i"): float(r[0, 1]), ("v", "p"): float(r[0, 2]), ("i", "p"): float(r[1, 2])}
    assert [round(each, 2) for each in pairs.values()] == [-0.36, 0.86, -0.65]
    found = imubayes.propagate(
        lambda v, i, p: (v / i * np.cos(p), v / i * np.sin(p), v / i), inputs, names=("R", "X", "Z"), correlation=pairs
    )
    budgets = {each.name: each.gum for each in found.outputs}
    printed = {"R": (127.732, 0.071), "X": (219.847, 0.295), "Z": (254.260, 0.236)}
    for name, digits in printed.items():
        assert (budgets[name].value, budgets[name].uncertainty) == pytest.approx(digits, abs=1e-3)
    for name, each in budgets.items():
        assert found[name].value == pytest.approx(each.value, abs=0.01)
        assert found[name].uncertainty == pytest.approx(each.uncertainty, rel=0.02)
    correlation = found.correlation
    assert (correlation[0, 1], correlation[0, 2], correlation[1, 2]) == pytest.approx((-0.588, -0.485, 0.993), abs=0.01)


# GUM H.3: calibration of a thermometer, a straight line through eleven corrections.
def test_thermometer_of_gum_h3():
    t = np.array([21.521, 22.012, 22.512, 23.003, 23.507, 23.999, 24.513, 25.002, 25.503, 26.010, 26.511]) - 20
    b = np.array([-0.171, -0.169, -0.166, -0.159, -0.164, -0.165, -0.156, -0.157, -0.159, -0.161, -0.160])
    line = np.linalg.pinv(np.stack([np.ones_like(t), t], axis=1))
    s = math.sqrt(np.sum((b - np.stack([np.ones_like(t), t], axis=1) @ (line @ b)) ** 2) / 9)

    def equation(**read):
        y1, y2 = line @ np.stack(list(read.values()))
        return y1, y2, y1 + 10 * y2

    inputs = [normal(f"b{k}", value, s, type="A") for k, value in enumerate(b)]
    found = imubayes.propagate(equation, inputs, names=("y1", "y2", "b30"))
    said = [(round(each.gum.value, 5), round(each.gum.uncertainty, 5)) for each in found.outputs]
    assert said[0] == pytest.approx((-0.1712, 0.0029), abs=5e-5)
    assert said[1] == pytest.approx((0.00218, 0.00067), abs=5e-6)
    assert said[2] == pytest.approx((-0.1494, 0.0041), abs=5e-5)
    assert found.correlation[0, 1] == pytest.approx(-0.930, abs=2e-3)
    for each in found.outputs:
        assert each.uncertainty == pytest.approx(each.gum.uncertainty, rel=0.02)


def bivariate(shared: float, shape: str) -> imubayes.Propagated:
    third = normal("c", 0, shared) if shape == "normal" else between("c", -ROOT * shared, ROOT * shared)
    inputs = [normal("a", 0, 1), normal("b", 0, 1), third]
    return imubayes.propagate(lambda a, b, c: (a + c, b + c), inputs, names=("y1", "y2"), digits=2)


# JCGM 102, 9.2: additive bivariate model, Y1 = X1 + X3, Y2 = X2 + X3.
@pytest.mark.parametrize("shared", [0.1, 3.0])
def test_bivariate_model_of_jcgm_102(shared):
    found = bivariate(shared, "normal")
    r = shared**2 / (1 + shared**2)
    assert found.correlation[0, 1] == pytest.approx(r, abs=0.01)
    # χ² of two degrees of freedom: k_p = 2.45 for any normal pair; k_q by the bivariate normal distribution.
    assert found.ellipsoid_factor == pytest.approx(2.448, abs=0.01)
    law = stats.multivariate_normal([0, 0], [[1, r], [r, 1]])
    k = found.box_factor
    assert law.cdf([k, k], lower_limit=[-k, -k]) == pytest.approx(0.95, abs=0.002)
    assert found.outputs[0].uncertainty == pytest.approx(math.hypot(1, shared), rel=0.01)
    # A rectangular shared input makes the pair lie in a band: its ellipsoid is smaller.
    if shared > 1:
        assert bivariate(shared, "rectangular").ellipsoid_factor < 2.40


def test_draws_of_a_fit_keep_their_correlation():
    random = np.random.default_rng(1)
    pair = random.multivariate_normal([1.0, 2.0], [[1.0, -0.8], [-0.8, 1.0]], 20_000)
    inputs = [InputQuantity.from_draws("a", pair[:, 0]), InputQuantity.from_draws("b", pair[:, 1])]
    found = imubayes.propagate(lambda a, b: a + b, inputs)
    assert found.uncertainty == pytest.approx(math.sqrt(0.4), rel=0.02)
    assert found.gum.uncertainty == pytest.approx(math.sqrt(0.4), rel=0.02)


def test_readings_are_of_type_a_with_their_degrees_of_freedom():
    values = np.array([5.007, 4.994, 5.005, 4.990, 4.999])
    found = imubayes.propagate(lambda v: 2 * v, [InputQuantity.readings("v", values.tolist())], digits=1)
    u = values.std(ddof=1) / math.sqrt(5)
    (line,) = found.gum.lines
    assert (line.type, line.degrees_of_freedom, line.uncertainty) == ("A", 4.0, pytest.approx(u))
    assert found.gum.coverage_factor == pytest.approx(stats.t(4).ppf(0.975))
    low, high = found.interval
    assert (high - low) / 2 == pytest.approx(2 * u * stats.t(4).ppf(0.975), rel=0.03)
    assert found.uncertainty == pytest.approx(2 * u * math.sqrt(2), rel=0.06)
    assert "Budget of y" in str(found)
    assert repr(found).startswith("<Propagated y = 9.99")


def decided(**arguments) -> imubayes.ConformityStatement:
    return imubayes.conformity((0.0, 1.0), **{"upper": 3.0, **arguments})


@pytest.mark.parametrize(
    ("made", "what"),
    [
        (lambda: normal("x", math.nan, 1), "estimate nan"),
        (lambda: normal("x", 1, -1), "uncertainty -1"),
        (lambda: between("x", 2, 1), "limits 2 … 1"),
        (lambda: between("x", 0, 1, "triangular", inexact=0.1), "known to"),
        (lambda: InputQuantity.readings("x", [1.0]), "1 readings"),
        (lambda: imubayes.propagate(lambda y: y, [normal("x", 0, 1)]), "does not take the inputs x"),
        (lambda: imubayes.propagate(lambda x: x, [normal("x", 0, 1)] * 2), "'x' is repeated"),
        (lambda: imubayes.propagate(lambda x: (x, x), [normal("x", 0, 1)]), "returns 2 outputs"),
        (lambda: imubayes.propagate(lambda x: "no", [normal("x", 0, 1)]), "no real numbers"),
        (lambda: imubayes.propagate(lambda x: np.sqrt(x + 0j), [normal("x", 9, 1)]), "no real numbers"),
        (lambda: imubayes.propagate(lambda x: 0.1, [normal("x", 0, 1)]), "one number for 4 values"),
        (lambda: imubayes.propagate(lambda a, b: np.mean([a, b]), PAIR), "one number for 4 values"),
        (lambda: imubayes.budget(lambda a, b: np.linalg.norm([a, b]), PAIR), "one number for 4 values"),
        (lambda: imubayes.propagate(lambda a, b: np.outer(a, b), PAIR), "4 × 4 for 4 values"),
        (lambda: imubayes.budget(lambda a, b: a - a.mean() + b, PAIR), "when it is evaluated with others"),
        (lambda: imubayes.propagate(lambda a, b: np.cumsum(a) + b, PAIR), "when it is evaluated with others"),
        (lambda: imubayes.propagate(lambda x: math.sin(x), [normal("x", 0, 1)]), "does not take arrays"),
        (lambda: imubayes.propagate(lambda x: x, [InputQuantity.readings("x", [1.0, 2.0, 4.0])]), "standard deviation"),
        (lambda: imubayes.propagate(lambda x: x, [normal("x", 0, 1, 1.5)]), "standard deviation"),
        (lambda: imubayes.propagate(lambda x: x if x > 0 else -x, [normal("x", 0, 1)]), "does not take arrays"),
        (lambda: imubayes.propagate(lambda x: np.log(x), [normal("x", 5, 3)]), "not finite"),
        (lambda: imubayes.budget(lambda x, y: x + y, [normal("x", 0, 1), between("y", 0, 1)],
                                 correlation={("x", "y"): 0.5}), "not normal"),
        (lambda: imubayes.budget(lambda x: x, [normal("x", 0, 1)], correlation={("x", "z"): 0.5}), "two inputs"),
        (lambda: imubayes.conformity((0.0, 1.0)), "no limits"),
        (lambda: imubayes.conformity((0.0, 1.0), lower=2, upper=1), "crossed"),
        (lambda: imubayes.conformity((0.0, -1.0), upper=1), "u = -1"),
        (lambda: imubayes.conformity((0.0, 1.0), upper=1, rule="global_risk"), "global risk"),
        (lambda: inspect.unwrap(imubayes.conformity)([10.5, 8.0], upper=12), "a list"),
        (lambda: inspect.unwrap(imubayes.conformity)((10.5, 8.0, 3.0), upper=12), "3 numbers"),
        (lambda: imubayes.propagate(lambda x: (x, x), [normal("x", 0, 1)], names=("y", "y")), "'y' is repeated"),
        (lambda: imubayes.budget(lambda x: (), [normal("x", 0, 1)], names=()), "no outputs"),
        (lambda: imubayes.propagate(lambda x: x, [normal("x", 0, 1)])["q"], "no output 'q'"),
        (lambda: imubayes.budget(lambda x: np.log(x), [normal("x", 0, 0.1)]), "not finite"),
        (lambda: imubayes.budget(lambda x: np.sqrt(x), [normal("x", 0, 1)]), "not finite"),
        (lambda: between("x", 0, 1, degrees_of_freedom=0), "0 degrees of freedom"),
        (lambda: between("x", 0, 1, degrees_of_freedom=math.nan), "nan degrees of freedom"),
        (lambda: inspect.unwrap(imubayes.propagate)(lambda x: x, [normal("x", 0, 1)], digits=0), "digits = 0"),
        (lambda: imubayes.propagate(lambda x: x, [normal("x", 0, 1)], most_draws=10), "most_draws = 10"),
        (lambda: imubayes.budget(lambda a, b: a + b, PAIR, correlation={("a", "b"): 0.5, ("b", "a"): -0.5}), "twice"),
        (lambda: decided(rule="conformance_probability", probability=5.0), "probability = 5"),
        (lambda: decided(rule="specific_risk", probability=0.0), "probability = 0"),
        (lambda: decided(factor=-10.0), "factor = -10"),
        (lambda: decided(width=math.nan), "width = nan"),
        (lambda: decided(factor=1.0, width=1.0), "a factor or a width"),
        (lambda: decided(rule="simple_acceptance", width=1.0), "no guard band to set"),
        (lambda: decided(rule="conformance_probability", factor=2.0), "no guard band to set"),
        (lambda: decided(probability=0.9), "no probability to set"),
        (lambda: decided(production=(math.nan, 1.0)), "mean = nan"),
        (lambda: decided(production=(0.0, 0.0)), "sd = 0"),
        (lambda: decided(production=(0.0, math.inf)), "sd = inf"),
        (lambda: decided(lower=math.nan), "nan"),
        (lambda: decided(lower=math.inf), "no limits"),
        (lambda: imubayes.conformity(np.array([10.5, 8.0]), upper=12), "2 draws"),
        (lambda: imubayes.conformity(np.arange(399.0), upper=12), "399 draws"),
        (lambda: imubayes.conformity(np.full(1000, 0.1), upper=12), "all the same"),
        (lambda: imubayes.conformity(np.ones((500, 2)), upper=12), "500 × 2"),
        (lambda: inspect.unwrap(imubayes.conformity)("10.5", upper=12), "a str"),
    ],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore:(invalid value|divide by zero) encountered in (log|sqrt)")
def test_what_is_no_input_or_equation_is_refused_in_four_parts(made, what):
    with pytest.raises(InputError) as caught:
        made()
    issue = caught.value.issues[0]
    assert what in issue.what
    assert issue.where
    assert issue.allowed
    assert issue.remedy


# JCGM 106: 7.3.2 the Zener diode, and 8.3.2: a guard band of 1.65 u is 95 % one-sided.
def test_conformity_of_jcgm_106():
    found = imubayes.conformity((-5.47, 0.05), upper=-5.40, rule="simple_acceptance")
    assert f"{found.conformance:.2f}" == "0.92"
    assert found.accepted
    assert found.consumer_risk == pytest.approx(0.081, abs=1e-3)
    at_the_edge = imubayes.conformity((10 - 1.6501 * 0.2, 0.2), upper=10)
    assert at_the_edge.outcome == "pass"
    assert at_the_edge.consumer_risk == pytest.approx(0.05, abs=1e-3)
    assert imubayes.conformity((10 - 1.64 * 0.2, 0.2), upper=10).outcome == "fail"
    conditional = imubayes.conformity((0.9, 0.1), lower=-1, upper=1, rule="ilac_g8_non_binary", production=(0, 0.5))
    assert conditional.outcome == "conditional_pass"
    assert conditional.acceptance == (-1, 1)
    assert "CONDITIONAL PASS" in str(conditional)


def test_conformity_of_a_propagated_output_is_that_of_its_draws():
    found = imubayes.propagate(lambda a, b: a * b, [between("a", 0, 1), between("b", 0, 1)], digits=1)
    decided = imubayes.conformity(found, upper=0.9, rule="conformance_probability", probability=0.99)
    assert decided.conformance == pytest.approx(0.9 - 0.9 * math.log(0.9), abs=2e-3)
    assert decided.outcome == "pass"
    specific = imubayes.conformity(found, upper=0.9, rule="specific_risk", probability=0.001)
    assert specific.outcome == "fail"


def test_an_output_that_does_not_vary_is_known_exactly():
    found = imubayes.propagate(lambda x: np.full_like(x, 0.1), [normal("x", 0, 1)])
    assert (found.value, found.uncertainty, found.stable) == (pytest.approx(0.1, abs=1e-15), 0.0, True)
    assert found.interval == (0.1, 0.1)


def test_degrees_of_freedom_are_those_of_the_variance_with_its_correlations():
    values = [0, 1, 2, 1.5]
    inputs = [normal("a", 10, 3), normal("b", 10, 3), InputQuantity.readings("z", values)]
    (found,) = imubayes.budget(lambda a, b, z: a - b + z, inputs, correlation={("a", "b"): 0.99})
    of_readings = np.var(values, ddof=1) / 4
    nu = (2 * 9 * 0.01 + of_readings) ** 2 / (of_readings**2 / 3)
    assert found.degrees_of_freedom == pytest.approx(nu, rel=1e-6)
    assert found.coverage_factor == pytest.approx(stats.t(math.floor(nu)).ppf(0.975))


def second_order(equation, *inputs, **given) -> tuple[float | None, float | None]:
    (found,) = imubayes.budget(equation, inputs, **given)
    return found.second_order_value, found.second_order_uncertainty


def test_no_second_order_where_its_series_does_not_converge():
    """The sine of 0 ± 1 has the standard deviation √((1 − e⁻²)/2) = 0.66: the third derivative takes all of it."""
    assert second_order(lambda x: np.sin(x), normal("x", 0, 1)) == (None, None)
    assert second_order(lambda x: np.sin(x), normal("x", 0, 3)) == (None, None)
    assert second_order(lambda x: np.sin(x), normal("x", 0, 0.3)) == pytest.approx(
        (0, math.sqrt(-math.expm1(-0.18) / 2)), rel=0.01
    )
    (found,) = imubayes.budget(lambda x: np.sin(x), [normal("x", 0, 1)])
    assert "does not converge" in str(found)


@pytest.mark.parametrize(("value", "u"), [(9.19263177e9, 1e-4), (9.80665, 1e-9), (-1e6, 1e-8), (0.0, 1e-12)])
def test_rounding_of_a_large_estimate_is_no_curvature(value, u):
    (found,) = imubayes.budget(lambda x: 2 * x, [normal("x", value, u)])
    assert found.uncertainty == pytest.approx(2 * u, rel=1e-3)
    assert found.second_order_value == pytest.approx(2 * value, rel=1e-12)
    assert found.second_order_uncertainty == pytest.approx(2 * u, rel=5e-3)


# Products of correlated normal quantities: E = μ_a μ_b + r u_a u_b, and the variance of Bohrnstedt and Goldberger.
@pytest.mark.parametrize("r", [0.9, -0.5, 1.0, 0.0])
def test_second_order_of_correlated_inputs(r):
    inputs = normal("a", 2, 1), normal("b", 3, 0.5), normal("c", 1, 0.2)
    found = second_order(lambda a, b, c: a * b + c, *inputs, correlation={("a", "b"): r})
    covariance = r * 0.5
    variance = 4 * 0.25 + 9 + 2 * 6 * covariance + 0.25 + covariance**2 + 0.04
    assert found == pytest.approx((7 + covariance, math.sqrt(variance)), rel=1e-5)


def test_second_order_of_paired_draws():
    pair = np.random.default_rng(1).multivariate_normal([2.0, 2.0], [[1.0, 0.9], [0.9, 1.0]], 20_000)
    inputs = InputQuantity.from_draws("a", pair[:, 0]), InputQuantity.from_draws("b", pair[:, 1])
    assert second_order(lambda a, b: a * b, *inputs) == pytest.approx((4.9, 4.124), rel=0.02)


@pytest.mark.parametrize(("count", "digits", "stable"), [(20, 2, False), (20, 1, False), (40_000, 1, True)])
def test_the_draws_of_an_input_are_as_many_as_its_output_rests_on(count, digits, stable):
    drawn = InputQuantity.from_draws("x", np.random.default_rng(3).normal(size=count))
    found = imubayes.propagate(lambda x, b: x + b, [drawn, normal("b", 0, 0.1)], digits=digits)
    assert found.stable is stable
    assert found.effective == min(count, len(found.draws))
    assert ("TOO FEW" in str(found)) is not stable
    decided = imubayes.conformity(found, upper=2.0, rule="conformance_probability", probability=0.9)
    assert (decided.outcome == "withheld") is not stable
    # What contributes little may be known from few draws.
    little = imubayes.propagate(lambda x, b: 1e-3 * x + b, [drawn, normal("b", 0, 1.0)], digits=1)
    assert little.stable


# Exactly known distributions that no sinh-arcsinh normal resembles; p_c in closed form.
@pytest.mark.parametrize(
    ("inputs", "upper", "p"),
    [
        ([between("a", 0, 1)], 0.97, 0.97),
        ([between("a", -1, 1, "arcsine")], 0.95, 1 - math.acos(0.95) / math.pi),
        ([between("a", 0, 1), between("b", 0, 1)], 1.8, 1 - 0.2**2 / 2),
    ],
)
def test_conformance_of_an_output_that_is_not_normal_is_stated(inputs, upper, p):
    found = imubayes.propagate(of_sum, inputs, digits=1)
    rule = {"upper": upper, "rule": "conformance_probability"}
    clear = imubayes.conformity(found, **rule, probability=0.5)
    assert clear.outcome == "pass"
    assert clear.conformance == pytest.approx(p, abs=3e-3)
    assert imubayes.conformity(found, **rule, probability=0.999).outcome == "fail"
    close = imubayes.conformity(found, **rule, probability=clear.conformance)
    assert close.outcome == "withheld"
    assert close.conformance is None


def test_regions_of_outputs_that_hang_together_or_do_not_vary():
    """Of x and 2x and a constant there is one dimension: both factors are those of one normal quantity."""
    inputs = [normal("x", 0, 1)]
    found = imubayes.propagate(lambda x: (x, 2 * x, np.full_like(x, 0.1)), inputs, names=("a", "b", "c"), digits=1)
    assert found.ellipsoid_factor == pytest.approx(1.96, abs=0.02)
    assert found.box_factor == pytest.approx(1.96, abs=0.02)
    exact = imubayes.propagate(lambda x: np.full_like(x, 0.1), inputs)
    assert (exact.ellipsoid_factor, exact.box_factor) == (0.0, 0.0)


def test_no_more_draws_than_asked_for():
    found = imubayes.propagate(lambda x: x, [normal("x", 0, 1)], probability=0.99999, most_draws=100_000, digits=1)
    assert len(found.draws) <= 100_000
    assert not found.stable, "each block is to hold 100/(1 − p) draws (JCGM 101, 7.9.4)"
