"""A MEMS unit turned by hand on a desk: raw samples at 100 Hz, rests in 28 attitudes, turns between them.

Every sample is the mean of the true rate and specific force over its own 10 ms, centred at its time stamp, so
the samples of a turn integrate to the true turn.  The accelerometers define the body frame: ax is without
misalignment and ay leans within the x-y plane alone, as the model file says.
"""

from pathlib import Path

import numpy as np
import polars

import truth
import write
from kinematics import Site
from motion import Move, hand_moves, path
from plan import Plan, Run
from sensor import AXES, Channel, Surroundings, Values, accelerometer_signal, converted, gyro_signal

SEED = 20260330
STEADY = Surroundings()
SAMPLE_RATE = 100.0
POSES = 28
FIRST_REST = 15.0
NODES, WEIGHTS = np.polynomial.legendre.leggauss(5)
DECIMALS = {"accelerometer": 4, "gyro": 6}


def plan() -> Plan:
    accelerometers = (
        Channel(f"a{letter}", "accelerometer", i, "m/s^2", 1.0, "m/s^2", 0.02, o) for letter, i, o in AXES
    )
    gyros = (Channel(f"g{letter}", "gyro", i, "rad/s", 1.0, "rad/s", 0.0017, o) for letter, i, o in AXES)
    return Plan(
        name="desk-imu",
        purpose="MEMS unit turned by hand between 28 rests on a desk: raw samples at 100 Hz, no table.",
        serial="MM009",
        site=Site(48.0, 520.0),
        channels=(*accelerometers, *gyros),
        tables=(),
        mountings=(),
        runs=(Run("tumble", "free_tumble", [], start="2026-03-30T10:00:00+00:00"),),
    )


def exact_outputs(design: Plan, values: Values, moves: list[Move], times: np.ndarray) -> np.ndarray:
    """Noise-free outputs (T, channels): means over each sample's interval by Gauss's rule."""
    site, interval = design.site, 1 / SAMPLE_RATE
    total = np.zeros((len(times), len(design.channels)))
    for node, weight in zip(NODES, WEIGHTS, strict=True):
        attitude, turning, acceleration = path(moves, times + 0.5 * interval * node)
        rate = turning + site.earth_rate @ attitude
        force = np.einsum("tji,tj->ti", attitude, acceleration + site.upward_force)
        for column, channel in enumerate(design.channels):
            if channel.kind == "gyro":
                signal = gyro_signal(channel, values, site, rate, force, STEADY)
            else:
                signal = accelerometer_signal(channel, values, site, force, STEADY)
            total[:, column] += 0.5 * weight * converted(channel, values, site, signal, STEADY)
    return total


def write_samples(
    folder: Path,
    design: Plan,
    seed: int,
    values: Values,
    times: np.ndarray,
    outputs: np.ndarray,
    full_scale: dict[str, float] | None = None,
) -> None:
    """Write raw samples, with white noise, beside the campaign file."""
    columns = {"time_s": times}
    for channel, exact in zip(design.channels, outputs.T, strict=True):
        noise = truth.stream(seed, f"noise/{channel.name}").normal(size=len(times))
        sigma = values[f"white_noise.sigma[{channel.name}]"]
        limit = (full_scale or {}).get(channel.kind, np.inf)
        columns[channel.name] = np.round(np.clip(exact + sigma * noise, -limit, limit), DECIMALS[channel.kind])
    (folder / "runs").mkdir(parents=True, exist_ok=True)
    polars.DataFrame(columns).write_parquet(folder / "runs" / "tumble.parquet", compression="zstd")


def generate(
    folder: Path, seed: int, hidden: Values | None = None, full_scale: dict[str, float] | None = None
) -> dict[str, float]:
    """Write the campaign into `folder`; return the true parameters and derived quantities.

    Parameters
    ----------
    hidden : further true values, of effects that the shipped model lacks.
    full_scale : kind of channel → largest output, where the converter clips.
    """
    folder, design = Path(folder), plan()
    values = design.draw(seed) | dict(hidden or {})
    moves, end = hand_moves(POSES, FIRST_REST, truth.stream(seed, "moves"))
    times = np.arange(round(end * SAMPLE_RATE)) / SAMPLE_RATE
    outputs = exact_outputs(design, values, moves, times)
    write_samples(folder, design, seed, values, times, outputs, full_scale)
    runs = [write.run_entry(run, "parquet", temperature_degC=25.0) for run in design.runs]
    write.write_campaign_file(folder, design, seed, runs)
    derived = truth.scale_factors(design.channels, values)
    start = moves[0].attitude
    nuisance = {
        "heading_of_body_x_deg": float(np.degrees(np.arctan2(start[0, 0], start[1, 0]))),
        "move_start_s": [move.start for move in moves],
        "move_end_s": [move.start + move.duration for move in moves],
    }
    write.write_truth(folder, design, seed, values, derived, nuisance)
    return values | derived


if __name__ == "__main__":
    generate(Path(__file__).resolve().parents[1] / "desk-imu", SEED)
