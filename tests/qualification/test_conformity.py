"""Specification files, limits over temperature, and the outcome for a unit whose posterior is known."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imubayes.foundations.errors import InputError
from imubayes.results.posterior_quantities import PosteriorQuantities
from imubayes.results.summary import CombinationSummary, Quantity
from imubayes.results.temperature_range import ThermalModel
from imubayes_qualification.budgets.unit_under_test import TestedUnit
from imubayes_qualification.certificate.conformity import conformity, overall_outcome, resolved_limits
from imubayes_qualification.certificate.specification import read_specification
from imubayes_qualification.evaluation.coverage import KnownUncertainty

SIZE = 20_000
HEAD = 'format = 1\nname = "test"\n'


def quantities(**sd_scale: float) -> PosteriorQuantities:
    random = np.random.default_rng(4)
    stated = {
        "gyro_bias.bias[gx]": ("deg/h", 5.0, 0.5),
        "gyro_bias.bias[gy]": ("deg/h", -9.5, 0.5),
        "gyro_bias_temperature.slope[gx]": ("deg/h/degC", 0.1, 0.01),
        "scale_factor[gx]": ("pulse/s per deg/s", 1000.2, 0.01),
        "accel_bias.bias[ax]": ("ug", 120.0, 10.0),
        "gyro_scale_factor.scale[gx]": ("ppm", 200.0, 10.0),
        "gyro_scale_temperature.slope[gx]": ("ppm/degC", 2.0, 0.1),
    }
    entries = {name: Quantity(name=name, unit=unit, mean=mean, sd=sd) for name, (unit, mean, sd) in stated.items()}
    draws = {name: mean + sd * random.standard_normal(SIZE) for name, (_, mean, sd) in stated.items()}
    return PosteriorQuantities(entries, draws, dict.fromkeys(stated, float(SIZE)))


UNIT = TestedUnit(
    quantities(),
    (),
    {},
    9.80,
    (-10.4, 55.3),
    ThermalModel({}, {name: entry.unit for name, entry in quantities().entries.items()}, 25.0),
)


def outcome(tmp_path: Path, text: str, unit: TestedUnit = UNIT):
    file = tmp_path / "spec.toml"
    file.write_text(HEAD + text)
    return [conformity(limit, unit) for limit in resolved_limits(*read_specification(file), unit)]


def limit(quantity: str, rest: str) -> str:
    return f'[[limit]]\nquantity = "{quantity}"\n{rest}\n'


def test_a_family_has_a_limit_for_each_member(tmp_path):
    found = outcome(tmp_path, limit("gyro_bias.bias", 'lower = -10\nupper = 10\nunit = "deg/h"'))
    assert [(each.limit.quantity.name, each.decision.outcome) for each in found] == [
        ("gyro_bias.bias[gx]", "pass"),
        ("gyro_bias.bias[gy]", "fail"),
    ]
    assert found[1].decision.guard_band == pytest.approx(1.65 * 0.5, rel=0.02)
    # −9.5 ± 0.5 is a standard deviation inside: Φ(1) = 0.841.
    assert found[1].conformance.value == pytest.approx(0.841, abs=0.01)
    assert found[1].producer == found[1].conformance.value
    assert found[1].consumer is None
    assert overall_outcome(found) == "fail"


def with_sum(share: float | None, standard: bool = False) -> TestedUnit:
    """The unit with a scale factor of which so much is from the data, and its sum with the error of the table."""
    known = quantities()
    gx, table = "gyro_scale_factor.scale[gx]", "table_rate_error.rate_error[rate]"
    total = "S[gx]" if standard else f"{gx}+{table}"
    line = CombinationSummary(name=total, unit="ppm", standard=standard, quantities=(gx, table), weights=(1.0, 1.0))
    entries = {**known.entries, gx: known.entries[gx].model_copy(update={"from_data": share}), total: line}
    draws = {**known.draws, total: known.draws[gx] - 20.0}
    effective = {**known.effective, total: float(SIZE)}
    return replace(UNIT, quantities=PosteriorQuantities(entries, draws, effective))


def test_a_sum_with_an_error_of_the_table_is_no_member_of_the_family(tmp_path):
    """The scale factor, 200 ± 10 ppm, passes; its sum with an error of the table, 180 ppm, would fail."""
    unit, ends = with_sum(0.99), 'lower = 180\nunit = "ppm"'
    found = outcome(tmp_path, limit("gyro_scale_factor.scale", ends), unit)
    assert [(each.limit.quantity.name, each.decision.outcome) for each in found] == [
        ("gyro_scale_factor.scale[gx]", "pass")
    ]
    named = "gyro_scale_factor.scale[gx]+table_rate_error.rate_error[rate]"
    (full,) = outcome(tmp_path, limit(named, ends), unit)
    assert (full.limit.quantity.name, full.decision.outcome) == (named, "fail")
    # A symbol of a standard is a family of its own.
    assert outcome(tmp_path, limit("S", ends), with_sum(0.99, standard=True))[0].decision.outcome == "fail"


@pytest.mark.parametrize("ends", ["lower = 0", "lower = 1000"])
def test_there_is_no_decision_on_what_the_data_do_not_determine(tmp_path, ends):
    text = limit("gyro_scale_factor.scale", f'{ends}\nunit = "ppm"')
    (found,) = outcome(tmp_path, text, with_sum(0.2))
    assert (found.decision.outcome, found.decision.withheld) == ("withheld", "not_determined")
    assert (found.consumer, found.producer) == (None, None)
    assert overall_outcome([found]) == "withheld"
    # What is exact was not measured either.
    known = quantities()
    exact = {**known.draws, "gyro_scale_factor.scale[gx]": np.full(SIZE, 200.0)}
    unmeasured = replace(UNIT, quantities=replace(known, draws=exact))
    (found,) = outcome(tmp_path, text, unmeasured)
    assert found.decision.withheld == "not_determined"
    (found,) = outcome(tmp_path, text, with_sum(0.8))
    assert found.decision.outcome in ("pass", "fail")


@pytest.mark.parametrize("name", ["global_risk", "specific_risk", "conformance_probability"])
def test_an_exact_quantity_of_a_production_needs_no_guard_band(tmp_path, name):
    """Without an uncertainty a unit is accepted if it conforms: no risk, and a guard band is not divided by zero."""
    known = quantities()
    exact = {**known.draws, "gyro_bias.bias[gx]": np.full(SIZE, 5.0)}
    ends = 'lower = -10\nupper = 10\nunit = "deg/h"\nproduction = { mean = 0, sd = 8 }'
    text = f'[rule]\nname = "{name}"\n' + limit("gyro_bias.bias[gx]", ends)
    (found,) = outcome(tmp_path, text, replace(UNIT, quantities=replace(known, draws=exact)))
    assert found.decision.withheld == "not_determined"
    assert found.overall is not None
    for risk in (found.overall.consumer, found.overall.producer):
        assert (risk.from_draws, risk.from_quadrature) == (0.0, pytest.approx(0.0, abs=1e-12))


@pytest.mark.parametrize(("size", "outcome_with_it"), [(0.1, "pass"), (3.0, "withheld")])
def test_no_unit_passes_that_equipment_taken_as_exact_could_put_beyond_a_limit(tmp_path, size, outcome_with_it):
    """5 ± 0.5 deg/h is well inside ± 7.5; with 3 deg/h of the equipment it is not, and nobody knows."""
    text = limit("gyro_bias.bias[gx]", 'lower = -7.5\nupper = 7.5\nunit = "deg/h"')
    unit = replace(UNIT, unstated={"gyro_bias.bias[gx]": size})
    (found,) = outcome(tmp_path, text, unit)
    assert found.decision.outcome == outcome_with_it
    assert found.decision.withheld == ("taken_as_exact" if outcome_with_it == "withheld" else None)
    assert outcome(tmp_path, text)[0].decision.outcome == "pass"
    # What fails without it fails.
    (failed,) = outcome(tmp_path, limit("gyro_bias.bias[gx]", 'upper = 4\nunit = "deg/h"'), unit)
    assert failed.decision.outcome == "fail"


def test_limits_in_another_unit_and_relative_to_nominal(tmp_path):
    bias, scale = outcome(
        tmp_path,
        limit("accel_bias.bias[ax]", 'upper = 0.2\nunit = "mg"')
        + limit("scale_factor[gx]", 'nominal = 1000\nlower = -300\nupper = 300\nunit = "ppm"'),
    )
    assert (bias.limit.tolerance.lower, bias.limit.tolerance.upper) == (-math.inf, pytest.approx(200.0))
    assert (scale.limit.tolerance.lower, scale.limit.tolerance.upper) == pytest.approx((999.7, 1000.3))
    assert (scale.limit.rule.name, scale.limit.rule.guard_factor) == ("guard_band", 1.65)


def test_bias_over_a_temperature_range(tmp_path):
    """5 deg/h + 0.1 deg/h/°C from −10 to 55 °C: the estimate reaches 8.0 deg/h at 55 °C, and no more."""
    (found,) = outcome(
        tmp_path, limit("gyro_bias.bias[gx]", 'lower = -9\nupper = 9\nunit = "deg/h"\ntemperature_degC = [-10, 55]')
    )
    assert found.temperature == 55.0
    assert found.estimate.value == pytest.approx(8.0, abs=0.02)
    assert found.estimate.standard == pytest.approx(math.hypot(0.5, 0.3), rel=0.03)
    exact = 0.5 * (1 + math.erf(1 / math.hypot(0.5, 0.3) / math.sqrt(2)))
    assert found.conformance.value == pytest.approx(exact, abs=0.006)


def test_a_range_that_moves_nothing_leaves_length_and_known_uncertainty_as_they_are(tmp_path):
    """Bias of gy and an angle have no thermal terms: what is stated of them is the same with a range as without."""
    known, angle = quantities(), "gyro_misalignment_total[gx]"
    vector = np.random.default_rng(8).normal([3.0, 4.0], 2.0, (SIZE, 2))
    entries = {**known.entries, angle: Quantity(name=angle, unit="arcsec")}
    draws = {**known.draws, angle: np.linalg.norm(vector, axis=1)}
    unit = replace(
        UNIT,
        quantities=PosteriorQuantities(entries, draws, dict.fromkeys(entries, float(SIZE))),
        lengths={angle: 5.0},
        known={"gyro_bias.bias[gy]": KnownUncertainty(0.502, 1e-4, 9.0)},
    )
    for text in (
        limit(angle, 'upper = 12\nunit = "arcsec"'),
        limit("gyro_bias.bias[gy]", 'lower = -10\nunit = "deg/h"'),
    ):
        (plain,), (over,) = (outcome(tmp_path, each, unit) for each in (text, text + "temperature_degC = [-10, 55]\n"))
        assert over.stated == plain.stated
        assert (over.estimate, over.decision) == (plain.estimate, plain.decision)
    # The length of the mean vector: that of the draws is longer.
    assert outcome(tmp_path, limit(angle, 'upper = 12\nunit = "arcsec"'), unit)[0].estimate.value == 5.0


def with_memory(**parameters: tuple[str, float]) -> TestedUnit:
    """The unit with further parameters of gx, each known exactly: unit and value."""
    known = quantities()
    entries, draws = dict(known.entries), dict(known.draws)
    for family, (unit, value) in parameters.items():
        name = f"{family.replace('__', '.')}[gx]"
        entries[name], draws[name] = Quantity(name=name, unit=unit, mean=value, sd=0.0), np.full(SIZE, value)
    units = {name: entry.unit for name, entry in entries.items()}
    # 2 °C/min at the fastest, and 1000 pulse/s per deg/s.
    thermal = ThermalModel({}, units, 25.0, fastest=2 / 60, scale={"gx": 1000 * 180 / math.pi})
    known = PosteriorQuantities(entries, draws, dict.fromkeys(entries, float(SIZE)))
    return replace(UNIT, quantities=known, thermal=thermal)


@pytest.mark.parametrize(
    ("parameters", "width", "scatter"),
    [
        ({"gyro_thermal_hysteresis__half_width": ("deg/h", -3.0)}, 3.0, 0.0),
        # 0.2 deg/h/°C behind by 10 min at 2 °C/min, and by no more than the range.
        ({"gyro_thermal_lag__coefficient": ("deg/h/degC", 0.2), "gyro_thermal_lag__tau": ("min", 10.0)}, 4.0, 0.0),
        ({"gyro_thermal_lag__coefficient": ("deg/h/degC", 0.2), "gyro_thermal_lag__tau": ("h", 10.0)}, 13.0, 0.0),
        ({"gyro_bias_temperature_rate__slope": ("deg/h/(degC/min)", 1.5)}, 3.0, 0.0),
        ({"gyro_run_bias__spread": ("deg/h", 2.0)}, 0.0, 2.0),
        ({"run_scatter__tau": ("pulse/s", 1.0)}, 0.0, 3.6),
    ],
)
def test_a_limit_over_temperature_holds_for_both_branches_and_for_the_next_run(tmp_path, parameters, width, scatter):
    """5 deg/h + 0.1 deg/h/°C reaches 8 deg/h at 55 °C: hysteresis and lag go beyond on top, below 1.5 at −10 °C."""
    unit = with_memory(**parameters)
    span = 'unit = "deg/h"\ntemperature_degC = [-10, 55]'
    above, below = (
        outcome(tmp_path, limit("gyro_bias.bias[gx]", f"{ends}\n{span}"), unit)[0]
        for ends in ("lower = -99\nupper = 8", "lower = 1.5\nupper = 99")
    )
    assert (above.temperature, below.temperature) == (55.0, -10.0)
    assert above.estimate.value == pytest.approx(8.0 + width, abs=0.05)
    assert below.estimate.value == pytest.approx(1.5 - width, abs=0.05)
    assert above.estimate.standard == pytest.approx(math.hypot(0.5, 0.3, scatter), rel=0.03)


def test_scale_factor_over_a_temperature_range(tmp_path):
    """2 ppm/°C over 35 °C below the reference: −70 ppm, for the relative scale factor and for the absolute one."""
    relative, absolute = outcome(
        tmp_path,
        limit("gyro_scale_factor.scale[gx]", 'lower = 0\nunit = "ppm"\ntemperature_degC = [-10, 25]')
        + limit("scale_factor[gx]", 'lower = 999\nunit = "pulse/s per deg/s"\ntemperature_degC = [-10, 25]'),
    )
    assert relative.estimate.value == pytest.approx(200 - 70, abs=0.5)
    assert absolute.estimate.value == pytest.approx(1000.2 * (1 - 70e-6), abs=2e-3)
    assert relative.temperature == absolute.temperature == -10.0


@pytest.mark.parametrize(
    ("rule", "expected"),
    [
        ('name = "simple_acceptance"', "pass"),
        ('name = "guard_band"', "fail"),
        ('name = "guard_band"\nwidth = 0.4', "pass"),
        ('name = "ilac_g8_non_binary"', "conditional_pass"),
        ('name = "conformance_probability"\nprobability = 0.8', "pass"),
        ('name = "conformance_probability"', "fail"),
        ('name = "specific_risk"\nprobability = 0.2', "pass"),
        ('name = "specific_risk"', "fail"),
    ],
)
def test_rules_of_the_file(tmp_path, rule, expected):
    text = f"[rule]\n{rule}\n" + limit("gyro_bias.bias[gy]", 'lower = -10\nupper = 10\nunit = "deg/h"')
    (found,) = outcome(tmp_path, text)
    assert found.decision.outcome == expected


def test_one_width_of_a_guard_band_is_of_limits_in_one_unit(tmp_path):
    """A width of 5 would be 5 deg/h of a bias and 5 ppm of a scale factor."""
    bias = limit("gyro_bias.bias[gy]", 'lower = -10\nupper = 10\nunit = "deg/h"')
    scale = limit("gyro_scale_factor.scale[gx]", 'lower = 0\nupper = 999\nunit = "ppm"')
    own = scale + 'rule = { name = "guard_band", width = 5 }\n'
    file, rule = tmp_path / "spec.toml", '[rule]\nname = "guard_band"\nwidth = 5\n'
    file.write_text(HEAD + rule + bias + scale, encoding="utf-8")
    with pytest.raises(InputError, match=r"one width, 5, for limits in deg/h, ppm") as caught:
        read_specification(file)
    assert "spec.toml:5" in caught.value.issues[0].where
    for fine in (rule + bias + own, rule.replace("width = 5", "factor = 2") + bias + scale):
        file.write_text(HEAD + fine, encoding="utf-8")
        assert read_specification(file)[0].limit


def test_a_global_risk_depends_on_the_production(tmp_path):
    rule = '[rule]\nname = "global_risk"\nprobability = 0.001\n'
    rest = 'lower = -10\nupper = 10\nunit = "deg/h"\nproduction = { mean = 0, sd = SD }'
    narrow, wide = (
        outcome(tmp_path, rule + limit("gyro_bias.bias[gy]", rest.replace("SD", sd)))[0] for sd in ("2", "8")
    )
    assert narrow.decision == narrow.decision.__class__("pass", 0.0)
    assert wide.decision.outcome == "fail"
    assert wide.overall is not None
    assert wide.overall.consumer.from_quadrature == pytest.approx(0.001, rel=0.02)


@pytest.mark.parametrize(
    ("text", "what", "allowed"),
    [
        (limit("gyro_biass.bias", 'upper = 1\nunit = "deg/h"'), "no quantity 'gyro_biass.bias'", "gyro_bias.bias"),
        (limit("gyro_bias.bias[gz]", 'upper = 1\nunit = "deg/h"'), "no quantity", "gyro_bias.bias[gx]"),
        (limit("gyro_bias.bias", 'lower = 2\nupper = 1\nunit = "deg/h"'), "crossed", "lower < upper"),
        (limit("gyro_bias.bias", 'unit = "deg/h"'), "no limits", "lower, upper"),
        (limit("gyro_bias.bias", 'upper = 1\nunit = "mg"'), "unit 'mg'", "deg/h"),
        (limit("gyro_bias.bias", 'upper = 1\nunit = "deg/hour"'), "'hour' is not a unit", "deg"),
        (limit("scale_factor[gx]", 'upper = 1\nunit = "ppm"'), "unit 'ppm'", "'nominal'"),
        (
            limit("gyro_bias.bias", 'upper = 1\nunit = "deg/h"\ntemperature_degC = [-40, 55]'),
            "there are no data",
            "-10.4 … 55.3",
        ),
        (limit("gyro_bias.bias", 'upper = 1\nunit = "deg/h"\ntemperature_degC = [55, -10]'), "crossed", "lowest"),
        (
            '[rule]\nname = "global_risk"\n' + limit("gyro_bias.bias", 'upper = 1\nunit = "deg/h"'),
            "global",
            "production",
        ),
        ('[rule]\nname = "guard"\n' + limit("gyro_bias.bias", 'upper = 1\nunit = "deg/h"'), "guard", "guard_band"),
        (limit("gyro_bias.bias", 'upper = 1\nunit = "deg/h"\nfactor = 2'), "unknown key 'factor'", "quantity"),
    ],
)
def test_errors_have_four_parts(tmp_path, text, what, allowed):
    with pytest.raises(InputError) as caught:
        outcome(tmp_path, text)
    (issue,) = caught.value.issues
    assert what in issue.what
    assert allowed in issue.allowed
    assert "spec.toml:" in issue.where
    assert issue.remedy


@pytest.mark.parametrize(("upper", "refused"), [(-2, True), (0, False)])
def test_a_negative_upper_limit_of_a_size_is_refused(tmp_path, upper, refused):
    unit = replace(UNIT, nonnegative=frozenset({"accel_bias.bias[ax]"}))
    text = limit("accel_bias.bias", f'upper = {upper}\nunit = "mg"')
    assert outcome(tmp_path, text)  # a bias may be negative
    if not refused:
        assert outcome(tmp_path, text, unit)
        return
    with pytest.raises(InputError, match="cannot be negative"):
        outcome(tmp_path, text, unit)


def test_all_errors_of_a_file_are_reported_at_once(tmp_path):
    text = limit("gyro_biass.bias", 'upper = 1\nunit = "deg/h"') + limit("gyro_bias.bias[gx]", 'upper = 1\nunit = "mg"')
    with pytest.raises(InputError) as caught:
        outcome(tmp_path, text)
    assert len(caught.value.issues) == 2


def test_u_over_a_range_is_that_of_the_next_run_whose_scatter_is_uncertain(tmp_path):
    """A scatter known to a factor of two: y ± U holds 95 % of the next runs, which y ± 1.96 u does not."""
    unit = with_memory(run_scatter__tau=("pulse/s", 1.0))
    name, random = "run_scatter.tau[gx]", np.random.default_rng(12)
    tau = np.exp(0.6 * random.standard_normal(SIZE))
    unit = replace(unit, quantities=replace(unit.quantities, draws={**unit.quantities.draws, name: tau}))
    span = 'lower = -99\nupper = 99\nunit = "deg/h"\ntemperature_degC = [-10, 55]'
    (found,) = outcome(tmp_path, limit("gyro_bias.bias[gx]", span), unit)
    # 1 pulse/s is 3.6 deg/h; bias and slope of the unit are normal.
    size = 400_000
    bias = 8.0 + math.hypot(0.5, 0.3) * random.standard_normal(size)
    runs = bias + 3.6 * np.exp(0.6 * random.standard_normal(size)) * random.standard_normal(size)

    def held(half: float) -> float:
        return float(np.mean(np.abs(runs - found.stated.estimate) <= half))

    assert held(found.stated.expanded) == pytest.approx(0.95, abs=0.003)
    assert held(1.95996 * found.stated.standard) < 0.946
    assert found.stated.factor > 2.0
    assert found.estimate.expanded == found.stated.expanded


def test_what_u_omits_over_a_range_is_of_the_temperature_at_which_u_is(tmp_path):
    """A cause that moves bias and slope against each other: 3 deg/h at 25 °C, and nothing at 55 °C."""
    bias, slope = "gyro_bias.bias[gx]", "gyro_bias_temperature.slope[gx]"
    unit = replace(UNIT, unstated={bias: 3.0, slope: 0.1}, jointly={bias: np.array([3.0]), slope: np.array([-0.1])})
    ends = 'lower = -99\nupper = 99\nunit = "deg/h"'
    (at_reference,) = outcome(tmp_path, limit(bias, ends), unit)
    assert at_reference.omitted_ratio == pytest.approx(math.hypot(1, 3.0 / 0.5), rel=0.02)

    def over(lower: float, upper: float, span: str):
        text = f'lower = {lower}\nupper = {upper}\nunit = "deg/h"\ntemperature_degC = {span}'
        return outcome(tmp_path, limit(bias, text), unit)[0]

    hot, cold = over(-99, 15, "[-10, 55]"), over(0, 99, "[-10, 25]")
    assert (hot.temperature, cold.temperature) == (55.0, -10.0)
    assert hot.omitted_ratio == pytest.approx(1.0, abs=1e-6)
    assert cold.omitted_ratio == pytest.approx(math.hypot(1, (3.0 + 3.5) / math.hypot(0.5, 0.35)), rel=0.03)
    # 8 ± 0.6 deg/h is within 11 at 55 °C whatever the cause is; at −10 °C the cause puts 6.5 deg/h on 1.5.
    assert over(-99, 11, "[40, 55]").decision.outcome == "pass"
    assert over(-99, 11, "[-10, 55]").decision.withheld == "taken_as_exact"
