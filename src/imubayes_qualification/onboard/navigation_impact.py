"""Effect of the uncertainty of constants on board on navigation: position, velocity, attitude of a mission.

The error of a corrected input is linear in the constants about their means: with s the corrected channels before the
matrix, u = M s − A f gives δu = δM s − M s δκ − M δb − δA f.  It drives the strapdown error equations in the ψ-angle
form (Benson 1975; Titterton and Weston, Strapdown Inertial Navigation Technology, 12.3), in North, East, Down:

    ψ̇ = −ω_in × ψ − C δω
    δv̇ = f × ψ − (2 ω_ie + ω_en) × δv + δg + C δf,   δg = g/R (−δp_N, −δp_E, 2 δp_D)
    δṗ = −ω_en × δp + δv

The sensitivity of the nine states to every constant is integrated along the mission, and their joint covariance does
the rest.  Start and alignment are exact: what is stated comes from the calibration, the offset of a recording and the
noise alone.  Height is aided, as by a barometer, unless it is stated not to be: unaided it diverges, and takes the
others along.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
from scipy.linalg import block_diag

from imubayes.foundations.earth import earth_rate, normal_gravity
from imubayes.foundations.errors import input_error
from imubayes.foundations.numerics import cross_matrices
from imubayes.foundations.quantity_names import QuantityName, name_of
from imubayes.foundations.records import Record
from imubayes_qualification.onboard.record import OnboardConstants, TriadConstants

RADIUS = 6_371_008.8  # m, mean of the Earth: of the flattening nothing is left in an error
_STEP = 1.0
"""Longest step of the integration, s.  Numerical: a twentieth of the shortest period of interest; halving it moves the
position error of an hour by less than a thousandth."""
_LONGEST = 6 * 3600.0
COLUMNS = ("time_s", "latitude_deg", "longitude_deg", "height_m", "roll_deg", "pitch_deg", "heading_deg")
# What the constants are called, and the source of error that they make.
_SOURCES = {"bias": "bias", "M": "scale factor and misalignment", "gain": "scale factor over temperature",
            "A": "g-sensitivity"}  # fmt: skip
_TOLD = 121  # instants of a mission at which the errors are kept


@dataclass(frozen=True)
class Mission:
    """A motion of the unit, T instants; body axes are forward, right and down at zero attitude.

    Attributes
    ----------
    time : shape (T,), s, increasing.
    latitude, height : shapes (T,), rad and m.
    velocity : shape (T, 3), North, East and Down, m/s.
    attitude : shape (T, 3, 3), from body axes to North, East, Down.
    """

    time: np.ndarray
    latitude: np.ndarray
    height: np.ndarray
    velocity: np.ndarray
    attitude: np.ndarray


class NavigationError(Record):
    """Standard deviations at an instant of a mission, along North, East and Down: m, m/s, rad."""

    time_s: float
    position_m: tuple[float, float, float]
    velocity_m_s: tuple[float, float, float]
    attitude_rad: tuple[float, float, float]

    @property
    def horizontal_m(self) -> float:
        """Root of the sum of the variances along North and East (DRMS)."""
        return math.hypot(*self.position_m[:2])


class ErrorSource(Record):
    """What one source of error alone does at the end of a mission."""

    kind: str
    source: str
    horizontal_m: float
    vertical_m: float
    attitude_rad: float


class EffectNotShown(ErrorSource):
    """What an effect that the runs could not show does at the end, every coefficient of the largest size.

    The coefficients of all channels have independent signs: squares of what they do are added.  The size is no standard
    uncertainty, and neither is what follows from it.

    Attributes
    ----------
    size, unit : largest size met in practice that the data do not contradict, of the first coefficient.
    """

    size: float
    unit: str


class EffectNotPropagated(Record):
    """An effect of the unit that the runs could not show, and that was not propagated.

    Attributes
    ----------
    needs : what it depends on and the mission does not state; empty of one with memory, a limit or a shape, and of a
        lever arm.
    """

    effect: str
    needs: tuple[str, ...]


class NavigationImpact(Record):
    """Navigation errors that follow from the uncertainty of a calibration.

    Attributes
    ----------
    errors : from the beginning to the end of the mission.
    sources : each alone, largest horizontal error first.  Constants are correlated: their squares need not add up.
    not_in : effects that the constants do not express; the errors do not include them.
    diagnosed : whether a diagnosis of the result lists the effects that the runs could not show.
    not_shown : these effects, largest horizontal error first; none is in the errors.
    not_propagated : effects that the runs could not show and whose errors cannot be computed for this mission.

    Examples
    --------
    >>> import imubayes
    >>> nothing = imubayes.NavigationImpact(serial="U1", mission="at rest", errors=(), sources=(), not_in=("gyro_lag",))
    >>> nothing.not_in
    ('gyro_lag',)
    """

    serial: str
    mission: str
    errors: tuple[NavigationError, ...]
    sources: tuple[ErrorSource, ...]
    not_in: tuple[str, ...]
    diagnosed: bool = False
    not_shown: tuple[EffectNotShown, ...] = ()
    not_propagated: tuple[EffectNotPropagated, ...] = ()


def level_mission(
    duration: float, latitude: float, speed: float = 0.0, heading: float = 0.0, height: float = 0.0
) -> Mission:
    """Return a mission at rest or at a constant speed and heading, level, for so many seconds; angles in rad."""
    if not 0 < duration <= _LONGEST:
        fault = f"the duration of the mission is {duration:g} s"
        raise input_error(fault, "duration", f"above 0, at most {_LONGEST:g} s", "correct the duration")
    time = np.linspace(0.0, duration, max(2, math.ceil(duration / _STEP) + 1))
    velocity = np.tile([speed * math.cos(heading), speed * math.sin(heading), 0.0], (len(time), 1))
    along = latitude + velocity[:, 0] * time / (RADIUS + height)
    if np.abs(along).max() > math.radians(89.0):
        raise input_error("the mission passes a pole", "heading and speed", "latitudes within 89 deg", "change them")
    attitude = np.broadcast_to(_rotation(np.array([[0.0, 0.0, heading]])), (len(time), 3, 3))
    return Mission(time, along, np.full(len(time), float(height)), velocity, attitude)


def read_mission(file: Path) -> Mission:
    """Return the mission of a CSV file with the columns `COLUMNS`, interpolated to the steps of the integration.

    Raises
    ------
    InputError
        if the file is missing, lacks a column, or has values that are no numbers or times that do not increase.
    """
    remedy = "a CSV file with the columns " + ", ".join(COLUMNS)
    try:
        table = pl.read_csv(file, comment_prefix="#").select(pl.col(COLUMNS).cast(pl.Float64))
    except (OSError, pl.exceptions.PolarsError) as error:
        raise input_error("the trajectory cannot be read", str(file), remedy, str(error).splitlines()[0]) from error
    rows = table.to_numpy()
    good = len(rows) > 2 and np.isfinite(rows).all() and (np.diff(rows[:, 0]) > 0).all()
    if not good or np.abs(rows[:, 1]).max() > 89 or rows[-1, 0] - rows[0, 0] > _LONGEST:
        allowed = (
            "at least three rows of finite numbers, times that increase over at most six hours, latitudes within 89 deg"
        )
        raise input_error("this is not a trajectory", str(file), allowed, "correct the rows")
    time = rows[:, 0] - rows[0, 0]
    even = np.linspace(0.0, time[-1], max(3, math.ceil(time[-1] / _STEP) + 1))
    angles = np.unwrap(np.radians(rows[:, [1, 2, 4, 5, 6]]), axis=0)
    latitude, longitude, *attitude = (np.interp(even, time, column) for column in angles.T)
    height = np.interp(even, time, rows[:, 3])
    radius = RADIUS + height
    velocity = np.stack(
        [np.gradient(latitude, even) * radius, np.gradient(longitude, even) * radius * np.cos(latitude),
         -np.gradient(height, even)], axis=1,
    )  # fmt: skip
    return Mission(even, latitude, height, velocity, _rotation(np.stack(attitude, axis=1)))


def _rotation(angles: np.ndarray) -> np.ndarray:
    """Return rotations from body axes to North, East, Down of roll, pitch and heading, (T, 3) → (T, 3, 3)."""
    (sr, sp, sh), (cr, cp, ch) = np.sin(angles).T, np.cos(angles).T
    rows = [
        [ch * cp, ch * sp * sr - sh * cr, ch * sp * cr + sh * sr],
        [sh * cp, sh * sp * sr + ch * cr, sh * sp * cr - ch * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


@dataclass(frozen=True)
class MissionMotion:
    """Nominal rates and forces of a mission, (T, 3): ω_ie, ω_en, f in North, East, Down; ω and f in body axes."""

    earth: np.ndarray
    transport: np.ndarray
    force: np.ndarray
    body_rate: np.ndarray
    body_force: np.ndarray
    gravity: np.ndarray


def motion_of(mission: Mission) -> MissionMotion:
    """Return the nominal rates and forces of a mission."""
    # `earth_rate` counts East, North, Up.
    earth = np.array([earth_rate(latitude) for latitude in mission.latitude])[:, [1, 0, 2]] * [1, 1, -1]
    radius = RADIUS + mission.height
    north, east = mission.velocity[:, 0] / radius, mission.velocity[:, 1] / radius
    transport = np.stack([east, -north, -east * np.tan(mission.latitude)], axis=1)
    gravity = np.array([normal_gravity(*at) for at in zip(mission.latitude, mission.height, strict=True)])
    change = np.gradient(mission.velocity, mission.time, axis=0)
    force = change + np.cross(2 * earth + transport, mission.velocity)
    force[:, 2] -= gravity
    to_body = np.swapaxes(mission.attitude, 1, 2)
    turned = np.einsum("tij,tjk->tik", to_body, np.gradient(mission.attitude, mission.time, axis=0))
    turning = np.stack([turned[:, 2, 1], turned[:, 0, 2], turned[:, 1, 0]], axis=1)
    rate = turning + np.einsum("tij,tj->ti", to_body, earth + transport)
    return MissionMotion(earth, transport, force, rate, np.einsum("tij,tj->ti", to_body, force), gravity)


def _input_errors(constants: OnboardConstants, motion: MissionMotion, warmer: float) -> np.ndarray:
    """Return the derivative of rate and specific force, body axes, by every constant, shape (T, 6, n).

    Sensors and converter are by `warmer` °C above the reference temperature of the constants.
    """
    found = np.zeros((len(motion.body_rate), 6, len(constants.constants)))
    places = {constant.name: place for place, constant in enumerate(constants.constants)}
    for triad in constants.triads:
        gyro = triad.kind == "gyro"
        inputs = motion.body_rate if gyro else motion.body_force
        rows, matrix = slice(0, 3) if gyro else slice(3, 6), np.array(triad.matrix)
        if gyro and triad.g_sensitivity is not None:
            inputs = inputs + motion.body_force @ np.array(triad.g_sensitivity).T
            for row, name in enumerate("xyz"):
                for column, of in enumerate("xyz"):
                    found[:, row, places[name_of("A", name, of)]] = -motion.body_force[:, column]
        channels = inputs @ np.linalg.pinv(matrix).T
        for place, channel in enumerate(triad.channels):
            for row, name in enumerate("xyz"):
                found[:, rows.start + row, places[name_of("M", name, channel)]] = channels[:, place]
            for kind, terms, size in (
                ("bias", triad.bias.terms, np.ones(len(channels))),
                ("gain", triad.gain.terms, channels[:, place]),
            ):
                for term in terms:
                    power = warmer ** (term.sensor + term.converter)
                    suffix = f",{term.sensor},{term.converter}" if term.sensor or term.converter else ""
                    at = places[f"{kind}[{channel}{suffix}]"]
                    found[:, rows, at] = -power * size[:, None] * matrix[:, place]
    return found


def _dynamics(motion: MissionMotion, at: int, radius: float) -> np.ndarray:
    """Return F of δṗ, δv̇, ψ̇ at an instant, shape (9, 9)."""
    found = np.zeros((9, 9))
    earth, transport = motion.earth[at], motion.transport[at]
    found[:3, :3], found[:3, 3:6] = cross_matrices(transport), np.eye(3)
    found[3:6, :3] = np.diag([-1.0, -1.0, 2.0]) * motion.gravity[at] / radius
    found[3:6, 3:6], found[3:6, 6:] = cross_matrices(2 * earth + transport), cross_matrices(motion.force[at]).T
    found[6:, 6:] = cross_matrices(earth + transport)
    return found


def _step(
    mission: Mission, motion: MissionMotion, at: int, kept: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what a step makes of the errors, (9, 9), and of those of rate and force, (9, 6): whole, and per second.

    Parameters
    ----------
    kept : shape (9,), 0 for the errors that stay zero, otherwise 1.
    """
    step, middle = mission.time[at + 1] - mission.time[at], mission.attitude[at] + mission.attitude[at + 1]
    into = np.zeros((9, 6))
    into[6:, :3], into[3:6, 3:] = -middle / 2, middle / 2
    into *= kept[:, None]
    change = step * kept[:, None] * _dynamics(motion, at, RADIUS + mission.height[at])
    return np.eye(9) + change + change @ change / 2, step * (np.eye(9) + change / 2) @ into, into


@dataclass(frozen=True)
class _Drivers:
    """What drives the errors: derivatives of rate and force, (T, 6, n), their covariance (n, n), and sources (n,)."""

    derivative: np.ndarray
    covariance: np.ndarray
    source: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class HiddenEffect:
    """An effect that the runs could not show, on one kind of channels.

    Attributes
    ----------
    size, unit : largest size of its coefficients, of the first if they differ.
    error : shape (T, 6, n), of rate and specific force, body axes, by each of its coefficients at that size.
    """

    effect: str
    kind: str
    size: float
    unit: str
    error: np.ndarray


@dataclass(frozen=True)
class HiddenEffects:
    """The effects that the runs could not show: those that are propagated, and the others."""

    effects: tuple[HiddenEffect, ...]
    left: tuple[EffectNotPropagated, ...]


def _drivers(constants: OnboardConstants, motion: MissionMotion, warmer: float) -> _Drivers:
    """Return the constants, and the offset of a recording about each axis of body."""
    kinds = {channel: triad.kind for triad in constants.triads for channel in triad.channels}
    source = []
    for constant in constants.constants:
        name = QuantityName.of(constant.name)
        letter, channel = name.family, name.labels[1 if name.family == "M" else 0]
        source.append((kinds.get(channel, "gyro"), _SOURCES[letter]))
    columns, roots = [_input_errors(constants, motion, warmer)], [np.array(constants.covariance)]
    for triad in constants.triads:
        offset = np.zeros((len(motion.body_rate), 6, len(triad.channels)))
        offset[:, slice(0, 3) if triad.kind == "gyro" else slice(3, 6)] = np.array(triad.matrix)
        columns.append(offset)
        roots.append(np.diag(np.square(triad.run_offset)))
        source += [(triad.kind, "offset of a recording")] * len(triad.channels)
    return _Drivers(np.concatenate(columns, axis=2), np.asarray(block_diag(*roots)), tuple(source))


def navigation_impact(
    constants: OnboardConstants,
    mission: Mission,
    name: str,
    temperature: float | None = None,
    rate_hz: float | None = None,
    aided_height: bool = True,
    hidden: HiddenEffects | None = None,
) -> NavigationImpact:
    """Return what the uncertainty of constants amounts to over a mission.

    Parameters
    ----------
    name : of the mission, for the record.
    temperature : of sensors and converter, °C; the reference temperature of the constants if None.
    rate_hz : of the samples, by which their noise is a random walk; without it noise is left out and named.
    aided_height : whether height and vertical velocity are known from elsewhere.
    hidden : effects that the runs could not show, along this mission; None if there is no diagnosis.

    Raises
    ------
    InputError
        for a unit without three axes of gyros and of accelerometers.
    """
    if len(constants.triads) < 2:
        has = constants.triads[0].kind if constants.triads else "none"
        fault = f"navigation needs gyros and accelerometers on three axes each; with three axes: {has}"
        raise input_error(fault, f"unit {constants.serial}", "a fit of a whole unit", "fit both in one campaign")
    motion = motion_of(mission)
    warmer = 0.0 if temperature is None else temperature - constants.reference_degC
    drivers = _drivers(constants, motion, warmer)
    densities = np.concatenate([_density(constants.triad(kind), rate_hz) for kind in ("gyro", "accelerometer")])
    count = len(mission.time)
    effects, own = hidden.effects if hidden is not None else (), drivers.derivative.shape[2]
    derivative = np.concatenate([drivers.derivative, *(each.error for each in effects)], axis=2)
    sensitivity, noise = np.zeros((9, derivative.shape[2])), np.zeros((9, 9))
    kept = np.ones(9) if not aided_height else np.array([1.0, 1.0, 0.0, 1.0, 1.0, 0.0, 1.0, 1.0, 1.0])
    told = set(np.linspace(0, count - 1, min(count, _TOLD)).astype(int).tolist())
    errors = [_error(0.0, np.zeros((9, 9)))]
    for at in range(count - 1):
        step = mission.time[at + 1] - mission.time[at]
        through, gain, into = _step(mission, motion, at, kept)
        mean = (derivative[at] + derivative[at + 1]) / 2
        sensitivity = through @ sensitivity + gain @ mean
        noise = through @ noise @ through.T + step * (into * densities) @ into.T
        if at + 1 in told:
            total = sensitivity[:, :own] @ drivers.covariance @ sensitivity[:, :own].T + noise
            errors.append(_error(float(mission.time[at + 1]), total))
    return NavigationImpact(
        serial=constants.serial,
        mission=name,
        errors=tuple(errors),
        sources=_alone(drivers, sensitivity[:, :own], noise if rate_hz else None),
        not_in=(*(each.effect for each in constants.unexpressed), *constants.slow_noise,
                *(() if rate_hz else ("white noise (the sampling rate is not stated)",))),
        diagnosed=hidden is not None,
        not_shown=_not_shown(effects, sensitivity[:, own:]),
        not_propagated=hidden.left if hidden is not None else (),
    )  # fmt: skip


def _density(triad: TriadConstants | None, rate_hz: float | None) -> np.ndarray:
    """Return the spectral density of the noise about x, y and z, (3,), per Hz; zero without a rate."""
    if triad is None or not rate_hz:
        return np.zeros(3)
    return np.square(np.array(triad.matrix)) @ np.square(triad.sample_noise) / rate_hz


def _error(time: float, covariance: np.ndarray) -> NavigationError:
    pn, pe, pd, vn, ve, vd, an, ae, ad = np.sqrt(np.maximum(np.diag(covariance), 0.0)).tolist()
    return NavigationError(time_s=time, position_m=(pn, pe, pd), velocity_m_s=(vn, ve, vd), attitude_rad=(an, ae, ad))


def _alone(drivers: _Drivers, sensitivity: np.ndarray, noise: np.ndarray | None) -> tuple[ErrorSource, ...]:
    """Return what each source alone does at the end."""
    covariances = {}
    for source in dict.fromkeys(drivers.source):
        chosen = [place for place, each in enumerate(drivers.source) if each == source]
        own = sensitivity[:, chosen]
        covariances[source] = own @ drivers.covariance[np.ix_(chosen, chosen)] @ own.T
    if noise is not None:
        covariances["", "white noise"] = noise
    found = (ErrorSource(**_at_end(each), kind=kind, source=name) for (kind, name), each in covariances.items())
    return tuple(sorted(found, key=lambda each: -each.horizontal_m))


def _at_end(covariance: np.ndarray) -> dict[str, float]:
    end = _error(0.0, covariance)
    return {"horizontal_m": end.horizontal_m, "vertical_m": end.position_m[2],
            "attitude_rad": math.hypot(*end.attitude_rad)}  # fmt: skip


def _not_shown(effects: tuple[HiddenEffect, ...], sensitivity: np.ndarray) -> tuple[EffectNotShown, ...]:
    """Return what each effect does at the end; the sensitivity to their coefficients, (9, n), is in their order."""
    found, first = [], 0
    for each in effects:
        columns = sensitivity[:, first : first + each.error.shape[2]]
        first += columns.shape[1]
        end = _at_end(columns @ columns.T)
        found.append(EffectNotShown(**end, kind=each.kind, source=each.effect, size=each.size, unit=each.unit))
    return tuple(sorted(found, key=lambda each: -each.horizontal_m))
