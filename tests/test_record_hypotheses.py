"""A hypothesis about what was recorded: its words, its correction, its named values, and when two are the same."""

import pytest

from imubayes.foundations.wrong_records import (
    GAINS,
    RATE_UNITS,
    WrongRecord,
    agreement_text,
    correction,
    record_remedy,
)


def temperature(recorded: float, agreeing: float, sd: float = 0.1, row: int | None = None) -> WrongRecord:
    return WrongRecord(
        run="hot", row=row, form="offset", quantity="temperature_degC", unit="degC", recorded=recorded,
        agreeing=(agreeing,), sd=(sd,),
    )  # fmt: skip


def ratio(form: str, quantity: str, value: float, sd: float = 1e-4, kind: str = "") -> WrongRecord:
    return WrongRecord.model_validate(
        {"run": "up", "form": form, "quantity": quantity, "unit": "1", "recorded": 1.0, "agreeing": (value,),
         "sd": (sd,), "kind": kind}
    )  # fmt: skip


def test_degrees_fahrenheit_are_named_at_their_value_alone():
    named, other = temperature(75.7, (75.7 - 32) / 1.8 + 0.1), temperature(59.51, 24.30)
    assert named.named is not None
    assert agreement_text(named).endswith("(recorded: 75.700), as if in degrees Fahrenheit")
    assert correction(named) == "replace T by (T - 32) / 1.8 in column 'temperature_degC' of run 'hot'"
    assert other.named is None, "15.3 °C would be 59.51 °F"
    assert correction(other) == "add -35.21 to column 'temperature_degC' of run 'hot'"


def test_a_name_is_told_only_while_it_is_likelier_than_the_open_value():
    """At 3 standard deviations a prior width of 300 of them speaks for the name, at 6 nothing does."""
    apart = [temperature(75.7, (75.7 - 32) / 1.8 + each, 0.1).named is not None for each in (0.0, 0.3, 0.6)]
    assert apart == [True, True, False]


@pytest.mark.parametrize(
    ("record", "name", "line"),
    [
        (
            ratio("factor", "table_rate_deg_s", 6.002, 2e-3), "in rpm",
            "multiply column 'table_rate_deg_s' of run 'up' by 6",
        ),
        (
            ratio("factor", "table_rate_deg_s", -1.0005, 1e-3), "with the opposite sign",
            "reverse the sign of column 'table_rate_deg_s' of run 'up'",
        ),
        (
            ratio("output_factor", "ay", 0.1001, 1e-4, "accelerometer"), "with a decimal place",
            "multiply column 'ay' of run 'up' by 0.1",
        ),
    ],
)  # fmt: skip
def test_units_and_signs_are_named_with_their_exact_factor(record: WrongRecord, name: str, line: str):
    assert agreement_text(record).endswith(f", as if {name}")
    assert correction(record).rstrip("0").rstrip(".") == line.rstrip("0").rstrip(".")


def test_a_factor_that_is_no_unit_is_no_unit():
    for value in (1.0211, 0.98, 3.0):
        assert ratio("factor", "table_rate_deg_s", value).named is None
    for gains in GAINS.values():
        assert all(abs(gain - 1) > 0.5 for gain in gains.values())
    assert all(abs(unit - 1) > 0.5 for unit in RATE_UNITS.values())


def test_every_form_has_words_and_a_line():
    seen = WrongRecord(run="a", form="samples", quantity="samples", unit="1", recorded=6e4, agreeing=(550.0,), sd=(90,))
    assert agreement_text(seen) == "about 550 ± 90 samples in each row (stated: 60000)"
    assert correction(seen) == "multiply column 'samples' of run 'a' by 0.0092"
    pair = WrongRecord(
        run="a", other="b", form="exchange", quantity="temperature_degC", unit="1", recorded=0.0, agreeing=(1.0,)
    )
    assert correction(pair) == "exchange column 'temperature_degC' of run 'a' and of run 'b'"
    unit = WrongRecord(run="a", form="unit", quantity="unit", unit="1", recorded=None, agreeing=())
    assert record_remedy(unit) == "name the file of this unit for run 'a', or leave the run out"
    row = temperature(20.0, 25.13, 0.11, row=3)
    assert record_remedy(row) == (
        "write 25.13 in column 'temperature_degC', row 3 of run 'hot' if the record confirms it, or leave the row out"
    )
    prior = WrongRecord(form="prior", quantity="b", unit="1", recorded=0.0, agreeing=(9.0,), sd=(1.0,))
    assert not correction(prior)


def test_two_hypotheses_are_the_same_by_place_and_value():
    one = temperature(59.51, 24.30)
    assert one.agrees_with(temperature(59.51, 24.6))
    assert not one.agrees_with(temperature(59.51, 26.0))
    assert not one.agrees_with(one.model_copy(update={"run": "cold"}))
    assert not one.agrees_with(one.model_copy(update={"row": 3}))
    angle = WrongRecord(
        run="a", form="offset", quantity="table_angle_deg", unit="deg", recorded=5.0, agreeing=(359.99,)
    )
    assert angle.agrees_with(angle.model_copy(update={"agreeing": (-0.01,)}))
    pair = WrongRecord(run="a", other="b", form="exchange", quantity="t", unit="1", recorded=0.0, agreeing=(1.0,))
    assert pair.agrees_with(pair.model_copy(update={"run": "b", "other": "a"}))
