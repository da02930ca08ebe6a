"""A number that is withheld says why and what gives it, and is withheld wherever it would stand."""

import numpy as np
import pytest

from imubayes.display.layout import Sheet
from imubayes.results.marginal import Marginal
from imubayes_qualification.budgets.budget_parts import CorrelationMatrix, QuantityBudget, UncertaintyBudgets
from imubayes_qualification.certificate.report_estimates import monte_carlo_error
from imubayes_qualification.certificate.report_record import (
    Adequacy,
    Conformity,
    LimitOutcome,
    MonteCarloError,
    MountingAngle,
    Probability,
    QualificationReport,
    ReportedConvergence,
    ReportedEstimate,
    ResultLine,
)
from imubayes_qualification.certificate.report_subject import Provenance, ReportedEffect
from imubayes_qualification.display.report.budget_sections import budget_section
from imubayes_qualification.display.report.document import Block
from imubayes_qualification.display.report.first_page import alarms, banner, limits_table, risk_table, rules_text
from imubayes_qualification.display.report.result_sections import mounting_section, result_section
from imubayes_qualification.display.report.words import (
    chance,
    digits_text,
    interval_text,
    more_draws_text,
    reference_temperature,
    stated,
    value_text,
)
from imubayes_qualification.evaluation.coverage import KnownUncertainty, coverage_of

NAME, U = "accel_quadratic.quadratic[az]", 0.93
VALUES = {"estimate": -22.44, "standard_uncertainty": U, "low": -24.2, "high": -20.6}


def error(digits: int) -> MonteCarloError:
    return MonteCarloError.model_validate(
        {
            "estimate": 0.015, "standard_uncertainty": 0.01, "low": 0.04, "high": 0.04, "effective": 4000.0,
            "digits": digits, "tolerance": 0.05, "worst": "low", "draws_needed": 2.56,
        }
    )  # fmt: skip


def line(digits: int) -> ResultLine:
    withheld = None if digits else "monte_carlo_error"
    common = {"name": NAME, "unit": "ug/g^2", "d_si": None, "kind": "parameter", "monte_carlo": error(digits)}
    return ResultLine.model_validate({**common, **VALUES, "withheld": withheld})


def limit(digits: int) -> LimitOutcome:
    sure = Probability(
        value=1.0, from_draws=1.0, from_quadrature=1.0, monte_carlo_error=1e-4, allowed=0.01, withheld=None
    )
    return LimitOutcome(
        name=NAME, unit="ug/g^2", d_si=None, lower=-40, upper=40, nominal=None, temperature_range=None,
        temperature=None,
        estimate=-22.44, standard_uncertainty=U, expanded_uncertainty=1.8, conformance=sure, rule="guard_band",
        guard_factor=1.65, guard_width=None, rule_probability=None, guard_band=1.5, outcome="pass", consumer_risk=0.0,
        producer_risk=None, global_consumer_risk=None, global_producer_risk=None, monte_carlo=error(digits),
    )  # fmt: skip


def report(digits: int) -> QualificationReport:
    budget = QuantityBudget.model_construct(
        name=NAME, unit="ug/g^2", standard_uncertainty=U, expanded_uncertainty=1.8, coverage_factor=1.96,
        interval="symmetric", remainder=0.0, components=False, scaled=1.0, lines=(), halved=(), next_run=None,
    )  # fmt: skip
    conformity = Conformity(specification="x", sha256="", outcome="pass", obstacles=(), limits=(limit(digits),))
    budgets = UncertaintyBudgets.model_construct(
        quantities=(budget,), correlation=CorrelationMatrix(names=(NAME,), rows=((1.0,),))
    )
    return QualificationReport.model_construct(
        results=(line(digits),), mounting_angles=(), standards=(), combinations=(), thermal_linearity=(),
        conformity=conformity, budgets=budgets, certificate=None, missing=(),
    )  # fmt: skip


def text(blocks: list[Block]) -> str:
    tables = [block for block in blocks if isinstance(block, Sheet)]
    return "\n".join(" | ".join([table.title, *(cell.text for row in table.rows for cell in row)]) for table in tables)


def test_the_row_says_why_and_the_terminal_which_command_gives_it():
    """A command has no place in a certificate."""
    estimate, u, _, _ = stated(line(0))
    assert (estimate, u) == ("withheld", "too few draws")
    assert interval_text(line(0)) == "–"
    said = more_draws_text(report(0))
    assert "1 number" in said
    assert "2.6 times as many are needed" in said
    assert "--until-digits 1" in said
    assert more_draws_text(report(2)) == ""
    assert stated(line(1))[:2] == ("-22.4", "0.9")


@pytest.mark.parametrize(
    ("draws", "u", "said", "digits"),
    [
        (4000, 50.0, ("-1234", "50", "-1234 ± 98"), 2),  # by JCGM 101 alone: 50 and 90, or 100
        (4000, 0.16, ("-1234.00", "0.16", "-1234.00 ± 0.31"), 2),
        (1000, 50.0, ("-1230", "50", "-1230 ± 100"), 1),
    ],
)
def test_uncertainties_have_two_digits_where_the_draws_support_them(draws, u, said, digits):
    """GUM 7.2.6, and the value to the same place; one digit is determined by the name of the quantity."""
    normal = np.random.default_rng(7).standard_normal(draws)
    marginal = Marginal(-1234 + u * (normal - normal.mean()) / normal.std(), float(draws))
    found = coverage_of(marginal, KnownUncertainty(u, 1e-4 * u))
    made = ReportedEstimate(
        name=NAME, unit="ug/g^2", d_si=None, estimate=found.estimate, standard_uncertainty=found.standard,
        low=found.low, high=found.high, interval=found.shape, expanded_uncertainty=found.expanded,
        monte_carlo=monte_carlo_error(found, marginal.effective),
    )  # fmt: skip
    assert (*stated(made)[:2], value_text(made)) == said
    assert digits_text([made]).count(NAME) == 2 - digits
    assert "two significant digits" in digits_text([made])


@pytest.mark.parametrize("page", ["limits", "results", "budgets"])
def test_what_one_page_withholds_no_other_states(page):
    """The uncertainty and the estimate are on no page, and each says so."""
    pages = {
        "limits": lambda digits: text([limits_table([limit(digits)])]),
        "results": lambda digits: text(result_section(report(digits))),
        "budgets": lambda digits: text(budget_section(report(digits))),
    }
    withheld, known = pages[page](0), pages[page](2)
    assert "withheld" in withheld
    for number in ("0.93", "22.4", "1.8"):
        assert number not in withheld
    assert "withheld" not in known
    assert ("-22.4 ± 1.8" if page == "limits" else "0.93") in known


@pytest.mark.parametrize(
    ("value", "error", "said"),
    [
        (1.0, 6e-5, "> 0.9999"),
        (0.99995, 0.0, "> 0.9999"),
        (0.9997, 2e-4, "0.9997"),
        (0.9141, 3e-3, "0.914"),
        (0.9997, 3e-3, "> 0.999"),
        (0.0, 6e-5, "< 0.0001"),
    ],
)
def test_no_probability_is_one_or_above_it(value, error, said):
    assert chance(value, error) == said


def test_an_estimate_without_posterior_says_so():
    none = ReportedEstimate(name="x", unit="1", d_si=None, withheld="not_converged")
    assert stated(none)[1] == "no convergence"


def test_a_mounting_angle_that_is_withheld_says_so():
    angle = MountingAngle.model_validate(
        {
            "name": "mounting_angle[gx,flat]", "unit": "deg", "d_si": None, **VALUES, "monte_carlo": error(0),
            "withheld": "monte_carlo_error", "channel": "gx", "mounting": "flat", "nominal": 0.0, "deviation": None,
            "evidence": (), "runs": (),
        }
    )  # fmt: skip
    (table,) = [block for block in mounting_section([angle]) if isinstance(block, Sheet)]
    assert "withheld" in text([table])
    assert "too few draws" in table.note
    assert "--until-digits" not in table.note


def test_a_deviation_is_the_difference_of_the_angles_as_they_are_printed():
    angle = MountingAngle.model_validate(
        {
            "name": "mounting_angle[gx,pyramid]", "unit": "deg", "d_si": None, "estimate": 54.7165237,
            "standard_uncertainty": 2.9e-6, "monte_carlo": error(2), "channel": "gx", "mounting": "pyramid",
            "nominal": 54.73561032, "deviation": 54.7165237 - 54.73561032, "evidence": (), "runs": (),
        }
    )  # fmt: skip
    (table,) = [block for block in mounting_section([angle]) if isinstance(block, Sheet)]
    nominal, stated, _, deviation = (cell.text for cell in table.rows[0][2:6])
    true = stated.partition(" ")[0]
    assert len(nominal) == len(true)
    assert (float(true) - float(nominal)) * 3600 == pytest.approx(float(deviation), abs=0.01)


def test_an_interval_that_is_not_symmetric_stands_in_brackets():
    skewed = {"interval": "shortest", "low": 12.0, "high": 131.0, "estimate": 41.0, "standard_uncertainty": 32.0}
    assert value_text(line(2).model_copy(update={**skewed, "expanded_uncertainty": 60.0})) == "41 [12; 131]"


def test_decisions_and_risks_have_symbol_and_channel():
    named = limit(2).model_copy(update={"symbol": "K_2", "label": "az"})
    quantity, channel = risk_table([named]).rows[0][:2]
    assert (quantity.text, quantity.formula, channel.text) == ("K_2", True, "az")


@pytest.mark.parametrize(
    ("changes", "nothing"),
    [
        ({"guard_band": 39.9}, False),
        ({"guard_band": 40.1}, True),
        ({"guard_band": 100.0, "lower": None}, False),  # an estimate far below is accepted
        ({"guard_band": 41.0, "lower": None, "interval": "shortest"}, True),  # a length is not below zero
        ({"guard_band": 39.0, "lower": None, "interval": "shortest"}, False),
        ({"guard_band": None}, False),
    ],
)
def test_a_guard_band_that_leaves_no_acceptance_zone_says_so(changes, nothing):
    """A FAIL that no unit could avoid is distinguished from one of this unit: in the row, and before all tables."""
    found = limit(2).model_copy(update=changes | {"outcome": "fail"})
    assert found.accepts_nothing == nothing
    decision = limits_table([found]).rows[0][-1].text
    assert decision == ("FAIL: the guard band leaves no acceptance zone" if nothing else "FAIL")
    assert ("no acceptance zone" in risk_table([found]).rows[0][3].text) == nothing
    made = report(2).model_copy(
        update={
            "conformity": Conformity(specification="x", sha256="", outcome="fail", obstacles=(), limits=(found,)),
            "convergence": ReportedConvergence.model_construct(converged=True, sampled=True),
            "adequacy": Adequacy.model_construct(verdict="adequate", intervals_valid=True, prior_conflicts=()),
        }
    )
    assert any(NAME in alarm and "no acceptance zone" in alarm for alarm in alarms(made)) == nothing


@pytest.mark.parametrize(("count", "said"), [(1, "(1 limit)"), (2, "(2 limits)")])
def test_limits_are_counted_in_english(count, said):
    assert said in rules_text([limit(2)] * count)[0]


@pytest.mark.parametrize("outcome", ["pass", "fail"])
def test_a_decision_on_an_approximation_says_so_on_the_first_page(outcome):
    def sentence(sampled: bool) -> str:
        changed = report(2).conformity
        assert changed is not None
        update = {
            "conformity": changed.model_copy(update={"outcome": outcome}),
            "convergence": ReportedConvergence.model_construct(converged=True, sampled=sampled),
        }
        return banner(report(2).model_copy(update=update)).sentence

    assert "The posterior was not sampled" in sentence(sampled=False)
    assert "sampled" not in sentence(sampled=True)


@pytest.mark.parametrize(
    ("reference", "said"), [("25 °C", "25 (T_ref)"), ("25 °C, 20 °C of gyro_bias_temperature", "T_ref")]
)
def test_a_limit_at_the_reference_temperature_says_which_it_is(reference, said):
    assert limits_table([limit(2)], None, reference).rows[0][3].text == said


def test_the_reference_temperature_is_that_of_the_effects():
    def of(**stated: float) -> str:
        effects = [
            ReportedEffect(name=name, channels=None, prior={}, options={"reference_degC": value})
            for name, value in stated.items()
        ]
        made = Provenance.model_construct(effects=tuple(effects))
        return reference_temperature(QualificationReport.model_construct(provenance=made))

    assert of() == of(gyro_bias_temperature=25.0) == "25 °C"
    assert of(gyro_bias_temperature=20.0) == "25 °C, 20 °C of gyro_bias_temperature"


@pytest.mark.parametrize(
    ("expanded", "digits", "said"),
    [(0.343, 1, "0.4"), (0.304, 1, "0.3"), (0.363, 1, "0.4"), (9.49, 1, "10"), (0.343, 2, "0.34")],
)
def test_rounding_takes_no_more_than_a_twentieth_of_the_expanded_uncertainty(expanded, digits, said):
    """EA-4/02, 6.3."""
    u = expanded / 1.96
    found = limit(digits).model_copy(update={"standard_uncertainty": u, "expanded_uncertainty": expanded})
    assert value_text(found).partition(" ± ")[2] == said
