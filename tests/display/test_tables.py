"""Tables: what is said first, what is marked, units on everything, and nothing unescaped."""

import io
import json
import subprocess
import sys
from collections import Counter

import pytest
import synthetic_results as made
from rich.console import Console

from imubayes.display.fit_quality_tables import (
    combination_sheet,
    fit_sheet,
    next_run_sheet,
    run_design_text,
    run_sheet,
    weak_sheet,
)
from imubayes.display.fit_report import summary_html
from imubayes.display.layout import Cell, Report, Sheet, report_text, terminal
from imubayes.display.quantity_tables import derived_sheet, parameter_sheet
from imubayes.inference.candidate_runs import RunDesign, TemperatureProfile
from imubayes.inference.identifiability import WeakDirection
from imubayes.results.summary import RunSummary, Summary


def text_of(sheet: Sheet, width: int = 160, **options) -> str:
    buffer = io.StringIO()
    Console(file=buffer, width=width, **options).print(terminal(sheet))
    return buffer.getvalue()


def words_of(sheet: Sheet, **options) -> str:
    """Return the text without line breaks and columns of blanks."""
    return " ".join(text_of(sheet, **options).split())


def changed(summary: Summary, **changes) -> Summary:
    """Return a summary of which the first entry of each list is changed as given, and plain values are replaced."""
    for name, value in changes.items():
        if isinstance(value, dict):
            first, *others = getattr(summary, name)
            changes[name] = (first.model_copy(update=value), *others)
    return summary.model_copy(update=changes)


@pytest.fixture
def summary() -> Summary:
    parameters = [
        made.parameter("gyro_bias.bias[gx]", "deg/h", 13.6168, 0.6123, 0.9996, r_hat=1.001, ess_bulk=900, ess_tail=800),
        made.parameter(
            "accel_quadratic.quadratic[ax]", "ug/g^2", 0.4, 19.7, 0.03, r_hat=1.0, ess_bulk=900, ess_tail=950
        ),
        made.parameter("pose_attitude.x[tumble,3]", "arcsec", 1.0, 1.0, 0.01, nuisance=True),
    ]
    derived = [made.quantity("mounting_angle[gx,pyramid]", "deg", 54.735612, 0.000361, 0.99999)]
    runs = [
        RunSummary(name="flat", channel="gx", n=20, chi2=19.0, rms=3e-5, unit="deg/s"),
        RunSummary(name="flat", channel="ax", n=20, chi2=95.0, rms=12e-6, unit="g"),
        RunSummary(name="tilted", channel="gx", n=20, chi2=2.0, rms=0.02, unit="deg/s"),
        RunSummary(name="tilted", channel="ax", n=0, chi2=None, rms=None, unit="g"),
    ]
    residuals = made.tumble_residuals(4)
    return made.summary_of(residuals, parameters, derived, runs=tuple(runs), chi2=116.0, dof=57)


def test_parameters_are_rounded_with_units_interval_and_share(summary):
    text = text_of(parameter_sheet(summary))
    assert "95 % equal-tailed" in text
    row = next(line for line in text.splitlines() if "gyro_bias" in line)
    assert row.split() == ["gyro_bias.bias[gx]", "13.62", "0.61", "12.42", "…", "14.82", "deg/h", "99.96", "%"]


def test_the_temperature_of_a_run_is_shown_where_the_data_tell_it(summary):
    of_runs = [
        made.parameter("thermometer_error.offset[warm]", "degC", 20.7, 0.3, 0.99, nuisance=True),
        made.parameter("thermometer_error.offset[steady]", "degC", 0.01, 0.49, 0.02, nuisance=True),
    ]
    text = text_of(parameter_sheet(summary.model_copy(update={"parameters": (*summary.parameters, *of_runs)})))
    assert "thermometer_error.offset[warm]" in text
    assert "thermometer_error.offset[steady]" not in text
    assert "2 nuisance parameters" in text


def test_what_the_data_did_not_determine_is_marked(summary):
    text = text_of(parameter_sheet(summary))
    row = next(line for line in text.splitlines() if "accel_quadratic" in line)
    assert "µg/g²" in row
    assert "3 %, not determined" in row
    assert "not determined" not in next(line for line in text.splitlines() if "gyro_bias" in line)
    assert "1 of 2 not determined" in words_of(parameter_sheet(summary))
    assert "pose_attitude" not in text


def test_words_give_way_before_names_and_numbers(summary):
    name = "accel_misalignment.toward_o[ax]"
    added = made.parameter(name, "arcsec", 1e-5, 9.9e-4, 0.01, r_hat=1.0)
    summary = changed(summary, parameters=(*summary.parameters, added))
    narrow = text_of(parameter_sheet(summary), width=80)
    assert f" {name} " in narrow
    assert "0.00001 ± 0.00099 arcsec" in narrow
    assert "1 %, not determined" not in narrow
    folded = text_of(parameter_sheet(summary), width=60)
    assert f" {name} " not in folded
    assert "1 %, not" in folded


def test_what_did_not_converge_comes_first_and_red(summary):
    message = "The ensembles disagree on gyro_bias.bias[gx]."
    summary = changed(summary, converged=False, message=message, parameters={"r_hat": 1.4})
    for sheet in (parameter_sheet(summary), derived_sheet(summary), run_sheet(summary), fit_sheet(summary)):
        assert words_of(sheet).startswith("NOT CONVERGED. The ensembles disagree on gyro_bias.bias[gx].")
        coloured = text_of(sheet, force_terminal=True, color_system="standard")
        assert coloured.lstrip().startswith("\x1b[1;31m")
    text = text_of(parameter_sheet(summary))
    assert "R-hat" in text
    assert "1.400" in text
    assert summary_html(summary).index("NOT CONVERGED") < summary_html(summary).index("<table")


def test_convergence_columns_are_left_out_where_all_is_well(summary):
    text = words_of(parameter_sheet(summary))
    assert "R-hat at most 1.001, effective sizes at least 800" in text
    assert "ESS" not in text


def test_numbers_of_a_failed_fit_are_dashes(summary):
    parameters, derived = made.without_estimates(summary.parameters), made.without_estimates(summary.derived)
    summary = changed(summary, parameters=parameters, derived=derived, converged=False, message="", sampled=False)
    text = text_of(parameter_sheet(summary))
    assert "NOT CONVERGED" in text
    assert "–" in next(line for line in text.splitlines() if "gyro_bias" in line)
    assert "None" not in text
    assert "None" not in summary_html(summary)


def test_runs_tell_fit_and_size_in_readable_units(summary):
    rows = [line.split() for line in text_of(run_sheet(summary)).splitlines()]
    assert ["flat", "gx", "20", "0.95", "0.108", "deg/h"] in rows
    assert ["ax", "20", "4.75", "12.0", "µg"] in rows
    assert ["tilted", "gx", "20", "0.10", "0.0200", "deg/s"] in rows
    assert ["ax", "0", "–", "–", "µg"] in rows or ["ax", "0", "–", "–", "g"] in rows
    assert "1 of 3 values of χ² is too large" in words_of(fit_sheet(summary))


def test_rows_in_need_of_attention_survive_a_limit(summary):
    text = words_of(parameter_sheet(summary, most=1))
    assert "accel_quadratic" in text
    assert "gyro_bias" not in text
    assert "1 more row is in summary.json" in text


def test_a_narrow_terminal_cuts_no_number(summary):
    wide, narrow = text_of(parameter_sheet(summary), 160), text_of(parameter_sheet(summary), 72)
    assert "12.42 … 14.82" in wide
    assert "13.62 ± 0.61 deg/h" in narrow
    assert max(map(len, narrow.splitlines())) <= 72


def test_weak_directions_and_next_runs(summary):
    assert "2 %" in text_of(weak_sheet(summary))
    assert "1.3 → 0.76 arcsec" in text_of(next_run_sheet(summary))
    assert "every combination" in words_of(weak_sheet(changed(summary, weak_directions=())))


def test_weak_directions_are_written_where_they_are_shown(summary):
    shown = " ".join(text_of(weak_sheet(summary)).split())
    assert "mounting_error.z[x-up] − 0.87·mounting_error.z[y-up] and 2 more" in shown
    confusion = WeakDirection(quantities=("scale_factor[gx]", "k"), kind="confusion", from_data=0.0)
    assert "scale_factor[gx] against k" in text_of(weak_sheet(changed(summary, weak_directions=(confusion,))))


def test_determined_combinations_have_symbol_members_estimate_interval_and_unit(summary):
    wide = " ".join(text_of(combination_sheet(summary), 220).split())
    assert "D_F+D_II[gx] gyro_bias.bias[gx] + gyro_g2_sensitivity.d_ii[gx] 0.7087 0.0021 0.7046 … 0.7128 deg/h" in wide
    assert "k′[gx,pyramid] scale_factor[gx]·cos(mounting_angle[gx,pyramid]) 577.350 0.012" in wide
    assert "gyro_bias.bias[gy] − 0.563·gyro_g_sensitivity.d_i[gy] 0.310 0.011" in wide
    assert "D_F+D_II[gx]" in summary_html(summary)
    narrow = text_of(combination_sheet(summary), 72)
    assert "0.7087 ± 0.0021 deg/h" in narrow
    assert max(map(len, narrow.splitlines())) <= 72


def test_combinations_survive_the_file(summary):
    stored = json.loads(summary.json_text())
    assert stored["weak_directions"][0]["combination"] == "mounting_error.z[x-up]-0.87·mounting_error.z[y-up]"
    assert Summary.model_validate(stored) == summary


@pytest.mark.parametrize(
    ("design", "text"),
    [
        (
            RunDesign(procedure="rate_table", table="rate", mounting="x-up", repeated=True, max_rate_deg_s=300.0),
            "one more rate_table on 'rate' in mounting 'x-up', rates to ±300 deg/s",
        ),
        (
            RunDesign(procedure="dividing_head", table="head", mounting="x-up", another_table=True, positions=12),
            "dividing_head on another table than 'head' in mounting 'x-up', 12 positions",
        ),
        (
            RunDesign(
                procedure="current_injection", current_mA=12.0, specific_force_g=10.0,
                temperature=TemperatureProfile(
                    covariate="converter_temperature", form="ramp", low_degC=15.0, high_degC=45.0
                ),
            ),
            "current_injection, current 12 mA (10 g), converter temperature ramped from 15 to 45 degC",
        ),
        (
            RunDesign(
                procedure="thermal_ramp",
                temperature=TemperatureProfile(
                    covariate="temperature", form="cycle", low_degC=-10.0, high_degC=40.0, hours=2.0
                ),
            ),
            "thermal_ramp, temperature cycled within 2 h from -10 to 40 degC, held, and back three times slower",
        ),
    ],
)  # fmt: skip
def test_a_run_that_could_be_made_in_words(design, text):
    assert run_design_text(design) == text


def test_html_is_escaped_and_self_contained(summary):
    hostile = "<script>alert('&')</script>"
    summary = changed(
        summary,
        campaign=hostile,
        parameters={"name": f"gyro_bias.bias[{hostile}]"},
        runs={"name": hostile, "channel": "<b>"},
        notes=(hostile,),
        weak_directions={"quantities": (hostile,), "weights": (1.0,)},
        combinations={"name": hostile},
        next_runs={"run": RunDesign(procedure="rate_table", mounting=hostile)},
    )
    page = summary_html(summary)
    assert "<script" not in page
    assert "<b>]" not in page
    assert page.count("&lt;script&gt;alert(&#39;&amp;&#39;)&lt;/script&gt;") >= 5
    assert "http" not in page
    assert page.count("<table") == page.count("</table>") == 7


def test_names_with_brackets_are_not_taken_for_markup(summary):
    assert "[red]flat[/red]" in text_of(run_sheet(changed(summary, runs={"name": "[red]flat[/red]"})))


@pytest.mark.compiled  # processes
def test_tables_do_without_matplotlib():
    code = "import sys, imubayes.display.layout, imubayes.display.fit_report; print('matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_headings_wrap_before_a_cell_is_cut():
    head = ("model", "residual / deg/h", "residual / µg", "Δ elpd")
    row = [Cell("● └─ + gyro_scale_asymmetry"), Cell("2.14"), Cell("6.48"), Cell("+303 ± 88 (7/7 runs)")]
    text = report_text(Report((), [Sheet("Models tried", head, [row])]), width=80)
    assert "+303 ± 88 (7/7 runs)" in text
    assert max(map(len, text.splitlines())) <= 80


def test_what_does_not_fit_is_wrapped_and_not_lost():
    """Rich crops a cell whose column became narrower than its words; a unit without its 'per' is another unit."""
    rows = [[Cell("scale_factor[gx]"), Cell("dividing_head"), Cell("0.0050"), Cell("8.4 → 7.1"), Cell("pulse/s per g")]]
    sheet = Sheet("Contribution", ("quantity", "best alone", "sd", "now → after", "unit"), rows, (0, 1, 4))
    for width in range(24, 90):
        shown = "".join(text_of(sheet, width).split())
        letters = Counter("".join("".join(cell.text.split()) for cell in rows[0]))
        assert not letters - Counter(shown), width
    assert "8.4 → 7.1" in text_of(sheet, 66)
