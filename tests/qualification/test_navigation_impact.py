"""Navigation errors of a mission: closed forms at rest, and a strapdown mechanisation of its own on a trajectory."""

import math

import numpy as np
import polars as pl
import pytest

from imubayes.foundations.errors import InputError
from imubayes_qualification.onboard.navigation_impact import (
    COLUMNS,
    Mission,
    level_mission,
    navigation_impact,
    read_mission,
)
from imubayes_qualification.onboard.record import (
    Constant,
    OnboardConstants,
    ThermalPolynomial,
    ThermalPowers,
    TriadConstants,
)

RADIUS, RATE, G = 6_371_008.8, 7.292115e-5, 9.81
SHORT = math.radians(45)


def triad(kind: str, noise: float = 0.0, offset: float = 0.0) -> TriadConstants:
    eye = tuple(map(tuple, np.eye(3).tolist()))
    plain = ThermalPolynomial(terms=(ThermalPowers(sensor=0, converter=0),), coefficients=((0.0,),) * 3)
    return TriadConstants(
        kind=kind, unit="", channels=tuple(f"{kind[0]}{axis}" for axis in "xyz"), output_units=("",) * 3,
        nominal_scale=(1.0,) * 3, nominal_offset=(0.0,) * 3, matrix=eye, bias=plain,
        gain=ThermalPolynomial(terms=(), coefficients=((),) * 3), g_sensitivity=None, input_range=1.0, error_left=0.0,
        sample_noise=(noise,) * 3, run_offset=(offset,) * 3,
    )  # fmt: skip


def constants(sds: dict[str, float], noise: float = 0.0, kinds=("accelerometer", "gyro")) -> OnboardConstants:
    """Return the constants of an ideal unit, some of which are uncertain, independently."""
    triads = [triad(kind, noise if kind == "gyro" else 0.0) for kind in kinds]
    names = [
        name
        for each in triads
        for name in (
            *(f"M[{axis},{of}]" for axis in "xyz" for of in each.channels),
            *(f"bias[{c}]" for c in each.channels),
        )
    ]
    found = [
        Constant(name=name, unit="", value=0.0, sd=sds.get(name, 0.0), q025=0.0, q975=0.0, from_data=None)
        for name in names
    ]
    covariance = np.diag(np.square([each.sd for each in found])).tolist()
    return OnboardConstants.model_construct(
        serial="U", reference_degC=25.0, triads=tuple(triads), constants=tuple(found), covariance=covariance,
        unexpressed=(), slow_noise=(),
    )  # fmt: skip


def at_end(sds: dict[str, float], duration: float, **more):
    mission = level_mission(duration, SHORT, **more)
    return navigation_impact(constants(sds), mission, "test", aided_height=False).errors[-1]


def test_an_accelerometer_bias_at_rest_is_a_schuler_oscillation():
    bias, seconds = 1e-3, 2000.0
    end = at_end({"bias[ax]": bias}, seconds)
    schuler = math.sqrt(G / RADIUS)
    assert end.position_m[0] == pytest.approx(bias / schuler**2 * (1 - math.cos(schuler * seconds)), rel=0.01)
    assert end.attitude_rad[0] == pytest.approx(0.0, abs=1e-12)


def test_a_gyro_bias_at_rest_grows_with_the_cube_of_time_and_then_with_time():
    bias, schuler = math.radians(0.1) / 3600, math.sqrt(G / RADIUS)
    for seconds in (300.0, 3600.0):
        end = at_end({"bias[gy]": bias}, seconds)
        along = bias * RADIUS * (seconds - math.sin(schuler * seconds) / schuler)
        assert end.position_m[0] == pytest.approx(along, rel=0.03)  # the Earth turns the axis within an hour
    assert end.attitude_rad[1] == pytest.approx(bias * 3600, rel=0.05)


def test_the_vertical_channel_diverges():
    bias, seconds = 1e-3, 900.0
    rate = math.sqrt(2 * G / RADIUS)
    end = at_end({"bias[az]": bias}, seconds)
    assert end.position_m[2] == pytest.approx(bias / rate**2 * (math.cosh(rate * seconds) - 1), rel=0.01)
    aided = navigation_impact(constants({"bias[az]": bias}), level_mission(seconds, SHORT), "test").errors[-1]
    assert aided.position_m == (0.0, 0.0, 0.0)


def test_a_scale_factor_matters_where_there_is_an_input():
    # Down is turned by 1 g at rest, ahead by nothing.
    assert at_end({"M[x,ax]": 1e-4}, 100.0).position_m[0] == pytest.approx(0.0, abs=1e-6)
    assert at_end({"M[z,az]": 1e-4}, 100.0).position_m[2] == pytest.approx(0.5e-4 * G * 100**2, rel=5e-3)


def test_noise_is_a_random_walk_and_is_left_out_without_a_rate():
    unit, mission = constants({}, noise=1e-4), level_mission(600.0, SHORT)
    silent = navigation_impact(unit, mission, "test")
    assert silent.errors[-1].horizontal_m == 0.0
    assert any("white noise" in each for each in silent.not_in)
    found = navigation_impact(unit, mission, "test", rate_hz=100.0)
    assert found.errors[-1].attitude_rad[0] == pytest.approx(1e-4 / math.sqrt(100) * math.sqrt(600), rel=0.01)
    assert found.sources[0].source == "white noise"


def test_sources_are_ranked_and_halving_the_step_changes_nothing():
    unit = constants({"bias[gx]": 1e-7, "bias[ax]": 1e-4, "M[z,az]": 1e-5})
    found = navigation_impact(unit, level_mission(3600.0, SHORT, speed=200.0, heading=0.5), "test")
    assert [(each.kind, each.source) for each in found.sources[:2]] == [("gyro", "bias"), ("accelerometer", "bias")]
    assert found.sources[0].horizontal_m > found.sources[1].horizontal_m > found.sources[2].horizontal_m
    fine = level_mission(3600.0, SHORT, speed=200.0, heading=0.5)
    half = np.linspace(0, 3600.0, 2 * len(fine.time) - 1)
    finer = Mission(
        half, np.interp(half, fine.time, fine.latitude), np.zeros(len(half)), np.tile(fine.velocity[0], (len(half), 1)),
        np.broadcast_to(fine.attitude[0], (len(half), 3, 3)),
    )  # fmt: skip
    again = navigation_impact(unit, finer, "test")
    assert again.errors[-1].horizontal_m == pytest.approx(found.errors[-1].horizontal_m, rel=1e-3)


# A mechanisation of its own, on a sphere: attitude by rotation vectors, velocity and position by small steps.


def rotation(vector: np.ndarray) -> np.ndarray:
    angle = np.linalg.norm(vector)
    if angle < 1e-15:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross


def euler(roll: float, pitch: float, heading: float) -> np.ndarray:
    about = [
        rotation(np.array(axis) * angle)
        for axis, angle in (([0, 0, 1], heading), ([0, 1, 0], pitch), ([1, 0, 0], roll))
    ]
    return about[0] @ about[1] @ about[2]


def rates(latitude, height, velocity):
    radius = RADIUS + height
    earth = RATE * np.array([math.cos(latitude), 0, -math.sin(latitude)])
    north, east = velocity[0] / radius, velocity[1] / radius
    return earth, np.array([east, -north, -east * math.tan(latitude)])


def gravity(height: float) -> float:
    return G * (RADIUS / (RADIUS + height)) ** 2


def navigated(trajectory, errors: dict[str, float]) -> np.ndarray:
    """Return position, North, East, Down, that a unit with errors navigates to along a turn, m."""
    step, latitude, longitude, height = trajectory["step"], SHORT, 0.0, 0.0
    velocity, attitude = trajectory["velocity"][0].copy(), trajectory["attitude"][0].copy()
    for rate, force in zip(trajectory["rate"], trajectory["force"], strict=True):
        rate, force = rate.copy(), force.copy()
        rate[2] += errors.get("bias[gz]", 0.0) + errors.get("M[z,gz]", 0.0) * rate[2]
        force[1] += errors.get("bias[ay]", 0.0)
        force[0] += errors.get("M[x,ay]", 0.0) * force[1]
        earth, transport = rates(latitude, height, velocity)
        middle = attitude @ rotation(rate * step / 2)
        middle = rotation(-(earth + transport) * step / 2) @ middle
        attitude = rotation(-(earth + transport) * step) @ attitude @ rotation(rate * step)
        change = middle @ force - np.cross(2 * earth + transport, velocity) + [0, 0, gravity(height)]
        ahead = velocity + change * step
        mean = (velocity + ahead) / 2
        latitude += mean[0] / (RADIUS + height) * step
        longitude += mean[1] / (RADIUS + height) / math.cos(latitude) * step
        height -= mean[2] * step
        velocity = ahead
    return np.array([latitude * RADIUS, longitude * RADIUS * math.cos(SHORT), -height])


def turning() -> tuple[Mission, dict]:
    """Return a level flight with a turn, and the inputs of an ideal unit for the mechanisation above."""
    step, duration, speed = 0.1, 300.0, 100.0
    time = np.arange(0, duration + step / 2, step)
    heading = 0.3 + 0.01 * time
    velocity = np.stack([speed * np.cos(heading), speed * np.sin(heading), 0 * time], axis=1)
    latitude = SHORT + np.concatenate([[0], np.cumsum((velocity[1:, 0] + velocity[:-1, 0]) / 2)]) * step / RADIUS
    attitude = np.array([euler(0.02, 0.0, each) for each in heading])
    inputs = []
    for at in range(len(time) - 1):
        mean, place = (velocity[at] + velocity[at + 1]) / 2, (latitude[at] + latitude[at + 1]) / 2
        earth, transport = rates(place, 0.0, mean)
        middle = euler(0.02, 0.0, (heading[at] + heading[at + 1]) / 2)
        change = (velocity[at + 1] - velocity[at]) / step
        force = middle.T @ (change + np.cross(2 * earth + transport, mean) - [0, 0, gravity(0.0)])
        inputs.append((middle.T @ (earth + transport) + euler(0.02, 0, 0).T @ [0, 0, 0.01], force))
    coarse = slice(None, None, 10)
    mission = Mission(time[coarse], latitude[coarse], 0 * time[coarse], velocity[coarse], attitude[coarse])
    rate, force = (np.array(each) for each in zip(*inputs, strict=True))
    return mission, {"step": step, "velocity": velocity, "attitude": attitude, "rate": rate, "force": force}


@pytest.mark.parametrize(
    ("name", "size"), [("bias[gz]", 2e-6), ("M[z,gz]", 2e-4), ("bias[ay]", 1e-3), ("M[x,ay]", 5e-4)]
)
def test_an_error_in_a_turn_is_what_a_mechanisation_makes_of_it(name, size):
    mission, trajectory = turning()
    off = navigated(trajectory, {name: size}) - navigated(trajectory, {})
    end = navigation_impact(constants({name: size}), mission, "turn", aided_height=False).errors[-1]
    assert end.horizontal_m == pytest.approx(float(np.hypot(*off[:2])), rel=0.02)


def test_a_trajectory_file_is_the_mission_it_describes(tmp_path):
    mission = level_mission(600.0, SHORT, speed=150.0, heading=math.radians(60))
    east = np.cumsum(np.full(len(mission.time), 150 * math.sin(math.radians(60)))) / RADIUS / np.cos(mission.latitude)
    columns = [mission.time, np.degrees(mission.latitude), np.degrees(east), 0 * mission.time, 0 * mission.time,
               0 * mission.time, 60 + 0 * mission.time]  # fmt: skip
    pl.DataFrame(dict(zip(COLUMNS, columns, strict=True))).write_csv(tmp_path / "flight.csv")
    unit = constants({"bias[gz]": 1e-6, "M[y,ax]": 1e-4, "bias[ay]": 1e-4})
    read = navigation_impact(unit, read_mission(tmp_path / "flight.csv"), "file").errors[-1]
    assert read.horizontal_m == pytest.approx(
        navigation_impact(unit, mission, "level").errors[-1].horizontal_m, rel=0.01
    )


def test_what_cannot_be_navigated_is_refused(tmp_path):
    with pytest.raises(InputError, match="gyros and accelerometers"):
        navigation_impact(constants({}, kinds=("gyro",)), level_mission(10.0, SHORT), "test")
    with pytest.raises(InputError, match="duration of the mission is 0 s"):
        level_mission(0.0, SHORT)
    with pytest.raises(InputError, match="pole"):
        level_mission(3600.0, math.radians(88), speed=300.0)
    (tmp_path / "x.csv").write_text("time_s,latitude_deg\n0,1\n")
    with pytest.raises(InputError, match="cannot be read"):
        read_mission(tmp_path / "x.csv")
