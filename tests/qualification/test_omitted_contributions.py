"""The first page states which properties of site and equipment, exact in the model, every U includes or omits."""

import math

import pytest

from imubayes.display.layout import Sheet
from imubayes_qualification.budgets.budget_parts import QuantityBudget, UncertaintyBudgets
from imubayes_qualification.budgets.taken_as_exact import ExactInput, QuantityShift, TakenAsExact
from imubayes_qualification.certificate.report_record import (
    MountingAngle,
    QualificationReport,
    ReportedCombination,
    ReportedConvergence,
    ResultLine,
    StandardEstimate,
    ThermalLinearity,
)
from imubayes_qualification.certificate.report_subject import Provenance
from imubayes_qualification.display.report.exact_tables import (
    BESIDE,
    included_table,
    omissions,
    omitted_beside,
    omitted_note,
    omitted_table,
    sensitivity_table,
)
from imubayes_qualification.display.report.result_sections import (
    combination_section,
    converter_section,
    mounting_section,
    standards_section,
)

BIAS, ANGLE, SUM, SEAT = "accel_bias.bias[ax]", "mounting_angle[ax,up]", "a[ax]+b[up]", "table_axis_tilt.x[rate]"
DRIFT, DELTA_K = "converter_gain_drift.slope[ax]", "delta_k[ax,ramp]"
U = 0.5
# What all parameters together do to each quantity that is in no uncertainty, in units of u.
JOINT = {BIAS: 1.0, ANGLE: 3.0, SUM: 0.2, SEAT: math.sqrt(3.0), DRIFT: math.sqrt(8.0), DELTA_K: math.sqrt(15.0)}


def shifts(sizes: dict[str, float]) -> tuple[QuantityShift, ...]:
    return tuple(QuantityShift(name=name, value=U * size) for name, size in sizes.items())


def exact_input(effect: str, sizes: dict[str, float], included: bool) -> ExactInput:
    return ExactInput(
        effect=effect, parameter=f"{effect}.x[t]", source="table", unit="arcsec", size=5.0, left=5.0, stated=included,
        included=included, shifts=shifts(sizes),
    )  # fmt: skip


def report(withheld: bool = False) -> QualificationReport:
    stated = {"estimate": 1.0, "standard_uncertainty": U, "d_si": None}
    angle = stated | {"withheld": "monte_carlo_error"} if withheld else stated
    standard = {"key": "accel_bias", "symbol": "K_0", "quantity": "bias", "standard": "IEEE Std 1293", "term": "K_0"}
    names = (BIAS, ANGLE, SUM, SEAT, DRIFT, DELTA_K)
    budgets = [QuantityBudget.model_construct(name=name, unit="ug", standard_uncertainty=U) for name in names]
    return QualificationReport.model_construct(
        standards=(
            StandardEstimate(name="accel_bias[ax]", unit="ug", label="ax", members=(BIAS,), **standard, **stated),
        ),
        mounting_angles=(
            MountingAngle(
                name=ANGLE, unit="deg", channel="ax", mounting="up", nominal=0, deviation=None, evidence=(), runs=(),
                **angle,
            ),
        ),
        combinations=(
            ReportedCombination(
                name=SUM, unit="arcsec", standard=False, quantities=("a[ax]", "b[up]"), weights=(1.0, 1.0), constant=0,
                middle_of="", evidence=(), procedures=(), **stated,
            ),
        ),
        thermal_linearity=(
            ThermalLinearity(name=DELTA_K, unit="%", channel="ax", run="ramp", threshold=10, within=None, **stated),
        ),
        results=tuple(
            ResultLine(name=name, unit="arcsec", kind="parameter", **stated) for name in (BIAS, SEAT, DRIFT)
        ),
        budgets=UncertaintyBudgets.model_construct(quantities=tuple(budgets)),
        convergence=ReportedConvergence.model_construct(converged=True),
        not_estimated=(), provenance=Provenance.model_construct(effects=()),
        exact=TakenAsExact(
            inputs=(
                exact_input("gravity_anomaly", {BIAS: 0.8}, included=True),
                exact_input("encoder_harmonic", JOINT, included=False),
                exact_input("table_wobble", {BIAS: 0.1, ANGLE: 5.0}, included=False),
            ),
            unstated=shifts(JOINT),
        ),
    )  # fmt: skip


def rows(table: Sheet | None) -> list[tuple[str, ...]]:
    return [] if table is None else [tuple(cell.text for cell in row) for row in table.rows]


def test_every_stated_quantity_that_omits_something_has_its_factor():
    """The factor is that of all parameters together, √(1 + (omitted/u)²), and a quantity stands once."""
    found = {each.label: each.ratio for each in omissions(report())}
    converters = {DRIFT: 3.0, "Δk[ax,ramp]": 4.0}
    assert found == pytest.approx({"ax": math.sqrt(2), "ax,up": math.sqrt(10), SEAT: 2.0} | converters)
    bias, angles, linearity, others, drift = rows(omitted_table(omissions(report())))
    assert [linearity[:2], drift[:2]] == [
        ("converters", "× 4.00 (1 factor in that table)"),
        ("converters", "× 3.00 (1 factor in that table)"),
    ]
    assert bias == ("K_0", "ax × 1.41", "0.50 → 0.71", "µg", "encoder harmonic (5.0 arcsec)")
    assert angles[0] == "true mounting angles"
    assert angles[-1].startswith("table wobble (5.0 arcsec), encoder")
    assert others[:2] == ("others of the result table", "× 2.00 (1 factor in that table)")
    said = omitted_note(omissions(report()), "angle")
    assert said.startswith(
        " U omits: factor by which known contributions (table wobble, encoder harmonic) would multiply"
    )
    assert omitted_note(omissions(report()), "combination") == ""


def test_what_u_omits_stands_in_its_own_row():
    """A reader who copies y ± U of an angle sees beside it that a wobble of the table would make it three times."""
    found = omitted_beside(report())
    assert found[ANGLE] == "× 3.16"
    assert found[BIAS] == found["accel_bias[ax]"] == "× 1.41"
    (table,) = [each for each in mounting_section(report().mounting_angles, "", found) if isinstance(each, Sheet)]
    assert table.rows[0][table.head.index(BESIDE)].text == found[ANGLE]
    (standards, *_) = [each for each in standards_section(report(), "", found) if isinstance(each, Sheet)]
    assert standards.rows[0][standards.head.index(BESIDE)].text == found[BIAS]
    (table,) = [each for each in mounting_section(report().mounting_angles) if isinstance(each, Sheet)]
    assert BESIDE not in table.head


def test_what_u_of_a_converter_omits_stands_beside_it():
    own = report().thermal_linearity, report().results, " u and U omit this."
    tables = [each for each in converter_section(*own, omitted_beside(report())) if isinstance(each, Sheet)]
    assert [table.rows[0][table.head.index(BESIDE)].text for table in tables] == ["× 3.00", "× 4.00"]
    assert all(table.note.endswith(own[-1]) for table in tables)
    assert all(BESIDE not in each.head for each in converter_section(*own) if isinstance(each, Sheet))


def test_errors_that_the_data_bound_do_less_than_their_changes_suggest():
    """A change per unit times the plausible size is more than a factor contains, and the note of each table says so."""
    (changes, factors) = sensitivity_table(report()), omitted_table(omissions(report()))
    assert changes is not None
    assert factors is not None
    assert "the data bound such an error" in changes.note
    assert "that part of each error that the data do not determine" in factors.note
    assert "in proportion" not in factors.note


def test_what_is_withheld_has_no_factor_and_nothing_omitted_is_no_table():
    assert {each.label for each in omissions(report(withheld=True))} == {"ax", SEAT, DRIFT, "Δk[ax,ramp]"}
    assert omitted_table([]) is None


def test_what_u_omits_is_given_per_unit_of_its_error():
    """Plausible are 5 arcsec, of which a harmonic moves the bias by 0.5: 0.1 per arcsec; of two, 0.14, or 0.2 alike."""
    ((cause, per, symbol, channel, change, u, unit), (other, *_)) = rows(sensitivity_table(report()))
    assert (cause, per, symbol, channel) == ("encoder harmonic", "1 arcsec", "K_0", "ax")
    assert (change, u, unit) == ("0.100", "0.50", "µg")
    assert other == "table wobble"
    several = report()
    inputs = (*several.exact.inputs, exact_input("encoder_harmonic", {BIAS: 1.0}, included=False))
    two = several.model_copy(update={"exact": several.exact.model_copy(update={"inputs": inputs})})
    (first, *_) = rows(sensitivity_table(two))
    assert (first[0], *first[4:6]) == ("encoder harmonic, 2 parameters", "0.141", "0.200")
    # What hardly moves it is left out, and what is in U is no part of this table.
    small = two.exact.inputs[0], exact_input("table_wobble", {BIAS: 0.05}, included=False)
    none = several.model_copy(update={"exact": several.exact.model_copy(update={"inputs": small})})
    assert sensitivity_table(none) is None


def test_what_is_in_every_uncertainty_is_told_apart():
    ((effect, size, stated, moved, change, _),) = rows(included_table(report()))
    assert (effect, size, stated, moved) == ("gravity anomaly", "5.0 arcsec", "stated", "K_0[ax]")
    assert change == "0.30 → 0.50"


def test_the_note_of_a_table_has_what_its_uncertainties_omit():
    said = " u and U omit this."
    (table,) = [block for block in combination_section(report().combinations, said) if isinstance(block, Sheet)]
    assert table.note.endswith(said)
