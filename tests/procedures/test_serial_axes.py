"""Tables of several axes and centrifuges: kinematics and textbook against attitude and place differentiated in time.

The simulator of `data/generators` composes rotations for a few instants and takes differences; it knows no formula of
rates or accelerations.
"""

import re
from dataclasses import replace

import centrifuge
import multi_axis_table
import numpy as np
import pytest
import serial_table
from kinematics import Site as GeneratorSite
from kinematics import rotation
from serial_table import Pose, SerialTable

from imubayes.campaign import inspect_campaign, load_campaign
from imubayes.foundations.campaign_data import Campaign, Mounting, Run, Site, Table
from imubayes.foundations.errors import InputError
from imubayes.procedures import classical
from imubayes.procedures.kinematics import felt, row_means, serial_stimulus, turning_rate
from imubayes.procedures.textbook import Estimate, Undetermined

TABLE_ERRORS = (
    "mounting_error",
    "table_",
    "outer_",
    "middle_",
    "inner_",
    "platform_",
    "arm_",
    "lever_arm",
    "run_scatter",
)

# A gyro's axes are not separable on the centrifuge: the Earth rate along the third one is no matter of 1 mdeg/h.
ASSUMED_ZERO = {multi_axis_table: (), centrifuge: ("gyro_misalignment",)}


def direction(rng) -> tuple[float, float, float]:
    vector = rng.normal(size=3)
    x, y, z = (float(component) for component in vector / np.linalg.norm(vector))
    return x, y, z


def package_felt(table: SerialTable, seat: np.ndarray, site: GeneratorSite, pose: Pose):
    """Return inertial rate and specific force of the package at one instant, angles in rad, (3,) each."""
    names = ("outer", "middle", "table")
    covariates = {f"{name}_angle": np.array([np.radians(pose.angle[k])]) for k, name in enumerate(names)}
    covariates |= {f"{name}_rate": np.array([np.radians(pose.rate[k])]) for k, name in enumerate(names)}
    run = Run("one", "multi_axis_table", "t", "m", covariates, np.zeros((1, 0)), np.ones(1), np.zeros((1, 0)))
    known = Table(
        "t", np.radians(table.azimuth_deg), np.radians(table.elevation_deg), middle_axis=table.middle_axis,
        inner_axis=table.inner_axis, arm=table.arm_radius_m or 0.0,
    )  # fmt: skip
    place = Site(np.radians(site.latitude_deg), site.height_m, site.gravity)
    campaign = Campaign("c", place, (), {"t": known}, {"m": Mounting("m", seat)}, (run,))
    stimulus = serial_stimulus(run, campaign)
    rate, force = felt(stimulus, place)
    return rate[0], force[0], turning_rate(stimulus)[0]


@pytest.mark.parametrize("seed", range(6))
def test_axes_in_any_direction_turning_together(seed):
    """Two axes, three axes and arms, in any direction, all turning at once: to the rounding of the differences."""
    rng = np.random.default_rng(seed)
    table = SerialTable(
        "t", rng.uniform(-180, 180), rng.uniform(-90, 90), inner_axis=direction(rng),
        middle_axis=direction(rng) if seed % 2 else None, arm_radius_m=1.3 if seed % 3 else None,
    )  # fmt: skip
    site, seat = GeneratorSite(48.0, 200.0), rotation(rng.normal(size=3))
    free = np.array([1.0, float(seed % 2), 1.0])
    pose = Pose(tuple(rng.uniform(-180, 180, 3) * free), tuple(rng.uniform(-300, 300, 3) * free))
    chain = serial_table.Chain(table, _seat(seat), {}, site.gravity)
    rate, force = (values[0] for values in serial_table.felt(chain, pose, site, np.zeros(1), np.zeros(3)))
    found_rate, found_force, turning = package_felt(table, seat, site, pose)
    np.testing.assert_allclose(found_rate, rate, atol=1e-9)
    np.testing.assert_allclose(found_force, force, atol=3e-7)
    attitude = chain.at(pose, np.zeros(1), np.zeros(3))[0][0]
    np.testing.assert_allclose(turning, rate - attitude.T @ site.earth_rate, atol=1e-9)


def test_the_coriolis_acceleration_is_in_it():
    """2 ω_E × v at 10 rad/s on 1 m is 0.15 mg: a formula without it fails by a thousand times the tolerance above."""
    site = GeneratorSite(48.0, 200.0)
    pose = Pose((0.0, 0.0, 0.0), (np.degrees(10.0), 0.0, 0.0))
    _, force, _ = package_felt(centrifuge.TABLE, np.eye(3), site, pose)
    vertical = site.earth_rate[2]
    assert force[0] == pytest.approx(-(10.0**2 + 2 * 10.0 * vertical), abs=1e-9)
    assert 2 * 10.0 * vertical > 1e-3


def _seat(matrix):
    return multi_axis_table.Mounting("m", matrix, 0.0)


def generated(module, folder, seed, exact=TABLE_ERRORS, **more):
    """Return a campaign of a generator with some effects at nothing, and the truth.

    Axes lean by a tenth of what the model has them: to second order they change the scale factor.
    """
    drawn = {
        name: value * (0.1 if "misalignment" in name else 1.0)
        for name, value in serial_table.drawn(module.plan(), seed).items()
    }
    values = {name: 0.0 if name.startswith(exact) else value for name, value in drawn.items()} | more
    module.generate(folder / str(seed), seed, values)
    return load_campaign(folder / str(seed)), values


def estimates(campaign):
    return [one for one in classical(campaign) if isinstance(one, Estimate)]


PARTS = re.compile(r"([+-]?)([0-9.]*)·?(D_[A-Z]+)")


def of_truth(name, truth, channels):
    """Return the true value of an estimate: of a parameter, a scale factor, or a sum such as D_F+D_SS; 0 if none."""
    values = truth | serial_table.truth.scale_factors(channels, truth)
    symbols, _, label = name.partition("[")
    if not symbols.startswith("D_"):
        assert name in values or symbols.startswith(("accel_", "gyro_g2")), name
        return values.get(name, 0.0)
    assert "".join("".join(part) for part in PARTS.findall(symbols)) == symbols.replace("·", "")
    total = 0.0
    for sign, factor, symbol in PARTS.findall(symbols):
        letters = symbol.removeprefix("D_").lower()
        effect = "gyro_g_sensitivity" if len(letters) == 1 else "gyro_g2_sensitivity"
        parameter = "gyro_bias.bias" if letters == "f" else f"{effect}.d_{letters}"
        total += float(sign + (factor or "1")) * values.get(f"{parameter}[{label}", 0.0)
    return total


@pytest.mark.parametrize(
    "module",
    [
        pytest.param(multi_axis_table, marks=pytest.mark.slow, id="multi_axis_table"),
        pytest.param(centrifuge, id="centrifuge"),
    ],
)
def test_the_textbook_is_right_where_its_assumptions_hold(module, tmp_path):
    scores, names = [], set()
    for seed in range(5):
        campaign, truth = generated(module, tmp_path, seed, (*TABLE_ERRORS, *ASSUMED_ZERO[module]))
        for one in estimates(campaign):
            scores.append((one.value - of_truth(one.name, truth, module.CHANNELS)) / one.sd)
            names.add(one.name.split("[")[0])
    scores = np.array(scores)
    assert len(scores) > 80
    assert 0.8 < np.sqrt(np.mean(scores**2)) < 1.2
    assert np.sqrt(np.mean((1.5 * scores) ** 2)) > 1.2
    assert {"scale_factor", "accel_bias.bias", "accel_quadratic.quadratic"} <= names
    further = {"accel_cubic.cubic", "accel_odd_quadratic.odd_quadratic", "gyro_g2_sensitivity.d_ii", "D_F+D_S"}
    assert (further if module is centrifuge else {"D_F+D_SS", "gyro_g_sensitivity.d_i"}) <= names


def test_the_radius_of_the_arm_is_an_error_of_k1_and_its_stretch_one_of_k_oq(tmp_path):
    """100 µm of 1 m are 100 ppm; a stretch of 5 µm/g adds 5 ppm/g·a, with the sign of a."""
    plain, _ = generated(centrifuge, tmp_path / "plain", 1)
    wrong = {"arm_error.radius[centrifuge]": 100.0, "arm_error.stretch[centrifuge]": 5.0}
    longer, _ = generated(centrifuge, tmp_path / "longer", 1, **wrong)
    fixed = [run.name for run in plain.runs if run.name.startswith("fixed")]
    one, other = ({e.name: e.value for e in estimates(each.only(*fixed))} for each in (plain, longer))
    assert other["scale_factor[a]"] / one["scale_factor[a]"] - 1 == pytest.approx(1e-4, abs=5e-6)
    name = "accel_odd_quadratic.odd_quadratic[a]"
    assert other[name] - one[name] == pytest.approx(5.0, abs=0.5)
    assert other["accel_quadratic.quadratic[a]"] - one["accel_quadratic.quadratic[a]"] == pytest.approx(0.0, abs=0.1)
    said = [each.sentence for each in classical(longer) if isinstance(each, Undetermined)]
    assert any("radius of the arm" in sentence and "stretch" in sentence for sentence in said)


def test_positions_leave_what_they_cannot_separate_open(tmp_path):
    """In 24 positions one axis at a time sees ±1 g: cubes and products are not separable, and are named."""
    campaign, _ = generated(multi_axis_table, tmp_path, 2)
    found = classical(campaign.only("upright", "sideways"))
    names = {one.name for one in found if isinstance(one, Estimate)}
    assert {"accel_bias.bias[ax]", "accel_misalignment.toward_o[ax]", "accel_quadratic.quadratic[ax]"} <= names
    assert not {"accel_cubic.cubic[ax]", "accel_cross_coupling.k_io[ax]"} & names
    assert any("K3" in one.sentence for one in found if isinstance(one, Undetermined))


@pytest.fixture
def folder(tmp_path):
    multi_axis_table.generate(tmp_path / "campaign", 4)
    return tmp_path / "campaign"


def changed(folder, old, new, file="campaign.toml"):
    path = folder / file
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    return [issue.what for issue in inspect_campaign(folder).issues]


def test_the_directions_of_the_axes_must_be_stated(folder):
    text = (folder / "campaign.toml").read_text()
    (folder / "campaign.toml").write_text(text.replace("middle_axis = [1.0, 0.0, 0.0]\n", ""))
    whats = changed(folder, "inner_axis = [0.0, 0.0, 1.0]\n", "")
    assert "table 'three-axis' of run 'upright' states no inner axis" in whats


def test_a_middle_axis_without_an_inner_one_is_refused(folder):
    (what, *_) = changed(folder, "inner_axis = [0.0, 0.0, 1.0]\n", "")
    assert "have an 'inner_axis'" in what


def test_an_axis_has_a_direction(folder):
    (what, *_) = changed(folder, "inner_axis = [0.0, 0.0, 1.0]", "inner_axis = [0.0, 0.0, 0.0]")
    assert "zero vector" in what


def test_a_raw_log_is_refused(folder):
    whats = changed(folder, ",samples,", ",power_on_s,", "runs/upright.csv")
    assert "a run of procedure 'multi_axis_table' needs the column 'samples'" in whats


def test_a_centrifuge_has_an_arm(tmp_path):
    centrifuge.generate(tmp_path / "c", 1)
    whats = changed(tmp_path / "c", "arm_radius_m = 1.0\n", "")
    assert "the centrifuge 'centrifuge' has no arm" in whats


def test_two_axes_at_unknown_angles_are_refused(folder):
    campaign = load_campaign(folder)
    run = campaign.runs[-1]
    blank = {name: np.full(run.rows, np.nan) for name in ("outer_angle", "middle_angle")}
    blind = replace(run, covariates={**run.covariates, **blank})
    with pytest.raises(InputError, match="two axes whose angles are both unknown"):
        serial_stimulus(blind, campaign)


def test_means_over_whole_turns_need_no_angle_and_arcs_do(folder):
    """An axis that turns alone averages over all its angles; of the others, and of arcs, the angle counts."""
    campaign = load_campaign(folder)
    for name, axis, differs in (("outer", "outer", False), ("held", "middle", True), ("together", "middle", True)):
        run = campaign.only(name).runs[0]
        turned = {**run.covariates, f"{axis}_angle": run.covariates[f"{axis}_angle"] + 1.0}
        means = []
        for each in (run, replace(run, covariates=turned)):
            stimulus = serial_stimulus(each, campaign)
            means.append(row_means(stimulus, felt(stimulus, campaign.site)[1]))
        rows = run.covariates["outer_rate"] != 0
        assert bool(np.abs(means[0][rows] - means[1][rows]).max() > 1e-3) is differs
