# pyright: reportMissingImports=false
"""Information of the outputs of a drawn campaign on its set-up, by two laws.

χ² of the outputs under a linear Gaussian law: the nominal input of every row, worked out here from the files, and all
errors with standard deviations.  A mistake that raises it by less than `DETECTABLE` changes the expected outputs by
less than noise and errors conceal: nobody who knows no more than the law can detect it in that campaign.

`GENERATING` has the standard deviations from which `data/generators` draws.  `STATED` has those that a reader of the
campaign files can assume of a tactical unit, which no file narrows: the default priors of the catalogue of effects
(`imubayes effects`), and repeatabilities from one run to the next of 10 deg/h and 0.5 mg, as data sheets have them.
χ² is then that of the best valid explanation with every physical parameter free within its plausible range.
Nothing here is shared with the package.
"""

import csv
import tomllib
from dataclasses import dataclass
from math import pi, radians
from pathlib import Path

import numpy as np
from kinematics import Site, about, trihedral

DETECTABLE = 49.0
"""Seven standard deviations: six, as for hidden effects in data/README.md, and one for the thousand mistakes that may
have been made."""
ARCSEC, DEG_H, UG, PPM = pi / 648000, pi / 180 / 3600, 9.8e-6, 1e-6
KNOWN = ("rate_table", "rotation_modulation", "dividing_head", "polar_tumble", "thermal_ramp")


@dataclass(frozen=True)
class Law:
    """Standard deviations of the errors of channels, SI.

    Attributes
    ----------
    gyro, accelerometer : scale factor, two misalignments, bias, its slope and curvature with the temperature, the same
        of the scale factor, three terms of g, six quadratic in g, slopes of bias and scale factor with the temperature
        of the converter, three lever arms.
    offsets : of single runs, kind → SI; None if they are those that were drawn.
    rows : of single rows, kind → SI; of single rows of polar tumbles in the law without terms quadratic in g.
    share : of the input.
    """

    gyro: tuple[float, ...]
    accelerometer: tuple[float, ...]
    offsets: dict[str, float] | None
    rows: dict[str, float]
    share: float


# The widest of the models in use.
GENERATING = Law(
    gyro=(1e-3, 300 * ARCSEC, 300 * ARCSEC, 100 * DEG_H, 0.2 * DEG_H, 0, 1e-5, 0, *(5 * DEG_H,) * 3, *(0,) * 11),
    accelerometer=(
        3e-4, 100 * ARCSEC, 100 * ARCSEC, 1000 * UG, 20 * UG, 0, 2e-5, 0, 0, 0, 0, 20 * UG, *(0,) * 5,
        25 * UG, 5e-6, *(0.01,) * 3,
    ),
    offsets=None, rows={"gyro": 0.0, "accelerometer": 0.0}, share=1e-6,
)  # fmt: skip
STATED = Law(
    gyro=(
        2e-3, 200 * ARCSEC, 200 * ARCSEC, 3600 * DEG_H, 20 * DEG_H, 0.5 * DEG_H, 1e-4, 1e-6, *(100 * DEG_H,) * 3,
        *(10 * DEG_H,) * 6, 20 * DEG_H, 1e-4, *(0,) * 3,
    ),
    accelerometer=(
        2e-3, 200 * ARCSEC, 200 * ARCSEC, 20000 * UG, 100 * UG, 5 * UG, 1e-4, 1e-6, 0, 0, 0, *(50 * UG,) * 6,
        100 * UG, 1e-4, *(0.1,) * 3,
    ),
    offsets={"gyro": 10 * DEG_H, "accelerometer": 500 * UG},
    rows={"gyro": 0.3 * DEG_H, "accelerometer": 20 * UG}, share=3e-4,
)  # fmt: skip
_TUMBLE_ROWS = 0.3 * DEG_H  # terms quadratic in g, if a law has none


@dataclass
class System:
    """The normal equations of all errors: matrix, vector and sum of weighted squares."""

    matrix: np.ndarray
    vector: np.ndarray
    square: float = 0.0

    def add(self, design: np.ndarray, places: np.ndarray, error: np.ndarray, variance: np.ndarray) -> None:
        weighted = design / variance[:, None]
        self.matrix[np.ix_(places, places)] += design.T @ weighted
        self.vector[places] += weighted.T @ error
        self.square += float(error @ (error / variance))

    def chi_square(self) -> float:
        lower = np.linalg.cholesky(np.eye(len(self.vector)) + self.matrix)
        return self.square - float(np.sum(np.linalg.solve(lower, self.vector) ** 2))


def chi_square(folder: Path, law: Law = GENERATING) -> float:
    """Return χ² of all outputs of the runs on tables of one axis, all errors integrated out."""
    said = tomllib.loads((folder / "campaign.toml").read_text(encoding="utf-8"))
    truth = tomllib.loads((folder / "truth.toml").read_text(encoding="utf-8"))["parameters"]
    drawn = folder / "drawn_noise.toml"
    noise = tomllib.loads(drawn.read_text(encoding="utf-8")) if drawn.exists() else {}
    runs = [run for run in said["run"] if run["procedure"] in KNOWN and "mounting" in run]
    channels, count = said["channel"], len(law.gyro)
    seats = [mounting["name"] for mounting in said["mounting"]]
    tables = [table["name"] for table in said["table"]]
    shared = count * len(channels)
    offsets = shared + 3 * len(seats) + 3 * len(tables)
    size = offsets + len(channels) * len(runs)
    system = System(np.zeros((size, size)), np.zeros(size))
    for number, run in enumerate(runs):
        rows = _columns(folder / run["file"])
        stand, rate = _stand(said, run, rows)
        site = Site(said["site"]["latitude_deg"], said["site"]["height_m"])
        gravity = said["site"].get("gravity_m_s2", site.gravity)
        force = stand @ [0.0, 0.0, gravity]
        turn = stand @ site.earth_rate + rate
        seat, table = seats.index(run["mounting"]), tables.index(run["table"])
        loose = said["mounting"][seat]["uncertainty_arcmin"] * 60 * ARCSEC
        tilt = said["table"][table].get("axis_uncertainty_arcsec", 20.0) * ARCSEC
        for k, channel in enumerate(channels):
            if channel["name"] not in rows:
                continue
            gyro = channel["kind"] == "gyro"
            design = _design(channel, rows, turn, force, rate, gravity) * (law.gyro if gyro else law.accelerometer)
            seated = np.cross(turn if gyro else force, _axes(channel)[0]) * loose
            up = site.earth_rate if gyro else np.array([0.0, 0.0, gravity])
            tilted = np.cross(_axes(channel)[0] @ stand, up) * tilt
            label = channel["name"]
            per = _scale_si(channel, gravity)
            # The truth is in the units that were drawn.
            factor = channel["noise"] / noise.get(label, channel["noise"])
            sigma = factor * truth.get(f"white_noise.sigma[{label}]", channel["noise"] / factor)
            scatter = factor * truth.get(f"run_scatter.tau[{label}]", 0.1 * channel["noise"] / factor)
            offset = np.full((len(design), 1), law.offsets[channel["kind"]] if law.offsets else scatter / abs(per))
            places = np.concatenate([
                count * k + np.arange(count), shared + 3 * seat + np.arange(3),
                shared + 3 * len(seats) + 3 * table + np.arange(3), [offsets + number * len(channels) + k],
            ])  # fmt: skip
            whole = np.concatenate([design, seated, tilted, offset], axis=1)
            error = (rows[label] - channel.get("offset", 0.0)) / per - (turn if gyro else force) @ _axes(channel)[0]
            # Products of errors, which a linear law leaves out: of seat and lever arm, of seat and scale factor.
            share = max(law.share, loose**2) * np.linalg.norm(turn if gyro else force, axis=1)
            arms = 0.0 if gyro else 2 * loose * 0.03 * np.sum(rate**2, axis=1)
            of_row = max(law.rows[channel["kind"]], _TUMBLE_ROWS if run["procedure"] == "polar_tumble" else 0.0)
            left_out = share**2 + arms**2 + of_row**2
            system.add(whole, places, error, (sigma / per) ** 2 / rows["samples"] + left_out)
    return system.chi_square()


def _columns(file: Path) -> dict[str, np.ndarray]:
    with file.open(encoding="utf-8", newline="") as stream:
        head, *rows = list(csv.reader(stream))
    return {name: np.array([float(row[k]) if row[k] else np.nan for row in rows]) for k, name in enumerate(head)}


def _stand(said: dict, run: dict, rows: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Local level → body of each row, mean over its arc, and the rate of the table in body axes, rad/s."""
    table = next(each for each in said["table"] if each["name"] == run["table"])
    mounting = next(each for each in said["mounting"] if each["name"] == run["mounting"])
    seat = np.array(mounting["body_to_table"]) if "body_to_table" in mounting else trihedral()
    level = about(2, -radians(table["azimuth_deg"])) @ about(0, -radians(90 - table["elevation_deg"]))
    count = len(rows["samples"])
    angle = np.radians(rows.get("table_angle_deg", np.zeros(count)) - table.get("zero_angle_deg", 0.0))
    known = np.isfinite(angle)
    span = np.radians(rows.get("table_angle_span_deg", np.zeros(count)))
    short = np.where(known, np.sinc(span / 2 / pi), 0.0)
    cosine, sine = short * np.cos(np.where(known, angle, 0)), short * np.sin(np.where(known, angle, 0))
    turn = np.zeros((count, 3, 3))  # table at zero → table
    turn[:, 0, 0] = turn[:, 1, 1] = cosine
    turn[:, 0, 1], turn[:, 1, 0], turn[:, 2, 2] = sine, -sine, 1.0
    rate = np.radians(rows.get("table_rate_deg_s", np.zeros(count)))[:, None] * seat[2]
    return seat.T @ turn @ level.T, rate


def _axes(channel: dict) -> np.ndarray:
    along = np.array(channel["input_axis"], dtype=float) / np.linalg.norm(channel["input_axis"])
    least = np.eye(3)[np.argmin(np.round(np.abs(along), 9))]
    output = np.array(channel.get("output_axis", least), dtype=float)
    output -= (output @ along) * along
    output /= np.linalg.norm(output)
    return np.array([along, output, np.cross(along, output)])


def _scale_si(channel: dict, gravity: float) -> float:
    per = {"deg/s": pi / 180, "deg/h": DEG_H, "rad/s": 1.0, "g": gravity, "m/s^2": 1.0}
    return channel["scale"] / per[channel["per"]]


def _design(
    channel: dict, rows: dict[str, np.ndarray], turn: np.ndarray, force: np.ndarray, rate: np.ndarray, gravity: float
) -> np.ndarray:
    """Response to each error of a channel, in the order of a law, shape (rows, 22)."""
    gyro, axes = channel["kind"] == "gyro", _axes(channel)
    along = (turn if gyro else force) @ axes.T
    one = np.ones(len(along))
    warm = rows.get("temperature_degC", 25 * one) - 25
    converter = rows.get("converter_temperature_degC", 25 * one) - 25
    in_g = force @ axes.T / gravity
    squared = np.stack([in_g[:, a] * in_g[:, b] for a, b in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))])
    # Centripetal force of a lever arm r: Ω(Ω·r) − Ω²r, along the input axis.
    arm = (rate @ axes[0])[:, None] * rate - np.sum(rate**2, axis=1)[:, None] * axes[0]
    thermal = [warm, warm**2, warm * along[:, 0], warm**2 * along[:, 0]]
    return np.column_stack([along, one, *thermal, in_g, *squared, converter, converter * along[:, 0], arm])
