"""Known answers: what a laboratory runs before it trusts this installation (ISO/IEC 17025, 7.11.2).

Published values of noise analysis, propagation and conformity, and a campaign whose answer is known by construction.
Its readings are those of a formula that stands here and shares nothing with the models, plus residuals r with
Jᵀ W r = Λ (θ* − μ): at the stated θ* the gradient of the posterior vanishes, so that the mode is θ* and its covariance
(Jᵀ W J + Λ)⁻¹, with J by complex steps, W the weights and Λ the precision of the priors.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import polars as pl
import tomlkit

from imubayes import fit, sample
from imubayes.foundations.progress import Tell, silent
from imubayes.foundations.quantity_names import QuantityName, name_of
from imubayes.foundations.records import Record
from imubayes.results.marginal import Marginal
from imubayes_qualification.evaluation.decision_rules import ToleranceInterval, conformance_probability
from imubayes_qualification.evaluation.input_quantities import InputQuantity
from imubayes_qualification.evaluation.propagation import propagate
from imubayes_recordings.noise_analysis.allan_deviation import allan_variance
from imubayes_recordings.noise_analysis.running_sum import from_samples


class KnownAnswer(Record):
    """A value computed here beside the known one.

    Attributes
    ----------
    subject : what was computed.
    source : where the known value was published, or how it is known.
    known, found : in the unit that the subject names.
    allowed : largest difference; half of the last published digit, or the scatter of a finite number of draws.

    Examples
    --------
    >>> import imubayes
    >>> answer = imubayes.KnownAnswer(subject="π", source="series", known=3.1416, found=3.14159, allowed=5e-5)
    >>> answer.agrees
    True
    """

    subject: str
    source: str
    known: float
    found: float
    allowed: float

    @property
    def agrees(self) -> bool:
        """Whether the difference is within what is allowed."""
        return abs(self.found - self.known) <= self.allowed


def _answer(subject: str, source: str, known: float, found: float, allowed: float) -> KnownAnswer:
    return KnownAnswer(subject=subject, source=source, known=known, found=found, allowed=allowed)


def selftest(progress: Tell = silent) -> tuple[KnownAnswer, ...]:
    """Return the known answers with the values of this installation.

    Parameters
    ----------
    progress : called with a short text as the work goes on.

    Examples
    --------
    >>> import imubayes
    >>> all(answer.agrees for answer in imubayes.selftest())
    True
    """
    found: list[KnownAnswer] = []
    for subject, answers in _PARTS.items():
        progress(subject)
        found += answers()
    return tuple(found)


def _allan_deviations() -> Iterator[KnownAnswer]:
    numbers = [1234567890]
    while len(numbers) < 1000:
        numbers.append(16807 * numbers[-1] % 2147483647)
    suites = (
        ("9", [892, 809, 823, 798, 671, 644, 883, 903, 677], {1: (91.22945, 5e-6), 2: (85.95287, 5e-6)}),
        ("1000", np.array(numbers) / 2147483647, {1: (0.2922319, 5e-8)}),
    )
    for size, values, published in suites:
        found = allan_variance(from_samples(np.asarray(values, dtype=float), 1.0))
        deviations = dict(zip(found.factor.tolist(), np.sqrt(found.variance).tolist(), strict=True))
        for factor, (known, allowed) in published.items():
            subject = f"overlapping Allan deviation of {size} values, averaging factor {factor}"
            yield _answer(subject, "NIST SP 1065, 12.4", known, deviations[factor], allowed)


def _propagated() -> Iterator[KnownAnswer]:
    root = math.sqrt(3)
    four = [InputQuantity.between(name, -root, root) for name in "abcd"]
    found = propagate(lambda a, b, c, d: a + b + c + d, four, digits=2)
    yield _answer("sum of four rectangular quantities: u", "JCGM 101, 9.2.3", 2.0, found.uncertainty, 0.02)
    low, high = found.shortest
    yield _answer("the same: half of the 95 % interval", "JCGM 101, 9.2.3", 3.88, (high - low) / 2, 0.05)
    two = [InputQuantity.normal("a", 0.010, 0.005), InputQuantity.normal("b", 0.0, 0.005)]
    loss = propagate(lambda a, b: 1e6 * (a**2 + b**2), two, digits=2)
    source = "JCGM 101, 9.4.2.2"
    yield _answer("comparison loss, x1 = 0.010: y, 10⁻⁶", source, 150.0, loss.value, 1.5)
    yield _answer("the same: u, 10⁻⁶", source, 112.0, loss.uncertainty, 1.5)
    yield _answer("the same: upper end of the shortest 95 % interval, 10⁻⁶", source, 367.0, loss.shortest[1], 5.0)


_READING = np.array([21.521, 22.012, 22.512, 23.003, 23.507, 23.999, 24.513, 25.002, 25.503, 26.010, 26.511])
_CORRECTION = -1e-3 * np.array([171, 169, 166, 159, 164, 165, 156, 157, 159, 161, 160])


def _sampled() -> Iterator[KnownAnswer]:
    """GUM H.3 with its scatter unknown: with prior 1/σ the posterior is t with 9 degrees of freedom, sd √(9/7) u."""
    distance = _READING - 20

    def log_density(points: np.ndarray) -> np.ndarray:
        residual = points[:, :1] + points[:, 1:2] * distance - _CORRECTION
        log_sigma = points[:, 2]
        return -len(distance) * log_sigma - np.sum(residual**2, axis=1) / (2 * np.exp(2 * log_sigma))

    start, scale = [-0.17, 0.002, math.log(0.0035)], [0.003, 0.0007, 0.25]
    drawn = sample(log_density, start, scale, ["y1", "y2", "log_sigma"])
    y1, y2 = (np.asarray(drawn.posterior["posterior"][name]).ravel() for name in ("y1", "y2"))
    at_30, widening = y1 + 10 * y2, math.sqrt(9 / 7)
    cases = (("y1, °C", y1, -0.1712, 0.0029), ("y2", y2, 0.00218, 0.00067), ("b(30 °C), °C", at_30, -0.1494, 0.0041))
    for name, draws, value, u in cases:
        subject, source = f"thermometer, sampled: {name}", "GUM H.3.3 to H.3.5"
        yield _answer(subject, source, value, float(draws.mean()), 0.1 * u)
        yield _answer(
            f"{subject}: standard deviation", f"{source}, × √(9/7)", widening * u, float(draws.std()), 0.06 * u
        )


def _decided() -> Iterator[KnownAnswer]:
    draws = np.random.default_rng(1).standard_normal(200_000)
    inside = conformance_probability(Marginal(draws, float(len(draws))), ToleranceInterval(upper=1.6449))
    found = math.nan if inside.value is None else inside.value
    yield _answer("conformance probability, limit 1.6449 u above y", "JCGM 106, 7.2", 0.95, found, 0.002)


@dataclass(frozen=True)
class _Kind:
    """What the three channels of a kind have in common; `width` is of the normal priors of θ."""

    name: str
    per: str
    scale: float
    noise: float
    width: tuple[float, ...]


@dataclass(frozen=True)
class _Axis:
    """A channel along body axis `place`, with θ*: bias, scale factor error and two misalignments."""

    name: str
    kind: _Kind
    place: int
    stated: tuple[float, ...]

    def output(self, theta: np.ndarray, inputs: np.ndarray) -> np.ndarray:
        """Return the outputs for inputs (rows, 3) in body axes: scale · (1 + error) · (input along IA + bias)."""
        bias, error, toward_o, toward_s = theta
        along, across, third = (inputs[:, (self.place + step) % 3] for step in range(3))
        projected = (along + toward_o * across + toward_s * third) / np.sqrt(1 + toward_o**2 + toward_s**2)
        return self.kind.scale * (1 + error) * (projected + bias)


_ARCSEC, _G = math.pi / 648_000, 9.81
_TILTS = 600 * _ARCSEC, 600 * _ARCSEC
_GYRO = _Kind("gyro", "rad/s", 60_000.0, 5.0, (1e-4, 1e-3, *_TILTS))
_FORCE = _Kind("accelerometer", "m/s^2", 2_000.0, 3.0, (0.05, 1e-3, *_TILTS))
# θ*: bias in the unit of the input, scale factor error, misalignments in arcsec.
_UNIT = tuple(
    _Axis(f"{kind.name[0]}{axis}", kind, "xyz".index(axis), (bias, error, toward_o * _ARCSEC, toward_s * _ARCSEC))
    for kind, axis, bias, error, toward_o, toward_s in (
        (_GYRO, "x", 7e-5, 3e-4, 90, -45), (_GYRO, "y", -1.2e-4, -2e-4, -30, 70), (_GYRO, "z", 2e-5, 5e-4, 20, 55),
        (_FORCE, "x", 0.02, -4e-4, 60, 25), (_FORCE, "y", -0.01, 6e-4, 35, -80), (_FORCE, "z", 0.03, 1e-4, -50, 15),
    )
)  # fmt: skip
_NAMES = {
    "gyro": ("gyro_bias.bias", "gyro_scale_factor.scale", "gyro_misalignment.toward_o", "gyro_misalignment.toward_s"),
    "accelerometer": ("accel_bias.bias", "accel_scale_factor.scale", "accel_misalignment.toward_o",
                      "accel_misalignment.toward_p"),
}  # fmt: skip
_LATITUDE, _EARTH = 48.0, 7.292115e-5
_RATES, _SAMPLES = np.array([-100.0, -30.0, -10.0, 10.0, 30.0, 100.0]), 1000  # deg/s
# Each body axis up and down on a rate table with a vertical axis: rotations, as rows of body_to_table.
_SEATS = tuple(np.roll(np.diag([1.0, sign, sign]), shift, axis=1) for sign in (1.0, -1.0) for shift in range(3))


def _constructed() -> Iterator[KnownAnswer]:
    """Fit the campaign whose posterior mode is θ*."""
    random = np.random.default_rng(20261128)
    up = np.concatenate([np.repeat(seat[2:], len(_RATES), axis=0) for seat in _SEATS])
    rates = np.radians(np.tile(_RATES, len(_SEATS))) + _EARTH * math.sin(math.radians(_LATITUDE))
    outputs: dict[str, np.ndarray] = {}
    sds: dict[str, np.ndarray] = {}
    for axis in _UNIT:
        inputs = up * rates[:, None] if axis.kind is _GYRO else up * _G
        theta, weight = np.array(axis.stated), _SAMPLES / axis.kind.noise**2
        jacobian = np.stack([np.imag(axis.output(theta + step, inputs)) / 1e-30 for step in 1e-30j * np.eye(4)], axis=1)
        precision = np.diag(1 / np.square(axis.kind.width))
        normal = weight * jacobian.T @ jacobian
        noise = random.standard_normal(len(inputs)) / math.sqrt(weight)
        within = np.linalg.solve(normal, precision @ theta - weight * jacobian.T @ noise)
        outputs[axis.name] = axis.output(theta, inputs) + noise + jacobian @ within
        sds[axis.name] = np.sqrt(np.diag(np.linalg.inv(normal + precision)))
    with TemporaryDirectory() as name:
        folder = Path(name)
        _write_campaign(folder, outputs)
        _write_model(folder / "model.toml")
        found = fit(folder, folder / "model.toml", sample=False).fit
    if found.posterior is None:
        yield _answer("joint fit: converged", "by construction", 1.0, 0.0, 0.0)
        return
    fitted, draws = dict(zip(found.model.parameter_names, found.z, strict=False)), found.posterior.points
    off, wide = [], []
    for axis in _UNIT:
        names = [name_of(name, axis.name) for name in _NAMES[axis.kind.name]]
        for name, value, width, u in zip(names, axis.stated, axis.kind.width, sds[axis.name], strict=True):
            off.append(abs(fitted[name] * width - value) / u)
            wide.append(abs(draws[:, found.model.parameter_names.index(name)].std() * width / u - 1))
    source = f"by construction, {len(off)} parameters"
    yield _answer("joint fit: largest distance of an estimate from its value, in u", source, 0.0, max(off), 1e-8)
    yield _answer("the same: largest relative error of a standard uncertainty", source, 0.0, max(wide), 0.05)


def _write_campaign(folder: Path, outputs: Mapping[str, np.ndarray]) -> None:
    unit = np.eye(3)
    channels = [
        {"name": axis.name, "kind": axis.kind.name, "input_axis": unit[axis.place].tolist(),
         "output_axis": unit[(axis.place + 1) % 3].tolist(), "output_unit": "count", "scale": axis.kind.scale,
         "per": axis.kind.per, "noise": axis.kind.noise}
        for axis in _UNIT
    ]  # fmt: skip
    seats = {f"seat-{place + 1}": seat for place, seat in enumerate(_SEATS)}
    document = {
        "format": 1,
        "name": "selftest",
        "site": {"latitude_deg": _LATITUDE, "gravity_m_s2": _G},
        "channel": channels,
        "table": [{"name": "table", "elevation_deg": 90.0}],
        "mounting": [{"name": name, "body_to_table": seat.tolist()} for name, seat in seats.items()],
        "run": [
            {"name": name, "procedure": "rate_table", "file": f"{name}.csv", "table": "table", "mounting": name}
            for name in seats
        ],
    }
    (folder / "campaign.toml").write_text(tomlkit.dumps(document))
    for place, name in enumerate(seats):
        rows = slice(len(_RATES) * place, len(_RATES) * (place + 1))
        columns = {"time_s": 600.0 * np.arange(len(_RATES)), "table_rate_deg_s": _RATES}
        columns |= {channel: values[rows] for channel, values in outputs.items()}
        pl.DataFrame({**columns, "samples": np.full(len(_RATES), _SAMPLES)}).write_csv(folder / f"{name}.csv")


def _write_model(file: Path) -> None:
    priors: dict[str, dict[str, str]] = {"white_noise": {"sigma": "lognormal(1 noise, 1e-6)"}}
    for kind in (_GYRO, _FORCE):
        for name, width, unit in zip(_NAMES[kind.name], kind.width, (kind.per, "1", "rad", "rad"), strict=True):
            quantity = QuantityName.of(name)
            priors.setdefault(quantity.effect, {})[quantity.parameter] = f"normal(0, {width!r} {unit})"
    effects = [{"name": effect, "prior": prior} for effect, prior in priors.items()]
    file.write_text(tomlkit.dumps({"format": 1, "name": "selftest", "effect": effects}))


_PARTS: Mapping[str, Callable[[], Iterator[KnownAnswer]]] = {
    "Allan deviation": _allan_deviations,
    "propagation of uncertainty": _propagated,
    "conformity": _decided,
    "sampling": _sampled,
    "joint fit": _constructed,
}
