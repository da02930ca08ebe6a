"""Tables: what is said first, what is marked, units on everything, and nothing unescaped."""

import io
import subprocess
import sys

import pytest
import synthetic_results as made
from rich.console import Console
from rich.table import Table

from imubayes.display.html import summary_html
from imubayes.display.terminal_tables import (
    derived_table,
    fit_table,
    next_run_table,
    parameter_table,
    run_table,
    weak_table,
)


def text_of(table: Table, width: int = 160, **options) -> str:
    buffer = io.StringIO()
    Console(file=buffer, width=width, **options).print(table)
    return buffer.getvalue()


def words_of(table: Table, **options) -> str:
    """Return the text without line breaks and columns of blanks."""
    return " ".join(text_of(table, **options).split())


@pytest.fixture
def summary() -> dict:
    parameters = [
        made.quantity("gyro_bias.bias[gx]", "deg/h", 13.6168, 0.6123, 0.9996, r_hat=1.001, ess_bulk=900, ess_tail=800),
        made.quantity(
            "accel_quadratic.quadratic[ax]", "ug/g^2", 0.4, 19.7, 0.03, r_hat=1.0, ess_bulk=900, ess_tail=950
        ),
        made.quantity("pose_attitude.x[tumble,3]", "arcsec", 1.0, 1.0, 0.01, nuisance=True),
    ]
    derived = [made.quantity("mounting_angle[gx,pyramid]", "deg", 54.735612, 0.000361, 0.99999)]
    runs = [
        {"name": "flat", "channel": "gx", "n": 20, "chi2": 19.0, "rms": 3e-5, "unit": "deg/s"},
        {"name": "flat", "channel": "ax", "n": 20, "chi2": 95.0, "rms": 12e-6, "unit": "g"},
        {"name": "tilted", "channel": "gx", "n": 20, "chi2": 2.0, "rms": 0.02, "unit": "deg/s"},
        {"name": "tilted", "channel": "ax", "n": 0, "chi2": None, "rms": None, "unit": "g"},
    ]
    residuals = made.tumble_residuals(4)
    return made.summary_of(residuals, parameters, derived, runs=runs, chi2=116.0, dof=57)


def test_parameters_are_rounded_with_units_interval_and_share(summary):
    text = text_of(parameter_table(summary))
    assert "95 % equal-tailed" in text
    row = next(line for line in text.splitlines() if "gyro_bias" in line)
    assert row.split() == ["gyro_bias.bias[gx]", "13.62", "0.61", "12.42", "…", "14.82", "deg/h", "99.96", "%"]


def test_what_the_data_did_not_determine_is_marked(summary):
    text = text_of(parameter_table(summary))
    row = next(line for line in text.splitlines() if "accel_quadratic" in line)
    assert "µg/g²" in row
    assert "3 %, not determined" in row
    assert "not determined" not in next(line for line in text.splitlines() if "gyro_bias" in line)
    assert "1 of 2 not determined" in words_of(parameter_table(summary))
    assert "pose_attitude" not in text


def test_words_give_way_before_names_and_numbers(summary):
    name = "accel_misalignment.toward_o[ax]"
    summary["parameters"].append(made.quantity(name, "arcsec", 1e-5, 9.9e-4, 0.01))
    narrow = text_of(parameter_table(summary), width=80)
    assert f" {name} " in narrow
    assert "0.00001 ± 0.00099 arcsec" in narrow
    assert "1 %, not determined" not in narrow
    folded = text_of(parameter_table(summary), width=60)
    assert f" {name} " not in folded
    assert "1 %, not" in folded


def test_what_did_not_converge_comes_first_and_red(summary):
    summary |= {"converged": False, "message": "The ensembles disagree on gyro_bias.bias[gx]."}
    summary["parameters"][0]["r_hat"] = 1.4
    for table in (parameter_table(summary), derived_table(summary), run_table(summary), fit_table(summary)):
        assert words_of(table).startswith("NOT CONVERGED. The ensembles disagree on gyro_bias.bias[gx].")
        coloured = text_of(table, force_terminal=True, color_system="standard")
        assert coloured.lstrip().startswith("\x1b[1;31m")
    text = text_of(parameter_table(summary))
    assert "R-hat" in text
    assert "1.400" in text
    assert summary_html(summary).index("NOT CONVERGED") < summary_html(summary).index("<table")


def test_convergence_columns_are_left_out_where_all_is_well(summary):
    text = words_of(parameter_table(summary))
    assert "R-hat at most 1.001, effective sizes at least 800" in text
    assert "ESS" not in text


def test_numbers_of_a_failed_fit_are_dashes(summary):
    for entry in (*summary["parameters"], *summary["derived"]):
        entry |= dict.fromkeys(("mean", "sd", "q025", "q975", "from_data", "r_hat", "ess_bulk", "ess_tail"))
    summary |= {"converged": False, "message": "", "sampled": False}
    text = text_of(parameter_table(summary))
    assert "NOT CONVERGED" in text
    assert "–" in next(line for line in text.splitlines() if "gyro_bias" in line)
    assert "None" not in text
    assert "None" not in summary_html(summary)


def test_runs_tell_fit_and_size_in_readable_units(summary):
    rows = [line.split() for line in text_of(run_table(summary)).splitlines()]
    assert ["flat", "gx", "20", "0.95", "0.108", "deg/h"] in rows
    assert ["ax", "20", "4.75", "12.0", "µg"] in rows
    assert ["tilted", "gx", "20", "0.10", "0.0200", "deg/s"] in rows
    assert ["ax", "0", "–", "–", "µg"] in rows or ["ax", "0", "–", "–", "g"] in rows
    assert "1 of 3 lies above what noise alone would give" in words_of(fit_table(summary))


def test_rows_in_need_of_attention_survive_a_limit(summary):
    text = words_of(parameter_table(summary, most=1))
    assert "accel_quadratic" in text
    assert "gyro_bias" not in text
    assert "1 more row is in summary.json" in text


def test_a_narrow_terminal_cuts_no_number(summary):
    wide, narrow = text_of(parameter_table(summary), 160), text_of(parameter_table(summary), 72)
    assert "12.42 … 14.82" in wide
    assert "13.62 ± 0.61 deg/h" in narrow
    assert max(map(len, narrow.splitlines())) <= 72


def test_weak_directions_and_next_runs(summary):
    assert "2 %" in text_of(weak_table(summary))
    assert "1.3 → 0.76 arcsec" in text_of(next_run_table(summary))
    assert "every combination" in words_of(weak_table(summary | {"weak_directions": []}))


def test_html_is_escaped_and_self_contained(summary):
    hostile = "<script>alert('&')</script>"
    summary["campaign"] = hostile
    summary["parameters"][0]["name"] = f"gyro_bias.bias[{hostile}]"
    summary["runs"][0] |= {"name": hostile, "channel": "<b>"}
    summary["notes"] = [hostile]
    summary["weak_directions"][0]["combination"] = hostile
    summary["next_runs"][0]["run"] = hostile
    page = summary_html(summary)
    assert "<script" not in page
    assert "<b>]" not in page
    assert page.count("&lt;script&gt;alert(&#x27;&amp;&#x27;)&lt;/script&gt;") >= 5
    assert "http" not in page
    assert page.count("<table") == page.count("</table>") == 5


def test_names_with_brackets_are_not_taken_for_markup(summary):
    summary["runs"][0]["name"] = "[red]flat[/red]"
    assert "[red]flat[/red]" in text_of(run_table(summary))


def test_tables_do_without_matplotlib():
    code = "import sys, imubayes.display.terminal_tables, imubayes.display.html; print('matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
