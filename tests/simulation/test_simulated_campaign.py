"""Plans: what is simulated loads again, is recovered by the fit, and a bad plan is refused in four parts."""

import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from imubayes.campaign import load_campaign
from imubayes.foundations.errors import InputError
from imubayes.inference.laplace_marginal import knowledge
from imubayes.inference.parameter_fit import fit_at, linearise
from imubayes.inference.posterior_mode import find_mode
from imubayes.model.bind import bind
from imubayes.model.model_file import read_model
from imubayes.simulation.simulate import simulate, simulate_plan
from imubayes.simulation.test_plan import read_plan

ROOT = Path(__file__).parents[2]

PLAN = """\
format = 1
name = "planned"
model = "model.toml"
seed = 5

[truth]
"gyro_scale_factor.scale[gx]" = 250.0

[site]
latitude_deg = 34.25
height_m = 400.0

[[channel]]
name = "gx"
kind = "gyro"
input_axis = [1, 0, 0]
output_unit = "pulse/s"
scale = 1000.0
per = "deg/s"
noise = 8.0

[[channel]]
name = "ax"
kind = "accelerometer"
input_axis = [1, 0, 0]
output_unit = "pulse/s"
scale = 20000.0
per = "g"
noise = 2.0
current_mA_per_g = 1.2

[[table]]
name = "rate"
elevation_deg = 90.0

[[mounting]]
name = "x-up"
body_to_table = [[0, 1, 0], [0, 0, 1], [1, 0, 0]]
uncertainty_arcmin = 5.0

[[mounting]]
name = "pyramid"
preset = "trihedral"
uncertainty_arcmin = 5.0

[[run]]
name = "turning 1"
procedure = "rate_table"
table = "rate"
mounting = "x-up"
rates_deg_s = [0, 100, -100, 7, -7, 0]
converter_temperature_degC = [25.0, 25.0]

[[run]]
name = "turning 2"
procedure = "rate_table"
table = "rate"
mounting = "pyramid"
rates_deg_s = [0, 100, -100, 0]
converter_temperature_degC = [25.0, 25.0]

[[run]]
name = "standing"
procedure = "dividing_head"
table = "rate"
mounting = "x-up"
positions = 8
converter_temperature_degC = [25.0, 25.0]
samples = 400

[[run]]
name = "warming"
procedure = "thermal_ramp"
table = "rate"
mounting = "x-up"
converter_temperature_degC = [20.0, 50.0]
rate_degC_per_h = 30.0
rows = 10

[[run]]
name = "injected"
procedure = "current_injection"
current_mA = 12.0
converter_temperature_degC = [20.0, 50.0]
rate_degC_per_h = 30.0
seconds_per_row = 600.0
"""

EFFECTS = """\
mounting_error
gyro_bias
gyro_scale_factor
accel_bias
accel_scale_factor
converter_gain_drift
injection_error
white_noise
run_scatter"""


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    model = 'format = 1\nname = "model"\n' + "".join(f'[[effect]]\nname = "{one}"\n' for one in EFFECTS.split())
    (tmp_path / "model.toml").write_text(model)
    (tmp_path / "plan.toml").write_text(PLAN)
    return tmp_path / "plan.toml"


@pytest.fixture
def edit(plan: Path) -> Callable[[str, str], None]:
    def replace(old: str, new: str) -> None:
        text = plan.read_text()
        assert old in text
        plan.write_text(text.replace(old, new, 1))

    return replace


def files_in(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in sorted(folder.rglob("*")) if file.is_file()}


@pytest.mark.slow
def test_what_is_simulated_is_loaded_and_recovered(plan: Path):
    folder = simulate_plan(plan, plan.parent / "out")
    campaign = load_campaign(folder)
    truth = tomllib.loads((folder / "truth.toml").read_text())
    model = bind(read_model(plan.parent / "model.toml"), campaign)
    mode = find_mode(model.problem, jnp.zeros(len(model.layout)), jnp.zeros(len(model.hyper_layout)))
    assert bool(mode.converged)
    true_z, true_h = (
        layout.z_of([truth["parameters"][name] for name in layout.names])
        for layout in (model.layout, model.hyper_layout)
    )
    # At the true noise scales, of which few runs say little, χ² has as many degrees of freedom as there are parameters:
    # five standard deviations of it.
    z, h = fit_at(model.problem, mode.z, jnp.asarray(true_h)), jnp.asarray(true_h)
    miss = np.asarray(z) - true_z
    known = knowledge(model.problem, linearise(model.problem, z), h)
    square = miss @ (np.asarray(known.precision) + np.eye(len(miss))) @ miss
    size = len(miss)
    assert abs(square - size) < 5 * np.sqrt(2 * size)
    assert np.max(np.abs(np.asarray(mode.h) - true_h)) < 4


def test_the_uncertainty_of_a_temperature_is_written_back_and_has_a_truth(plan: Path, edit):
    stated = "converter_temperature_degC = [25.0, 25.0]"
    edit(stated, f"{stated}\nconverter_temperature_uncertainty_degC = 3.0")
    folder = simulate_plan(plan, plan.parent / "out")
    run, *others = load_campaign(folder).runs
    assert run.converter_temperature_uncertainty == 3.0
    assert all(other.converter_temperature_uncertainty is None for other in others)
    truth = tomllib.loads((folder / "truth.toml").read_text())["parameters"]
    (offset,) = (value for name, value in truth.items() if name.startswith("converter_thermometer_error"))
    assert 0 < abs(offset) < 12
    edit("converter_temperature_uncertainty_degC = 3.0", 'converter_thermometer = "Pt"')
    edit("[[run]]", '[[thermometer]]\nname = "Pt"\noffset_uncertainty_degC = 3.0\n\n[[run]]')
    read = load_campaign(simulate_plan(plan, plan.parent / "read"))
    assert (read.runs[0].converter_thermometer, read.thermometers["Pt"].offset_uncertainty) == ("Pt", 3.0)
    assert "converter_thermometer_calibration.offset[Pt]" in (plan.parent / "read" / "truth.toml").read_text()
    edit('converter_thermometer = "Pt"', "converter_temperature_uncertainty_degC = -3.0")
    with pytest.raises(InputError, match="converter_temperature_uncertainty_degC"):
        read_plan(plan)


def test_outputs_are_written_with_all_digits(plan: Path):
    folder = simulate_plan(plan, plan.parent / "out")
    planned = read_plan(plan)
    done = simulate(bind(read_model(planned.model), planned.campaign), 5, planned.file.truth)
    for simulated, loaded in zip(done.campaign.runs, load_campaign(folder).runs, strict=True):
        np.testing.assert_array_equal(simulated.observed, loaded.observed)
        for name, values in loaded.covariates.items():
            np.testing.assert_array_equal(simulated.covariates[name], values)


def test_same_seed_same_bytes(plan: Path):
    first = files_in(simulate_plan(plan, plan.parent / "first"))
    again = files_in(simulate_plan(plan, plan.parent / "again", 5))
    other = files_in(simulate_plan(plan, plan.parent / "other", 6))
    assert first == again
    assert all(first[name] != other[name] for name in first)


def test_truths_given_are_kept_and_disturb_no_other(plan: Path, edit):
    free = tomllib.loads((simulate_plan(plan, plan.parent / "a") / "truth.toml").read_text())
    assert free["parameters"]["gyro_scale_factor.scale[gx]"] == pytest.approx(250.0, rel=1e-12)
    assert free["units"]["gyro_scale_factor.scale"] == "ppm"
    edit('scale[gx]" = 250.0', 'scale[gx]" = -10.0\n"white_noise.sigma[gx]" = 7.5')
    fixed = tomllib.loads((simulate_plan(plan, plan.parent / "b") / "truth.toml").read_text())
    assert fixed["parameters"]["white_noise.sigma[gx]"] == pytest.approx(7.5, rel=1e-12)
    changed = {name for name, value in fixed["parameters"].items() if value != free["parameters"][name]}
    assert changed == {"gyro_scale_factor.scale[gx]", "white_noise.sigma[gx]"}


def test_noise_is_what_the_likelihood_assumes(plan: Path, edit):
    edit("positions = 8", "positions = 4000")
    edit('scale[gx]" = 250.0', 'scale[gx]" = 0.0\n"white_noise.sigma[ax]" = 2.0\n"run_scatter.tau[ax]" = 50.0')
    planned = read_plan(plan)
    model = bind(read_model(planned.model), planned.campaign)
    done = simulate(model, 1, planned.file.truth)
    place = [run.name for run in planned.campaign.runs].index("standing")
    # About a vertical axis an accelerometer along it reads the same at every angle.
    readings = done.campaign.runs[place].observed[:, 1]
    assert readings.std() == pytest.approx(2.0 / np.sqrt(400), rel=0.05)
    offsets = [value for (channel, _), value in done.offsets.items() if channel == "ax"]
    assert len(offsets) == 5
    assert 10 < np.std(offsets) < 120


def test_rows_are_what_the_plan_says(plan: Path):
    campaign = read_plan(plan).campaign
    turning, _, standing, warming, injected = campaign.runs
    turns = np.abs(turning.covariates["table_rate"][3]) / (2 * np.pi) * 2 * (360 / 7)
    assert turns == pytest.approx(2, abs=1e-9)
    assert np.isnan(turning.covariates["table_angle"]).tolist() == [False, True, True, True, True, False]
    np.testing.assert_allclose(np.degrees(standing.covariates["table_angle"]), 45.0 * np.arange(8))
    np.testing.assert_allclose(warming.covariates["converter_temperature"], 21.5 + 3.0 * np.arange(10))
    np.testing.assert_allclose(np.diff(warming.covariates["time"]), 360.0)
    assert injected.rows == 6
    np.testing.assert_allclose(injected.covariates["current"], 0.012)
    assert np.isnan(injected.observed[:, 0]).all()
    assert not np.isnan(injected.observed[:, 1]).any()


BAD_PLANS = [
    ('procedure = "dividing_head"', 'procedure = "free_tumble"', "'positions' does not apply", "poses"),
    ('procedure = "dividing_head"', 'procedure = "divided_head"', "cannot be simulated", "dividing_head"),
    ("positions = 8", "rates_deg_s = [10.0]", "does not apply", "positions"),
    ("positions = 8", "", "has no 'positions'", "angles_deg"),
    ("positions = 8", "positions = 8\nangles_deg = [1.0]", "both positions and angles_deg", "angles_deg"),
    ("rate_degC_per_h = 30.0\nrows = 10", "rate_degC_per_h = 30.0", "number of rows", "rows"),
    ("rows = 10", "rows = 10\nseconds_per_row = 60.0", "overdetermined", "rate_degC_per_h"),
    (
        "[20.0, 50.0]\nrate_degC_per_h = 30.0\nrows",
        "[20.0, 20.0]\nrate_degC_per_h = 30.0\nrows",
        "no temperature change",
        "two different values",
    ),
    ("positions = 8", "position = 8", "unknown key 'position'", "positions"),
    ("positions = 8", "positions = 0", "positions", "at least 1"),
    ('mounting = "x-up"\npositions', 'mounting = "x-down"\npositions', "'x-down'", "x-up"),
    ('table = "rate"\nmounting = "x-up"\npositions', 'mounting = "x-up"\npositions', "no 'table'", "rate"),
    ("noise = 8.0", "", "no noise", "standard deviation"),
    ("current_mA_per_g = 1.2", "", "current", "current_mA_per_g"),
    ('name = "standing"', 'name = "warming"', "given twice", "not yet used"),
    ('model = "model.toml"', 'model = "modell.toml"', "no file 'modell.toml'", "model.toml"),
    ("gyro_scale_factor.scale[gx]", "gyro_scale_factor.scale[gy]", "no parameter", "gyro_scale_factor.scale[gx]"),
    ('gyro_scale_factor.scale[gx]" = 250.0', 'white_noise.sigma[gx]" = -1.0', "outside the support", "output"),
    ("seed = 5", "seed = -5", "seed", "at least 0"),
]


@pytest.mark.parametrize(("old", "new", "what", "allowed"), BAD_PLANS)
def test_a_bad_plan_is_refused_in_four_parts(plan: Path, edit, old: str, new: str, what: str, allowed: str):
    edit(old, new)
    with pytest.raises(InputError) as refused:
        simulate_plan(plan, plan.parent / "out")
    problems = refused.value.issues
    found = [problem for problem in problems if what in problem.what]
    assert found, [problem.what for problem in problems]
    assert allowed in found[0].allowed
    assert ".toml" in found[0].where
    assert found[0].remedy
    assert sorted(path.name for path in plan.parent.iterdir()) == ["model.toml", "plan.toml"]


def test_an_occupied_folder_is_left_alone(plan: Path):
    out = plan.parent / "out"
    out.mkdir()
    (out / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match="not an empty folder"):
        simulate_plan(plan, out)
    assert files_in(out) == {"mine.txt": b"mine"}


def test_the_shipped_plan_is_sound():
    plan = read_plan(ROOT / "data/plans/trihedral-example.toml")
    assert bind(read_model(plan.model), plan.campaign).layout.names


def test_reading_campaigns_needs_no_jax():
    code = "import sys, imubayes.campaign, imubayes.simulation.test_plan; print('jax' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
