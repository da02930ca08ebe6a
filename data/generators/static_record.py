"""An IMU at rest for four hours: white, flicker and random-walk noise, quantisation and a ramp on single channels.

Flicker noise is the fractional sum of order ½ of white noise (Kasdin, Proc. IEEE 83 (1995), 802): its filter has the
coefficients h_k = h_(k−1) (k − ½)/k, and the record is cut out after it has run in for as long as the record.
"""

from pathlib import Path

import numpy as np
import polars

import truth
import write
from kinematics import Mounting, Site, Table
from plan import Moments, Plan, Row, Run
from sensor import AXES, DEG_PER_HOUR, Channel, Values

SEED = 20261101
SITE = Site(55.75, 150.0)
HOURS, INTERVAL = 4.0, 1.0
GYROS = tuple(Channel(f"g{letter}", "gyro", i, "deg/s", 1.0, "deg/s", 1e-3, o) for letter, i, o in AXES)
ACCELEROMETERS = tuple(Channel(f"a{letter}", "accelerometer", i, "g", 1.0, "g", 3e-5, o) for letter, i, o in AXES)
PLATE = Table("plate", 30.0, 90.0, 20.0)
SEAT = Mounting("level", np.eye(3), 2.0)
TYPICAL = {
    "gyro": {"white": 0.05, "flicker": 0.5, "random_walk": 2.0},
    "accelerometer": {"white": 30.0, "flicker": 8.0, "random_walk": 30.0},
}
"""Medians of the coefficients, in the units of `NOISE_UNITS`."""
SINGLE = {"gz": {"ramp": 1.5}, "az": {"quantisation": 4e-4}}
NOISE_UNITS = {
    "gyro": {
        "quantisation": "arcsec", "white": "deg/h^(1/2)", "flicker": "deg/h", "random_walk": "deg/h/h^(1/2)",
        "ramp": "deg/h/h",
    },
    "accelerometer": {
        "quantisation": "m/s", "white": "ug/Hz^(1/2)", "flicker": "ug", "random_walk": "ug/h^(1/2)", "ramp": "ug/h",
    },
}  # fmt: skip


def in_si(kind: str, term: str, value: float) -> float:
    """A coefficient of noise in SI: of the rate or specific force, in seconds."""
    hour, micro = 3600.0, 1e-6 * SITE.gravity
    if kind == "gyro":
        factors = {
            "quantisation": np.pi / 648000, "white": DEG_PER_HOUR * hour / np.sqrt(hour), "flicker": DEG_PER_HOUR,
            "random_walk": DEG_PER_HOUR / np.sqrt(hour), "ramp": DEG_PER_HOUR / hour,
        }  # fmt: skip
    else:
        factors = {
            "quantisation": 1.0, "white": micro, "flicker": micro, "random_walk": micro / np.sqrt(hour),
            "ramp": micro / hour,
        }  # fmt: skip
    return value * factors[term]


def flicker(samples: int, generator: np.random.Generator) -> np.ndarray:
    """Flicker noise of two-sided spectrum 1/(2πf) at frequencies far below the sampling rate."""
    whole = 2 * samples
    order = np.arange(1, whole)
    weights = np.concatenate([[1.0], np.cumprod((order - 0.5) / order)])
    size = 1 << (2 * whole - 1).bit_length()
    spectrum = np.fft.rfft(weights, size) * np.fft.rfft(generator.normal(size=whole), size)
    return np.fft.irfft(spectrum, size)[samples:whole]


def noise(terms: dict[str, float], samples: int, interval: float, generator: np.random.Generator) -> np.ndarray:
    """A record of noise with the given coefficients, all in SI units of one quantity."""
    found = terms.get("white", 0.0) / np.sqrt(interval) * generator.normal(size=samples)
    if "flicker" in terms:
        found += terms["flicker"] * flicker(samples, generator)
    if "random_walk" in terms:
        found += terms["random_walk"] * np.sqrt(interval) * np.cumsum(generator.normal(size=samples))
    if "quantisation" in terms:
        # A pulse counter errs by a part of a pulse at either end of the interval.
        found += terms["quantisation"] * np.diff(generator.normal(size=samples + 1)) / interval
    return found + terms.get("ramp", 0.0) * interval * np.arange(samples)


def plan(seed: int, model: str | Path | None = None) -> Plan:
    """The plan: one record on a levelled plate of known azimuth."""
    samples = round(HOURS * 3600 / INTERVAL)
    rows = [Row(HOURS * 1800, samples, 25.0)]
    return Plan(
        name="static-record", purpose="An IMU at rest for four hours.", serial="SR006", site=SITE,
        channels=(*GYROS, *ACCELEROMETERS), tables=(PLATE,), mountings=(SEAT,),
        runs=(Run("night", "static_record", rows, "plate", "level", "2026-11-01T20:00:00+00:00"),), model=model,
    )  # fmt: skip


def noise_of(channel: Channel, seed: int) -> dict[str, float]:
    """The true coefficients of noise of a channel, by term, in the units of `NOISE_UNITS`."""
    drawn = {
        term: median * float(np.exp(0.2 * truth.stream(seed, f"{term}[{channel.name}]").normal()))
        for term, median in TYPICAL[channel.kind].items()
    }
    return drawn | SINGLE.get(channel.name, {})


def record(drawn: Plan, values: Values, seed: int) -> np.ndarray:
    """The outputs of all channels, shape (samples, channels)."""
    moments = Moments(drawn)
    (still,) = moments.means(moments.outputs(values))
    samples = drawn.runs[0].rows[0].samples
    columns = []
    for channel, mean in zip(drawn.channels, still, strict=True):
        terms = {term: in_si(channel.kind, term, value) for term, value in noise_of(channel, seed).items()}
        random = truth.stream(seed, f"record of {channel.name}")
        columns.append(mean + channel.scale_si(drawn.site) * noise(terms, samples, INTERVAL, random))
    return np.stack(columns, axis=1)


def generate(folder: Path, seed: int) -> dict[str, float]:
    """Write the campaign into `folder`; return the true parameters and coefficients of noise."""
    folder, drawn = Path(folder), plan(seed)
    values = dict(drawn.draw(seed))
    outputs = record(drawn, values, seed)
    for channel in drawn.channels:
        white = in_si(channel.kind, "white", noise_of(channel, seed)["white"])
        values[f"white_noise.sigma[{channel.name}]"] = white * channel.scale_si(drawn.site) / np.sqrt(INTERVAL)
    coefficients = {
        f"noise_term.{term}[{channel.name}]": value
        for channel in drawn.channels
        for term, value in noise_of(channel, seed).items()
    }
    run = drawn.runs[0]
    write.write_campaign_file(folder, drawn, seed, [write.run_entry(run, "parquet", temperature_degC=25.0)])
    (folder / "runs").mkdir(exist_ok=True)
    columns = {"time_s": np.arange(len(outputs), dtype=np.float32) * np.float32(INTERVAL)}
    columns |= {channel.name: outputs[:, place].astype(np.float32) for place, channel in enumerate(drawn.channels)}
    polars.DataFrame(columns).write_parquet(folder / "runs" / f"{run.name}.parquet", compression="zstd")
    derived = truth.mounting_angles(drawn.channels, drawn.mountings, values)
    write.write_truth(folder, drawn, seed, values, derived, coefficients)
    return values | coefficients | derived


if __name__ == "__main__":
    generate(Path(__file__).resolve().parents[1] / "static-record", SEED)
