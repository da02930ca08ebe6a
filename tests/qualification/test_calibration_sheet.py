"""The first screen of `fit`: channels as columns in the fewest blocks, and every number that it shows."""

import io
import re

import pytest
from rich.console import Console

from display import synthetic_results as made
from imubayes.display.fit_report import summary_html, summary_report
from imubayes.display.layout import Report, print_report
from imubayes.display.quantity_tables import axis_sheet, calibration_sheets
from imubayes.foundations.units import BIAS_CONVENTION
from imubayes.results.summary import Summary, in_output_units
from imubayes_qualification.certificate.report_record import MonteCarloError, ResultLine
from imubayes_qualification.display.report.result_sections import axis_table

CHANNELS = (*made.GYROS, *made.ACCELEROMETERS)


@pytest.fixture(scope="module")
def summary() -> Summary:
    parameters, derived = made.trihedral_quantities()
    components = [
        made.quantity(f"input_axis[{channel},{component}]", "1", 0.5, 0.00023, 0.5)
        for channel in made.GYROS
        for component in "xyz"
    ]
    return made.summary_of(made.trihedral_residuals(), parameters, [*derived, *components])


def lines(report: Report, width: int) -> list[str]:
    buffer = io.StringIO()
    print_report(report, Console(file=buffer, width=width, color_system=None))
    return buffer.getvalue().splitlines()


def value(text: str) -> tuple[float, float]:
    """Return estimate and uncertainty of a cell, read from either form by itself."""
    text = text.rstrip("*")
    if "±" in text:
        estimate, sd = text.split("±")
        return float(estimate), float(sd)
    match = re.fullmatch(r"(-?[\d.]+)\(([\d.]+)\)", text)
    assert match, text
    decimals = len(match[1].partition(".")[2])
    return float(match[1]), float(match[2]) * (1 if "." in match[2] else 10.0**-decimals)


@pytest.mark.parametrize("width", [60, 80, 120, 200])
def test_every_number_of_a_channel_is_shown_once(summary, width):
    """Whatever the form and the number of blocks."""
    found = {}
    for sheet in calibration_sheets(summary):
        for block in sheet.blocks(width):
            for name, *cells, unit in block.rows:
                for channel, cell in zip(block.head[1:-1], cells, strict=True):
                    if cell.text:
                        key = f"{name.text}[{channel}]"
                        assert key not in found
                        found[key] = (cell.text, unit.text)
    wanted = {one.name: one for one in summary.parameters if one.name.partition("[")[2].removesuffix("]") in CHANNELS}
    assert set(found) == set(wanted)
    for name, (text, _) in found.items():
        estimate, sd = value(text)
        entry = wanted[name]
        assert entry.mean is not None
        assert entry.sd is not None
        assert sd == pytest.approx(entry.sd, rel=0.06)
        assert estimate == pytest.approx(entry.mean, abs=0.06 * entry.sd)


def test_blocks_are_as_few_as_the_width_allows(summary):
    gyros = calibration_sheets(summary)[0]
    assert [len(gyros.blocks(width)) for width in (200, 80, 50)] == [1, 1, 3]
    assert "±" in gyros.blocks(200)[0].rows[0][1].text
    assert "±" not in gyros.blocks(80)[0].rows[0][1].text
    for width in (60, 80, 120):
        assert max(map(len, lines(Report((), [gyros]), width))) <= width


def test_what_is_not_determined_is_marked_and_named(summary):
    bias = "gyro_bias.bias[gy]"
    loose = [one.model_copy(update={"from_data": 0.02}) if one.name == bias else one for one in summary.parameters]
    doubted = summary.model_copy(update={"parameters": tuple(loose)})
    (row,) = (line for line in lines(summary_report(doubted), 120) if line.startswith("gyro_bias.bias "))
    assert row.count("*") == 1
    assert bias in next(line for line in lines(summary_report(doubted), 120) if line.startswith("* Not determined"))
    assert not [line for line in lines(summary_report(summary), 120) if line.startswith("gyro_bias") and "*" in line]


def test_notebook_shows_the_calibration_of_each_channel_first(summary):
    page = summary_html(summary)
    assert page.index("Gyros") < page.index("Input axes") < page.index("<details")
    loose = [one.model_copy(update={"from_data": 0.0}) for one in summary.parameters]
    assert "* Not determined" in summary_html(summary.model_copy(update={"parameters": tuple(loose)}))


def test_output_units_are_those_of_the_channel(summary):
    of_output = [
        one.model_copy(update={"unit": "output"}) if one.name.startswith("white_noise") else one
        for one in summary.parameters
    ]
    shown = summary.model_copy(update={"parameters": tuple(of_output)})
    for verbose in (False, True):
        text = lines(summary_report(shown, verbose), 80)
        assert not [line for line in text if line.rstrip().endswith(" output")]
        assert any(line.startswith("white_noise.sigma") and line.rstrip().endswith("pulse/s") for line in text)
    assert ">output<" not in summary_html(shown)


def test_noise_of_a_servo_angle_is_an_angle(summary):
    (noise, *_) = (one for one in summary.parameters if one.name.startswith("white_noise"))
    angle = noise.model_copy(update={"name": "white_noise.sigma[table_angle]", "unit": "output"})
    shown = in_output_units(summary.model_copy(update={"parameters": (noise, angle)}))
    assert shown.parameters[1].unit == "deg"
    assert shown.parameters[0].unit != "deg"


def test_axes_are_vectors(summary):
    (block,) = axis_sheet(summary).blocks()
    assert [row[0].text for row in block.rows] == list(made.GYROS)
    assert [cell.text for cell in block.rows[0][1:]] == ["0.50000 ± 0.00023"] * 3
    assert "0.50000(23)" in "\n".join(lines(Report((), [axis_sheet(summary)]), 50))


def test_every_parameter_but_those_of_seats_is_on_the_first_screen(summary):
    tilt = made.quantity("table_axis_tilt.x[head]", "arcsec", -2.5, 0.4, 0.9)
    tilted = summary.model_copy(update={"parameters": (*summary.parameters, tilt)})
    text = "\n".join(lines(summary_report(tilted), 80))
    assert "table_axis_tilt.x[head]" in text
    assert "-2.50 ± 0.40 arcsec" in text
    shown = [entry.name for entry in tilted.parameters if entry.name.rpartition("[")[0] not in text]
    assert all(name.startswith("mounting_error.") for name in shown)


def test_the_report_states_every_component_with_its_uncertainty():
    """Also one that is as large as its uncertainty; what the draws do not support is withheld."""
    values = {"x": (1.0, None), "y": (0.00023, 2), "z": (0.00051, 0)}
    table = axis_table(
        [
            ResultLine(
                name=f"input_axis[gx,{component}]", unit="1", d_si=None, kind="derived", estimate=estimate,
                standard_uncertainty=0.00023 if digits is not None else 0.0, low=0.0, high=1.0, exact=digits is None,
                monte_carlo=None if digits is None else MonteCarloError(
                    estimate=0.0, standard_uncertainty=0.0, low=0.0, high=0.0, effective=100.0, digits=digits,
                    tolerance=1e-5, worst="mean", draws_needed=3.0,
                ),
            )
            for component, (estimate, digits) in values.items()
        ]
    )  # fmt: skip
    assert [cell.text for cell in table.rows[0]] == [
        "gx",
        "1.00000 (u = 0)",
        "0.00023 (u = 0.00023)",
        "withheld: too few draws",
    ]


def test_the_first_screen_is_short_and_the_whole_is_there(summary):
    brief, whole = (lines(summary_report(summary, verbose), 80) for verbose in (False, True))
    assert len(brief) < 100 < 170 < len(whole)
    text = "\n".join(whole)
    missing = [one.name for one in (*summary.parameters, *summary.derived) if f" {one.name} " not in text]
    assert missing == []
    assert any(line.startswith(" mounting_angle[gx,pyramid]") for line in brief)
    assert any("scale_factor[gx] against" in line or "of parameters weakly" in line for line in brief)


def test_a_fit_without_estimates_shows_none(summary):
    parameters, derived = made.without_estimates(summary.parameters), made.without_estimates(summary.derived)
    failed = summary.model_copy(update={"parameters": parameters, "derived": derived, "converged": False})
    text = "\n".join(lines(summary_report(failed), 80))
    assert text.startswith("NOT CONVERGED")
    assert "None" not in text


def test_what_a_bias_is_referred_to_stands_below_the_last_sheet(summary):
    notes = [block.note for sheet in calibration_sheets(summary) for block in sheet.blocks(60)]
    assert notes[-1] == BIAS_CONVENTION
    assert not any(notes[:-1])
    without = [entry for entry in summary.parameters if "_bias." not in entry.name]
    assert not any(
        sheet.note for sheet in calibration_sheets(summary.model_copy(update={"parameters": tuple(without)}))
    )
